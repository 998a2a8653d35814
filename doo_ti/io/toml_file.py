"""TOML files, the keys that scenes of several kinds share, and the scenes that come with the package.

msgspec checks that each value has its declared type and range. A message names file, key, value and remedy:

    scene.toml: rod.edges: 2 is not allowed; give a whole number >= 4

Commands take scenes of the package by name in any folder: ``vicryl``, ``whip``, ``scenes/rig.yaml``. Scenes share the keys of a
rod's material, and of what is stated at some moments of a motion, smooth between them (docs/scenes.md).
"""

import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, get_args, get_origin

import msgspec
import numpy as np

from doo_ti.rod import frames as rotations
from doo_ti.rod.material import bend_or_twist, force_in_newton, weight_per_length
from doo_ti.rod.types import LARGEST, Configuration
from doo_ti.system.errors import InputError, require
from doo_ti.system.files import MOST_TEXT_BYTES, read_content
from doo_ti.system.terminal import warn

Finite = Annotated[float, msgspec.Meta(ge=-LARGEST, le=LARGEST)]
Positive = Annotated[float, msgspec.Meta(gt=0, le=LARGEST)]
NotNegative = Annotated[float, msgspec.Meta(ge=0, le=LARGEST)]
Vector = tuple[Finite, Finite, Finite]
Rotation = tuple[Vector, Vector, Vector]
NumberOrPair = float | tuple[float, float]
NumberOrMatrix = float | tuple[tuple[float, float], tuple[float, float]]
"""Without bounds, which are checked where the values are used: msgspec 0.22 crashes on a bounded number beside a tuple."""

_FORMS = {Vector: "a vector [X, Y, Z]", Rotation: "a matrix of three rows [X, Y, Z]",
          NumberOrPair: "a number, or two: [START, END]", NumberOrMatrix: "a number or a matrix [[A1, A12], [A12, A2]]"}
_WORDS = {"float": "a number", "int": "a whole number", "str": "text in quotes", "bool": "true or false", "array": "a list",
          "object": "a table"}
"""msgspec's names of types, for a person."""


class Table(msgspec.Struct, forbid_unknown_fields=True):
    """One table of a TOML file; subclasses declare its keys and their types."""


def read_toml(path: Path) -> tuple[dict, bytes]:
    """The values in a TOML file, and its bytes. Raises InputError for a file that cannot be read or is not TOML."""
    content = read_content(path, MOST_TEXT_BYTES, "name a readable scene")
    try:
        return tomllib.loads(content.decode()), content
    except UnicodeDecodeError:
        raise InputError(path, "file", "not TOML (not even text)", "name a TOML file") from None
    except (ValueError, RecursionError) as error:
        raise InputError(path, "file", f"not TOML ({error})", "correct the scene") from None


def checked(source, key: str, value, kind):
    """``value`` in the type ``kind``, a :class:`Table` or whatever msgspec converts to.

    key  of the value in the file, for messages; empty for the whole file

    Raises InputError for wrong types, values out of range, and keys that are missing or unknown.
    """
    try:
        return msgspec.convert(value, kind)
    except msgspec.ValidationError as error:
        found = re.fullmatch(r"(?P<problem>.*?)(?: - at `\$\.?(?P<key>\w*).*`)?", str(error), re.DOTALL)
    if found["key"]:  # one of the table's keys
        kind = next(field.type for field in msgspec.structs.fields(kind) if field.encode_name == found["key"])
        key, value = _below(key, found["key"]), value[found["key"]]
    about_key = re.fullmatch(r"Object (?P<what>missing|contains).* field `(?P<key>.*)`", found["problem"], re.DOTALL)
    if about_key and about_key["what"] == "missing":
        raise InputError(source, _below(key, about_key["key"]), "missing", f"add {about_key['key']}")
    if about_key:
        raise unknown_key(source, _below(key, about_key["key"]), kind.__struct_fields__)
    if isinstance(value, dict) and (kind is list or get_origin(kind) is list or list in get_args(kind)):
        raise InputError(source, key, "one table, in single brackets", f"write [[{key}]]")
    shown = repr(value)
    problem = f"{shown[:80] + '…' * (len(shown) > 80)} is not allowed"
    raise InputError(source, key, problem, _remedy(found["problem"], kind))


def unknown_key(source, key: str, known) -> InputError:
    """The error for a ``key`` that is none of the ``known`` ones."""
    return InputError(source, key, "unknown key", f"the keys are {', '.join(known)}")


def _below(key: str, name: str) -> str:
    return f"{key}.{name}" if key else name


def _remedy(problem: str, kind) -> str:
    """What to give instead, from msgspec's message: "Expected `float | null` >= 0.0, got `str`" says a number >= 0.0."""
    for part in (kind, *get_args(kind)):
        if part in _FORMS:
            return f"give {_FORMS[part]}"
        if get_origin(part) is Literal:
            return f"give one of {', '.join(get_args(part))}"
    expected = re.fullmatch(r"Expected (.*?)(?:, got .*)?", problem, re.DOTALL)
    if expected is None:
        return f"correct it ({problem})"
    each = "in each entry " if get_origin(kind) is tuple and "`array`" not in problem else ""
    return f"{each}give " + re.sub("`(.*?)`", lambda names: " or ".join(
        _WORDS.get(name, name) for name in names[1].split(" | ") if name != "null"), expected[1])


PACKAGE = Path(__file__).parents[1]
SCENES = PACKAGE / "scenes" if (PACKAGE / "scenes").is_dir() else PACKAGE.parent / "scenes"
"""Where those of an installed package lie, or of its source."""


def scene_file(name: str) -> str:
    """``name`` where there is such a file or folder, else the scene of that name that comes with the package, else ``name``."""
    asked = Path(name)
    if not name or asked.exists() or asked.is_absolute() or ".." in asked.parts:
        return name
    within = Path(*asked.parts[1:]) if asked.parts[0] == "scenes" and len(asked.parts) > 1 else asked
    for place in (SCENES, SCENES / "motion", SCENES / "groups"):
        for file in (place / within, place / within.with_suffix(".toml")):
            if file.is_file():
                return str(file)
    return name


# --- keys that scenes share ----------------------------------------------------------------------------------------------


class MaterialKeys(Table, kw_only=True):
    """The keys; what is None is not stated."""

    bend: NumberOrMatrix | None = None
    twist: Positive | None = None
    weight: NotNegative | None = None
    EI: NumberOrMatrix | None = None
    GJ: Positive | None = None
    linear_density: Positive | None = None


@dataclass(frozen=True)
class StatedMaterial:
    """bend (2, 2) and twist in mm³ and weight, as :class:`.Material` has them; newton: N in its unit of force, or None."""

    bend: np.ndarray
    twist: float
    weight: float
    newton: float | None


def stated_material(source, key: str, keys: MaterialKeys, unit_density: float | None = None) -> StatedMaterial:
    """The material that the table ``key`` of the file ``source`` states.

    unit_density  g/m of a rod of weight 1, to which stiffness in N m² becomes relative; by default the material's own

    Raises InputError for keys that are missing, and for the same quantity stated in both ways.
    """
    physical = keys.EI is not None
    for name, other in (("bend", "EI"), ("weight", "EI"), ("twist", "EI"), ("GJ", "bend")):
        require(getattr(keys, name) is None or getattr(keys, other) is None, source, f"{key}.{name}", f"given beside {other}",
                "give bend, twist and weight, or EI and GJ with linear_density")
    require(physical or keys.bend is not None, source, f"{key}.{'EI' if keys.GJ is not None else 'bend'}", "missing",
            "give bend, or EI with linear_density")
    if physical and keys.linear_density is None:
        raise InputError(source, f"{key}.linear_density", "missing beside EI", "give the mass per length in g/m")
    bend, twist, names = (keys.EI, keys.GJ, ("EI", "GJ")) if physical else (keys.bend, keys.twist, ("bend", "twist"))
    if twist is None and not isinstance(bend, float):
        raise InputError(source, f"{key}.{names[1]}", f"missing beside a matrix {names[0]}", "give the stiffness against twist")
    matrix, twist = np.array(bend) if isinstance(bend, tuple) else bend * np.eye(2), bend if twist is None else twist
    weight = 1.0 if keys.weight is None else keys.weight
    if physical:
        unit = weight_per_length(keys.linear_density if unit_density is None else unit_density)
        matrix, twist = bend_or_twist(matrix, unit), float(bend_or_twist(twist, unit))
        weight = 1.0 if unit_density is None else keys.linear_density / unit_density
    newton = None
    if keys.linear_density is not None and weight > 0:
        newton = float(force_in_newton(1.0, weight_per_length(keys.linear_density), weight))
    return StatedMaterial(matrix, twist, weight, newton)


def newtons(found: list[StatedMaterial]) -> np.ndarray | None:
    """(G,) N in the unit of force of each material, or None where one does not state it."""
    return None if any(one.newton is None for one in found) else np.array([one.newton for one in found])


def instants(source, rate: float, duration: float, most: int, called: str) -> np.ndarray:
    """(1 + steps,) s: ``rate`` instants a second from zero to ``duration``, the values of ``rate_hz`` and ``duration_s`` in the
    file ``source``. Raises InputError, which calls them ``called``, for fewer than one step or more than ``most``."""
    steps = round(duration * rate)
    require(1 <= steps <= most, source, "duration_s", f"{steps} {called} at rate_hz", f"give 1 to {most:,}")
    return np.arange(steps + 1) / rate


def interpolated(source, name: str, rows: list, table: type[Table], first: Mapping[str, object],
                 time: np.ndarray) -> dict[str, np.ndarray]:
    """The quantities of ``first``, as they are at time zero, at the instants ``time`` (T,) in s: (T, ...) each, on monotone
    cubics between the moments of ``rows``, called ``name`` in the file ``source``; after the last they stay.

    table  how a moment is written: ``time_s``, and quantities that are None where they stay as they were. Those whose names
           end in "direction" become unit vectors

    Raises InputError where times do not rise, and as :func:`.checked` does.
    """
    from scipy.interpolate import PchipInterpolator

    now, at, states = dict(first), [0.0], [first]
    for k, row in enumerate(rows):
        moment = checked(source, f"{name}[{k}]", row, table)
        if moment.time_s < at[-1] or k and moment.time_s == at[-1]:
            raise InputError(source, f"{name}[{k}].time_s", f"{moment.time_s:g} does not rise", "give moments in their order")
        for key in now:
            value = getattr(moment, key)
            if value is not None:
                direction = key.endswith("direction")
                now[key] = rotations.unit_direction(source, f"{name}[{k}].{key}", value) if direction else np.array(value)
        if moment.time_s == at[-1]:  # the first one takes the place of the beginning
            at, states = [], []
        at.append(moment.time_s)
        states.append(dict(now))
    if len(at) == 1:
        return {key: np.broadcast_to(value, (len(time), *np.shape(value))) for key, value in now.items()}
    return {key: PchipInterpolator(at, np.array([state[key] for state in states]))(np.minimum(time, at[-1])) for key in now}


ClampName = Literal["free", "position", "tangent", "frame"]


class Moment(Table):
    """One moment; what is None stays as it was."""

    time_s: NotNegative = 0.0
    start_position_mm: Vector | None = None
    start_direction: Vector | None = None
    end_position_mm: Vector | None = None
    end_direction: Vector | None = None
    start_turns: Finite | None = None
    end_turns: Finite | None = None
    end_rotation_deg: Finite | None = None


@dataclass(frozen=True)
class EndPaths:
    """Where both ends of a rod are held at T instants: positions (T, 3) mm, frames (T, 3, 3) with columns t, m1, m2, and (T,)
    rad by which the end has turned about its direction."""

    start_position: np.ndarray
    end_position: np.ndarray
    start_frame: np.ndarray
    end_frame: np.ndarray
    end_rotation: np.ndarray


def end_paths(source, key: str, rows: list, start: Configuration, time: np.ndarray) -> EndPaths:
    """The paths of the ends of one rod at the instants ``time`` (T,) s.

    rows   the moments, the value of ``key`` in the file ``source``
    start  the rod: where its ends are as long as no moment says otherwise

    While its direction changes, also from the rod's own to that of the first moment, an end turns about it only by its
    ``turns``. Raises InputError as :func:`.interpolated` does, and where a direction reverses from one moment to the next.
    """
    rows = [_in_turns(source, f"{key}[{number}]", row) for number, row in enumerate(rows)]
    vertices, frames = start.vertices[0], start.frames[0]
    first = {"start_position_mm": vertices[0], "start_direction": frames[0, :, 0], "end_position_mm": vertices[-1],
             "end_direction": frames[-1, :, 0], "start_turns": 0.0, "end_turns": 0.0}
    paths = interpolated(source, key, rows, Moment, first, time)
    held = {}
    for end, edge in (("start", 0), ("end", -1)):
        length = np.linalg.norm(paths[f"{end}_direction"], axis=-1, keepdims=True)
        require((length > 0).all(), source, key, f"{end}_direction reverses from one moment to the next",
                "give a moment with a direction in between")
        along = np.concatenate([frames[edge, None, :, 0], paths[f"{end}_direction"] / length])
        along = _transported(along, frames[edge, :, 1])[1:]
        held[end] = rotations.turned_about_tangent(along, 2 * np.pi * paths[f"{end}_turns"])
    return EndPaths(paths["start_position_mm"], paths["end_position_mm"], held["start"], held["end"],
                    2 * np.pi * paths["end_turns"])


def _in_turns(source, key: str, row):
    """The moment ``row`` with ``end_turns`` for ``end_rotation_deg``, if it has that."""
    if not isinstance(row, dict) or "end_rotation_deg" not in row:
        return row
    turns = checked(source, key, row, Moment).end_rotation_deg / 360.0
    warn(f"{source}: {key}.end_rotation_deg is called end_turns now: {turns:g}")
    return {name: value for name, value in row.items() if name != "end_rotation_deg"} | {"end_turns": turns}


def _transported(directions: np.ndarray, m1: np.ndarray) -> np.ndarray:
    """(T, 3, 3) frames along unit ``directions`` (T, 3), from one with that ``m1`` (3,) by the smallest rotation from each to
    the next. The rotations of 2, then 4, 8, … successive instants are multiplied, as there may be a million instants."""
    turn, together = np.tile([1.0, 0.0, 0.0, 0.0], (len(directions), 1)), 1
    turn[1:] = rotations.smallest_rotation(directions[:-1], directions[1:])
    while together < len(turn):
        turn[together:] = rotations.quaternion_product(turn[together:], turn[:-together])
        together *= 2
    across = rotations.matrix_from_quaternion(turn / np.linalg.norm(turn, axis=-1, keepdims=True)) @ m1
    across -= np.sum(across * directions, axis=-1, keepdims=True) * directions
    across /= np.linalg.norm(across, axis=-1, keepdims=True)
    return np.stack([directions, across, np.cross(directions, across)], axis=-1)
