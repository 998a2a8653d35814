"""The thread's centre line in an image (§IV-A).

The paper's binary image marks the pixels of the thread. Here the line is found to a fraction of a pixel, as
points with directions; all later steps are as exact as these. The paper's way, a Canny edge detector with an offset Gaussian,
is :func:`_canny_line`.

First the thread's appearance is measured: dark or light, how wide, how distinct, and roughly where. It is found on a pyramid
of ever coarser images: a line stands out as a ridge at the level that fits its width.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from doo_ti.arguments import typed
from doo_ti.errors import InputError
from doo_ti.short_repr import short_repr
from doo_ti.vision.detection.colour import as_colour, lab, likeness, likeness_table
from doo_ti.vision.detection.ridge import (
    POINTS_PER_PX,
    REACH_PX,
    Curvature,
    Edges,
    Ridges,
    edges_across,
    gradient,
    pieces,
)

SIGMA_PER_WIDTH, SMALLEST_SIGMA = 0.35, 0.8
"""Standard deviation of the ridges' smoothing, px: a bar gets a single ridge, and neighbouring strands stay apart."""
WEAK, STRONG = 0.2, 0.5
"""Shares of the typical strength: all of a piece of thread exceeds the first, some of it the second."""
WIDTH_RATIO, FAINTEST = 1.5, 0.4
"""Largest ratio of widths, which differ with depth, and least ratio of mean strengths, of a piece and the most distinct one."""
CANNY_STRONG, CANNY_WEAK = 0.4, 0.15
"""Canny's thresholds over the slope of the thread's edges."""
VOTE_BLUR_PX = 1.0
"""Standard deviation of a vote."""
MEETING = 0.5
"""Least share of votes on the centre line, of those of two complete edges with an edge pixel per px of length."""
STEEPEST = 8000
"""Slope of the thread's edges in the whole numbers that Canny takes."""
METHODS = ("ridge", "canny")
POLARITIES = ("dark", "light")
WIDEST_PX = 40.0
"""Wider threads are sought in halved images."""
MOST_WIDTH_PX = 1000.0
"""Largest width of a thread: samples are taken across it."""


@typed
@dataclass(frozen=True)
class DetectionOptions:
    """Options of the detection.

    method          "ridge": to a fraction of a pixel; "canny": the paper's edges and offset Gaussian, to a pixel
    polarity        "dark" or "light" against the background; None: the more distinct of the two
    width_px        of the thread between its edges; None: measured
    least_contrast  grey levels between thread and background; lines that differ less are ignored
    shortest_px     shorter visible pieces are regarded as specks
    colour          red, green and blue of the thread, 0 to 255: it is then a light line in the likeness to this colour
    region          left, top, width and height in px of the part of the image where the thread is; None: all of it

    Raises InputError for another method or polarity, numbers that are not positive, and other colours and regions.
    """

    __repr__ = short_repr

    method: str = "ridge"
    polarity: str | None = None
    width_px: float | None = None
    least_contrast: float = 10.0
    shortest_px: float = 10.0
    colour: Sequence[float] | None = None
    region: Sequence[int] | None = None

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise InputError("detection", "method", f"{self.method!r} is unknown", f"give {' or '.join(METHODS)}")
        if self.polarity not in (None, *POLARITIES):
            raise InputError("detection", "polarity", f"{self.polarity!r} is unknown", f"give {' or '.join(POLARITIES)}")
        for name in ("width_px", "least_contrast", "shortest_px"):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and value > 0):
                raise InputError("detection", name, f"{value}", "give a number above 0")
        if self.width_px is not None and self.width_px > MOST_WIDTH_PX:
            raise InputError("detection", "width_px", f"{self.width_px:g}", f"give {MOST_WIDTH_PX:g} px at most")
        for name, count, wanted in (("colour", 3, "three numbers from 0 to 255: red, green and blue"),
                                    ("region", 4, "left, top, width and height in px, at least 16 x 16")):
            value = getattr(self, name)
            if value is None:
                continue
            numbers = tuple(value)
            sound = len(numbers) == count and np.isfinite(numbers).all() and min(numbers) >= 0
            if not sound or (max(numbers) > 255 if name == "colour" else min(numbers[2:]) < 16):
                raise InputError("detection", name, f"{numbers}", f"give {wanted}")
            object.__setattr__(self, name, numbers)


@typed
@dataclass(frozen=True)
class Detection:
    """The centre line found in one image; N = 0 where no thread was found.

    points     (N, 2) px, x and y, at most a pixel apart along the line, in no order
    direction  (N, 2) unit tangents, of either sign
    strength   (N,) grey levels: how distinct the line is
    width_px   median distance between the thread's edges, NaN without a thread
    polarity   "dark" or "light", "" without a thread
    shape      (height, width) of the image
    method     of :class:`DetectionOptions`, or "mask", "follow"
    width      (N,) px: the thread's width at each point, where it is known: of masks; else None
    """

    points: Annotated[np.ndarray, "N 2"]
    direction: Annotated[np.ndarray, "N 2"]
    strength: Annotated[np.ndarray, "N"]
    width_px: float
    polarity: str
    shape: tuple[int, int]
    method: str
    width: Annotated[np.ndarray, "N"] | None = None

    @property
    def widths(self) -> np.ndarray:
        """(N,) px: the thread's width at each point; where only one is known, that."""
        return np.full(len(self.points), float(self.width_px)) if self.width is None else self.width

    @property
    def count(self) -> int:
        return len(self.points)


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


@typed
def detect(image: np.ndarray, options: DetectionOptions = DetectionOptions()) -> Detection:
    """The thread's centre line in an image with levels from 0 to 255, (H, W) grey or (H, W, 3) in OpenCV's order.

    Raises InputError for an image of another shape or smaller than 16 × 16, and for a region outside.
    """
    image = np.asarray(image)
    check_image(image)
    part, corner = cropped(image, options)
    if options.colour is not None:
        line, polarity = likeness(as_colour(part), likeness_table([lab(np.array(options.colour[::-1]))])), "light"
    else:
        line, polarity = _grey(part), options.polarity
    look = appearance(line, polarity, options.width_px, options.least_contrast)
    points, direction, strength = np.empty((0, 2)), np.empty((0, 2)), np.empty(0)
    if look is not None:
        left, top, right, bottom = look.box
        points, direction, strength = _line(line[top:bottom, left:right], look, options)
        points = points + (left, top)
    found = Detection(points, direction, strength, look.width_px if len(points) else np.nan,
                      look.polarity if len(points) else "", image.shape[:2], options.method)
    return moved(found, corner)


def thinned(detection: Detection) -> tuple[np.ndarray, np.ndarray]:
    """The strongest point of each pixel (N', 2), and its direction: about one for each pixel of line."""
    order = np.argsort(-detection.strength, kind="stable")
    cells = np.round(detection.points[order]).astype(np.int64)
    _, first = np.unique(cells[:, 1] * (detection.shape[1] + 1) + cells[:, 0], return_index=True)
    kept = order[np.sort(first)]
    return detection.points[kept], detection.direction[kept]


def check_image(image: np.ndarray) -> None:
    """Raise InputError for anything but (H, W) or (H, W, 3) numbers of at least 16 × 16."""
    form = image.ndim in (2, 3) and image.shape[2:] in ((), (3,)) and image.dtype.kind in "uif"
    if not form or min(image.shape[:2]) < 16:
        raise InputError("detection", "image", f"shape {image.shape} of {image.dtype}",
                         "give (H, W) or (H, W, 3) levels, at least 16 x 16")


def cropped(image: np.ndarray, options: DetectionOptions) -> tuple[np.ndarray, tuple[int, int]]:
    """The region of an image, and its corner's x and y. Raises InputError where the image has fewer than 16 × 16 px of it."""
    if options.region is None:
        return image, (0, 0)
    left, top, width, height = (int(value) for value in options.region)
    part = image[top : top + height, left : left + width]
    if min(part.shape[:2]) < 16:
        raise InputError("detection", "region", f"{options.region} has less than 16 x 16 px of the image",
                         f"give a part of its {image.shape[1]} x {image.shape[0]} px")
    return part, (left, top)


def moved(detection: Detection, corner: tuple[int, int]) -> Detection:
    """What was detected in a region that begins at ``corner``, in px of the whole image."""
    return replace(detection, points=detection.points + corner) if any(corner) else detection


def _grey(image: np.ndarray) -> np.ndarray:
    """(H, W) float32."""
    import cv2

    return (image if image.ndim == 2 else cv2.cvtColor(as_colour(image), cv2.COLOR_BGR2GRAY)).astype(np.float32)


def _line(image: np.ndarray, look: Appearance, options: DetectionOptions) -> tuple[np.ndarray, ...]:
    """(N, 2) points, (N, 2) directions and (N,) strengths in an image (H, W) float32, halved for wide threads."""
    import cv2

    halvings = max(0, int(np.ceil(np.log2(look.width_px / WIDEST_PX))))
    for _ in range(halvings):
        image = cv2.pyrDown(image)
    scale = 2.0**halvings
    look = replace(look, width_px=look.width_px / scale, slope=look.slope * scale)
    find = {"ridge": _ridge_line, "canny": _canny_line}[options.method]
    found = find(image, look, options.least_contrast, options.shortest_px / scale)
    return in_whole_pixels(scale, *found)


def in_whole_pixels(scale: float, points: np.ndarray, direction: np.ndarray, *values: np.ndarray) -> tuple[np.ndarray, ...]:
    """Points with directions and (N,) ``values`` of an image that has one pixel for ``scale``, in px of the image itself and
    again at most a pixel apart."""
    if scale == 1:
        return points, direction, *values
    between = np.arange(scale) - (scale - 1) / 2
    points = (scale * points[:, None] + between[:, None] * direction[:, None]).reshape(-1, 2)
    return points, *(np.repeat(array, len(between), axis=0) for array in (direction, *values))


def _ridge_line(image: np.ndarray, look: Appearance, least_contrast: float, shortest_px: float) -> tuple[np.ndarray, ...]:
    """(N, 2) points, (N, 2) directions and (N,) strengths: ridges at the thread's width, each moved to the middle between the
    two edges."""
    curvature = Curvature(image, max(SMALLEST_SIGMA, SIGMA_PER_WIDTH * look.width_px))
    certain = max(SURE * curvature.noise(), BAR * least_contrast)
    ridges = curvature.ridges(look.polarity, certain / 2)
    typical = (ridges.strength**3).sum() / max((ridges.strength**2).sum(), 1e-30)
    ridges = ridges[ridges.strength >= WEAK * typical]
    edges = edges_across(gradient(image), ridges.point, ridges.normal, look.polarity, 0.75 * look.width_px + 2)
    sound = of_a_thread(edges, ridges.strength) & (np.abs(ridges.offset + edges.shift) <= REACH_PX)
    sound &= (edges.width > look.width_px / 2) & (edges.width < 1.5 * look.width_px + 1)
    ridges, width = ridges.moved(edges.shift)[sound], edges.width[sound]
    piece = pieces(ridges, max(certain, STRONG * typical), max(shortest_px, look.width_px))
    kept = np.flatnonzero(piece)
    kept = kept[_alike(piece[kept], width[kept], ridges.strength[kept])]
    ridges = ridges[kept]
    return ridges.point, ridges.tangent, ridges.strength


def _alike(piece: np.ndarray, width: np.ndarray, strength: np.ndarray) -> np.ndarray:
    """(N,) bool: points of pieces about as wide as the most distinct one, and not much fainter."""
    if not len(piece):
        return np.zeros(0, dtype=bool)
    _, piece, count = np.unique(piece, return_inverse=True, return_counts=True)
    median = width[np.lexsort((width, piece))][np.cumsum(count) - count + count // 2]
    mean = np.bincount(piece, strength) / count
    first = np.argmax(count * mean**2)
    ratio = median / median[first]
    return ((ratio < WIDTH_RATIO) & (ratio > 1 / WIDTH_RATIO) & (mean > FAINTEST * mean[first]))[piece]


# --- the paper's way ----------------------------------------------------------------------------------------------------

def _canny_line(image: np.ndarray, look: Appearance, least_contrast: float, shortest_px: float) -> tuple[np.ndarray, ...]:
    """(N, 2) pixels of the centre line in an image (H, W) float32, their (N, 2) directions and (N,) strengths.

    "A Canny edge detector with a blurred, offset Gaussian kernel" (§IV-A): every edge pixel votes for the place half a thread's
    width along the gradient towards the thread's middle; votes are blurred. The centre line lies where votes of both edges
    coincide. Votes have directions: those of opposite edges cancel, and only votes that cancel count.

    look            of the thread: the offset is half its width
    least_contrast  grey levels: fainter edges are ignored
    shortest_px     of a piece of line
    """
    import cv2

    slope = gradient(image)
    whole = np.clip(np.rint(slope * (STEEPEST / look.slope)), -32767, 32767).astype(np.int16)
    floor = 0.25 * least_contrast / look.slope
    weak, strong = (STEEPEST * max(share, floor) for share in (CANNY_WEAK, CANNY_STRONG))
    edge = cv2.Canny(np.ascontiguousarray(whole[..., 0]), np.ascontiguousarray(whole[..., 1]), weak, strong, L2gradient=True)
    row, column = np.nonzero(edge)
    outward = slope[row, column] / np.maximum(np.linalg.norm(slope[row, column], axis=1, keepdims=True), 1e-30)
    meeting = _meeting(row, column, outward if look.polarity == "dark" else -outward, look.width_px / 2, image.shape)
    curvature = Curvature(meeting, VOTE_BLUR_PX)
    ridges = curvature.ridges("light", 1e-3)
    ridges = ridges[(meeting[ridges.row, ridges.column] >= MEETING) & (np.abs(ridges.offset) <= REACH_PX)]
    ridges = ridges[pieces(ridges, 0.0, shortest_px) > 0]
    return np.stack([ridges.column, ridges.row], axis=1).astype(np.float64), ridges.tangent, look.slope * ridges.strength


def _meeting(row: np.ndarray, column: np.ndarray, outward: np.ndarray, offset: float, shape: tuple[int, int]) -> np.ndarray:
    """(H, W) float32: blurred votes of edge pixels that coincide with votes from the other edge, 1 for two complete edges."""
    import cv2

    x = np.rint(column - offset * outward[:, 0]).astype(np.int64)
    y = np.rint(row - offset * outward[:, 1]).astype(np.int64)
    inside = (x >= 0) & (x < shape[1]) & (y >= 0) & (y < shape[0])
    place, length = (y * shape[1] + x)[inside], shape[0] * shape[1]
    ballots = [np.bincount(place, weight, length).reshape(shape).astype(np.float32)
               for weight in (None, outward[inside, 0], outward[inside, 1])]
    votes, across, down = (cv2.GaussianBlur(ballot, (0, 0), VOTE_BLUR_PX, borderType=cv2.BORDER_CONSTANT) for ballot in ballots)
    return (votes - np.sqrt(across * across + down * down)) * np.float32(VOTE_BLUR_PX * np.sqrt(2 * np.pi) / 2)


# --- the thread's appearance -----------------------------------------------------------------------------------------------

LEVELS = 5
"""Levels of the pyramid above the image itself: halves to 32nds, for threads up to some 150 px wide."""
SIGMA = 1.2
"""Smoothing, px of a level."""
SURE = 7.0
"""Times the noise: strength of lines that are certainly not noise."""
BAR = 0.4
"""Strength over contrast of a line at the level that fits it."""
SHORTEST = 5.0
"""px of a level: shorter pieces are regarded as noise."""
SLENDER = 16.0
"""px of a level: least length of a slender piece, a few px wide."""
BLUR_PX = 4.0
"""Largest standard deviation of the blur of a thread's edge; edges with more are shading of the background."""
LEAST_BALANCE = 0.25
"""Least ratio of the slopes of a thread's two edges; with less, the line is the border of something else."""
SAMPLES = 400
"""Largest number of points where the width is measured."""


def appearance(image: np.ndarray, polarity: str | None, width_px: float | None, least_contrast: float) -> Appearance | None:
    """The appearance of the most distinct line in an image (H, W) float32; None without a distinct line.

    polarity, width_px  given, or None: measured
    least_contrast      grey levels: lines that differ less from the background are ignored
    """
    import cv2

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
