"""Labelled marks: which mark of which rod is where in which image, and the observations that triangulated marks make (§V-A).

A CSV file with one row per label, in any order:

    observation   the rod's configuration: any name; observations keep the order in which they first appear
    camera        name of the rig's camera
    mark          0, 1, 2 … along the rod; of a ribbon 0L and 0R, 1L and 1R …: both edges beside each vertex
    u_px, v_px    pixels, (0, 0) at the centre of the upper left one

Labels to partition by come from another CSV file: ``observation`` and any of ``end_distance_mm``, ``end_rotation_deg`` and
``total_twist_deg``.

A ribbon has marks on both edges. Its centre line is half way between them, and m1 of an edge points across the ribbon from its
left to its right edge: the mean of the directions at both ends of the edge, made orthogonal to t; m2 = t × m1 is the normal.

Axes: C cameras, D observations, V vertices, E edges, S sides: one, or both edges of a ribbon.
"""

import io
import os
import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from doo_ti.dataset import Observations
from doo_ti.errors import InputError
from doo_ti.file_content import MOST_TEXT_BYTES, read_content
from doo_ti.frames import matrix_from_quaternion, smallest_rotation
from doo_ti.start import fill_missing
from doo_ti.vision.cameras.rig import Rig
from doo_ti.vision.reprojection.triangulation import Points

COLUMNS = ("observation", "camera", "mark", "u_px", "v_px")
LABELS = {"end_distance_mm": "end_distance", "end_rotation_deg": "end_rotation", "total_twist_deg": "total_twist"}
FEWEST_MARKS = 3


@dataclass(frozen=True)
class Marks:
    """The labels of D rods with V marks each.

    names   of the observations
    pixels  (C, D, V, S, 2) px, in the order of the rig's cameras; NaN where a mark is not labelled
    source  the file they come from
    """

    names: tuple[str, ...]
    pixels: np.ndarray
    source: str

    @property
    def is_ribbon(self) -> bool:
        return self.pixels.shape[3] == 2

    def mark(self, vertex: int, side: int) -> str:
        """How the file names a mark."""
        return f"{vertex}{'LR'[side]}" if self.is_ribbon else str(vertex)


def read_marks(path: str | os.PathLike, rig: Rig) -> Marks:
    """The marks of a CSV file, seen by ``rig``.

    Raises InputError, naming column and row, for what is no such file, missing columns, cameras the rig has not, marks that are
    no numbers from 0 without gap, edges of a ribbon beside plain marks, coordinates that are no numbers or outside the image,
    and a mark that a camera has twice in an observation.
    """
    path = Path(path)
    table = _table(path, COLUMNS)
    for name in ("observation", "camera", "mark"):
        _refuse(path, table, name, table[name] == "", "is empty", "name it in every row")
        _refuse(path, table, name, np.char.find(table[name], "\n") >= 0, "holds a line break", "close the quote")
    camera = _places(path, table, "camera", rig.names)
    names, observation = _names(table["observation"])
    vertex, side, is_ribbon = _vertices(path, table)
    pixel = np.stack([_numbers(path, table, name) for name in ("u_px", "v_px")], axis=-1)
    for axis, (name, extent) in enumerate((("u_px", "width"), ("v_px", "height"))):
        size = np.array([getattr(entry, extent) for entry in rig.cameras])[camera]
        outside = ~((pixel[:, axis] >= -0.5) & (pixel[:, axis] <= size - 0.5))
        if outside.any():
            row = int(np.argmax(outside))
            seen = rig.cameras[camera[row]]
            raise InputError(path, name, f"{pixel[row, axis]:g} in row {row + 1} is outside {seen.name}'s images, which the "
                             f"rig says are {seen.width} x {seen.height}", "label images of that size")
    place = (camera, observation, vertex, side)
    shape = len(rig.cameras), len(names), vertex.max() + 1, 2 if is_ribbon else 1
    flat = np.ravel_multi_index(place, shape)
    _, first = np.unique(flat, return_index=True)
    again = np.ones(len(flat), dtype=bool)
    again[first] = False
    if again.any():
        row = int(np.argmax(again))
        raise InputError(path, "mark", f"{table['mark'][row]} of observation {table['observation'][row]} is there twice for "
                         f"{table['camera'][row]} (row {row + 1})", "keep one label")
    pixels = np.full((*shape, 2), np.nan)
    pixels[place] = pixel
    return Marks(names, pixels, str(path))


def read_labels(path: str | os.PathLike, names: tuple[str, ...]) -> dict[str, np.ndarray]:
    """Field of Observations: (D,) values in the file's units, for the observations ``names``; rows of others are left behind.

    Raises InputError for what is no such file, for an observation without a row or with two, and for what is no number.
    """
    path = Path(path)
    table = _table(path, ("observation",))
    row_of = {name: row for row, name in enumerate(table["observation"].tolist())}
    _refuse(path, table, "observation", ~np.isin(np.arange(len(table["observation"])), list(row_of.values())), "is there twice",
            "keep one row")
    missing = next((name for name in names if name not in row_of), None)
    if missing is not None:
        raise InputError(path, "observation", f"no row for {missing!r}", "label all observations")
    given = [name for name in LABELS if name in table]
    if not given:
        raise InputError(path, "header", "no label", f"give one or more of {', '.join(LABELS)}")
    rows = [row_of[name] for name in names]
    return {LABELS[name]: _numbers(path, table, name)[rows] for name in given}


def _table(path: Path, needed: tuple[str, ...]) -> dict[str, np.ndarray]:
    """Column: (N,) stripped text, of a CSV file that has the columns ``needed``."""
    import pyarrow
    import pyarrow.csv

    content = read_content(path, MOST_TEXT_BYTES, "name a readable CSV file")
    try:
        header = content.splitlines()[0].decode("utf-8-sig").split(",") if content else []
        as_text = {name: pyarrow.string() for name in header}
        table = pyarrow.csv.read_csv(io.BytesIO(content), convert_options=pyarrow.csv.ConvertOptions(column_types=as_text))
    except (pyarrow.ArrowException, UnicodeDecodeError) as error:
        first = str(error).strip().splitlines()[0][:80]
        raise InputError(path, "file", f"is no CSV table ({first})", f"write the columns {','.join(needed)}") from None
    names = [name.strip() for name in table.column_names]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise InputError(path, twice, "the column is there twice", "keep one of them")
    missing = next((name for name in needed if name not in names), None)
    if missing is not None:
        raise InputError(path, missing, "the column is missing", f"give {', '.join(needed)}")
    if table.num_rows == 0:
        raise InputError(path, "file", "holds no rows", "write one row per label")
    return {name: np.char.strip(np.array(column.cast("string").fill_null("").to_pylist(), dtype=str))
            for name, column in zip(names, table.columns)}


def _refuse(path: Path, table: dict[str, np.ndarray], name: str, wrong: np.ndarray, problem: str, remedy: str) -> None:
    """Raise InputError for the first row that is wrong."""
    if wrong.any():
        row = int(np.argmax(wrong))
        raise InputError(path, name, f"{str(table[name][row])!r} in row {row + 1} {problem}", remedy)


def _numbers(path: Path, table: dict[str, np.ndarray], name: str) -> np.ndarray:
    """A column in f64, finite."""
    try:
        values = table[name].astype(np.float64)
    except ValueError:
        values = np.array([_number(text) for text in table[name].tolist()])
    _refuse(path, table, name, ~np.isfinite(values), "is not a finite number", "give a number, or leave the row out")
    return values


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return np.nan


def _names(column: np.ndarray) -> tuple[tuple[str, ...], np.ndarray]:
    """The different names in order of appearance, and (N,) which of them each row has."""
    names, first, which = np.unique(column, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return tuple(names[order].tolist()), rank[which.reshape(-1)]


def _places(path: Path, table: dict[str, np.ndarray], name: str, known: tuple[str, ...]) -> np.ndarray:
    """(N,) which of the ``known`` names each row has."""
    column = table[name]
    _refuse(path, table, name, ~np.isin(column, known), "is no camera of the rig", f"the rig has {', '.join(known)}")
    place = {entry: index for index, entry in enumerate(known)}
    names, which = np.unique(column, return_inverse=True)
    return np.array([place[entry] for entry in names.tolist()])[which.reshape(-1)]


def _vertices(path: Path, table: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray, bool]:
    """(N,) vertex and (N,) side of each row's mark, and whether the rods are ribbons."""
    names, which = np.unique(table["mark"], return_inverse=True)
    which = which.reshape(-1)
    found = [re.fullmatch(r"(\d{1,6})([LR]?)", name) for name in names.tolist()]
    _refuse(path, table, "mark", np.array([match is None for match in found])[which], "is no mark",
            "give 0, 1, 2 … along the rod, or 0L, 0R, 1L … along both edges of a ribbon")
    vertex, side = np.array([int(match[1]) for match in found]), np.array([match[2] for match in found])
    is_ribbon = bool((side != "").any())
    _refuse(path, table, "mark", (side == "")[which] & is_ribbon, "is no edge mark, others are",
            "mark both edges at every vertex, L and R, or none")
    count = int(vertex.max()) + 1
    for letter in ("L", "R") if is_ribbon else ("",):
        unseen = np.setdiff1d(np.arange(count), vertex[side == letter])
        if len(unseen):
            raise InputError(path, "mark", f"{unseen[0]}{letter} is nowhere, but there is mark {count - 1}",
                             "count marks from 0 along the rod, without gap")
    if count < FEWEST_MARKS:
        raise InputError(path, "mark", f"{count} marks", f"a rod has {FEWEST_MARKS} or more")
    return vertex[which], (side == "R").astype(int)[which], is_ribbon


# --- from triangulated marks to observations ------------------------------------------------------------------------------

@dataclass(frozen=True)
class MarkedRods:
    """Observations of D rods, and how their frames came about.

    frames_filled  (D, E) bool: frames carried over from the nearest measured one, because a mark beside them has no position
    """

    observations: Observations
    frames_filled: np.ndarray


def observe(marks: Marks, points: Points, rest_length: float | None = None, up=(0.0, 0.0, 1.0), name: str = "observations",
            **labels) -> MarkedRods:
    """The rods that ``points``, the triangulated ``marks.pixels`` as (C, P, 2), are marks of.

    rest_length  mm from each mark to the next along the rod; by default each edge's median over the observations
    up           (3,) against gravity
    labels       fields of Observations: end_distance, end_rotation, total_twist (D,)

    Sigma is the root mean square over the three axes. A ribbon gets ``frames``; and ``start_frame`` and ``end_frame`` where all
    marks at both vertices of that end's edge have positions in all observations. Raises InputError for an observation with
    fewer than two vertices that have a position, and for whatever Observations refuses.
    """
    shape = marks.pixels.shape[1:4]
    position, valid = points.position.reshape(*shape, 3), points.valid.reshape(shape).all(axis=-1)
    variance = np.trace(points.covariance, axis1=-2, axis2=-1).reshape(shape) / 3
    few = np.flatnonzero(valid.sum(axis=1) < 2)
    if len(few):
        problem = f"{marks.names[few[0]]!r} has {valid[few[0]].sum()} vertices with a position"
        raise InputError(marks.source, "observation", problem, "label more of its marks in two images or more, or leave it out")
    unseen = np.flatnonzero(~(valid[:, 1:] & valid[:, :-1]).any(axis=0))
    if rest_length is None and len(unseen):
        raise InputError(marks.source, "mark", f"no observation has positions for both {unseen[0]} and {unseen[0] + 1}",
                         "label them in two images or more, or give --rest-length")
    lengths = None if rest_length is None else np.full(shape[1] - 1, rest_length)
    observations = Observations(position.mean(axis=2), valid, lengths, up=up, sigma=np.sqrt(variance.sum(axis=-1)) / shape[2],
                                name=name, source=marks.source, **labels)
    filled = np.zeros((shape[0], shape[1] - 1), dtype=bool)
    if marks.is_ribbon:
        frames, filled = _ribbon_frames(observations, position[:, :, 1] - position[:, :, 0], marks)
        ends = {"start_frame": frames[:, 0], "end_frame": frames[:, -1]}
        known = {"start_frame": not filled[:, 0].any(), "end_frame": not filled[:, -1].any()}
        observations = replace(observations, frames=frames, **{end: frame for end, frame in ends.items() if known[end]})
    return MarkedRods(observations, filled)


def _ribbon_frames(observations: Observations, across: np.ndarray, marks: Marks) -> tuple[np.ndarray, np.ndarray]:
    """(D, E, 3, 3) frames of ribbons with ``across`` (D, V, 3) from left to right edge, and (D, E) where they are filled."""
    edges = np.diff(fill_missing(observations), axis=1)
    tangent = edges / np.linalg.norm(edges, axis=-1, keepdims=True)
    valid = observations.valid
    unit = np.where(valid[..., None], across, 0.0)
    unit = unit / np.maximum(np.linalg.norm(unit, axis=-1, keepdims=True), np.finfo(float).tiny)
    director = unit[:, :-1] + unit[:, 1:]
    director = director - np.sum(director * tangent, axis=-1, keepdims=True) * tangent
    length = np.linalg.norm(director, axis=-1)
    # Less than a tenth is left of a width that runs along the rod, or that turns half round from one vertex to the next.
    measured = valid[:, :-1] & valid[:, 1:] & (length > 0.1)
    none = np.flatnonzero(~measured.any(axis=1))
    if len(none):
        raise InputError(marks.source, "observation", f"{marks.names[none[0]]!r} shows the ribbon's width at no two neighbours",
                         "label more of its marks, or leave it out")
    director = director / np.where(measured, length, 1.0)[..., None]
    nearest = _nearest(measured)
    source = np.take_along_axis(tangent, nearest[..., None], axis=1)
    carried = matrix_from_quaternion(smallest_rotation(source, tangent))
    director = np.einsum("deij,dej->dei", carried, np.take_along_axis(director, nearest[..., None], axis=1))
    return np.stack([tangent, director, np.cross(tangent, director)], axis=-1), ~measured


def _nearest(there: np.ndarray) -> np.ndarray:
    """(D, E) the nearest place in the same row that is ``there`` (D, E), itself if it is."""
    place = np.arange(there.shape[1])
    before = np.maximum.accumulate(np.where(there, place, -there.shape[1]), axis=1)
    after = np.minimum.accumulate(np.where(there, place, 2 * there.shape[1])[:, ::-1], axis=1)[:, ::-1]
    return np.where(place - before <= after - place, before, after)
