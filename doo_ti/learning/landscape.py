"""Finished sweeps rod by rod, as leave-one-out tables and figures need them (§III-E): never new relaxations.

Axes: G grid cells, N terms of the objective: observations under Eq. 2, pairs of observations under Eq. 3.
"""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from doo_ti.grid import Grid
from doo_ti.learning.cell_sums import CellSums, is_sound, status_counts  # noqa: F401  commands take it from here
from doo_ti.learning.overview import Overview
from doo_ti.learning.stored_cells import cell_files, terms_in, whole_rods_in
from doo_ti.learning.summary import changed_files, check_cells, read_summary, sweep_identity
from doo_ti.terminal import in_line

LABELS = ("end_distance_mm", "end_rotation_deg")
RODS_AT_ONCE = 1 << 16
"""To be summed up."""


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
        """(G, N) bool: rods that converged to a certified minimum."""
        return is_sound(self.distance, self.status, self.stable)

    @cached_property
    def overview(self) -> Overview:
        """The same, summed up over the rods of each cell."""
        cells, terms = self.distance.shape
        sums = CellSums(cells, terms)
        columns = {"distance_mm": self.distance, "status": self.status, "stable": self.stable}
        if self.jumps is not None:
            columns |= {"jumps": self.jumps, "pair_weight": np.broadcast_to(self.weight, self.distance.shape)}
        step = max(1, RODS_AT_ONCE // terms)
        for first in range(0, cells, step):
            block = {name: column[first:first + step].reshape(-1) for name, column in columns.items()}
            cell, term = np.divmod(np.arange(len(block["status"])), terms)
            sums.add(first + cell, term, block)
        return Overview(self.run, self.name, self.grid, self.objective, sums,
                        lambda cell: {name: column[cell] for name, column in columns.items()})

    @property
    def compared(self) -> np.ndarray:
        """(N,) bool: terms whose rod is sound in some cell. The others say nothing and are left out."""
        return self.overview.sums.compared

    @property
    def unsound(self) -> np.ndarray:
        """(G,) rods of the compared terms that are not sound: cells with any do not compete."""
        return self.overview.unsound

    @property
    def mean_distance(self) -> np.ndarray:
        """(G,) Eq. 2 or 3 over the compared terms, mm; NaN in cells that do not compete, since not all these rods are sound."""
        return self.overview.mean_distance

    @property
    def distance_of_sound(self) -> np.ndarray:
        """(G,) the same over the compared terms that are sound in each cell; NaN where none is. Cells are not comparable by
        it."""
        return self.overview.sums.distance_of_sound

    @property
    def best(self) -> int:
        """The competing cell with the smallest mean distance. Raises InputError where none competes."""
        return self.overview.best


def read_landscape(run: Path) -> Landscape:
    """The landscape in the folder of a finished sweep. Raises InputError where it holds none."""
    summary = read_summary(run)
    check_cells(run, changed_files(run, summary))
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
        run=run, name=name, grid=grid, objective="dynamic" if terms.dynamic else "static", distance=found["distance_mm"],
        status=found["status"], stable=found["stable"], observation=terms.observation, from_observation=terms.from_observation,
        weight=per_term.get("pair_weight", np.ones(shape[1])), end_distance=per_term[LABELS[0]],
        end_rotation=per_term[LABELS[1]], jumps=found.get("jumps"))
