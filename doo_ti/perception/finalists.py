"""The last hypotheses of a search, relaxed until they converge, and their E_vis (§IV-A).

    E_vis = E / B + ν Σ_c (E_proj^c + E_cover^c)

of rods that grew (:meth:`Search.relaxed`) and, with evidence from both sides, of rods traced along the detected lines
(:mod:`doo_ti.perception.traced`).

Uncertainty of the vertices of a perceived rod: the Laplace approximation of E_vis around its minimum (§IV-A).

    cov = (∫ a aᵀ ds / (σ² ℓ) + H_E / T)⁻¹,        T = 2 E / P

Detected points have errors of σ px across the line, equal within a length ℓ of the line; the movement of places of the image
across the image, per parameter, is a. H_E is the Hessian of the rod's bending energy E over its stiffness. How strongly rods of
this kind bend is taken from the rod itself: with P parameters of a Gaussian density e^{−E/T} the mean of E is P T/2. Where
images say little, as of the depth where cameras are close together, the rod's stiffness is all that is known, and sigma is
large. Other noise and errors of the model are left out: rig, rest lengths and seed count as exact.

Sensor noise alone moves detected points by about 0.02 px, over about 4 px of line; the default σ and ℓ of
:class:`doo_ti.perception.search.PerceptionOptions` are larger, so that sigma is as large as the errors measured on renderings
of known rods.

Axes: A image sets, C cameras, F finalists of all sets, A rods, E edges, V vertices, S places along a rod, P = 2 (E − 1)
parameters: turns of all edges but the first.
"""

from dataclasses import dataclass

import numpy as np

from doo_ti.perception.growth import Hypotheses
from doo_ti.perception.search import Search, evidence
from doo_ti.perception.traced import traced
from doo_ti.rod.frames import across
from doo_ti.rod.types import Configuration, Status
from doo_ti.vision.cameras.rig import Rig
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


PLACES = (0.25, 0.75)
"""Places along an edge where its image is evaluated."""
LEAST_BENDING = 1e-4
"""T of a rod that looks straight, times its length."""
STEP_MM = 1e-3
"""Step of the difference quotients of the projection."""


def vertex_sigma(rig: Rig, vertices: np.ndarray, sigma_px: float, correlation_px: float) -> np.ndarray:
    """(A, V) mm: standard deviation of each vertex, root mean square over its three coordinates; zero for the first two
    vertices, which are given.

    vertices                   (A, V, 3) mm: rods at minima of E_vis / B, isotropic and straight at rest
    sigma_px, correlation_px   σ and ℓ of the detection
    """
    edges = np.diff(vertices, axis=1)
    length = np.linalg.norm(edges, axis=-1)
    tangents = edges / length[..., None]
    first = across(tangents)
    turns = np.stack([first, np.cross(tangents, first)], axis=-1)  # (A, E, 3, 2)
    seen, image_length = _movement_across(rig, vertices, turns, length)
    information = np.swapaxes(seen, -1, -2) @ (image_length[..., None] * seen) / (sigma_px**2 * correlation_px)
    bending = (np.linalg.norm(np.diff(tangents, axis=1), axis=-1) ** 2 * 2.0 / (length[:, :-1] + length[:, 1:])).sum(axis=1)
    temperature = np.maximum(2.0 * bending / information.shape[-1], LEAST_BENDING / length.sum(axis=1))
    covariance = np.linalg.inv(information + bending_hessian(turns, length) / temperature[:, None, None])
    moved = _vertex_movement(turns, length)  # (A, V, 3, P)
    variance = np.einsum("avxp,apq,avxq->av", moved, covariance, moved, optimize=True)
    return np.sqrt(np.maximum(variance, 0.0) / 3)


def point_sigma(rig: Rig, points: np.ndarray, sigma_px: float) -> np.ndarray:
    """(...) mm: standard deviation of ``points`` (..., 3) that each camera sees with an error of ``sigma_px``, root mean square
    over the coordinates; infinite where one camera alone sees them."""
    ahead = STEP_MM * np.eye(3)
    points = np.asarray(points)[..., None, :]
    jacobian = (rig.project(points + ahead) - rig.project(points - ahead)) / (2 * STEP_MM)  # (C, ..., 3, 2)
    information = np.nan_to_num(np.einsum("c...xu,c...yu->...xy", jacobian, jacobian)) / sigma_px**2
    sizes = np.linalg.eigvalsh(information)
    variance = (1.0 / np.maximum(sizes, 1e-100)).mean(axis=-1)
    return np.where(sizes[..., 0] > 1e-12 * sizes[..., -1], np.sqrt(variance), np.inf)


def _vertex_movement(turns: np.ndarray, length: np.ndarray) -> np.ndarray:
    """(A, V, 3, P) mm per rad: derivative of each vertex by turns of the edges."""
    rods, edges = length.shape
    each = length[..., None, None] * turns
    before = np.tri(edges + 1, edges, -1)
    moved = before[None, :, :, None, None] * each[:, None]
    return np.moveaxis(moved[:, :, 1:], 2, 3).reshape(rods, edges + 1, 3, 2 * (edges - 1))


def _movement_across(rig: Rig, vertices: np.ndarray, turns: np.ndarray, length: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """((A, C S, P) px per rad: movement of places of the rod's images across these; (A, C S) px: length of image per place)."""
    rods, edges = length.shape
    moved = _vertex_movement(turns, length)
    rows, shares = [], []
    for part in PLACES:
        place = (1 - part) * vertices[:, :-1] + part * vertices[:, 1:]
        motion = (1 - part) * moved[:, :-1] + part * moved[:, 1:]  # (A, E, 3, P)
        ahead = STEP_MM * np.eye(3)
        jacobian = (rig.project(place[:, :, None] + ahead) - rig.project(place[:, :, None] - ahead)) / (2 * STEP_MM)
        along = np.einsum("caexu,aex->caeu", jacobian, np.diff(vertices, axis=1))
        pixels = np.linalg.norm(along, axis=-1)
        normal = np.stack([-along[..., 1], along[..., 0]], axis=-1) / np.maximum(pixels, 1e-9)[..., None]
        rows.append(np.einsum("caexu,caeu,aexp->acep", jacobian, normal, motion, optimize=True))
        shares.append(np.swapaxes(pixels, 0, 1) / len(PLACES))
    across_image, share = np.stack(rows, axis=3), np.stack(shares, axis=3)
    # Places that a camera cannot see do not count.
    blind = ~(np.isfinite(across_image).all(axis=-1) & np.isfinite(share))
    across_image[blind], share[blind] = 0.0, 0.0
    return across_image.reshape(rods, -1, across_image.shape[-1]), share.reshape(rods, -1)


def bending_hessian(turns: np.ndarray, length: np.ndarray) -> np.ndarray:
    """(A, P, P) 1/mm: second derivative of Σ |κb|²/l̄, with κb as the difference of tangents."""
    rods, edges = length.shape
    joint = 2.0 / (length[:, :-1] + length[:, 1:])
    diagonal, beside = np.zeros((rods, edges)), -joint
    diagonal[:, :-1] += joint
    diagonal[:, 1:] += joint
    blocks = np.zeros((rods, edges, 2, edges, 2))
    every = np.arange(edges)
    blocks[:, every, :, every, :] = np.moveaxis(diagonal[..., None, None] * np.eye(2), 1, 0)
    product = beside[..., None, None] * np.swapaxes(turns[:, :-1], -1, -2) @ turns[:, 1:]
    blocks[:, every[:-1], :, every[1:], :] = np.moveaxis(product, 1, 0)
    blocks[:, every[1:], :, every[:-1], :] = np.moveaxis(np.swapaxes(product, -1, -2), 1, 0)
    return blocks[:, 1:, :, 1:].reshape(rods, 2 * (edges - 1), 2 * (edges - 1))
