"""A group of rods in motion as a recording (docs/groups.md). Axes: T moments, V vertices of a rod."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import rerun
import rerun.blueprint as blueprint

from doo_ti.contact.surroundings import Surroundings
from doo_ti.groups.relax_group import GroupSolution
from doo_ti.record.obstacles import log_forces, log_obstacles
from doo_ti.record.stream import FAILED, drawn_strips, entity_name, front_view, log_up, panels, recording
from doo_ti.report import distinct_colors
from doo_ti.report.grid_view import Observed, grid_view
from doo_ti.report.groups import GroupMotion

TIE = (255, 255, 255)


def record_group(path: Path, moments: Sequence[GroupSolution], *, name: str, names: Sequence[str] | None = None,
                 surroundings: Surroundings | None = None, row: int = 0, rate: float = 1.0,
                 up: Sequence[float] = (0.0, 0.0, 1.0), newton: float | None = None) -> None:
    """Record the group ``row`` at T moments, ``rate`` of them a second, on the timeline ``time``.

    ``world/rods`` has an entity for each rod, by its number and its name where there are ``names``: as thick as it is where
    ``surroundings`` say so, in red at moments that have not converged; ``world/ties`` the tied points; ``world/obstacles`` and
    ``world/forces`` what rods touch, and what that exerts, in N where ``newton`` says how many their unit of force has.
    """
    seen = GroupMotion.of(moments, row, surroundings, newton)
    grid = grid_view(Observed(seen.vertices.reshape(1, -1, 3), up=up))
    layout = blueprint.Blueprint(front_view(grid, "world", f"Rods, mm: blue {seen.touched.legend}", 1.8), *panels("time"))
    frames, count = len(seen.rods), len(seen.rods[0])
    when = [rerun.TimeColumn("time", duration=np.arange(frames) / rate)]
    called = [str(rod) if names is None else f"{rod}_{entity_name(names[rod])}" for rod in range(count)]
    with recording(path, f"group {name}", name, layout) as stream:
        log_up(stream, "world", grid.basis[2])
        radii = [None] * count if seen.radii is None else seen.radii.tolist()
        for rod, (own, color) in enumerate(zip(called, distinct_colors(count), strict=True)):
            place = f"world/rods/{own}"
            stream.log(place, rerun.LineStrips3D.from_fields(radii=_thick(radii[rod], 1.0, 1.2)), static=True)
            strips = [strip for moment in seen.rods for strip in drawn_strips(moment[rod][None])]
            stream.send_columns(place, when, rerun.LineStrips3D.columns(
                strips=strips, colors=np.where(seen.sound[:, None], color, np.array(FAILED, dtype=color.dtype))))
        if len(seen.tied):
            thickest = None if seen.radii is None else max(radii)
            stream.log("world/ties", rerun.Points3D.from_fields(colors=TIE, radii=_thick(thickest, 1.3, 2.0)), static=True)
            stream.send_columns("world/ties", when, rerun.Points3D.columns(
                positions=seen.vertices[:, seen.tied].reshape(-1, 3)).partition([len(seen.tied)] * frames))
        log_obstacles(stream, "world/obstacles", when, seen.touched, np.zeros((1, 3)))
        log_forces(stream, "world/forces", when, seen.touched, np.zeros((1, 3)))


def _thick(radius: float | None, share: float, points: float):
    """So many times the radius, or so many points of the screen where there is none."""
    return rerun.Radius.ui_points(points) if radius is None else share * radius
