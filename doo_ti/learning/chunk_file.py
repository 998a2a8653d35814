"""The file of a chunk of cells: rows as Parquet, one per cell and observation, or pair.

Pages carry checksums, and the file's metadata say which sweep it belongs to and who made it.
"""

import json
from pathlib import Path

import numpy as np

from doo_ti.errors import InputError
from doo_ti.io.files import write_whole
from doo_ti.learning.maker import maker
from doo_ti.types import LARGEST, Status

IDENTITY, MAKER = "doo_ti_sweep", "doo_ti_maker"
"""Keys of a file's metadata."""
REMEDY = "delete it and run the sweep again"
MOST_ROWS = 1 << 31

# What a column holds: NumPy's letters for its kind, and whether each value can be one of it.
_SOUND = {
    "distance_mm": ("f", lambda x: np.isnan(x) | ((x >= 0) & (x <= LARGEST))),
    "start_distance_mm": ("f", lambda x: np.isnan(x) | ((x >= 0) & (x <= LARGEST))),
    "status": ("iu", lambda x: np.isin(x, list(Status))),
    "stable": ("b", lambda x: x | True),
    "jumps": ("iu", lambda x: x >= 0),
    "pair_weight": ("f", lambda x: (x > 0) & (x <= LARGEST)),
    "observation": ("iu", lambda x: (x >= 0) & (x < MOST_ROWS)),
    "from_observation": ("iu", lambda x: (x >= 0) & (x < MOST_ROWS)),
    "end_distance_mm": ("f", lambda x: ~np.isinf(x)),
    "end_rotation_deg": ("f", lambda x: ~np.isinf(x)),
}


def chunk_path(run: Path, part: str, first: int, last: int) -> Path:
    """The file of the cells ``first`` to ``last`` in the folder's ``part``, "cells" or "hypotheses"."""
    return run / part / f"{first:09d}-{last:09d}.parquet"


def write_chunk(path: Path, columns: dict, material: str, identity: str) -> None:
    """Write the rows of a chunk of the sweep ``identity``, whole or not at all."""
    import pyarrow

    count = len(columns["observation"])
    names = pyarrow.DictionaryArray.from_arrays(np.zeros(count, dtype=np.int8), [material])
    write_rows(path, pyarrow.table({**columns, "material": names}, metadata={IDENTITY: identity, MAKER: json.dumps(maker())}))


def write_rows(path: Path, table) -> None:
    """Write a pyarrow table of a chunk's rows, its metadata with it."""
    import pyarrow.parquet

    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, lambda file: pyarrow.parquet.write_table(table, file, write_page_checksum=True))


def column_names(path: Path) -> set[str]:
    """The columns of a chunk. Raises InputError where it cannot be read."""
    return set(_schema(path).names)


def check_identity(paths: list[Path], identity: str | None) -> None:
    """Raise InputError where a chunk belongs to another sweep than ``identity``, or than the others.

    identity  None where the run does not say; chunks of older runs do not either
    """
    found = [_identity(path) for path in paths]
    wanted = identity if any(found) else None
    for path, own in zip(paths, found, strict=True):
        if own != (wanted or found[0]):
            raise InputError(path, "cells", "belongs to another sweep", REMEDY)


def _identity(path: Path) -> str | None:
    """Which sweep a chunk's metadata name."""
    return (_schema(path).metadata or {}).get(IDENTITY.encode(), b"").decode(errors="replace") or None


def _schema(path: Path):
    import pyarrow
    import pyarrow.parquet

    try:
        return pyarrow.parquet.read_schema(_file(path))
    except (pyarrow.ArrowException, OSError) as error:
        raise _unreadable(path, error) from None


def read_rows(path: Path, names: list[str] | None = None):
    """The rows of a chunk as a pyarrow table, or their columns ``names``. Raises InputError where they cannot be read."""
    import pyarrow
    import pyarrow.parquet

    try:
        table = pyarrow.parquet.read_table(_file(path), columns=names, page_checksum_verification=True)
    except (pyarrow.ArrowException, OSError) as error:
        raise _unreadable(path, error) from None
    for name in names or ():
        if name not in table.column_names:
            raise InputError(path, name, "the column is missing", REMEDY)
    return table


def read_columns(path: Path, names: list[str]) -> dict[str, np.ndarray]:
    """The columns ``names`` of a chunk. Raises InputError where they cannot be read, and for what no sweep can have found."""
    table = read_rows(path, names)
    columns = {}
    for name in names:
        column = table.column(name)
        if column.null_count:
            raise InputError(path, name, "a value is missing", REMEDY)
        values = columns[name] = column.to_numpy()
        kinds, is_sound = _SOUND.get(name, ("f", np.isfinite))
        if values.dtype.kind not in kinds:
            raise InputError(path, name, f"type {column.type}", REMEDY)
        wrong = np.flatnonzero(~is_sound(values))
        if len(wrong):
            raise InputError(path, name, f"{values[wrong[0]]} in row {wrong[0]}", REMEDY)
    return columns


def _file(path: Path) -> Path:
    """``path``. Raises InputError for what is there and no file, such as a pipe, which would be waited for."""
    if path.exists() and not path.is_file():
        raise InputError(path, "cells", "a folder, a device or a pipe, no file", REMEDY)
    return path


def _unreadable(path: Path, error: Exception) -> InputError:
    reason = (str(error) or type(error).__name__).splitlines()[0]
    return InputError(path, "cells", f"cannot be read ({reason})", REMEDY)
