"""How the thread looks in an image: dark or light, how wide, how distinct, and roughly where; and across a line: its middle,
its width and its colours.

It is found on a pyramid of ever coarser images: a line stands out as a ridge at the level that fits its width.

The colour at an offset s from the line is compared with that farther off on either side: where the median difference is large
against the scatter along the thread, s is within. Beside a thread its shadow differs from the background, too; but there the
colour is a multiple of the background's, while a thread has a colour of its own or is much darker.

Likeness to the thread's colours is exp(−(d/τ)²) of the distance d in CIE Lab to the nearest of them, 255 where equal. A thread
becomes a light line on dark, whatever its background.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from doo_ti.vision.ridge import POINTS_PER_PX, REACH_PX, Curvature, Edges, Ridges, edges_across, gradient, pieces

LEVELS = 5  # levels of the pyramid above the image itself: halves to 32nds, for threads up to some 150 px wide
SIGMA = 1.2  # smoothing, px of a level
SURE = 7.0  # times the noise: strength of lines that are certainly not noise
BAR = 0.4  # strength over contrast of a line at the level that fits it
SHORTEST = 5.0  # px of a level: shorter pieces are regarded as noise
SLENDER = 16.0  # px of a level: least length of a slender piece, a few px wide
BLUR_PX = 4.0  # largest standard deviation of the blur of a thread's edge; edges with more are shading of the background
LEAST_BALANCE = 0.25  # least ratio of the slopes of a thread's two edges; with less, the line is the border of something else
SAMPLES = 400  # largest number of points where the width is measured


@dataclass(frozen=True)
class Appearance:
    """How the thread looks in an image.

    polarity  "dark" or "light" against the background
    width_px  median distance between its edges
    slope     grey levels per px of its edges, smoothed by EDGE_SIGMA
    box       left, top, right, bottom of the box around it in px, right and bottom exclusive
    """

    polarity: str
    width_px: float
    slope: float
    box: tuple[int, int, int, int]


def appearance(image: np.ndarray, polarity: str | None, width_px: float | None, least_contrast: float) -> Appearance | None:
    """The appearance of the most distinct line in an image (H, W) float32; None without a distinct line.

    polarity, width_px  given, or None: measured
    least_contrast      grey levels: lines that differ less from the background are ignored
    """
    found, level = [], image
    for step in range(1, LEVELS + 1):
        if min(level.shape) < 16:
            break
        level = cv2.pyrDown(level)
        if width_px is not None and step < LEVELS and 2.0**step * SIGMA < 0.4 * width_px:
            continue
        curvature = Curvature(level, SIGMA)
        strong = max(SURE * curvature.noise(), BAR * least_contrast)
        for sign in ("dark", "light") if polarity is None else (polarity,):
            ridges = curvature.ridges(sign, strong / 2)
            ridges = ridges[np.abs(ridges.offset) <= REACH_PX]
            piece = pieces(ridges, strong / 2, SHORTEST)
            ridges, piece = ridges[piece > 0], piece[piece > 0]
            slender = (np.bincount(piece, minlength=1) >= SLENDER * POINTS_PER_PX)[piece]
            found.append((2.0**step * (ridges.strength[slender] ** 2).sum(), sign, 2.0**step, ridges, slender))
        if width_px is not None:
            break
    for score, sign, scale, ridges, slender in sorted(found, key=lambda entry: -entry[0]):
        look = _measured(image, ridges, slender, sign, scale, width_px) if score > 0 else None
        if look is not None:
            return look
    return None


def _measured(image: np.ndarray, ridges: Ridges, slender: np.ndarray, polarity: str, scale: float,
              width_px: float | None) -> Appearance | None:
    """The appearance from the ridges of one level, ``scale`` px of the image to a pixel; None where they are not a thread.

    slender  (N,) bool: points of the long pieces, at which the thread is measured
    """
    # Smoothing and taking every second pixel leaves pixel centres of the level on pixel centres of the image.
    margin = int(np.ceil(8 * scale)) + 4
    point = scale * ridges.point
    left, top = np.maximum(np.floor(point.min(axis=0)).astype(int) - margin, 0)
    right, bottom = np.minimum(np.ceil(point.max(axis=0)).astype(int) + margin + 1, image.shape[::-1])
    square = np.where(slender, ridges.strength, 0) ** 2
    chosen = np.flatnonzero(slender & (ridges.strength >= 0.5 * (square * ridges.strength).sum() / square.sum()))
    chosen = chosen[:: max(1, len(chosen) // SAMPLES)]
    reach = 3.5 * SIGMA * scale if width_px is None else 0.75 * width_px + 2
    slopes = gradient(image[top:bottom, left:right])
    edges = edges_across(slopes, point[chosen] - (left, top), ridges.normal[chosen], polarity, reach)
    sound = of_a_thread(edges, ridges.strength[chosen])
    if 2 * sound.sum() < len(sound):
        return None
    width = float(np.median(edges.width[sound])) if width_px is None else float(width_px)
    return Appearance(polarity, width, float(np.median(edges.slope[sound])), (int(left), int(top), int(right), int(bottom)))


def of_a_thread(edges: Edges, strength: np.ndarray) -> np.ndarray:
    """(N,) bool: there are two edges, and they are as sharp as a line of that ``strength`` must have."""
    return (edges.balance > LEAST_BALANCE) & (edges.slope * BLUR_PX * np.sqrt(2 * np.pi) >= strength / BAR)


WITHIN = 0.5  # share of the largest ratio of difference and scatter up to which a place is within the thread
SURELY_WITHIN = 5.0  # ratio from which on a place is within the thread in any case: its stripes may differ
LEVEL = 3.0  # Lab: scatter without noise
DEEPEST, TINGE = 0.6, 6.0
"""In a shadow the levels of an image are those of the background times a factor, of 0.6 or more (a third of the light), and
differ from that by less than this in Lab."""
REACH = 2.5  # widths to either side that are looked at
SMOOTHING_PX = 0.7


@dataclass(frozen=True)
class Line:
    """A place on a thread: (2,) px, the angle of its direction and its width."""

    point: np.ndarray
    angle: float
    width: float


@dataclass(frozen=True)
class Look:
    """How a thread differs from what is beside it.

    colours   (n, 3) Lab, across it
    contrast  Lab
    polarity  "dark" or "light"
    sound     both its edges are where they are for its width, and it is no shadow
    """

    colours: np.ndarray
    contrast: float
    polarity: str
    sound: bool


def looked(image: np.ndarray, path: np.ndarray, middle: int, line: Line, before: Look | None) -> tuple[Line, Look]:
    """The line again, at the middle and with the width of the thread that the points ``path`` (N, 2) follow, and its look; what
    was known ``before`` where the thread has no edges there. The line is at the point ``middle`` of them."""
    sampled, along, offset = _across(image, path, line.width)
    seen, shaded = lab(sampled), _in_shadow(np.median(sampled, axis=0))
    usual = np.median(seen, axis=0)
    scatter = np.median(np.linalg.norm(seen - usual, axis=-1), axis=0)
    difference = np.minimum(*(np.median(np.linalg.norm(seen - seen[:, [end]], axis=-1), axis=0) for end in (0, -1)))
    ratio = difference / (scatter + LEVEL)
    near = np.flatnonzero(np.abs(offset) <= max(line.width / 2, 0.5))
    top = int(near[np.argmax(ratio[near])])
    first, last = _edges(ratio, difference, top)
    clear = np.flatnonzero(~shaded[first : last + 1])
    if len(clear):
        first, last = first + int(clear[0]), first + int(clear[-1])
        top = first + int(np.argmax(ratio[first : last + 1]))
    width = offset[last] - offset[first] + 0.5
    line = Line(path[middle], float(np.arctan2(along[middle, 1], along[middle, 0])), line.width)
    sound = len(clear) > 0 and 0 < first and last < len(offset) - 1 and line.width / 2 <= width <= 2 * line.width
    if not sound:
        if before is not None:
            return line, before
        first, last, width = top, top, line.width
    shift = (offset[first] + offset[last]) / 2 if last > first else 0.0
    inner = np.linspace(offset[first] + 0.2 * width, offset[last] - 0.2 * width, 5) if last > first else offset[[top]]
    colours = usual[np.argmin(np.abs(offset[:, None] - inner), axis=0)]
    polarity = "light" if usual[top, 0] > (usual[0, 0] + usual[-1, 0]) / 2 else "dark"
    across = np.array([-along[middle, 1], along[middle, 0]])
    return (replace(line, point=line.point + shift * across, width=max(float(width), 2.0)),
            Look(colours, float(difference[top]), polarity, sound))


def window(image: np.ndarray, place: np.ndarray, reach: int) -> tuple[np.ndarray, np.ndarray]:
    """The pixels within ``reach`` of a place, blurred, and the corner (2,) at which they begin."""
    x, y = (int(value) for value in np.clip(np.rint(place), 0, np.array(image.shape[1::-1]) - 1))
    left, top = max(x - reach, 0), max(y - reach, 0)
    return cv2.GaussianBlur(image[top : y + reach + 1, left : x + reach + 1], (0, 0), SMOOTHING_PX), np.array([left, top])


def _across(image: np.ndarray, path: np.ndarray, width: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(N, n, 3) colours across a path (N, 2), its (N, 2) directions, and the (n,) offsets in px."""
    span = int(max(1, width))
    smooth = cv2.blur(np.gradient(path, axis=0)[:, None], (1, 2 * span + 1), borderType=cv2.BORDER_REPLICATE)[:, 0]
    along = smooth / np.maximum(np.linalg.norm(smooth, axis=1, keepdims=True), 1e-9)
    offset = np.arange(-REACH * width, REACH * width + 0.01, 0.5)
    place, reach = path.mean(axis=0), int(np.abs(path - path.mean(axis=0)).max() + REACH * width) + 4
    pixels, corner = window(image, place, reach)
    at = (path - corner)[:, None] + offset[:, None] * np.stack([-along[:, 1], along[:, 0]], axis=-1)[:, None]
    at = at.astype(np.float32)
    return cv2.remap(pixels, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), along, offset


def _edges(ratio: np.ndarray, difference: np.ndarray, top: int) -> tuple[int, int]:
    """The first and the last place within the thread around ``top``."""
    outside = np.flatnonzero(ratio <= min(WITHIN * ratio[top], SURELY_WITHIN))
    first, last = outside[outside < top].max(initial=-1) + 1, outside[outside > top].min(initial=len(ratio)) - 1
    # The edges, blurred, are where half of the outermost stripe's difference is reached.
    third = max(1, (last - first) // 3)
    outer, inner = difference[first : first + third], difference[last - third + 1 : last + 1]
    return first + int(np.argmax(outer >= outer.max() / 2)), last - int(np.argmax(inner[::-1] >= inner.max() / 2))


def _in_shadow(colours: np.ndarray) -> np.ndarray:
    """(n,) bool: which of (n, 3) B, G, R across a thread are those of either end in a shadow."""
    found = np.zeros(len(colours), dtype=bool)
    for ground in (colours[0], colours[-1]):
        factor = colours @ ground / max(float(ground @ ground), 1e-9)
        off = np.linalg.norm(lab(colours) - lab(factor[:, None] * ground), axis=1)
        found |= (factor >= DEEPEST) & (factor <= 1.0) & (off <= TINGE)
    return found


TOLERANCE = 18.0  # τ: distances in Lab by which shading changes a colour
_STEPS = 64  # levels of each channel in the table of colours: within one, Lab differs by some 2


def lab(colours: np.ndarray) -> np.ndarray:
    """(..., 3) CIE Lab, L from 0 to 100, of (..., 3) B, G, R from 0 to 255."""
    flat = np.ascontiguousarray(colours, dtype=np.float32).reshape(1, -1, 3) / 255
    return cv2.cvtColor(flat, cv2.COLOR_BGR2LAB).reshape(np.shape(colours))


def likeness_table(colours: Sequence[np.ndarray], tolerance: float = TOLERANCE) -> np.ndarray:
    """(64, 64, 64) float32 likeness, 0 to 255, of blue, green and red to any of the ``colours``, each (3,) in Lab."""
    level = (np.arange(_STEPS) + 0.5) * (256 / _STEPS) - 0.5
    cells = lab(np.stack(np.meshgrid(level, level, level, indexing="ij"), axis=-1))
    nearest = np.min([((cells - np.float32(colour)) ** 2).sum(axis=-1) for colour in colours], axis=0)
    return 255 * np.exp(-nearest / tolerance**2, dtype=np.float32)


def likeness(image: np.ndarray, table: np.ndarray) -> np.ndarray:
    """(H, W) float32 likeness of an image (H, W, 3) uint8 in OpenCV's order, by a table of :func:`likeness_table`."""
    blue, green, red = (image[..., channel] // (256 // _STEPS) for channel in range(3))
    return table[blue, green, red]


def as_colour(image: np.ndarray) -> np.ndarray:
    """(H, W, 3) uint8 of an image (H, W) or (H, W, 3) with levels from 0 to 255."""
    levels = image if image.dtype == np.uint8 else np.clip(np.nan_to_num(image), 0, 255).round().astype(np.uint8)
    return levels if levels.ndim == 3 else np.repeat(levels[..., None], 3, axis=2)
