"""Round tubes as a camera sees them: coverage of pixels exact across the tube, shaded, the nearer before the farther.

A tube is cut into straight segments, each of which meets the few pixels around its projection. What the segments of one
strand leave on a pixel counts once, by the nearest of them; strands over the same pixel are laid over each other by depth.
"""

from dataclasses import dataclass

import numpy as np

from doo_ti.vision.rig import Camera

ACROSS = 4
"""Places across the covered part of a pixel where shading is evaluated."""


@dataclass(frozen=True)
class Tube:
    """A round, opaque object along a curve; its ends are round.

    curve       (n, 3) mm, n ≥ 2, dense enough to be straight between points
    radius      mm
    brightness  grey levels away from the light, one number or (n,)
    """

    curve: np.ndarray
    radius: float
    brightness: np.ndarray | float


def draw(camera: Camera, tubes: list[Tube], background: np.ndarray, light: np.ndarray, shading: float) -> np.ndarray:
    """(H, W) float32 grey levels: ``tubes`` before ``background``.

    light    (3,) unit vector towards the light, in the world
    shading  grey levels that a surface is brighter where it faces the light; in between, by the cosine

    What is not in front of the camera is not seen.
    """
    image = np.array(background, dtype=np.float32)
    segments = _join([_segments(camera, tube, light) for tube in tubes])
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

    begin, along  px: where it begins and what it runs
    radius        (S, 2) px at its ends: half the distance between the projected sides
    depth         mm of its near side
    side, front   cosine of the light to the side that lies left of the run, and to the front
    brightness    grey levels
    """
    curve = np.asarray(tube.curve, dtype=np.float64)
    tangent = np.gradient(curve, axis=0)
    ray = curve - camera.centre
    side = _unit(np.cross(ray, tangent))
    front = _unit(np.cross(tangent, side))
    front *= -np.sign((front * ray).sum(axis=1, keepdims=True))
    centre, left = camera.project(curve), camera.project(curve + tube.radius * side)
    right = camera.project(curve - tube.radius * side)
    along = np.diff(centre, axis=0)
    across = (left - right)[:-1]
    # The image's y runs down: "left" is wherever the cross product below is positive, and the side follows suit.
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


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-300)


def _join(parts: list[dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """One table of all segments; between tubes the numbering leaves a gap, as between strands."""
    joined = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    joined["number"] = np.concatenate([np.arange(len(part["depth"])) + 2 * k for k, part in enumerate(parts)])
    joined["number"] += np.repeat(np.cumsum([0] + [len(part["depth"]) for part in parts[:-1]]), [len(p["depth"]) for p in parts])
    return joined


def _covered(segments: dict[str, np.ndarray], height: int, width: int) -> tuple[np.ndarray, ...]:
    """Every pair of a segment and a pixel it covers: segment, pixel, its distance, how far it lies sideways of the axis, the
    radius there, and the share of the pixel that is covered."""
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
    wide, high = np.abs(along[:, 1]) / np.sqrt(square), np.abs(along[:, 0]) / np.sqrt(square)
    cover = _below(distance + radius, wide[segment], high[segment]) - _below(distance - radius, wide[segment], high[segment])
    kept = cover > 1e-6
    sideways = (run_x * y - run_y * x) / np.sqrt(square)[segment]
    pixel = row * width + column
    return tuple(values[kept] for values in (segment, pixel, distance, sideways, radius, cover))


def _below(level: np.ndarray, wide: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Share of a unit square that lies below ``level`` along a direction with the components ``wide`` and ``high`` ≥ 0.

    Seen along it the square is a trapezium, the convolution of two boxes of these widths; this is its integral.
    """
    short, long = np.maximum(np.minimum(wide, high), 1e-4), np.maximum(wide, high)
    outer, inner = (long + short) / 2, (long - short) / 2
    parts = [np.maximum(level + shift, 0) ** 2 for shift in (outer, inner, -inner, -outer)]
    return (parts[0] - parts[1] - parts[2] + parts[3]) / (2 * short * long)


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
