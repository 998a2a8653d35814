"""What the rods of each cell of a grid add up to: all that a summary and a picture need of them.

Axes: G grid cells, N terms of the objective, n rods that are added at once.
"""

import numpy as np

from doo_ti.types import Status


class CellSums:
    """Sums over the rods of each cell, to which rods are added in portions of any size: memory grows with G and N, not with
    their product.

    weight   (N,) w_xy of the terms whose rods were added, ones under Eq. 2
    compared (N,) bool: terms whose rod is sound in some cell. The others say nothing and are left out
    count    (G,) rods that were added
    status   (S,) rods of each Status
    stable   certified rods; jumped: those that fell to another branch
    """

    def __init__(self, cells: int, terms: int):
        self.weight, self.compared = np.ones(terms), np.zeros(terms, dtype=bool)
        self.count, self._sound = np.zeros(cells, dtype=np.int32), np.zeros(cells, dtype=np.int32)
        self._distance, self._weight = np.zeros(cells), np.zeros(cells)
        self.status = np.zeros(len(Status), dtype=np.int64)
        self.stable = self.jumped = 0

    def add(self, cell: np.ndarray, term: np.ndarray, rods: dict[str, np.ndarray]) -> None:
        """Add rods (n,), each of a cell and a term; ``rods`` holds columns by name, as a sweep stores them.

        A cell's rods are added up term by term, in whatever order they come.
        """
        order = np.argsort(cell * np.int64(len(self.weight)) + term, kind="stable")
        cell, term = cell[order], term[order]
        distance, status, stable = (rods[name][order] for name in ("distance_mm", "status", "stable"))
        if "pair_weight" in rods:
            self.weight[term] = rods["pair_weight"][order]
            self.jumped += int((rods["jumps"] > 0).sum())
        self.status += np.bincount(status, minlength=len(self.status))
        self.stable += int(stable.sum())
        np.add.at(self.count, cell, 1)
        sound = is_sound(distance, status, stable)
        cell, term = cell[sound], term[sound]
        self.compared[term] = True
        np.add.at(self._sound, cell, 1)
        np.add.at(self._distance, cell, distance[sound] * self.weight[term])
        np.add.at(self._weight, cell, self.weight[term])

    @property
    def unsound(self) -> np.ndarray:
        """(G,) rods of the compared terms that are not sound: cells with any do not compete. Zero in cells without rods."""
        return np.where(self.count > 0, self.compared.sum() - self._sound, 0)

    @property
    def mean_distance(self) -> np.ndarray:
        """(G,) Eq. 2 or 3 over the compared terms, mm; NaN in cells that do not compete, since not all these rods are sound."""
        # A rod that is sound is of a compared term: where their numbers are equal, the sums are over all compared terms.
        whole = (self._sound == self.compared.sum()) & (self._sound > 0)
        return np.divide(self._distance, self.weight[self.compared].sum(), out=np.full(len(whole), np.nan), where=whole)

    @property
    def distance_of_sound(self) -> np.ndarray:
        """(G,) the same over the compared terms that are sound in each cell; NaN where none is. Cells are not comparable by
        it."""
        return np.divide(self._distance, self._weight, out=np.full(len(self._weight), np.nan), where=self._weight > 0)

def is_sound(distance: np.ndarray, status: np.ndarray, stable: np.ndarray) -> np.ndarray:
    """Whether rods converged to certified minima. The others lie anywhere, at their observation too."""
    return (status == Status.CONVERGED) & stable & np.isfinite(distance)


def status_counts(status: np.ndarray) -> dict[str, int]:
    """How many rods ended how, by the status's name, none left out but those that never occurred."""
    return counts_by_name(np.bincount(np.ravel(status), minlength=len(Status)))


def counts_by_name(counts: np.ndarray) -> dict[str, int]:
    """The same from the number of rods of each Status."""
    return {kind.name.lower(): int(counts[kind]) for kind in Status if counts[kind]}
