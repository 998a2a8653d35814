"""Labelled marks: the pixels of each mark of each rod in each image, labels to partition observations by, and observations from
the triangulated marks (§V-A). A CSV file has one row per label, in any order:

    observation   the rod's configuration: any name; observations keep the order in which they first appear
    camera        name of the rig's camera
    mark          0, 1, 2 … along the rod; of a ribbon 0L and 0R, 1L and 1R …: both edges beside each vertex
    u_px, v_px    pixels, (0, 0) at the centre of the upper left one

Labels to partition by come from another CSV file: ``observation`` and any of ``end_distance_mm``, ``end_rotation_deg`` and
``total_twist_deg``.

A ribbon's centre line is half way between the marks on its edges, and m1 of an edge points across the ribbon from its left to
its right edge: the mean of the directions at both ends of the edge, made orthogonal to t; m2 = t × m1 is the normal.

Axes: C cameras, D observations, V vertices, E edges, S sides: one, or both edges of a ribbon; N rows of the file.
"""

import math
import os
import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from doo_ti.io.arrays import CsvTable, read_csv
from doo_ti.rod.frames import matrix_from_quaternion, smallest_rotation, unit_vectors
from doo_ti.rod.observations import Observations
from doo_ti.rod.start import directions
from doo_ti.system.errors import InputError
from doo_ti.vision.triangulation import MarkStatus, Points

COLUMNS = ("observation", "camera", "mark", "u_px", "v_px")
LABELS = {"end_distance_mm": "end_distance", "end_rotation_deg": "end_rotation", "total_twist_deg": "total_twist"}
FEWEST_MARKS = 3
MOST_UNLABELLED = 100  # marks of all observations and cameras for each that is labelled


@dataclass(frozen=True)
class Marks:
    """The labels of D rods with V marks each."""

    names: tuple[str, ...]  # of the observations
    pixels: np.ndarray  # (C, D, V, S, 2) px, in the order of the rig's cameras; NaN where a mark is not labelled
    source: str  # the file they come from

    @property
    def labels(self) -> np.ndarray:
        """(D,) the names, as whole numbers where all are."""
        whole = all(re.fullmatch(r"0|[1-9]\d{0,14}", name) for name in self.names)
        return np.array(self.names, dtype=np.int64 if whole else np.str_)

    @property
    def is_ribbon(self) -> bool:
        return self.pixels.shape[3] == 2

    def mark(self, vertex: int, side: int) -> str:
        """How the file names a mark."""
        return f"{vertex}{'LR'[side]}" if self.is_ribbon else str(vertex)


def read_marks(path: str | os.PathLike[str], rig) -> Marks:
    """The marks of a CSV file, seen by the cameras of ``rig``, a :class:`doo_ti.vision.cameras.Rig`.

    Raises InputError, naming column, value and line, for any other file, missing columns, cameras that the rig lacks,
    marks that are not numbered from 0 without gap, a ribbon's edge marks beside plain marks, coordinates that are not
    numbers or outside the image, and a mark that a camera has twice in an observation.
    """
    path = Path(path)
    table = read_csv(path, COLUMNS)
    for name in ("observation", "camera", "mark"):
        table.refuse(name, np.array(table.columns[name]) == "", "is empty", "name it in every row")
    place_of = {camera.name: index for index, camera in enumerate(rig.cameras)}
    table.refuse("camera", np.array([name not in place_of for name in table.columns["camera"]]), "is not a camera of the rig",
                 f"the rig has {', '.join(place_of)}")
    camera = np.array([place_of[name] for name in table.columns["camera"]])
    names = {name: number for number, name in enumerate(dict.fromkeys(table.columns["observation"]))}
    observation = np.array([names[name] for name in table.columns["observation"]])
    vertex, side, is_ribbon = _vertices(table)
    pixel = np.stack([table.numbers(name) for name in ("u_px", "v_px")], axis=-1)
    for axis, (name, extent) in enumerate((("u_px", "width"), ("v_px", "height"))):
        size = np.array([getattr(entry, extent) for entry in rig.cameras])[camera]
        outside = ~((pixel[:, axis] >= -0.5) & (pixel[:, axis] <= size - 0.5))
        seen = rig.cameras[camera[int(np.argmax(outside))]]
        table.refuse(name, outside, f"is outside the images of {seen.name}, {seen.width} x {seen.height} px in the rig",
                     "label images of that size")
    place = (camera, observation, vertex, side)
    shape = len(rig.cameras), len(names), int(vertex.max()) + 1, 2 if is_ribbon else 1
    if math.prod(shape) > MOST_UNLABELLED * table.count:
        raise InputError(path, "mark", f"{table.count} labels of {shape[2]} marks in {len(names)} observations",
                         "number the marks alike in all observations")
    again = np.ones(table.count, dtype=bool)
    again[np.unique(np.ravel_multi_index(place, shape), return_index=True)[1]] = False
    row = int(np.argmax(again))
    table.refuse("mark", again, f"is there twice for observation {table.columns['observation'][row]} and "
                 f"{table.columns['camera'][row]}", "keep one label")
    pixels = np.full((*shape, 2), np.nan)
    pixels[place] = pixel
    return Marks(tuple(names), pixels, str(path))


def read_labels(path: str | os.PathLike[str], names: tuple[str, ...]) -> dict[str, np.ndarray]:
    """Field of Observations: (D,) values in the file's units, for the observations ``names``; rows of others are ignored.

    Raises InputError for any other file, for an observation without a row or with two, and for cells that are no number.
    """
    path = Path(path)
    table = read_csv(path, ("observation",), form=f"observation and any of {', '.join(LABELS)}")
    labelled = table.columns["observation"]
    row_of = {name: row for row, name in enumerate(labelled)}
    table.refuse("observation", np.array([row_of[name] != row for row, name in enumerate(labelled)]), "is there twice",
                 "keep one row")
    missing = next((name for name in names if name not in row_of), None)
    if missing is not None:
        raise InputError(path, "observation", f"no row for {missing!r}", "label all observations")
    given = [name for name in LABELS if name in table.columns]
    if not given:
        raise InputError(path, "header", "no label", f"give one or more of {', '.join(LABELS)}")
    rows = [row_of[name] for name in names]
    return {LABELS[name]: table.numbers(name)[rows] for name in given}


def _vertices(table: CsvTable) -> tuple[np.ndarray, np.ndarray, bool]:
    """(N,) vertex and (N,) side of each row's mark, and whether the rods are ribbons."""
    found = [re.fullmatch(r"(\d{1,6})([LR]?)", name) for name in table.columns["mark"]]
    table.refuse("mark", np.array([match is None for match in found]), "is not a mark",
                 "give 0, 1, 2 … along the rod, or 0L, 0R, 1L … along both edges of a ribbon")
    vertex, side = np.array([int(match[1]) for match in found]), np.array([match[2] for match in found])
    is_ribbon = bool((side != "").any())
    table.refuse("mark", (side == "") & is_ribbon, "is not an edge mark, others are",
                 "mark both edges at every vertex, L and R, or none")
    count = int(vertex.max()) + 1
    for letter in ("L", "R") if is_ribbon else ("",):
        unseen = np.setdiff1d(np.arange(count), vertex[side == letter])
        if len(unseen):
            raise InputError(table.path, "mark", f"{unseen[0]}{letter} is missing, but there is mark {count - 1}",
                             "number marks from 0 along the rod, without gap")
    if count < FEWEST_MARKS:
        raise InputError(table.path, "mark", f"{count} marks", f"label {FEWEST_MARKS} or more per rod")
    return vertex, (side == "R").astype(int), is_ribbon


def observe(marks: Marks, points: Points, rest_length: float | None = None, up=(0.0, 0.0, 1.0), name: str = "observations",
            **labels) -> tuple[Observations, np.ndarray]:
    """The rods that ``points``, the triangulated ``marks.pixels`` as (C, P, 2), are marks of; and (D, E) bool: frames that are
    carried over from the nearest measured one, because a mark beside them has no position.

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
        wrong = (points.status == MarkStatus.CONTRADICTORY).reshape(shape)[:, unseen[0] : unseen[0] + 2].any()
        raise InputError(marks.source, "mark", f"no observation has positions for both {unseen[0]} and {unseen[0] + 1}"
                         + (", whose labels contradict each other" if wrong else ""),
                         f"{'correct' if wrong else 'label'} them in two images or more, or give `rest_length`")
    lengths = None if rest_length is None else np.full(shape[1] - 1, rest_length)
    observations = Observations(position.mean(axis=2), valid, lengths, up=up, sigma=np.sqrt(variance.sum(axis=-1)) / shape[2],
                                name=name, source=marks.source, labels=marks.labels, **labels)
    filled = np.zeros((shape[0], shape[1] - 1), dtype=bool)
    if marks.is_ribbon:
        frames, filled = _ribbon_frames(observations, position[:, :, 1] - position[:, :, 0], marks)
        ends = {end: frames[:, edge] for end, edge in (("start_frame", 0), ("end_frame", -1)) if not filled[:, edge].any()}
        observations = replace(observations, frames=frames, **ends)
    return observations, filled


def _ribbon_frames(observations: Observations, across: np.ndarray, marks: Marks) -> tuple[np.ndarray, np.ndarray]:
    """(D, E, 3, 3) frames of ribbons with ``across`` (D, V, 3) from left to right edge, and (D, E) where they are filled."""
    tangent, valid = directions(observations), observations.valid
    unit = unit_vectors(np.where(valid[..., None], across, 0.0))
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
    place = np.arange(measured.shape[1])  # the nearest edge that was measured: itself, if it was
    nearest = np.where(measured[:, None], np.abs(place[:, None] - place), len(place)).argmin(axis=-1)
    source = np.take_along_axis(tangent, nearest[..., None], axis=1)
    carried = matrix_from_quaternion(smallest_rotation(source, tangent))
    director = np.einsum("deij,dej->dei", carried, np.take_along_axis(director, nearest[..., None], axis=1))
    return np.stack([tangent, director, np.cross(tangent, director)], axis=-1), ~measured
