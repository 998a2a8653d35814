r"""The objective over Θ: Eqs. 2 and 3 of §III-E, summed over the relaxed rods of each grid cell.

    Eq. 2, static     f(Θ) = Σ_x    w_x  d(Γ̃^x,  Γ^x) / Σ_x    w_x       Γ̃^x  = F(Γ^x, E_Θ, C^x),   w_x = 1
    Eq. 3, dynamic    f(Θ) = Σ_{xy} w_xy d(Γ̃^xy, Γ^y) / Σ_{xy} w_xy      Γ̃^xy = F(Γ̃^x, E_Θ, C^y)

Γ^x are the observations and C^x their clamps, d is Eq. 1 in mm (:mod:`doo_ti.rod.metric`), and F relaxes a rod
(:mod:`doo_ti.learning.cells`). A term is an observation x under Eq. 2, and a pair (x, y) under Eq. 3: its clamps move from C^x
to C^y. Both are divided by the sum of the weights, so that f is a mean distance in mm, with the same minimum. Only
certified minima are compared: the distance of a rod that did not converge does not depend on Θ alone.

Axes: G grid cells, N terms, n rods that are added at once.
"""

import numpy as np

from doo_ti.rod.types import Status


class CellSums:
    """Both sums of Eq. 2 or 3 for each cell. Rods are added in portions of any size and order; memory grows with G + N, not
    with G · N.

    weight   (N,) w_xy of the terms whose rods were added, ones under Eq. 2
    compared (N,) bool: terms whose rod is sound in some cell. The others are left out of the sums in all cells
    count    (G,) rods added
    status   (S,) rods of each Status
    stable   certified rods; jumped: rods that jumped to another branch
    """

    def __init__(self, cells: int, terms: int):
        self.weight, self.compared = np.ones(terms), np.zeros(terms, dtype=bool)
        self.count, self._sound = np.zeros(cells, dtype=np.int32), np.zeros(cells, dtype=np.int32)
        self._distance, self._weight = np.zeros(cells), np.zeros(cells)
        self.status = np.zeros(len(Status), dtype=np.int64)
        self.stable = self.jumped = 0

    def add(self, cell: np.ndarray, term: np.ndarray, rods: dict[str, np.ndarray]) -> None:
        """Add rods (n,) of cells and terms; ``rods`` holds the columns of a sweep's files by name.

        The rods of a cell are added in the order of their terms, whatever order they are given in.
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
        np.add.at(self._distance, cell, distance[sound] * self.weight[term])  # Σ w_xy d
        np.add.at(self._weight, cell, self.weight[term])                      # Σ w_xy

    @property
    def unsound(self) -> np.ndarray:
        """(G,) rods of the compared terms that are not sound: cells with any do not compete. Zero in cells without rods."""
        return np.where(self.count > 0, self.compared.sum() - self._sound, 0)

    @property
    def mean_distance(self) -> np.ndarray:
        """(G,) f(Θ) in mm over the compared terms; NaN in cells that do not compete, where not all these rods are sound."""
        # A sound rod is of a compared term: where their numbers are equal, the sums run over all compared terms.
        whole = (self._sound == self.compared.sum()) & (self._sound > 0)
        return np.divide(self._distance, self.weight[self.compared].sum(), out=np.full(len(whole), np.nan), where=whole)

    @property
    def distance_of_sound(self) -> np.ndarray:
        """(G,) the same over those compared terms that are sound in the cell; NaN where none is. Cells are not comparable by
        it."""
        return np.divide(self._distance, self._weight, out=np.full(len(self._weight), np.nan), where=self._weight > 0)


def is_sound(distance: np.ndarray, status: np.ndarray, stable: np.ndarray) -> np.ndarray:
    """Whether rods converged to certified minima. The distance of any other rod has no meaning, even if it is small."""
    return (status == Status.CONVERGED) & stable & np.isfinite(distance)


def status_counts(status: np.ndarray) -> dict[str, int]:
    """Number of rods of each status that occurs, by its name."""
    return counts_by_name(np.bincount(np.ravel(status), minlength=len(Status)))


def counts_by_name(counts: np.ndarray) -> dict[str, int]:
    """Names and numbers of rods from the number of rods of each Status."""
    return {kind.name.lower(): int(counts[kind]) for kind in Status if counts[kind]}
