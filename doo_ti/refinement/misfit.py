"""How far rods are from what was observed, and how that changes with their parameters.

Two measures, with their derivatives by way of :mod:`doo_ti.refinement.sensitivity`: Eq. 1's distance, and the sum of squares

    χ² = Σ_i |x_i − x_i'|²/σ_i² + Σ_j w_m² |m1_j − m1_j'|²/σ_j²

over the marks and frames that say something about Θ: seen, and not held by a clamp. σ_j is that of the edge's two marks, as a
root mean square. Eq. 1 says how good a fit is, χ² has the smooth minimum and the statistics.
"""

from dataclasses import dataclass

import numpy as np

from doo_ti.dataset import Observations
from doo_ti.refinement.sensitivity import Sensitivity
from doo_ti.types import Clamp, Clamps, Configuration


@dataclass(frozen=True)
class Misfit:
    """What was observed, and what of it counts how much.

    vertices       (D, V, 3) mm, zero where nothing was seen
    directors      (D, E, 3) m1, or None where frames do not count
    vertex_weight  (D, V) 1/σ_i, zero where a mark does not count; ones where σ is not known
    frame_weight   (D, E) w_m/σ_j, or None
    """

    vertices: np.ndarray
    directors: np.ndarray | None
    vertex_weight: np.ndarray
    frame_weight: np.ndarray | None

    @property
    def numbers(self) -> np.ndarray:
        """(D,) how many independent numbers count: three of a mark, two of a director."""
        marks = 3 * (self.vertex_weight > 0).sum(axis=1)
        return marks if self.frame_weight is None else marks + 2 * (self.frame_weight > 0).sum(axis=1)

    def residuals(self, configuration: Configuration) -> np.ndarray:
        """(D, N) weighted differences of the rods from the observations, N = 3 V (+ 3 E)."""
        parts = [self.vertex_weight[..., None] * (configuration.vertices - self.vertices)]
        if self.directors is not None:
            parts.append(self.frame_weight[..., None] * (configuration.frames[..., 1] - self.directors))
        return np.concatenate([part.reshape(len(part), -1) for part in parts], axis=1)

    def derivatives(self, sensitivity: Sensitivity) -> np.ndarray:
        """(D, N, P) of :meth:`residuals` by the columns of ``sensitivity``."""
        parts = [self.vertex_weight[..., None, None] * sensitivity.vertices]
        if self.directors is not None:
            parts.append(self.frame_weight[..., None, None] * sensitivity.directors)
        return np.concatenate([part.reshape(len(part), -1, part.shape[-1]) for part in parts], axis=1)


def misfit(observations: Observations, clamps: Clamps, frame_weight: float = 0.0) -> Misfit:
    """What of ``observations`` counts under ``clamps``. frame_weight: w_m in mm, as in Eq. 1."""
    counts = observations.valid & ~_held_vertices(observations, clamps)
    sigma = np.ones(counts.shape) if observations.sigma is None else np.broadcast_to(observations.sigma, counts.shape)
    vertices = np.where(observations.valid[..., None], observations.vertices, 0.0)
    weight = np.where(counts, 1.0 / np.where(counts, sigma, 1.0), 0.0)
    if frame_weight <= 0:
        return Misfit(vertices, None, weight, None)
    frames = np.full((observations.count, observations.edges), frame_weight)
    frames[np.broadcast_to(clamps.start, observations.count) == Clamp.FRAME, 0] = 0.0
    frames[np.broadcast_to(clamps.end, observations.count) == Clamp.FRAME, -1] = 0.0
    seen = np.where(observations.valid, sigma, 1.0)
    frames /= np.sqrt(0.5 * (seen[:, 1:] ** 2 + seen[:, :-1] ** 2))
    return Misfit(vertices, observations.frames[..., 1], weight, frames)


def _held_vertices(observations: Observations, clamps: Clamps) -> np.ndarray:
    """(D, V) bool: a position clamp holds the last vertex of its end, a clamp that also holds the tangent the last two."""
    held = np.zeros(observations.valid.shape, dtype=bool)
    for kind, outer, inner in ((clamps.start, 0, 1), (clamps.end, -1, -2)):
        held[:, outer] = np.asarray(kind) >= Clamp.POSITION
        held[:, inner] |= np.asarray(kind) >= Clamp.TANGENT
    return held


def distance_gradient(sensitivity: Sensitivity, observations: Observations, frame_weight: float = 0.0) -> np.ndarray:
    """(D, P) derivative of Eq. 1, mm per unit of each column, of rods that belong to ``observations`` one to one.

    Where a mark is met exactly its distance has no derivative; it counts as zero.
    """
    valid, rods = observations.valid, sensitivity.configuration
    apart = np.where(valid[..., None], rods.vertices - np.where(valid[..., None], observations.vertices, 0.0), 0.0)
    total = np.einsum("dvk,dvkp->dp", _unit(apart), sensitivity.vertices) / (valid.sum(axis=1) - 1)[:, None]
    if frame_weight > 0:
        turned = rods.frames[..., 1] - observations.frames[..., 1]
        share = frame_weight / (observations.edges - 1)
        total += share * np.einsum("dek,dekp->dp", _unit(turned), sensitivity.directors)
    return total


def _unit(vector: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(vector, axis=-1, keepdims=True)
    return np.divide(vector, length, out=np.zeros_like(vector), where=length > 0)
