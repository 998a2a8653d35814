"""The thread's centre line in an image (§IV-A).

The paper's binary image marks the pixels of the thread. Here the line is found to a fraction of a pixel, as
points with directions; all later steps are as exact as these. The paper's way, a Canny edge detector with an offset Gaussian,
is :mod:`doo_ti.vision.detection.canny`. First the thread's :mod:`doo_ti.vision.detection.appearance` is measured.
"""

from dataclasses import replace

import numpy as np

from doo_ti.system.arguments import typed
from doo_ti.vision.detection.appearance import BAR, SURE, Appearance, appearance, of_a_thread
from doo_ti.vision.detection.canny import canny_line
from doo_ti.vision.detection.colour import as_colour, lab, likeness, likeness_table
from doo_ti.vision.detection.continued import continued
from doo_ti.vision.detection.line import Detection, in_whole_pixels, moved
from doo_ti.vision.detection.options import DetectionOptions, check_image, cropped
from doo_ti.vision.detection.ridge import REACH_PX, Curvature, edges_across, gradient, pieces

SIGMA_PER_WIDTH, SMALLEST_SIGMA = 0.35, 0.8
"""Standard deviation of the ridges' smoothing, px: a bar gets a single ridge, and neighbouring strands stay apart."""
WEAK, STRONG = 0.2, 0.5
"""Shares of the typical strength: all of a piece of thread exceeds the first, some of it the second."""
WIDTH_RATIO, FAINTEST = 1.5, 0.4
"""Largest ratio of widths, which differ with depth, and least ratio of mean strengths, of a piece and the most distinct one."""
WIDEST_PX = 40.0
"""Wider threads are sought in halved images."""


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
    find = {"ridge": _ridge_line, "canny": canny_line}[options.method]
    found = find(image, look, options.least_contrast, options.shortest_px / scale)
    return in_whole_pixels(scale, *found)


def _ridge_line(image: np.ndarray, look: Appearance, least_contrast: float, shortest_px: float) -> tuple[np.ndarray, ...]:
    """(N, 2) points, (N, 2) directions and (N,) strengths: ridges at the thread's width, each moved to the middle between the
    two edges, and what goes on from their ends."""
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
    return continued(image, look, ridges[kept])


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
