"""A sweep: Eq. 2 for every cell of a grid, in chunks that are stored as they finish (§III-E).

    RUN/cells/*.parquet   one row per (cell, observation)
    RUN/summary.json      best Θ, its error, the range of each parameter within 5 %, counts of statuses, provenance
    RUN/landscape.png     the error landscape
    RUN/run.rrd           the recording

A sweep that was stopped goes on where it was. Axes: G cells, D observations, N whole-turn hypotheses of all observations.
"""

import json
import os
import shlex
import time
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import nullcontext
from dataclasses import asdict, dataclass
from functools import partial
from multiprocessing import get_context, parent_process
from multiprocessing.connection import wait
from pathlib import Path

import numpy as np

from doo_ti.dataset import Observations, write_whole
from doo_ti.descent import Descent
from doo_ti.errors import InputError, InterruptedRunError
from doo_ti.grid import Grid
from doo_ti.learning import gather_landscape, status_counts
from doo_ti.newton import Newton
from doo_ti.run_folder import chunk_path, claim, finished, identity_of, provenance, store
from doo_ti.start import (
    check_experiment,
    choose_hypothesis,
    observation_clamps,
    start_configuration,
    turn_hypotheses,
)
from doo_ti.types import Clamp

CHUNK_BYTES = 32 << 20
"""Memory for the frames of a chunk's rods, the larger part of what a sweep holds: 31 000 rods of 33 edges."""
MOST_RODS = 1_000_000_000
MOST_FRAMES = 60
"""Solver iterations of the best cell that are recorded."""


@dataclass(frozen=True)
class SweepOptions:
    """How a sweep relaxes and compares.

    frame_weight           w_m of Eq. 1, mm
    clamp_start, clamp_end what holds the ends; None: the frame where it is given, else the tangent
    solver, precision      as :func:`doo_ti.relaxation.relax` takes them
    objective              "static" (Eq. 2)
    seed                   of everything random, for the provenance: a static sweep draws nothing
    workers                processes to share the chunks; None: this one. The result does not depend on it
    """

    frame_weight: float = 0.0
    clamp_start: Clamp | None = None
    clamp_end: Clamp | None = None
    solver: Newton | Descent = Newton()
    precision: str = "mixed"
    objective: str = "static"
    seed: int = 0
    workers: int | None = None


def sweep(run: Path, observations: Observations, grid: Grid, *, options: SweepOptions = SweepOptions(),
          command: list[str] = ()) -> dict:
    """Run the sweep in the folder ``run``, or what is left of it, and return the summary.

    Raises InputError where ``run`` holds another sweep, InterruptedRunError where a chunk fails: what is done is kept.
    """
    began = time.monotonic()
    run = Path(run)
    clamps = _clamps(observations, options)
    check_experiment(observations, clamps, grid.axes[-1].values[-1], options.frame_weight)
    rods = len(turn_hypotheses(observations, clamps)[0])
    if rods * grid.size > MOST_RODS:
        raise InputError(grid.source, "grid", f"{grid.size:,} cells are {rods * grid.size:,} rods",
                         f"give a grid of at most {MOST_RODS // rods:,} cells")
    together = CHUNK_BYTES // (32 * observations.edges)
    identity = identity_of(observations, grid, options, together)
    claim(run, identity)
    step = max(1, together // rods)
    chunks = [(first, min(first + step, grid.size)) for first in range(0, grid.size, step)]
    left = [chunk for chunk in chunks if not chunk_path(run, *chunk).exists()]
    if not left and (done := finished(run, identity)):
        return done
    relaxed = rods * sum(last - first for first, last in left)
    seconds = _relax_chunks(run, observations, grid, options, left, rods, command)
    landscape = gather_landscape(run, grid, observations.name)
    if np.isnan(landscape.mean_distance).all():
        raise InterruptedRunError(f"{run}: no cell has an error, every rod came to nothing; look at status in cells/")
    best = landscape.best
    theta = {name: float(value[best]) for name, value in grid.cell_values().items()}
    summary = {
        "material": observations.name,
        "best": {**theta, "bend_12": grid.bend_12, "mean_distance_mm": float(landscape.mean_distance[best])},
        "intervals_within_5_percent": [asdict(interval) for interval in landscape.intervals],
        "units": {"bend_1": "mm3", "bend_2": "mm3", "bend_12": "mm3", "twist": "mm3", "weight": "relative"},
        "rods": {"count": int(landscape.status.size), **status_counts(landscape.status),
                 "stable": int(landscape.stable.sum())},
        "rods_at_best": {**status_counts(landscape.status[best]), "stable": int(landscape.stable[best].sum())},
        "observations": observations.count,
        "cells": grid.size,
        "grid": grid.as_dict(),
        "timing": {"relaxed_rods": relaxed, "relaxation_s": seconds, "total_s": time.monotonic() - began},
        "provenance": provenance(observations, clamps, options, identity, command),
    }
    _draw(run, observations, grid, options, landscape, summary)
    summary["timing"]["total_s"] = time.monotonic() - began
    text = json.dumps(summary, indent=2) + "\n"
    write_whole(run / "summary.json", lambda file: file.write(text.encode()))
    return summary


def sweep_cells(observations: Observations, grid: Grid, options: SweepOptions, first: int, last: int) -> dict:
    """The rows of cells ``first`` to ``last``, cell by cell: columns by name. Of several whole-turn hypotheses of an
    observation the one nearest to it stands in each cell; the column ``turns`` says which."""
    from doo_ti.metric import distance
    from doo_ti.relaxation import relax

    clamps = _clamps(observations, options)
    index, turns = turn_hypotheses(observations, clamps)
    starts = start_configuration(observations.take(index), clamps.take(index), turns)
    cells, hypotheses = last - first, len(index)
    of_cell, of_hypothesis = np.divmod(np.arange(cells * hypotheses), hypotheses)
    solution = relax(starts, grid.materials(slice(first, last)), clamps.take(index), options.solver, up=observations.up,
                     precision=options.precision, configuration_index=of_hypothesis, material_index=of_cell)
    error = distance(solution.configuration, observations, index[of_hypothesis], options.frame_weight)
    if hypotheses == observations.count:
        rows = np.arange(cells * hypotheses)
    else:
        sound = solution.converged & solution.stable
        rows = choose_hypothesis(of_cell * observations.count + index[of_hypothesis], error, sound)
    cell, observation = of_cell[rows], index[of_hypothesis[rows]]
    columns = {name: values[cell] for name, values in grid.cell_values(slice(first, last)).items()}
    columns |= {"observation": observation.astype(np.int32), "turns": turns[of_hypothesis[rows]].astype(np.int32)}
    for name, labels in (("end_distance_mm", observations.end_distance), ("end_rotation_deg", observations.end_rotation)):
        columns[name] = np.full(len(rows), np.nan) if labels is None else labels[observation]
    columns["distance_mm"] = error[rows]
    for name in ("energy", "residual", "iterations", "status", "stable", "precision"):
        columns[name] = getattr(solution, name)[rows]
    return columns


def _clamps(observations: Observations, options: SweepOptions):
    return observation_clamps(observations, options.clamp_start, options.clamp_end)


def _relax_chunks(run, observations, grid, options, chunks, rods, command) -> float:
    """Relax and store ``chunks``; returns the seconds it took."""
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
    from rich.console import Console

    began = time.monotonic()
    work = partial(sweep_cells, observations, grid, options)
    bar = Progress(TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TextColumn("cells"),
                   TextColumn("{task.fields[rate]}"), TimeRemainingColumn(), console=Console(stderr=True))
    try:
        with bar, _pool(options.workers) as executor:
            before = grid.size - sum(last - first for first, last in chunks)
            task = bar.add_task(observations.name, total=grid.size, completed=before, rate="compiling")
            done = 0
            for (first, last), columns in _results(work, chunks, executor):
                store(chunk_path(run, first, last), columns, observations.name)
                done += last - first
                rate = done * rods / (time.monotonic() - began)
                bar.update(task, advance=last - first, rate=f"{rate:,.0f} rods/s")
    except InputError:
        raise
    except (Exception, KeyboardInterrupt) as error:
        reason = " ".join(str(error).split()) or {KeyboardInterrupt: "interrupted"}.get(type(error), type(error).__name__)
        again = shlex.join(command) if command else "the same call"
        raise InterruptedRunError(f"{run}: sweep stopped ({reason}); finished cells are kept, go on with: {again}") from error
    return time.monotonic() - began


def _pool(workers: int | None):
    """An executor of that many spawned processes that share the processors; without a number none."""
    if workers is None:
        return nullcontext()
    threads = max(1, (os.cpu_count() or 1) // workers)
    return ProcessPoolExecutor(workers, get_context("spawn"), initializer=_start_worker, initargs=(threads,))


def _start_worker(threads: int) -> None:
    """Start Taichi on ``threads`` threads, and see to it that the worker does not outlive its parent."""
    from threading import Thread

    from doo_ti import runtime

    def end_with_parent() -> None:
        wait([parent_process().sentinel])
        os._exit(1)

    Thread(target=end_with_parent, daemon=True).start()
    runtime.start(threads=threads)


def _results(work, chunks, executor: Executor | None):
    """(chunk, columns) of each chunk in order, computed here or by the executor, a few ahead."""
    if executor is None:
        for chunk in chunks:
            yield chunk, work(*chunk)
        return
    ahead = 2 * (os.cpu_count() or 1)
    waiting = []
    for chunk in chunks:
        waiting.append((chunk, executor.submit(work, *chunk)))
        if len(waiting) > ahead:
            chunk, future = waiting.pop(0)
            yield chunk, future.result()
    for chunk, future in waiting:
        yield chunk, future.result()


def _draw(run: Path, observations: Observations, grid: Grid, options: SweepOptions, landscape, summary: dict) -> None:
    """landscape.png and run.rrd."""
    from doo_ti.record import record_sweep
    from doo_ti.report import landscape_picture
    from doo_ti.types import Status

    axes = [(axis.name, axis.values, axis.log, axis.unit) for axis in grid.axes]
    values = landscape.mean_distance.reshape(grid.shape)
    minimum = np.unravel_index(landscape.best, grid.shape)
    sound = (landscape.status == Status.CONVERGED) & landscape.stable
    unfinished = (~sound).sum(axis=1).reshape(grid.shape)
    label = "mean distance (Eq. 1) [mm]"
    title = f"{observations.name}: static error over {observations.count} observations"
    if any(len(axis) > 1 for axis in grid.axes):
        write_whole(run / "landscape.png", lambda file: landscape_picture(
            file, axes, values, minimum=minimum, title=title, label=label, unfinished=unfinished))
    trajectory, energy, residual, status, error = _trajectory(observations, grid, options, landscape.best)
    best, rods = summary["best"], summary["rods"]
    record_sweep(
        run / "run.rrd", run_id=summary["provenance"]["sweep_sha256"][:32], name=title,
        observations_vertices=np.where(observations.valid[..., None], observations.vertices, np.nan),
        labels={"end_distance_mm": observations.end_distance, "end_rotation_deg": observations.end_rotation},
        trajectory=trajectory, energy=energy, residual=residual, status=status, distance=error,
        axes=axes, landscape=values, minimum=minimum, unfinished=unfinished, intervals=landscape.intervals,
        properties={"bend_1_mm3": best["bend_1"], "bend_2_mm3": best["bend_2"], "twist_mm3": best["twist"],
                    "weight": best["weight"], "mean_distance_mm": best["mean_distance_mm"], "rods": rods["count"],
                    "rods_converged": rods.get("converged", 0), "rods_stable": rods["stable"],
                    "recorded_iterations": "those of Newton"},
        up=observations.up,
    )


def _trajectory(observations: Observations, grid: Grid, options: SweepOptions, best: int):
    """The rods of the best cell after 1, 2, … solver iterations: (T, D, V, 3) vertices, (T, D) energy and residual, and
    the last (D,) status and distance. A relaxation stopped after k iterations is the first k of the whole one."""
    from doo_ti.metric import distance
    from doo_ti.relaxation import relax

    columns = sweep_cells(observations, grid, options, best, best + 1)
    clamps = _clamps(observations, options)
    starts = start_configuration(observations, clamps, columns["turns"])
    material = grid.materials(slice(best, best + 1))
    vertices, energy, residual = [starts.vertices], [], []
    solution = None
    for count in range(1, MOST_FRAMES + 1):
        solution = relax(starts, material, clamps, Newton(max_iterations=count), up=observations.up)
        vertices.append(solution.configuration.vertices)
        energy.append(solution.energy)
        residual.append(solution.residual)
        if (solution.iterations < count).all():
            break
    first = np.full((1, observations.count), np.nan)
    error = distance(solution.configuration, observations, None, options.frame_weight)
    return (np.stack(vertices), np.concatenate([first, energy]), np.concatenate([first, residual]), solution.status, error)
