"""The centre line of a mask: detection where a segmentation of the image is given.

The distance to the mask's border is a roof, whose crest is the centre line. Smoothed by σ, a crest between slopes of ±1 that
end at distance a from it has the second derivative across

    −2 (1 − exp(−a² / 2σ²)) / (σ √(2π)),

whatever the thread's width 2a; branches to corners and bumps of the border have √½ of it or less.
"""

import numpy as np

from doo_ti.system.arguments import typed
from doo_ti.system.errors import InputError
from doo_ti.vision.detection.line import Detection, in_whole_pixels, moved
from doo_ti.vision.detection.options import DetectionOptions, cropped
from doo_ti.vision.detection.ridge import REACH_PX, Curvature, pieces

SIGMA = 1.0
CREST = 0.8
"""Least second derivative over that of a full roof."""
LABELS = 16
WORKING_WIDTH = 16.0
"""px: masks of wider threads are halved, so that their rough borders are smoothed."""
LARGEST_HOLE = 20
"""px of a hole or speck that is regarded as noise."""


@typed
def detect_mask(mask: np.ndarray, options: DetectionOptions = DetectionOptions()) -> Detection:
    """The centre line of a mask (H, W) of any numbers. With at most LABELS different ones the thread is where they are not 0;
    with more, in a smoothed mask, where they exceed half of the largest. Of ``options`` its ``shortest_px`` and ``region``
    are used.

    Raises InputError for anything else, and for masks smaller than 16 × 16.
    """
    mask = np.asarray(mask)
    if mask.ndim != 2 or min(mask.shape) < 16 or mask.dtype.kind not in "buif":
        raise InputError("detection", "mask", f"shape {mask.shape} of {mask.dtype}", "give (H, W) numbers, at least 16 x 16")
    part, corner = cropped(mask, options)
    least = 0 if len(np.unique(mask)) <= LABELS else mask.max() / 2
    roof, scale = _roof(_cleaned(part > least))
    ridges = Curvature(roof, SIGMA).ridges("light", 0.1)
    half = roof[ridges.row, ridges.column].astype(np.float64)
    full = 2 * SIGMA / np.sqrt(2 * np.pi) * (1 - np.exp(-0.5 * (half / SIGMA) ** 2))
    kept = (ridges.strength >= CREST * full) & (np.abs(ridges.offset) <= REACH_PX) & (half > 0)
    ridges, half = ridges[kept], half[kept]
    kept = pieces(ridges, 0.0, options.shortest_px / scale) > 0
    ridges, half = ridges[kept], half[kept]
    # Distances are from pixel to pixel: half a pixel lies beyond the border.
    width = 2 * (half + np.abs(ridges.offset)) - 1
    found = in_whole_pixels(scale, ridges.point, ridges.tangent, np.full(len(width), 255.0), scale * width)
    typical, polarity = (float(np.median(found[3])), "light") if len(width) else (np.nan, "")
    return moved(Detection(*found[:3], typical, polarity, mask.shape, "mask", found[3]), corner)


def _cleaned(inside: np.ndarray) -> np.ndarray:
    """(H, W) uint8: 1 within, without small holes and specks."""
    import cv2

    for within in (0, 1):
        of_kind = (inside == within).astype(np.uint8)
        label, sizes = cv2.connectedComponentsWithStats(of_kind, connectivity=4 + 4 * within)[1:3]
        small = sizes[:, cv2.CC_STAT_AREA] <= LARGEST_HOLE
        small[0] = False
        inside = inside ^ small[label]
    return inside.astype(np.uint8)


def _roof(inside: np.ndarray) -> tuple[np.ndarray, float]:
    """(h, w) float32: px from the nearest pixel outside, halved where the thread is wide, and px of the mask to one of it."""
    import cv2

    scale = 1.0
    while True:
        # The thread goes on beyond the image's border; distances to nothing would have no end.
        roof = cv2.distanceTransform(np.pad(inside, 2, mode="edge"), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[2:-2, 2:-2]
        roof = np.minimum(roof, max(inside.shape))
        if not inside.any() or 4 * np.median(roof[inside > 0]) <= WORKING_WIDTH or min(inside.shape) < 32:
            return np.ascontiguousarray(roof), scale
        inside, scale = (cv2.pyrDown(255 * inside) > 127).astype(np.uint8), 2 * scale
