"""The formats of files of observations: by suffix, and of CSV files by their first lines, to the keys of the npz format.

    .npz              keys of observations (docs/observations.md)
    .csv, .parquet    a row for each vertex; .csv also motion capture and plain polylines
    .txt, .xyz        plain polylines
    .xml              cables of MuJoCo models
    .usd, .usda, .usdc  curves of USD scenes
"""

import os
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from doo_ti.io.arrays import read_npz
from doo_ti.io.capture_csv import is_motive, is_nexus, read_motive, read_nexus
from doo_ti.io.curves import Curves
from doo_ti.io.mujoco_xml import read_mujoco
from doo_ti.io.observation_tables import KEYS_IN_TABLES, LABELS, RENAMED, read_table
from doo_ti.io.polyline_text import is_polyline, read_polylines
from doo_ti.io.usd import read_usd
from doo_ti.system.errors import InputError
from doo_ti.system.files import MOST_BYTES, MOST_TEXT_BYTES, read_content

TABLES = (".csv", ".parquet")
OWN = (".npz", *TABLES)
"""Suffixes of files that the package also writes."""
OF_OTHERS = {".txt": read_polylines, ".xyz": read_polylines, ".xml": read_mujoco,
             ".usd": read_usd, ".usda": read_usd, ".usdc": read_usd}
MOST_CSV_BYTES = 1 << 28
"""Reading CSV takes about fifteen times as much memory."""


def checked_suffix(path: Path, known: tuple[str, ...] = OWN) -> None:
    """Raise InputError unless the suffix of ``path`` is ``known``."""
    if path.suffix not in known:
        raise InputError(path, "file", f"suffix {path.suffix!r} is not a format of observations",
                         f"use one of {', '.join(known)}")


def read_keys(path: Path, columns=None) -> tuple[bytes, dict[str, np.ndarray]]:
    """The bytes of a file, and its keys of the npz format. ``unit`` among them: mm in the unit that the file states.

    columns  as in :func:`doo_ti.io.observation_files.load_observations`

    Raises InputError for files that cannot be read, and for ``columns`` that do not fit the format.
    """
    content, read = _opened(path)
    if read is not None:
        curves = read(path, content, _names(path, columns))
        return content, curves.keys() | {"unit": curves.unit}
    if path.suffix == ".npz":
        if columns is not None:
            raise InputError(path, "columns", "an npz has keys", "leave `columns` out")
        return content, read_npz(path, content, (*KEYS_IN_TABLES, LABELS))
    return content, read_table(path, content, _renamed(path, columns))


def read_curves(path: Path, columns=None) -> Curves | None:
    """The curves of a file of another program, or None of a file in a format of this package. Raises as :func:`read_keys`."""
    content, read = _opened(path)
    return None if read is None else read(path, content, _names(path, columns))


def _opened(path: Path) -> tuple[bytes, Callable[..., Curves] | None]:
    """The bytes of a file, and the reader of curves for it; None where it is in a format of this package."""
    if os.path.isfile(path):  # else the reason is that it is missing, or a folder
        checked_suffix(path, (*OWN, *OF_OTHERS))
    most = MOST_CSV_BYTES if path.suffix == ".csv" else MOST_TEXT_BYTES if path.suffix in OF_OTHERS else MOST_BYTES
    content = read_content(path, most)
    if not content:
        raise InputError(path, "file", "0 bytes, the file is empty", "write the observations again")
    if path.suffix != ".csv":
        return content, OF_OTHERS.get(path.suffix)
    readers = ((is_motive, read_motive), (is_nexus, read_nexus), (is_polyline, read_polylines))
    return content, next((read for fits, read in readers if fits(content)), None)


def _names(path: Path, columns) -> list[str] | None:
    if isinstance(columns, Mapping):
        raise InputError(path, "columns", "the file is not a table of vertices",
                         "name its markers or curves in their order along the rod: A,B,C")
    return None if columns is None else list(columns)


def _renamed(path: Path, columns) -> dict[str, str]:
    if columns is None:
        return {}
    unknown = [name for name in columns if name not in RENAMED]
    if unknown or not isinstance(columns, Mapping):
        raise InputError(path, "columns", f"{','.join(unknown or columns)!r}",
                         f"give NAME=COLUMN for some of {', '.join(RENAMED)}")
    return dict(columns)
