"""What to draw of finished sweeps, checked before anything is written, and the drawing of it (Fig. 3, 4, 5)."""

import time
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from doo_ti.errors import InputError
from doo_ti.figures.panels import MARKS, in_rows, panels_by_end_distance, panels_of_runs, plane_of, run_name, title_of
from doo_ti.figures.recording import Cells, cells_to_record, record_figure
from doo_ti.figures.regimes import draw_regimes
from doo_ti.io.files import write_whole
from doo_ti.learning.experiment import Experiment
from doo_ti.learning.landscape import Landscape, read_landscape
from doo_ti.learning.partition import check_comparable
from doo_ti.learning.run_folder import read_experiment
from doo_ti.report import MEAN_DISTANCE, LandscapePanel, landscapes_picture
from doo_ti.terminal import progress

OWN_SCALE = ", each on a colour scale of its own"


@dataclass(frozen=True)
class Study:
    """Finished sweeps over one grid, and what to draw of them.

    panels       one row, a panel per run
    by_distance  a row per run: each end distance, then all together; None where not asked for
    cells        those that are recorded
    observation  whose ribbon stands for each regime; None: the one where they differ most
    """

    landscapes: list[Landscape]
    experiments: list[Experiment]
    panels: list[list[LandscapePanel]]
    by_distance: list[list[LandscapePanel]] | None
    cells: Cells
    observation: int | None

    @property
    def title(self) -> str:
        return title_of(self.landscapes)

    @property
    def recorded_values(self) -> dict[str, tuple[int, int]]:
        """How many values of each varying axis are recorded, and of how many."""
        axes = zip(self.cells.grid.axes, self.landscapes[0].grid.axes, strict=True)
        return {axis.name: (len(part), len(axis)) for part, axis in axes if len(axis) > 1}


def read(runs: list[Path], *, by_end_distance: bool, observation: int | None, most_cells: int | None) -> Study:
    """Read finished sweeps. Raises InputError where they are none, differ in their grid, repeat a material and objective,
    lack the end distances asked for, or hold no such observation."""
    landscapes = [read_landscape(run) for run in runs]
    check_comparable(landscapes)
    experiments = [read_experiment(run) for run in runs]
    for landscape, experiment in zip(landscapes, experiments, strict=True):
        if len(landscape.observation) != experiment.terms:
            raise InputError(landscape.run, "observations", f"{experiment.terms} terms, but the cells hold "
                             f"{len(landscape.observation)}", "run the sweep again")
        if observation is not None and observation not in landscape.observation:
            raise InputError("study", "observation", f"{observation} is not compared with in {landscape.run}",
                             f"give one of {landscape.observation.min()} to {landscape.observation.max()}")
    return Study(landscapes, experiments, panels_of_runs(landscapes),
                 panels_by_end_distance(landscapes) if by_end_distance else None,
                 cells_to_record(landscapes, most_cells), observation)


def draw_landscapes(study: Study, out: Path) -> list[dict]:
    """Write landscapes.png and, with end distances, end_distances.png into the folder ``out``; returns path, bytes and
    seconds of each file."""
    out.mkdir(parents=True, exist_ok=True)
    files: list[dict] = []
    with _told(files, out / "landscapes.png") as path:
        write_whole(path, lambda file: landscapes_picture(
            file, study.panels, title=f"{study.title}{OWN_SCALE * (len(study.landscapes) > 1)}", label=MEAN_DISTANCE))
    if study.by_distance:
        rows = study.by_distance if len(study.by_distance) > 1 else in_rows(study.by_distance[0])
        with _told(files, out / "end_distances.png") as path:
            write_whole(path, lambda file: landscapes_picture(
                file, rows, title=f"{study.title} by end distance", label=MEAN_DISTANCE, marks=MARKS, relative=True))
    return files


def record_cells(study: Study, out: Path) -> list[dict]:
    """Write cells.rrd, with a bar of the rods relaxed."""
    files: list[dict] = []
    rods = sum(experiment.terms for experiment in study.experiments) * study.cells.grid.size
    rows = study.by_distance or [[panel] for panel in study.panels[0]]
    with _told(files, out / "cells.rrd") as path, progress(keep=True) as bar:
        task = bar.add_task("recording", total=rods, unit="rods")
        record_figure(path, study.experiments, study.landscapes, rows, study.cells, title=study.title,
                      advance=lambda done: bar.update(task, advance=done))
    return files


def draw_ribbons(study: Study, out: Path) -> list[dict]:
    """Write regimes_NAME.png and .rrd for each run over both bends of a ribbon."""
    files: list[dict] = []
    for landscape, experiment in zip(study.landscapes, study.experiments, strict=True):
        if plane_of(landscape).twist is None:
            continue
        name = run_name(landscape, study.landscapes)
        stem = out / f"regimes_{'_'.join(''.join(c if c.isalnum() else ' ' for c in name).split())}"
        began = time.monotonic()
        files += [_file(path, began) for path in draw_regimes(stem, name, experiment, landscape, study.observation)]
    return files


@contextmanager
def _told(files: list[dict], path: Path):
    """Adds a file with its size and time to ``files`` once it is written."""
    began = time.monotonic()
    yield path
    files.append(_file(path, began))


def _file(path: Path, began: float) -> dict:
    return {"path": str(path), "bytes": path.stat().st_size, "seconds": time.monotonic() - began}
