"""The recording of Algorithm 1: images with what was detected, hypotheses that grow and are pruned, and the rods that remain.

Images lie as they were taken, and what lies over them is projected with the lens' distortion: the viewer's own cameras, whose
frusta stand around the rods, know none.

Axes: C cameras, n hypotheses of a set at a step, V vertices.
"""

import numpy as np
import rerun
import rerun.blueprint as blueprint

from doo_ti.perception.growth import GrowthStep
from doo_ti.record.stream import entity_name, panels, recording
from doo_ti.record.wall import FAILED, GROUND, drawn_strips, log_up
from doo_ti.report.reprojections import BEST, DETECTED, RUNNER_UP, TRUTH, SeenRod
from doo_ti.vision.cameras.camera import Camera
from doo_ti.vision.cameras.rig import Rig

KEPT = (125, 170, 255)
FRUSTUM_MM = 60.0
JPEG_QUALITY = 80
TIMELINE = "edges"

FARTHEST_PX = 1e6
"""What is drawn farther off is not seen."""


def record_perception(path, *, run_id: str, name: str, rig: Rig, rods: list[SeenRod], growth: list[list[GrowthStep]],
                      up=(0, 0, 1)) -> None:
    """Write the recording ``path``, its layout inside: on the timeline ``edges`` how many edges hypotheses have; one step after
    the last the rods that remain, relaxed to the end.

    rods    sets of images with the rods that explain them
    growth  of each of them, from two edges on
    up      direction against gravity
    """
    places = [_entity(index, seen.name) for index, seen in enumerate(rods)]
    with recording(path, run_id, name, _layout(rig, places, rods, np.asarray(up, float))) as stream:
        for place, seen, steps in zip(places, rods, growth, strict=True):
            log_up(stream, f"{place}/world", np.asarray(up, float))
            _log_cameras(stream, place, rig, seen)
            _log_styles(stream, place, rig)
            for number, step in enumerate(steps, 2):
                stream.set_time(TIMELINE, sequence=number)
                _log_step(stream, place, rig, step)
            stream.set_time(TIMELINE, sequence=len(steps) + 2)
            _log_answer(stream, place, rig, seen)
            stream.reset_time()


def _entity(index: int, name: str) -> str:
    """The path below which a set's entities lie."""
    return f"set{index}_{entity_name(name)}"


def _log_cameras(stream, place: str, rig: Rig, seen: SeenRod) -> None:
    """What never changes: images and what was detected in them, frusta, the true rod."""
    for camera, image, detected in zip(rig.cameras, seen.images, seen.detected, strict=True):
        flat = f"{place}/{camera.name}"
        stream.log(flat, rerun.Image(image, color_model="L").compress(jpeg_quality=JPEG_QUALITY), static=True)
        stream.log(f"{flat}/detected", rerun.Points2D(
            _drawn(detected), colors=_rgb(DETECTED), radii=rerun.Radius.ui_points(1.2), draw_order=5.0), static=True)
        _log_frustum(stream, f"{place}/world/{camera.name}", camera)
        if seen.truth is not None:
            stream.log(f"{flat}/truth", rerun.LineStrips2D(
                [_drawn(camera.project(seen.truth))], colors=_rgb(TRUTH), radii=rerun.Radius.ui_points(1.0), draw_order=8.0),
                static=True)
    if seen.truth is not None:
        stream.log(f"{place}/world/truth", rerun.LineStrips3D(
            drawn_strips(seen.truth[None]), colors=_rgb(TRUTH), radii=rerun.Radius.ui_points(1.0)), static=True)
    words = rerun.TextDocument(f"**{seen.name}**: {seen.verdict}", media_type="text/markdown")
    stream.log(f"{place}/verdict", words, static=True)


def _log_frustum(stream, entity: str, camera: Camera) -> None:
    """Where a camera stands and what it sees, without its distortion."""
    stream.log(entity, rerun.Transform3D(translation=camera.centre, mat3x3=camera.rotation.T), rerun.Pinhole(
        image_from_camera=camera.matrix, width=camera.width, height=camera.height, image_plane_distance=FRUSTUM_MM),
        static=True)


def _log_styles(stream, place: str, rig: Rig) -> None:
    """Colours and widths of what changes, once."""
    for root, strips in [(f"{place}/world", rerun.LineStrips3D)] + [
            (f"{place}/{camera.name}", rerun.LineStrips2D) for camera in rig.cameras]:
        for name, color, width in (("pruned", FAILED, 0.4), ("kept", KEPT, 0.7), ("runner_up", _rgb(RUNNER_UP), 1.6),
                                   ("best", _rgb(BEST), 1.6)):
            order = {} if strips is rerun.LineStrips3D else {"draw_order": {"pruned": 6.0, "kept": 7.0}.get(name, 9.0)}
            stream.log(f"{root}/{name}", strips.from_fields(colors=[color], radii=rerun.Radius.ui_points(width), **order),
                       static=True)


def _log_step(stream, place: str, rig: Rig, step: GrowthStep) -> None:
    """The hypotheses of a step in space and in every image: those that stay, the best of them, and those that were pruned."""
    kept = np.flatnonzero(step.kept)
    groups = {"best": kept[:1], "kept": kept[1:], "pruned": np.flatnonzero(~step.kept)}
    stream.log(f"{place}/energy_vis", rerun.AnyValues(per_mm=step.energy_vis, kept=step.kept))
    for name, rows in groups.items():
        curves = step.vertices[rows]
        stream.log(f"{place}/world/{name}", rerun.LineStrips3D.from_fields(strips=drawn_strips(curves)))
        for camera in rig.cameras:
            pixels = [_drawn(line) for line in camera.project(curves)]
            stream.log(f"{place}/{camera.name}/{name}", rerun.LineStrips2D.from_fields(strips=pixels))


def _log_answer(stream, place: str, rig: Rig, seen: SeenRod) -> None:
    """The best rod and its runner-up in place of hypotheses."""
    groups = {"best": [seen.best], "runner_up": [] if seen.runner_up is None else [seen.runner_up], "kept": [], "pruned": []}
    for name, curves in groups.items():
        stream.log(f"{place}/world/{name}", rerun.LineStrips3D.from_fields(
            strips=[strip for curve in curves for strip in drawn_strips(curve[None])]))
        for camera in rig.cameras:
            stream.log(f"{place}/{camera.name}/{name}", rerun.LineStrips2D.from_fields(
                strips=[_drawn(camera.project(curve)) for curve in curves]))


def _drawn(pixels: np.ndarray) -> np.ndarray:
    """(n, 2) px as the viewer counts them, with the corners of pixels at whole numbers; what is not seen is left out."""
    return (pixels[(np.abs(pixels) < FARTHEST_PX).all(axis=1)] + 0.5).astype(np.float32)


def _rgb(color: str) -> tuple[int, int, int]:
    return tuple(int(color[at : at + 2], 16) for at in (1, 3, 5))


def _layout(rig: Rig, places: list[str], rods: list[SeenRod], up: np.ndarray) -> blueprint.Blueprint:
    """A tab for each set: the rods in space, near and among the cameras, and the cameras' images."""
    tabs = []
    for place, seen in zip(places, rods, strict=True):
        middle, size = seen.best.mean(axis=0), np.ptp(seen.best, axis=0).max()
        toward = np.mean([camera.centre for camera in rig.cameras], axis=0) - middle
        toward = toward / np.linalg.norm(toward) + 0.3 * up / np.linalg.norm(up)
        space = blueprint.Spatial3DView(
            name="Hypotheses: best and kept blue, pruned red", origin=f"{place}/world", line_grid=False, background=GROUND,
            eye_controls=blueprint.EyeControls3D(kind=blueprint.Eye3DKind.Orbital, look_target=middle, eye_up=up,
                                                 position=middle + 2.0 * size * toward))
        cameras = blueprint.Spatial3DView(name="Cameras", origin=f"{place}/world", line_grid=False, background=GROUND)
        images = [blueprint.Spatial2DView(name=camera.name, origin=f"{place}/{camera.name}", background=GROUND,
                                          visual_bounds=_bounds(seen.detected[column]))
                  for column, camera in enumerate(rig.cameras)]
        words = blueprint.TextDocumentView(name="Verdict", origin=f"{place}/verdict")
        tabs.append(blueprint.Horizontal(
            blueprint.Vertical(space, words, row_shares=[6, 1]), blueprint.Grid(*images, cameras), column_shares=[1, 1.2],
            name=seen.name))
    body = tabs[0] if len(tabs) == 1 else blueprint.Tabs(*tabs)
    return blueprint.Blueprint(body, *panels(TIMELINE))


def _bounds(detected: np.ndarray, margin: float = 40.0) -> blueprint.VisualBounds2D:
    """What an image view shows when opened: the thread."""
    (left, top), (right, bottom) = detected.min(axis=0) - margin, detected.max(axis=0) + margin
    return blueprint.VisualBounds2D(x_range=[left, right], y_range=[top, bottom])
