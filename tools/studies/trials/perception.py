"""Accuracy of rods recovered from images of known rods (§V-E), also with fewer cameras and with gaps filled.

Axes: A sets, C cameras, V vertices, n points of a curve.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from doo_ti.perception.perceive import Perception
from doo_ti.perception.search import Hypotheses, PerceptionOptions, Search
from doo_ti.rod.frames import bishop_frames, quaternion_from_matrix
from doo_ti.vision.cameras.rig import Rig
from doo_ti.vision.detection.detect import detect
from doo_ti.vision.detection.line import Detection
from doo_ti.vision.detection.options import DetectionOptions
from doo_ti.vision.rendering.render import Photographs
from doo_ti.vision.reprojection.distance_map import DistanceMaps
from doo_ti.vision.reprojection.image_energy import coverage

CORRECT_MM = 1.0
"""A rod with a smaller mean error of its vertices counts as recovered correctly."""

UNSEEN_PX = 2.0
"""The thread is not detected where the next detected point is further away: an error of the line itself is far less."""


@dataclass(frozen=True)
class Trial:
    """Results of A sets.

    vertex_error  (A,) mm: mean distance of the vertices to the true ones
    curve_error   (A,) mm: the same to the true curve, whatever the place along it
    energy_vis    (A,) 1/mm: E_vis of what was found
    truth_energy  (A,) 1/mm: E_vis of the rod relaxed from the true one
    status        (A,) Status of what was found
    """

    vertex_error: np.ndarray
    curve_error: np.ndarray
    energy_vis: np.ndarray
    truth_energy: np.ndarray
    status: np.ndarray

    @property
    def correct(self) -> np.ndarray:
        """(A,) bool."""
        return self.vertex_error < CORRECT_MM

    @property
    def overlooked(self) -> np.ndarray:
        """(A,) bool: not correct although the true rod has a smaller E_vis: the search pruned it."""
        return ~self.correct & (self.truth_energy < self.energy_vis)


def judged(perception: Perception, vertices: np.ndarray, curve: np.ndarray, truth_energy: np.ndarray) -> Trial:
    """What was found beside the true vertices (A, V, 3) and the true, dense curve (A, n, 3)."""
    off = np.linalg.norm(perception.vertices - vertices, axis=-1).mean(axis=1)
    return Trial(off, distance_to_curve(perception.vertices, curve).mean(axis=1), perception.energy_vis, truth_energy,
                 perception.status)


def distance_to_curve(points: np.ndarray, curve: np.ndarray) -> np.ndarray:
    """(A, V) mm from points (A, V, 3) to the polygons (A, n, 3), by way of their vertices: they are dense."""
    square = (points**2).sum(axis=-1)[..., None] + (curve**2).sum(axis=-1)[:, None] - 2 * points @ np.swapaxes(curve, 1, 2)
    nearest = square.argmin(axis=2)
    row = np.arange(len(points))[:, None]
    middle = curve[row, nearest]
    distances = []
    for neighbour in (curve[row, np.maximum(nearest - 1, 0)], curve[row, np.minimum(nearest + 1, curve.shape[1] - 1)]):
        along = neighbour - middle
        share = ((points - middle) * along).sum(axis=-1) / np.maximum((along**2).sum(axis=-1), 1e-300)
        distances.append(np.linalg.norm(points - middle - np.clip(share, 0, 1)[..., None] * along, axis=-1))
    return np.minimum(*distances)


def truth_energy(search: Search, vertices: np.ndarray) -> np.ndarray:
    """(A,) 1/mm: E_vis of the rod relaxed from the true edges (A, V, 3), clamped as in the search."""
    tangents = np.diff(vertices, axis=1)
    tangents /= np.linalg.norm(tangents, axis=-1, keepdims=True)
    frames = quaternion_from_matrix(bishop_frames(tangents, search.first[:, 1]))
    rods, solution = search.relaxed(Hypotheses(np.arange(len(frames)), frames, np.zeros(len(frames))))
    detections = search.maps.detections
    if detections is None or search.options.evidence == "rod":
        return rods.energy_vis
    cover = coverage(search.rig, solution.configuration.vertices, rods.of_set, detections, search.options.cap)
    return rods.energy_vis + search.options.nu * cover.error.sum(axis=1)


def with_energy(options: PerceptionOptions, share: float) -> PerceptionOptions:
    """The same search with the rod's energy multiplied by ``share``, which must not be zero: ν is divided by it."""
    return replace(options, nu=options.nu / share, growing_nu=options.growing_nu / share)


def detected(images: list[list[np.ndarray]], options: DetectionOptions = DetectionOptions(),
             threads: int = 2) -> list[list[Detection]]:
    """Detections in A lists of C images."""
    with ThreadPoolExecutor(threads) as executor:
        return list(executor.map(lambda views: [detect(image, options) for image in views], images))


def taken(photographs: Photographs, threads: int = 2) -> list[list[np.ndarray]]:
    """All images, by set and camera, held in memory."""
    with ThreadPoolExecutor(threads) as executor:
        return list(executor.map(photographs.images, range(len(photographs.names))))


def usual_width(detections: list[list[Detection]]) -> float:
    """px: the median width over all images of one thread, so that views where strands touch do not mislead."""
    return float(np.nanmedian([found.width_px for views in detections for found in views]))


def without_camera(maps: DistanceMaps, rig: Rig, camera: int) -> tuple[DistanceMaps, Rig]:
    """The maps and the rig without one of the C cameras."""
    kept = [index for index in range(len(rig.cameras)) if index != camera]
    return maps.take(slice(None), kept), Rig(tuple(rig.cameras[index] for index in kept), rig.source)


def sets_of(maps: DistanceMaps, rows) -> DistanceMaps:
    """The maps of some of the sets."""
    return maps.take(rows)


def unseen(maps: DistanceMaps, pixels: np.ndarray) -> np.ndarray:
    """(A, C, n) bool: where the projected truth (C, A, n, 2) has no detected point near."""
    offset, left, top, width, height = (maps.window[..., index, None] for index in range(5))
    column, line = np.moveaxis(np.rint(np.swapaxes(pixels, 0, 1)).astype(np.int64), -1, 0)
    column, line = np.clip(column - left, 0, width - 1), np.clip(line - top, 0, height - 1)
    return maps.values[offset + line * width + column] > UNSEEN_PX


def filled(detections: list[list[Detection]], maps: DistanceMaps, pixels: np.ndarray) -> list[list[Detection]]:
    """Detections with the projected truth (C, A, n, 2) put in where nothing was seen, as in §V-E."""
    missing = unseen(maps, pixels)
    run = np.gradient(pixels, axis=2)
    run /= np.linalg.norm(run, axis=-1, keepdims=True)
    return [[_with_points(found, pixels[camera, index][missing[index, camera]], run[camera, index][missing[index, camera]])
             for camera, found in enumerate(views)] for index, views in enumerate(detections)]


def _with_points(found: Detection, points: np.ndarray, direction: np.ndarray) -> Detection:
    return replace(found, points=np.concatenate([found.points, points]),
                   direction=np.concatenate([found.direction, direction]),
                   strength=np.concatenate([found.strength, np.full(len(points), np.median(found.strength))]))


def crossings(pixels: np.ndarray) -> np.ndarray:
    """(...) how often polygons (..., n, 2) in an image cross themselves."""
    begin, along = pixels[..., :-1, :], np.diff(pixels, axis=-2)
    between = begin[..., None, :, :] - begin[..., :, None, :]
    first, second = along[..., :, None, :], along[..., None, :, :]
    area = _cross(first, second)
    with np.errstate(divide="ignore", invalid="ignore"):
        place, other = _cross(between, second) / area, _cross(between, first) / area
    apart = np.subtract.outer(np.arange(along.shape[-2]), np.arange(along.shape[-2])) < -1
    hit = (place >= 0) & (place < 1) & (other >= 0) & (other < 1) & apart
    return hit.sum(axis=(-1, -2))


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
