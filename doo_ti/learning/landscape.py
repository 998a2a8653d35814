"""The objective over Θ, Eqs. 2 and 3 of §III-E, summed over the relaxed rods of each grid cell; and the results of a sweep,
read from its stored cells.

    Eq. 2, static     f(Θ) = Σ_x    w_x  d(Γ̃^x,  Γ^x) / Σ_x    w_x       Γ̃^x  = F(Γ^x, E_Θ, C^x),   w_x = 1
    Eq. 3, dynamic    f(Θ) = Σ_{xy} w_xy d(Γ̃^xy, Γ^y) / Σ_{xy} w_xy      Γ̃^xy = F(Γ̃^x, E_Θ, C^y)

Γ^x are the observations and C^x their clamps, d is Eq. 1 in mm (:mod:`doo_ti.rod.metric`), and F relaxes a rod
(:mod:`doo_ti.learning.experiment`). A term is an observation x under Eq. 2, and a pair (x, y) under Eq. 3: its clamps move from
C^x to C^y. Both are divided by the sum of the weights, so that f is a mean distance in mm, with the same minimum. Only
certified minima are compared: the distance of a rod that did not converge does not depend on Θ alone.

Axes: G grid cells, N terms.
"""

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from doo_ti.learning.chunks import LABELS, Terms, cell_files, read_summary, rods_in, sweep_identity, terms_in, whole_rods_in
from doo_ti.rod.grid import Grid, Interval, valley
from doo_ti.rod.types import Status
from doo_ti.system.arguments import short_repr, typed
from doo_ti.system.errors import InputError
from doo_ti.system.terminal import in_line


def is_sound(distance: np.ndarray, status: np.ndarray, stable: np.ndarray) -> np.ndarray:
    """Whether rods converged to certified minima. The distance of any other rod has no meaning, even if it is small."""
    return (status == Status.CONVERGED) & stable & np.isfinite(distance)


def status_counts(status: np.ndarray) -> dict[str, int]:
    """Number of rods of each status that occurs, by its name."""
    counts = np.bincount(np.ravel(status), minlength=len(Status))
    return {kind.name.lower(): int(counts[kind]) for kind in Status if counts[kind]}


@dataclass(frozen=True)
class Landscape:
    """A run rod by rod.

    run               its folder
    name              the rod's material
    grid              the cells
    objective         "static", Eq. 2, or "dynamic", Eq. 3
    distance          (G, N) Eq. 1 in mm, NaN for a rod that has no configuration
    status            (G, N) Status, −1 where a sweep that is not finished has stored no rod
    stable            (G, N) certified minima
    observation       (N,) the observation that each term compares with: y of Eq. 3
    from_observation  (N,) the one that it starts from, x of Eq. 3: under Eq. 2 the same
    weight            (N,) w_xy, above zero; ones under Eq. 2
    end_distance, end_rotation  (N,) labels of ``observation`` in mm and degrees, NaN where unknown
    jumps             (G, N) sub-steps in which a rod jumped to another branch, None under Eq. 2
    """

    __repr__ = short_repr

    run: Path
    name: str
    grid: Grid
    objective: str
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
    def compared(self) -> np.ndarray:
        """(N,) bool: terms whose rod is sound in some cell. The others are left out of the sums in all cells."""
        return self.sound.any(axis=0)

    @property
    def stored(self) -> np.ndarray:
        """(G,) bool: cells whose rods are there, all cells of a finished sweep."""
        return (self.status >= 0).any(axis=1)

    @cached_property
    def unsound(self) -> np.ndarray:
        """(G,) rods of the compared terms that are not sound: cells with any do not compete. Zero in cells without rods."""
        return np.where(self.stored, self.compared.sum() - self.sound.sum(axis=1), 0)

    @cached_property
    def mean_distance(self) -> np.ndarray:
        """(G,) f(Θ) of Eq. 2 or 3 in mm over the compared terms; NaN in cells that do not compete, where not all these rods are
        sound."""
        return np.where(self.unsound == 0, self.distance_of_sound, np.nan)

    @property
    def distance_of_sound(self) -> np.ndarray:
        """(G,) the same over those compared terms that are sound in the cell; NaN where none is. Cells are not comparable by
        it."""
        weight = self._sums(self.weight)
        return np.divide(self._sums(self.distance * self.weight), weight, out=np.full(len(weight), np.nan), where=weight > 0)

    def _sums(self, values: np.ndarray) -> np.ndarray:
        """(G,) of the sound rods of each cell, added up in the order of their terms."""
        return np.cumsum(np.where(self.sound, values, 0.0), axis=1)[:, -1]

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

    @property
    def theta(self) -> dict[str, float]:
        """bend_1, bend_2, twist and weight of the best cell."""
        return {name: float(value[0]) for name, value in self.grid.cell_values(np.array([self.best])).items()}

    @cached_property
    def intervals(self) -> tuple[Interval, ...]:
        """For each varying axis the range within 5 % of the smallest mean distance."""
        return valley(self.grid, self.mean_distance)

    @property
    def competition(self) -> dict[str, int]:
        """How many cells compete, how many do not, and how many terms no cell can compare, as JSON holds it."""
        out = int((self.unsound > 0).sum())
        return {"cells_competing": int(self.stored.sum()) - out if self.compared.any() else 0,
                "cells_not_competing": out, "terms_left_out": int((~self.compared).sum())}

    def as_dict(self) -> dict:
        """All of this as a summary holds it."""
        best, stored = self.best, self.status[self.status >= 0]
        jumps = {} if self.jumps is None else {
            "jumps": {"rods": int((self.jumps > 0).sum()), "rods_at_best": int((self.jumps[best] > 0).sum())}}
        return {
            "material": self.name,
            "objective": self.objective,
            "best": {**self.theta, "bend_12": self.grid.bend_12, "mean_distance_mm": float(self.mean_distance[best])},
            "intervals_within_5_percent": [asdict(interval) for interval in self.intervals],
            "units": {"bend_1": "mm3", "bend_2": "mm3", "bend_12": "mm3", "twist": "mm3", "weight": "relative"},
            "rods": {"count": len(stored), **status_counts(stored), "stable": int(self.stable.sum())},
            **self.competition,
            "rods_at_best": {**status_counts(self.status[best]), "stable": int(self.stable[best].sum())},
            "cells": self.grid.size,
            "grid": self.grid.as_dict(),
            **jumps,
        }


@typed
def read_landscape(run: Path | str) -> Landscape:
    """The landscape in the folder of a finished sweep. Raises InputError where it holds none."""
    run = Path(run)
    summary = read_summary(run)
    grid = Grid.from_dict(summary.get("grid"), str(run / "summary.json"))
    return gather_landscape(run, grid, in_line(summary.get("material", run.name)), sweep_identity(summary))


def gather_landscape(run: Path, grid: Grid, name: str, identity: str | None, part: str = "cells", whole: bool = True
                     ) -> Landscape:
    """The landscape in the stored cells of ``run``, in its folder ``part``.

    identity  of the sweep that they belong to, None where the run does not say
    whole     whether all rods must be there; else, of a sweep that is not finished, those that are, and of several hypotheses
              about a term the nearest sound rod of each cell

    Raises InputError where they are another sweep's, or do not hold each cell and term of the objective once.
    """
    paths = cell_files(run, identity, part)
    terms = terms_in(paths)
    shape = grid.size, len(terms.key)
    found = {"distance_mm": np.full(shape, np.nan), "status": np.full(shape, -1, dtype=np.int8),
             "stable": np.zeros(shape, dtype=bool), **({"jumps": np.zeros(shape, dtype=np.int32)} if terms.dynamic else {})}
    per_term = {column: np.full(shape[1], np.nan) for column in (*LABELS, *(("pair_weight",) if terms.dynamic else ()))}
    for cell, term, columns in whole_rods_in(run, paths, grid, terms) if whole else _nearest_rods_in(paths, grid, terms):
        for column, table in found.items():
            table[cell, term] = columns[column]
        for column, table in per_term.items():
            table[term] = columns[column]
    return Landscape(
        run=run, name=name, grid=grid, objective=terms.objective, distance=found["distance_mm"], status=found["status"],
        stable=found["stable"], observation=terms.observation, from_observation=terms.from_observation,
        weight=per_term.get("pair_weight", np.ones(shape[1])), end_distance=per_term[LABELS[0]],
        end_rotation=per_term[LABELS[1]], jumps=found.get("jumps"))


def _nearest_rods_in(paths: list[Path], grid: Grid, terms: Terms) -> Iterator[tuple]:
    """As :func:`doo_ti.learning.chunks.whole_rods_in`, of several rods of a cell and term the nearest sound one, of files that
    hold whole cells."""
    for cell, term, columns in rods_in(paths, grid, terms):
        distance = columns["distance_mm"]
        sound = is_sound(distance, columns["status"], columns["stable"])
        order = np.lexsort((distance, ~sound, term, cell))
        rows = order[np.diff(cell[order] * np.int64(len(terms.key)) + term[order], prepend=-1) > 0]
        yield cell[rows], term[rows], {name: column[rows] for name, column in columns.items()}


def plane_of(landscape: Landscape):
    """The landscape as :class:`doo_ti.report.plane.LandscapePlane`, which pictures and recordings take."""
    from doo_ti.report.plane import LandscapePlane

    shape = landscape.grid.shape
    return LandscapePlane.of(landscape.grid.picture_axes, landscape.mean_distance.reshape(shape),
                             np.unravel_index(landscape.best, shape), landscape.unsound.reshape(shape))
