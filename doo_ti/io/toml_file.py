"""TOML files: msgspec checks that each value has its declared type and range; one form of error message, which names file, key,
value and remedy:

    scene.toml: rod.edges: 2 is not allowed; give a whole number >= 4

and the scenes that come with the package: commands take them by name in any folder, ``vicryl``, ``whip``, ``scenes/rig.yaml``.
"""

import re
import tomllib
from pathlib import Path
from typing import Annotated, Literal, get_args, get_origin

import msgspec
import numpy as np

from doo_ti.rod.types import LARGEST
from doo_ti.system.errors import InputError
from doo_ti.system.files import MOST_TEXT_BYTES, read_content

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


def unit_direction(source, key: str, vector) -> np.ndarray:
    """(3,) ``vector``, the value of that key, over its length. Raises InputError where that is zero."""
    length = np.linalg.norm(vector)
    if not length > 0:
        raise InputError(source, key, "no direction", "give a vector X, Y, Z that is not zero")
    return np.asarray(vector, dtype=np.float64) / length


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
INSTALLED, SOURCE = PACKAGE / "scenes", PACKAGE.parent / "scenes"
"""Where they lie in an installed package, and in its source."""


def scene_file(name: str) -> str:
    """``name`` where there is such a file or folder, else the scene of that name that comes with the package, else ``name``."""
    asked = Path(name)
    if not name or asked.exists() or asked.is_absolute() or ".." in asked.parts:
        return name
    folder = INSTALLED if INSTALLED.is_dir() else SOURCE
    within = Path(*asked.parts[1:]) if asked.parts[0] == "scenes" and len(asked.parts) > 1 else asked
    for place in (folder, folder / "motion", folder / "groups"):
        for file in (place / within, place / within.with_suffix(".toml")):
            if file.is_file():
                return str(file)
    return name
