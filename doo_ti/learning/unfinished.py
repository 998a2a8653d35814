"""A sweep that is still going on, or was interrupted: what is stored of it so far. Its folder is only read."""

import time
from dataclasses import dataclass
from pathlib import Path

from doo_ti.errors import InterruptedRunError
from doo_ti.learning.experiment import Experiment
from doo_ti.learning.overview import Overview, gather_part
from doo_ti.learning.run_folder import read_plan
from doo_ti.learning.sweeps import draw


@dataclass(frozen=True)
class Unfinished:
    """A sweep's stored cells.

    experiment  what it searches
    identity    which sweep it is
    overview    of its stored cells
    age         seconds since the last of them were stored
    """

    experiment: Experiment
    identity: str
    overview: Overview
    age: float

    @property
    def done(self) -> str:
        """``1,300 of 5,200 cells (25 %)``."""
        cells, stored = self.experiment.grid.size, int((self.overview.sums.count > 0).sum())
        return f"{stored:,} of {cells:,} cells ({100 * stored // cells} %)"

    def draw(self, folder: Path) -> None:
        """Write landscape.png and run.rrd, as a finished sweep has them, into ``folder``: of the cells so far, with the rods
        of the best one."""
        draw(folder, self.experiment, self.overview, self.identity, f", so far {self.done}")


def read_unfinished(run: Path) -> Unfinished:
    """What is stored of a sweep. Raises InputError where ``run`` is no sweep's folder, InterruptedRunError where nothing is
    stored yet that could be shown."""
    experiment, identity = read_plan(run)
    part = "hypotheses" if experiment.hypotheses.are_several else "cells"
    written = [path.stat().st_mtime for path in (run / part).glob("*.parquet")]
    if not written:
        raise InterruptedRunError(f"view: {run}: none of {experiment.grid.size:,} cells is stored yet; look again later")
    overview = gather_part(run, experiment.grid, experiment.observations.name, identity, part)
    unfinished = Unfinished(experiment, identity, overview, max(0.0, time.time() - max(written)))
    if not overview.has_best:
        raise InterruptedRunError(f"view: {run}: {unfinished.done} are stored, but in none of them did all rods converge to "
                                  "certified minima; look again later, or look at status and stable in cells/")
    return unfinished
