"""The last hypotheses of a search, relaxed until they converge, and their E_vis (§IV-A).

    E_vis = E / B + ν Σ_c (E_proj^c + E_cover^c)

of rods that grew (:meth:`Search.relaxed`) and, with evidence from both sides, of rods traced along the detected lines
(:mod:`doo_ti.perception.traced`).

Axes: A image sets, C cameras, F finalists of all sets.
"""

from dataclasses import dataclass

import numpy as np

from doo_ti.perception.growth import Hypotheses
from doo_ti.perception.search import Search
from doo_ti.perception.traced import traced
from doo_ti.types import Configuration, Material
from doo_ti.vision.reprojection.coverage import coverage
from doo_ti.vision.reprojection.score import score


@dataclass(frozen=True)
class Finalists:
    """F rods on the fine mesh.

    of_set         (F,) image set, in increasing order
    configuration  the rods
    energy_vis     (F,) 1/mm; infinite for rods that failed
    status, stable (F,) how their relaxation ended
    coverage       (F, C) share of the detected line that is explained; NaN where the detections are not known
    line           (F, C) px of detected line
    """

    of_set: np.ndarray
    configuration: Configuration
    energy_vis: np.ndarray
    status: np.ndarray
    stable: np.ndarray
    coverage: np.ndarray
    line: np.ndarray


def finalists(search: Search, grown: Hypotheses) -> Finalists:
    """Those that ``grown``, relaxed, and those that are traced."""
    hypotheses, solution = search.relaxed(grown)
    of_set, energy = hypotheses.of_set, hypotheses.energy_vis
    parts = [(solution.configuration, solution.status, solution.stable)]
    detections = search.maps.detections
    if detections is None or search.options.evidence == "rod":
        unknown = np.full((len(of_set), len(search.rig.cameras)), np.nan)
        return Finalists(of_set, *_joined(parts, energy), unknown, unknown)
    fine = np.repeat(search.rest_length / search.options.pieces, search.options.pieces)
    rods = traced(search.rig, detections, search.point, search.direction, fine / fine.sum(), search.material, search.up,
                  float(fine.sum()))
    if rods is not None:
        # Of rods that grew E_vis is known; a traced one is relaxed under another energy.
        of_set = np.concatenate([of_set, rods.of_set])
        energy = np.concatenate([energy, _energy_vis(search, rods.solution.configuration, rods.of_set)])
        one = rods.solution.configuration
        parts.append((Configuration(one.start, one.quaternions, fine), rods.solution.status, rods.solution.stable))
    order = np.argsort(of_set, kind="stable")
    configuration, energy, status, stable = _joined(parts, energy)
    configuration, of_set = configuration.take(order), of_set[order]
    found = coverage(search.rig, configuration.vertices, of_set, detections, search.options.cap)
    energy = energy[order] + search.options.nu * found.error.sum(axis=1)
    return Finalists(of_set, configuration, np.where(np.isfinite(energy), energy, np.inf), status[order], stable[order],
                     found.share, found.line)


def _joined(parts, energy: np.ndarray):
    configurations, status, stable = zip(*parts, strict=True)
    return Configuration.concatenate(list(configurations)), energy, np.concatenate(status), np.concatenate(stable)


def _energy_vis(search: Search, rods: Configuration, of_set: np.ndarray) -> np.ndarray:
    """(R,) E/B + ν Σ E_proj of rods, 1/mm; of a material that is not round that of a round one as stiff."""
    weight = search.material.weight[0]
    round_one = Material(search.scale, search.scale, weight)
    found = score(rods.vertices, search.maps, of_set, search.rig, search.options.nu * search.scale, round_one,
                  points=search.piece_points, cap=search.options.cap, up=search.up)
    return found.total / search.scale


def left_over(share: np.ndarray, line: np.ndarray, image_length: np.ndarray, length: float) -> np.ndarray:
    """(A,) mm of thread that rods of ``length`` mm do not explain, in the camera where that is most: px of line at the scale of
    the rod's image."""
    with np.errstate(invalid="ignore"):
        unexplained = (1 - share) * line / np.maximum(image_length, 1e-9) * length
    return unexplained.max(axis=1)
