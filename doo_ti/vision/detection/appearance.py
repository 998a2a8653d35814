"""How the thread looks in an image: dark or light, how wide, how distinct, and roughly where.

It is found on a pyramid of ever coarser images: a line stands out as a ridge at the level that fits its width.
"""

from dataclasses import dataclass

import numpy as np

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
