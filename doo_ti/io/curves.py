"""Curves from tables of other programs, and what a user may say about such files; MuJoCo's and USD: :mod:`doo_ti.io.foreign`.

**Plain polylines**: numbers between commas, spaces, tabs or semicolons; also with decimals behind a comma, where something else
separates them. Three numbers in a line are a point, an empty line begins the next curve; more, three for each point, are a
whole curve in a line.

**Motion capture** as CSV, from OptiTrack Motive and Vicon Nexus: three columns X, Y, Z for each marker below a few lines of
header; a cell is empty where the marker was not seen. Motive ("Export tracking data"): line 1 is ``Format Version,…,Export
Frame Rate,120,…,Length Units,Meters,…``; rows ``Type``, ``Name``, ``ID`` and ``Position`` describe the columns; markers of
rigid bodies and unlabelled ones are left out unless they are named; y points up. Nexus ("Trajectories"): a line
``Trajectories``, the rate, names ``Subject:Marker``, ``Frame,Sub Frame,X,Y,Z,…``, units, and rows up to an empty line; z points
up.

Axes: D curves, or T frames of one; V points or markers, in the order of the file or of the names that the user gives.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from doo_ti.io.arrays import csv_rows, decoded, listed, number_in
from doo_ti.rod.material import UNITS_IN_MM
from doo_ti.rod.types import LARGEST
from doo_ti.system.errors import InputError, require


@dataclass(frozen=True)
class Curves:
    """D curves of V points.

    points  (D, V, 3) in ``unit``; NaN where a marker was not seen
    unit    mm in one unit of length, as the file states it
    up      (3,) direction against gravity in the coordinates of the file
    rate    frames per second, where the curves are the frames of one recording, else None
    labels  (D,) whole numbers that the file gives the curves, or None
    """

    points: np.ndarray
    unit: float = 1.0
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)
    rate: float | None = None
    labels: np.ndarray | None = None

    def keys(self) -> dict[str, np.ndarray]:
        """The keys of the npz format; frames in which fewer than two points were seen are left out."""
        seen = np.isfinite(self.points).all(axis=-1)
        kept = seen.sum(axis=1) >= 2
        keys = {"vertices_mm": self.points[kept] * self.unit, "up": np.array(self.up)}
        if self.labels is not None:
            keys["observation"] = self.labels[kept]
        return keys if seen[kept].all() else keys | {"valid": seen[kept]}


def chosen_names(path, field: str, found: list[str], wanted: list[str] | None) -> list[str]:
    """The names of markers or curves to read, in the order ``wanted``, where that is given. Raises InputError for one that the
    file does not have."""
    if wanted is None:
        return found
    missing = next((name for name in wanted if name not in found), None)
    require(missing is None, path, field, f"{missing!r} is not in the file", f"give some of {listed(found)}")
    return wanted


def stacked(path, curves: Sequence[np.ndarray]) -> np.ndarray:
    """(D, V, 3) the points of D curves (V, 3). Raises InputError for curves of different sizes, fewer than three points, and
    points that are not finite or beyond bounds."""
    sizes = [len(points) for points in curves]
    require(len(set(sizes)) == 1, path, "points", f"curves of {min(sizes)} to {max(sizes)} points",
            "give curves of equally many")
    require(sizes[0] >= 3, path, "points", f"{sizes[0]} points in a curve", "give three or more")
    points = np.stack(curves)
    require((np.abs(points) <= LARGEST).all(), path, "points", "not finite", "give finite numbers")
    return points


FORM = "give lines of X Y Z, with an empty line between curves, or all numbers of a curve in one line"

_DECIMAL = re.compile(r"[-+]?\d+(?:,\d+)?(?:[eE][-+]?\d+)?")  # a number with decimals behind a comma, or a whole one


def is_polyline(content: bytes) -> bool:
    """Whether the first line with text holds nothing but numbers."""
    text = decoded(content[: 1 << 16], "replace")
    return _numbers(next((line for line in text.splitlines() if line.strip() and not line.startswith("#")), "")) is not None


def read_polylines(path: Path, content: bytes, names: list[str] | None = None) -> Curves:
    """The curves of a file of numbers, in mm. Raises InputError for anything else, and for curves of different sizes."""
    require(names is None, path, "columns", "the file has no names", "leave `columns` out")
    lines, breaks = [], [0]
    try:
        whole = decoded(content)
    except UnicodeDecodeError:
        raise InputError(path, "file", "is no text", FORM) from None
    for number, text in enumerate(whole.splitlines(), start=1):
        text = text.partition("#")[0].strip()
        if not text:
            breaks += [len(lines)] * (len(lines) > breaks[-1])
            continue
        values = _numbers(text)
        if values is None or lines and len(values) != len(lines[0]) or len(values) % 3:
            raise InputError(path, f"line {number}", f"{text[:40]!r}", FORM)
        lines.append(values)
    require(lines, path, "file", "holds no numbers", FORM)
    if len(lines[0]) > 3:
        return Curves(stacked(path, np.array(lines).reshape(len(lines), -1, 3)))
    ends = [end for end in breaks if 0 < end < len(lines)]
    return Curves(stacked(path, np.split(np.array(lines), ends)))


def _numbers(text: str) -> list[float] | None:
    """The numbers of a line, or None where there is anything else."""
    words = text.replace(";", " ").split()
    if len(words) % 3 == 0 and all(map(_DECIMAL.fullmatch, words)) and "," in text:
        words = [word.replace(",", ".") for word in words]
    else:
        words = text.replace(",", " ").replace(";", " ").split()
    try:
        return [float(word) for word in words] or None
    except ValueError:
        return None


MOTIVE_UNITS = {"meters": "m", "centimeters": "cm", "millimeters": "mm", "inches": "in"}
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
    rate = _rate(path, decimal, 1, about.get("Export Frame Rate") or about.get("Capture Frame Rate") or "")
    header = next((row for row, (_, cells) in enumerate(rows) if cells and cells[0].strip() == "Frame"), None)
    require(header is not None, path, "Frame", "no row begins with it", REMEDY)
    above = {cells[1].strip(): cells for _, cells in rows[1:header] if len(cells) > 1}
    require("Name" in above, path, "Name", "no row names the markers", REMEDY)
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
    require(len(rows) >= begin + 6, path, "Trajectories", "no rows below it", REMEDY)
    rate = _rate(path, decimal, rows[begin + 1][0], _cell(rows[begin + 1][1], 0))
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
    require(len(order) >= 3, path, "Name", f"{len(order)} markers", "name three or more along the rod, in their order")
    short = next((name for name in order if len(columns[name]) != 3), None)
    if short is not None:
        raise InputError(path, short, f"{len(columns[short])} columns of a position", "give markers of different names")
    chosen = [column for name in order for column in columns[name]]
    frames = [(line, cells) for line, cells in rows if any(map(str.strip, cells))]
    points = np.array([[_number(path, decimal, line, _cell(cells, column)) for column in chosen] for line, cells in frames])
    texts = [_cell(cells, 0) for _, cells in frames]
    labels = np.array(texts, dtype=np.int64) if all(text.isdecimal() and len(text) < 16 for text in texts) else None
    require(len(points), path, "Frame", "no frames", REMEDY)
    return points.reshape(len(points), -1, 3), labels if labels is not None and (np.diff(labels) > 0).all() else None


def _unit(path: Path, field: str, known: dict[str, str], name: str) -> float:
    """mm in the unit that the file calls ``name``."""
    if name not in known:
        raise InputError(path, field, f"{name[:40]!r} is not a known unit of length", f"export in one of {', '.join(known)}")
    return UNITS_IN_MM[known[name]]


def _cell(cells: list[str], column: int) -> str:
    return cells[column].strip() if column < len(cells) else ""


def _rate(path: Path, decimal: str, line: int, cell: str) -> float | None:
    """Frames per second, or None where the cell states none."""
    rate = _number(path, decimal, line, cell)
    return rate if rate > 0 else None


def _number(path: Path, decimal: str, line: int, cell: str) -> float:
    """The number in a cell, NaN where it is empty."""
    value = number_in(cell or "nan", decimal)
    require(not np.isinf(value), path, f"line {line}", f"{cell!r} is not a finite number", REMEDY)
    return value
