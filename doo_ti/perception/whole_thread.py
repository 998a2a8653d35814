"""Threads of unknown length, from a seed to where they end in the images (docs/perception.md).

Between cameras that are close together a rod that is too long folds along the line of sight, and explains the images as well
as a shorter one: to end where the paths end does not determine its length. So it is chosen as everything else is, by E_vis
with evidence from both sides. The best rods are relaxed again with lengths a little shorter and longer; between these E_vis is
a parabola. Lengths whose E_vis exceeds the least one by less than what makes a runner-up ambiguous explain the images as well:
they are the range of the thread's length. Within that, it is the one with which the best rod ends where its paths end.

Axes: A image sets, R rods, L lengths.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from doo_ti.perception.evidence import evidence
from doo_ti.perception.search import PerceptionOptions
from doo_ti.perception.traced import whole_rods
from doo_ti.rod.types import Material
from doo_ti.vision.cameras.rig import Rig
from doo_ti.vision.detection.line import Detection
from doo_ti.vision.reprojection.distance_map import distance_maps

EDGES = 120
BEST = 3
"""Rods of a set that are tried with other lengths."""
TIMES = np.array([0.88, 0.94, 0.97, 1.0, 1.03, 1.06])
"""Those lengths, over the ones with which the rods end where their paths end."""
POINTS = 2
"""Places along an edge where a map is sampled."""
ROUNDS = 3
AMBIGUOUS_PX = 0.02
"""E_vis over ν and the length of all detected lines, in px, by which a length is no worse than the best."""


@dataclass(frozen=True)
class WholeThreads:
    """Of A sets; NaN where no thread can be followed from the seed.

    length     (A,) mm
    range      (A, 2) mm: the shortest and the longest length that explains the images as well
    direction  (A, 3) unit vectors of the beginnings
    """

    length: np.ndarray
    range: np.ndarray
    direction: np.ndarray


def whole_threads(rig: Rig, detections: Sequence[Sequence[Detection]], point: np.ndarray, direction: np.ndarray | None,
                  material: Material, up: np.ndarray, options: PerceptionOptions = PerceptionOptions()) -> WholeThreads:
    """The thread from each seed ``point`` (A, 3) mm in its ``direction`` (A, 3), or in the one in which it goes on.

    options  whose ν and cap E_vis has
    """
    length, ways = np.full(len(point), np.nan), np.full((len(point), 3), np.nan)
    bounds = np.full((len(point), 2), np.nan)
    for row, images in enumerate(detections):  # maps of all sets at once may not fit into memory
        way = None if direction is None else direction[row : row + 1]
        tracing, rods = whole_rods(rig, [images], point[row : row + 1], way, np.full(EDGES, 1 / EDGES), material, up)
        if rods is None:
            continue
        maps, looked = distance_maps([list(images)]), (material, up, options, POINTS)
        energy, _ = evidence(rig, maps, rods.solution.configuration, tracing.of_set, *looked)
        rows = np.repeat(np.argsort(energy, kind="stable")[:BEST], len(TIMES))
        tried = rods.take(rows)
        tried = tried.as_long(tried.length * np.tile(TIMES, len(rows) // len(TIMES)))
        tracing = tracing.take(rows)
        tried = tracing.relaxed(tried, np.ones(len(rows), dtype=bool), ROUNDS)
        energy, found = evidence(rig, maps, tried.solution.configuration, tracing.of_set, *looked)
        energy, lengths = energy.reshape(-1, len(TIMES)), tried.length.reshape(-1, len(TIMES))
        slack = AMBIGUOUS_PX * options.nu * found.line[0].sum()
        length[row], bounds[row] = _profiled(lengths, energy, slack)
        nearest = np.argmin(np.where(energy <= energy.min() + slack, np.abs(lengths - length[row]), np.inf))
        ways[row] = tried.solution.configuration.frames[nearest, 0, :, 0]
    return WholeThreads(length, bounds, ways if direction is None else direction)


def _profiled(length: np.ndarray, energy: np.ndarray, slack: float) -> tuple[float, tuple[float, float]]:
    """The length of the thread, and the least and the largest one whose energy exceeds the least by ``slack`` at most.

    length, energy  (R, L) of rods with TIMES their length
    """
    fine, values = [], []
    for tried, found in zip(length, energy, strict=True):
        k = int(np.clip(np.argmin(found), 1, len(tried) - 2))
        here = slice(k - 1, k + 2)
        if not np.isfinite(found[here]).all():
            continue
        between = np.linspace(tried[k - 1], tried[k + 1], 41)
        fine.append(np.concatenate([tried, between]))
        values.append(np.concatenate([found, np.polyval(np.polyfit(tried[here], found[here], 2), between)]))
    if not fine:
        best = np.unravel_index(np.argmin(energy), energy.shape)
        return float(length[best]), (float(length.min()), float(length.max()))
    every, least = np.concatenate(fine), np.concatenate(values)
    alike = every[least <= least.min() + slack]
    at_end = int(np.argmax(TIMES == 1.0))
    best = int(np.argmin(energy[:, at_end]))
    sound = energy[best, at_end] <= least.min() + slack
    return float(length[best, at_end] if sound else every[np.argmin(least)]), (float(alike.min()), float(alike.max()))
