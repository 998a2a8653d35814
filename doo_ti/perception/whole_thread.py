"""Threads of unknown length, from a seed to where they end in the images (docs/perception.md).

Axes: A image sets, C cameras.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from doo_ti.perception.search import PerceptionOptions
from doo_ti.perception.traced import traced
from doo_ti.types import Material
from doo_ti.vision.cameras.rig import Rig
from doo_ti.vision.detection.line import Detection
from doo_ti.vision.reprojection.coverage import coverage

EDGES = 120


@dataclass(frozen=True)
class WholeThreads:
    """Of A sets; NaN where no thread can be followed from the seed.

    length     (A,) mm
    direction  (A, 3) unit vectors of the beginnings
    """

    length: np.ndarray
    direction: np.ndarray


def whole_threads(rig: Rig, detections: Sequence[Sequence[Detection]], point: np.ndarray, direction: np.ndarray | None,
                  material: Material, up: np.ndarray, options: PerceptionOptions = PerceptionOptions()) -> WholeThreads:
    """The thread from each seed ``point`` (A, 3) mm in its ``direction`` (A, 3), or in the one in which it goes on.

    options  of which ν and the cap weigh what a rod leaves unexplained
    """
    length, ways = np.full(len(point), np.nan), np.full((len(point), 3), np.nan)
    rods = traced(rig, detections, point, direction, np.full(EDGES, 1 / EDGES), material, up)
    if rods is None:
        return WholeThreads(length, ways)
    unexplained = coverage(rig, rods.whole.vertices, rods.of_set, detections, options.cap).error.sum(axis=1)
    energy = rods.energy + options.nu * unexplained
    for row in np.unique(rods.of_set):
        own = np.flatnonzero(rods.of_set == row)
        best = own[np.nan_to_num(energy[own], nan=np.inf).argmin()]
        length[row], ways[row] = rods.thread[best], rods.whole.frames[best, 0, :, 0]
    return WholeThreads(length, ways if direction is None else direction)
