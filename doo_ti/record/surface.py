"""The landscape as a surface over its grid, and the cells as they come in."""

from itertools import count

import numpy as np
import rerun
import rerun.blueprint as blueprint

from doo_ti import report
from doo_ti.record.wall import GROUND, TEXT
from doo_ti.report.plane import Plane

MINIMUM = (255, 255, 255)
MOST_POINTS = 20_000


def log_surface(stream, plane: Plane) -> None:
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


def _log_surface_axes(stream, plane: Plane) -> None:
    """A frame around the surface's base, with the ends of the axes and the height written to it."""
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


def log_cells(stream, plane: Plane, landscape: np.ndarray, order) -> None:
    """One point per evaluated cell, on the trial that evaluated it; cells without a value have none. Of a grid of more than
    ``MOST_POINTS`` cells every second, third, … along each axis, and the best."""
    order = np.arange(landscape.size) if order is None else np.asarray(order).reshape(-1)
    values = landscape.reshape(-1)[order]
    shown = np.isfinite(values)
    if not shown.any():
        return
    if landscape.size > MOST_POINTS:
        step = next(step for step in count(2) if np.prod([-(-size // step) for size in landscape.shape]) <= MOST_POINTS)
        shown &= np.all([place % step == 0 for place in np.unravel_index(order, landscape.shape)], axis=0)
        shown[np.nanargmin(values)] = True
    trial = np.flatnonzero(shown)
    x, y = plane.unit_axes
    first, second = plane.places(np.unravel_index(order[trial], landscape.shape))
    points = np.stack([x[first], y[second], plane.height(values[trial])], axis=-1)
    stream.log("landscape/cells", rerun.Points3D.from_fields(radii=rerun.Radius.ui_points(2.5)), static=True)
    stream.send_columns("landscape/cells", [rerun.TimeColumn("trial", sequence=trial)], rerun.Points3D.columns(
        positions=points.astype(np.float32), colors=report.landscape_colors(values[trial], plane.values),
        labels=[report.quantity(value, "mm") for value in values[trial]], show_labels=np.zeros(len(trial), bool)))


def surface_view() -> blueprint.Spatial3DView:
    """The surface, with the cells up to the time cursor."""
    return blueprint.Spatial3DView(
        name="Surface (timeline: trial)", origin="landscape", contents=["$origin/surface/**", "$origin/cells"],
        line_grid=False, background=GROUND,
        eye_controls=blueprint.EyeControls3D(
            kind=blueprint.Eye3DKind.Orbital, position=(1.25, -0.95, 0.95), look_target=(0.55, 0.42, 0.15),
            eye_up=(0, 0, 1)),
        time_ranges=blueprint.VisibleTimeRange("trial", start=blueprint.TimeRangeBoundary.infinite(),
                                               end=blueprint.TimeRangeBoundary.cursor_relative()))
