"""Learning Θ from finished sweeps (§III-E): reductions over their stored cells, never new relaxations.

Axes: G grid cells, N terms of the objective: observations under Eq. 2, pairs of observations under Eq. 3.
"""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from doo_ti.errors import InputError
from doo_ti.grid import Grid, Interval, valley
from doo_ti.learning.chunk_file import check_identity, column_names, read_columns
from doo_ti.learning.summary import check_cells, read_summary, sweep_identity
from doo_ti.terminal import in_line
from doo_ti.types import Status

PARAMETERS = ("bend_1", "bend_2", "twist", "weight")
LABELS = ("end_distance_mm", "end_rotation_deg")
MOST_OBSERVATIONS = 1 << 31
"""More than the column ``observation`` can number."""


@dataclass(frozen=True)
class Landscape:
    """What a run measured.

    run               its folder
    name              the rod's material
    grid              the cells
    objective         "static", Eq. 2, or "dynamic", Eq. 3
    distance          (G, N) Eq. 1 in mm, NaN where a rod came to nothing
    status            (G, N) Status
    stable            (G, N) certified minima
    observation       (N,) the observation that each term compares with: y of Eq. 3
    from_observation  (N,) the one that it starts from, x of Eq. 3: under Eq. 2 the same
    weight            (N,) w_xy, above zero; ones under Eq. 2
    end_distance, end_rotation  (N,) labels of ``observation`` in mm and degrees, NaN where unknown
    jumps             (G, N) sub-steps at which a rod fell to another branch, None under Eq. 2
    """

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
        """(G, N) bool: rods that converged to a certified minimum. The others lie anywhere, at their observation too."""
        return (self.status == Status.CONVERGED) & self.stable & np.isfinite(self.distance)

    @cached_property
    def compared(self) -> np.ndarray:
        """(N,) bool: terms whose rod is sound in some cell. The others say nothing and are left out."""
        return self.sound.any(axis=0)

    @cached_property
    def unsound(self) -> np.ndarray:
        """(G,) rods of the compared terms that are not sound: cells with any do not compete."""
        return (~self.sound[:, self.compared]).sum(axis=1)

    @cached_property
    def mean_distance(self) -> np.ndarray:
        """(G,) Eq. 2 or 3 over the compared terms, mm; NaN in cells that do not compete, since not all these rods are sound."""
        weight = self.weight[self.compared]
        if not len(weight):
            return np.full(len(self.distance), np.nan)
        mean = (self.distance[:, self.compared] * weight).sum(axis=1) / weight.sum()
        return np.where(self.unsound == 0, mean, np.nan)

    @property
    def distance_of_sound(self) -> np.ndarray:
        """(G,) the same over the compared terms that are sound in each cell; NaN where none is. Cells are not comparable by
        it."""
        weight = self.weight * self.sound
        total = weight.sum(axis=1)
        summed = np.where(self.sound, self.distance, 0.0) @ self.weight
        return np.divide(summed, total, out=np.full(len(total), np.nan), where=total > 0)

    @property
    def best(self) -> int:
        """The competing cell with the smallest mean distance. Raises InputError where none competes."""
        if np.isnan(self.mean_distance).all():
            raise InputError(self.run, "distance_mm", "no cell has an error: in none did all rods converge to certified minima",
                             "look at status and stable in cells/")
        return int(np.nanargmin(self.mean_distance))

    @property
    def intervals(self) -> tuple[Interval, ...]:
        """For each varying axis the range within 5 % of the smallest mean distance."""
        return valley(self.grid, self.mean_distance)


def read_landscape(run: Path) -> Landscape:
    """The landscape in the folder of a finished sweep. Raises InputError where it holds none."""
    summary = read_summary(run)
    check_cells(run, summary)
    grid = Grid.from_dict(summary.get("grid"), str(run / "summary.json"))
    return gather_landscape(run, grid, in_line(summary.get("material", run.name)), sweep_identity(summary))


def gather_landscape(run: Path, grid: Grid, name: str, identity: str | None) -> Landscape:
    """The landscape in the stored cells of ``run``, whatever files they lie in and in whatever order.

    identity  of the sweep that they belong to, None where the run does not say

    One file is in memory at a time. Raises InputError where they are another sweep's, or do not hold each cell and term of the
    objective once.
    """
    paths = sorted((run / "cells").glob("*.parquet"))
    if not paths:
        raise InputError(run / "cells", "cells", "no Parquet files", "run the sweep to its end")
    check_identity(paths, identity)
    dynamic = column_names(paths[0]) >= {"from_observation"}
    ends = ("from_observation", "observation") if dynamic else ("observation",)
    terms = np.unique(np.concatenate([_terms(path, ends) for path in paths]))
    values = grid.cell_values()
    wanted = _as_keys([values[parameter] for parameter in PARAMETERS])
    order = np.argsort(wanted)
    kinds = {"distance_mm": np.float64, "status": np.int8, "stable": bool, **({"jumps": np.int32} if dynamic else {})}
    found = {column: np.zeros((grid.size, len(terms)), dtype=kind) for column, kind in kinds.items()}
    per_term = {column: np.full(len(terms), np.nan) for column in (*LABELS, *(("pair_weight",) if dynamic else ()))}
    seen = np.zeros((grid.size, len(terms)), dtype=np.int8)
    complete = dynamic or bool((terms == np.arange(len(terms))).all())
    for path in paths:
        columns = read_columns(path, [*PARAMETERS, *ends, *found, *per_term])
        keys = _as_keys([columns[parameter] for parameter in PARAMETERS])
        cell = order[np.minimum(np.searchsorted(wanted, keys, sorter=order), grid.size - 1)]
        term = np.searchsorted(terms, _term_keys(columns, ends))
        complete &= bool((wanted[cell] == keys).all())
        np.add.at(seen, (cell, term), 1)
        for column, table in found.items():
            table[cell, term] = columns[column]
        for column, table in per_term.items():
            table[term] = columns[column]
    if not (complete and (seen == 1).all()):
        raise InputError(run, "cells", f"do not hold each cell and {'pair' if dynamic else 'observation'} of the grid once",
                         "run the sweep to its end")
    start, end = terms // MOST_OBSERVATIONS, terms % MOST_OBSERVATIONS
    return Landscape(
        run=run, name=name, grid=grid, objective="dynamic" if dynamic else "static", distance=found["distance_mm"],
        status=found["status"], stable=found["stable"], observation=end, from_observation=start if dynamic else end,
        weight=per_term.get("pair_weight", np.ones(len(terms))), end_distance=per_term[LABELS[0]],
        end_rotation=per_term[LABELS[1]], jumps=found.get("jumps"))


def jumps_of(landscape: Landscape) -> dict[str, int]:
    """How many rods fell to another branch on their way, in all cells and in the best one."""
    fell = landscape.jumps > 0
    return {"rods": int(fell.sum()), "rods_at_best": int(fell[landscape.best].sum())}


def competition_of(landscape: Landscape) -> dict[str, int]:
    """How many cells compete, how many do not, and how many terms no cell can compare, as JSON holds it."""
    out = int((landscape.unsound > 0).sum())
    return {"cells_competing": len(landscape.unsound) - out if landscape.compared.any() else 0, "cells_not_competing": out,
            "terms_left_out": int((~landscape.compared).sum())}


def status_counts(status: np.ndarray) -> dict[str, int]:
    """How many rods ended how, by the status's name, none left out but those that never occurred."""
    return {kind.name.lower(): int((status == kind).sum()) for kind in Status if (status == kind).any()}


def _as_keys(parameters: list[np.ndarray]) -> np.ndarray:
    """(N,) keys that are equal exactly where all ``parameters`` (N,) are, and that can be sorted."""
    rows = np.ascontiguousarray(np.stack(parameters, axis=-1), dtype=np.float64)
    return rows.view([("", np.float64)] * len(parameters)).ravel()


def _term_keys(columns: dict[str, np.ndarray], ends: tuple[str, ...]) -> np.ndarray:
    """(N,) one number for each term of the objective, in the order of the observations that it starts from, then ends at."""
    last = columns[ends[-1]].astype(np.int64)
    return last if len(ends) == 1 else columns[ends[0]].astype(np.int64) * MOST_OBSERVATIONS + last


def _terms(path: Path, ends: tuple[str, ...]) -> np.ndarray:
    return np.unique(_term_keys(read_columns(path, list(ends)), ends))
