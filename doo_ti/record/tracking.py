"""The recording of a video: its images with the rod's reprojections, and the rod in space, frame by frame.

Axes: T frames, C cameras, V vertices.
"""

import numpy as np
import rerun
import rerun.blueprint as blueprint

from doo_ti.record.stream import panels, recording
from doo_ti.record.wall import GROUND, log_up
from doo_ti.vision.cameras.rig import Rig
from doo_ti.vision.detection.images import read_image

COLORS = np.array([(47, 123, 255), (255, 159, 28), (255, 46, 77)], dtype=np.uint8)
"""Of rods that are tracked, that Algorithm 1 found, and, for the log, that are lost."""
WORDS = ("tracked", "found by Algorithm 1", "lost")
JPEG_QUALITY = 80
TIMELINE = "frame"


def record_track(path, *, run_id: str, name: str, rig: Rig, paths, vertices: np.ndarray, error: np.ndarray, how: np.ndarray,
                 up=(0, 0, 1)) -> None:
    """Write the recording ``path``, its layout inside, on the timeline ``frame``.

    paths     T tuples of C images
    vertices  (T, V, 3) mm, NaN where the rod is lost
    error     (T, C) px to the detection, NaN where there is none
    how       (T,) :class:`doo_ti.perception.tracking.How`
    up        direction against gravity
    """
    with recording(path, run_id, name, _layout(rig)) as stream:
        log_up(stream, "world", np.asarray(up, float))
        for camera in rig.cameras:
            stream.log(f"world/{camera.name}", rerun.Transform3D(translation=camera.centre, mat3x3=camera.rotation.T),
                       rerun.Pinhole(image_from_camera=camera.matrix, width=camera.width, height=camera.height,
                                     image_plane_distance=0.2 * float(np.linalg.norm(camera.centre))), static=True)
        for frame, (images, rod) in enumerate(zip(paths, vertices, strict=True)):
            stream.set_time(TIMELINE, sequence=frame)
            color, drawn = COLORS[how[frame]], rod[np.isfinite(rod).all(axis=1)]
            stream.log("world/rod", rerun.LineStrips3D([drawn], colors=color, radii=rerun.Radius.ui_points(2.0)))
            if frame == 0 or how[frame] != how[frame - 1]:
                stream.log("how", rerun.TextLog(f"frame {frame}: {WORDS[how[frame]]}"))
            for camera, image, off in zip(rig.cameras, images, error[frame], strict=True):
                seen = rerun.Image(read_image(image, camera), color_model="L").compress(jpeg_quality=JPEG_QUALITY)
                stream.log(camera.name, seen)
                # The viewer counts pixels from their corners.
                stream.log(f"{camera.name}/rod", rerun.LineStrips2D([(camera.project(drawn) + 0.5).astype(np.float32)],
                                                                   colors=color, radii=rerun.Radius.ui_points(1.4)))
                stream.log(f"error/{camera.name}", rerun.Scalars(off))


def _layout(rig: Rig) -> blueprint.Blueprint:
    """The rod among the cameras and its distance to the detection on the left, images on the right."""
    space = blueprint.Spatial3DView(name="Rod: blue tracked, orange by Algorithm 1", origin="world", line_grid=False,
                                    background=GROUND)
    error = blueprint.TimeSeriesView(name="Distance to the detection [px]", origin="error")
    images = [blueprint.Spatial2DView(name=camera.name, origin=camera.name, background=GROUND) for camera in rig.cameras]
    words = blueprint.TextLogView(name="How the rod was found", origin="how")
    beside = blueprint.Vertical(space, blueprint.Horizontal(error, words), row_shares=[3, 1])
    return blueprint.Blueprint(blueprint.Horizontal(beside, blueprint.Grid(*images)), *panels(TIMELINE))
