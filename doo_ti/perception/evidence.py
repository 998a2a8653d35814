"""E_vis of rods with evidence from both sides (§IV-A):

    E_vis = E / B + ν Σ_c (E_proj^c + E_cover^c)

with E_proj what the rod's image is away from the detected line, and E_cover what the line is away from the rod's image.

Axes: A image sets, C cameras, R rods.
"""

import numpy as np

from doo_ti.perception.search import PerceptionOptions
from doo_ti.rod.types import Configuration, Material
from doo_ti.vision.cameras.rig import Rig
from doo_ti.vision.reprojection.coverage import Coverage, coverage
from doo_ti.vision.reprojection.distance_map import DistanceMaps
from doo_ti.vision.reprojection.score import score


def evidence(rig: Rig, maps: DistanceMaps, rods: Configuration, of_set: np.ndarray, material: Material, up: np.ndarray,
             options: PerceptionOptions, points: int) -> tuple[np.ndarray, Coverage]:
    """(R,) E_vis in 1/mm, infinite where it is not finite, and what rods of the sets ``of_set`` (R,) explain. A material that
    is not round counts as a round one as stiff.

    points  places along an edge where a map is sampled
    """
    stiffness = float(np.linalg.eigvalsh(material.bend).max())
    round_one = Material(stiffness, stiffness, material.weight[0])
    one_way = score(rods.vertices, maps, of_set, rig, options.nu * stiffness, round_one, points=points, cap=options.cap, up=up)
    found = coverage(rig, rods.vertices, of_set, maps.detections, options.cap)
    energy = one_way.total / stiffness + options.nu * found.error.sum(axis=1)
    return np.where(np.isfinite(energy), energy, np.inf), found
