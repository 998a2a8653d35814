"""The step of damped least squares of a given longest length (Levenberg, Marquardt), for B rods at once."""

import numpy as np

from doo_ti.manipulation.targets import ServoOptions, Targets

LEAST_DAMPING = 1e-4
"""mm² by which the square of the rod's displacement must grow with a gripper's move of 1 mm: moves that change less are damped.
Ten times as much leaves small rotations undone, a tenth follows the noise of the marks."""
ITERATIONS, CLOSE = 50, 1e-9
"""The search for the damping ends when a step's length is right to the share CLOSE, usually within ten iterations, or after
ITERATIONS."""
LEAST_LENGTH = 1e-12
"""mm, in place of zero in that search."""


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

    @classmethod
    def towards(cls, targets: Targets, shapes: np.ndarray, columns: np.ndarray, options: ServoOptions) -> "DampedSteps":
        """Steps of the grippers, in mm, that bring ``shapes`` (B, V, 3) to their targets; ``columns`` (B, 3V, 12) are the
        derivatives of the shapes by the grippers' coordinates."""
        weight = np.sqrt(np.repeat(targets.shares, 3, axis=1))[..., None]
        weighed = columns * (weight * (options.moves / options.scale))
        across = np.swapaxes(weighed, 1, 2)
        return cls(across @ weighed, (across @ (weight * (targets.places - shapes).reshape(weight.shape)))[..., 0])

    def within(self, length: np.ndarray) -> np.ndarray:
        """(B, K) the steps of at most ``length`` (B,), zero where that is."""
        damping, longest = np.full(len(length), LEAST_DAMPING), np.maximum(length, LEAST_LENGTH)
        for _ in range(ITERATIONS):
            # Newton's method on 1/|u| - 1/length, which is nearly linear in the damping and grows with it (Hebden, 1973): from
            # below it never steps too far.
            steps = self._along / (self._values + damping[:, None])
            size = np.maximum(np.linalg.norm(steps, axis=1), 1e-300)
            longer = size > (1.0 + CLOSE) * longest
            if not longer.any():
                break
            slope = np.sum(steps**2 / (self._values + damping[:, None]), axis=1) / size**2
            damping = damping + np.where(longer, (size / longest - 1.0) / np.where(longer, slope, 1.0), 0.0)
        step = (self._vectors @ (self._along / (self._values + damping[:, None]))[..., None])[..., 0]
        excess = np.linalg.norm(step, axis=1) / longest
        return np.where(length[:, None] > 0, step / np.maximum(excess, 1.0)[:, None], 0.0)

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
