"""The paper's landscapes from finished sweeps (Fig. 3, 4, 5): what to draw is checked before anything is written. The rods of
the recorded cells, and the ribbons of each regime, are relaxed again.

Axes: G grid cells, C recorded ones, D observations, N terms of the objective and rods of a cell, V vertices.
"""

import hashlib
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np

from doo_ti.learning.cross_validation import check_comparable
from doo_ti.learning.experiment import Experiment, are_certified, relax_cells
from doo_ti.learning.landscape import Landscape, plane_of, read_landscape
from doo_ti.learning.run_folder import read_experiment
from doo_ti.record import sweep
from doo_ti.record.motions import record_ribbons
from doo_ti.report.canvas import Observed, quantity, upright_basis, values_text
from doo_ti.report.figures import Ribbons, ribbon_sides, ribbons_picture
from doo_ti.report.landscapes import LandscapePanel, cells_image, landscapes_picture
from doo_ti.report.plane import REGIMES, regime
from doo_ti.rod.grid import Axis, Grid
from doo_ti.rod.types import Configuration
from doo_ti.system.errors import InputError
from doo_ti.system.terminal import progress

MARKS = "minimum over all observations; in the panel of all, those of each end distance"
COLUMNS = 4  # panels of one run side by side
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


@dataclass(frozen=True)
class Study:
    """Finished sweeps over one grid, and what to draw of them."""

    landscapes: list[Landscape]
    experiments: list[Experiment]
    panels: list[LandscapePanel]  # a panel per run
    # for each run a panel for each end distance, then one of all; None where not wanted
    by_distance: list[list[LandscapePanel]] | None
    cells: Cells  # those that are recorded
    # the observation whose ribbon is drawn for each regime; None: the one where the ribbons differ most
    observation: int | None

    @property
    def title(self) -> str:
        """``Static (Eq. 2) error landscapes``."""
        objectives = sorted({landscape.objective for landscape in self.landscapes}, reverse=True)
        equations = {"static": "Eq. 2", "dynamic": "Eq. 3"}
        text = " and ".join(f"{objective} ({equations[objective]})" for objective in objectives)
        return f"{text[0].upper()}{text[1:]} error landscape{'s' * (len(self.landscapes) > 1)}"

    @property
    def names(self) -> list[str]:
        return [panel.title for panel in self.panels]

    @property
    def recorded_values(self) -> dict[str, tuple[int, int]]:
        """How many values of each varying axis are recorded, and of how many."""
        axes = zip(self.cells.grid.axes, self.landscapes[0].grid.axes, strict=True)
        return {axis.name: (len(part), len(axis)) for part, axis in axes if len(axis) > 1}


def read(runs: list[Path], *, by_end_distance: bool, observation: int | None, most_cells: int | None) -> Study:
    """Read finished sweeps. Raises InputError where a folder holds none, where they differ in their grid or repeat a material
    and objective, and where end distances or ``observation`` are missing."""
    landscapes = [read_landscape(run) for run in runs]
    check_comparable(landscapes)
    experiments = [read_experiment(run) for run in runs]
    for landscape, experiment in zip(landscapes, experiments, strict=True):
        if len(landscape.observation) != experiment.terms:
            raise InputError(landscape.run, "observations", f"{experiment.terms} terms, but the cells hold "
                             f"{len(landscape.observation)}", "run the sweep again")
        if observation is not None and observation not in landscape.observation:
            raise InputError(landscape.run, "observation", f"{observation} is not compared with",
                             f"give one of {landscape.observation.min()} to {landscape.observation.max()}")
    several = len({landscape.objective for landscape in landscapes}) > 1
    names = [f"{landscape.name}, {landscape.objective}" if several else landscape.name for landscape in landscapes]
    panels = [LandscapePanel(name, plane_of(landscape)) for name, landscape in zip(names, landscapes, strict=True)]
    by_distance = [_by_end_distance(panel, landscape) for panel, landscape in zip(panels, landscapes, strict=True)
                   ] if by_end_distance else None
    # All cells of the grid, or at most as many evenly spread ones that include each landscape's best.
    grid = landscapes[0].grid
    best = [np.unravel_index(landscape.best, grid.shape) for landscape in landscapes]
    kept = thinned(grid.shape, grid.size if most_cells is None else most_cells, best)
    axes = tuple(Axis(axis.name, axis.values[some], axis.log) for axis, some in zip(grid.axes, kept, strict=True))
    index = tuple(some.ravel() for some in np.meshgrid(*kept, indexing="ij"))
    cells = Cells(Grid(axes, grid.bend_12, grid.source), index, np.ravel_multi_index(index, grid.shape))
    return Study(landscapes, experiments, panels, by_distance, cells, observation)


def _by_end_distance(together: LandscapePanel, landscape: Landscape) -> list[LandscapePanel]:
    """A panel for each end distance, then one of all; each marks the minimum of all, and the last one those of the others.
    Raises InputError where end distances are unknown."""
    if np.isnan(landscape.end_distance).any():
        raise InputError(landscape.run, "end_distance_mm", "unknown",
                         "do not partition by end distance, or give the observations the label")
    distances = np.unique(landscape.end_distance)
    of_terms = [field.name for field in fields(landscape) if isinstance(getattr(landscape, field.name), np.ndarray)]
    parts = [plane_of(replace(landscape, **{name: getattr(landscape, name)[..., landscape.end_distance == distance]
                                            for name in of_terms})) for distance in distances]
    row = [LandscapePanel(f"{together.title}, {distance:g} mm", part, (("", together.plane.minimum),))
           for distance, part in zip(distances, parts, strict=True)]
    marks = tuple((f"{distance:g}", part.minimum) for distance, part in zip(distances, parts, strict=True))
    return [*row, LandscapePanel(f"{together.title}, all", together.plane, marks)]


def _in_rows(panels: list[LandscapePanel]) -> list[list[LandscapePanel]]:
    return [panels[first:first + COLUMNS] for first in range(0, len(panels), COLUMNS)]


def draw_landscapes(study: Study, out: Path) -> list[dict]:
    """Write landscapes.png and, with end distances, end_distances.png into the folder ``out``; returns path, bytes and
    seconds of each file."""
    began, path = time.monotonic(), out / "landscapes.png"
    own_scale = ", each on a colour scale of its own" if len(study.landscapes) > 1 else ""
    landscapes_picture(path, [study.panels], title=f"{study.title}{own_scale}")
    files = [_file(path, began)]
    if study.by_distance:
        began, path = time.monotonic(), out / "end_distances.png"
        rows = study.by_distance if len(study.by_distance) > 1 else _in_rows(study.by_distance[0])
        landscapes_picture(path, rows, title=f"{study.title} by end distance", marks=MARKS, relative=True)
        files.append(_file(path, began))
    return files


# --- the recording of the cells -------------------------------------------------------------------------------------------


def record_cells(study: Study, out: Path) -> list[dict]:
    """Write cells.rrd, with a progress bar of the rods relaxed; returns as :func:`draw_landscapes`."""
    began, path, landscapes, cells = time.monotonic(), out / "cells.rrd", study.landscapes, study.cells
    rows = [_in_rows(panels) for panels in study.by_distance or [[panel] for panel in study.panels]]
    runs = []
    for name, experiment, landscape, panels in zip(study.names, study.experiments, landscapes, rows, strict=True):
        picture, boxes = cells_image(panels, cells.index, marks=MARKS, relative=sum(map(len, panels)) > 1)
        runs.append(sweep.CellsOfRun(name, Observed.of(experiment.observations), landscape.observation, landscape.distance,
                                     picture, boxes))
    mean = np.stack([landscape.mean_distance[cells.cell] for landscape in landscapes])
    # Each run's errors are taken relative to its smallest, so that all runs count alike; cells without an error come first.
    smallest = np.array([landscape.mean_distance[landscape.best] for landscape in landscapes])
    order = np.argsort(-np.nan_to_num((mean / smallest[:, None]).mean(axis=0), nan=np.inf), kind="stable")
    rank = np.argsort(order, kind="stable")
    with progress(keep=True) as bar:
        rods = sum(experiment.terms for experiment in study.experiments) * cells.grid.size
        task = bar.add_task("recording", total=rods, unit="rods")
        sweep.record_cells(path, run_id=_run_id([cells.cell, *(landscape.distance for landscape in landscapes)]),
                           name=study.title, runs=runs, cells=cells.cell, rank=rank, texts=_cell_texts(study),
                           rods=_relaxed(study, advance=lambda done: bar.update(task, advance=done)))
    return [_file(path, began)]


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


def _relaxed(study: Study, advance: Callable[[int], None]) -> Iterator[sweep.Rods]:
    """The rods of all runs, some cells at a time; ``advance`` is called with the number of rods relaxed since the last call."""
    grid = study.cells.grid
    for run, experiment in enumerate(study.experiments):
        part, step = replace(experiment, grid=grid), max(1, RODS_AT_ONCE // experiment.terms)
        for first in range(0, grid.size, step):
            last = min(first + step, grid.size)
            columns, configuration = relax_cells(part, first, last)
            vertices = configuration.vertices
            yield sweep.Rods(run, first, vertices.reshape(last - first, -1, *vertices.shape[1:]),
                             columns["distance_mm"].reshape(last - first, -1), are_certified(columns).reshape(last - first, -1))
            advance(len(vertices))


def _cell_texts(study: Study) -> list[str]:
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


def _run_id(arrays: list[np.ndarray]) -> str:
    return hashlib.sha256(b"".join(np.ascontiguousarray(array).tobytes() for array in arrays)).hexdigest()[:32]


# --- the ribbons of each regime -------------------------------------------------------------------------------------------


def draw_ribbons(study: Study, out: Path) -> list[dict]:
    """Write regimes_NAME.png and .rrd for each run over both bends of a ribbon; returns as :func:`draw_landscapes`."""
    files: list[dict] = []
    for panel, landscape, experiment in zip(study.panels, study.landscapes, study.experiments, strict=True):
        if panel.plane.twist is None:
            continue
        stem = out / f"regimes_{'_'.join(''.join(c if c.isalnum() else ' ' for c in panel.title).split())}"
        began = time.monotonic()
        files += [_file(path, began) for path in draw_regimes(stem, panel.title, experiment, landscape, study.observation)]
    return files


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
                            are_certified(columns)))
    return found


def draw_regimes(stem: Path, name: str, experiment: Experiment, landscape: Landscape,
                 observation: int | None) -> list[Path]:
    """Write ``stem``.png, the ribbons of an observation, by default of that where they differ most, on average over vertices
    and pairs of regimes, all certified minima; and ``stem``.rrd, those of all. Returns the files, none where no regime is in
    the grid."""
    regimes = regimes_of(experiment, landscape)
    if not regimes:
        return []
    observed, seen = Observed.of(experiment.observations), landscape.observation
    shapes = np.stack([found.ribbons.vertices for found in regimes])
    apart = np.linalg.norm(shapes[:, None] - shapes[None], axis=-1).mean(axis=(0, 1, 3))  # (D,) mm
    apart[~np.all([found.sound for found in regimes], axis=0)] = -1.0
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
    record_ribbons(recording, run_id=_run_id(list(shapes)), name=f"{name}: regimes",
                   ribbons=ribbons, observation=seen, rank=rank, basis=basis,
                   texts=[_regime_text(names[k], regimes, k) for k in range(len(seen))])
    return [picture, recording]


def _ribbons(experiment: Experiment, landscape: Landscape, regimes: list[Regime]) -> list[Ribbons]:
    """Those of each regime, after the observed ones where frames were measured; their width is w_m of Eq. 1, if given."""
    observed, seen = experiment.observations, landscape.observation
    width = experiment.options.frame_weight or observed.length / 15
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


def _file(path: Path, began: float) -> dict:
    return {"path": str(path), "bytes": path.stat().st_size, "seconds": time.monotonic() - began}
