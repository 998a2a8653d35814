"""Recordings of rods in images: Algorithm 1, whose hypotheses grow and are pruned, a rod tracked through a video, and one that
a servo brings to a target.

Images are shown as they were taken, and curves are projected onto them with the lens' distortion, which the viewer's own
cameras do not have; their frusta are shown in space.

Axes: T frames, C cameras, n hypotheses of a set at a step, V vertices. ``up`` (3,) is the direction against gravity.
"""

import numpy as np
import rerun
import rerun.blueprint as blueprint

from doo_ti.perception.growth import GrowthStep
from doo_ti.perception.virtual_lab import SeenMoment
from doo_ti.record import viewer
from doo_ti.report.canvas import box, widest
from doo_ti.report.figures import BEST, DETECTED, RUNNER_UP, TRUTH, SeenRod
from doo_ti.vision.cameras import Camera, Rig
from doo_ti.vision.images import read_image

KEPT = (125, 170, 255)
FRUSTUM_MM = 60.0
MARGIN_PX = 40.0  # around the thread, in an image view when opened
JPEG_QUALITY = 80
FARTHEST_PX = 1e6  # points farther away are left out
TRACKED_COLORS = np.array([(47, 123, 255), (255, 159, 28), (255, 46, 77)], dtype=np.uint8)
"""Of rods that are tracked, found by Algorithm 1, and lost."""
TRACKED_WORDS = ("tracked", "found by Algorithm 1", "lost")


def record_perception(path, *, run_id: str, name: str, rig: Rig, rods: list[SeenRod], growth: list[list[GrowthStep]],
                      up=(0, 0, 1)) -> None:
    """Write the recording ``path``: the timeline ``edges`` is the number of edges of the hypotheses; one step after the last
    are the rods that remain, relaxed to the end.

    rods    sets of images with the rods that explain them
    growth  of each of them, from two edges on
    """
    places = [f"set{index}_{viewer.entity_name(seen.name)}" for index, seen in enumerate(rods)]
    with viewer.recording(path, run_id, name, _growth_layout(rig, places, rods, np.asarray(up, float))) as stream:
        for place, seen, steps in zip(places, rods, growth, strict=True):
            viewer.log_up(stream, f"world/{place}", up)
            _log_cameras(stream, place, rig, seen)
            _log_styles(stream, place, rig)
            for number, step in enumerate(steps, 2):
                stream.set_time("edges", sequence=number)
                stream.log(f"curves/{place}/energy_vis", rerun.AnyValues(per_mm=step.energy_vis, kept=step.kept))
                kept = np.flatnonzero(step.kept)  # the best, the others that are kept, and those that are pruned
                own = {"rods": kept[:1], "kept": kept[1:], "pruned": np.flatnonzero(~step.kept)}
                _log_curves(stream, place, rig, {name: list(step.vertices[some]) for name, some in own.items()})
            stream.set_time("edges", sequence=len(steps) + 2)
            _log_curves(stream, place, rig, {
                "rods": [seen.best], "runner_up": [] if seen.runner_up is None else [seen.runner_up], "kept": [], "pruned": []})
            stream.reset_time()


def _log_cameras(stream, place: str, rig: Rig, seen: SeenRod) -> None:
    """Everything that is the same in all steps: images and their detected points, frusta, the true rod."""
    for camera, image, detected in zip(rig.cameras, seen.images, seen.detected, strict=True):
        flat = f"images/{place}/{camera.name}"
        stream.log(flat, rerun.Image(image, color_model="L").compress(jpeg_quality=JPEG_QUALITY), static=True)
        stream.log(f"{flat}/detected", rerun.Points2D(
            _drawn(detected), colors=_rgb(DETECTED), radii=viewer.points(1.2), draw_order=5.0), static=True)
        _log_frustum(stream, f"world/{place}/cameras/{camera.name}", camera, FRUSTUM_MM)
        if seen.truth is not None:
            stream.log(f"{flat}/truth", rerun.LineStrips2D([_drawn(camera.project(seen.truth))], colors=_rgb(TRUTH),
                                                           radii=viewer.points(1.0), draw_order=8.0), static=True)
    if seen.truth is not None:
        stream.log(f"world/{place}/truth", rerun.LineStrips3D(
            viewer.drawn_strips(seen.truth[None]), colors=_rgb(TRUTH), radii=viewer.points(1.0)), static=True)
    words = rerun.TextDocument(f"**{seen.name}**: {seen.verdict}", media_type="text/markdown")
    stream.log(f"summary/{place}", words, static=True)


def _log_frustum(stream, entity: str, camera: Camera, size: float) -> None:
    """Pose and field of view of a camera, without its distortion, as a frustum of ``size`` mm."""
    stream.log(entity, rerun.Transform3D(translation=camera.centre, mat3x3=camera.rotation.T), rerun.Pinhole(
        image_from_camera=camera.matrix, width=camera.width, height=camera.height, image_plane_distance=size),
        static=True)


def _log_styles(stream, place: str, rig: Rig) -> None:
    """Colours and widths of all curves, once."""
    for root, strips in [(f"world/{place}", rerun.LineStrips3D)] + [
            (f"images/{place}/{camera.name}", rerun.LineStrips2D) for camera in rig.cameras]:
        for name, color, width in (("pruned", viewer.FAILED, 0.4), ("kept", KEPT, 0.7), ("runner_up", _rgb(RUNNER_UP), 1.6),
                                   ("rods", _rgb(BEST), 1.6)):
            order = {} if strips is rerun.LineStrips3D else {"draw_order": {"pruned": 6.0, "kept": 7.0}.get(name, 9.0)}
            stream.log(f"{root}/{name}", strips.from_fields(colors=[color], radii=viewer.points(width), **order), static=True)


def _log_curves(stream, place: str, rig: Rig, curves: dict[str, list[np.ndarray]]) -> None:
    """Curves (V, 3) by the name of their entity, in space and in every image."""
    for name, some in curves.items():
        stream.log(f"world/{place}/{name}", rerun.LineStrips3D.from_fields(
            strips=[strip for curve in some for strip in viewer.drawn_strips(curve[None])]))
        for camera in rig.cameras:
            stream.log(f"images/{place}/{camera.name}/{name}", rerun.LineStrips2D.from_fields(
                strips=[_drawn(camera.project(curve)) for curve in some]))


def _drawn(pixels: np.ndarray) -> np.ndarray:
    """(n, 2) px as the viewer counts them, with the corners of pixels at whole numbers; points far outside are left out."""
    return (pixels[(np.abs(pixels) < FARTHEST_PX).all(axis=1)] + 0.5).astype(np.float32)


def _rgb(color: str) -> tuple[int, int, int]:
    return tuple(int(color[at : at + 2], 16) for at in (1, 3, 5))


def _growth_layout(rig: Rig, places: list[str], rods: list[SeenRod], up: np.ndarray) -> blueprint.Blueprint:
    """A tab for each set: the rods in space, near and among the cameras, and the cameras' images."""
    tabs = []
    for place, seen in zip(places, rods, strict=True):
        middle, size = seen.best.mean(axis=0), widest(*box(seen.best))
        toward = np.mean([camera.centre for camera in rig.cameras], axis=0) - middle
        toward = toward / np.linalg.norm(toward) + 0.3 * up / np.linalg.norm(up)
        space = viewer.space_view("Hypotheses: best and kept blue, pruned red", f"world/{place}",
                                  (middle + 1.3 * size * toward, middle, up))
        cameras = viewer.space_view("Cameras", f"world/{place}")
        images = []
        for camera, detected in zip(rig.cameras, seen.detected, strict=True):
            low, high = box(detected)  # limits of the view when opened: those of the thread
            (left, top), (right, bottom) = low - MARGIN_PX, high + MARGIN_PX
            images.append(blueprint.Spatial2DView(
                name=camera.name, origin=f"images/{place}/{camera.name}", background=viewer.BACKGROUND,
                visual_bounds=blueprint.VisualBounds2D(x_range=[left, right], y_range=[top, bottom])))
        words = blueprint.TextDocumentView(name="Verdict", origin=f"summary/{place}")
        tabs.append(blueprint.Horizontal(
            blueprint.Vertical(space, words, row_shares=[6, 1]), blueprint.Grid(*images, cameras), column_shares=[1, 1.2],
            name=seen.name))
    body = tabs[0] if len(tabs) == 1 else blueprint.Tabs(*tabs)
    return blueprint.Blueprint(body, *viewer.panels("edges"))


def record_track(path, *, run_id: str, name: str, rig: Rig, paths, vertices: np.ndarray, error: np.ndarray, how: np.ndarray,
                 up=(0, 0, 1)) -> None:
    """Write the recording ``path`` of a video, on the timeline ``frame``.

    paths     T tuples of C images
    vertices  (T, V, 3) mm, NaN where the rod is lost
    error     (T, C) px to the detection, NaN where there is none
    how       (T,) :class:`doo_ti.perception.tracking.How`
    """
    layout = _video_layout(rig, "frame", "Rod: blue tracked, orange by Algorithm 1", "error", "Distance to the detection [px]",
                           "How the rod was found")
    with viewer.recording(path, run_id, name, layout) as stream:
        viewer.log_up(stream, "world", up)
        for camera in rig.cameras:
            _log_frustum(stream, f"world/cameras/{camera.name}", camera, 0.2 * float(np.linalg.norm(camera.centre)))
        for frame, (images, rod) in enumerate(zip(paths, vertices, strict=True)):
            stream.set_time("frame", sequence=frame)
            color, drawn = TRACKED_COLORS[how[frame]], rod[np.isfinite(rod).all(axis=1)]
            stream.log("world/rods", rerun.LineStrips3D([drawn], colors=color, radii=viewer.points(2.0)))
            if frame == 0 or how[frame] != how[frame - 1]:
                stream.log("log", rerun.TextLog(f"frame {frame}: {TRACKED_WORDS[how[frame]]}"))
            for camera, image, off in zip(rig.cameras, images, error[frame], strict=True):
                seen = rerun.Image(read_image(image, camera), color_model="L").compress(jpeg_quality=JPEG_QUALITY)
                stream.log(f"images/{camera.name}", seen)
                stream.log(f"images/{camera.name}/rods", rerun.LineStrips2D([_drawn(camera.project(drawn))], colors=color,
                                                                   radii=viewer.points(1.4)))
                stream.log(f"curves/error/{camera.name}", rerun.Scalars(off))


def _video_layout(rig: Rig, timeline: str, rods: str, curve: str, title: str, log: str) -> blueprint.Blueprint:
    """Rods among the cameras on the left, above a ``curve`` and the log; images on the right."""
    curves = blueprint.TimeSeriesView(name=title, origin=f"curves/{curve}")
    images = [blueprint.Spatial2DView(name=camera.name, origin=f"images/{camera.name}", background=viewer.BACKGROUND)
              for camera in rig.cameras]
    below = blueprint.Horizontal(curves, viewer.log_view(log, timeline))
    beside = blueprint.Vertical(viewer.space_view(rods, "world"), below, row_shares=[3, 1])
    views = blueprint.Grid(*images, grid_columns=1 if len(images) <= 3 else 2)
    return blueprint.Blueprint(blueprint.Horizontal(beside, views, column_shares=[2, 1]), *viewer.panels(timeline))


MODEL, TARGET = (198, 120, 221), (253, 231, 37)


def record_servo(path, *, run_id: str, name: str, rig: Rig, moments: list[SeenMoment], model: np.ndarray, target: np.ndarray,
                 distance: np.ndarray, words: list[str], up=(0, 0, 1)) -> None:
    """Write the recording ``path`` of a rod that a servo moves, on the timeline ``step``.

    moments   T of them, what cameras saw before each step
    model     (T, V, 3) mm, where the servo expected the rod then
    target    (V, 3) mm, NaN where nothing is asked
    distance  (T, 2) mm to the target after each step, true and as estimated
    words     T, the status after each step
    """
    asked = target[np.isfinite(target).all(axis=1)]
    layout = _video_layout(rig, "step", "Rods: blue tracked, purple the model, yellow the target", "distance",
                           "Distance to the target [mm]", "Statuses")
    with viewer.recording(path, run_id, name, layout) as stream:
        viewer.log_up(stream, "world", up)
        stream.log("world/target", rerun.LineStrips3D([asked], colors=TARGET, radii=viewer.points(1.2)), static=True)
        for camera in rig.cameras:
            _log_frustum(stream, f"world/cameras/{camera.name}", camera, FRUSTUM_MM)
        for step, (moment, own) in enumerate(zip(moments, model, strict=True)):
            stream.set_time("step", sequence=step)
            how, rod = moment.frame.how, moment.frame.vertices[np.isfinite(moment.frame.vertices).all(axis=1)]
            for entity, curve, color in (("rods", rod, TRACKED_COLORS[how]), ("truth", moment.rod, _rgb(TRUTH)),
                                         ("model", own, MODEL)):
                stream.log(f"world/{entity}", rerun.LineStrips3D([curve], colors=color, radii=viewer.points(1.6)))
            for camera, image in zip(rig.cameras, moment.images, strict=True):
                stream.log(f"images/{camera.name}", rerun.Image(image, color_model="L").compress(jpeg_quality=JPEG_QUALITY))
                for entity, curve, color in (("rods", rod, TRACKED_COLORS[how]), ("target", asked, TARGET)):
                    stream.log(f"images/{camera.name}/{entity}", rerun.LineStrips2D(
                        [_drawn(camera.project(curve))], colors=color, radii=viewer.points(1.2)))
            for kind, value in zip(("true", "estimated"), distance[step], strict=True):
                stream.log(f"curves/distance/{kind}", rerun.Scalars(value))
            if step == 0 or words[step] != words[step - 1]:
                stream.log("log", rerun.TextLog(f"step {step + 1}: {words[step]}"))
