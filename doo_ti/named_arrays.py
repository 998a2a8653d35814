"""Files of arrays that go along together: npz, one array per key, or CSV, one row per entry.

Which keys there are, the shape of an entry, and the columns that hold it in a CSV file say the callers:

    {"end_position_mm": ((3,), ("end_x_mm", "end_y_mm", "end_z_mm"))}
"""

import csv
from io import StringIO
from pathlib import Path

import numpy as np

from doo_ti.errors import InputError
from doo_ti.file_content import read_content
from doo_ti.importers import read_npz
from doo_ti.types import LARGEST

_AXES = ("x", "y", "z")


def position_columns(name: str) -> tuple[str, ...]:
    """Of a position in mm."""
    return tuple(f"{name}_{axis}_mm" for axis in _AXES)


def frame_columns(name: str) -> tuple[str, ...]:
    """Of a frame, as tables of observations have them."""
    return tuple(f"{name}_{director}_{axis}" for axis in _AXES for director in ("t", "m1", "m2"))


def read_arrays(path: Path, known: dict[str, tuple[tuple[int, ...], tuple[str, ...]]], only_npz=()) -> dict[str, np.ndarray]:
    """The arrays of a file, those of a CSV file (N, \\*shape), as float64.

    only_npz  further keys, of any shape, that no CSV file holds

    Raises InputError for files that cannot be read, unknown columns, entries that are not finite numbers, and where none of
    the known keys is there.
    """
    path = Path(path)
    if path.suffix not in (".npz", ".csv"):
        raise InputError(path, "file", f"suffix {path.suffix!r}", "name a .npz or .csv file")
    content = read_content(path)
    keys = (*known, *only_npz)
    arrays = read_npz(path, content, keys) if path.suffix == ".npz" else _from_table(path, content, known)
    if not arrays:
        raise InputError(path, "file", "holds none of the known keys", f"give some of {', '.join(keys)}")
    for key, value in arrays.items():
        if value.dtype.kind not in "fiu":
            raise InputError(path, key, f"dtype {value.dtype} is not numeric", "store real numbers")
        arrays[key] = value = value.astype(np.float64)
        if not (np.abs(value) <= LARGEST).all():
            raise InputError(path, key, "not finite", "give finite numbers")
    return arrays


def _from_table(path: Path, content: bytes, known) -> dict[str, np.ndarray]:
    try:
        rows = [row for row in csv.reader(StringIO(content.decode("utf-8-sig"))) if row]
    except (ValueError, csv.Error) as error:
        raise InputError(path, "file", f"not CSV ({error})", "give a CSV file") from None
    names = [name.strip() for name in rows[0]] if rows else []
    columns = [name for _, owned in known.values() for name in owned]
    for name in names:
        if name not in columns or names.count(name) > 1:
            raise InputError(path, name or "header", "unknown column, or one given twice",
                             f"the columns are {', '.join(columns)}")
    if len(rows) < 2:
        raise InputError(path, "file", "holds no rows", "give numbers below the names of the columns")
    if any(len(row) != len(names) for row in rows):
        line = next(number for number, row in enumerate(rows, 1) if len(row) != len(names))
        raise InputError(path, "file", f"line {line} has {len(rows[line - 1])} entries", f"give {len(names)} in each line")
    try:
        values = np.array(rows[1:], dtype=np.float64)
    except ValueError as error:
        raise InputError(path, "file", f"an entry is no number ({error})", "give numbers below the names") from None
    arrays = {}
    for key, (shape, owned) in known.items():
        present = [name for name in owned if name in names]
        if present and len(present) < len(owned):
            missing = next(name for name in owned if name not in names)
            raise InputError(path, missing, f"the column is missing beside {present[0]}", f"give {', '.join(owned)}")
        if present:
            arrays[key] = values[:, [names.index(name) for name in owned]].reshape(len(values), *shape)
    return arrays
