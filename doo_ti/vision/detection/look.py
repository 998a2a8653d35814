"""What a thread looks like across a line: its middle, its width and its colours.

The colour at an offset s from the line is compared with that farther off on either side: where the median difference is large
against the scatter along the thread, s is within. Beside a thread its shadow differs from the background, too; but there the
colour is a multiple of the background's, while a thread has a colour of its own or is much darker.
"""

from dataclasses import dataclass, replace

import numpy as np

from doo_ti.vision.detection.colour import lab

WITHIN = 0.5
"""Share of the largest ratio of difference and scatter up to which a place is within the thread."""
SURE = 5.0
"""Ratio from which on a place is within the thread in any case: its stripes may differ."""
LEVEL = 3.0
"""Lab: scatter without noise."""
DEEPEST, TINGE = 0.6, 6.0
"""In a shadow the levels of an image are those of the background times a factor, of 0.6 or more (a third of the light), and
differ from that by less than this in Lab."""
REACH = 2.5
"""Widths to either side that are looked at."""
BLUR_PX = 0.7


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
    import cv2

    x, y = (int(value) for value in np.clip(np.rint(place), 0, np.array(image.shape[1::-1]) - 1))
    left, top = max(x - reach, 0), max(y - reach, 0)
    return cv2.GaussianBlur(image[top : y + reach + 1, left : x + reach + 1], (0, 0), BLUR_PX), np.array([left, top])


def _across(image: np.ndarray, path: np.ndarray, width: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(N, n, 3) colours across a path (N, 2), its (N, 2) directions, and the (n,) offsets in px."""
    import cv2

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
    outside = np.flatnonzero(ratio <= min(WITHIN * ratio[top], SURE))
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
