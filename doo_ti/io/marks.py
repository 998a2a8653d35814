"""Labelled marks: the pixels of each mark of each rod in each image, and labels to partition observations by (§V-A).

A CSV file with one row per label, in any order:

    observation   the rod's configuration: any name; observations keep the order in which they first appear
    camera        name of the rig's camera
    mark          0, 1, 2 … along the rod; of a ribbon 0L and 0R, 1L and 1R …: both edges beside each vertex
    u_px, v_px    pixels, (0, 0) at the centre of the upper left one

Labels to partition by come from another CSV file: ``observation`` and any of ``end_distance_mm``, ``end_rotation_deg`` and
``total_twist_deg``.

Axes: C cameras, D observations, V vertices, S sides: one, or both edges of a ribbon; N rows of the file.
"""

import math
import os
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from doo_ti.io.csv_table import CsvTable, read_csv
from doo_ti.system.errors import InputError

COLUMNS = ("observation", "camera", "mark", "u_px", "v_px")
LABELS = {"end_distance_mm": "end_distance", "end_rotation_deg": "end_rotation", "total_twist_deg": "total_twist"}
FEWEST_MARKS = 3
MOST_UNLABELLED = 100
"""Marks of all observations and cameras for each that is labelled."""


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
    """The marks of a CSV file, seen by the cameras of ``rig``, a :class:`doo_ti.vision.cameras.rig.Rig`.

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
