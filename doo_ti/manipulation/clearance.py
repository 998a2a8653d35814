"""Whether rods keep clear of obstacles, at rest and on the way between two shapes. Axes: R rods, V vertices."""

from dataclasses import dataclass

import numpy as np

from doo_ti.contact.surroundings import Surroundings

CLEAR = 2e-3
"""Of the rod's length, to obstacles: as near as equilibria are told apart."""
NEAR = 0.03
"""Of the rod's length: gaps that are larger are measured at vertices only, as a lower bound."""


@dataclass(frozen=True)
class Clearance:
    """What is around rods of one kind, ``surroundings`` of one row, and their ``length`` in mm and ``edges``."""

    surroundings: Surroundings
    length: float
    edges: int

    def around(self, count: int) -> Surroundings:
        """The surroundings of ``count`` rods."""
        return self.surroundings.take(np.zeros(count, dtype=np.int64))

    def of(self, vertices: np.ndarray) -> np.ndarray:
        """(R,) mm by which rods (R, V, 3) are further than CLEAR from all obstacles, at least; infinite without any."""
        if not self.surroundings:
            return np.full(len(vertices), np.inf)
        margin = CLEAR * self.length
        gap = self._gap(vertices, places=2) - 0.5 * self.length / self.edges - margin
        near = np.flatnonzero(gap < NEAR * self.length)
        if len(near):
            gap[near] = self._gap(vertices[near]) - margin
        return gap

    def between(self, before: np.ndarray, after: np.ndarray, gap_before: np.ndarray, gap_after: np.ndarray) -> np.ndarray:
        """(R,) bool: whether rods that move from ``before`` to ``after`` (R, V, 3), each vertex along a line, keep clear; gaps
        (R,) of both.

        A rod that moves by less than both gaps together touches nothing; else it is halved (conservative advancement).
        """
        clear = (gap_before > 0) & (gap_after > 0)
        travel = np.linalg.norm(after - before, axis=-1).max(axis=1)
        rows = np.flatnonzero(clear & (travel > gap_before + gap_after + 2 * CLEAR * self.length))
        if len(rows):
            middle = 0.5 * (before[rows] + after[rows])
            gap = self.of(middle)
            clear[rows] = (self.between(before[rows], middle, gap_before[rows], gap)
                           & self.between(middle, after[rows], gap, gap_after[rows]))
        return clear

    def _gap(self, vertices: np.ndarray, **places: int) -> np.ndarray:
        return np.nan_to_num(self.around(len(vertices)).smallest_gap(vertices, **places), nan=-np.inf)
