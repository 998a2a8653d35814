"""The recording of a sweep: rods over solver iterations, landscape as picture and surface, curves, summary.

Axes: T iterations, D observations (one rod each), V vertices.
"""

import os
from dataclasses import dataclass
from itertools import count
from typing import Annotated

import numpy as np
import rerun
import rerun.blueprint as blueprint

from doo_ti import report
from doo_ti.record.stream import (
    FAILED,
    TEXT,
    drawn_strips,
    front_view,
    log_observations,
    panels,
    recording,
    space_view,
    vectors,
)
from doo_ti.report.grid_view import GridView, Observed, grid_view
from doo_ti.report.plane import LandscapePlane
from doo_ti.rod.grid import UNITS, Interval
from doo_ti.rod.types import Status
from doo_ti.system.arguments import typed
from doo_ti.system.short_repr import short_repr

BLOCK = 10
"""Iterations sent at once."""
MINIMUM = (255, 255, 255)
MOST_POINTS = 20_000


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
    region      as `report.landscape_picture` takes it
    """
    properties = {key: value if isinstance(value, (int, float, str)) else str(value) for key, value in properties.items()}
    grid = grid_view(observed)
    with recording(path, run_id, name, _layout(grid, plane)) as stream:
        if properties:
            stream.send_property("run", rerun.AnyValues(**properties))
        log_observations(stream, "world", grid, observed)
        _log_rods(stream, grid, trajectory, observed.names, with_trials=plane is not None)
        _log_curves(stream, trajectory)
        if plane is not None:
            stream.log("landscape/picture", rerun.Image(report.landscape_image(plane, title=name, region=region)), static=True)
            log_surface(stream, plane)
            log_cells(stream, plane)
        text = _summary(name, intervals, observed.names, trajectory, properties)
        stream.log("summary", rerun.TextDocument(text, media_type="text/markdown"), static=True)


def _log_rods(stream, grid: GridView, trajectory: SweepTrajectory, names: list[str], with_trials: bool) -> None:
    """One entity for all rods, one instance per rod: an entity per rod makes files large and the viewer slow."""
    status, distance = trajectory.status, trajectory.distance
    colors = np.where((status == Status.CONVERGED)[:, None], report.distance_colors(distance), FAILED)
    labels = [f"{name}: {report.quantity(d, 'mm')}, {_ending(s)}"
              for name, d, s in zip(names, distance, status, strict=True)]
    stream.log("world/rods", rerun.LineStrips3D.from_fields(
        colors=colors.astype(np.uint8), radii=rerun.Radius.ui_points(1.7), labels=labels, show_labels=False),
        rerun.AnyValues(offset_mm=vectors(grid.offset)), static=True)
    for start in range(0, len(trajectory.vertices), BLOCK):
        rods = trajectory.vertices[start:start + BLOCK] + grid.offset[:, None]
        steps, rods_of_step, marks, _ = rods.shape
        strips = drawn_strips(rods.reshape(-1, marks, 3))
        stream.send_columns("world/rods", [rerun.TimeColumn("iteration", sequence=np.arange(start, start + steps))],
                            rerun.LineStrips3D.columns(strips=strips).partition([rods_of_step] * steps))
    if with_trials:  # so that the relaxed rods are also shown on the timeline of the cells
        stream.send_columns("world/rods", [rerun.TimeColumn("trial", sequence=[0])],
                            rerun.LineStrips3D.columns(strips=strips[-rods_of_step:]).partition([rods_of_step]))


def _log_curves(stream, trajectory: SweepTrajectory) -> None:
    """Statistics over the rods: among curves of single rods an outlier would not be seen."""
    energy, residual = _held(trajectory.energy), _held(trajectory.residual)
    with np.errstate(divide="ignore", invalid="ignore"):
        residual = np.where(residual > 0, np.log10(residual), np.nan)
    curves = {
        "energy/mean": ("mean [mm²]", np.nanmean, energy, (45, 212, 191)),
        "energy/median": ("median [mm²]", np.nanmedian, energy, (125, 170, 255)),
        "residual/median": ("median [log10]", np.nanmedian, residual, (125, 170, 255)),
        "residual/largest": ("largest [log10]", np.nanmax, residual, FAILED),
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
            vertex_colors=report.landscape_colors(plane.values, plane.values)[inside]), static=True)
    _log_surface_axes(stream, plane)
    if plane.minimum is not None:
        stream.log("landscape/surface/minimum", rerun.Points3D(
            [points[plane.minimum]], labels=[report.quantity(plane.values[plane.minimum], "mm")], show_labels=True,
            colors=MINIMUM, radii=rerun.Radius.ui_points(6)), static=True)


def _log_surface_axes(stream, plane: LandscapePlane) -> None:
    """A frame around the surface's base, labelled with the ends of the axes and the height."""
    strips = [np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 0), (0, 0, plane.HEIGHT)])]
    texts, places = [], []
    ends = (((0.08, -0.1, 0), (0.5, -0.16, 0), (0.9, -0.1, 0)), ((1.1, 0.1, 0), (1.2, 0.5, 0), (1.1, 0.92, 0)))
    for axis, three_places in zip(plane.axes, ends, strict=False):
        texts += [report.quantity(axis[1][0]), report.axis_label(axis), report.quantity(axis[1][-1])]
        places += three_places
    if np.isfinite(plane.values).any():
        texts += ["0 mm", "mean distance " + report.quantity(np.nanmax(plane.values), "mm")]
        places += [(-0.08, -0.04, 0), (0, 0, plane.HEIGHT + 0.05)]
    stream.log("landscape/surface/axes", rerun.LineStrips3D(
        strips, colors=TEXT, radii=rerun.Radius.ui_points(0.7)), static=True)
    stream.log("landscape/surface/axes/labels", rerun.Points3D(
        places, labels=texts, show_labels=True, colors=TEXT, radii=rerun.Radius.ui_points(0)), static=True)


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
    stream.log("landscape/cells", rerun.Points3D.from_fields(radii=rerun.Radius.ui_points(2.5)), static=True)
    stream.send_columns("landscape/cells", [rerun.TimeColumn("trial", sequence=trial)], rerun.Points3D.columns(
        positions=points.astype(np.float32), colors=report.landscape_colors(values[trial], plane.values),
        labels=[report.quantity(value, "mm") for value in values[trial]], show_labels=np.zeros(len(trial), bool)))


def _layout(grid: GridView, plane: LandscapePlane | None) -> blueprint.Blueprint:
    """Rods and summary on the left, landscape and curves on the right; it opens on the last iteration."""
    rods = front_view(grid, "world", f"Rods on observed marks (white), mm; {grid.meaning}".removesuffix("; "))
    plots = [blueprint.TimeSeriesView(name=name, origin=f"curves/{entity}", plot_legend=blueprint.Corner2D.RightTop)
             for entity, name in (("energy", "Energy [mm²]"), ("residual", "log10 residual"))]
    summary = blueprint.TextDocumentView(name="Summary", origin="summary")
    left, right = blueprint.Vertical(rods, summary, row_shares=[3, 1.25]), blueprint.Vertical(*plots)
    if plane is not None:
        picture = blueprint.Spatial2DView(name="Landscape", origin="landscape/picture")
        right = blueprint.Vertical(blueprint.Tabs(picture, _surface_view()), blueprint.Horizontal(*plots), row_shares=[3, 2])
    return blueprint.Blueprint(blueprint.Horizontal(left, right, column_shares=[1.25, 1]), *panels("iteration"))


def _surface_view() -> blueprint.Spatial3DView:
    """The surface, with the cells up to the time cursor."""
    return space_view(
        "Surface (timeline: trial)", "landscape", ((1.25, -0.95, 0.95), (0.55, 0.42, 0.15), (0, 0, 1)),
        contents=["$origin/surface/**", "$origin/cells"],
        time_ranges=blueprint.VisibleTimeRange("trial", start=blueprint.TimeRangeBoundary.infinite(),
                                               end=blueprint.TimeRangeBoundary.cursor_relative()))


def _summary(name: str, intervals: tuple[Interval, ...], names: list[str], trajectory: SweepTrajectory,
             properties: dict) -> str:
    """Best Θ with its interval, the statuses of the rods, and the properties, in Markdown."""
    status, distance = trajectory.status, trajectory.distance
    lines, finite = [f"**{name}**"], np.isfinite(distance)
    if finite.any():
        worst = int(np.nanargmax(distance))
        mean, median, largest = (report.quantity(value, "mm") for value in (
            np.mean(distance[finite]), np.median(distance[finite]), distance[worst]))
        lines[0] += (f": mean distance (Eq. 1) **{mean}** over {finite.sum()} of {len(distance)} rods, median "
                     f"{median}, largest {largest} ({names[worst]})")
    if intervals:
        lines += ["", "| Θ | best | within 5 % of the minimum |", "|---|---|---|"]
        lines += [f"| {report.SYMBOLS[i.name]} | **{report.quantity(i.best, UNITS[i.name])}** "
                  f"| {'≤ ' * i.low_is_open}{report.quantity(i.low)} … "
                  f"{'≥ ' * i.high_is_open}{report.quantity(i.high, UNITS[i.name])} |" for i in intervals]
    counts = [f"{np.sum(status == kind)} {_ending(kind)}" for kind in Status if (status == kind).any()]
    lines += ["", f"Rods: {', '.join(counts)}. Coloured by distance, teal the smallest, yellow the largest; red: not "
              "converged.", ""]
    if properties:
        lines += ["| property | |", "|---|---|", *("| {} | {} |".format(key, str(value).replace("|", "\\|"))
                                                      for key, value in properties.items())]
    return "\n".join(lines)


def _ending(status: int) -> str:
    return Status(status).name.lower().replace("_", " ")
