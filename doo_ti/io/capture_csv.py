"""Motion capture as CSV: the trajectories of markers, from OptiTrack Motive and Vicon Nexus.

Both put three columns X, Y, Z for each marker below a few lines of header; a cell is empty where the marker was not seen.

Motive ("Export tracking data"):  line 1 is ``Format Version,…,Export Frame Rate,120,…,Length Units,Meters,…``; rows ``Type``,
``Name``, ``ID`` and ``Position`` describe the columns. Markers of rigid bodies and unlabelled ones are left out unless they
are named. Motive's y axis points up.

Nexus ("Trajectories"):  a line ``Trajectories``, the rate, names ``Subject:Marker``, ``Frame,Sub Frame,X,Y,Z,…``, units, and
rows up to an empty line. z points up.

Axes: T frames, V markers, in the order of the columns or of the names that the user gives.
"""

from pathlib import Path

import numpy as np

from doo_ti.io.csv_table import csv_rows, number_in
from doo_ti.io.curves import Curves, chosen_names
from doo_ti.rod.physical_units import UNITS_IN_MM
from doo_ti.system.errors import InputError

MOTIVE_UNITS = {"meters": "m", "centimeters": "cm", "millimeters": "mm"}
REMEDY = "export the markers' trajectories as CSV again"


def is_motive(content: bytes) -> bool:
    """Whether these bytes begin a CSV file of OptiTrack Motive."""
    return content[:200].lstrip(b"\xef\xbb\xbf").startswith(b"Format Version")


def is_nexus(content: bytes) -> bool:
    """Whether these bytes are a CSV file of Vicon Nexus: one line says only ``Trajectories``."""
    lines = content[: 1 << 16].lstrip(b"\xef\xbb\xbf").splitlines()
    return any(line.strip(b' ,;\t"') == b"Trajectories" for line in lines)


def read_motive(path: Path, content: bytes, names: list[str] | None = None) -> Curves:
    """The markers of a Motive file. Raises InputError for files without markers, and for names that they do not have."""
    rows, decimal = csv_rows(path, content, REMEDY)
    about = dict(zip(rows[0][1][::2], rows[0][1][1::2], strict=False))
    unit = _unit(path, "Length Units", MOTIVE_UNITS, about.get("Length Units", "Meters").strip().lower())
    rate = _number(path, decimal, 1, about.get("Export Frame Rate") or about.get("Capture Frame Rate") or "")
    header = next((row for row, (_, cells) in enumerate(rows) if cells and cells[0].strip() == "Frame"), None)
    if header is None:
        raise InputError(path, "Frame", "no row begins with it", REMEDY)
    above = {cells[1].strip(): cells for _, cells in rows[1:header] if len(cells) > 1}
    if "Name" not in above:
        raise InputError(path, "Name", "no row names the markers", REMEDY)
    kinds = rows[header - 1][1]
    columns: dict[str, list[int]] = {}
    for column in range(2, len(rows[header][1])):
        kind, axis = _cell(kinds, column), _cell(rows[header][1], column)
        name, what = _cell(above["Name"], column), _cell(above.get("Type", []), column) or "Marker"
        ours = name in names if names is not None else what == "Marker" and not name.startswith("Unlabeled")
        if kind in ("Position", "") and axis in ("X", "Y", "Z") and ours:
            columns.setdefault(name, []).append(column)
    points, labels = _points(path, decimal, rows[header + 1 :], columns, names)
    return Curves(points, unit, (0.0, 1.0, 0.0), rate, labels=labels)


def read_nexus(path: Path, content: bytes, names: list[str] | None = None) -> Curves:
    """The markers of a Nexus file. Raises InputError for files without markers, and for names that they do not have. A name may
    leave out the subject."""
    rows, decimal = csv_rows(path, content, REMEDY)
    begin = next((row for row, (_, cells) in enumerate(rows) if cells and cells[0].strip() == "Trajectories"), len(rows))
    if len(rows) < begin + 6:
        raise InputError(path, "Trajectories", "no rows below it", REMEDY)
    rate = _number(path, decimal, rows[begin + 1][0], _cell(rows[begin + 1][1], 0))
    labels, units = rows[begin + 2][1], rows[begin + 4][1]
    columns: dict[str, list[int]] = {}
    for column in range(2, len(labels)):
        if name := _cell(labels, column):
            short = name.partition(":")[2] or name
            columns.setdefault(short if names is not None and name not in names else name, []).extend(range(column, column + 3))
    rest = rows[begin + 5 :]
    end = next((row for row, (_, cells) in enumerate(rest) if not any(map(str.strip, cells))), len(rest))
    unit = _unit(path, "Trajectories", {name: name for name in UNITS_IN_MM}, _cell(units, 2) or "mm")
    points, labels = _points(path, decimal, rest[:end], columns, names)
    return Curves(points, unit, rate=rate, labels=labels)


def _points(path: Path, decimal: str, rows: list, columns: dict[str, list[int]],
            names: list[str] | None) -> tuple[np.ndarray, np.ndarray | None]:
    """(T, V, 3) the positions of the markers in ``columns``, all or those of the ``names``, NaN where a marker was not seen;
    and (T,) the numbers of the frames, None where they are not whole numbers that rise."""
    order = chosen_names(path, "Name", list(columns), names)
    if len(order) < 3:
        raise InputError(path, "Name", f"{len(order)} markers", "name three or more along the rod, in their order")
    short = next((name for name in order if len(columns[name]) != 3), None)
    if short is not None:
        raise InputError(path, short, f"{len(columns[short])} columns of a position", "give markers of different names")
    chosen = [column for name in order for column in columns[name]]
    frames = [(line, cells) for line, cells in rows if any(map(str.strip, cells))]
    points = np.array([[_number(path, decimal, line, _cell(cells, column)) for column in chosen] for line, cells in frames])
    texts = [_cell(cells, 0) for _, cells in frames]
    labels = np.array(texts, dtype=np.int64) if all(text.isdecimal() and len(text) < 16 for text in texts) else None
    if not len(points):
        raise InputError(path, "Frame", "no frames", REMEDY)
    return points.reshape(len(points), -1, 3), labels if labels is not None and (np.diff(labels) > 0).all() else None


def _unit(path: Path, field: str, known: dict[str, str], name: str) -> float:
    """mm in the unit that the file calls ``name``."""
    if name not in known:
        raise InputError(path, field, f"{name[:40]!r} is not a known unit of length", f"export in one of {', '.join(known)}")
    return UNITS_IN_MM[known[name]]


def _cell(cells: list[str], column: int) -> str:
    return cells[column].strip() if column < len(cells) else ""


def _number(path: Path, decimal: str, line: int, cell: str) -> float:
    """The number in a cell, NaN where it is empty."""
    value = number_in(cell or "nan", decimal)
    if np.isinf(value):
        raise InputError(path, f"line {line}", f"{cell!r} is not a finite number", REMEDY)
    return value
