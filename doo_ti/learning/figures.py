"""The paper's landscapes from finished sweeps (Fig. 3, 4, 5): what to draw is checked before anything is written.

Axes: G grid cells, N terms of the objective.
"""

import time
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np

from doo_ti.learning.cross_validation import check_comparable
from doo_ti.learning.drawing import plane_of
from doo_ti.learning.experiment import Experiment
from doo_ti.learning.figure_rods import Cells, cells_to_record, draw_regimes, record_figure
from doo_ti.learning.landscape import Landscape, read_landscape
from doo_ti.learning.run_folder import read_experiment
from doo_ti.report import LandscapePanel, landscapes_picture
from doo_ti.system.errors import InputError
from doo_ti.system.terminal import progress

OWN_SCALE = ", each on a colour scale of its own"
MARKS = "minimum over all observations; in the panel of all, those of each end distance"
COLUMNS = 4  # panels of one run side by side


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
        """The names of the runs."""
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
    return Study(landscapes, experiments, panels, by_distance, cells_to_record(landscapes, most_cells), observation)


def _by_end_distance(together: LandscapePanel, landscape: Landscape) -> list[LandscapePanel]:
    """A panel for each end distance, then one of all; each marks the minimum of all, and the last one those of the others.
    Raises InputError where end distances are unknown."""
    if np.isnan(landscape.end_distance).any():
        raise InputError(landscape.run, "end_distance_mm", "unknown",
                         "do not partition by end distance, or give the observations the label")
    distances = np.unique(landscape.end_distance)
    parts = [plane_of(_terms(landscape, landscape.end_distance == distance)) for distance in distances]
    row = [LandscapePanel(f"{together.title}, {distance:g} mm", part, (("", together.plane.minimum),))
           for distance, part in zip(distances, parts, strict=True)]
    marks = tuple((f"{distance:g}", part.minimum) for distance, part in zip(distances, parts, strict=True))
    return [*row, LandscapePanel(f"{together.title}, all", together.plane, marks)]


def _terms(landscape: Landscape, which: np.ndarray) -> Landscape:
    """The landscape of some of its terms."""
    values = {field.name: getattr(landscape, field.name) for field in fields(landscape)}
    return replace(landscape, **{name: value[..., which] for name, value in values.items() if isinstance(value, np.ndarray)})


def _in_rows(panels: list[LandscapePanel]) -> list[list[LandscapePanel]]:
    return [panels[first:first + COLUMNS] for first in range(0, len(panels), COLUMNS)]


def draw_landscapes(study: Study, out: Path) -> list[dict]:
    """Write landscapes.png and, with end distances, end_distances.png into the folder ``out``; returns path, bytes and
    seconds of each file."""
    out.mkdir(parents=True, exist_ok=True)
    began, path = time.monotonic(), out / "landscapes.png"
    landscapes_picture(path, [study.panels], title=f"{study.title}{OWN_SCALE * (len(study.landscapes) > 1)}")
    files = [_file(path, began)]
    if study.by_distance:
        began, path = time.monotonic(), out / "end_distances.png"
        rows = study.by_distance if len(study.by_distance) > 1 else _in_rows(study.by_distance[0])
        landscapes_picture(path, rows, title=f"{study.title} by end distance", marks=MARKS, relative=True)
        files.append(_file(path, began))
    return files


def record_cells(study: Study, out: Path) -> list[dict]:
    """Write cells.rrd, with a progress bar of the rods relaxed; returns as :func:`draw_landscapes`."""
    began, path = time.monotonic(), out / "cells.rrd"
    rods = sum(experiment.terms for experiment in study.experiments) * study.cells.grid.size
    rows = [_in_rows(panels) for panels in study.by_distance or [[panel] for panel in study.panels]]
    with progress(keep=True) as bar:
        task = bar.add_task("recording", total=rods, unit="rods")
        record_figure(path, study, rows, MARKS, advance=lambda done: bar.update(task, advance=done))
    return [_file(path, began)]


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


def _file(path: Path, began: float) -> dict:
    return {"path": str(path), "bytes": path.stat().st_size, "seconds": time.monotonic() - began}
