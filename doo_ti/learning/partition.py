"""Runs partitioned into the rows and columns of a table: by material, objective and end distance (§V-B, §V-C).

Axes: G grid cells, N terms of a part. A term is an observation under Eq. 2, a pair of observations under Eq. 3.
"""

from dataclasses import dataclass, replace

import numpy as np

from doo_ti.learning.landscape import Landscape
from doo_ti.system.errors import InputError

FACTORS = ("material", "objective", "end-distance")
"""What runs can be partitioned by, in the order in which a table lists it."""


@dataclass(frozen=True)
class Part:
    """Some terms of a landscape: one row and one column of a table.

    label      its name in the table, such as ``nylon 30 mm``
    landscape  the run that it is a part of
    terms      (N,) indices of the run's terms
    """

    label: str
    landscape: Landscape
    terms: np.ndarray

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
    """The rows and columns of one table.

    by          the factors in which the parts differ
    within      the value of the other factors, the same in all parts, such as ``static``
    parts       two or more, over one grid
    unlabelled  terms that are in no part because their end distance is unknown
    """

    by: tuple[str, ...]
    within: str
    parts: tuple[Part, ...]
    unlabelled: int = 0


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
    by = _ordered(by)
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


def _ordered(by: tuple[str, ...]) -> tuple[str, ...]:
    """``by`` in the order of FACTORS. Raises InputError where it names others, or one twice."""
    unknown = [factor for factor in by if factor not in FACTORS]
    if unknown or not by or len(set(by)) < len(by):
        problem = f"{','.join(by)!r} " + ("names a factor twice" if by and not unknown else "is no partition")
        raise InputError("partition", "by", problem, f"give some of {', '.join(FACTORS)}, joined by commas")
    return tuple(factor for factor in FACTORS if factor in by)


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
