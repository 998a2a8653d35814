"""The recording of a figure: the rods of every cell against their observations, beside the landscapes (Fig. 3, 4, 5).

Axes: C recorded cells, D observations, N rods of a cell, V vertices, P panels of a run's picture.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import rerun
import rerun.blueprint as blueprint

from doo_ti import report
from doo_ti.record.stream import (
    FAILED,
    drawn_strips,
    entity_name,
    front_view,
    log_observations,
    panels,
    recording,
    vectors,
)
from doo_ti.report.grid_view import GridView, Observed, grid_view

BESIDE = 3
"""Most runs side by side; more of them are tabs."""


@dataclass(frozen=True)
class CellsOfRun:
    """What a recording shows of one run.

    name         the first part of its entities' paths
    observed     the D observations
    observation  (N,) the observation that each rod is compared with
    distance     mm, of any shape: its range is that of the rods' colours
    picture      (H, W, 3) uint8, the run's landscapes
    boxes        (C, P, 4) left, top, width and height in pixels of the recorded cells in the picture's panels
    """

    name: str
    observed: Observed
    observation: np.ndarray
    distance: np.ndarray
    picture: np.ndarray
    boxes: np.ndarray


@dataclass(frozen=True)
class Rods:
    """The rods of some recorded cells of one run.

    run       index of the run
    first     index of the first cell among the recorded ones
    vertices  (c, N, V, 3) mm
    distance  (c, N) Eq. 1, mm
    sound     (c, N) bool: certified minima
    """

    run: int
    first: int
    vertices: np.ndarray
    distance: np.ndarray
    sound: np.ndarray


def record_cells(path, *, run_id: str, name: str, runs: list[CellsOfRun], cells: np.ndarray, rank: np.ndarray,
                 texts: list[str], rods: Iterable[Rods]) -> None:
    """Write the recording ``path``, one step per cell.

    cells  (C,) the cells' numbers in the grid: the timeline ``cell``
    rank   (C,) their order on the timeline ``falling_error``: the best cell last, where the recording opens
    texts  (C,) Markdown that goes with each cell
    rods   of all runs and cells, in pieces, in any order
    """
    grids = [grid_view(run.observed) for run in runs]
    with recording(path, run_id, name, _layout(runs, grids)) as stream:
        for run, grid in zip(runs, grids, strict=True):
            _log_static(stream, run, grid)
            _log_marker(stream, run, _times(cells, rank))
        stream.send_columns("summary", _times(cells, rank), rerun.TextDocument.columns(
            text=texts, media_type=["text/markdown"] * len(texts)))
        for piece in rods:
            part = slice(piece.first, piece.first + len(piece.vertices))
            _log_rods(stream, runs[piece.run], grids[piece.run], piece, _times(cells[part], rank[part]))


def entity(run: CellsOfRun) -> str:
    """The name of a run's entities, below ``world`` and ``landscape``."""
    return entity_name(run.name)


def _times(cells: np.ndarray, rank: np.ndarray) -> list[rerun.TimeColumn]:
    return [rerun.TimeColumn("cell", sequence=cells), rerun.TimeColumn("falling_error", sequence=rank)]


def _log_static(stream, run: CellsOfRun, grid: GridView) -> None:
    """Everything that is the same in all cells: observations, landscapes, names and width of the rods."""
    world, names = f"world/{entity(run)}", run.observed.names
    log_observations(stream, world, grid, run.observed)
    stream.log(f"{world}/rods", rerun.LineStrips3D.from_fields(
        radii=rerun.Radius.ui_points(1.7), labels=[names[d] for d in run.observation], show_labels=False),
        rerun.AnyValues(offset_mm=vectors(grid.offset[run.observation])), static=True)
    stream.log(f"landscape/{entity(run)}", rerun.Image(run.picture).compress(), static=True)
    stream.log(f"landscape/{entity(run)}/cell", rerun.Boxes2D.from_fields(
        colors=[FAILED], radii=rerun.Radius.ui_points(1.5), draw_order=10.0), static=True)


def _log_marker(stream, run: CellsOfRun, times: list[rerun.TimeColumn]) -> None:
    """A box around the cell in each panel, a little larger than the cell, so that its colour stays visible."""
    steps, count, _ = run.boxes.shape
    half = 0.5 * run.boxes[..., 2:]
    stream.send_columns(f"landscape/{entity(run)}/cell", times, rerun.Boxes2D.columns(
        centers=(run.boxes[..., :2] + half).reshape(-1, 2).astype(np.float32),
        half_sizes=(1.25 * half).reshape(-1, 2).astype(np.float32)).partition([count] * steps))


def _log_rods(stream, run: CellsOfRun, grid: GridView, piece: Rods, times: list[rerun.TimeColumn]) -> None:
    """One entity for all rods of a run, one instance per rod, one row per cell."""
    steps, count, marks, _ = piece.vertices.shape
    strips = drawn_strips((piece.vertices + grid.offset[run.observation][:, None]).reshape(-1, marks, 3))
    colors = np.where(piece.sound[..., None], report.distance_colors(piece.distance, run.distance), FAILED)
    place, lengths = f"world/{entity(run)}/rods", [count] * steps
    stream.send_columns(place, times, [
        *rerun.LineStrips3D.columns(strips=strips, colors=colors.reshape(-1, 3).astype(np.uint8)).partition(lengths),
        *rerun.AnyValues.columns(distance_mm=piece.distance.reshape(-1).astype(np.float32)).partition(lengths)])


def _layout(runs: list[CellsOfRun], grids: list[GridView]) -> blueprint.Blueprint:
    """Each run's rods and landscapes, and the cell's Θ and errors as text; it opens on the best cell."""
    text = blueprint.TextDocumentView(name="Cell", origin="summary")
    views = []
    for run, grid in zip(runs, grids, strict=True):
        rods = front_view(grid, f"world/{entity(run)}", f"{run.name}: rods on observed marks (white)", aspect=1.1)
        views.append((rods, blueprint.Spatial2DView(name=f"{run.name}: landscape", origin=f"landscape/{entity(run)}")))
    if len(runs) == 1:
        (rods, landscape), = views
        body = blueprint.Horizontal(rods, blueprint.Vertical(landscape, text, row_shares=[3, 1.5]), column_shares=[1.1, 1])
    else:
        together = blueprint.Horizontal if len(runs) <= BESIDE else blueprint.Tabs
        body = blueprint.Vertical(together(*(blueprint.Vertical(*pair, row_shares=[3, 2.4]) for pair in views)), text,
                                  row_shares=[4, 1])
    return blueprint.Blueprint(body, *panels("falling_error"))
