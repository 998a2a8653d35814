"""Files of observations to and from the keys of the npz format: npz itself, and tables, CSV or Parquet, losslessly.

A table has one row per vertex:

    observation, vertex        whole numbers, vertices 0 … E of each observation once, rows in any order
    x_mm, y_mm, z_mm           the vertex; empty where it is missing
    valid, sigma_mm            of the vertex
    rest_length_mm, frame_*    of the edge from this vertex to the next, empty at vertex E
    end_distance_mm, end_rotation_deg, total_twist_deg, start_frame_*, end_frame_*
                               of the observation: at its vertex 0, the other rows repeat it or are empty
    up_x, up_y, up_z           of the file

The nine columns of a frame end in t_x, t_y, t_z, m1_x, …, m2_z. All but the first five are optional; other columns
are ignored.
"""

import io
import zipfile
import zlib
from difflib import get_close_matches
from pathlib import Path
from tokenize import TokenError
from typing import BinaryIO

import numpy as np

from doo_ti.errors import InputError

_XYZ = ("x", "y", "z")
_FRAME = tuple(f"{director}_{axis}" for axis in _XYZ for director in ("t", "m1", "m2"))
# Key of the npz format: what a value of it belongs to, the shape of the value, the names of its columns.
_COLUMNS = {
    "vertices_mm": ("vertex", (3,), tuple(f"{axis}_mm" for axis in _XYZ)),
    "valid": ("vertex", (), ("valid",)),
    "sigma_mm": ("vertex", (), ("sigma_mm",)),
    "rest_length_mm": ("edge", (), ("rest_length_mm",)),
    "frames": ("edge", (3, 3), tuple(f"frame_{part}" for part in _FRAME)),
    "end_distance_mm": ("observation", (), ("end_distance_mm",)),
    "end_rotation_deg": ("observation", (), ("end_rotation_deg",)),
    "total_twist_deg": ("observation", (), ("total_twist_deg",)),
    "start_frame": ("observation", (3, 3), tuple(f"start_frame_{part}" for part in _FRAME)),
    "end_frame": ("observation", (3, 3), tuple(f"end_frame_{part}" for part in _FRAME)),
    "up": ("observation", (3,), tuple(f"up_{axis}" for axis in _XYZ)),
}
# Keys that hold one value for all observations.
_SHARED = ("rest_length_mm", "up")
# What reading a damaged npz may raise.
_UNREADABLE = (ValueError, OSError, EOFError, KeyError, RuntimeError, MemoryError, OverflowError, SyntaxError,
               TypeError, TokenError, zipfile.BadZipFile, zlib.error)

MOST_UNPACKED_BYTES = 1 << 30
"""Of the arrays or columns of a file."""
NEARLY = 0.88
"""Letters that two keys share, over those of both, from which on one is taken for a slip of the other."""


def read_npz(path: Path, content: bytes, known=tuple(_COLUMNS)) -> dict[str, np.ndarray]:
    """The arrays of the ``known`` keys from the bytes of an npz file, never unpickled; ``path`` names it in errors.

    Raises InputError for whatever is no npz of plain arrays, and for a key that is nearly one of those not there.
    """
    remedy = "write it with numpy.savez from plain numeric arrays"
    try:
        archive = np.load(io.BytesIO(content), allow_pickle=False)
    except _UNREADABLE as error:
        kind = "truncated" if content[:2] == b"PK" else "pickled" if content[:1] == b"\x80" else "not an npz"
        raise InputError(path, "file", f"{kind} file ({_first_line(error)})", remedy) from None
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
                # Files may hold more than is known here, but what is nearly known is a slip.
                if alike := get_close_matches(key, set(archive.files) - set(known), 1, NEARLY):
                    raise InputError(path, alike[0], "unknown key", f"name it {key}, or otherwise if it is something else")
                continue
            try:
                value = archive[key]
            except _UNREADABLE as error:
                raise InputError(path, key, f"cannot be read ({_first_line(error)})", remedy) from None
            if not isinstance(value, np.ndarray):
                raise InputError(path, key, "is not an array", remedy)
            keys[key] = value
    return keys


def read_table(path, content: bytes) -> dict[str, np.ndarray]:
    """The keys of the npz format from the bytes of a CSV or Parquet file; ``path`` tells which.

    Raises InputError for what is no table, for missing or repeated rows and columns, and for values that are not
    numbers or differ where they must agree.
    """
    table = _parse(path, content)
    names = table.column_names
    for name in ("observation", "vertex", *_COLUMNS["vertices_mm"][2]):
        if name not in names:
            raise InputError(path, name, "the column is missing", "give observation, vertex, x_mm, y_mm, z_mm")
    order, shape = _row_order(path, _whole(path, table, "observation"), _whole(path, table, "vertex"))
    keys = {}
    for key, (owner, value_shape, columns) in _COLUMNS.items():
        present = [name for name in columns if name in names]
        if not present:
            continue
        if len(present) < len(columns):
            missing = next(name for name in columns if name not in names)
            raise InputError(path, missing, f"the column is missing beside {present[0]}", f"give {', '.join(columns)}")
        values = np.stack([_numbers(path, table, name)[order].reshape(shape) for name in columns], axis=-1)
        keys[key] = _of_owner(path, key, owner, values).reshape((*_lead(owner, shape), *value_shape))
    for key in _SHARED:
        if key in keys:
            keys[key] = _agreed(path, key, keys[key])
    sigma = keys.get("sigma_mm")
    if sigma is not None and np.isfinite(sigma).all() and np.ptp(sigma) == 0:
        keys["sigma_mm"] = sigma.flat[0]
    return keys


def write_table(file: BinaryIO, suffix: str, keys: dict[str, np.ndarray]) -> None:
    """Write the keys of the npz format to ``file`` as CSV or Parquet, by ``suffix``."""
    import pyarrow
    import pyarrow.csv
    import pyarrow.parquet

    count, marks = keys["vertices_mm"].shape[:2]
    columns = {"observation": np.repeat(np.arange(count), marks), "vertex": np.tile(np.arange(marks), count)}
    for key, (owner, value_shape, names) in _COLUMNS.items():
        if key not in keys:
            continue
        lead = _lead(owner, (count, marks))
        value = np.broadcast_to(keys[key], (*lead, *value_shape)).reshape(*lead, len(names))
        if owner == "observation":
            value = np.repeat(value[:, None], marks, axis=1)
        elif owner == "edge":
            value = np.concatenate([value, np.full_like(value[:, :1], np.nan)], axis=1)
        for place, name in enumerate(names):
            columns[name] = value[..., place].ravel()
    table = pyarrow.table({
        name: pyarrow.array(values, mask=np.isnan(values) if values.dtype.kind == "f" else None)
        for name, values in columns.items()
    })
    (pyarrow.csv.write_csv if suffix == ".csv" else pyarrow.parquet.write_table)(table, file)


def _parse(path, content: bytes):
    """The bytes as a pyarrow table."""
    import pyarrow
    import pyarrow.csv
    import pyarrow.parquet

    kind = "CSV" if path.suffix == ".csv" else "Parquet"
    reader = pyarrow.csv.read_csv if kind == "CSV" else pyarrow.parquet.read_table
    try:
        if kind == "Parquet":
            _check_unpacked(path, pyarrow.parquet.read_metadata(pyarrow.BufferReader(content)))
        table = reader(pyarrow.BufferReader(content))
        names = table.column_names
    except (pyarrow.ArrowException, OSError, UnicodeDecodeError) as error:
        raise InputError(path, "file", f"is not a {kind} table ({_first_line(error)})",
                         "write one row per vertex under a header") from None
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise InputError(path, twice, "the column is there twice", "keep one of them")
    if table.num_rows == 0:
        raise InputError(path, "file", "holds no rows", "write one row per vertex")
    return table


def _check_unpacked(path, metadata) -> None:
    """Raise InputError where the columns of a Parquet file are large, however small they are packed."""
    large = max(8 * metadata.num_rows * metadata.num_columns,
                sum(metadata.row_group(group).total_byte_size for group in range(metadata.num_row_groups)))
    if large > MOST_UNPACKED_BYTES:
        raise InputError(path, "file", f"unpacks to {large:,} bytes", f"give columns of at most {MOST_UNPACKED_BYTES:,}")


def _numbers(path, table, name: str) -> np.ndarray:
    """A column in f64, NaN where it is empty."""
    import pyarrow.types as types

    column = table.column(name)
    kind = column.type
    if types.is_string(kind) or types.is_large_string(kind):
        row, text = next(((row, text) for row, text in enumerate(column.to_pylist()) if not _is_number(text)), (0, None))
        if text is None:
            raise InputError(path, name, f"numbers stored as text, {column[0].as_py()!r} in row 1", "store them as numbers")
        raise InputError(path, name, f"{text!r} in row {row + 1} is not a number", "give numbers, or leave it empty")
    if not (types.is_integer(kind) or types.is_floating(kind) or types.is_boolean(kind) or types.is_null(kind)):
        raise InputError(path, name, f"type {kind} is not numeric", "give numbers")
    if types.is_null(kind):
        return np.full(table.num_rows, np.nan)
    return column.cast("int8" if types.is_boolean(kind) else kind).cast("float64", safe=False).to_numpy()


def _is_number(text: str | None) -> bool:
    try:
        float(text or "nan")
    except ValueError:
        return False
    return True


def _whole(path, table, name: str) -> np.ndarray:
    values = _numbers(path, table, name)
    bad = np.flatnonzero(~(np.isfinite(values) & (values == np.round(values)) & (np.abs(values) < 2**53)))
    if len(bad):
        row = int(bad[0])
        raise InputError(path, name, f"{values[row]:g} in row {row + 1} is not a whole number", "give whole numbers")
    return values.astype(np.int64)


def _row_order(path, observation: np.ndarray, vertex: np.ndarray) -> tuple[np.ndarray, tuple[int, int]]:
    """The rows sorted by observation, then vertex, and (D, V)."""
    order = np.lexsort((vertex, observation))
    labels, count = np.unique(observation, return_counts=True)
    marks = int(vertex.max()) + 1
    expected = np.arange(len(order)) - np.repeat(np.cumsum(count) - count, count)
    wrong = np.flatnonzero(vertex[order] != expected)
    if len(wrong) or (count != marks).any():
        label = observation[order][wrong[0]] if len(wrong) else labels[np.argmax(count != marks)]
        raise InputError(path, "vertex", f"observation {label} has other rows than vertices 0 to {marks - 1} once each",
                         "give one row per vertex, with empty coordinates and valid = 0 where the mark is missing")
    return order, (len(labels), marks)


def _lead(owner: str, shape: tuple[int, int]) -> tuple[int, ...]:
    """The leading axes of what belongs to a vertex, an edge or an observation."""
    count, marks = shape
    return {"vertex": (count, marks), "edge": (count, marks - 1), "observation": (count,)}[owner]


def _of_owner(path, key: str, owner: str, values: np.ndarray) -> np.ndarray:
    """(D, V, n) cells of the table to the values of the owners, each kept once."""
    if owner == "vertex":
        return values
    if owner == "edge":
        return values[:, :-1]
    first = values[:, :1]
    differs = np.argwhere((values != first) & ~np.isnan(values))
    if len(differs):
        d, v, _ = differs[0]
        raise InputError(path, key, f"observation number {d} has another value at vertex {v} than at vertex 0",
                         "repeat the observation's value, or leave the other rows empty")
    return first[:, 0]


def _agreed(path, key: str, values: np.ndarray) -> np.ndarray:
    """The value that all observations share."""
    differs = np.flatnonzero((values != values[0]).reshape(len(values), -1).any(axis=1) & ~np.isnan(values).all())
    if len(differs):
        raise InputError(path, key, f"observation number {differs[0]} has another value than observation 0",
                         "give the same value in all observations of a file")
    return values[0]


def _first_line(error: BaseException) -> str:
    return (str(error) or type(error).__name__).strip().splitlines()[0]
