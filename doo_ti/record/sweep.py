"""Recordings of sweeps: of one, the rods over solver iterations, landscape as picture and surface, curves, summary; of several,
the rods of every cell against their observations, beside the landscapes (Fig. 3, 4, 5).

Axes: T iterations, D observations (one rod each), V vertices; C recorded cells, N rods of a cell, P panels of a run's picture.
"""

import os
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import count
from typing import Annotated

import numpy as np
import rerun
import rerun.blueprint as blueprint

from doo_ti.record import viewer
from doo_ti.report import canvas
from doo_ti.report.canvas import GridView, Observed, grid_view
from doo_ti.report.landscapes import draw_landscape
from doo_ti.report.plane import LandscapePlane
from doo_ti.rod.grid import UNITS, Interval
from doo_ti.rod.types import Status
from doo_ti.system.arguments import short_repr, typed

BLOCK = 10  # iterations sent at once
MINIMUM = (255, 255, 255)
MOST_POINTS = 20_000
ENDINGS = {status: status.name.lower().replace("_", " ") for status in Status}


@typed
@dataclass(frozen=True)
class SweepTrajectory:
    """The relaxation of D rods.

    vertices          (T, D, V, 3) mm; a rod with a NaN in it is not drawn
    energy, residual  (T, D): relative to weight, mm²; without a unit. Where NaN the rod's last value is used
    status, distance  (D,) at the end: Status; Eq. 1, mm
    """

    __repr__ = short_repr

    vertices: Annotated[np.ndarray, "T D V 3"]
    energy: Annotated[np.ndarray, "T D"]
    residual: Annotated[np.ndarray, "T D"]
    status: Annotated[np.ndarray, "D"]
    distance: Annotated[np.ndarray, "D"]


@typed
def record_sweep(path: str | os.PathLike[str], *, run_id: str, name: str, observed: Observed, trajectory: SweepTrajectory,
                 properties: dict[str, object], plane: LandscapePlane | None = None, intervals: tuple[Interval, ...] = (),
                 region: np.ndarray | None = None) -> None:
    """Write the recording ``path``.

    observed    the D observations
    trajectory  of the rods of the best cell
    properties  {name: number or text}: in the summary and as properties of the recording
    plane       the landscape; None for a single relaxation
    intervals   of the parameters, as `grid.valley` finds them, for the summary
    region      as :func:`doo_ti.report.landscapes.landscape_picture` takes it
    """
    properties = {key: value if isinstance(value, (int, float, str)) else str(value) for key, value in properties.items()}
    grid = grid_view(observed)
    with viewer.recording(path, run_id, name, _layout(grid, plane)) as stream:
        if properties:
            stream.send_property("run", rerun.AnyValues(**properties))
        viewer.log_observations(stream, "world", grid, observed)
        _log_rods(stream, grid, trajectory, observed.names, with_trials=plane is not None)
        _log_curves(stream, trajectory)
        if plane is not None:
            picture = canvas.pixels(draw_landscape(plane, name, region))
            stream.log("landscape/picture", rerun.Image(picture), static=True)
            log_surface(stream, plane)
            log_cells(stream, plane)
        text = _summary(name, intervals, observed.names, trajectory, properties)
        stream.log("summary", rerun.TextDocument(text, media_type="text/markdown"), static=True)


def _log_rods(stream, grid: GridView, trajectory: SweepTrajectory, names: list[str], with_trials: bool) -> None:
    """One entity for all rods, one instance per rod: an entity per rod makes files large and the viewer slow."""
    status, distance = trajectory.status, trajectory.distance
    colors = np.where((status == Status.CONVERGED)[:, None], canvas.distance_colors(distance), viewer.FAILED)
    labels = [f"{name}: {canvas.quantity(d, 'mm')}, {ENDINGS[s]}" for name, d, s in zip(names, distance, status, strict=True)]
    stream.log("world/rods", rerun.LineStrips3D.from_fields(
        colors=colors.astype(np.uint8), radii=viewer.points(1.7), labels=labels, show_labels=False),
        rerun.AnyValues(offset_mm=viewer.vectors(grid.offset)), static=True)
    for start in range(0, len(trajectory.vertices), BLOCK):
        rods = trajectory.vertices[start:start + BLOCK] + grid.offset[:, None]
        times = [rerun.TimeColumn("iteration", sequence=np.arange(start, start + len(rods)))]
        viewer.send_rods(stream, "world/rods", times, rods)
    if with_trials:  # so that the relaxed rods are also shown on the timeline of the cells
        viewer.send_rods(stream, "world/rods", [rerun.TimeColumn("trial", sequence=[0])], rods[-1:])


def _log_curves(stream, trajectory: SweepTrajectory) -> None:
    """Statistics over the rods: among curves of single rods an outlier would not be seen."""
    energy, residual = _held(trajectory.energy), _held(trajectory.residual)
    with np.errstate(divide="ignore", invalid="ignore"):
        residual = np.where(residual > 0, np.log10(residual), np.nan)
    curves = {
        "energy/mean": ("mean [mm²]", np.nanmean, energy, (45, 212, 191)),
        "energy/median": ("median [mm²]", np.nanmedian, energy, (125, 170, 255)),
        "residual/median": ("median [log10]", np.nanmedian, residual, (125, 170, 255)),
        "residual/largest": ("largest [log10]", np.nanmax, residual, viewer.FAILED),
    }
    for entity, (name, statistic, values, color) in curves.items():
        some = np.isfinite(values).any(axis=1)
        if some.any():
            stream.log(f"curves/{entity}", rerun.SeriesLines(names=name, colors=color, widths=2), static=True)
            stream.send_columns(f"curves/{entity}", [rerun.TimeColumn("iteration", sequence=np.flatnonzero(some))],
                                rerun.Scalars.columns(scalars=statistic(values[some], axis=1)))


def _held(values: np.ndarray) -> np.ndarray:
    """(T, D) with each NaN replaced by the rod's last finite value before it."""
    last = np.where(np.isfinite(values), np.arange(len(values))[:, None], 0)
    return np.take_along_axis(values, np.maximum.accumulate(last, axis=0), axis=0)


def log_surface(stream, plane: LandscapePlane) -> None:
    """The landscape as a surface over the unit square (on log axes, of the logarithms), height in proportion to mm."""
    plane, _ = plane.blocks()
    points, triangles = plane.surface()
    inside = np.isfinite(plane.values)
    if len(triangles):
        stream.log("landscape/surface", rerun.Mesh3D(
            vertex_positions=points[inside], triangle_indices=triangles,
            vertex_colors=canvas.landscape_colors(plane.values, plane.values)[inside]), static=True)
    _log_surface_axes(stream, plane)
    if plane.minimum is not None:
        stream.log("landscape/surface/minimum", rerun.Points3D(
            [points[plane.minimum]], labels=[canvas.quantity(plane.values[plane.minimum], "mm")], show_labels=True,
            colors=MINIMUM, radii=viewer.points(6)), static=True)


def _log_surface_axes(stream, plane: LandscapePlane) -> None:
    """A frame around the surface's base, labelled with the ends of the axes and the height."""
    strips = [np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 0), (0, 0, plane.HEIGHT)])]
    texts, places = [], []
    ends = (((0.08, -0.1, 0), (0.5, -0.16, 0), (0.9, -0.1, 0)), ((1.1, 0.1, 0), (1.2, 0.5, 0), (1.1, 0.92, 0)))
    for axis, three_places in zip(plane.axes, ends, strict=False):
        texts += [canvas.quantity(axis[1][0]), canvas.axis_label(axis), canvas.quantity(axis[1][-1])]
        places += three_places
    if np.isfinite(plane.values).any():
        texts += ["0 mm", "mean distance " + canvas.quantity(np.nanmax(plane.values), "mm")]
        places += [(-0.08, -0.04, 0), (0, 0, plane.HEIGHT + 0.05)]
    stream.log("landscape/surface/axes", rerun.LineStrips3D(strips, colors=viewer.TEXT, radii=viewer.points(0.7)), static=True)
    stream.log("landscape/surface/axes/labels", rerun.Points3D(
        places, labels=texts, show_labels=True, colors=viewer.TEXT, radii=viewer.points(0)), static=True)


def log_cells(stream, plane: LandscapePlane) -> None:
    """One point per cell that has a value, on the timeline ``trial`` at its number in the grid. Of a grid of more than
    ``MOST_POINTS`` cells every second, third, … along each axis, and the best."""
    shape, values = plane.grid.shape, plane.grid.reshape(-1)
    shown = np.isfinite(values)
    if not shown.any():
        return
    if values.size > MOST_POINTS:
        step = next(step for step in count(2) if np.prod([-(-size // step) for size in shape]) <= MOST_POINTS)
        shown &= np.all([place % step == 0 for place in np.unravel_index(np.arange(values.size), shape)], axis=0)
        shown[np.nanargmin(values)] = True
    trial = np.flatnonzero(shown)
    x, y = plane.unit_axes
    first, second = plane.places(np.unravel_index(trial, shape))
    points = np.stack([x[first], y[second], plane.height(values[trial])], axis=-1)
    stream.log("landscape/cells", rerun.Points3D.from_fields(radii=viewer.points(2.5)), static=True)
    stream.send_columns("landscape/cells", [rerun.TimeColumn("trial", sequence=trial)], rerun.Points3D.columns(
        positions=points.astype(np.float32), colors=canvas.landscape_colors(values[trial], plane.values),
        labels=[canvas.quantity(value, "mm") for value in values[trial]], show_labels=np.zeros(len(trial), bool)))


def _layout(grid: GridView, plane: LandscapePlane | None) -> blueprint.Blueprint:
    """Rods and summary on the left, landscape and curves on the right; it opens on the last iteration."""
    rods = viewer.front_view(grid, "world", f"Rods on observed marks (white), mm; {grid.meaning}".removesuffix("; "))
    plots = [blueprint.TimeSeriesView(name=name, origin=f"curves/{entity}", plot_legend=blueprint.Corner2D.RightTop)
             for entity, name in (("energy", "Energy [mm²]"), ("residual", "log10 residual"))]
    summary = blueprint.TextDocumentView(name="Summary", origin="summary")
    left, right = blueprint.Vertical(rods, summary, row_shares=[3, 1.25]), blueprint.Vertical(*plots)
    if plane is not None:
        picture = blueprint.Spatial2DView(name="Landscape", origin="landscape/picture")
        surface = viewer.space_view(  # with the cells up to the time cursor
            "Surface (timeline: trial)", "landscape", ((1.25, -0.95, 0.95), (0.55, 0.42, 0.15), (0, 0, 1)),
            contents=["$origin/surface/**", "$origin/cells"],
            time_ranges=blueprint.VisibleTimeRange("trial", start=blueprint.TimeRangeBoundary.infinite(),
                                                   end=blueprint.TimeRangeBoundary.cursor_relative()))
        right = blueprint.Vertical(blueprint.Tabs(picture, surface), blueprint.Horizontal(*plots), row_shares=[3, 2])
    return blueprint.Blueprint(blueprint.Horizontal(left, right, column_shares=[1.25, 1]), *viewer.panels("iteration"))


def _summary(name: str, intervals: tuple[Interval, ...], names: list[str], trajectory: SweepTrajectory,
             properties: dict) -> str:
    """Best Θ with its interval, the statuses of the rods, and the properties, in Markdown."""
    status, distance = trajectory.status, trajectory.distance
    lines, finite = [f"**{name}**"], np.isfinite(distance)
    if finite.any():
        worst = int(np.nanargmax(distance))
        mean, median, largest = (canvas.quantity(value, "mm") for value in (
            np.mean(distance[finite]), np.median(distance[finite]), distance[worst]))
        lines[0] += (f": mean distance (Eq. 1) **{mean}** over {finite.sum()} of {len(distance)} rods, median "
                     f"{median}, largest {largest} ({names[worst]})")
    if intervals:
        lines += ["", "| Θ | best | within 5 % of the minimum |", "|---|---|---|"]
        lines += [f"| {canvas.SYMBOLS[i.name]} | **{canvas.quantity(i.best, UNITS[i.name])}** "
                  f"| {'≤ ' * i.low_is_open}{canvas.quantity(i.low)} … "
                  f"{'≥ ' * i.high_is_open}{canvas.quantity(i.high, UNITS[i.name])} |" for i in intervals]
    counts = [f"{np.sum(status == kind)} {ENDINGS[kind]}" for kind in Status if (status == kind).any()]
    lines += ["", f"Rods: {', '.join(counts)}. Coloured by distance, teal the smallest, yellow the largest; red: not "
              "converged.", ""]
    if properties:
        lines += ["| property | |", "|---|---|", *("| {} | {} |".format(key, str(value).replace("|", "\\|"))
                                                      for key, value in properties.items())]
    return "\n".join(lines)


# --- cells of several runs -----------------------------------------------------------------------------------------------


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

    @property
    def entity(self) -> str:
        """The name of its entities, below ``world`` and ``landscape``."""
        return viewer.entity_name(self.name)


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
    with viewer.recording(path, run_id, name, _cells_layout(runs, grids)) as stream:
        for run, grid in zip(runs, grids, strict=True):
            _log_run(stream, run, grid, _times(cells, rank))
        stream.send_columns("summary", _times(cells, rank), rerun.TextDocument.columns(
            text=texts, media_type=["text/markdown"] * len(texts)))
        for piece in rods:
            part = slice(piece.first, piece.first + len(piece.vertices))
            _log_cell_rods(stream, runs[piece.run], grids[piece.run], piece, _times(cells[part], rank[part]))


def _times(cells: np.ndarray, rank: np.ndarray) -> list[rerun.TimeColumn]:
    return [rerun.TimeColumn("cell", sequence=cells), rerun.TimeColumn("falling_error", sequence=rank)]


def _log_run(stream, run: CellsOfRun, grid: GridView, times: list[rerun.TimeColumn]) -> None:
    """Everything but the rods: what is the same in all cells, and a box around the cell in each panel, a little larger than the
    cell, so that its colour stays visible."""
    world, names = f"world/{run.entity}", run.observed.names
    viewer.log_observations(stream, world, grid, run.observed)
    stream.log(f"{world}/rods", rerun.LineStrips3D.from_fields(
        radii=viewer.points(1.7), labels=[names[d] for d in run.observation], show_labels=False),
        rerun.AnyValues(offset_mm=viewer.vectors(grid.offset[run.observation])), static=True)
    stream.log(f"landscape/{run.entity}", rerun.Image(run.picture).compress(), static=True)
    stream.log(f"landscape/{run.entity}/cell", rerun.Boxes2D.from_fields(
        colors=[viewer.FAILED], radii=viewer.points(1.5), draw_order=10.0), static=True)
    steps, count, _ = run.boxes.shape
    half = 0.5 * run.boxes[..., 2:]
    stream.send_columns(f"landscape/{run.entity}/cell", times, rerun.Boxes2D.columns(
        centers=(run.boxes[..., :2] + half).reshape(-1, 2).astype(np.float32),
        half_sizes=(1.25 * half).reshape(-1, 2).astype(np.float32)).partition([count] * steps))


def _log_cell_rods(stream, run: CellsOfRun, grid: GridView, piece: Rods, times: list[rerun.TimeColumn]) -> None:
    """One entity for all rods of a run, one instance per rod, one row per cell."""
    steps, count, marks, _ = piece.vertices.shape
    strips = viewer.drawn_strips((piece.vertices + grid.offset[run.observation][:, None]).reshape(-1, marks, 3))
    colors = np.where(piece.sound[..., None], canvas.distance_colors(piece.distance, run.distance), viewer.FAILED)
    place, lengths = f"world/{run.entity}/rods", [count] * steps
    stream.send_columns(place, times, [
        *rerun.LineStrips3D.columns(strips=strips, colors=colors.reshape(-1, 3).astype(np.uint8)).partition(lengths),
        *rerun.AnyValues.columns(distance_mm=piece.distance.reshape(-1).astype(np.float32)).partition(lengths)])


def _cells_layout(runs: list[CellsOfRun], grids: list[GridView]) -> blueprint.Blueprint:
    """Each run's rods and landscapes, and the cell's Θ and errors as text; it opens on the best cell."""
    text = blueprint.TextDocumentView(name="Cell", origin="summary")
    views = []
    for run, grid in zip(runs, grids, strict=True):
        rods = viewer.front_view(grid, f"world/{run.entity}", f"{run.name}: rods on observed marks (white)", aspect=1.1)
        views.append((rods, blueprint.Spatial2DView(name=f"{run.name}: landscape", origin=f"landscape/{run.entity}")))
    if len(runs) == 1:
        (rods, landscape), = views
        body = blueprint.Horizontal(rods, blueprint.Vertical(landscape, text, row_shares=[3, 1.5]), column_shares=[1.1, 1])
    else:
        together = blueprint.Horizontal if len(runs) <= 3 else blueprint.Tabs
        body = blueprint.Vertical(together(*(blueprint.Vertical(*pair, row_shares=[3, 2.4]) for pair in views)), text,
                                  row_shares=[4, 1])
    return blueprint.Blueprint(body, *viewer.panels("falling_error"))
