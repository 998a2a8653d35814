"""Files of named arrays: npz, one array per key, or CSV, one row per entry of the first axis.

The caller states which keys are known, the shape of an entry, and the columns that hold it in a CSV file:

    {"end_position_mm": ((3,), ("end_x_mm", "end_y_mm", "end_z_mm"))}
"""

import io
import math
import zipfile
import zlib
from difflib import get_close_matches
from pathlib import Path
from tokenize import TokenError

import numpy as np

from doo_ti.io.csv_table import read_csv
from doo_ti.rod.types import LARGEST
from doo_ti.system.errors import InputError
from doo_ti.system.files import read_content

AXES = ("x", "y", "z")
MOST_UNPACKED_BYTES = 1 << 30
"""Of the arrays or columns of a file."""
MOST_UNPACKED_RATIO = 1100
"""Of these bytes to those of the file: what NumPy compresses shrinks to a thousandth at best."""
NEARLY = 0.88
"""Least similarity of two keys (difflib) at which one counts as a misspelling of the other."""
# What reading a damaged npz may raise.
_UNREADABLE = (ValueError, OSError, EOFError, KeyError, RuntimeError, MemoryError, OverflowError, SyntaxError,
               TypeError, TokenError, zipfile.BadZipFile, zlib.error)


def frame_columns(name: str) -> tuple[str, ...]:
    """Of a frame with the columns t, m1, m2, row by row: ``NAME_t_x``, ``NAME_m1_x``, …"""
    return tuple(f"{name}_{director}_{axis}" for axis in AXES for director in ("t", "m1", "m2"))


def read_npz(path: Path, content: bytes, known: tuple[str, ...]) -> dict[str, np.ndarray]:
    """The arrays of the ``known`` keys from the bytes of an npz file, never unpickled; ``path`` names it in messages.

    Raises InputError for whatever is not an npz of plain arrays, and for a misspelt key.
    """
    remedy = "write it with numpy.savez from plain numeric arrays"
    if content[:6] == b"\x93NUMPY":
        raise InputError(path, "file", "holds one bare array, not named ones", remedy)
    try:
        archive = zipfile.ZipFile(io.BytesIO(content))
    except _UNREADABLE as error:
        kind = "truncated" if content[:2] == b"PK" else "pickled" if content[:1] == b"\x80" else "not an npz"
        raise InputError(path, "file", f"{kind} file ({first_line(error)})", remedy) from None
    keys = {}
    with archive:
        entries = [(entry.filename.removesuffix(".npy"), entry) for entry in archive.infolist()]
        members = dict(entries)
        if len(members) < len(entries):
            name, _ = next(entry for entry in entries if members[entry[0]] is not entry[1])
            raise InputError(path, name, "the key is there twice", remedy)
        check_unpacked(path, content, sum(entry.file_size for name, entry in entries if name in known))
        for key in known:
            if key not in members:
                # Files may hold unknown keys, but one that is nearly a known key is a mistake.
                if alike := get_close_matches(key, members.keys() - set(known), 1, NEARLY):
                    raise InputError(path, alike[0], "unknown key", f"name it {key}, or otherwise if it is something else")
                continue
            try:
                keys[key] = _member(archive, members[key])
            except _UNREADABLE as error:
                raise InputError(path, key, f"cannot be read ({first_line(error)})", remedy) from None
    return keys


def _member(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> np.ndarray:
    """An array of an npz. Raises an error unless it is as long as its header says, before there is an array of that size."""
    if entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise ValueError("compressed as NumPy does not")
    with archive.open(entry) as file:
        version = np.lib.format.read_magic(file)
        read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, _, dtype = read_header(file)
        size = entry.file_size - file.tell()
        if not dtype.itemsize or not dtype.hasobject and math.prod(shape) * dtype.itemsize != size:
            raise ValueError(f"{size} bytes for shape {str(shape)[:80]} of {dtype}")
        file.seek(0)
        return np.lib.format.read_array(file, allow_pickle=False)


def check_unpacked(path: Path, content: bytes, size: int) -> None:
    """Raise InputError where the bytes of a file unpack to a size that is too large, or that no data of its size unpack to."""
    most = min(MOST_UNPACKED_BYTES, MOST_UNPACKED_RATIO * len(content))
    if size > most:
        raise InputError(path, "file", f"unpacks to {size:,} bytes", f"give arrays of at most {most:,}")


def read_arrays(path: Path, known: dict[str, tuple[tuple[int, ...], tuple[str, ...]]]) -> dict[str, np.ndarray]:
    """The arrays of a file, those of a CSV file (N, \\*shape), as float64.

    Raises InputError for files that cannot be read, unknown columns, entries that are not finite numbers, and where none of
    the known keys is there.
    """
    path = Path(path)
    if path.suffix not in (".npz", ".csv"):
        raise InputError(path, "file", f"suffix {path.suffix!r}", "name a .npz or .csv file")
    arrays = read_npz(path, read_content(path), tuple(known)) if path.suffix == ".npz" else _from_table(path, known)
    if not arrays:
        raise InputError(path, "file", "has none of the known keys", f"give some of {', '.join(known)}")
    return checked_arrays(path, arrays)


def checked_arrays(path: Path, arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """``arrays``, changed to float64. Raises InputError for those that are not finite numbers."""
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
