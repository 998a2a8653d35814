"""The recording of a motion: rods over time, what they hold and where they fall. Axes: T moments, R rods, V vertices."""

import numpy as np
import rerun
import rerun.blueprint as blueprint

from doo_ti.record.stream import entity_name, panels, recording
from doo_ti.record.wall import FAILED, GROUND, drawn_strips, log_up

COLORS = np.array([(45, 212, 191), (253, 231, 37), (125, 170, 255), (255, 159, 28), (198, 120, 221), (152, 195, 121)],
                  dtype=np.uint8)
MOST_CURVES = 12


def record_motion(path, *, run_id: str, name: str, time: np.ndarray, vertices: np.ndarray, names: list[str], sound: np.ndarray,
                  jumps: np.ndarray, curves: dict[str, np.ndarray], text: str, up=(0, 0, 1)) -> None:
    """Write the recording ``path``, its layout inside: all rods in one place, as they move.

    time      (T,) s, the timeline ``time``
    vertices  (T, R, V, 3) mm; a rod with a NaN in it is not drawn
    names     R of them
    sound     (T, R) bool: drawn in red from where they are not
    jumps     (T, R) falls, told in the log
    curves    title, with its unit: (T, R), a line for each of the first ``MOST_CURVES`` rods
    text      Markdown
    """
    count, moments = len(names), len(time)
    when = [rerun.TimeColumn("time", duration=time)]
    with recording(path, run_id, name, _layout(vertices, list(curves), np.asarray(up, float))) as stream:
        log_up(stream, "rods", np.asarray(up, float))
        stream.log("rods", rerun.LineStrips3D.from_fields(
            radii=rerun.Radius.ui_points(2.0), labels=names, show_labels=count <= len(COLORS)), static=True)
        colors = np.where(sound[..., None], COLORS[np.arange(count) % len(COLORS)], np.uint8(FAILED)).astype(np.uint8)
        stream.send_columns("rods", when, rerun.LineStrips3D.columns(
            strips=drawn_strips(vertices.reshape(moments * count, *vertices.shape[2:])),
            colors=colors.reshape(-1, 3)).partition([count] * moments))
        for title, values in curves.items():
            shown = values[:, :MOST_CURVES]
            entity = f"curves/{entity_name(title)}"
            stream.log(entity, rerun.SeriesLines(names=names[:MOST_CURVES], widths=[2.0] * shown.shape[1],
                                                 colors=COLORS[np.arange(shown.shape[1]) % len(COLORS)]), static=True)
            stream.send_columns(entity, when, rerun.Scalars.columns(
                scalars=np.ascontiguousarray(shown).ravel()).partition([shown.shape[1]] * moments))
        for moment, rod in np.argwhere(jumps > 0):
            stream.set_time("time", duration=float(time[moment]))
            stream.log("falls", rerun.TextLog(f"{names[rod]} falls to another branch", level=rerun.TextLogLevel.WARN))
        stream.log("summary", rerun.TextDocument(text, media_type="text/markdown"), static=True)


def _layout(vertices: np.ndarray, titles: list[str], up: np.ndarray) -> blueprint.Blueprint:
    """Rods on the left, seen from the front and a little above; curves, falls and text on the right."""
    low, high = np.nanmin(vertices, axis=(0, 1, 2)), np.nanmax(vertices, axis=(0, 1, 2))
    middle, size = 0.5 * (low + high), max(np.linalg.norm(high - low), 1.0)
    up = up / np.linalg.norm(up)
    chord = np.nanmean(vertices[:, :, -1] - vertices[:, :, 0], axis=(0, 1))
    into = np.cross(up, chord)
    into = np.cross(up, np.eye(3)[np.argmin(np.abs(up))]) if np.linalg.norm(into) < 1e-6 * size else into
    view = blueprint.Spatial3DView(
        name="Rods, mm", origin="rods", line_grid=False, background=GROUND,
        eye_controls=blueprint.EyeControls3D(
            kind=blueprint.Eye3DKind.Orbital, look_target=middle, eye_up=up,
            position=middle - 1.1 * size * (into / np.linalg.norm(into) - 0.3 * up)))
    plots = [blueprint.TimeSeriesView(name=title, origin=f"curves/{entity_name(title)}") for title in titles]
    words = blueprint.Horizontal(blueprint.TextDocumentView(name="Summary", origin="summary"),
                                 blueprint.TextLogView(name="Falls", origin="falls"))
    beside = blueprint.Vertical(*plots, words)
    return blueprint.Blueprint(blueprint.Horizontal(view, beside, column_shares=[1.3, 1]), *panels("time"))
