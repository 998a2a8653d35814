"""Leave-one-out cross-validation over finished sweeps, Tables I to III (§V-B, §V-C), without new relaxations: runs partitioned
into the rows and columns of a table, by material, objective and end distance, and the error of each part under the Θ of each
other.

Axes: G grid cells, P parts of a table, N terms of a part, K tested terms. A term is an observation under Eq. 2, a pair of
observations under Eq. 3.
"""

from dataclasses import dataclass, replace

import numpy as np

from doo_ti.learning.landscape import Landscape
from doo_ti.system.errors import InputError

FACTORS = ("material", "objective", "end-distance")  # what runs can be partitioned by, in the order in which a table lists it


@dataclass(frozen=True)
class Part:
    """Some terms of a landscape: one row and one column of a table."""

    label: str  # its name in the table, such as ``nylon 30 mm``
    landscape: Landscape  # the run that it is a part of
    terms: np.ndarray  # (N,) indices of the run's terms

    @property
    def ends(self) -> np.ndarray:
        """(N, 2) the observations of each term: the one it starts from, and the one it is compared with."""
        return np.stack([self.landscape.from_observation[self.terms], self.landscape.observation[self.terms]], axis=-1)

    @property
    def measurable(self) -> "Part":
        """The part without the terms whose rod is a certified minimum in no cell."""
        return replace(self, terms=self.terms[self.landscape.compared[self.terms]])

    def certified(self, cells: np.ndarray | int) -> np.ndarray:
        """(N,) whether the rod of each term is a certified minimum in the cell of that term, or in the one of all."""
        return self.landscape.sound[cells, self.terms]

    def jumped(self, cells: np.ndarray | int) -> np.ndarray:
        """(N,) whether the rod of each term jumped to another branch, in those cells; never under Eq. 2."""
        jumps = self.landscape.jumps
        return np.zeros(len(self.terms), dtype=bool) if jumps is None else jumps[cells, self.terms] > 0


@dataclass(frozen=True)
class Partition:
    """The rows and columns of one table."""

    by: tuple[str, ...]  # the factors in which the parts differ
    within: str  # the value of the other factors, the same in all parts, such as ``static``
    parts: tuple[Part, ...]  # two or more, over one grid
    unlabelled: int = 0  # terms that are in no part because their end distance is unknown


def check_comparable(landscapes: list[Landscape]) -> None:
    """Raise InputError unless all have the same grid, no two the same material and objective, and those of one material the
    same observations, judged by their numbers and end distances."""
    seen: dict[tuple[str, str], Landscape] = {}
    for landscape in landscapes:
        if landscape.grid.as_dict() != landscapes[0].grid.as_dict():
            raise InputError(landscape.run, "grid", f"another grid than that of {landscapes[0].run}",
                             "sweep all runs over the same axes")
        twin = seen.get((landscape.name, landscape.objective))
        if twin:
            raise InputError(landscape.run, "material", f"{landscape.objective} {landscape.name}, like {twin.run}",
                             "give one run of each material and objective")
        seen[landscape.name, landscape.objective] = landscape
    for (name, objective), landscape in seen.items():
        static = seen.get((name, "static"))
        if objective == "dynamic" and static and not _same_observations(landscape, static):
            raise InputError(landscape.run, "observation", f"other observations of {name} than those of {static.run}",
                             "sweep the same file under both objectives")


def usual_factors(landscapes: list[Landscape]) -> list[tuple[str, ...]]:
    """The factors of each table that these runs allow: the paper's, without the factors in which the runs do not differ.

    End distance is a factor only where the labels group the observations: on average two or more of each distance.
    """
    objectives = [landscape.objective for landscape in landscapes]
    labels = [landscape.end_distance[~np.isnan(landscape.end_distance)] for landscape in landscapes]
    distances = ("end-distance",) * any(1 < len(np.unique(label)) <= len(label) // 2 for label in labels)
    several_materials = len(set(objectives)) < len(objectives)
    both_objectives = len({landscape.name for landscape in landscapes}) < len(landscapes)
    tables = [("material",), ("material", *distances)] * several_materials + [("objective", *distances)] * both_objectives
    return list(dict.fromkeys(tables)) or [distances] * bool(distances)


def partition(landscapes: list[Landscape], by: tuple[str, ...], end_distances: tuple[float, ...] = ()) -> list[Partition]:
    """The tables by some factors: one for each value of the other factors, of the runs that differ in these.

    by             some of FACTORS
    end_distances  mm, those to select where ``by`` names end-distance; none: all that occur

    In a table of both objectives a static run keeps only the observations that occur in pairs (Table III). A pair belongs to
    the end distance of the observation it is compared with. Raises InputError as :func:`check_comparable` does, for unknown
    factors, for end distances that no observation has, and where there are not two parts.
    """
    check_comparable(landscapes)
    unknown = [factor for factor in by if factor not in FACTORS]
    if unknown or not by or len(set(by)) < len(by):
        problem = f"{','.join(by)!r} " + ("names a factor twice" if by and not unknown else "is no partition")
        raise InputError("partition", "by", problem, f"give some of {', '.join(FACTORS)}, joined by commas")
    by = tuple(factor for factor in FACTORS if factor in by)
    distances = _end_distances(landscapes, end_distances) if "end-distance" in by else None
    found = []
    for within, group in _groups(landscapes, by).items():
        parts, unlabelled = [], 0
        for landscape in group:
            terms = _terms_beside(landscape, group if "objective" in by else [])
            label = " ".join(_value(landscape, factor) for factor in by if factor != "end-distance")
            if distances is None:
                parts.append(Part(label, landscape, terms))
                continue
            unlabelled += int(np.isnan(landscape.end_distance[terms]).sum())
            for distance in distances:
                chosen = terms[landscape.end_distance[terms] == distance]
                if len(chosen):
                    parts.append(Part(f"{label} {distance:.10g} mm".lstrip(), landscape, chosen))
        if len(parts) > 1:
            found.append(Partition(by, within, tuple(parts), unlabelled))
    if not found:
        raise InputError("partition", "by", f"{','.join(by)} makes no table of two parts",
                         "give runs that differ in it, or partition by something else")
    return found


def _value(landscape: Landscape, factor: str) -> str:
    return {"material": landscape.name, "objective": landscape.objective}[factor]


def _groups(landscapes: list[Landscape], by: tuple[str, ...]) -> dict[str, list[Landscape]]:
    """The landscapes of each table by what its parts share, materials in the order given, static before dynamic; tables whose
    landscapes do not differ in each factor of ``by`` are left out."""
    fixed = [factor for factor in ("material", "objective") if factor not in by]
    materials = list(dict.fromkeys(landscape.name for landscape in landscapes))
    groups: dict[str, list[Landscape]] = {}
    for landscape in sorted(landscapes, key=lambda one: (materials.index(one.name), one.objective == "dynamic")):
        groups.setdefault(" ".join(_value(landscape, factor) for factor in fixed), []).append(landscape)
    differ = [factor for factor in ("material", "objective") if factor in by]
    return {within: group for within, group in groups.items()
            if all(len({_value(landscape, factor) for landscape in group}) > 1 for factor in differ)}


def _end_distances(landscapes: list[Landscape], wanted: tuple[float, ...]) -> list[float]:
    """``wanted``, or all that occur, ascending. Raises InputError for one that no observation has, and where none has any."""
    labels = np.concatenate([landscape.end_distance for landscape in landscapes])
    present = np.unique(labels[~np.isnan(labels)])
    if not len(present):
        raise InputError(landscapes[0].run, "end_distance_mm", "no observation has an end distance",
                         "partition by something else, or put end_distance_mm into the observations and sweep again")
    for distance in wanted:
        if distance not in present:
            raise InputError("partition", "end_distances", f"no observation at {distance:g} mm",
                             f"choose from {', '.join(f'{value:g}' for value in present)}")
    return sorted(set(wanted or present.tolist()))


def _terms_beside(landscape: Landscape, others: list[Landscape]) -> np.ndarray:
    """The terms of a landscape; of a static one, with a dynamic one of its material beside it, those that occur in pairs."""
    terms = np.arange(len(landscape.observation))
    if landscape.objective == "static":
        for other in others:
            if other.objective == "dynamic" and other.name == landscape.name:
                return terms[np.isin(landscape.observation, [other.observation, other.from_observation])]
    return terms


def _same_observations(dynamic: Landscape, static: Landscape) -> bool:
    """Whether the observations of pairs are among the static ones, with the same end distances."""
    if not np.isin([dynamic.observation, dynamic.from_observation], static.observation).all():
        return False
    order = np.argsort(static.observation)
    place = order[np.searchsorted(static.observation, dynamic.observation, sorter=order)]
    return np.array_equal(static.end_distance[place], dynamic.end_distance, equal_nan=True)


BLOCK_BYTES = 64 << 20  # memory for the sums of one block of tested terms
_PARTS_PER_MM = 2.0**32
_UNUSABLE = 1e300


@dataclass(frozen=True)
class Scores:
    """One table: each row a training set, each column a test set, both the parts of a partition."""

    partition: Partition  # the P parts
    best: np.ndarray  # (P,) cell that the whole training set chooses; −1 where none has all its errors
    training: np.ndarray  # (P,) mean distance there, mm
    mean: np.ndarray  # (P, P) mean distance of the tested terms (Eq. 1), mm; NaN where none has a score
    standard_error: np.ndarray  # (P, P) of that mean, mm; NaN below two terms
    count: np.ndarray  # (P, P) tested terms that have a score
    left_out: np.ndarray  # (P, P) those that have none: no distance at their cell, or no training terms are left without them
    uncertified: np.ndarray  # (P, P) scored rods that are no certified minima
    jumped: np.ndarray  # (P, P) scored rods that jumped to another branch (Eq. 3)

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
