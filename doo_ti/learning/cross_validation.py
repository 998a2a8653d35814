"""Leave-one-out cross-validation over finished sweeps, Tables I to III (§V-B, §V-C), without new relaxations.

Axes: G grid cells, P parts of a table, N terms of a part, K tested terms. A term is an observation under Eq. 2, a pair of
observations under Eq. 3.
"""

from dataclasses import dataclass

import numpy as np

from doo_ti.learning.partition import Part, Partition

BLOCK_BYTES = 64 << 20
"""Memory for the sums of one block of tested terms."""
_PARTS_PER_MM = 2.0**32
_UNUSABLE = 1e300


@dataclass(frozen=True)
class Scores:
    """One table: each row a training set, each column a test set, both the parts of a partition.

    partition       the P parts
    best            (P,) cell that the whole training set chooses; −1 where none has all its errors
    training        (P,) mean distance there, mm
    mean            (P, P) mean distance of the tested terms (Eq. 1), mm; NaN where none has a score
    standard_error  (P, P) of that mean, mm; NaN below two terms
    count           (P, P) tested terms that have a score
    left_out        (P, P) those that have none: no distance at their cell, or no training terms are left without them
    uncertified     (P, P) scored rods that are no certified minima
    jumped          (P, P) scored rods that jumped to another branch (Eq. 3)
    """

    partition: Partition
    best: np.ndarray
    training: np.ndarray
    mean: np.ndarray
    standard_error: np.ndarray
    count: np.ndarray
    left_out: np.ndarray
    uncertified: np.ndarray
    jumped: np.ndarray

    @property
    def is_best(self) -> np.ndarray:
        """(P, P) the smallest mean of each column, among the entries that score most of its terms, and of those the ones with
        the fewest rods that are no certified minima: leaving terms out, or scoring such rods, is no advantage."""
        return self._eligible & (self.mean == self._lowest)

    @property
    def is_near(self) -> np.ndarray:
        """(P, P) the other entries within one standard error of the best entry of their column."""
        error = np.where(self.is_best, self.standard_error, np.inf).min(axis=0)
        reach = self._lowest + np.where(np.isfinite(error), error, 0.0)
        return self._eligible & ~self.is_best & (self.mean <= reach)

    @property
    def _eligible(self) -> np.ndarray:
        most = (self.count > 0) & (self.count == self.count.max(axis=0))
        return most & (self.uncertified == np.where(most, self.uncertified, np.iinfo(int).max).min(axis=0))

    @property
    def _lowest(self) -> np.ndarray:
        return np.where(self._eligible, self.mean, np.inf).min(axis=0)


def cross_validate(partition: Partition) -> Scores:
    """Train on each part, test on each: for every tested term the Θ of :func:`chosen_cells`, its error under that Θ in the
    test set's landscape; the mean and its standard error, sd/√n with n − 1 in sd where all weights are one.
    """
    parts = partition.parts
    size = (len(parts), len(parts))
    mean, standard_error = np.full(size, np.nan), np.full(size, np.nan)
    count, left_out, uncertified, jumped = (np.zeros(size, dtype=int) for _ in range(4))
    best, training = np.full(len(parts), -1), np.full(len(parts), np.nan)
    starts = np.cumsum([len(part.terms) for part in parts])[:-1]
    ends = np.concatenate([part.ends for part in parts])
    nothing = np.full((1, 2), -1)  # one more tested term, for which no training term is left out
    for row, learned in enumerate(parts):
        *chosen, best[row] = chosen_cells(learned, np.concatenate([ends, nothing]))
        if best[row] >= 0:
            terms = learned.measurable.terms
            training[row], _ = _mean(learned.landscape.distance[best[row], terms], learned.landscape.weight[terms])
        for column, (tested, cells) in enumerate(zip(parts, np.split(np.array(chosen), starts), strict=True)):
            distance = np.where(cells >= 0, tested.landscape.distance[cells, tested.terms], np.nan)
            scored = np.isfinite(distance)
            mean[row, column], standard_error[row, column] = _mean(
                distance[scored], tested.landscape.weight[tested.terms[scored]])
            count[row, column], left_out[row, column] = scored.sum(), (~scored).sum()
            uncertified[row, column] = (scored & ~tested.certified(cells)).sum()
            jumped[row, column] = (scored & tested.jumped(cells)).sum()
    return Scores(partition, best, training, mean, standard_error, count, left_out, uncertified, jumped)


def chosen_cells(training: Part, tested: np.ndarray) -> np.ndarray:
    """(K,) for each tested term the cell with the smallest mean error of the training set without it; the first of equal
    ones, and −1 where nothing is left to train on or no cell is usable.

    tested  (K, 2) the observations of each tested term; −1 for none

    Every training term that shares an observation with the tested term is left out: of a static training set the tested
    observation, or both of a tested pair; of a dynamic one every pair with either of them. Observations are identified by their
    numbers, whatever the material or objective. A term that is kept, and whose rod is no certified minimum in a cell, makes
    that cell unusable; a term whose rod is a certified minimum in no cell is not used.
    """
    training = training.measurable
    landscape, terms = training.landscape, training.terms
    share = landscape.weight[terms] / landscape.weight[terms].max(initial=0.0)
    # Sums of whole numbers are exact in any order: equal cells are equal on every machine.
    error = np.rint(landscape.distance[:, terms] * (share * _PARTS_PER_MM))
    error[~landscape.sound[:, terms]] = _UNUSABLE
    # Tested terms for which the same training terms are left out are computed once.
    ends = np.sort(np.where(np.isin(tested, training.ends), tested, -1), axis=1)
    ends, of_tested = np.unique(ends, axis=0, return_inverse=True)
    cells = np.full(len(ends), -1)
    step = max(1, BLOCK_BYTES // (8 * len(error) + 16 * len(terms)))
    for first in range(0, len(ends), step):
        block = slice(first, first + step)
        kept = ~(ends[block, None, :, None] == training.ends[None, :, None, :]).any(axis=(2, 3))
        total = kept.astype(np.float64) @ error.T
        usable = kept.any(axis=1) & (total.min(axis=1) < _UNUSABLE)
        cells[block] = np.where(usable, total.argmin(axis=1), -1)
    return cells[of_tested.ravel()]


def _mean(distance: np.ndarray, weight: np.ndarray) -> tuple[float, float]:
    """The weighted mean of (n,) distances and its standard error; sd/√n where all weights are equal."""
    count = len(distance)
    if not count:
        return np.nan, np.nan
    mean = (weight * distance).sum() / weight.sum()
    if count < 2:
        return mean, np.nan
    spread = (weight**2 * (distance - mean) ** 2).sum()
    return mean, np.sqrt(count / (count - 1) * spread) / weight.sum()
