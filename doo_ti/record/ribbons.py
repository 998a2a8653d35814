"""The recording of ribbons of several materials under the same clamps (Fig. 5c). Axes: D observations, V vertices."""

import numpy as np
import rerun
import rerun.blueprint as blueprint

from doo_ti.record.stream import panels, recording
from doo_ti.record.wall import GROUND, drawn_strips, log_up
from doo_ti.report import Ribbons


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
    with recording(path, run_id, name, _layout(ribbons, basis)) as stream:
        log_up(stream, "ribbons", basis[2])
        for number, kind in enumerate(ribbons):
            place, borders = f"ribbons/{number}", kind.sides.reshape(-1, marks, 3)
            if kind.filled:
                # A ribbon that came to nothing is a point.
                sides = np.where(np.isfinite(kind.sides).all(axis=(1, 2, 3), keepdims=True), kind.sides, 0.0).astype(np.float32)
                stream.log(place, rerun.Mesh3D.from_fields(triangle_indices=_triangles(marks)), static=True)
                stream.send_columns(place, times, rerun.Mesh3D.columns(
                    vertex_positions=sides.reshape(-1, 3), vertex_normals=_normals(sides).reshape(-1, 3),
                    vertex_colors=np.tile(np.uint8(kind.color), (sides[..., 0].size, 1))).partition([2 * marks] * count))
            stream.log(f"{place}/borders", rerun.LineStrips3D.from_fields(
                colors=[np.uint8(kind.color) // (2 if kind.filled else 1)], radii=rerun.Radius.ui_points(0.9),
                labels=[kind.label] * 2, show_labels=False), static=True)
            stream.send_columns(f"{place}/borders", times, rerun.LineStrips3D.columns(
                strips=drawn_strips(borders)).partition([2] * count))
        stream.send_columns("summary", times, rerun.TextDocument.columns(text=texts, media_type=["text/markdown"] * count))


def _triangles(marks: int) -> np.ndarray:
    """(N, 3) of a band whose vertices are those of its one border, then those of the other."""
    low = np.arange(marks - 1)
    high = low + marks
    return np.concatenate([np.stack([low, low + 1, high], -1), np.stack([high, low + 1, high + 1], -1)]).astype(np.uint32)


def _normals(sides: np.ndarray) -> np.ndarray:
    """(D, 2, V, 3) unit vectors across each band's face."""
    along = np.gradient(sides.mean(axis=1), axis=1)
    normal = np.cross(along, sides[:, 1] - sides[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-9)
    return np.stack([normal, normal], axis=1).astype(np.float32)


def _layout(ribbons: list[Ribbons], basis: np.ndarray) -> blueprint.Blueprint:
    """The ribbons of the last step from the front and above, and what they are."""
    points = np.stack([kind.sides for kind in ribbons])
    low, high = np.nanmin(points, axis=(0, 2, 3)), np.nanmax(points, axis=(0, 2, 3))
    middle, size = np.median(0.5 * (low + high), axis=0), np.linalg.norm(high - low, axis=-1).max()
    view = blueprint.Spatial3DView(
        name="Ribbons, mm", origin="ribbons", line_grid=False, background=GROUND,
        eye_controls=blueprint.EyeControls3D(
            kind=blueprint.Eye3DKind.Orbital, look_target=middle, eye_up=basis[2],
            position=middle - 0.9 * size * (basis[1] - 0.35 * basis[2] - 0.35 * basis[0])))
    text = blueprint.TextDocumentView(name="Ribbons", origin="summary")
    return blueprint.Blueprint(blueprint.Horizontal(view, text, column_shares=[1.2, 1]), *panels("difference"))
