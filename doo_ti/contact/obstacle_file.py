"""Obstacles in TOML files: for each a ``kind`` and the fields of its class (:mod:`doo_ti.contact.obstacles`), lengths in mm.

    [[obstacles]]
    kind = "plane"                     # plane, sphere, capsule, cylinder, ring, box or itself
    point = [0, 0, 0]
    normal = [0, 0, 1]

    [[obstacles]]
    kind = "cylinder"
    start = [0, -50, 20]
    end = [0, 50, 20]
    radius = 8.0
    friction = 0.3                     # (0)
"""

from dataclasses import MISSING, fields
from pathlib import Path
from typing import Annotated, Literal

import msgspec

from doo_ti.contact.itself import Itself
from doo_ti.contact.obstacles import Box, Capsule, Cylinder, Obstacle, Plane, Ring, Sphere
from doo_ti.errors import InputError
from doo_ti.io.toml_file import Finite, NotNegative, Positive, Rotation, Table, Vector, checked, read_toml

KINDS = {kind.__name__.lower(): kind for kind in (Plane, Sphere, Capsule, Cylinder, Ring, Box, Itself)}
_TYPES = {(): Finite, (3,): Vector, (3, 3): Rotation}


def _table(kind: type[Obstacle]) -> type[Table]:
    """How an obstacle of that class is written."""
    keys = [("kind", str)]
    for field in fields(kind):
        number = NotNegative if field.name == "friction" else Positive if field.name in kind.positive else Finite
        value = _TYPES[kind.shapes[field.name]] if kind.shapes[field.name] else number
        keys.append((field.name, value) if field.default is MISSING else (field.name, value, field.default))
    return msgspec.defstruct(kind.__name__, keys, bases=(Table,), forbid_unknown_fields=True)


class _File(Table):
    obstacles: Annotated[list, msgspec.Meta(min_length=1)]


def load_obstacles(path: str | Path) -> list[Obstacle]:
    """The obstacles of a TOML file. Raises InputError for unreadable files, unknown kinds and keys, wrong types and values."""
    path = Path(path)
    return obstacles_of(path, checked(path, "", read_toml(path)[0], _File).obstacles)


def obstacles_of(source, rows: list) -> list[Obstacle]:
    """The obstacles of ``[[obstacles]]`` in the file ``source``. Raises InputError as :func:`load_obstacles` does."""
    found = []
    for number, row in enumerate(rows):
        key = f"obstacles[{number}]"
        if not isinstance(row, dict) or "kind" not in row:
            raise InputError(source, f"{key}.kind", "missing", f"give one of {', '.join(KINDS)}")
        kind = KINDS[checked(source, f"{key}.kind", row["kind"], Literal[tuple(KINDS)])]
        values = msgspec.structs.asdict(checked(source, key, row, _table(kind)))
        del values["kind"]
        try:
            found.append(kind(**values))
        except InputError as error:
            raise InputError(source, f"{key}.{error.field}", error.problem, error.remedy) from None
    return found
