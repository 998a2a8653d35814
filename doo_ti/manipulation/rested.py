"""Equilibria that the last step of a servo computed: their derivatives are taken without relaxing the models again.

Axes: B rods, V vertices, C columns of derivatives.
"""

import numpy as np

from doo_ti.relaxation.sensitivity import sensitivity
from doo_ti.rod.types import Solution


class Rested:
    """Equilibria of B rods. That of a rod is a row of one of several solutions, or is missing."""

    def __init__(self, count: int):
        self._count, self._parts = count, []

    @property
    def missing(self) -> np.ndarray:
        """Numbers of the rods without an equilibrium."""
        there = np.zeros(self._count, dtype=bool)
        for rods, _, _ in self._parts:
            there[rods] = True
        return np.flatnonzero(~there)

    def forget(self, rods: np.ndarray) -> None:
        """Drop the equilibria of these rods, whose models have changed."""
        kept = [(own, rows, solution, ~np.isin(own, rods)) for own, rows, solution in self._parts]
        self._parts = [(own[stay], rows[stay], solution) for own, rows, solution, stay in kept if stay.any()]

    def put(self, rods: np.ndarray, solution: Solution, rows: np.ndarray) -> None:
        """Add the equilibria of these rods, which are missing: the ``rows`` of the solution."""
        if len(rods):
            self._parts.append((rods, rows, solution))

    def derivatives(self, parameters: tuple[str, ...], modes: np.ndarray | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(B, V, 3) vertices of the models, (B, V, 3, C) their derivatives as :func:`.sensitivity` has them, and (B,) whether a
        rod has any. No equilibrium may be missing."""
        whole = None
        for rods, rows, solution in self._parts:
            found = sensitivity(solution, parameters, modes, rotations=False, loads=False)
            usable = found.usable & np.isfinite(found.vertices[:, -1]).all(axis=(1, 2))  # none of taut rods
            own = solution.configuration.vertices, found.vertices, usable
            if len(rows) == self._count:
                return own
            whole = whole or tuple(np.empty((self._count, *array.shape[1:]), dtype=array.dtype) for array in own)
            for array, part in zip(whole, own, strict=True):
                array[rods] = part[rows]
        return whole
