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
from doo_ti.types import Configuration, Material, Status
from doo_ti.vision.reprojection.coverage import coverage
from doo_ti.vision.reprojection.score import score

CONVINCING, CLOSE_PX = 0.98, 0.5
"""Share of the detected line that a rod which grew explains in every camera, and its mean distance from that line: where there
is such a rod none is traced, which takes longer than all of the search."""

@dataclass(frozen=True)
class Finalists:
    """F rods on the fine mesh.

    of_set         (F,) image set, in increasing order
    configuration  the rods
    energy_vis     (F,) 1/mm; infinite for rods that failed
    status         (F,) how their relaxation ended
    certified      (F,) bool: at a minimum of the energy that they were relaxed under
    coverage       (F, C) share of the detected line that is explained; NaN where the detections are not known
    line           (F, C) px of detected line
    """

    of_set: np.ndarray
    configuration: Configuration
    energy_vis: np.ndarray
    status: np.ndarray
    certified: np.ndarray
    coverage: np.ndarray
    line: np.ndarray


def finalists(search: Search, grown: Hypotheses) -> Finalists:
    """Those that ``grown``, relaxed, and those that are traced, in sets where none of the former is convincing."""
    hypotheses, solution = search.relaxed(grown)
    of_set, energy, options = hypotheses.of_set, hypotheses.energy_vis, search.options
    certified = (solution.status == Status.CONVERGED) & solution.stable
    detections = search.maps.detections
    if detections is None or options.evidence == "rod":
        unknown = np.full((len(of_set), len(search.rig.cameras)), np.nan)
        return Finalists(of_set, solution.configuration, energy, solution.status, certified, unknown, unknown)
    found = coverage(search.rig, solution.configuration.vertices, of_set, detections, options.cap)
    own = Finalists(of_set, solution.configuration, energy + options.nu * found.error.sum(axis=1), solution.status, certified,
                    found.share, found.line)
    convincing = certified & (found.share >= CONVINCING).all(axis=1) & (found.error <= CLOSE_PX * found.line).all(axis=1)
    doubtful = np.setdiff1d(np.arange(len(search.point)), of_set[convincing])
    return own if not len(doubtful) else _with_traced(search, own, doubtful)


def _with_traced(search: Search, grown: Finalists, sets: np.ndarray) -> Finalists:
    """``grown``, and rods traced in the image sets ``sets``."""
    fine = np.repeat(search.rest_length / search.options.pieces, search.options.pieces)
    detections = [search.maps.detections[row] for row in sets]
    rods = traced(search.rig, detections, search.point[sets], search.direction[sets], fine / fine.sum(), search.material,
                  search.up, float(fine.sum()))
    if rods is None:
        return grown
    of_set, one = sets[rods.of_set], rods.solution.configuration
    found = coverage(search.rig, one.vertices, rods.of_set, detections, search.options.cap)
    energy = _energy_vis(search, one, of_set) + search.options.nu * found.error.sum(axis=1)
    parts = grown, Finalists(of_set, Configuration(one.start, one.quaternions, fine), np.where(np.isfinite(energy), energy, np.inf),
                             rods.solution.status, (rods.solution.status == Status.CONVERGED) & rods.solution.stable,
                             found.share, found.line)
    order = np.argsort(np.concatenate([part.of_set for part in parts]), kind="stable")
    joined = {name: np.concatenate([getattr(part, name) for part in parts])[order] for name in Finalists.__dataclass_fields__
              if name != "configuration"}
    return Finalists(configuration=Configuration.concatenate([part.configuration for part in parts]).take(order), **joined)


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
