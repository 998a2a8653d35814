"""Normal equations of many rods, and steps u of damped least squares (Levenberg, Marquardt): min |e − J u|² + λ |u|².

λ is so large that |u| is at most a given length, and a·u = c where a·u would be more (one active constraint). Newton's method
finds it, on 1/|u| − 1/length, which is nearly linear in λ and grows with it (Hebden, 1973): from below it never steps too far.
Where the constraint holds, only the part of u across it, r = u − c a/|a|², becomes shorter as λ grows.

Axes: B rods, V vertices, K unknowns of each.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

LEAST_DAMPING = 1e-4
"""mm² by which the square of the rod's displacement must grow with a gripper's move of 1 mm: moves that change less are damped.
Ten times as much leaves small rotations undone, a tenth follows the noise of the marks."""
ITERATIONS, CLOSE = 50, 1e-6
"""The search for the damping ends when a step's length is right to the share CLOSE, usually within ten iterations, or after
ITERATIONS."""
LEAST_LENGTH = 1e-12  # mm, in place of zero in that search


def normal_equations(columns: np.ndarray, weight: np.ndarray, residual: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(B, K, K) JᵀWJ and (B, K) JᵀWr of ``columns`` J (B, V, 3, K), ``weight`` (B, V) and r = ``residual`` (B, V, 3)."""
    root, shape = np.sqrt(weight)[..., None], (len(columns), 3 * weight.shape[1], columns.shape[-1])
    rows, right = (root[..., None] * columns).reshape(shape), (root * residual).reshape(*shape[:2], 1)
    across = np.swapaxes(rows, 1, 2)
    return across @ rows, (across @ right)[..., 0]


@dataclass(frozen=True)
class DampedSteps:
    """The least squares of B rods."""

    normal: np.ndarray  # (B, K, K) JᵀJ
    gradient: np.ndarray  # (B, K) Jᵀe

    @cached_property
    def _axes(self) -> tuple[np.ndarray, np.ndarray]:
        """(B, K) eigenvalues of JᵀJ, and (B, K, K) their vectors."""
        values, axes = np.linalg.eigh(self.normal)
        return np.maximum(values, 0.0), axes  # beside a very large one, as of a rod at a fold, others are its rounding

    def below(self, length: np.ndarray, across: np.ndarray, room: np.ndarray) -> np.ndarray:
        """(B, K) the steps of at most ``length`` (B,), zero where that is, whose product with ``across`` a (B, K) is at most
        ``room`` c (B,): where it would be more, the best of those that have just that."""
        values, axes = self._axes
        gradient, across = ((vectors[:, None] @ axes)[:, 0] for vectors in (self.gradient, across))
        steps = _shortened(values, gradient, length, 0.0 * across, 0.0 * room)
        active = np.flatnonzero(_dot(across, steps) > room)
        if len(active):
            across, room = across[active], room[active]
            place = room / np.maximum(_dot(across, across), 1e-30)
            longest = np.sqrt(np.maximum(length[active] ** 2 - place * room, 0.0))
            steps[active] = _shortened(values[active], gradient[active], longest, across, place) + place[:, None] * across
        return np.where(length[:, None] > 0, (axes @ steps[..., None])[..., 0], 0.0)


def _shortened(values: np.ndarray, gradient: np.ndarray, longest: np.ndarray, across: np.ndarray, place: np.ndarray
               ) -> np.ndarray:
    """(B, K) r, in the axes in which JᵀJ has the ``values`` (B, K), at most ``longest`` (B,). Without constraint ``across`` and
    ``place``, c/|a|², are zero."""
    longest, damping = np.maximum(longest, LEAST_LENGTH), np.full(len(values), LEAST_DAMPING)
    for _ in range(ITERATIONS):
        soft = 1.0 / (values + damping[:, None])
        step, along = soft * gradient, soft * across
        share = 1.0 / np.maximum(_dot(across, along), 1e-300)
        step -= (share * (_dot(across, step) - place * _dot(across, across)))[:, None] * along
        rest = step - place[:, None] * across
        size = np.maximum(np.sqrt(_dot(rest, rest)), 1e-30)
        longer = size > (1.0 + CLOSE) * longest
        if not longer.any():
            break
        turned = soft * step
        turned -= (share * _dot(across, turned))[:, None] * along
        damping += np.where(longer, (size / longest - 1.0) * size**2 / np.where(longer, _dot(rest, turned), 1.0), 0.0)
    return rest / np.maximum(size / longest, 1.0)[:, None]


def _dot(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """(B,) the products of two vectors of each rod."""
    return np.sum(one * other, axis=1)
