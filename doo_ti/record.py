"""The recording of a run for the rerun viewer: rods over solver iterations, landscape, curves, summary.

Only this module imports rerun; import it where it is used, not at a module's top: that takes half a second.
Entities, timelines and counts: docs/recording.md. Axes: T iterations, D observations (one rod each), V vertices.
"""

import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pyarrow
import rerun
import rerun.blueprint as blueprint
from rerun.experimental import ViewerClient

from doo_ti import report
from doo_ti.contact_sheet import Sheet, contact_sheet, observation_names
from doo_ti.errors import InputError
from doo_ti.grid import UNITS, Interval
from doo_ti.landscape import Plane
from doo_ti.types import Status

FILE = "run.rrd"
LABEL = "mean distance (Eq. 1) [mm]"
BLOCK = 10
"""Iterations sent at once."""
OBSERVED, FAILED, TEXT, MINIMUM = (235, 235, 235), (255, 46, 99), (175, 175, 175), (255, 255, 255)
GROUND = (16, 18, 22)


def record_sweep(path, *, run_id: str, name: str, observations_vertices, labels, trajectory, energy, residual, status,
                 distance, properties: dict, axes=(), landscape=None, minimum=None, valley=None, unfinished=None,
                 intervals: tuple[Interval, ...] = (), order=None, up=(0, 0, 1)) -> None:
    """Write the recording ``path``, its layout inside.

    observations_vertices  (D, V, 3) mm, NaN where a mark is missing
    labels                 {"end_distance_mm": (D,), "end_rotation_deg": (D,)}: the first makes the columns of the
                           contact sheet, the second its rows; None where unknown: reading order
    trajectory             (T, D, V, 3) mm, the rods of the best cell; a rod with a NaN in it is not drawn
    energy, residual       (T, D): relative to weight, mm²; scaled residual, 1/mm. Where NaN the rod's last one stands
    status, distance       (D,): Status; Eq. 1, mm
    properties             {name: number or text}: in the summary and as properties of the recording
    axes, landscape, minimum, valley, unfinished
                           as `report.landscape_picture` takes them; left out for a single relaxation
    intervals              of the parameters, as `grid.valley` finds them, for the summary
    order                  (N,) flat grid index of the cell each trial evaluated; default: grid order
    up                     direction against gravity
    """
    vertices, trajectory = np.asarray(observations_vertices, float), np.asarray(trajectory, float)
    status, distance = np.asarray(status), np.asarray(distance, float)
    properties = {key: value if isinstance(value, (int, float, str)) else str(value)
                  for key, value in properties.items()}
    labels = {label: values for label, values in (labels or {}).items() if values is not None}
    sheet, names = contact_sheet(vertices, labels, up), observation_names(labels, len(vertices))
    plane = None if landscape is None else Plane.of(axes, landscape, minimum, valley, unfinished)
    stream = rerun.RecordingStream("doo_ti", recording_id=run_id)
    stream.set_log_time_enabled(False)
    stream.set_log_tick_enabled(False)
    part = Path(path).with_name(Path(path).name + ".part")  # nobody meets a file that is still being written
    stream.save(part, default_blueprint=_layout(sheet, plane))
    stream.send_recording_name(name)
    if properties:
        stream.send_property("run", rerun.AnyValues(**properties))
    _log_observations(stream, sheet, vertices, names)
    _log_rods(stream, sheet, trajectory, names, status, distance, plane is not None)
    _log_curves(stream, np.asarray(energy, float), np.asarray(residual, float))
    if plane is not None:
        picture = report.landscape_image(axes, landscape, minimum=minimum, valley=valley, title=name, label=LABEL,
                                         unfinished=unfinished)
        stream.log("landscape/picture", rerun.Image(picture), static=True)
        _log_surface(stream, plane)
        _log_cells(stream, plane, np.asarray(landscape, float), axes, order)
    text = _summary(name, intervals, names, status, distance, properties)
    stream.log("summary", rerun.TextDocument(text, media_type="text/markdown"), static=True)
    stream.flush(timeout_sec=60)
    stream.disconnect()
    os.replace(part, path)


def open_viewer(path) -> int:
    """Open a run's recording (the run's folder or the .rrd file) in the rerun viewer; returns the viewer's exit code.

    Raises InputError where there is no recording.
    """
    return _viewer(path, "--port", "auto").wait()


def save_screenshot(path, picture, size=(1600, 900)) -> None:
    """Write what the viewer shows as a PNG, without a display (needs a Vulkan driver; mesa's in software will do).

    Raises InputError where there is no recording, RuntimeError where the viewer does not start.
    """
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    viewer = _viewer(path, "--headless", "--port", str(port), "--window-size", "{}x{}".format(*size), own_group=True)
    try:
        client = _connect(viewer, port)
        client.run_command("ui.toggle_top_panel")
        time.sleep(12)  # the viewer's notices fade and its plots fill
        client.save_screenshot(str(Path(picture).resolve()))
    finally:
        os.killpg(viewer.pid, signal.SIGTERM)  # the command and the viewer it started
        viewer.wait()


def _connect(viewer: subprocess.Popen, port: int) -> ViewerClient:
    """The viewer on ``port``, once it has the recording open."""
    client, deadline = None, time.monotonic() + 60
    while viewer.poll() is None and time.monotonic() < deadline:
        try:
            client = client or ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy")
            if client.get_state().active_recording:
                return client
        except ConnectionError:  # not listening yet
            pass
        time.sleep(0.5)
    raise RuntimeError("the rerun viewer did not start; is a Vulkan driver installed?")


def _viewer(path, *options: str, own_group: bool = False) -> subprocess.Popen:
    file = Path(path) / FILE if Path(path).is_dir() else Path(path)
    if not file.is_file():
        raise InputError(path, FILE, "there is no recording", "name a folder that doo-ti sweep has written")
    # Left alone the viewer listens on every network interface and reports its use; CI=true stops the reports.
    command = [sys.executable, "-m", "rerun_cli", "--bind", "127.0.0.1", *options, str(file)]
    return subprocess.Popen(command, env=os.environ | {"CI": "true"}, start_new_session=own_group)


def _log_observations(stream, sheet: Sheet, vertices: np.ndarray, names: list[str]) -> None:
    """Observed marks and the lines through them; a missing mark is left out."""
    present = np.isfinite(vertices).all(axis=-1)
    placed = (vertices + sheet.offset[:, None]).astype(np.float32)
    axis = int(np.argmax(np.abs(sheet.basis[2])))
    up = f"RIGHT_HAND_{'XYZ'[axis]}_{'UP' if sheet.basis[2][axis] > 0 else 'DOWN'}"
    stream.log("world", getattr(rerun.ViewCoordinates, up), static=True)
    strips = [rod[mask] for rod, mask in zip(placed, present, strict=True)]
    stream.log("world/observations", rerun.LineStrips3D(
        strips, colors=OBSERVED, radii=rerun.Radius.ui_points(0.5), labels=names, show_labels=False),
        rerun.AnyValues(offset_mm=_vectors(sheet.offset)), static=True)
    stream.log("world/observations/marks", rerun.Points3D(
        placed[present], colors=OBSERVED, radii=rerun.Radius.ui_points(1.0)), static=True)
    if sheet.headings:
        texts, places = zip(*sheet.headings, strict=True)
        stream.log("world/headings", rerun.Points3D(
            places, labels=texts, show_labels=True, colors=TEXT, radii=rerun.Radius.ui_points(0)), static=True)


def _log_rods(stream, sheet: Sheet, trajectory: np.ndarray, names: list[str], status, distance,
              with_trials: bool) -> None:
    """One entity for all rods, one instance per rod: a rod per entity makes files and viewer slow."""
    colors = np.where((status == Status.CONVERGED)[:, None], report.distance_colors(distance), FAILED)
    labels = [f"{name}: {report.quantity(d, 'mm')}, {_ending(s)}"
              for name, d, s in zip(names, distance, status, strict=True)]
    stream.log("world/rods", rerun.LineStrips3D.from_fields(
        colors=colors.astype(np.uint8), radii=rerun.Radius.ui_points(1.7), labels=labels, show_labels=False),
        rerun.AnyValues(offset_mm=_vectors(sheet.offset)), static=True)
    for start in range(0, len(trajectory), BLOCK):
        rods = (trajectory[start:start + BLOCK] + sheet.offset[:, None]).astype(np.float32)
        steps, count, marks, _ = rods.shape
        strips = rods.reshape(-1, marks, 3)
        if not np.isfinite(strips).all():  # an empty strip keeps the rod's instance index and draws nothing
            strips = [rod if np.isfinite(rod).all() else rod[:0] for rod in strips]
        stream.send_columns("world/rods", [rerun.TimeColumn("iteration", sequence=np.arange(start, start + steps))],
                            rerun.LineStrips3D.columns(strips=strips).partition([count] * steps))
    if with_trials:  # where the cells appear, the relaxed rods stay in sight
        stream.send_columns("world/rods", [rerun.TimeColumn("trial", sequence=[0])],
                            rerun.LineStrips3D.columns(strips=strips[-count:]).partition([count]))


def _log_curves(stream, energy: np.ndarray, residual: np.ndarray) -> None:
    """Statistics over the rods: curves of single rods would hide the one that matters among many."""
    energy, residual = _held(energy), _held(residual)
    with np.errstate(divide="ignore", invalid="ignore"):
        residual = np.where(residual > 0, np.log10(residual), np.nan)
    curves = {
        "energy/mean": ("mean [mm²]", np.nanmean, energy, (45, 212, 191)),
        "energy/median": ("median [mm²]", np.nanmedian, energy, (125, 170, 255)),
        "residual/median": ("median [log10 1/mm]", np.nanmedian, residual, (125, 170, 255)),
        "residual/largest": ("largest [log10 1/mm]", np.nanmax, residual, FAILED),
    }
    for entity, (name, statistic, values, color) in curves.items():
        some = np.isfinite(values).any(axis=1)
        if some.any():
            stream.log(f"curves/{entity}", rerun.SeriesLines(names=name, colors=color, widths=2), static=True)
            stream.send_columns(f"curves/{entity}", [rerun.TimeColumn("iteration", sequence=np.flatnonzero(some))],
                                rerun.Scalars.columns(scalars=statistic(values[some], axis=1)))


def _log_surface(stream, plane: Plane) -> None:
    """The landscape as a surface over the unit square (on log axes, of the logarithms), height in proportion to mm."""
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


def _log_cells(stream, plane: Plane, landscape: np.ndarray, axes, order) -> None:
    """One point per evaluated cell, on the trial that evaluated it; cells without a value have none."""
    order = np.arange(landscape.size) if order is None else np.asarray(order).reshape(-1)
    values = landscape.reshape(-1)[order]
    trial = np.flatnonzero(np.isfinite(values))
    if not trial.size:
        return
    index = dict(zip((axis[0] for axis in axes), np.unravel_index(order[trial], landscape.shape), strict=True))
    x, y = plane.unit_axes
    first, *rest = (index[axis[0]] for axis in plane.axes)
    points = np.stack([x[first], y[rest[0]] if rest else 0 * x[first], plane.height(values[trial])], axis=-1)
    stream.log("landscape/cells", rerun.Points3D.from_fields(radii=rerun.Radius.ui_points(2.5)), static=True)
    stream.send_columns("landscape/cells", [rerun.TimeColumn("trial", sequence=trial)], rerun.Points3D.columns(
        positions=points.astype(np.float32), colors=report.landscape_colors(values[trial], plane.values),
        labels=[report.quantity(value, "mm") for value in values[trial]], show_labels=np.zeros(len(trial), bool)))


def _layout(sheet: Sheet, plane: Plane | None) -> blueprint.Blueprint:
    """Rods and summary on the left, landscape and curves on the right; on the last iteration when opened."""
    width, height = sheet.extent
    away = 0.52 * max(height, width / 1.35) / np.tan(np.radians(27.5))
    rods = blueprint.Spatial3DView(
        name=f"Rods on observed marks (white), mm; {sheet.meaning}".removesuffix("; "), origin="world",
        line_grid=False, background=GROUND,
        eye_controls=blueprint.EyeControls3D(
            kind=blueprint.Eye3DKind.Orbital, look_target=sheet.centre, eye_up=sheet.basis[2],
            position=sheet.centre - away * sheet.basis[1]))
    plots = [blueprint.TimeSeriesView(name=name, origin=f"curves/{entity}", plot_legend=blueprint.Corner2D.RightTop)
             for entity, name in (("energy", "Energy [mm²]"), ("residual", "log10 scaled residual [1/mm]"))]
    summary = blueprint.TextDocumentView(name="Summary", origin="summary")
    left = blueprint.Vertical(rods, summary, row_shares=[3, 1.25])
    panels = (blueprint.BlueprintPanel(state="collapsed"), blueprint.SelectionPanel(state="collapsed"),
              blueprint.TimePanel(state="collapsed", timeline="iteration", play_state="following"))
    if plane is None:
        right = blueprint.Vertical(*plots)
        return blueprint.Blueprint(blueprint.Horizontal(left, right, column_shares=[1.25, 1]), *panels)
    surface = blueprint.Spatial3DView(
        name="Surface (timeline: trial)", origin="landscape", contents=["$origin/surface/**", "$origin/cells"],
        line_grid=False, background=GROUND,
        eye_controls=blueprint.EyeControls3D(
            kind=blueprint.Eye3DKind.Orbital, position=(1.25, -0.95, 0.95), look_target=(0.55, 0.42, 0.15),
            eye_up=(0, 0, 1)),
        time_ranges=blueprint.VisibleTimeRange("trial", start=blueprint.TimeRangeBoundary.infinite(),
                                               end=blueprint.TimeRangeBoundary.cursor_relative()))
    picture = blueprint.Spatial2DView(name="Landscape", origin="landscape/picture")
    right = blueprint.Vertical(blueprint.Tabs(picture, surface), blueprint.Horizontal(*plots), row_shares=[3, 2])
    return blueprint.Blueprint(blueprint.Horizontal(left, right, column_shares=[1.25, 1]), *panels)


def _summary(name: str, intervals: tuple[Interval, ...], names, status, distance, properties: dict) -> str:
    """Best Θ with its interval, how the rods ended, and the properties, in Markdown."""
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


def _held(values: np.ndarray) -> np.ndarray:
    """(T, D) with each NaN replaced by the rod's last finite value before it."""
    last = np.where(np.isfinite(values), np.arange(len(values))[:, None], 0)
    return np.take_along_axis(values, np.maximum.accumulate(last, axis=0), axis=0)


def _vectors(array: np.ndarray) -> pyarrow.Array:
    return pyarrow.FixedSizeListArray.from_arrays(pyarrow.array(array.astype(np.float32).reshape(-1)), 3)
