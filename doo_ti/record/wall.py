"""Observations and their rods on the wall of a contact sheet. Axes: D observations, R rods, V vertices."""

import numpy as np
import pyarrow
import rerun
import rerun.blueprint as blueprint

from doo_ti.contact_sheet import Sheet

OBSERVED, FAILED, TEXT = (235, 235, 235), (255, 46, 99), (175, 175, 175)
GROUND = (16, 18, 22)


def log_observations(stream, world: str, sheet: Sheet, vertices: np.ndarray, names: list[str]) -> None:
    """Observed marks (D, V, 3) and the lines through them, below the entity ``world``; a missing mark is left out."""
    present = np.isfinite(vertices).all(axis=-1)
    placed = (vertices + sheet.offset[:, None]).astype(np.float32)
    log_up(stream, world, sheet.basis[2])
    strips = [rod[mask] for rod, mask in zip(placed, present, strict=True)]
    stream.log(f"{world}/observations", rerun.LineStrips3D(
        strips, colors=OBSERVED, radii=rerun.Radius.ui_points(0.5), labels=names, show_labels=False),
        rerun.AnyValues(offset_mm=vectors(sheet.offset)), static=True)
    stream.log(f"{world}/observations/marks", rerun.Points3D(
        placed[present], colors=OBSERVED, radii=rerun.Radius.ui_points(1.0)), static=True)
    if sheet.headings:
        texts, places = zip(*sheet.headings, strict=True)
        stream.log(f"{world}/headings", rerun.Points3D(
            places, labels=texts, show_labels=True, colors=TEXT, radii=rerun.Radius.ui_points(0)), static=True)


def log_up(stream, world: str, up: np.ndarray) -> None:
    """The coordinate axis nearest to ``up`` as the viewer's vertical."""
    axis = int(np.argmax(np.abs(up)))
    name = f"RIGHT_HAND_{'XYZ'[axis]}_{'UP' if up[axis] > 0 else 'DOWN'}"
    stream.log(world, getattr(rerun.ViewCoordinates, name), static=True)


def drawn_strips(rods: np.ndarray):
    """(N, V, 3) rods as the viewer takes them: a rod with a NaN in it is an empty strip, which keeps its instance index and
    draws nothing."""
    rods = rods.astype(np.float32)
    if np.isfinite(rods).all():
        return rods
    return [rod if np.isfinite(rod).all() else rod[:0] for rod in rods]


def wall_view(sheet: Sheet, world: str, name: str, aspect: float = 1.35) -> blueprint.Spatial3DView:
    """The wall from the front, as far away as it takes to see all of it in a view ``aspect`` times as wide as high."""
    width, height = sheet.extent
    away = 0.52 * max(height, width / aspect) / np.tan(np.radians(27.5))
    return blueprint.Spatial3DView(
        name=name, origin=world, line_grid=False, background=GROUND,
        eye_controls=blueprint.EyeControls3D(
            kind=blueprint.Eye3DKind.Orbital, look_target=sheet.centre, eye_up=sheet.basis[2],
            position=sheet.centre - away * sheet.basis[1]))


def vectors(array: np.ndarray) -> pyarrow.Array:
    return pyarrow.FixedSizeListArray.from_arrays(pyarrow.array(array.astype(np.float32).reshape(-1)), 3)
