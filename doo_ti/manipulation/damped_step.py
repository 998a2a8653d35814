"""The step of damped least squares of a given longest length (Levenberg, Marquardt), for B rods at once."""

from dataclasses import dataclass

import numpy as np

from doo_ti.manipulation.dense_kernels import damped_steps, normal_equations
from doo_ti.manipulation.targets import ServoOptions, Targets


@dataclass(frozen=True)
class DampedSteps:
    """min |e − J u|² + λ |u|² over u, with λ so large that |u| ≤ a given length.

    normal    (B, K, K) JᵀJ
    gradient  (B, K) Jᵀe
    """

    normal: np.ndarray
    gradient: np.ndarray

    @classmethod
    def towards(cls, targets: Targets, shapes: np.ndarray, columns: np.ndarray, first: int, options: ServoOptions
                ) -> "DampedSteps":
        """Steps of the grippers, in mm, that bring ``shapes`` (B, V, 3) to their targets; the twelve ``columns`` (B, V, 3, C)
        from ``first`` on are the derivatives of the shapes by the grippers' coordinates."""
        normal, gradient = normal_equations(columns, first, len(options.scale), targets.shares, targets.places - shapes)
        unit = options.moves / options.scale
        return cls(normal * np.outer(unit, unit), gradient * unit)

    def within(self, length: np.ndarray) -> np.ndarray:
        """(B, K) the steps of at most ``length`` (B,), zero where that is."""
        return damped_steps(self.normal, self.gradient, length, np.zeros_like(self.gradient), np.zeros_like(length))

    def below(self, length: np.ndarray, across: np.ndarray, room: np.ndarray) -> np.ndarray:
        """(B, K) the steps of at most ``length`` (B,) whose product with ``across`` (B, K) is at most ``room`` (B,): where that
        of :meth:`within` is more, the best of those that have just that (one active constraint)."""
        return damped_steps(self.normal, self.gradient, length, across, room)
