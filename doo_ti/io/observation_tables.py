"""Tables of rods, CSV or Parquet, a row per vertex: of observations, to and from the keys of the npz format without loss
(docs/observations.md); and of results.

What belongs to a vertex, to the edge from it to the next, or to the observation, :data:`KEYS_IN_TABLES` says. Cells are empty
where a mark is missing, and at the last vertex, where no edge begins; what belongs to an observation is in one of its rows, the
others repeat it or are empty. Vertices count from 0 or 1, rows are in any order; without ``vertex`` they are in order along the
rod, without ``observation`` there is one. Names are known in any case. Other columns are ignored.

Tables of results begin with the axes of the rods, such as moment and rod, in place of ``observation``. Values of an edge are at
the vertex where it begins, those of a rod, or of one of its axes, in all its rows; several numbers are NAME_0, NAME_1, …,
forces and moments NAME_x, NAME_y, NAME_z. Those of ``relax``, ``perceive`` or ``track`` can be read as observations.
"""

from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

import numpy as np

from doo_ti.io.arrays import AXES, LENGTH_ENDINGS, check_unpacked, first_line, frame_columns, given_columns, listed, read_csv
from doo_ti.system.errors import InputError, require

# Key of the npz format: what a value of it belongs to, the shape of the value, the names of its columns.
KEYS_IN_TABLES = {
    "vertices_mm": ("vertex", (3,), tuple(f"{axis}_mm" for axis in AXES)),
    **{key: ("vertex", (), (key,)) for key in ("valid", "sigma_mm")},
    "rest_length_mm": ("edge", (), ("rest_length_mm",)),
    "frames": ("edge", (3, 3), frame_columns("frame")),
    **{key: ("observation", (), (key,)) for key in ("end_distance_mm", "end_rotation_deg", "total_twist_deg")},
    **{key: ("observation", (3, 3), frame_columns(key)) for key in ("start_frame", "end_frame")},
    **{f"{end}_quaternion": ("observation", (4,), tuple(f"{end}_q{part}" for part in "wxyz")) for end in ("start", "end")},
    "up": ("observation", (3,), tuple(f"up_{axis}" for axis in AXES)),
    "spacing_error": ("observation", (), ("spacing_error",)),
}
# Keys that hold one value for all observations.
_SHARED = ("rest_length_mm", "up", "spacing_error")
_POSITION = KEYS_IN_TABLES["vertices_mm"][2]
_COLUMNS = ("observation", "vertex", *(name for _, _, names in KEYS_IN_TABLES.values() for name in names))
LABELS = "observation"  # key of the npz format: what messages call the observations
MOST_ABSENT = 100  # marks of all observations for each row
OTHER_NUMBERS = ("pose", "poses", "configuration", "config", "shape", "frame", "trial", "set", "sample", "rod")
OTHER_MARKS = ("mark", "marker", "point", "node", "index")  # what others call the columns observation and vertex
RENAMED = ("observation", "vertex", *AXES, "valid", "sigma_mm", "rest_length_mm")
"""What a user may say is in a column of another name."""


def read_table(path: Path, content: bytes, renamed: dict[str, str] | None = None) -> dict[str, np.ndarray]:
    """The keys of the npz format from the bytes of a CSV or Parquet file, by the suffix of ``path``; and ``unit``: mm in the
    unit that the columns of positions state.

    renamed  some of :data:`RENAMED`: the column of the file that holds it

    Raises InputError for files that are no table, for missing or repeated rows and columns, and for values that are not
    numbers or differ where they must agree.
    """
    columns, place, unit = (_csv_columns if path.suffix == ".csv" else _parquet_columns)(path, content, renamed or {})
    count = len(columns[_POSITION[0]])
    columns.setdefault("observation", np.zeros(count))
    in_order = "vertex" not in columns
    if in_order:  # how many rows before have the same label
        order = np.argsort(columns["observation"], kind="stable")
        firsts = np.searchsorted(columns["observation"][order], columns["observation"][order])
        columns["vertex"] = np.empty(count)
        columns["vertex"][order] = np.arange(count) - firsts
    rows = {}
    for name in ("observation", "vertex"):
        rows[name] = values = columns[name]
        if values.dtype.kind == "U":
            continue
        bad = np.flatnonzero(~(np.isfinite(values) & (values == np.round(values)) & (np.abs(values) < 2**53)))
        if len(bad):
            raise InputError(path, name, f"{values[bad[0]]:g} in {place(bad[0])} is not a whole number", "give whole numbers")
        rows[name] = values.astype(np.int64)
    labels, row = _rows_of(path, **rows)
    if in_order and (row < 0).any():
        label = labels[(row < 0).any(axis=1)][0]
        raise InputError(path, "vertex", f"missing, and observation {label} has fewer rows than others",
                         "give the column vertex, or a row for every vertex")
    keys = {"unit": unit, LABELS: labels}
    for key, (owner, value_shape, names) in KEYS_IN_TABLES.items():
        if given_columns(path, names, columns):
            values = np.stack([np.where(row < 0, np.nan, columns[name][row]) for name in names], axis=-1)
            if owner == "edge":
                values = values[:, :-1]
            elif owner == "observation":
                values = _agreed(path, key, values, 1, labels)
            keys[key] = values.reshape((*values.shape[:-1], *value_shape))
    for key in _SHARED:
        if key in keys:
            keys[key] = _agreed(path, key, keys[key], 0, labels)
    if "valid" in keys:
        unseen = np.isnan(keys["vertices_mm"]).any(axis=-1) & np.isnan(keys["valid"])
        keys["valid"] = np.where(unseen, 0.0, keys["valid"])
    sigma = keys.get("sigma_mm")
    if sigma is not None and len(np.unique(sigma[~np.isnan(sigma)])) == 1:
        keys["sigma_mm"] = np.nanmax(sigma)
    return keys


def write_table(file: BinaryIO, suffix: str, keys: dict[str, np.ndarray]) -> None:
    """Write the keys of the npz format to ``file`` as CSV or Parquet, by ``suffix``."""
    count, marks = keys["vertices_mm"].shape[:2]
    labels = keys.get(LABELS, np.arange(count))
    if len(np.unique(labels)) < count:
        labels = np.arange(count)
    columns, _ = _of_vertices({key: keys[key] for key in KEYS_IN_TABLES if key in keys}, ("observation",))
    write_columns(file, columns | {"observation": np.repeat(labels, marks)}, suffix)


def _named(path: Path, names, renamed: dict[str, str]) -> dict[str, tuple[str, float]]:
    """Column of the format: (column of the file, factor to its unit), of those that a file with columns ``names`` has."""
    given = {name.lower(): name for name in names} | {name: name for name in names}
    found = {name: (given[name], 1.0) for name in _COLUMNS if name in given}
    for ending, factor in LENGTH_ENDINGS.items():
        own = [f"{axis}{ending}" for axis in AXES]
        if _POSITION[0] not in found and own[0] in given:
            found |= {name: (given[column], factor) for name, column in zip(_POSITION, own, strict=True) if column in given}
    has = f"the file has {listed(names)}"
    for name, column in renamed.items():
        require(column in names, path, column, "the column is missing", has)
        found[f"{name}_mm" if name in AXES else name] = (column, 1.0)
    missing = next((name for name in _POSITION if name not in found), None)
    number = next((given[name] for name in OTHER_NUMBERS if name in given), None)
    if number is not None and "observation" not in found and missing is None:
        mark = next((given[name] for name in OTHER_MARKS if name in given and "vertex" not in found), None)
        raise InputError(path, "observation", f"the column is missing, and {number} seems to number the observations",
                         f"give --columns observation={number}{'' if mark is None else f',vertex={mark}'}")
    require(missing is None, path, missing, "the column is missing",
            f"give the columns observation, vertex, {', '.join(_POSITION)}, or name yours with `columns`; {has}")
    return found


def _csv_columns(path: Path, content: bytes, renamed) -> tuple[dict[str, np.ndarray], Callable[[int], str], float]:
    """The known columns as (N,) f64, NaN where a cell is empty, or texts of names; how a message names a row; and mm in the
    unit of positions."""
    table = read_csv(path, (), content=content)
    named = _named(path, table.columns, renamed)
    names = table.texts(named["observation"][0]) if "observation" in named else None
    columns = {name: factor * table.numbers(column, may_be_empty=True) for name, (column, factor) in named.items()
               if name != "observation" or names is None}
    return (columns if names is None else columns | {"observation": names}, lambda row: f"line {table.lines[row]}",
            named[_POSITION[0]][1])


def _parquet_columns(path: Path, content: bytes, renamed) -> tuple[dict[str, np.ndarray], Callable[[int], str], float]:
    """The same of a Parquet file."""
    import pyarrow
    import pyarrow.parquet

    try:
        file = pyarrow.parquet.ParquetFile(pyarrow.BufferReader(content))
        metadata, names = file.metadata, file.schema_arrow.names
        twice = next((name for name, count in Counter(names).items() if count > 1), None)
        require(twice is None, path, twice, "the column is there twice", "keep one of them")
        require(metadata.num_rows != 0, path, "file", "holds no rows", "write one row per vertex")
        check_unpacked(path, content, max(8 * metadata.num_rows * metadata.num_columns, sum(
            metadata.row_group(group).total_byte_size for group in range(metadata.num_row_groups))))
        named = _named(path, names, renamed)
        table = file.read(list({column for column, _ in named.values()}))
    except (pyarrow.ArrowException, OSError, UnicodeDecodeError) as error:
        raise InputError(path, "file", f"is not a Parquet table ({first_line(error)})", "write one row per vertex") from None
    values = {name: _parquet_values(path, column, table.column(column), name == "observation")
              for name, (column, _) in named.items()}
    return ({name: own if own.dtype.kind == "U" else named[name][1] * own for name, own in values.items()},
            lambda row: f"row {row + 1}", named[_POSITION[0]][1])


def _parquet_values(path: Path, name: str, column, texts: bool) -> np.ndarray:
    """(N,) f64 of a pyarrow column, NaN where it is empty; or its ``texts``, if it may have them and has one in every row."""
    import pyarrow.types as types

    kind = column.type
    if types.is_null(kind):
        return np.full(len(column), np.nan)
    if types.is_string(kind) or types.is_large_string(kind):
        if texts and not column.null_count:
            return np.array(column.to_pylist())
        raise InputError(path, name, f"numbers stored as text, {column[0].as_py()!r} in row 1", "store numbers")
    if not (types.is_integer(kind) or types.is_floating(kind) or types.is_boolean(kind)):
        raise InputError(path, name, f"type {kind} is not numeric", "store numbers")
    return column.cast("int8" if types.is_boolean(kind) else kind).cast("float64", safe=False).to_numpy()


def _rows_of(path, observation: np.ndarray, vertex: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(D,) the labels of the observations, which rise, texts in the order in which they appear; and (D, V) the row of each
    vertex, −1 where it has none."""
    vertex = vertex - (vertex.min() == 1)  # some programs count from one
    labels, first, place = np.unique(observation, return_index=True, return_inverse=True)
    if labels.dtype.kind == "U":
        order = np.argsort(first)
        labels, place = labels[order], np.argsort(order)[place]
    marks = int(vertex.max()) + 1
    if vertex.min() < 0:
        raise InputError(path, "vertex", f"{vertex.min()} of observation {observation[vertex.argmin()]}", "count from 0, or 1")
    if len(labels) * marks > MOST_ABSENT * len(vertex):
        raise InputError(path, "vertex", f"{marks - 1} of observation {observation[vertex.argmax()]}, and {len(vertex)} rows "
                         f"of {len(labels)} observations in all", "number the marks from 0 along the rod, without gap")
    flat, row = place * marks + vertex, np.full(len(labels) * marks, -1)
    row[flat] = np.arange(len(flat))
    twice = np.flatnonzero(row[flat] != np.arange(len(flat)))
    if len(twice):
        raise InputError(path, "vertex", f"{vertex[twice[0]]} of observation {observation[twice[0]]} is there twice",
                         "give each vertex of an observation one row")
    return labels, row.reshape(len(labels), marks)


def _agreed(path, key: str, values: np.ndarray, axis: int, labels: np.ndarray) -> np.ndarray:
    """The value that all rows of an observation share, along axis 1, or all observations, along axis 0; NaN where none has one.
    Raises InputError where they differ."""
    first = np.take_along_axis(values, np.expand_dims(np.argmin(np.isnan(values), axis=axis), axis), axis=axis)
    differs = np.argwhere((values != first) & ~np.isnan(values))
    if len(differs) and axis == 1:
        raise InputError(path, key, f"observation {labels[differs[0][0]]} has another value at vertex {differs[0][1]} than "
                         "before", "repeat the observation's value, or leave the other rows empty")
    if len(differs):
        raise InputError(path, key, f"observation {labels[differs[0][0]]} has another value than those before",
                         "give the same value in all observations of a file")
    return first.take(0, axis=axis)


POSITIONS = ("vertices_mm", "positions_mm")
OWNERS = {"time_s": "first axis", "recording": "first axis", "rest_length_mm": "file", "up": "file", "rate_hz": "file"}
"""Of arrays whose shape alone does not tell; others belong to rods, or to the last axis of the rods."""
OF_EDGES = ("rest_length_mm", "frames", "unsupported")
VECTORS = ("start_force", "start_moment", "end_force", "end_moment", "up")
OF_VERTICES = ("valid", "sigma_mm", *POSITIONS)


def write_rod_table(file: BinaryIO, arrays: dict[str, np.ndarray], axes: tuple[str, ...]) -> list[str]:
    """Write ``arrays`` to ``file``; returns the names of those that have no place in the table.

    axes  names of the leading axes of the positions, such as ("moment", "rod")
    """
    columns, left_out = _of_vertices(arrays, axes)
    write_columns(file, columns)
    return left_out


def _of_vertices(arrays: dict[str, np.ndarray], axes: tuple[str, ...]) -> tuple[dict[str, np.ndarray], list[str]]:
    """The columns of a table with a row for each vertex, and the names of arrays that have no place in it."""
    shape = next(arrays[name] for name in POSITIONS if name in arrays).shape[:-1]  # (*rods, V)
    index = np.indices(shape)
    columns = {name: index[place].ravel() for place, name in enumerate((*axes, "vertex"))}
    left_out = []
    for name, value in arrays.items():
        spread = _per_vertex(name, np.asarray(value), shape)
        if spread is None or spread.ndim > len(shape) + 1 and spread.shape[len(shape) :] != (3, 3):
            left_out.append(name)
            continue
        inner = spread.shape[len(shape) :]
        spread = spread.reshape(index[0].size, -1)
        columns |= {column: spread[:, place] for place, column in enumerate(_names(name, inner))}
    return columns, left_out


def write_columns(file: BinaryIO, columns: dict[str, np.ndarray], suffix: str = ".csv") -> None:
    """Write columns of equal length as CSV or Parquet, by ``suffix``; NaN is an empty cell."""
    import pyarrow
    import pyarrow.csv
    import pyarrow.parquet

    table = pyarrow.table({name: pyarrow.array(values, mask=np.isnan(values) if values.dtype.kind == "f" else None)
                           for name, values in columns.items()})
    (pyarrow.csv.write_csv if suffix == ".csv" else pyarrow.parquet.write_table)(table, file)


def _per_vertex(name: str, value: np.ndarray, shape: tuple[int, ...]) -> np.ndarray | None:
    """(*shape, …) the value of every vertex, or None where ``value`` does not fit."""
    rods, marks = shape[:-1], shape[-1]
    owner = OWNERS.get(name, "rod" if value.shape[: len(rods)] == rods else "last axis")
    if owner == "first axis" and value.shape == rods[:1]:
        value = value.reshape(-1, *[1] * (len(rods) - 1))
    if owner == "last axis" and value.shape not in ((), rods[-1:]):
        return None
    if owner != "rod":
        value = np.broadcast_to(value, (*rods, *value.shape) if owner == "file" else rods)
    inner = value.shape[len(rods) :]
    if name in OF_VERTICES and inner[:1] == (marks,):
        return value
    if name in OF_EDGES:
        last = np.full((*rods, 1, *inner[1:]), np.nan)
        return np.concatenate([value.astype(np.float64), last], axis=len(rods))
    return np.broadcast_to(value.reshape(*rods, 1, *inner), (*shape, *inner))


def _names(name: str, inner: tuple[int, ...]) -> tuple[str, ...]:
    """The columns of an array with ``inner`` numbers for each vertex."""
    if name in POSITIONS:
        return KEYS_IN_TABLES["vertices_mm"][2]
    if name in KEYS_IN_TABLES:
        return KEYS_IN_TABLES[name][2]
    if inner == (3, 3):
        return frame_columns(name)
    return (name,) if not inner else tuple(f"{name}_{end}" for end in (AXES if name in VECTORS else range(*inner)))
