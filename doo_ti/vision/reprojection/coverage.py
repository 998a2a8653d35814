"""How much of the detected line a rod explains, in each image: evidence from the image to the rod (§IV-A).

    E_cover = Σ_q min(|q − image of the rod|, cap) · 1 px        over the detected points q, one per pixel of line

It is the counterpart of E_proj, which sums distances from the rod's image to the detection: a rod that leaves thread
unexplained costs as much there as a rod of that image length without detection costs in E_proj.

Axes: A image sets, C cameras, R rods, V vertices.
"""

from dataclasses import dataclass

import numpy as np
import taichi as ti

from doo_ti.system import runtime
from doo_ti.vision.cameras.rig import Rig
from doo_ti.vision.detection.line import Detection, thinned
from doo_ti.vision.reprojection.triangulation import rays

NEAR_PX = 3.0
"""A detected point this near to the rod's image is explained."""


@dataclass(frozen=True)
class Coverage:
    """Of R rods.

    share  (R, C) of the detected points within NEAR_PX of the rod's image
    error  (R, C) E_cover, px²
    line   (R, C) px of detected line
    """

    share: np.ndarray
    error: np.ndarray
    line: np.ndarray


@runtime.exclusive
def coverage(rig: Rig, vertices: np.ndarray, of_set: np.ndarray, detections: list[list[Detection]], cap: float) -> Coverage:
    """Of rods with ``vertices`` (R, V, 3) mm, each of the set ``of_set`` (R,) of ``detections`` (A lists of C). Distances
    saturate at ``cap`` px. What a camera does not see explains nothing."""
    flat = [thinned(found)[0] for images in detections for found in images]
    first = np.cumsum([0, *(len(points) for points in flat)]).astype(np.int32)
    image = np.ascontiguousarray(np.nan_to_num(np.moveaxis(rig.project(vertices), 0, 1), nan=1e9), dtype=np.float32)
    result = np.zeros((*image.shape[:2], 2), dtype=np.float32)
    runtime.start()
    _explained(np.concatenate([*flat, np.zeros((1, 2))]).astype(np.float32), first, of_set.astype(np.int32), image, cap, result)
    lengths = np.diff(first).reshape(len(detections), -1)[of_set]
    return Coverage(result[..., 0] / np.maximum(lengths, 1), result[..., 1].astype(np.float64), lengths.astype(np.float64))


def outside_others(rig: Rig, vertices: np.ndarray, detections: list[list[Detection]]) -> np.ndarray:
    """(A, C) share of the line detected in each camera that one rod of each set, ``vertices`` (A, V, 3) mm, leaves unexplained
    because no other camera's image shows it: at the depth of the nearest vertex it is outside all of these."""
    found = np.zeros((len(vertices), len(rig.cameras)))
    for row, rod in enumerate(vertices):
        if not np.isfinite(rod).all():
            continue
        for c, camera in enumerate(rig.cameras):
            points = thinned(detections[row][c])[0]
            apart = np.linalg.norm(points[:, None] - np.nan_to_num(camera.project(rod), nan=1e9), axis=-1)
            ray = rays(camera, points)
            there = camera.centre + ray * (camera.depth(rod)[apart.argmin(axis=1)] / (ray @ camera.rotation[2]))[:, None]
            alone = apart.min(axis=1) > NEAR_PX
            for other in rig.cameras[:c] + rig.cameras[c + 1 :]:
                middle = 0.5 * np.array([other.width - 1, other.height - 1])
                alone &= ~((np.abs(other.project(there) - middle) <= middle + 0.5).all(axis=1))
            found[row, c] = alone.mean() if len(rig.cameras) > 1 else 0.0
    return found


@runtime.kernel
def _explained(
    points: ti.types.ndarray(dtype=ti.f32, ndim=2),  # [point, x y], image by image
    first: ti.types.ndarray(dtype=ti.i32, ndim=1),  # [image + 1]
    of_set: ti.types.ndarray(dtype=ti.i32, ndim=1),  # [rod]
    image: ti.types.ndarray(dtype=ti.f32, ndim=4),  # [rod, camera, vertex, x y]
    cap: ti.f32,
    result: ti.types.ndarray(dtype=ti.f32, ndim=3),  # [rod, camera, (points explained, E_cover)] out
):
    cameras = image.shape[1]
    for pair in range(image.shape[0] * cameras):
        rod, c = pair // cameras, pair % cameras
        near, error = 0.0, 0.0
        for k in range(first[of_set[rod] * cameras + c], first[of_set[rod] * cameras + c + 1]):
            x, y, least = points[k, 0], points[k, 1], cap * cap
            for v in range(image.shape[2] - 1):
                ax, ay = image[rod, c, v, 0], image[rod, c, v, 1]
                dx, dy = image[rod, c, v + 1, 0] - ax, image[rod, c, v + 1, 1] - ay
                along = ti.min(ti.max(((x - ax) * dx + (y - ay) * dy) / ti.max(dx * dx + dy * dy, 1e-12), 0.0), 1.0)
                ox, oy = x - ax - along * dx, y - ay - along * dy
                least = ti.min(least, ox * ox + oy * oy)
            distance = ti.sqrt(least)
            near += ti.select(distance <= NEAR_PX, 1.0, 0.0)
            error += distance
        result[rod, c, 0], result[rod, c, 1] = near, error
