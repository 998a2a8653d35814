"""The objective over Θ, Eqs. 2 and 3 of §III-E, summed over the relaxed rods of each grid cell; and the results of a sweep,
read from its stored cells: summed up per cell (:class:`Overview`), or rod by rod (:class:`Landscape`).

    Eq. 2, static     f(Θ) = Σ_x    w_x  d(Γ̃^x,  Γ^x) / Σ_x    w_x       Γ̃^x  = F(Γ^x, E_Θ, C^x),   w_x = 1
    Eq. 3, dynamic    f(Θ) = Σ_{xy} w_xy d(Γ̃^xy, Γ^y) / Σ_{xy} w_xy      Γ̃^xy = F(Γ̃^x, E_Θ, C^y)

Γ^x are the observations and C^x their clamps, d is Eq. 1 in mm (:mod:`doo_ti.rod.metric`), and F relaxes a rod
(:mod:`doo_ti.learning.experiment`). A term is an observation x under Eq. 2, and a pair (x, y) under Eq. 3: its clamps move from
C^x to C^y. Both are divided by the sum of the weights, so that f is a mean distance in mm, with the same minimum. Only
certified minima are compared: the distance of a rod that did not converge does not depend on Θ alone.

Axes: G grid cells, N terms, n rods that are added at once, or of a cell.
"""

from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from doo_ti.learning.chunks import RODS, Terms, cell_files, read_summary, rods_in, sweep_identity, terms_in, whole_rods_in
from doo_ti.rod.grid import Grid, Interval, valley
from doo_ti.rod.types import Status
from doo_ti.system.arguments import short_repr, typed
from doo_ti.system.errors import InputError
from doo_ti.system.terminal import in_line


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


LABELS = ("end_distance_mm", "end_rotation_deg")
RODS_AT_ONCE = 1 << 16  # rods that are summed up together


@dataclass(frozen=True)
class Summed:
    """Results from the sums over the rods of each cell. The classes below have ``sums`` (:class:`CellSums`) and
    ``rods_of(cell)``, which gives columns by name, (n,) each: status, stable, and under Eq. 3 jumps."""

    run: Path  # the run's folder
    name: str  # the rod's material
    grid: Grid  # the cells
    objective: str  # "static", Eq. 2, or "dynamic", Eq. 3

    @cached_property
    def compared(self) -> np.ndarray:
        """(N,) bool: terms whose rod is sound in some cell."""
        return self.sums.compared

    @cached_property
    def unsound(self) -> np.ndarray:
        """(G,) rods of the compared terms that are not sound."""
        return self.sums.unsound

    @cached_property
    def mean_distance(self) -> np.ndarray:
        """(G,) f(Θ) of Eq. 2 or 3 in mm, NaN in cells that do not compete."""
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
        out = int((self.unsound > 0).sum())
        return {"cells_competing": int((self.sums.count > 0).sum()) - out if self.compared.any() else 0,
                "cells_not_competing": out, "terms_left_out": int((~self.compared).sum())}

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


@dataclass(frozen=True)
class Overview(Summed):
    """A run's sums alone: memory grows with G + N, not with G · N."""

    sums: CellSums
    rods_of: Callable[[int], dict[str, np.ndarray]]


@dataclass(frozen=True)
class Landscape(Summed):
    """A run rod by rod.

    distance          (G, N) Eq. 1 in mm, NaN for a rod that has no configuration
    status            (G, N) Status
    stable            (G, N) certified minima
    observation       (N,) the observation that each term compares with: y of Eq. 3
    from_observation  (N,) the one that it starts from, x of Eq. 3: under Eq. 2 the same
    weight            (N,) w_xy, above zero; ones under Eq. 2
    end_distance, end_rotation  (N,) labels of ``observation`` in mm and degrees, NaN where unknown
    jumps             (G, N) sub-steps in which a rod jumped to another branch, None under Eq. 2
    """

    __repr__ = short_repr

    distance: np.ndarray
    status: np.ndarray
    stable: np.ndarray
    observation: np.ndarray
    from_observation: np.ndarray
    weight: np.ndarray
    end_distance: np.ndarray
    end_rotation: np.ndarray
    jumps: np.ndarray | None = None

    @cached_property
    def sound(self) -> np.ndarray:
        """(G, N) bool: rods that converged to a certified minimum."""
        return is_sound(self.distance, self.status, self.stable)

    @cached_property
    def sums(self) -> CellSums:
        """Over the rods of each cell."""
        cells, terms = self.distance.shape
        sums = CellSums(cells, terms)
        step = max(1, RODS_AT_ONCE // terms)
        for first in range(0, cells, step):
            block = {name: column.reshape(-1) for name, column in self.rods_of(slice(first, first + step)).items()}
            cell, term = np.divmod(np.arange(len(block["status"])), terms)
            sums.add(first + cell, term, block)
        return sums

    def rods_of(self, cell: int | slice) -> dict[str, np.ndarray]:
        """Columns of the rods of one cell (n,), or of some (c, n), by name."""
        columns = {"distance_mm": self.distance, "status": self.status, "stable": self.stable}
        if self.jumps is not None:
            columns |= {"jumps": self.jumps, "pair_weight": np.broadcast_to(self.weight, self.distance.shape)}
        return {name: column[cell] for name, column in columns.items()}


@typed
def read_landscape(run: Path | str) -> Landscape:
    """The landscape in the folder of a finished sweep. Raises InputError where it holds none."""
    run = Path(run)
    summary = read_summary(run)
    grid = Grid.from_dict(summary.get("grid"), str(run / "summary.json"))
    return gather_landscape(run, grid, in_line(summary.get("material", run.name)), sweep_identity(summary))


def gather_landscape(run: Path, grid: Grid, name: str, identity: str | None) -> Landscape:
    """The landscape in the stored cells of ``run``.

    identity  of the sweep that they belong to, None where the run does not say

    Raises InputError where they are another sweep's, or do not hold each cell and term of the objective once.
    """
    paths = cell_files(run, identity)
    terms = terms_in(paths)
    shape = grid.size, len(terms.key)
    kinds = {"distance_mm": np.float64, "status": np.int8, "stable": bool, **({"jumps": np.int32} if terms.dynamic else {})}
    found = {column: np.zeros(shape, dtype=kind) for column, kind in kinds.items()}
    per_term = {column: np.full(shape[1], np.nan) for column in (*LABELS, *(("pair_weight",) if terms.dynamic else ()))}
    for _, cell, term, columns in whole_rods_in(run, paths, grid, terms, LABELS):
        for column, table in found.items():
            table[cell, term] = columns[column]
        for column, table in per_term.items():
            table[term] = columns[column]
    return Landscape(
        run=run, name=name, grid=grid, objective=terms.objective, distance=found["distance_mm"], status=found["status"],
        stable=found["stable"], observation=terms.observation, from_observation=terms.from_observation,
        weight=per_term.get("pair_weight", np.ones(shape[1])), end_distance=per_term[LABELS[0]],
        end_rotation=per_term[LABELS[1]], jumps=found.get("jumps"))


def gather_overview(run: Path, grid: Grid, name: str, identity: str | None) -> Overview:
    """The overview of the stored cells of ``run``; ``identity`` and errors as :func:`gather_landscape`."""
    paths = cell_files(run, identity)
    terms = terms_in(paths)
    return _overview(run, grid, name, terms, whole_rods_in(run, paths, grid, terms))


def gather_part(run: Path, grid: Grid, name: str, identity: str, part: str) -> Overview:
    """The overview of those cells that an unfinished sweep has stored in the folder ``part``; of several hypotheses about a
    term the nearest sound rod counts in each cell."""
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
    """The overview of the rods in ``files``, as :func:`doo_ti.learning.chunks.rods_in` gives them."""
    sums, spans = CellSums(grid.size, len(terms.key)), {}
    for path, cell, term, columns in files:
        sums.add(cell, term, columns)
        spans[path] = cell.min(), cell.max()

    def rods_of(wanted: int) -> dict[str, np.ndarray]:
        names = (*RODS, "jumps") if terms.dynamic else RODS
        paths = [path for path, (first, last) in spans.items() if first <= wanted <= last]
        found = [(columns, cell == wanted) for _, cell, _, columns in rods_in(paths, grid, terms)]
        return {name: np.concatenate([columns[name][own] for columns, own in found]) for name in names}

    return Overview(run, name, grid, terms.objective, sums, rods_of)


def plane_of(landscape: Summed):
    """The landscape as :class:`doo_ti.report.plane.LandscapePlane`, which pictures and recordings take."""
    from doo_ti.report.plane import LandscapePlane

    shape = landscape.grid.shape
    return LandscapePlane.of(landscape.grid.picture_axes, landscape.mean_distance.reshape(shape),
                             np.unravel_index(landscape.best, shape), landscape.unsound.reshape(shape))
