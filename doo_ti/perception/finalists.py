"""The last hypotheses of a search, relaxed until they converge, and their E_vis (§IV-A).

    E_vis = E / B + ν Σ_c (E_proj^c + E_cover^c)

of rods that grew (:meth:`Search.relaxed`) and, with evidence from both sides, of rods traced along the detected lines
(:mod:`doo_ti.perception.traced`).

Axes: A image sets, C cameras, F finalists of all sets.
"""

from dataclasses import dataclass

import numpy as np

from doo_ti.perception.growth import Hypotheses
from doo_ti.perception.search import Search, evidence
from doo_ti.perception.traced import traced
from doo_ti.rod.types import Configuration, Status
from doo_ti.vision.reprojection.image_energy import Coverage, coverage
from doo_ti.vision.reprojection.score import score

CONVINCING, CLOSE_PX = 0.98, 0.5
"""A rod that grew is convincing if it explains this share of the detected line in every camera, and rod and line are this close
to each other on average. No rods are traced in a set that has one: tracing takes longer than the whole search."""
WIDE = np.radians(20.0)
"""Least angle between two cameras for that. Between closer ones a rod of a wrong length, or one folded along the line of sight,
explains the images as well."""


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
    thread         (F,) mm: length of the thread that a traced rod follows; NaN of others
    """

    of_set: np.ndarray
    configuration: Configuration
    energy_vis: np.ndarray
    status: np.ndarray
    certified: np.ndarray
    coverage: np.ndarray
    line: np.ndarray
    thread: np.ndarray


def finalists(search: Search, grown: Hypotheses) -> Finalists:
    """The rods that ``grown`` become when they are relaxed and, in sets where none of these is convincing, traced rods."""
    hypotheses, solution = search.relaxed(grown)
    of_set, energy, options = hypotheses.of_set, hypotheses.energy_vis, search.options
    certified = (solution.status == Status.CONVERGED) & solution.stable
    detections = search.maps.detections
    if detections is None or options.evidence == "rod":
        unknown = np.full((len(of_set), len(search.rig.cameras)), np.nan)
        return Finalists(of_set, solution.configuration, energy, solution.status, certified, unknown, unknown, unknown[:, 0])
    found = coverage(search.rig, solution.configuration.vertices, of_set, detections, options.cap)
    own = Finalists(of_set, solution.configuration, energy + options.nu * found.error.sum(axis=1), solution.status, certified,
                    found.share, found.line, np.full(len(of_set), np.nan))
    convincing = certified & (found.share >= CONVINCING).all(axis=1) & (found.error <= CLOSE_PX * found.line).all(axis=1)
    convincing &= _fits(search, solution.configuration, of_set) & (_angle(search, solution.configuration) >= WIDE)
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
    energy, found = _evidence(search, one, of_set)
    if not rods.together.all():  # a rod shorter than the thread, or longer, is as good as the whole thread that it is part of
        part = np.flatnonzero(~rods.together)
        energy[part] = _evidence(search, rods.whole.take(part), of_set[part])[0]
    parts = grown, Finalists(of_set, Configuration(one.start, one.quaternions, fine), energy,
                             rods.solution.status, (rods.solution.status == Status.CONVERGED) & rods.solution.stable,
                             found.share, found.line, rods.thread)
    order = np.argsort(np.concatenate([part.of_set for part in parts]), kind="stable")
    joined = {name: np.concatenate([getattr(part, name) for part in parts])[order] for name in Finalists.__dataclass_fields__
              if name != "configuration"}
    return Finalists(configuration=Configuration.concatenate([part.configuration for part in parts]).take(order), **joined)


def _fits(search: Search, rods: Configuration, of_set: np.ndarray) -> np.ndarray:
    """(R,) bool: every camera sees all of the rod near the detection."""
    found = score(rods.vertices, search.maps, of_set, search.rig, 1.0, points=search.piece_points, cap=search.options.cap)
    image = np.linalg.norm(np.diff(search.rig.project(rods.vertices), axis=2), axis=-1).sum(axis=-1).T
    return ((found.camera_error <= CLOSE_PX * image) & (found.unseen == 0)).all(axis=1)


def _angle(search: Search, rods: Configuration) -> np.ndarray:
    """(R,) rad: the largest angle between the lines of sight of two cameras to the middle of a rod."""
    sight = np.stack([rods.vertices.mean(axis=1) - camera.centre for camera in search.rig.cameras], axis=1)
    sight /= np.linalg.norm(sight, axis=-1, keepdims=True)
    return np.arccos(np.clip(np.einsum("rci,rdi->rcd", sight, sight).min(axis=(1, 2)), -1.0, 1.0))


def _evidence(search: Search, rods: Configuration, of_set: np.ndarray) -> tuple[np.ndarray, Coverage]:
    return evidence(search.rig, search.maps, rods, of_set, search.material, search.up, search.options, search.piece_points)


def left_over(final: Finalists, best: np.ndarray, image_length: np.ndarray, length: float) -> np.ndarray:
    """(A,) mm of thread that the rods ``best`` of ``length`` mm do not explain. Where the thread's length is not known: px of
    line at the scale of the rod's image, (A, C) px long, in the camera where that is most."""
    with np.errstate(invalid="ignore"):
        unexplained = (1 - final.coverage[best]) * final.line[best] / np.maximum(image_length, 1e-9) * length
        beyond = np.maximum(final.thread[best] - length, 0.0)
    return np.where(np.isnan(beyond), unexplained.max(axis=1), beyond)
