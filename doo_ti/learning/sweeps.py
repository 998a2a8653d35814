"""A sweep: Eq. 2 or 3 for every cell of a grid, in chunks that are stored as they finish (§III-E).

    RUN/cells/*.parquet   one row per (cell, observation), under Eq. 3 per (cell, pair)
    RUN/summary.json      best Θ, its error, the range of each parameter within 5 %, counts of statuses, provenance
    RUN/landscape.png     the error landscape
    RUN/run.rrd           the recording

and what :mod:`doo_ti.learning.run_folder` names besides. A sweep that was stopped goes on where it was.
"""

import shlex
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

import numpy as np

from doo_ti.dataset import Observations
from doo_ti.errors import InputError, InterruptedRunError
from doo_ti.grid import Grid
from doo_ti.learning.cells import relax_hypotheses
from doo_ti.learning.chunk_file import check_identity, chunk_path, read_rows, write_chunk
from doo_ti.learning.experiment import Experiment, SweepOptions
from doo_ti.learning.hypotheses import Hypotheses
from doo_ti.learning.landscape import Landscape, competition_of, gather_landscape, jumps_of, status_counts
from doo_ti.learning.pairs import Pairs
from doo_ti.learning.resolution import resolve
from doo_ti.learning.run_folder import claim, finished, identity_of, provenance
from doo_ti.learning.summary import write_summary
from doo_ti.learning.trajectory import trajectory
from doo_ti.learning.workers import Alone, Crew, crew
from doo_ti.progress import progress
from doo_ti.start import check_experiment
from doo_ti.whole_file import write_whole

CHUNK_BYTES = 32 << 20
"""Memory for the frames of a chunk's rods, the larger part of what a sweep holds: 31 000 rods of 33 edges."""
MOST_RODS = 1_000_000_000


def sweep(run: Path, observations: Observations, grid: Grid, *, options: SweepOptions = SweepOptions(),
          pairs: Pairs | None = None, command: list[str] = ()) -> dict:
    """Run the sweep in the folder ``run``, or what is left of it, and return the summary.

    pairs  the terms of Eq. 3; by default those of the labels

    Raises InputError for what :class:`doo_ti.learning.experiment.Experiment` refuses, where ``run`` holds another sweep and
    where no scheduler answers, InterruptedRunError where a chunk fails: what is done is kept.
    """
    with crew(options.workers, options.scheduler) as workers:
        return _swept(run, Experiment(observations, grid, options, pairs), workers, command)


def _swept(run: Path, experiment: Experiment, workers: Alone | Crew, command: list[str]) -> dict:
    """The sweep, its work done by ``workers``."""
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
        if not left and (done := finished(run, identity)):
            return done
        paths = [chunk_path(run, part, *chunk) for chunk in chunks if chunk not in set(left)]
        check_identity(paths, identity)
        for path in paths:  # what was stored before, whole, since its digest is about to be taken
            read_rows(path)
        seconds = _relax_chunks(run, part, experiment, left, workers, identity)
        resolution = None
        if part == "hypotheses":
            resolution = resolve(run, experiment, chunks)
            experiment = replace(experiment, hypotheses=Hypotheses.from_dict(resolution["kept"]))
        landscape = gather_landscape(run, grid, observations.name, identity)
        if np.isnan(landscape.mean_distance).all():
            raise InterruptedRunError(f"{run}: no cell has an error, in none did all rods converge to certified minima; "
                                      "look at status and stable in cells/")
        summary = {
            **_result(experiment, landscape), "hypotheses": resolution,
            "timing": {"relaxed_rods": rods * sum(last - first for first, last in left), "relaxation_s": seconds},
            "provenance": provenance(experiment, identity, command),
        }
        _draw(run, experiment, landscape, summary)
        summary["timing"]["total_s"] = time.monotonic() - began
        return write_summary(run, summary)


@contextmanager
def _resumable(run: Path, command: list[str]) -> Iterator[None]:
    """Raises what ends a sweep on its way as an InterruptedRunError that says how to go on."""
    try:
        yield
    except (InputError, InterruptedRunError):
        raise
    except (Exception, KeyboardInterrupt) as error:
        reason = " ".join(str(error).split()) or {KeyboardInterrupt: "interrupted"}.get(type(error), type(error).__name__)
        again = shlex.join(command) if command else "the same call"
        raise InterruptedRunError(f"{run}: sweep stopped ({reason}); finished cells are kept, go on with: {again}") from error


def _result(experiment: Experiment, landscape: Landscape) -> dict:
    """What a landscape says, as the summary holds it."""
    grid, best = experiment.grid, landscape.best
    theta = {name: float(value[best]) for name, value in grid.cell_values().items()}
    result = {
        "material": landscape.name,
        "objective": landscape.objective,
        "best": {**theta, "bend_12": grid.bend_12, "mean_distance_mm": float(landscape.mean_distance[best])},
        "intervals_within_5_percent": [asdict(interval) for interval in landscape.intervals],
        "units": {"bend_1": "mm3", "bend_2": "mm3", "bend_12": "mm3", "twist": "mm3", "weight": "relative"},
        "rods": {"count": int(landscape.status.size), **status_counts(landscape.status),
                 "stable": int(landscape.stable.sum())},
        **competition_of(landscape),
        "rods_at_best": {**status_counts(landscape.status[best]), "stable": int(landscape.stable[best].sum())},
        "observations": experiment.observations.count,
        "cells": grid.size,
        "grid": grid.as_dict(),
    }
    if experiment.pairs is not None:
        result["pairs"] = experiment.pairs.count
        result["jumps"] = jumps_of(landscape)
    return result


def _rows(experiment: Experiment, first: int, last: int) -> dict[str, np.ndarray]:
    """The columns of a chunk, without its rods."""
    return relax_hypotheses(experiment, first, last)[0]


def _relax_chunks(
    run: Path, part: str, experiment: Experiment, chunks: list[tuple[int, int]], workers: Alone | Crew, identity: str,
) -> float:
    """Have ``workers`` relax ``chunks`` and store them; returns the seconds it took."""
    began = time.monotonic()
    name, cells, rods = experiment.observations.name, experiment.grid.size, len(experiment.rods[0])
    with progress(lasting=True) as bar:
        before = cells - sum(last - first for first, last in chunks)
        task = bar.add_task(name, total=cells, completed=before, unit="cells", rate="compiling")
        done = 0
        for (first, last), columns in workers.results(partial(_rows, experiment), chunks):
            write_chunk(chunk_path(run, part, first, last), columns, name, identity)
            done += last - first
            rate = done * rods / (time.monotonic() - began)
            bar.update(task, advance=last - first, rate=f"{rate:,.0f} rods/s")
    return time.monotonic() - began


def _draw(run: Path, experiment: Experiment, landscape: Landscape, summary: dict) -> None:
    """landscape.png and run.rrd."""
    from doo_ti.record import record_sweep
    from doo_ti.report import landscape_picture

    observations, grid = experiment.observations, experiment.grid
    axes = grid.picture_axes
    values = landscape.mean_distance.reshape(grid.shape)
    minimum = np.unravel_index(landscape.best, grid.shape)
    unfinished = landscape.unsound.reshape(grid.shape)
    static = experiment.pairs is None
    label = "mean distance (Eq. 1) [mm]"
    terms = f"{observations.count} observations" if static else f"{experiment.pairs.count} pairs"
    title = f"{observations.name}: {landscape.objective} error over {terms}"
    if any(len(axis) > 1 for axis in grid.axes):
        write_whole(run / "landscape.png", lambda file: landscape_picture(
            file, axes, values, minimum=minimum, title=title, label=label, unfinished=unfinished))
    seen = observations if static else observations.take(experiment.pairs.to_index)
    way = trajectory(experiment, landscape.best)
    best, rods = summary["best"], summary["rods"]
    record_sweep(
        run / "run.rrd", run_id=summary["provenance"]["sweep_sha256"][:32], name=title,
        observations_vertices=np.where(seen.valid[..., None], seen.vertices, np.nan),
        labels={"end_distance_mm": seen.end_distance, "end_rotation_deg": seen.end_rotation},
        trajectory=way.vertices, energy=way.energy, residual=way.residual, status=way.status, distance=way.distance,
        axes=axes, landscape=values, minimum=minimum, unfinished=unfinished, intervals=landscape.intervals,
        properties={"bend_1_mm3": best["bend_1"], "bend_2_mm3": best["bend_2"], "twist_mm3": best["twist"],
                    "weight": best["weight"], "mean_distance_mm": best["mean_distance_mm"], "rods": rods["count"],
                    "cells_competing": summary["cells_competing"],
                    "rods_converged": rods.get("converged", 0), "rods_stable": rods["stable"],
                    "recorded_iterations": "those of Newton" if static else "sub-steps of the motion"},
        up=observations.up,
    )
