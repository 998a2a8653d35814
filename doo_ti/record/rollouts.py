"""Rods in motion as a recording: side by side, beside what was recorded of them, with errors over time.

Axes: R rods, T frames, V vertices.
"""

from pathlib import Path

import numpy as np
import rerun
import rerun.blueprint as blueprint

from doo_ti.record.obstacles import log_forces, log_obstacles
from doo_ti.record.stream import OBSERVED, drawn_strips, front_view, log_up, panels, recording
from doo_ti.report import distinct_colors
from doo_ti.report.grid_view import Observed, facing, grid_view
from doo_ti.report.touched import Touched

SIMULATED = (255, 140, 60)
MOST_RODS = 64


def record_rollout(path: Path, name: str, names: list[str], positions: np.ndarray, recorded: np.ndarray | None,
                   rate: float, up: np.ndarray, energies: dict[str, np.ndarray] | None = None,
                   touched: Touched | None = None) -> None:
    """Record the first :data:`MOST_RODS` of (R, T, V, 3) rods in mm, on the timeline ``time``.

    ``world/rods`` and ``world/observations`` hold a strip for each rod, moved to its place in the grid view; ``curves/error``
    the mean |difference| of each rod in mm; ``curves/energy`` has the ``energies`` (R, T) of the first rod by name, mm²;
    ``world/obstacles`` and ``world/forces`` what rods have ``touched``, and what that exerts on them.
    """
    rods = positions[:MOST_RODS]
    count, frames = rods.shape[:2]
    seen = None if recorded is None else recorded[:MOST_RODS]
    places = (rods if seen is None else seen).reshape(count, -1, 3)
    grid = grid_view(Observed(places, up=facing(places, up)[0]))
    title = f"Rods, mm: orange simulated{', white recorded' * (seen is not None)}"
    views = [front_view(grid, "world", title if touched is None else f"{title}, blue {touched.legend}", 1.8)]
    if seen is not None:
        views.append(blueprint.TimeSeriesView(name="Mean |difference|, mm", origin="curves/error"))
    if energies is not None:
        views.append(blueprint.TimeSeriesView(name=f"Energies of {names[0]}, mm²", origin="curves/energy"))
    layout = blueprint.Blueprint(blueprint.Vertical(*views, row_shares=[2, 1, 1][: len(views)]), *panels("time"))
    when = [rerun.TimeColumn("time", duration=np.arange(frames) / rate)]
    with recording(path, f"rollout {name}", name, layout) as stream:
        log_up(stream, "world", up)
        for entity, shown, color, width in (("observations", seen, OBSERVED, 0.7), ("rods", rods, SIMULATED, 1.2)):
            if shown is None:
                continue
            placed = shown + grid.offset[:, None, None]
            # A rod that may touch something is as thick as it is.
            thick = touched is not None and shown is rods
            radius = float(np.min(touched.surroundings.radius)) if thick else rerun.Radius.ui_points(width)
            stream.log(f"world/{entity}", rerun.LineStrips3D.from_fields(
                colors=color, radii=radius, labels=names[:MOST_RODS], show_labels=count <= 12), static=True)
            strips = drawn_strips(placed.swapaxes(0, 1).reshape(-1, *rods.shape[2:]))
            stream.send_columns(f"world/{entity}", when, rerun.LineStrips3D.columns(strips=strips).partition([count] * frames))
        if touched is not None:
            log_obstacles(stream, "world/obstacles", when, touched, grid.offset)
            log_forces(stream, "world/forces", when, touched, grid.offset)
        if seen is not None:
            error = np.abs(rods - seen).mean(axis=(2, 3)).T
            stream.log("curves/error", rerun.SeriesLines(
                names=names[:MOST_RODS], widths=[1.0] * count, colors=distinct_colors(count)), static=True)
            stream.send_columns("curves/error", when, rerun.Scalars.columns(
                scalars=np.ascontiguousarray(error).ravel()).partition([count] * frames))
        if energies is not None:
            values = np.stack([value[0] for value in energies.values()], axis=-1)
            stream.log("curves/energy", rerun.SeriesLines(names=list(energies), widths=[1.0] * len(energies),
                                                          colors=distinct_colors(len(energies))), static=True)
            stream.send_columns("curves/energy", when, rerun.Scalars.columns(scalars=values.ravel()).partition(
                [len(energies)] * frames))
