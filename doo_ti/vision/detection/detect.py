"""The thread's centre line in an image (§IV-A).

The paper's binary image says of each pixel whether the thread is on it. Here the line is found to a fraction of a pixel:
points with directions, which every later step is as exact as. The paper's way is in :mod:`doo_ti.vision.detection.detect`.
"""

from dataclasses import dataclass

import numpy as np

from doo_ti.errors import InputError
from doo_ti.vision.detection.appearance import BAR, SURE, Appearance, appearance, of_a_thread
from doo_ti.vision.detection.ridge import REACH_PX, Curvature, edges_across, gradient, pieces

SIGMA_PER_WIDTH, SMALLEST_SIGMA = 0.35, 0.8
"""Of the ridges' smoothing, px: enough that a bar has one ridge, no more than that neighbours stay apart."""

WEAK, STRONG = 0.2, 0.5
"""Of the typical strength: a piece of thread reaches the second somewhere and the first everywhere."""

WIDTH_RATIO, FAINTEST = 1.5, 0.4
"""Of a piece to the most distinct one: width either way, as depth changes it, and mean strength."""

CANNY_STRONG, CANNY_WEAK = 0.4, 0.15
"""Canny's thresholds over the slope of the thread's edges."""

VOTE_BLUR_PX = 1.0
"""Standard deviation of a vote."""

MEETING = 0.5
"""Votes on the centre line over those of two whole edges, with an edge pixel per px of length."""

STEEPEST = 8000
"""What the thread's slope becomes in the whole numbers that Canny takes."""

METHODS = ("ridge", "canny")
POLARITIES = ("dark", "light")
MOST_WIDTH_PX = 1000.0
"""Of a thread: samples are taken across it."""


@dataclass(frozen=True)
class DetectionOptions:
    """How the thread is looked for.

    method          "ridge": to a fraction of a pixel; "canny": the paper's edges and offset Gaussian, to a pixel
    polarity        "dark" or "light" against the background; None: whichever stands out
    width_px        of the thread between its edges; None: as found
    least_contrast  grey levels between thread and background; what differs less is not seen
    shortest_px     visible pieces of the thread that are shorter are taken for specks

    Raises InputError for another method or polarity, and numbers that are not positive.
    """

    method: str = "ridge"
    polarity: str | None = None
    width_px: float | None = None
    least_contrast: float = 10.0
    shortest_px: float = 10.0

    def __post_init__(self):
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


@dataclass(frozen=True)
class Detection:
    """The centre line found in one image; N = 0 where no thread was found.

    points     (N, 2) px, x and y, at most a pixel apart along the line, in no order
    direction  (N, 2) unit tangents, of either sign
    strength   (N,) how distinct the line is there, grey levels
    width_px   median distance between the thread's edges, NaN without a thread
    polarity   "dark" or "light", "" without a thread
    shape      (height, width) of the image
    method     of :class:`DetectionOptions`
    """

    points: np.ndarray
    direction: np.ndarray
    strength: np.ndarray
    width_px: float
    polarity: str
    shape: tuple[int, int]
    method: str

    @property
    def count(self) -> int:
        return len(self.points)


def detect(image: np.ndarray, options: DetectionOptions = DetectionOptions()) -> Detection:
    """The thread's centre line in an image (H, W) of grey levels, 0 to 255.

    Raises InputError for an image that is not (H, W) numbers of at least 16 × 16.
    """
    image = np.asarray(image)
    if image.ndim != 2 or min(image.shape) < 16 or image.dtype.kind not in "uif":
        raise InputError("detection", "image", f"shape {image.shape} of {image.dtype}",
                         "give (H, W) grey levels, at least 16 x 16")
    grey = image.astype(np.float32)
    look = appearance(grey, options.polarity, options.width_px, options.least_contrast)
    points, direction, strength = np.empty((0, 2)), np.empty((0, 2)), np.empty(0)
    if look is not None:
        left, top, right, bottom = look.box
        find = {"ridge": _ridge_line, "canny": _canny_line}[options.method]
        points, direction, strength = find(grey[top:bottom, left:right], look, options.least_contrast, options.shortest_px)
        points = points + (left, top)
    if not len(points):
        return Detection(points, direction, strength, np.nan, "", image.shape, options.method)
    return Detection(points, direction, strength, look.width_px, look.polarity, image.shape, options.method)


def _ridge_line(image: np.ndarray, look: Appearance, least_contrast: float,
                shortest_px: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points, directions and strengths: ridges at the thread's width, each moved to the middle between the two edges."""
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

def _canny_line(image: np.ndarray, look: Appearance, least_contrast: float,
                shortest_px: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(N, 2) pixels of the centre line in an image (H, W) float32, their (N, 2) directions and (N,) strengths.

    "A Canny edge detector with a blurred, offset Gaussian kernel" (§IV-A): every edge pixel votes for the place half a thread's
    width further in, along the gradient; votes are blurred. Where the votes of both edges meet lies the centre line. Votes
    carry their directions: those of a single edge do not cancel, and do not count.

    look            of the thread: the offset is half its width
    least_contrast  grey levels: fainter edges are none
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
    """(H, W) float32: blurred votes of edge pixels that are met by votes from the other side, 1 for two whole edges."""
    import cv2

    x = np.rint(column - offset * outward[:, 0]).astype(np.int64)
    y = np.rint(row - offset * outward[:, 1]).astype(np.int64)
    inside = (x >= 0) & (x < shape[1]) & (y >= 0) & (y < shape[0])
    place, length = (y * shape[1] + x)[inside], shape[0] * shape[1]
    ballots = [np.bincount(place, weight, length).reshape(shape).astype(np.float32)
               for weight in (None, outward[inside, 0], outward[inside, 1])]
    votes, across, down = (cv2.GaussianBlur(ballot, (0, 0), VOTE_BLUR_PX, borderType=cv2.BORDER_CONSTANT) for ballot in ballots)
    return (votes - np.sqrt(across * across + down * down)) * np.float32(VOTE_BLUR_PX * np.sqrt(2 * np.pi) / 2)
