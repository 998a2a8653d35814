"""Picture and recording of a sweep, finished or not: landscape.png, and run.rrd with the rods of its best cell.

Axes: T moments, N terms of the objective.
"""

import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from doo_ti.learning.cells import settled, sub_steps
from doo_ti.learning.experiment import Experiment, started
from doo_ti.learning.landscape import Overview, Summed, gather_part
from doo_ti.learning.run_folder import read_plan
from doo_ti.relaxation.newton import Newton
from doo_ti.relaxation.relax import relax
from doo_ti.rod.metric import distance
from doo_ti.rod.physical_units import relative_stiffness, stiffness
from doo_ti.rod.types import Material, Status
from doo_ti.system.errors import InterruptedRunError
from doo_ti.system.terminal import can_record

MOST_MOMENTS = 60  # iterations, or sub-steps, evenly chosen, that are recorded


def draw(folder: Path, experiment: Experiment, overview: Overview, identity: str, remark: str = "",
         linear_density: float | None = None) -> list[str]:
    """Write landscape.png and, where rerun is installed, run.rrd into ``folder``; their title ends with ``remark``, and EI is
    shown where the ``linear_density`` in g/m is known. Returns the names of those that were written."""
    from doo_ti.report import landscape_picture

    observations, grid, sums, best = experiment.observations, experiment.grid, overview.sums, overview.best
    static = experiment.pairs is None
    terms = f"{observations.count} observations" if static else f"{experiment.pairs.count} pairs"
    title = f"{observations.name}: {overview.objective} error over {terms}{remark}"
    plane = plane_of(overview)
    theta = {name: float(value[0]) for name, value in grid.cell_values(np.array([best])).items()}
    written = []
    if grid.varying:
        written.append("landscape.png")
        known = linear_density is not None and all(axis.name != "weight" for axis in grid.varying)
        landscape_picture(folder / written[-1], plane, title=title, newton_per_bend=(
            stiffness(relative_stiffness(1.0, theta["weight"]), linear_density) if known else None))
    if not can_record():
        return written
    from doo_ti.record import record_sweep
    from doo_ti.report.grid_view import Observed

    record_sweep(
        folder / "run.rrd", run_id=identity[:32], name=title,
        observed=Observed.of(observations if static else observations.take(experiment.pairs.to_index)),
        trajectory=trajectory(experiment, best), plane=plane, intervals=overview.intervals,
        properties={"bend_1_mm3": theta["bend_1"], "bend_2_mm3": theta["bend_2"], "twist_mm3": theta["twist"],
                    "weight": theta["weight"], "mean_distance_mm": float(overview.mean_distance[best]),
                    "rods": int(sums.count.sum()), "cells_competing": overview.competition["cells_competing"],
                    "rods_converged": int(sums.status[Status.CONVERGED]), "rods_stable": sums.stable,
                    "recorded_iterations": "those of Newton" if static else "sub-steps of the motion"},
    )
    return [*written, "run.rrd"]


def plane_of(landscape: Summed):
    """The landscape as :class:`doo_ti.report.plane.LandscapePlane`, which pictures and recordings take."""
    from doo_ti.report.plane import LandscapePlane

    shape = landscape.grid.shape
    return LandscapePlane.of(landscape.grid.picture_axes, landscape.mean_distance.reshape(shape),
                    np.unravel_index(landscape.best, shape), landscape.unsound.reshape(shape))


def trajectory(experiment: Experiment, cell: int):
    """A :class:`doo_ti.record.SweepTrajectory`: the relaxation of a cell's rods, iteration by iteration under Eq. 2,
    sub-step by sub-step under Eq. 3, each observation under the hypothesis that is nearest in that cell."""
    from doo_ti.record import SweepTrajectory

    experiment = settled(experiment, cell)
    material = experiment.grid.materials(slice(cell, cell + 1))
    if experiment.pairs is None:
        index, moments = None, list(_iterations(experiment, material))
    else:
        index, moments = experiment.pairs.to_index[experiment.rods[1]], list(sub_steps(experiment, material))
    kept = np.unique(np.linspace(0, len(moments) - 1, min(len(moments), MOST_MOMENTS + 1)).round().astype(int))
    configurations, energy, residual, status = zip(*(moments[k] for k in kept), strict=True)
    error = distance(configurations[-1], experiment.observations, index, experiment.options.frame_weight)
    vertices = np.stack([configuration.vertices for configuration in configurations])
    return SweepTrajectory(vertices, np.stack(energy), np.stack(residual), status[-1], error)


def _iterations(experiment: Experiment, material: Material) -> Iterator[tuple]:
    """The rods of Eq. 2 at their starts, then after 1, 2, … iterations of Newton, as
    :func:`doo_ti.learning.cells.sub_steps` gives them. A relaxation stopped after k iterations equals the first k of the whole
    one."""
    starts, clamps = started(experiment.observations, experiment.clamps, experiment.hypotheses)
    nothing = np.full(starts.count, np.nan)
    yield starts, nothing, nothing, None
    for count in range(1, MOST_MOMENTS + 1):
        solution = relax(starts, material, clamps, Newton(max_iterations=count), up=experiment.observations.up,
                         **experiment.options.surroundings.arguments)
        yield solution.configuration, solution.energy, solution.residual, solution.status
        if (solution.iterations < count).all():
            return


@dataclass(frozen=True)
class Unfinished:
    """The stored cells of a sweep that is running or was interrupted."""

    experiment: Experiment  # observations, grid and options
    identity: str  # identity of the sweep
    overview: Overview  # results of the stored cells
    age: float  # seconds since the last of them were stored

    @property
    def done(self) -> str:
        """``1,300 of 5,200 cells (25 %)``."""
        cells, stored = self.experiment.grid.size, int((self.overview.sums.count > 0).sum())
        return f"{stored:,} of {cells:,} cells ({100 * stored // cells} %)"

    def draw(self, folder: Path) -> None:
        """Write landscape.png and run.rrd of the stored cells into ``folder``."""
        draw(folder, self.experiment, self.overview, self.identity, f", so far {self.done}")


def read_unfinished(run: Path) -> Unfinished:
    """The stored cells of a sweep; its folder is only read. Raises InputError where ``run`` is no sweep's folder,
    InterruptedRunError where no cell is stored yet."""
    experiment, identity = read_plan(run)
    part = "hypotheses" if experiment.hypotheses.are_several else "cells"
    written = [path.stat().st_mtime for path in (run / part).glob("*.parquet")]
    if not written:
        raise InterruptedRunError(f"view: {run}: none of {experiment.grid.size:,} cells is stored yet; try again later")
    overview = gather_part(run, experiment.grid, experiment.observations.name, identity, part)
    unfinished = Unfinished(experiment, identity, overview, max(0.0, time.time() - max(written)))
    if not overview.has_best:
        raise InterruptedRunError(f"view: {run}: {unfinished.done} are stored, but in none of them did all rods converge to "
                                  "certified minima; look again later, or look at status and stable in cells/")
    return unfinished
