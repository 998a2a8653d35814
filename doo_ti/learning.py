"""Learning Θ from finished sweeps (§III-E): reductions over their stored cells, never new relaxations.

Axes: G grid cells, D observations.
"""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from doo_ti.errors import InputError
from doo_ti.grid import Grid, Interval, valley
from doo_ti.types import Status


@dataclass(frozen=True)
class Landscape:
    """What a run measured.

    run       its folder
    name      the rod's material
    grid      the cells
    distance  (G, D) Eq. 1 in mm, NaN where a rod came to nothing
    status    (G, D) Status
    stable    (G, D) certified minima
    """

    run: Path
    name: str
    grid: Grid
    distance: np.ndarray
    status: np.ndarray
    stable: np.ndarray

    @property
    def mean_distance(self) -> np.ndarray:
        """(G,) Eq. 2 over D, mm, without observations that have no distance anywhere; other gaps make a cell NaN."""
        useful = ~np.isnan(self.distance).all(axis=0)
        if not useful.any():
            return np.full(len(self.distance), np.nan)
        return self.distance[:, useful].mean(axis=1)

    @property
    def best(self) -> int:
        """The cell with the smallest mean distance. Raises InputError where no cell has one."""
        if np.isnan(self.mean_distance).all():
            raise InputError(self.run, "distance_mm", "no cell has an error", "look at the rods' status in cells/")
        return int(np.nanargmin(self.mean_distance))

    @property
    def intervals(self) -> tuple[Interval, ...]:
        """For each varying axis the range within 5 % of the smallest mean distance."""
        return valley(self.grid, self.mean_distance)


def read_landscape(run: Path) -> Landscape:
    """The landscape in the folder of a finished sweep. Raises InputError where it holds none."""
    summary = _summary(run)
    grid = Grid.from_dict(summary.get("grid"), str(run / "summary.json"))
    return gather_landscape(run, grid, str(summary.get("material", run.name)))


def gather_landscape(run: Path, grid: Grid, name: str) -> Landscape:
    """The landscape in the stored cells of ``run``. Raises InputError where they do not cover the grid once."""
    columns = _cells(run)
    parameters = ("bend_1", "bend_2", "twist", "weight")
    values = grid.cell_values()
    wanted = np.stack([values[name] for name in parameters], axis=-1)
    rows = np.stack([columns[name] for name in parameters], axis=-1)
    _, place = np.unique(np.concatenate([wanted, rows]), axis=0, return_inverse=True)
    place = place.ravel()
    cell_at = np.full(place.max() + 1, -1)
    cell_at[place[: grid.size]] = np.arange(grid.size)
    cell, observation = cell_at[place[grid.size :]], columns["observation"].astype(np.int64)
    count = int(observation.max()) + 1
    seen = np.zeros((grid.size, count), dtype=np.int64)
    if (cell >= 0).all():
        np.add.at(seen, (cell, observation), 1)
    if not (seen == 1).all():
        raise InputError(run, "cells", "do not hold each cell and observation of the grid once",
                         "run the sweep to its end")
    tables = {}
    for column in ("distance_mm", "status", "stable"):
        tables[column] = np.empty((grid.size, count), dtype=columns[column].dtype)
        tables[column][cell, observation] = columns[column]
    return Landscape(run, name, grid, tables["distance_mm"],
                     tables["status"].astype(np.int64), tables["stable"].astype(bool))


def status_counts(status: np.ndarray) -> dict[str, int]:
    """How many rods ended how, by the status's name, none left out but those that never occurred."""
    return {kind.name.lower(): int((status == kind).sum()) for kind in Status if (status == kind).any()}


def _summary(run: Path) -> dict:
    path = run / "summary.json"
    try:
        summary = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        problem = (error.strerror or str(error)).lower()
        raise InputError(path, "file", problem, "name the folder of a finished sweep") from None
    except ValueError as error:
        raise InputError(path, "file", f"not JSON ({error})", "run the sweep again") from None
    if not isinstance(summary, dict):
        raise InputError(path, "file", "holds no table", "run the sweep again")
    return summary


def _cells(run: Path) -> dict[str, np.ndarray]:
    """The columns of all of the run's cells."""
    import pyarrow
    import pyarrow.parquet

    paths = sorted((run / "cells").glob("*.parquet"))
    names = ["bend_1", "bend_2", "twist", "weight", "observation", "distance_mm", "status", "stable"]
    if not paths:
        raise InputError(run / "cells", "cells", "no Parquet files", "run the sweep to its end")
    try:
        table = pyarrow.concat_tables([pyarrow.parquet.read_table(path, columns=names) for path in paths])
        return {name: table.column(name).to_numpy() for name in names}
    except (pyarrow.ArrowException, OSError, KeyError) as error:
        reason = (str(error) or type(error).__name__).splitlines()[0]
        raise InputError(run / "cells", "cells", f"cannot be read ({reason})", "run the sweep again") from None
