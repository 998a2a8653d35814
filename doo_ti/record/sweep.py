"""The recording of a run: rods over solver iterations, landscape, curves, summary.

Axes: T iterations, D observations (one rod each), V vertices.
"""

import numpy as np
import rerun
import rerun.blueprint as blueprint

from doo_ti import report
from doo_ti.contact_sheet import Sheet, contact_sheet, known, observation_names
from doo_ti.grid import UNITS, Interval
from doo_ti.record.stream import panels, recording
from doo_ti.record.surface import log_cells, log_surface, surface_view
from doo_ti.record.wall import FAILED, drawn_strips, log_observations, vectors, wall_view
from doo_ti.report.plane import Plane
from doo_ti.types import Status

BLOCK = 10
"""Iterations sent at once."""


def record_sweep(path, *, run_id: str, name: str, observations_vertices, labels, trajectory, energy, residual, status,
                 distance, properties: dict, axes=(), landscape=None, minimum=None, valley=None, unfinished=None,
                 intervals: tuple[Interval, ...] = (), order=None, up=(0, 0, 1), region=None) -> None:
    """Write the recording ``path``, its layout inside.

    observations_vertices  (D, V, 3) mm, NaN where a mark is missing
    labels                 {"end_distance_mm": (D,), "end_rotation_deg": (D,)}: the first makes the columns of the
                           contact sheet, the second its rows; None where unknown: reading order
    trajectory             (T, D, V, 3) mm, the rods of the best cell; a rod with a NaN in it is not drawn
    energy, residual       (T, D): relative to weight, mm²; residual, without a unit. Where NaN the rod's last one stands
    status, distance       (D,): Status; Eq. 1, mm
    properties             {name: number or text}: in the summary and as properties of the recording
    axes, landscape, minimum, valley, unfinished, region
                           as `report.landscape_picture` takes them; left out for a single relaxation
    intervals              of the parameters, as `grid.valley` finds them, for the summary
    order                  (N,) flat grid index of the cell each trial evaluated; default: grid order
    up                     direction against gravity
    """
    vertices, trajectory = np.asarray(observations_vertices, float), np.asarray(trajectory, float)
    status, distance = np.asarray(status), np.asarray(distance, float)
    properties = {key: value if isinstance(value, (int, float, str)) else str(value)
                  for key, value in properties.items()}
    labels = known(labels)
    sheet, names = contact_sheet(vertices, labels, up), observation_names(labels, len(vertices))
    plane = None if landscape is None else Plane.of(axes, landscape, minimum, valley, unfinished)
    with recording(path, run_id, name, _layout(sheet, plane)) as stream:
        if properties:
            stream.send_property("run", rerun.AnyValues(**properties))
        log_observations(stream, "world", sheet, vertices, names)
        _log_rods(stream, sheet, trajectory, names, status, distance, plane is not None)
        _log_curves(stream, np.asarray(energy, float), np.asarray(residual, float))
        if plane is not None:
            picture = report.landscape_image(axes, landscape, minimum=minimum, valley=valley, title=name,
                                             label=report.MEAN_DISTANCE, unfinished=unfinished, region=region)
            stream.log("landscape/picture", rerun.Image(picture), static=True)
            log_surface(stream, plane)
            log_cells(stream, plane, np.asarray(landscape, float), order)
        text = _summary(name, intervals, names, status, distance, properties)
        stream.log("summary", rerun.TextDocument(text, media_type="text/markdown"), static=True)


def _log_rods(stream, sheet: Sheet, trajectory: np.ndarray, names: list[str], status, distance,
              with_trials: bool) -> None:
    """One entity for all rods, one instance per rod: a rod per entity makes files and viewer slow."""
    colors = np.where((status == Status.CONVERGED)[:, None], report.distance_colors(distance), FAILED)
    labels = [f"{name}: {report.quantity(d, 'mm')}, {_ending(s)}"
              for name, d, s in zip(names, distance, status, strict=True)]
    stream.log("world/rods", rerun.LineStrips3D.from_fields(
        colors=colors.astype(np.uint8), radii=rerun.Radius.ui_points(1.7), labels=labels, show_labels=False),
        rerun.AnyValues(offset_mm=vectors(sheet.offset)), static=True)
    for start in range(0, len(trajectory), BLOCK):
        rods = trajectory[start:start + BLOCK] + sheet.offset[:, None]
        steps, count, marks, _ = rods.shape
        strips = drawn_strips(rods.reshape(-1, marks, 3))
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
        "residual/median": ("median [log10]", np.nanmedian, residual, (125, 170, 255)),
        "residual/largest": ("largest [log10]", np.nanmax, residual, FAILED),
    }
    for entity, (name, statistic, values, color) in curves.items():
        some = np.isfinite(values).any(axis=1)
        if some.any():
            stream.log(f"curves/{entity}", rerun.SeriesLines(names=name, colors=color, widths=2), static=True)
            stream.send_columns(f"curves/{entity}", [rerun.TimeColumn("iteration", sequence=np.flatnonzero(some))],
                                rerun.Scalars.columns(scalars=statistic(values[some], axis=1)))


def _layout(sheet: Sheet, plane: Plane | None) -> blueprint.Blueprint:
    """Rods and summary on the left, landscape and curves on the right; on the last iteration when opened."""
    rods = wall_view(sheet, "world", f"Rods on observed marks (white), mm; {sheet.meaning}".removesuffix("; "))
    plots = [blueprint.TimeSeriesView(name=name, origin=f"curves/{entity}", plot_legend=blueprint.Corner2D.RightTop)
             for entity, name in (("energy", "Energy [mm²]"), ("residual", "log10 residual"))]
    summary = blueprint.TextDocumentView(name="Summary", origin="summary")
    left = blueprint.Vertical(rods, summary, row_shares=[3, 1.25])
    if plane is None:
        right = blueprint.Vertical(*plots)
        return blueprint.Blueprint(blueprint.Horizontal(left, right, column_shares=[1.25, 1]), *panels("iteration"))
    picture = blueprint.Spatial2DView(name="Landscape", origin="landscape/picture")
    right = blueprint.Vertical(blueprint.Tabs(picture, surface_view()), blueprint.Horizontal(*plots), row_shares=[3, 2])
    return blueprint.Blueprint(blueprint.Horizontal(left, right, column_shares=[1.25, 1]), *panels("iteration"))


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
