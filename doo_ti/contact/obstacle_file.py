"""Obstacles in files. In TOML (docs/obstacles.md) each has a ``kind`` and the fields of its class, lengths in mm; in scenes of
motions it may move, smoothly between its moments. In the folder of a run their numbers are in an npz, and in JSON what they are
and a digest of them."""

import hashlib
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import numpy as np

from doo_ti.contact.distance_grid import DistanceGrid
from doo_ti.contact.obstacles import Box, Capsule, Cylinder, Obstacle, Plane, Ring, Sphere
from doo_ti.contact.surroundings import Itself, Moving, Surroundings
from doo_ti.io import toml_file
from doo_ti.io.arrays import read_npz
from doo_ti.io.toml_file import Finite, NotNegative, Positive, Rotation, Table, Vector, checked, read_toml
from doo_ti.rod.frames import rotation_matrix, unit_direction
from doo_ti.system.arguments import typed
from doo_ti.system.errors import InputError
from doo_ti.system.files import read_content, write_whole

KINDS = {kind.__name__.lower(): kind for kind in (Plane, Sphere, Capsule, Cylinder, Ring, Box, Itself)} | {"grid": DistanceGrid}
GRID_KEYS = ("values", "spacing", "origin")
MOST_POSES = 1_000_000  # moving obstacles times instants of the motion
_TYPES = {(): Finite, (3,): Vector, (3, 3): Rotation}


def _table(kind: type[Obstacle]) -> type[Table]:
    """How an obstacle of that class is written."""
    keys = [("kind", str)]
    for field in fields(kind):
        number = NotNegative if field.name == "friction" else Positive if field.name in kind.positive else Finite
        value = _TYPES[kind.shapes[field.name]] if kind.shapes[field.name] else number
        keys.append((field.name, value) if field.default is MISSING else (field.name, value, field.default))
    return msgspec.defstruct(kind.__name__, keys, bases=(Table,), forbid_unknown_fields=True)


class _Grid(Table):
    """How a grid is written: by its values or by a mesh, in files beside the TOML file."""

    kind: str
    file: str | None = None
    mesh: str | None = None
    spacing: Positive | None = None
    margin: Positive | None = None
    position: Vector = (0.0, 0.0, 0.0)
    rotation: Rotation = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    friction: NotNegative = 0.0


class _Motion(Table):
    moments: Annotated[list, msgspec.Meta(min_length=1)]
    pivot: Vector | None = None
    turn_axis: Vector | None = None


class _Moment(Table):
    time_s: NotNegative
    shift: Vector | None = None
    turns: Finite | None = None


class _File(Table):
    obstacles: Annotated[list, msgspec.Meta(min_length=1)]


@typed
def load_obstacles(path: str | Path) -> list[Obstacle]:
    """The obstacles of a TOML file. Raises InputError for unreadable files, unknown kinds and keys, wrong types and values."""
    path = Path(path)
    return obstacles_of(path, checked(path, "", read_toml(path)[0], _File).obstacles)


def obstacles_of(source, rows: list, time: np.ndarray | None = None) -> list[Obstacle | Moving]:
    """The obstacles of ``[[obstacles]]`` in the file ``source``; those that move at the instants ``time`` (T,) s of a motion,
    if there are any. Raises InputError as :func:`load_obstacles` does."""
    moving = sum(isinstance(row, dict) and "moments" in row for row in rows)
    if time is not None and moving * len(time) > MOST_POSES:
        raise InputError(source, "obstacles", f"{moving} that move at {len(time):,} instants",
                         f"give fewer, or at most {MOST_POSES // moving:,} instants")
    return [_obstacle(source, f"obstacles[{number}]", row, time) for number, row in enumerate(rows)]


def _obstacle(source, key: str, row, time: np.ndarray | None) -> Obstacle | Moving:
    if not isinstance(row, dict) or "kind" not in row:
        raise InputError(source, f"{key}.kind", "missing", f"give one of {', '.join(KINDS)}")
    kind = KINDS[checked(source, f"{key}.kind", row["kind"], Literal[tuple(KINDS)])]
    motion = {name: row[name] for name in _Motion.__struct_fields__ if name in row}
    row = {name: value for name, value in row.items() if name not in motion}
    if motion and (time is None or kind is Itself):
        what = "the rod itself" if kind is Itself else "an obstacle that stands still here"
        raise InputError(source, f"{key}.{next(iter(motion))}", f"given for {what}",
                         "leave it out: bodies in scenes of simulate and predict may move")
    if kind is DistanceGrid:
        found = _grid(source, key, checked(source, key, row, _Grid))
    else:
        values = msgspec.structs.asdict(checked(source, key, row, _table(kind)))
        del values["kind"]
        try:
            found = kind(**values)
        except InputError as error:
            raise InputError(source, f"{key}.{error.field}", error.problem, error.remedy) from None
    return _moving(source, key, found, checked(source, key, motion, _Motion), time) if motion else found


def _moving(source, key: str, obstacle: Obstacle, motion: _Motion, time: np.ndarray) -> Moving:
    axis = obstacle.placed[1][0, :, 2] if motion.turn_axis is None else unit_direction(
        source, f"{key}.turn_axis", motion.turn_axis)
    path = toml_file.interpolated(source, f"{key}.moments", motion.moments, _Moment, {"shift": np.zeros(3), "turns": 0.0}, time)
    largest = np.abs(np.diff(path["turns"])).max()
    if largest >= 0.5:
        raise InputError(source, f"{key}.moments", f"{largest:.2g} turns between two frames",
                         "give less than half a turn, or a larger rate_hz")
    return Moving(obstacle, path["shift"], rotation_matrix(2.0 * np.pi * path["turns"][:, None] * axis), motion.pivot)


def _grid(source, key: str, table: _Grid) -> DistanceGrid:
    """The grid that a table of the file ``source`` states."""
    if (table.file is None) == (table.mesh is None):
        raise InputError(source, f"{key}.file", "missing" if table.file is None else "given beside mesh", "give file or mesh")
    if table.mesh is not None and table.spacing is None:
        raise InputError(source, f"{key}.spacing", "missing beside mesh", "add the distance of the grid's points in mm")
    if table.file is not None and (table.spacing or table.margin):
        raise InputError(source, f"{key}.{'spacing' if table.spacing else 'margin'}", "given beside file", "leave it out")
    pose = {"position": table.position, "rotation": table.rotation, "friction": table.friction}
    path = Path(source).parent / (table.file or table.mesh)
    try:
        if table.mesh is not None:
            return DistanceGrid.from_mesh(path, table.spacing, table.margin, **pose)
        given = read_npz(path, read_content(path), GRID_KEYS)
        for name in GRID_KEYS:
            if name not in given:
                raise InputError(path, name, "missing", f"store {', '.join(GRID_KEYS)} with numpy.savez")
        return DistanceGrid(**given, **pose)
    except InputError as error:
        if error.source != "DistanceGrid":
            raise
        in_file = table.file is not None and error.field in GRID_KEYS
        place, field = (path, error.field) if in_file else (source, f"{key}.{error.field}")
        raise InputError(place, field, error.problem, error.remedy) from None


# --- in the folder of a run ---


def described(surroundings: Surroundings) -> dict:
    """As JSON holds it: the kinds of the obstacles, the rods' radius, and the sha256 of all numbers."""
    digest = hashlib.sha256()
    for name, value in _arrays(surroundings).items():
        digest.update(name.encode() + str(value.shape).encode() + np.ascontiguousarray(value).tobytes())
    names = {kind: name for name, kind in KINDS.items()}
    return {"kinds": [names[type(obstacle)] for obstacle in surroundings.obstacles],
            "radius_mm": float(surroundings.radius), "sha256": digest.hexdigest()}


def save_surroundings(path: Path, surroundings: Surroundings) -> None:
    """Write the numbers of the obstacles."""
    write_whole(path, lambda file: np.savez(file, **_arrays(surroundings)))


def load_surroundings(path: Path, description: dict) -> Surroundings:
    """What :func:`described` gave ``description`` for, from what :func:`save_surroundings` wrote. Raises InputError where the
    file holds something else, KeyError or TypeError for what is no description."""
    kinds = [KINDS[name] for name in description["kinds"]]
    keys = tuple(_key(number, field.name) for number, kind in enumerate(kinds) for field in fields(kind))
    found = read_npz(path, read_content(path), keys)
    try:
        obstacles = [kind(**{field.name: found[_key(number, field.name)] for field in fields(kind)})
                     for number, kind in enumerate(kinds)]
        surroundings = Surroundings(obstacles, float(description["radius_mm"]))
        if described(surroundings) == description:
            return surroundings
    except (KeyError, InputError):
        pass
    raise InputError(path, "file", "not what the sweep wrote", "run the sweep again, which writes it")


def _key(number: int, field: str) -> str:
    return f"obstacle_{number}_{field}"


def _arrays(surroundings: Surroundings) -> dict[str, np.ndarray]:
    return {_key(number, field.name): getattr(obstacle, field.name)
            for number, obstacle in enumerate(surroundings.obstacles) for field in fields(obstacle)}
