"""Files of named arrays: npz, one array per key, or CSV, one row per entry of the first axis.

The caller states which keys are known, the shape of an entry, and the columns that hold it in a CSV file:

    {"end_position_mm": ((3,), ("end_x_mm", "end_y_mm", "end_z_mm"))}
"""

import io
import zipfile
import zlib
from difflib import get_close_matches
from pathlib import Path
from tokenize import TokenError

import numpy as np

from doo_ti.errors import InputError
from doo_ti.io.csv_table import read_csv
from doo_ti.io.files import read_content
from doo_ti.types import LARGEST

AXES = ("x", "y", "z")
MOST_UNPACKED_BYTES = 1 << 30
"""Of the arrays or columns of a file."""
NEARLY = 0.88
"""Least similarity of two keys (difflib) at which one counts as a misspelling of the other."""
# What reading a damaged npz may raise.
_UNREADABLE = (ValueError, OSError, EOFError, KeyError, RuntimeError, MemoryError, OverflowError, SyntaxError,
               TypeError, TokenError, zipfile.BadZipFile, zlib.error)


def position_columns(name: str) -> tuple[str, ...]:
    """Of a position in mm."""
    return tuple(f"{name}_{axis}_mm" for axis in AXES)


def frame_columns(name: str) -> tuple[str, ...]:
    """Of a frame with the columns t, m1, m2, row by row: ``NAME_t_x``, ``NAME_m1_x``, …"""
    return tuple(f"{name}_{director}_{axis}" for axis in AXES for director in ("t", "m1", "m2"))


def read_npz(path: Path, content: bytes, known: tuple[str, ...]) -> dict[str, np.ndarray]:
    """The arrays of the ``known`` keys from the bytes of an npz file, never unpickled; ``path`` names it in messages.

    Raises InputError for whatever is not an npz of plain arrays, and for a misspelt key.
    """
    remedy = "write it with numpy.savez from plain numeric arrays"
    try:
        archive = np.load(io.BytesIO(content), allow_pickle=False)
    except _UNREADABLE as error:
        kind = "truncated" if content[:2] == b"PK" else "pickled" if content[:1] == b"\x80" else "not an npz"
        raise InputError(path, "file", f"{kind} file ({first_line(error)})", remedy) from None
    if not isinstance(archive, np.lib.npyio.NpzFile):
        raise InputError(path, "file", "holds one bare array, not named ones", remedy)
    keys = {}
    with archive:
        large = sum(entry.file_size for entry in archive.zip.infolist() if entry.filename.removesuffix(".npy") in known)
        if large > MOST_UNPACKED_BYTES:
            raise InputError(path, "file", f"unpacks to {large:,} bytes", f"give arrays of at most {MOST_UNPACKED_BYTES:,}")
        if len(set(archive.files)) < len(archive.files):
            raise InputError(path, max(archive.files, key=archive.files.count), "the key is there twice", remedy)
        for key in known:
            if key not in archive:
                # Files may hold unknown keys, but one that is nearly a known key is a mistake.
                if alike := get_close_matches(key, set(archive.files) - set(known), 1, NEARLY):
                    raise InputError(path, alike[0], "unknown key", f"name it {key}, or otherwise if it is something else")
                continue
            try:
                value = archive[key]
            except _UNREADABLE as error:
                raise InputError(path, key, f"cannot be read ({first_line(error)})", remedy) from None
            if not isinstance(value, np.ndarray):
                raise InputError(path, key, "is not an array", remedy)
            keys[key] = value
    return keys


def read_arrays(path: Path, known: dict[str, tuple[tuple[int, ...], tuple[str, ...]]], only_npz=()) -> dict[str, np.ndarray]:
    """The arrays of a file, those of a CSV file (N, \\*shape), as float64.

    only_npz  further keys, of any shape, that no CSV file holds

    Raises InputError for files that cannot be read, unknown columns, entries that are not finite numbers, and where none of
    the known keys is there.
    """
    path = Path(path)
    if path.suffix not in (".npz", ".csv"):
        raise InputError(path, "file", f"suffix {path.suffix!r}", "name a .npz or .csv file")
    keys = (*known, *only_npz)
    arrays = read_npz(path, read_content(path), keys) if path.suffix == ".npz" else _from_table(path, known)
    if not arrays:
        raise InputError(path, "file", "has none of the known keys", f"give some of {', '.join(keys)}")
    for key, value in arrays.items():
        if value.dtype.kind not in "fiu":
            raise InputError(path, key, f"dtype {value.dtype} is not numeric", "store real numbers")
        arrays[key] = value = value.astype(np.float64)
        if not (np.abs(value) <= LARGEST).all():
            raise InputError(path, key, "not finite", "give finite numbers")
    return arrays


def _from_table(path: Path, known) -> dict[str, np.ndarray]:
    columns = tuple(name for _, owned in known.values() for name in owned)
    table = read_csv(path, (), columns, form=f"some of {', '.join(columns)}")
    given = {key: given_columns(path, owned, table.columns) for key, (_, owned) in known.items()}
    return {key: np.stack([table.numbers(name) for name in names], axis=-1).reshape(table.count, *known[key][0])
            for key, names in given.items() if names}


def given_columns(path: Path, columns: tuple[str, ...], names) -> tuple[str, ...]:
    """The ``columns`` of one key, or none. Raises InputError where a table with the columns ``names`` has only some of them."""
    present = [name for name in columns if name in names]
    if present and len(present) < len(columns):
        missing = next(name for name in columns if name not in names)
        raise InputError(path, missing, f"the column is missing beside {present[0]}", f"give {', '.join(columns)}")
    return tuple(present)


def first_line(error: BaseException) -> str:
    """Of an error's message, as part of one line."""
    return (str(error) or type(error).__name__).strip().splitlines()[0]
