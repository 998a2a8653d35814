"""The brightness across a line: where its two edges are, to a fraction of a pixel.

A round thread lit from one side is brighter on that side; the extremum of its brightness then lies off its middle, but the
middle between its edges does not.
"""

from dataclasses import dataclass

import numpy as np

from doo_ti.vision.ridge import derivative_kernels

STEP_PX = 0.25

EDGE_SIGMA = 1.0
"""px by which an image is smoothed before edges are sought across a line."""


@dataclass(frozen=True)
class Edges:
    """What was found across N points of a line.

    shift  (N,) px from the point along its normal to the middle between the edges
    width  (N,) px between the edges
    slope  (N,) grey levels per px: the weaker edge's
    balance  (N,) the weaker edge's slope over the stronger one's: 0 where only one side differs from the line
    """

    shift: np.ndarray
    width: np.ndarray
    slope: np.ndarray
    balance: np.ndarray


def gradient(image: np.ndarray) -> np.ndarray:
    """(H, W, 2) grey levels per px: the slope of an image (H, W) float32 smoothed by EDGE_SIGMA, along x and y."""
    import cv2

    smooth, slope, _ = derivative_kernels(EDGE_SIGMA)
    return cv2.merge([cv2.sepFilter2D(image, cv2.CV_32F, across, down, borderType=cv2.BORDER_REPLICATE)
                      for across, down in ((slope, smooth), (smooth, slope))])


def edges_across(gradients: np.ndarray, point: np.ndarray, normal: np.ndarray, polarity: str, reach_px: float) -> Edges:
    """The strongest edge on either side of each of (N, 2) points, within ``reach_px`` along ``normal``.

    gradients  of the image, from :func:`gradient`. They are interpolated, not the brightness: OpenCV places samples to 1/32 px,
               which near the slope's extremum matters little, but would make differences of the brightness jump.
    """
    import cv2

    if not len(point):
        return Edges(*np.empty((4, 0)))
    middle = int(np.ceil(reach_px / STEP_PX))
    place = STEP_PX * np.arange(-middle, middle + 1)
    at = (point[:, None] + place[:, None] * normal[:, None]).astype(np.float32)
    sampled = cv2.remap(gradients, at[..., 0], at[..., 1], cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    slope = (sampled * normal[:, None].astype(np.float32)).sum(axis=-1) * (1 if polarity == "dark" else -1)
    left, fall = _peak(-slope[:, middle::-1])
    right, rise = _peak(slope[:, middle:])
    left, right, weaker = -left * STEP_PX, right * STEP_PX, np.minimum(fall, rise)
    return Edges((left + right) / 2, right - left, weaker, weaker / np.maximum(np.maximum(fall, rise), 1e-30))


def _peak(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Place, in columns, and height of each row's highest value, by the parabola through it and its neighbours."""
    rows = np.arange(len(values))
    at = np.clip(np.argmax(values, axis=1), 1, values.shape[1] - 2)
    before, here, after = values[rows, at - 1], values[rows, at], values[rows, at + 1]
    bend = before - 2 * here + after
    offset = np.clip(np.where(bend < 0, (before - after) / (2 * np.where(bend < 0, bend, -1)), 0), -1, 1)
    return at + offset, np.maximum(here, 0)
