"""The rods of every cell of finished sweeps, relaxed again and recorded beside the landscapes (Fig. 3, 4, 5).

Axes: G grid cells, C recorded ones, D observations, N rods of a cell.
"""

import hashlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from doo_ti.figures.panels import MARKS, in_rows, run_name
from doo_ti.figures.thinning import thinned
from doo_ti.grid import Axis, Grid
from doo_ti.learning.cells import relax_cells
from doo_ti.learning.experiment import Experiment
from doo_ti.learning.landscape import Landscape
from doo_ti.record import CellsOfRun, Rods, record_cells
from doo_ti.report import MEAN_DISTANCE, LandscapePanel, cells_image, quantity, values_text
from doo_ti.types import Status

RODS_AT_ONCE = 16_000
REMARK = ("Rods are coloured by their distance, teal the smallest of all cells, yellow the largest; red: not a certified "
          "minimum. Timeline `cell` follows the grid, `falling_error` runs from the worst cell to the best.")


@dataclass(frozen=True)
class Cells:
    """The cells that are recorded.

    grid   those of a sweep's grid, a grid themselves
    index  (C,) of each per axis of the sweep's grid
    cell   (C,) number of each in the sweep's grid
    """

    grid: Grid
    index: tuple[np.ndarray, ...]
    cell: np.ndarray


def cells_to_record(landscapes: list[Landscape], most: int | None) -> Cells:
    """All cells of the grid that the landscapes share, or an even part of at most ``most`` that holds each one's best."""
    grid = landscapes[0].grid
    best = [np.unravel_index(landscape.best, grid.shape) for landscape in landscapes]
    kept = thinned(grid.shape, grid.size if most is None else most, best)
    axes = tuple(Axis(axis.name, axis.values[some], axis.log) for axis, some in zip(grid.axes, kept, strict=True))
    index = tuple(some.ravel() for some in np.meshgrid(*kept, indexing="ij"))
    return Cells(Grid(axes, grid.bend_12, grid.source), index, np.ravel_multi_index(index, grid.shape))


def record_figure(path: Path, experiments: list[Experiment], landscapes: list[Landscape], rows: list[list[LandscapePanel]],
                  cells: Cells, *, title: str, advance: Callable[[int], None] = lambda rods: None) -> None:
    """Write the recording ``path``. ``rows`` holds each run's panels; ``advance`` is told of rods as they are done."""
    runs = [_still(experiment, landscape, run_name(landscape, landscapes), panels, cells)
            for experiment, landscape, panels in zip(experiments, landscapes, rows, strict=True)]
    mean = np.stack([landscape.mean_distance[cells.cell] for landscape in landscapes])
    # Errors of several runs count alike, each over its smallest; cells without one come first.
    smallest = np.array([landscape.mean_distance[landscape.best] for landscape in landscapes])
    order = np.argsort(-np.nan_to_num((mean / smallest[:, None]).mean(axis=0), nan=np.inf), kind="stable")
    rank = np.empty(len(order), int)
    rank[order] = np.arange(len(order))
    digest = hashlib.sha256(b"".join(np.ascontiguousarray(part).tobytes() for part in (
        cells.cell, *(landscape.distance for landscape in landscapes))))
    record_cells(path, run_id=digest.hexdigest()[:32], name=title, runs=runs, cells=cells.cell, rank=rank,
                 texts=_texts(landscapes, cells), rods=_relaxed(experiments, cells, advance))


def _still(experiment: Experiment, landscape: Landscape, name: str, panels: list[LandscapePanel], cells: Cells) -> CellsOfRun:
    """What no cell changes."""
    observed = experiment.observations
    picture, boxes = cells_image(in_rows(panels), cells.index, title="", label=MEAN_DISTANCE, marks=MARKS,
                                 relative=len(panels) > 1)
    return CellsOfRun(
        name=name, vertices=np.where(observed.valid[..., None], observed.vertices, np.nan),
        labels={"end_distance_mm": observed.end_distance, "end_rotation_deg": observed.end_rotation}, up=observed.up,
        observation=landscape.observation, distance=landscape.distance, picture=picture, boxes=boxes)


def _relaxed(experiments: list[Experiment], cells: Cells, advance: Callable[[int], None]) -> Iterator[Rods]:
    """The rods of all runs, some cells at a time."""
    for run, experiment in enumerate(experiments):
        part = replace(experiment, grid=cells.grid)
        step = max(1, RODS_AT_ONCE // part.terms)
        for first in range(0, cells.grid.size, step):
            last = min(first + step, cells.grid.size)
            columns, configuration = relax_cells(part, first, last)
            sound = (columns["status"] == Status.CONVERGED) & columns["stable"]
            vertices = configuration.vertices
            yield Rods(run, first, vertices.reshape(last - first, -1, *vertices.shape[1:]),
                       columns["distance_mm"].reshape(last - first, -1), sound.reshape(last - first, -1))
            advance(len(vertices))


def _texts(landscapes: list[Landscape], cells: Cells) -> list[str]:
    """Θ of each recorded cell and what each run makes of it, in Markdown."""
    grid = landscapes[0].grid
    values = [(axis.name, axis.values[some], axis.unit) for axis, some in zip(grid.axes, cells.index, strict=True)
              if len(axis) > 1 or axis.name != "weight"]
    columns = [_columns(run_name(landscape, landscapes), landscape, cells.cell) for landscape in landscapes]
    head = ["", "| run | mean distance (Eq. 1) | over the smallest | rods not certified | jumped |", "|---|---|---|---|---|"]
    texts = []
    for step, cell in enumerate(cells.cell):
        theta = values_text([(name, value[step], unit) for name, value, unit in values])
        rows = [f"| {' | '.join(column[step] for column in of_run)} |" for of_run in columns]
        texts.append("\n".join([f"**Cell {cell} of {grid.size}: {theta}**", *head, *rows, "", REMARK]))
    return texts


def _columns(name: str, landscape: Landscape, cell: np.ndarray) -> list[list[str]]:
    """What a run makes of the cells: each column of its table as text."""
    mean, (_, rods) = landscape.mean_distance, landscape.status.shape
    unfinished = landscape.unsound[cell]
    jumped = None if landscape.jumps is None else (landscape.jumps > 0).sum(axis=1)[cell]
    return [[name] * len(cell), [f"**{quantity(value, 'mm')}**" for value in mean[cell]],
            [quantity(value) for value in mean[cell] / mean[landscape.best]],
            [f"{count} of {rods}" for count in unfinished],
            ["–"] * len(cell) if jumped is None else [f"{count} of {rods}" for count in jumped]]
