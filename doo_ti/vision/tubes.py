"""Round tubes as a camera sees them: shaded, the nearer in front, at their projections to a few thousandths of a pixel.

A tube is cut into straight segments, each of which covers the few pixels around its projection. Of the neighbouring segments
of one strand only the nearest counts at a pixel; strands over the same pixel are drawn one over the other, by depth.

Axes: S segments, n points of a curve, V vertices of a rod.
"""

from dataclasses import dataclass

import numpy as np

from doo_ti.rod.frames import arc_lengths, unit_vectors
from doo_ti.vision.cameras import Camera

DRAWN_BLUR_PX = 6**-0.5  # standard deviation of the hat function over which a pixel integrates
ACROSS = 4  # number of places across the covered part of a pixel where shading is evaluated


@dataclass(frozen=True)
class Tube:
    """A round, opaque object along a curve; its ends are round."""

    curve: np.ndarray  # (n, 3) mm, n ≥ 2, dense enough to be straight between points
    radius: float  # mm
    brightness: np.ndarray | float  # grey levels away from the light, one number or (n,)


def draw(camera: Camera, tubes: list[Tube], background: np.ndarray, light: np.ndarray, shading: float) -> np.ndarray:
    """(H, W) float32 grey levels: ``tubes`` before ``background``, blurred by a standard deviation of DRAWN_BLUR_PX.

    light    (3,) unit vector towards the light, in the world
    shading  grey levels: additional brightness of a surface that faces the light, times the cosine of its angle to the light

    Parts that are not in front of the camera are left out.
    """
    image = np.array(background, dtype=np.float32)
    if not tubes:
        return image
    parts = [_segments(camera, tube, light) for tube in tubes]
    segments = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    tube = np.repeat(np.arange(len(parts)), [len(part["depth"]) for part in parts])
    segments["number"] = np.arange(len(tube)) + 2 * tube  # between tubes it leaves a gap, as between strands
    strands = _strands(*_covered(segments, *image.shape), segments)
    pixel, cover, grey, depth = _shaded(*strands, segments, shading)
    order = np.lexsort((depth, pixel))
    pixel, cover, grey = pixel[order], cover[order], grey[order]
    first = np.flatnonzero(np.diff(pixel, prepend=-1))
    layer = np.arange(len(pixel)) - np.repeat(first, np.diff(first, append=len(pixel)))
    flat = image.reshape(-1)
    for above in range(int(layer.max(initial=-1)), -1, -1):
        here = layer == above
        flat[pixel[here]] += cover[here] * (grey[here] - flat[pixel[here]])
    return image


def _segments(camera: Camera, tube: Tube, light: np.ndarray) -> dict[str, np.ndarray]:
    """The segments of a tube in the image, arrays of one row or number for each.

    begin, along  px: its start, and the vector to its end
    radius        (S, 2) px at its ends: half the distance between the projected sides
    depth         mm of its near side
    side, front   cosine between the light and the side left of ``along``, and between the light and the front
    brightness    grey levels
    """
    curve = np.asarray(tube.curve, dtype=np.float64)
    tangent = np.gradient(curve, axis=0)
    ray = curve - camera.centre
    side = unit_vectors(np.cross(ray, tangent))
    front = unit_vectors(np.cross(tangent, side))
    front *= -np.sign((front * ray).sum(axis=1, keepdims=True))
    centre, left = camera.project(curve), camera.project(curve + tube.radius * side)
    right = camera.project(curve - tube.radius * side)
    along = np.diff(centre, axis=0)
    across = (left - right)[:-1]
    # The image's y points down: "left" is where the cross product below is positive.
    turned = np.sign(along[:, 0] * across[:, 1] - along[:, 1] * across[:, 0])
    size = np.linalg.norm(left - right, axis=1) / 2
    middle = np.broadcast_to(np.asarray(tube.brightness, dtype=np.float64), len(curve))
    found = {
        "begin": centre[:-1], "along": along, "radius": np.stack([size[:-1], size[1:]], axis=1),
        "depth": camera.depth(curve)[:-1] - tube.radius, "side": turned * (side @ light)[:-1], "front": (front @ light)[:-1],
        "brightness": (middle[:-1] + middle[1:]) / 2,
    }
    seen = np.isfinite(centre[:-1] + centre[1:] + (left + right)[:-1] + (left + right)[1:]).all(axis=1)
    return {name: value[seen] for name, value in found.items()}


def _covered(segments: dict[str, np.ndarray], height: int, width: int) -> tuple[np.ndarray, ...]:
    """Every pair of a segment and a pixel that it covers: segment, pixel, distance from the segment, signed distance from the
    axis, radius there, and the share of the pixel that is covered."""
    begin, along = segments["begin"], segments["along"]
    reach = segments["radius"].max(axis=1, initial=0)[:, None] + 1
    last = np.array([width, height]) - 1
    low = np.clip(np.floor(np.minimum(begin, begin + along) - reach), 0, last + 1).astype(np.int64)
    high = np.clip(np.ceil(np.maximum(begin, begin + along) + reach), -1, last).astype(np.int64)
    size = np.maximum(high - low + 1, 0)
    count = size.prod(axis=1)
    segment = np.repeat(np.arange(len(count)), count)
    local = np.arange(len(segment)) - np.repeat(np.cumsum(count) - count, count)
    row, column = np.divmod(local, size[segment, 0])
    row, column = row + low[segment, 1], column + low[segment, 0]
    x, y = column - begin[segment, 0], row - begin[segment, 1]
    run_x, run_y = along[segment, 0], along[segment, 1]
    square = np.maximum((along * along).sum(axis=1), 1e-12)
    place = np.clip((x * run_x + y * run_y) / square[segment], 0, 1)
    distance = np.hypot(x - place * run_x, y - place * run_y)
    radius = (1 - place) * segments["radius"][segment, 0] + place * segments["radius"][segment, 1]
    cover = _below(distance + radius) - _below(distance - radius)
    kept = cover > 1e-6
    sideways = (run_x * y - run_y * x) / np.sqrt(square)[segment]
    pixel = row * width + column
    return tuple(values[kept] for values in (segment, pixel, distance, sideways, radius, cover))


def _below(level: np.ndarray) -> np.ndarray:
    """Share of a pixel below ``level`` px from its middle: the integral of a hat function, 1 at the middle and 0 a pixel away.

    With a hat, sampled at whole pixels, drawn lines keep their place. With the pixel's square, lines along the pixel grid would
    be shifted by up to a tenth of a pixel.
    """
    inside = np.clip(level, -1, 1)
    return 0.5 + inside - 0.5 * inside * np.abs(inside)


def _strands(segment, pixel, distance, sideways, radius, cover, segments: dict[str, np.ndarray]) -> tuple[np.ndarray, ...]:
    """Of each run of neighbouring segments over a pixel, the one whose axis is nearest: what :func:`_shaded` takes."""
    number = segments["number"][segment]
    order = np.lexsort((number, pixel))
    apart = (np.diff(pixel[order], prepend=-1) != 0) | (np.diff(number[order], prepend=-2) > 1)
    strand = np.empty(len(order), dtype=np.int64)
    strand[order] = np.cumsum(apart)
    best = np.lexsort((distance, strand))
    best = best[np.diff(strand[best], prepend=0) != 0]
    return tuple(values[best] for values in (segment, pixel, sideways, radius, cover))


def _shaded(segment, pixel, sideways, radius, cover, segments: dict[str, np.ndarray], shading: float) -> tuple[np.ndarray, ...]:
    """Pixel, cover, mean grey level of the covered part and depth of each strand over a pixel."""
    low, high = np.maximum(-radius, sideways - 0.5), np.minimum(radius, sideways + 0.5)
    middle = (np.arange(ACROSS) + 0.5)[:, None] / ACROSS
    across = np.clip((low + middle * (high - low)) / np.maximum(radius, 1e-12), -1, 1)
    facing = across * segments["side"][segment] + np.sqrt(1 - across**2) * segments["front"][segment]
    grey = segments["brightness"][segment] + shading * np.maximum(facing, 0).mean(axis=0)
    return pixel, cover.astype(np.float32), grey.astype(np.float32), segments["depth"][segment]


# --- the curve through a rod's vertices -----------------------------------------------------------------------------------

def smooth_curve(vertices: np.ndarray, samples: int) -> np.ndarray:
    """(..., (V − 1) samples + 1, 3) mm: points of the curve through (..., V, 3) vertices, ``samples`` to an edge.

    The curve passes through every vertex; its parameter is chord length. The first two and the last two edges are one cubic
    each ("not a knot"), so that clamped ends keep their curvature; with fewer than four vertices the ends have no curvature.
    """
    from scipy.interpolate import CubicSpline

    vertices = np.asarray(vertices, dtype=np.float64)
    *rods, count, _ = vertices.shape
    ends, place = "not-a-knot" if count > 3 else "natural", np.arange((count - 1) * samples + 1) / samples
    curves = []
    for rod in vertices.reshape(-1, count, 3):
        along = arc_lengths(rod)
        curves.append(CubicSpline(along, rod, bc_type=ends)(np.interp(place, np.arange(count), along)))
    return np.reshape(curves, (*rods, len(place), 3))
