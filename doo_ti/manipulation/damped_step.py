"""The step of damped least squares of a given longest length (Levenberg, Marquardt), for B rods at once."""

import numpy as np

LEAST_DAMPING = 1e-4
"""mm² by which the square of the rod's displacement must grow with a gripper's move of 1 mm: moves that change less are damped.
Ten times as much leaves small rotations undone, a tenth follows the noise of the marks."""
HALVINGS = 40
MOST_DAMPING = 1e8


class DampedSteps:
    """min |e − J u|² + λ |u|² over u, with λ so large that |u| ≤ a given length.

    normal    (B, K, K) JᵀJ
    gradient  (B, K) Jᵀe
    """

    def __init__(self, normal: np.ndarray, gradient: np.ndarray):
        self._normal, self._gradient = normal, gradient
        values, self._vectors = np.linalg.eigh(normal)
        self._values = np.maximum(values, 0.0)
        # Products of single matrices, so that the rounding of a rod does not depend on how many others there are.
        self._along = (np.swapaxes(self._vectors, 1, 2) @ gradient[..., None])[..., 0]

    def within(self, length: np.ndarray) -> np.ndarray:
        """(B, K) the steps of at most ``length`` (B,), zero where that is."""
        low, high = np.full(len(length), np.log(LEAST_DAMPING)), np.full(len(length), np.log(MOST_DAMPING))
        fits = np.linalg.norm(self._along / (self._values + LEAST_DAMPING), axis=1) <= length
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            short = np.linalg.norm(self._along / (self._values + np.exp(middle)[:, None]), axis=1) <= length
            low, high = np.where(short, low, middle), np.where(short, middle, high)
        damping = np.where(fits, LEAST_DAMPING, np.exp(high))[:, None]
        step = (self._vectors @ (self._along / (self._values + damping))[..., None])[..., 0]
        return np.where(length[:, None] > 0, step, 0.0)

    def below(self, length: np.ndarray, across: np.ndarray, room: np.ndarray) -> np.ndarray:
        """(B, K) the steps of at most ``length`` (B,) whose product with ``across`` (B, K) is at most ``room`` (B,): where that
        of :meth:`within` is more, the best of those that have just that (one active constraint)."""
        step = self.within(length)
        rows = np.flatnonzero(np.sum(across * step, axis=1) > room)
        if len(rows):
            size = np.linalg.norm(across[rows], axis=1, keepdims=True)
            unit, fixed = across[rows] / size, room[rows, None] / size
            along = np.eye(across.shape[1]) - unit[:, :, None] * unit[:, None]
            normal = self._normal[rows]
            left = self._gradient[rows] - (normal @ (fixed * unit)[..., None])[..., 0]
            rest = DampedSteps(along @ normal @ along, (along @ left[..., None])[..., 0]).within(
                np.sqrt(np.maximum(length[rows] ** 2 - fixed[:, 0] ** 2, 0.0)))
            step[rows] = np.where(length[rows, None] > 0, rest + fixed * unit, 0.0)
        return step
