"""Distances between detected lines and rods (§IV-A): maps of the distance of every pixel from the line, for sets of images,

    D(p) = min over pieces n of |p − q_n(p)|,    q_n(p) the point of piece n nearest to p

A piece is half a pixel of straight line either way of a detected point, along its direction, so that D has a continuous valley
along the line. Each pixel takes its nearest piece from its neighbours (Danielsson, 1980): the search passes over a window's
lines down and up, and along each line both ways.

And how much of the detected line a rod explains, in each image: evidence from the image to the rod,

    E_cover = Σ_q min(|q − image of the rod|, cap) · 1 px        over the detected points q, one per pixel of line

It is the counterpart of E_proj, which sums distances from the rod's image to the detection: a rod that leaves thread
unexplained costs as much there as a rod of that image length without detection costs in E_proj.

Axes: A image sets, C cameras, R rods, V vertices.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import taichi as ti
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from doo_ti.rod.frames import arc_lengths, placed
from doo_ti.system import runtime
from doo_ti.system.arguments import short_repr, typed
from doo_ti.system.errors import InputError
from doo_ti.vision.cameras import Rig
from doo_ti.vision.detection import NEAR_PX, Detection, thinned
from doo_ti.vision.triangulation import rays

HALF_LENGTH_PX = 0.5  # half the length of a piece, and half the largest spacing of points along the line
SMALLEST_MARGIN_PX = 2  # with this a window is at least three pixels wide, the least that sampling needs
AROUND = 3  # px: pieces of pixels this near to a pixel's piece are compared too, since neighbours may miss the nearest one
COMPARED_PX = 25.0  # distance up to which they are compared; beyond, distances near a circle's centre are up to 0.07 px off
PIXELS_AT_ONCE = 1 << 24  # approximate number of pixels that are searched at a time, which bounds the memory


@typed
@dataclass(frozen=True)
class DistanceMaps:
    """Distances in px around the detected lines, for A sets of C images, one window each.

    values  (N,) float32: all windows one after the other, each line by line
    window  (A, C, 5) int64: index in ``values`` where a window starts, and its left, top, width and height in px
    detections  A lists of the C detections that the maps are of; None where these are not known
    """

    __repr__ = short_repr

    values: Annotated[np.ndarray, "N"]
    window: Annotated[np.ndarray, "A C 5"]
    detections: Sequence[Sequence[Detection]] | None = None

    def take(self, sets: np.ndarray | slice, cameras: Sequence[int] | slice = slice(None)) -> "DistanceMaps":
        """The maps of some of the sets, and of some of the cameras."""
        rows, columns = (np.arange(size)[chosen] for size, chosen in zip(self.window.shape[:2], (sets, cameras), strict=True))
        some = None if self.detections is None else [[self.detections[row][c] for c in columns] for row in rows]
        return DistanceMaps(self.values, self.window[rows][:, columns], some)


@typed
@runtime.exclusive
def distance_maps(detections: list[list[Detection]], margin_px: int = 50) -> DistanceMaps:
    """The maps of A sets of C detections: each of the box around a detection and ``margin_px`` more, within the image.

    Raises InputError for sets of different numbers of images, none at all, an image where no thread was found, and a margin
    below 2.
    """
    sets = {len(images) for images in detections}
    if len(sets) != 1 or 0 in sets:
        raise InputError("distance maps", "detections", f"{len(detections)} sets of {sorted(sets)} images",
                         "give one detection of each camera in every set")
    if margin_px < SMALLEST_MARGIN_PX:
        raise InputError("distance maps", "margin_px", f"{margin_px}", f"give at least {SMALLEST_MARGIN_PX}")
    for index, images in enumerate(detections):
        for camera, found in enumerate(images):
            if not found.count:
                raise InputError("distance maps", f"set {index}, image {camera}", "no thread was found in it",
                                 "leave the set out, or look for the thread with other options")
    flat = [found for images in detections for found in images]
    window = np.array([_window(found, int(margin_px)) for found in flat])
    size = window[:, 2] * window[:, 3]
    window = np.concatenate([(np.cumsum(size) - size)[:, None], window], axis=1)
    values = np.empty(size.sum(), dtype=np.float32)
    runtime.start()
    for part in np.split(np.arange(len(flat)), np.flatnonzero(np.diff(window[:, 0] // PIXELS_AT_ONCE)) + 1):
        _fill_part([flat[index] for index in part], window[part], values)
    own = [[found.copy() for found in images] for images in detections]
    return DistanceMaps(values, window.reshape(len(detections), -1, 5), own)


def _window(found: Detection, margin: int) -> tuple[int, int, int, int]:
    """Left, top, width and height of the box around a detection and ``margin``, within the image."""
    last = np.array(found.shape[::-1]) - 1
    low = np.clip(np.floor(found.points.min(axis=0)).astype(np.int64), 0, last) - margin
    high = np.clip(np.ceil(found.points.max(axis=0)).astype(np.int64), 0, last) + margin
    low, high = np.maximum(low, 0), np.minimum(high, last)
    return (*low, *(high - low + 1))


def _fill_part(found: list[Detection], window: np.ndarray, values: np.ndarray) -> None:
    """Compute the maps of some of the windows, which follow each other in ``values``."""
    begin, end = window[0, 0], window[-1, 0] + window[-1, 3] * window[-1, 4]
    pieces = np.concatenate([np.concatenate([image.points, image.direction], axis=1) for image in found])
    first = np.cumsum([0] + [image.count for image in found])
    local = window - [begin, 0, 0, 0, 0]
    nearest = np.empty(end - begin, dtype=np.int32)
    _search(pieces.astype(np.float32), first.astype(np.int32), local.astype(np.int32), nearest, values[begin:end])


@ti.func
def _distance(pieces: ti.template(), n, x, y):
    """px from the pixel (x, y) to piece n."""
    right, down = ti.cast(x, ti.f32) - pieces[n, 0], ti.cast(y, ti.f32) - pieces[n, 1]
    along = right * pieces[n, 2] + down * pieces[n, 3]
    along = ti.min(ti.max(along, -HALF_LENGTH_PX), HALF_LENGTH_PX)
    right, down = right - along * pieces[n, 2], down - along * pieces[n, 3]
    return ti.sqrt(right * right + down * down)


@ti.func
def _compare(pieces: ti.template(), nearest: ti.template(), values: ti.template(), here, neighbour, x, y):
    """Give pixel ``here`` at (x, y) its neighbour's piece where that is nearer than its own."""
    n = nearest[neighbour]
    if n >= 0 and n != nearest[here]:
        found = _distance(pieces, n, x, y)
        if found < values[here]:
            values[here], nearest[here] = found, n


@ti.func
def _pass_line(pieces: ti.template(), nearest: ti.template(), values: ti.template(), start, left, top, width, j, before):
    """Bring a window's line j up to date from line ``before``, then from left to right and back."""
    for i in range(width):
        here, above = start + j * width + i, start + before * width + i
        if before != j:
            for k in range(ti.max(i - 1, 0), ti.min(i + 2, width)):
                _compare(pieces, nearest, values, here, above + k - i, left + i, top + j)
        if i > 0:
            _compare(pieces, nearest, values, here, here - 1, left + i, top + j)
    for back in range(1, width):
        i = width - 1 - back
        here = start + j * width + i
        _compare(pieces, nearest, values, here, here + 1, left + i, top + j)


@ti.func
def _look_around(pieces: ti.template(), nearest: ti.template(), values: ti.template(), start, left, top, width, height, i, j):
    """Compare the pieces around the one nearest to pixel (i, j): where pieces are dense, neighbours do not hold all of them."""
    here = start + j * width + i
    n = nearest[here]
    column, line = ti.cast(ti.round(pieces[n, 0]), ti.i32) - left, ti.cast(ti.round(pieces[n, 1]), ti.i32) - top
    for b in range(ti.max(line - AROUND, 0), ti.min(line + AROUND + 1, height)):
        for a in range(ti.max(column - AROUND, 0), ti.min(column + AROUND + 1, width)):
            _compare(pieces, nearest, values, here, start + b * width + a, left + i, top + j)


@runtime.kernel
def _search(
    pieces: ti.types.ndarray(dtype=ti.f32, ndim=2),  # [point, x y and direction]
    first: ti.types.ndarray(dtype=ti.i32, ndim=1),  # [window + 1]
    windows: ti.types.ndarray(dtype=ti.i32, ndim=2),  # [window, start left top width height]
    nearest: ti.types.ndarray(dtype=ti.i32, ndim=1),  # [pixel] scratch
    values: ti.types.ndarray(dtype=ti.f32, ndim=1),  # [pixel] out
):
    ti.loop_config(block_dim=1)
    for w in range(windows.shape[0]):
        start, left, top, width, height = windows[w, 0], windows[w, 1], windows[w, 2], windows[w, 3], windows[w, 4]
        for here in range(start, start + width * height):
            nearest[here], values[here] = -1, 1e30
        for n in range(first[w], first[w + 1]):
            column = ti.cast(ti.round(pieces[n, 0]), ti.i32) - left
            line = ti.cast(ti.round(pieces[n, 1]), ti.i32) - top
            for j in range(ti.max(line - 2, 0), ti.min(line + 3, height)):
                for i in range(ti.max(column - 2, 0), ti.min(column + 3, width)):
                    found = _distance(pieces, n, left + i, top + j)
                    if found < values[start + j * width + i]:
                        values[start + j * width + i], nearest[start + j * width + i] = found, n
        for j in range(height):
            _pass_line(pieces, nearest, values, start, left, top, width, j, ti.max(j - 1, 0))
        for back in range(height):
            j = height - 1 - back
            _pass_line(pieces, nearest, values, start, left, top, width, j, ti.min(j + 1, height - 1))
        for j in range(height):
            for i in range(width):
                if values[start + j * width + i] < COMPARED_PX:
                    _look_around(pieces, nearest, values, start, left, top, width, height, i, j)


# --- how much of the line a rod explains -----------------------------------------------------------------------------------

BESIDE_PX = 2.0  # distance of points that follow each other along a line
ALIKE = 0.8  # least cosine between directions of a line: other strands cross it
WIDER = 1.75  # times its width a thread is not: what it is tied to, or held by, may be
THICKER = 1.1  # times its width, and a pixel, along a piece of line is what a thread is not that has one thickness
SAME_PX, FAR_PX, MOST_IMAGE_PX = 1.5, 12, 1e5
"""A rod's image passes along itself where parts are so near to each other, and so far along it; and the longest image that is
looked at: rods behind a camera have no end."""
ERRORS = ("outside", "skipped", "twice", "wider")  # of :func:`misread`


@dataclass(frozen=True)
class Coverage:
    """Of R rods."""

    share: np.ndarray  # (R, C) of the detected points within NEAR_PX of the rod's image
    error: np.ndarray  # (R, C) E_cover, px²
    line: np.ndarray  # (R, C) px of detected line


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


def of_thread(found: Detection) -> Detection:
    """What was ``found`` without lines that are far wider than the thread."""
    return found.take(found.widths <= WIDER * found.width_px)


def misread(rig: Rig, vertices: np.ndarray, detections: list[list[Detection]]) -> dict[str, np.ndarray]:
    """Where the rods ``vertices`` (A, V, 3) mm, one of each set, and the line detected in each camera do not belong together,
    (A, C) by name.

    outside  share of the line that no other camera's image shows, at the depth of the nearest vertex
    skipped  longest piece of the rest of the line that the rod leaves out between its ends, in widths of the thread
    twice    length of the rod's image that passes along another part of it, in widths of the thread
    wider    longest piece of the line along the rod that is wider than the thread is at its depth, in widths of the thread
    left     px of the line that are :func:`left_out`
    """
    found = {name: np.zeros((len(vertices), len(rig.cameras))) for name in (*ERRORS, "left")}
    outside, skipped, twice, wider, left = found.values()
    for row, rod in enumerate(vertices):
        if not np.isfinite(rod).all():
            continue
        for c, camera in enumerate(rig.cameras):
            detection, image = detections[row][c], np.nan_to_num(camera.project(rod), nan=1e9)
            points = thinned(detection)[0]
            place, far = nearest_place(points, image)
            between = (place > 0) & (place < len(rod) - 1)  # beyond its ends the rod leaves out nothing
            ray = rays(camera, points)
            there = camera.centre + ray * (camera.depth(rod)[place.astype(int)] / (ray @ camera.rotation[2]))[:, None]
            alone = np.full(len(points), len(rig.cameras) > 1)
            for other in rig.cameras[:c] + rig.cameras[c + 1 :]:
                middle = 0.5 * np.array([other.width - 1, other.height - 1])
                alone &= ~((np.abs(other.project(there) - middle) <= middle + 0.5).all(axis=1))
            outside[row, c] = (far & alone).mean()
            skipped[row, c] = _longest_piece(points[far & ~alone & between]) / detection.width_px
            left[row, c] = left_out(points, far & ~alone).sum()
            twice[row, c] = beside_itself(image, SAME_PX, FAR_PX).sum() / 2 / detection.width_px
            place, far = nearest_place(detection.points, image)
            depth = camera.depth(rod)[place.astype(int)]
            diameter = np.median((detection.widths * depth)[~far]) if not far.all() else np.inf  # in px at unit depth
            wide = ~far & (detection.widths > 1 + THICKER * diameter / depth)
            wider[row, c] = _longest_piece(np.unique(np.rint(detection.points[wide]), axis=0)) / detection.width_px
    return found


def nearest_place(points: np.ndarray, image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(P,) the place of a rod's ``image`` (V, 2) nearest to each point, in edges from its start, and whether it is farther than
    NEAR_PX."""
    (right, down), (x, y) = np.diff(image, axis=0).T, (points.T[:, :, None] - image[:-1].T[:, None])
    along = np.clip((x * right + y * down) / np.maximum(right**2 + down**2, 1e-12), 0.0, 1.0)
    apart = (x - along * right) ** 2 + (y - along * down) ** 2
    edge, every = apart.argmin(axis=1), np.arange(len(points))
    return edge + along[every, edge], apart[every, edge] > NEAR_PX**2


def beside_itself(image: np.ndarray, near: float, apart: float) -> np.ndarray:
    """(L,) bool at each px along a rod's ``image`` (V, 2): another part of it, more than ``apart`` px away along the rod, runs
    along it within ``near`` px. (1,) False where the image is shorter than that, or too long."""
    arc = arc_lengths(image)
    if not apart <= arc[-1] <= MOST_IMAGE_PX:
        return np.zeros(1, dtype=bool)
    points = placed(np.arange(arc[-1]), arc, image)
    one, other = cKDTree(points).query_pairs(near, output_type="ndarray").T
    way = np.gradient(points, axis=0)
    alike = np.abs((way[one] * way[other]).sum(axis=1)) > ALIKE * np.linalg.norm(way[one], axis=1) * np.linalg.norm(
        way[other], axis=1)
    twice = alike & (np.abs(other - one) > apart)
    beside = np.zeros(len(points), dtype=bool)
    beside[one[twice]] = beside[other[twice]] = True
    return beside


def _longest_piece(points: np.ndarray) -> int:
    """The largest number of points, about one for each pixel of line, that follow each other."""
    return int(np.bincount(_pieces(points)).max()) if len(points) else 0


def _pieces(points: np.ndarray) -> np.ndarray:
    """(P,) for each of the points (P, 2) the number of the piece that follow each other."""
    pairs = cKDTree(points).query_pairs(BESIDE_PX, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs)), pairs.T), shape=(len(points), len(points)))
    return connected_components(graph, directed=False)[1]


def left_out(points: np.ndarray, far: np.ndarray) -> np.ndarray:
    """(P,) bool: those of the points (P, 2) of a line that are ``far`` (P,) from a rod's image, but on pieces of line that it
    is on elsewhere: other pieces may be of something else."""
    if not far.any() or far.all():
        return np.zeros(len(points), dtype=bool)
    piece = _pieces(points)
    return far & np.isin(piece, piece[~far])


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
