"""Recordings of rods in one place of space: motions (§III-D), simulated ones beside what was recorded of them, groups
(docs/groups.md), and ribbons of several materials (Fig. 5c).

Axes: T moments or frames, R rods, D observations, V vertices.
"""

from pathlib import Path

import numpy as np
import rerun
import rerun.blueprint as blueprint

from doo_ti.contact.surroundings import Moving, since_first
from doo_ti.record import viewer
from doo_ti.report.canvas import Observed, box, distinct_colors, facing, grid_view, widest
from doo_ti.report.contact import GroupMotion, Touched
from doo_ti.report.figures import Ribbons
from doo_ti.report.motions import MovingRods

GRIPPER = (120, 120, 130)
MOST_CURVES = 12
MOST_IN_LEGEND = 6
"""Names of rods in the legend of a plot; of more it would be cut off, and only the rods in space show their names."""


def record_motion(path, *, run_id: str, name: str, rods: MovingRods, curves: dict[str, np.ndarray], text: str) -> None:
    """Write the recording ``path``: rods over time with the grippers that hold them, red from where they are no certified
    minima, and the observed marks that they started from; jumps are in the log.

    curves  title, with its unit: (T, R), a line for each of the first ``MOST_CURVES`` rods
    text    Markdown
    """
    count = len(rods.names)
    when = [rerun.TimeColumn("time", duration=rods.time)]
    with viewer.recording(path, run_id, name, _motion_layout(rods, list(curves))) as stream:
        viewer.log_up(stream, "world", rods.basis[2])
        stream.log("world/rods", rerun.LineStrips3D.from_fields(
            radii=viewer.points(2.0), labels=rods.names, show_labels=count <= MOST_CURVES), static=True)
        if rods.grippers is not None:
            moments, _, _, *line = rods.grippers.shape
            stream.log("world/grippers", rerun.LineStrips3D.from_fields(
                colors=[GRIPPER], radii=viewer.points(3.5)), static=True)
            viewer.send_rods(stream, "world/grippers", when, rods.grippers.reshape(moments, -1, *line))
        if rods.marks is not None:
            present = rods.marks[np.isfinite(rods.marks).all(axis=-1)].astype(np.float32)
            marks = rerun.Points3D(present, colors=viewer.OBSERVED, radii=viewer.points(1.4))
            stream.log("world/observations/marks", marks, static=True)
        _log_contact(stream, when, rods.touched, np.zeros((count, 3)))
        own = distinct_colors(count)
        colors = np.where(rods.sound[..., None], own, np.uint8(viewer.FAILED)).astype(np.uint8)
        viewer.send_rods(stream, "world/rods", when, rods.vertices, colors=colors)
        for title, values in curves.items():
            _log_curves(stream, f"curves/{viewer.entity_name(title)}", when, values[:, :MOST_CURVES], rods.names[:MOST_CURVES],
                        own[:MOST_CURVES], 2.0)
        for moment, rod in np.argwhere(rods.jumps > 0):
            stream.set_time("time", duration=float(rods.time[moment]))
            stream.log("log", rerun.TextLog(f"{rods.names[rod]} jumps to another branch", level=rerun.TextLogLevel.WARN))
        stream.log("summary", rerun.TextDocument(text, media_type="text/markdown"), static=True)


def _log_curves(stream, entity: str, when: list[rerun.TimeColumn], values: np.ndarray, names: list[str], colors: np.ndarray,
                width: float) -> None:
    """``values`` (T, N) as N lines in a plot."""
    moments, count = values.shape
    stream.log(entity, rerun.SeriesLines(names=names, widths=[width] * count, colors=colors), static=True)
    stream.send_columns(entity, when, rerun.Scalars.columns(
        scalars=np.ascontiguousarray(values).ravel()).partition([count] * moments))


def _motion_layout(rods: MovingRods, titles: list[str]) -> blueprint.Blueprint:
    """Rods on the left, seen from the front and a little above; curves, jumps and text on the right."""
    low, high = box(rods.vertices.reshape(-1, 3))
    middle, size = 0.5 * (low + high), max(np.linalg.norm(high - low), 1.0)
    _, into, up = rods.basis
    blue = "" if rods.touched is None else f"; blue: {rods.touched.legend}"
    view = viewer.space_view(f"Rods, mm; grey: grippers, white: observed marks{blue}", "world",
                             (middle - size * (into - 0.3 * up), middle, up))
    # The same colours everywhere: one legend, that of the first plot.
    plots = [blueprint.TimeSeriesView(
        name=title, origin=f"curves/{viewer.entity_name(title)}",
        plot_legend=blueprint.PlotLegend("LeftTop", visible=not place and len(rods.names) <= MOST_IN_LEGEND))
        for place, title in enumerate(titles)]
    words = blueprint.Horizontal(blueprint.TextDocumentView(name="Summary", origin="summary"), viewer.log_view("Jumps", "time"))
    beside = blueprint.Vertical(*plots, words)
    return blueprint.Blueprint(blueprint.Horizontal(view, beside, column_shares=[1.3, 1]), *viewer.panels("time"))


def record_ribbons(path, *, run_id: str, name: str, ribbons: list[Ribbons], observation: np.ndarray, rank: np.ndarray,
                   texts: list[str], basis: np.ndarray) -> None:
    """Write the recording ``path``: all kinds of ribbons in one place, one step per term.

    observation  (D,) the number of the observation that each is compared with, for the timeline ``observation``
    rank         (D,) order on the timeline ``difference``, at whose end the recording opens
    texts        (D,) Markdown that goes with each term
    basis        (3, 3) rows right, into the view and up
    """
    count, _, marks, _ = ribbons[0].sides.shape
    times = [rerun.TimeColumn("observation", sequence=observation), rerun.TimeColumn("difference", sequence=rank)]
    with viewer.recording(path, run_id, name, _ribbon_layout(ribbons, basis)) as stream:
        viewer.log_up(stream, "world", basis[2])
        for number, kind in enumerate(ribbons):
            place = f"world/ribbons/{number}"
            if kind.filled:
                # The mesh of a ribbon without a configuration is a point.
                sides = np.where(np.isfinite(kind.sides).all(axis=(1, 2, 3), keepdims=True), kind.sides, 0.0).astype(np.float32)
                low, high = np.arange(marks - 1), np.arange(marks, 2 * marks - 1)  # vertices of one border, then of the other
                triangles = [np.stack([low, low + 1, high], -1), np.stack([high, low + 1, high + 1], -1)]
                stream.log(place, rerun.Mesh3D.from_fields(
                    triangle_indices=np.concatenate(triangles).astype(np.uint32)), static=True)
                normal = np.cross(np.gradient(sides.mean(axis=1), axis=1), sides[:, 1] - sides[:, 0])
                normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-9)
                stream.send_columns(place, times, rerun.Mesh3D.columns(
                    vertex_positions=sides.reshape(-1, 3),
                    vertex_normals=np.stack([normal, normal], axis=1).astype(np.float32).reshape(-1, 3),
                    vertex_colors=np.tile(np.uint8(kind.color), (sides[..., 0].size, 1))).partition([2 * marks] * count))
            stream.log(f"{place}/borders", rerun.LineStrips3D.from_fields(
                colors=[np.uint8(kind.color) // (2 if kind.filled else 1)], radii=viewer.points(0.9),
                labels=[kind.label] * 2, show_labels=False), static=True)
            viewer.send_rods(stream, f"{place}/borders", times, kind.sides)
        stream.send_columns("summary", times, rerun.TextDocument.columns(text=texts, media_type=["text/markdown"] * count))


def _ribbon_layout(ribbons: list[Ribbons], basis: np.ndarray) -> blueprint.Blueprint:
    """The ribbons from the front and above, and the text of the term; it opens on the last step."""
    points = np.stack([kind.sides for kind in ribbons], axis=1)
    low, high = box(points.reshape(len(points), -1, 3))
    middle = np.median(0.5 * (low + high), axis=0)
    size = max(np.linalg.norm(high - low, axis=-1).max(), widest(low, high))
    position = middle - 0.9 * size * (basis[1] - 0.35 * basis[2] - 0.35 * basis[0])
    view = viewer.space_view("Ribbons, mm", "world", (position, middle, basis[2]))
    text = blueprint.TextDocumentView(name="Ribbons", origin="summary")
    return blueprint.Blueprint(blueprint.Horizontal(view, text, column_shares=[1.2, 1]), *viewer.panels("difference"))


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
    views = [viewer.front_view(grid, "world", title if touched is None else f"{title}, blue {touched.legend}", 1.8)]
    if seen is not None:
        views.append(blueprint.TimeSeriesView(name="Mean |difference|, mm", origin="curves/error"))
    if energies is not None:
        views.append(blueprint.TimeSeriesView(name=f"Energies of {names[0]}, mm²", origin="curves/energy"))
    layout = blueprint.Blueprint(blueprint.Vertical(*views, row_shares=[2, 1, 1][: len(views)]), *viewer.panels("time"))
    when = [rerun.TimeColumn("time", duration=np.arange(frames) / rate)]
    with viewer.recording(path, f"rollout {name}", name, layout) as stream:
        viewer.log_up(stream, "world", up)
        for entity, shown, color, width in (("observations", seen, viewer.OBSERVED, 0.7), ("rods", rods, SIMULATED, 1.2)):
            if shown is None:
                continue
            # A rod that may touch something is as thick as it is.
            thick = touched is not None and shown is rods
            radius = float(np.min(touched.surroundings.radius)) if thick else viewer.points(width)
            stream.log(f"world/{entity}", rerun.LineStrips3D.from_fields(
                colors=color, radii=radius, labels=names[:MOST_RODS], show_labels=count <= 12), static=True)
            viewer.send_rods(stream, f"world/{entity}", when, (shown + grid.offset[:, None, None]).swapaxes(0, 1))
        _log_contact(stream, when, touched, grid.offset)
        if seen is not None:
            _log_curves(stream, "curves/error", when, np.abs(rods - seen).mean(axis=(2, 3)).T, names[:MOST_RODS],
                        distinct_colors(count), 1.0)
        if energies is not None:
            values = np.stack([value[0] for value in energies.values()], axis=-1)
            _log_curves(stream, "curves/energy", when, values, list(energies), distinct_colors(len(energies)), 1.0)


TIE = (255, 255, 255)


def record_group(path: Path, seen: GroupMotion) -> None:
    """Record a group on the timeline ``time``.

    ``world/rods`` has an entity for each rod, by its number and its name: as thick as it is where that is known, in red at
    moments that have not converged; ``world/ties`` the tied points; ``world/obstacles`` and ``world/forces`` what rods touch,
    and what that exerts.
    """
    grid = grid_view(Observed(seen.vertices.reshape(1, -1, 3), up=seen.up))
    view = viewer.front_view(grid, "world", f"Rods, mm: blue {seen.touched.legend}", 1.8)
    frames, count = len(seen.rods), len(seen.names)
    when = [rerun.TimeColumn("time", duration=np.arange(frames) / seen.rate)]
    layout = blueprint.Blueprint(view, *viewer.panels("time"))
    with viewer.recording(path, f"group {seen.name}", seen.name, layout) as stream:
        viewer.log_up(stream, "world", grid.basis[2])
        radii = [None] * count if seen.radii is None else seen.radii.tolist()
        for rod, (own, color) in enumerate(zip(seen.names, distinct_colors(count), strict=True)):
            place = f"world/rods/{rod}_{viewer.entity_name(own)}"
            stream.log(place, rerun.LineStrips3D.from_fields(radii=_thick(radii[rod], 1.0, 1.2)), static=True)
            viewer.send_rods(stream, place, when, np.stack([moment[rod] for moment in seen.rods])[:, None],
                             colors=np.where(seen.sound[:, None], color, np.array(viewer.FAILED, dtype=color.dtype)))
        if len(seen.tied):
            thickest = None if seen.radii is None else max(radii)
            stream.log("world/ties", rerun.Points3D.from_fields(colors=TIE, radii=_thick(thickest, 1.3, 2.0)), static=True)
            stream.send_columns("world/ties", when, rerun.Points3D.columns(
                positions=seen.vertices[:, seen.tied].reshape(-1, 3)).partition([len(seen.tied)] * frames))
        _log_contact(stream, when, seen.touched, np.zeros((1, 3)))


def _thick(radius: float | None, share: float, points: float):
    """So many times the radius, or so many points of the screen where there is none."""
    return viewer.points(points) if radius is None else share * radius


OBSTACLE, FORCE = (130, 138, 150, 255), (110, 160, 255)


def _log_contact(stream, when: list, touched: Touched | None, offset: np.ndarray) -> None:
    """The obstacles around each rod, once for rods in one place, and contact forces as arrows at the T times ``when``, moved by
    the rods' ``offset`` (R, 3)."""
    if touched is None:
        return
    for row, move in enumerate(offset if offset.any() else offset[:1]):
        for number, (given, _, vertices, triangles, normals) in enumerate(touched.meshes(row, 0)):
            own, corners = f"world/obstacles/{row}/{number}", vertices[triangles]
            across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            turned = (across * normals).sum(axis=-1) < 0.0  # their corners are not in the sense of the outward normals
            corners = np.where(turned[:, None, None], corners[:, ::-1], corners).reshape(-1, 3)
            if isinstance(given, Moving):
                rotation, shift = since_first(*given.path)
                stream.send_columns(own, when, rerun.Transform3D.columns(mat3x3=rotation[0], translation=shift[0] + move))
            else:
                corners = corners + move
            stream.log(own, rerun.Mesh3D(
                vertex_positions=corners, vertex_normals=np.repeat(normals, 3, axis=0), albedo_factor=OBSTACLE,
                # A table does not hide from below what lies on it.
                face_rendering=rerun.components.MeshFaceRendering.Front), static=True)
    places, vectors, counts = [], [], []
    for frame in range(touched.force.shape[1]):
        found = [touched.arrows(row, frame) for row in range(len(offset))]
        places += [origin + move for (origin, _), move in zip(found, offset, strict=True)]
        vectors += [vector for _, vector in found]
        counts.append(sum(len(origin) for origin, _ in found))
    stream.log("world/forces", rerun.Arrows3D.from_fields(colors=FORCE, radii=viewer.points(0.8)), static=True)
    stream.send_columns("world/forces", when, rerun.Arrows3D.columns(
        origins=np.concatenate(places), vectors=np.concatenate(vectors)).partition(counts))
