"""A sweep: Eq. 2 or 3 for every cell of a grid, in chunks that are stored as they finish (§III-E).

    RUN/cells/*.parquet   one row per (cell, observation), under Eq. 3 per (cell, pair)
    RUN/summary.json      best Θ, its error, the range of each parameter within 5 %, counts of statuses, provenance
    RUN/landscape.png     the error landscape
    RUN/run.rrd           the recording

and the files that :mod:`doo_ti.learning.run_folder` names. A sweep that was stopped resumes with the first chunk that is not
stored.
"""

import json
import shlex
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from doo_ti.learning.chunks import DENSITY, SUMMARY, check_identity, chunk_path, read_rows, write_chunk
from doo_ti.learning.experiment import (
    Experiment,
    SweepOptions,
    iterations,
    load_kernels,
    relax_hypotheses,
    resolve,
    sub_steps,
    with_nearest_turns,
)
from doo_ti.learning.landscape import Landscape, gather_landscape, plane_of
from doo_ti.learning.run_folder import claim, finished, identity_of, provenance, read_plan
from doo_ti.learning.terms import Hypotheses, Pairs
from doo_ti.learning.up_axes import other_up_of
from doo_ti.learning.workers import ThisProcess, Workers, started_workers
from doo_ti.rod.grid import Grid
from doo_ti.rod.material import relative_stiffness, stiffness
from doo_ti.rod.metric import distance
from doo_ti.rod.observations import Observations
from doo_ti.rod.start import check_experiment
from doo_ti.rod.types import Status
from doo_ti.system.arguments import typed
from doo_ti.system.errors import InputError, InterruptedRunError
from doo_ti.system.files import write_text
from doo_ti.system.terminal import can_record, progress

CHUNK_BYTES = 32 << 20
"""Memory for the frames of a chunk's rods, the larger part of what a sweep holds: 31 000 rods of 33 edges."""
MOST_RODS = 100_000_000
MOST_MOMENTS = 60  # iterations, or sub-steps, evenly chosen, that are recorded


@typed
def sweep(run: Path | str, observations: Observations, grid: Grid, *, options: SweepOptions = SweepOptions(),
          pairs: Pairs | None = None, command: Sequence[str] = (), linear_density: float | None = None) -> dict[str, object]:
    """Relax ``observations`` under every cell of ``grid`` (Eq. 2 or 3), store the rods in the folder ``run``, and return the
    summary; an unfinished sweep in ``run`` is resumed.

    options  objective, clamps, solver, precision, workers (:class:`doo_ti.learning.experiment.SweepOptions`)
    pairs    the terms of Eq. 3; by default the paper's (footnote 7), from the labels of the observations
    command  the words of the command, for the provenance and the message that says how to resume
    linear_density  g/m of the rod, kept in the summary for results in N m²; cells do not depend on it

    Raises InputError as :class:`doo_ti.learning.experiment.Experiment` does, where ``run`` contains another sweep and where
    the Dask scheduler does not answer; InterruptedRunError where a chunk fails: the chunks stored before are kept.
    """
    with started_workers(options.workers, options.scheduler) as workers:
        return _swept(Path(run), Experiment(observations, grid, options, pairs), workers, command, linear_density)


def _swept(run: Path, experiment: Experiment, workers: ThisProcess | Workers, command: list[str],
           linear_density: float | None) -> dict:
    """The sweep, its chunks relaxed by ``workers``."""
    began = time.monotonic()
    observations, grid = experiment.observations, experiment.grid
    check_experiment(observations, experiment.clamps, grid.axes[-1].values[-1], experiment.options.frame_weight)
    rods = len(experiment.rods[0])
    if rods * grid.size > MOST_RODS:
        raise InputError(grid.source, "grid", f"{grid.size:,} cells are {rods * grid.size:,} rods",
                         f"give a grid of at most {MOST_RODS // rods:,} cells")
    together = CHUNK_BYTES // (32 * observations.edges)
    identity = identity_of(experiment, together)
    step = max(1, together // rods)
    chunks = [(first, min(first + step, grid.size)) for first in range(0, grid.size, step)]
    part = "hypotheses" if experiment.hypotheses.are_several else "cells"
    with _resumable(run, command):
        claim(run, identity, experiment)
        left = [chunk for chunk in chunks if not chunk_path(run, part, *chunk).exists()]
        if not left and (done := finished(run, identity, len(chunks))):
            return done
        paths = [chunk_path(run, part, *chunk) for chunk in chunks if chunk not in set(left)]
        check_identity(paths, identity)
        for path in paths:  # chunks stored before are read whole, which verifies their checksums
            read_rows(path)
        loading, seconds = _relax_chunks(run, part, experiment, left, workers, identity)
        resolution = None
        if part == "hypotheses":
            resolution = resolve(run, experiment, chunks)
            experiment = replace(experiment, hypotheses=Hypotheses.from_dict(resolution["kept"]))
        landscape = gather_landscape(run, grid, observations.name, identity)
        if not landscape.has_best:
            raise InterruptedRunError(f"{run}: no cell has an error, in none did all rods converge to certified minima; "
                                      "look at status and stable in cells/")
        summary = {
            **landscape.as_dict(), "observations": observations.count,
            **({} if experiment.pairs is None else {"pairs": experiment.pairs.count}), "hypotheses": resolution,
            **({} if linear_density is None else {DENSITY: linear_density}), "other_up": other_up_of(
                observations, experiment.clamps, grid.axes[-1].values[-1], observations.up, experiment.options.surroundings),
            "timing": {"relaxed_rods": rods * sum(last - first for first, last in left), "loading_s": loading,
                       "relaxation_s": seconds},
            "provenance": provenance(experiment, identity, command),
        }
        summary["shown"] = draw(run, experiment, landscape, identity, linear_density=linear_density)
        summary["timing"]["total_s"] = time.monotonic() - began
        write_text(run / SUMMARY, json.dumps(summary, indent=2) + "\n")
        return summary


@contextmanager
def _resumable(run: Path, command: list[str]) -> Iterator[None]:
    """Raises any other error of a sweep as an InterruptedRunError that says how to resume."""
    try:
        yield
    except (InputError, InterruptedRunError):
        raise
    except (Exception, KeyboardInterrupt) as error:
        reason = " ".join(str(error).split()) or {KeyboardInterrupt: "interrupted"}.get(type(error), type(error).__name__)
        again = shlex.join(command) if command else "the same call"
        raise InterruptedRunError(f"{run}: sweep stopped ({reason}); finished cells are kept, resume with: {again}") from error


def chunk_rows(experiment: Experiment, first: int, last: int) -> dict[str, np.ndarray]:
    """The columns of a chunk, without its rods."""
    return relax_hypotheses(experiment, first, last)[0]


def _relax_chunks(
    run: Path, part: str, experiment: Experiment, chunks: list[tuple[int, int]], workers: ThisProcess | Workers, identity: str,
) -> tuple[float, float]:
    """Have ``workers`` relax ``chunks``, and store them; returns the seconds that it took to load the kernels, where this
    process relaxes, and then to relax the rods."""
    begin = time.monotonic()
    name, cells, rods = experiment.observations.name, experiment.grid.size, len(experiment.rods[0])
    with progress(keep=True) as bar:
        before = cells - sum(last - first for first, last in chunks)
        task = bar.add_task(name, total=cells, completed=before, unit="cells", rate="compiling")
        if chunks and isinstance(workers, ThisProcess):
            load_kernels(experiment)
        began, done = time.monotonic(), 0
        for (first, last), columns in workers.results(partial(chunk_rows, experiment), chunks):
            write_chunk(chunk_path(run, part, first, last), columns, name, identity)
            done += last - first
            rate = done * rods / (time.monotonic() - began)
            bar.update(task, advance=last - first, rate=f"{rate:,.0f} rods/s")
    return began - begin, time.monotonic() - began


# --- picture and recording ------------------------------------------------------------------------------------------------


def draw(folder: Path, experiment: Experiment, landscape: Landscape, identity: str, remark: str = "",
         linear_density: float | None = None) -> list[str]:
    """Write landscape.png and, where rerun is installed, run.rrd into ``folder``; their title ends with ``remark``, and EI is
    shown where the ``linear_density`` in g/m is known. Returns the names of those that were written."""
    from doo_ti.report.landscapes import landscape_picture

    observations, grid, theta = experiment.observations, experiment.grid, landscape.theta
    static = experiment.pairs is None
    terms = f"{observations.count} observations" if static else f"{experiment.pairs.count} pairs"
    title = f"{observations.name}: {landscape.objective} error over {terms}{remark}"
    plane = plane_of(landscape)
    written = []
    if grid.varying:
        written.append("landscape.png")
        known = linear_density is not None and theta["weight"] > 0 and all(axis.name != "weight" for axis in grid.varying)
        landscape_picture(folder / written[-1], plane, title=title, newton_per_bend=(
            stiffness(relative_stiffness(1.0, theta["weight"]), linear_density) if known else None))
    if not can_record():
        return written
    from doo_ti.record.sweep import record_sweep
    from doo_ti.report.canvas import Observed

    record_sweep(
        folder / "run.rrd", run_id=identity[:32], name=title,
        observed=Observed.of(observations if static else observations.take(experiment.pairs.to_index)),
        trajectory=trajectory(experiment, landscape.best), plane=plane, intervals=landscape.intervals,
        properties={"bend_1_mm3": theta["bend_1"], "bend_2_mm3": theta["bend_2"], "twist_mm3": theta["twist"],
                    "weight": theta["weight"], "mean_distance_mm": float(landscape.mean_distance[landscape.best]),
                    "rods": int((landscape.status >= 0).sum()),
                    "cells_competing": landscape.competition["cells_competing"],
                    "rods_converged": int((landscape.status == Status.CONVERGED).sum()),
                    "rods_stable": int(landscape.stable.sum()),
                    "recorded_iterations": "those of Newton" if static else "sub-steps of the motion"},
    )
    return [*written, "run.rrd"]


def trajectory(experiment: Experiment, cell: int):
    """A :class:`doo_ti.record.sweep.SweepTrajectory`: the relaxation of a cell's rods, iteration by iteration under Eq. 2,
    sub-step by sub-step under Eq. 3, each observation under the hypothesis that is nearest in that cell."""
    from doo_ti.record.sweep import SweepTrajectory

    experiment = with_nearest_turns(experiment, cell)
    material = experiment.grid.materials(slice(cell, cell + 1))
    if experiment.pairs is None:
        index, moments = None, list(iterations(experiment, material, MOST_MOMENTS))
    else:
        index, moments = experiment.pairs.to_index[experiment.rods[1]], list(sub_steps(experiment, material))
    kept = np.unique(np.linspace(0, len(moments) - 1, min(len(moments), MOST_MOMENTS + 1)).round().astype(int))
    configurations, energy, residual, status = zip(*(moments[k] for k in kept), strict=True)
    error = distance(configurations[-1], experiment.observations, index, experiment.options.frame_weight)
    vertices = np.stack([configuration.vertices for configuration in configurations])
    return SweepTrajectory(vertices, np.stack(energy), np.stack(residual), status[-1], error)


# --- sweeps that are not finished -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Unfinished:
    """The stored cells of a sweep that is running or was interrupted."""

    experiment: Experiment  # observations, grid and options
    identity: str  # of the sweep
    landscape: Landscape  # of the stored cells
    age: float  # seconds since the last of them were stored

    @property
    def done(self) -> str:
        """``1,300 of 5,200 cells (25 %)``."""
        cells, stored = self.experiment.grid.size, int(self.landscape.stored.sum())
        return f"{stored:,} of {cells:,} cells ({100 * stored // cells} %)"

    def draw(self, folder: Path) -> None:
        """Write landscape.png and run.rrd of the stored cells into ``folder``."""
        draw(folder, self.experiment, self.landscape, self.identity, f", so far {self.done}")


def read_unfinished(run: Path) -> Unfinished:
    """The stored cells of a sweep; its folder is only read. Raises InputError where ``run`` is no sweep's folder,
    InterruptedRunError where no cell is stored yet."""
    experiment, identity = read_plan(run)
    part = "hypotheses" if experiment.hypotheses.are_several else "cells"
    written = [path.stat().st_mtime for path in (run / part).glob("*.parquet")]
    if not written:
        raise InterruptedRunError(f"view: {run}: none of {experiment.grid.size:,} cells is stored yet; try again later")
    landscape = gather_landscape(run, experiment.grid, experiment.observations.name, identity, part, whole=False)
    unfinished = Unfinished(experiment, identity, landscape, max(0.0, time.time() - max(written)))
    if not landscape.has_best:
        raise InterruptedRunError(f"view: {run}: {unfinished.done} are stored, but in none of them did all rods converge to "
                                  "certified minima; look again later, or look at status and stable in cells/")
    return unfinished
