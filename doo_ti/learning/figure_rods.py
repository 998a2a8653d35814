"""The rods behind the landscapes of finished sweeps, relaxed again: of every cell, and of a ribbon's regimes (Fig. 3, 4, 5).

Axes: G grid cells, C recorded ones, D observations, N rods of a cell, V vertices.
"""

import hashlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from doo_ti.learning.cells import relax_cells
from doo_ti.learning.experiment import Experiment
from doo_ti.learning.landscape import Landscape
from doo_ti.record import CellsOfRun, Rods, record_cells, record_ribbons
from doo_ti.report import LandscapePanel, Ribbons, cells_image, quantity, ribbon_sides, ribbons_picture, values_text
from doo_ti.report.grid_view import Observed, upright_basis
from doo_ti.report.plane import REGIMES, regime
from doo_ti.rod.grid import Axis, Grid
from doo_ti.rod.types import Configuration, Status

if TYPE_CHECKING:
    from doo_ti.learning.figures import Study

RODS_AT_ONCE = 16_000
REMARK = ("Rods are coloured by their distance, teal the smallest of all cells, yellow the largest; red: not a certified "
          "minimum. Timeline `cell` follows the grid, `falling_error` runs from the worst cell to the best.")
COLORS = ((214, 57, 57), (52, 158, 79), (48, 105, 205))  # of the regimes: red, green and blue as in the paper
OBSERVED = (120, 120, 120)


@dataclass(frozen=True)
class Cells:
    """The cells that are recorded."""

    grid: Grid  # those of a sweep's grid, a grid themselves
    index: tuple[np.ndarray, ...]  # (C,) of each per axis of the sweep's grid
    cell: np.ndarray  # (C,) number of each in the sweep's grid


def cells_to_record(landscapes: list[Landscape], most: int | None) -> Cells:
    """All cells of the grid that the landscapes share, or at most ``most`` evenly spread ones that include each one's best."""
    grid = landscapes[0].grid
    best = [np.unravel_index(landscape.best, grid.shape) for landscape in landscapes]
    kept = thinned(grid.shape, grid.size if most is None else most, best)
    axes = tuple(Axis(axis.name, axis.values[some], axis.log) for axis, some in zip(grid.axes, kept, strict=True))
    index = tuple(some.ravel() for some in np.meshgrid(*kept, indexing="ij"))
    return Cells(Grid(axes, grid.bend_12, grid.source), index, np.ravel_multi_index(index, grid.shape))


def thinned(shape: tuple[int, ...], most: int, kept: list[tuple[int, ...]]) -> tuple[np.ndarray, ...]:
    """For each axis of a grid of ``shape`` the ascending indices to keep, so that they make at most ``most`` cells.

    They are spread evenly, both ends included, and include all cells ``kept`` (an index per axis each), which may take more
    cells than ``most``.
    """
    needed = [sorted({int(cell[axis]) for cell in kept}) for axis in range(len(shape))]
    least = [max(min(2, size), len(some)) for size, some in zip(shape, needed, strict=True)]
    counts = list(shape)
    while np.prod(counts) > most and counts != least:
        spare = [count if count > low else 0 for count, low in zip(counts, least, strict=True)]
        counts[int(np.argmax(spare))] -= 1
    return tuple(_spread(size, count, some) for size, count, some in zip(shape, counts, needed, strict=True))


def _spread(size: int, count: int, needed: list[int]) -> np.ndarray:
    """``count`` indices below ``size``, evenly spread; each of ``needed`` replaces the nearest one."""
    found = np.round(np.linspace(0, size - 1, count)).astype(int)
    free = np.ones(count, dtype=bool)
    for index in needed:
        nearest = int(np.argmin(np.where(free, np.abs(found - index), size)))
        found[nearest], free[nearest] = index, False
    return np.sort(found)


def record_figure(path: Path, study: "Study", rows: list[list[list[LandscapePanel]]], marks: str,
                  advance: Callable[[int], None] = lambda rods: None) -> None:
    """Write the recording ``path`` of the cells of a study.

    rows     of each run: its panels, in rows; ``marks`` is what their marks are
    advance  is called with the number of rods relaxed since the last call
    """
    landscapes, cells = study.landscapes, study.cells
    runs = []
    for name, experiment, landscape, panels in zip(study.names, study.experiments, landscapes, rows, strict=True):
        picture, boxes = cells_image(panels, cells.index, marks=marks, relative=sum(map(len, panels)) > 1)
        runs.append(CellsOfRun(name, Observed.of(experiment.observations), landscape.observation, landscape.distance,
                               picture, boxes))
    mean = np.stack([landscape.mean_distance[cells.cell] for landscape in landscapes])
    # Each run's errors are taken relative to its smallest, so that all runs count alike; cells without an error come first.
    smallest = np.array([landscape.mean_distance[landscape.best] for landscape in landscapes])
    order = np.argsort(-np.nan_to_num((mean / smallest[:, None]).mean(axis=0), nan=np.inf), kind="stable")
    rank = np.empty(len(order), int)
    rank[order] = np.arange(len(order))
    record_cells(path, run_id=_run_id([cells.cell, *(landscape.distance for landscape in landscapes)]), name=study.title,
                 runs=runs, cells=cells.cell, rank=rank, texts=_cell_texts(study),
                 rods=_relaxed(study.experiments, cells, advance))


def _run_id(arrays: list[np.ndarray]) -> str:
    """An identity that depends on the arrays only."""
    return hashlib.sha256(b"".join(np.ascontiguousarray(array).tobytes() for array in arrays)).hexdigest()[:32]


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


def _cell_texts(study: "Study") -> list[str]:
    """Θ of each recorded cell and each run's result there, in Markdown."""
    grid, cells = study.landscapes[0].grid, study.cells
    values = [(axis.name, axis.values[some], axis.unit) for axis, some in zip(grid.axes, cells.index, strict=True)
              if len(axis) > 1 or axis.name != "weight"]
    head = ["", "| run | mean distance (Eq. 1) | over the smallest | rods not certified | jumped |", "|---|---|---|---|---|"]
    texts = []
    for step, cell in enumerate(cells.cell):
        theta = values_text([(name, value[step], unit) for name, value, unit in values])
        rows = []
        for name, landscape in zip(study.names, study.landscapes, strict=True):
            mean, rods = landscape.mean_distance, landscape.status.shape[1]
            jumped = "–" if landscape.jumps is None else f"{(landscape.jumps[cell] > 0).sum()} of {rods}"
            rows.append(f"| {name} | **{quantity(mean[cell], 'mm')}** | {quantity(mean[cell] / mean[landscape.best])} | "
                        f"{landscape.unsound[cell]} of {rods} | {jumped} |")
        texts.append("\n".join([f"**Cell {cell} of {grid.size}: {theta}**", *head, *rows, "", REMARK]))
    return texts


@dataclass(frozen=True)
class Regime:
    """The ribbons of one regime, under the cell in its middle."""

    number: int  # 1 to 3, as `REGIMES` counts them
    mean: float  # mm, the mean distance there
    theta: str  # Θ of the cell, as text
    ribbons: Configuration  # D of them
    distance: np.ndarray  # (D,) Eq. 1, mm
    sound: np.ndarray  # (D,) bool: certified minima

    @property
    def label(self) -> str:
        return f"{self.number}: {REGIMES[self.number - 1]}"


def regimes_of(experiment: Experiment, landscape: Landscape) -> list[Regime]:
    """The regimes that have cells in the grid."""
    values = landscape.grid.cell_values()
    bends = np.log(np.stack([values["bend_1"], values["bend_2"]], axis=-1))
    of_cell = regime(values["bend_1"], values["bend_2"], values["twist"])
    found = []
    for number in range(1, len(REGIMES) + 1):
        cells = np.flatnonzero(of_cell == number)
        if not len(cells):
            continue
        cell = int(cells[np.argmin(np.linalg.norm(bends[cells] - bends[cells].mean(axis=0), axis=-1))])
        columns, configuration = relax_cells(experiment, cell, cell + 1)
        theta = values_text([(name, values[name][cell], "mm³") for name in ("bend_1", "bend_2")])
        found.append(Regime(number, float(landscape.mean_distance[cell]), theta, configuration, columns["distance_mm"],
                            (columns["status"] == Status.CONVERGED) & columns["stable"]))
    return found


def difference(regimes: list[Regime]) -> np.ndarray:
    """(D,) mm between the ribbons of a term, on average over vertices and pairs of regimes; −1 where one of them is no
    certified minimum."""
    shapes = np.stack([found.ribbons.vertices for found in regimes])
    apart = np.linalg.norm(shapes[:, None] - shapes[None], axis=-1).mean(axis=(0, 1, 3))
    return np.where(np.all([found.sound for found in regimes], axis=0), apart, -1.0)


def draw_regimes(stem: Path, name: str, experiment: Experiment, landscape: Landscape,
                 observation: int | None) -> list[Path]:
    """Write ``stem``.png, the ribbons of an observation, by default of the one where they differ most, and ``stem``.rrd,
    those of all; returns the files, none where the grid has no regime."""
    regimes = regimes_of(experiment, landscape)
    if not regimes:
        return []
    observed, seen = Observed.of(experiment.observations), landscape.observation
    apart = difference(regimes)
    if observation is not None:
        apart[seen == observation] += apart.max() + 2
    order = np.argsort(apart, kind="stable")
    rank, term = np.argsort(order, kind="stable"), order[-1]
    names = [observed.names[d] for d in seen]
    ribbons = _ribbons(experiment, landscape, regimes)
    basis = upright_basis(observed.vertices[[seen[term]]], observed.up)
    title = f"{name}, {names[term]}: one ribbon between the same clamps in each regime"
    if lost := [str(found.number) for found in regimes if not found.sound[term]]:
        title += f"\nno certified minimum in regime {', '.join(lost)}"
    picture, recording = stem.with_suffix(".png"), stem.with_suffix(".rrd")
    ribbons_picture(picture, ribbons, term, basis=basis, title=title)
    record_ribbons(recording, run_id=_run_id([found.ribbons.vertices for found in regimes]), name=f"{name}: regimes",
                   ribbons=ribbons, observation=seen, rank=rank, basis=basis,
                   texts=[_regime_text(names[k], regimes, k) for k in range(len(seen))])
    return [picture, recording]


def _ribbons(experiment: Experiment, landscape: Landscape, regimes: list[Regime]) -> list[Ribbons]:
    """Those of each regime, after the observed ones where frames were measured; their width is w_m of Eq. 1, if given."""
    observed, seen = experiment.observations, landscape.observation
    width = experiment.options.frame_weight or observed.rest_length.sum() / 15
    ribbons = []
    if observed.frames is not None and observed.valid.all():
        sides = ribbon_sides(observed.vertices, observed.frames[..., 1], width)[seen]
        ribbons = [Ribbons("observed", OBSERVED, sides, filled=False)]
    label = "{}\n{}\nmean distance {} over all observations"
    for found in regimes:
        ribbons.append(Ribbons(label.format(found.label, found.theta, quantity(found.mean, "mm")), COLORS[found.number - 1],
                               ribbon_sides(found.ribbons.vertices, found.ribbons.frames[..., 1], width)))
    return ribbons


def _regime_text(name: str, regimes: list[Regime], term: int) -> str:
    """The distances of a term's ribbons, in Markdown."""
    lines = [f"**{name}**", "", "| regime | Θ | distance (Eq. 1) | mean over all |", "|---|---|---|---|"]
    lines += [f"| {found.label} | {found.theta} | **{quantity(found.distance[term], 'mm')}**"
              f"{'' if found.sound[term] else ', not a certified minimum'} | {quantity(found.mean, 'mm')} |"
              for found in regimes]
    return "\n".join([*lines, "", "Red, green, blue: regimes 1, 2, 3, each under the cell where its number is drawn in the "
                                  "landscape; grey: observed."])
