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
        for rods, *_ in self._parts:
            there[rods] = True
        return np.flatnonzero(~there)

    def forget(self, rods: np.ndarray) -> None:
        """Drop the equilibria of these rods, whose models have changed."""
        kept = [(part, ~np.isin(part[0], rods)) for part in self._parts]
        self._parts = [(own[stay], rows[stay], solution, vertices[stay])
                       for (own, rows, solution, vertices), stay in kept if stay.any()]

    def put(self, rods: np.ndarray, solution: Solution, rows: np.ndarray, vertices: np.ndarray) -> None:
        """Add the equilibria of these rods, which are missing: the ``rows`` of the solution, with the ``vertices`` (n, V, 3) of
        these rows."""
        if len(rods):
            self._parts.append((rods, rows, solution, vertices))

    def derivatives(self, parameters: tuple[str, ...], modes: np.ndarray | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(B, V, 3) vertices of the models, (B, V, 3, C) their derivatives as :func:`.sensitivity` has them, and (B,) whether a
        rod has any. No equilibrium may be missing."""
        whole = None
        for rods, rows, solution, vertices in self._parts:
            found = sensitivity(solution, parameters, modes, rotations=False, loads=False)
            usable = found.usable & np.isfinite(found.vertices[:, -1]).all(axis=(1, 2))  # none of taut rods
            if len(rows) == self._count:
                return vertices, found.vertices, usable
            own = vertices, found.vertices[rows], usable[rows]
            whole = whole or tuple(np.empty((self._count, *array.shape[1:]), dtype=array.dtype) for array in own)
            for array, part in zip(whole, own, strict=True):
                array[rods] = part
        return whole
