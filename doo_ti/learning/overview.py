"""What a run says as a whole, from its stored cells alone: its best cell, the ranges that fit nearly as well, and counts.

Nothing here grows with the rods of a cell. Axes: G grid cells, N terms of the objective.
"""

from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from doo_ti.errors import InputError
from doo_ti.grid import Grid, Interval, valley
from doo_ti.learning.cell_sums import CellSums, counts_by_name, is_sound, status_counts
from doo_ti.learning.stored_cells import RODS, Terms, cell_files, rods_in, terms_in, whole_rods_in


@dataclass(frozen=True)
class Overview:
    """What a run measured, summed up.

    run        its folder
    name       the rod's material
    grid       the cells
    objective  "static", Eq. 2, or "dynamic", Eq. 3
    sums       over the rods of each cell
    rods_of    the columns of a cell's rods, by name: status, stable, and under Eq. 3 jumps
    """

    run: Path
    name: str
    grid: Grid
    objective: str
    sums: CellSums
    rods_of: Callable[[int], dict[str, np.ndarray]]

    @cached_property
    def unsound(self) -> np.ndarray:
        """(G,) as CellSums has it."""
        return self.sums.unsound

    @cached_property
    def mean_distance(self) -> np.ndarray:
        """(G,) as CellSums has it."""
        return self.sums.mean_distance

    @property
    def has_best(self) -> bool:
        """Whether any cell competes."""
        return not np.isnan(self.mean_distance).all()

    @cached_property
    def best(self) -> int:
        """The competing cell with the smallest mean distance. Raises InputError where none competes."""
        if not self.has_best:
            raise InputError(self.run, "distance_mm", "no cell has an error: in none did all rods converge to certified minima",
                             "look at status and stable in cells/")
        return int(np.nanargmin(self.mean_distance))

    @cached_property
    def intervals(self) -> tuple[Interval, ...]:
        """For each varying axis the range within 5 % of the smallest mean distance."""
        return valley(self.grid, self.mean_distance)

    @property
    def competition(self) -> dict[str, int]:
        """How many cells compete, how many do not, and how many terms no cell can compare, as JSON holds it."""
        out, compared = int((self.unsound > 0).sum()), self.sums.compared
        return {"cells_competing": int((self.sums.count > 0).sum()) - out if compared.any() else 0, "cells_not_competing": out,
                "terms_left_out": int((~compared).sum())}

    def as_dict(self) -> dict:
        """All of this as a summary holds it."""
        sums, best, rods = self.sums, self.best, self.rods_of(self.best)
        theta = {name: float(value[0]) for name, value in self.grid.cell_values(np.array([best])).items()}
        jumps = {} if self.objective == "static" else {
            "jumps": {"rods": sums.jumped, "rods_at_best": int((rods["jumps"] > 0).sum())}}
        return {
            "material": self.name,
            "objective": self.objective,
            "best": {**theta, "bend_12": self.grid.bend_12, "mean_distance_mm": float(self.mean_distance[best])},
            "intervals_within_5_percent": [asdict(interval) for interval in self.intervals],
            "units": {"bend_1": "mm3", "bend_2": "mm3", "bend_12": "mm3", "twist": "mm3", "weight": "relative"},
            "rods": {"count": int(sums.count.sum()), **counts_by_name(sums.status), "stable": sums.stable},
            **self.competition,
            "rods_at_best": {**status_counts(rods["status"]), "stable": int(rods["stable"].sum())},
            "cells": self.grid.size,
            "grid": self.grid.as_dict(),
            **jumps,
        }


def gather_overview(run: Path, grid: Grid, name: str, identity: str | None) -> Overview:
    """The overview of the stored cells of ``run``.

    identity  of the sweep that they belong to, None where the run does not say

    Raises InputError where they are another sweep's, or do not hold each cell and term of the objective once.
    """
    paths = cell_files(run, identity)
    terms = terms_in(paths)
    return _overview(run, grid, name, terms, whole_rods_in(run, paths, grid, terms))


def gather_part(run: Path, grid: Grid, name: str, identity: str, part: str) -> Overview:
    """The overview of those cells that an unfinished sweep has stored in the folder ``part``; of the rods of several
    hypotheses about a term the nearest sound one counts in each cell."""
    paths = cell_files(run, identity, part)
    terms = terms_in(paths)

    def nearest(path, cell, term, columns):
        distance = columns["distance_mm"]
        sound = is_sound(distance, columns["status"], columns["stable"])
        order = np.lexsort((distance, ~sound, term, cell))
        rod = cell[order] * np.int64(len(terms.key)) + term[order]
        rows = order[np.diff(rod, prepend=-1) > 0]
        return path, cell[rows], term[rows], {name: column[rows] for name, column in columns.items()}

    return _overview(run, grid, name, terms, (nearest(*found) for found in rods_in(paths, grid, terms)))


def _overview(run: Path, grid: Grid, name: str, terms: Terms, files: Iterable[tuple]) -> Overview:
    """The overview of the rods in ``files``, as :func:`doo_ti.learning.stored_cells.rods_in` gives them."""
    sums, spans = CellSums(grid.size, len(terms.key)), {}
    for path, cell, term, columns in files:
        sums.add(cell, term, columns)
        spans[path] = cell.min(), cell.max()

    def rods_of(wanted: int) -> dict[str, np.ndarray]:
        names = (*RODS, "jumps") if terms.dynamic else RODS
        paths = [path for path, (first, last) in spans.items() if first <= wanted <= last]
        found = [(columns, cell == wanted) for _, cell, _, columns in rods_in(paths, grid, terms)]
        return {name: np.concatenate([columns[name][own] for columns, own in found]) for name in names}

    return Overview(run, name, grid, "dynamic" if terms.dynamic else "static", sums, rods_of)
