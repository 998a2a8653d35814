"""Ridges of an image to a fraction of a pixel (Steger, *An unbiased detector of curvilinear structures*, 1998), and the edges
beside them.

On a line the brightness, smoothed to about the line's width, has an extremum across it: the first derivative along the
eigenvector n of the Hessian is zero and the second is large. From the derivatives g and H at a pixel, the extremum lies at

    t n with t = −(g·n) / (nᵀ H n).

At the border of something wide the first derivative is not zero, so that borders are no ridges.

A round thread lit from one side is brighter on that side; the extremum of its brightness then lies off its middle, but the
middle between its edges does not.
"""

from dataclasses import dataclass, fields, replace

import cv2
import numpy as np

REACH_PX = 0.75  # pixels this near to a line give a point of it, so that points are at most a pixel apart in any direction
FIRST_REACH_PX, FIRST_REACH = 2.0, 0.5
"""Bounds of t before edges are found, px and over σ: t is too large away from the ridge, and uncertain on flat ridges."""
POINTS_PER_PX = 2 * REACH_PX  # mean number of points per px of a line
ROUNDNESS = 0.6  # largest curvature along the line, of the same sign, over that across; with more it is a speck or a crossing


@dataclass(frozen=True)
class Ridges:
    """Points of ridges, one for each of N pixels near one.

    point     (N, 2) px, x and y
    offset    (N,) px from the pixel along the normal to the point
    normal    (N, 2) unit vectors across, of either sign
    strength  (N,) grey levels: the second derivative across times σ², 0.48 of the contrast of a bar as wide as 2 σ
    row, column  (N,) the pixels
    """

    point: np.ndarray
    offset: np.ndarray
    normal: np.ndarray
    strength: np.ndarray
    row: np.ndarray
    column: np.ndarray

    def __getitem__(self, kept: np.ndarray) -> "Ridges":
        return Ridges(*(getattr(self, field.name)[kept] for field in fields(self)))

    def moved(self, shift: np.ndarray) -> "Ridges":
        """The same with the points ``shift`` (N,) px farther along their normals."""
        return replace(self, point=self.point + shift[:, None] * self.normal, offset=self.offset + shift)

    @property
    def tangent(self) -> np.ndarray:
        """(N, 2) unit vectors along, of either sign."""
        return np.stack([-self.normal[:, 1], self.normal[:, 0]], axis=1)


class Curvature:
    """Second and first derivatives of an image (H, W) float32, smoothed by σ px."""

    def __init__(self, image: np.ndarray, sigma: float):
        smooth, slope, bend = derivative_kernels(sigma)
        self.sigma = sigma
        self.xx, self.xy, self.yy, self.x, self.y = (
            cv2.sepFilter2D(image, cv2.CV_32F, across, down, borderType=cv2.BORDER_REPLICATE)
            for across, down in ((bend, smooth), (slope, slope), (smooth, bend), (slope, smooth), (smooth, slope)))
        self._mean = 0.5 * (self.xx + self.yy)
        self._deviator = np.sqrt((0.5 * (self.xx - self.yy)) ** 2 + self.xy * self.xy)

    def noise(self) -> float:
        """Grey levels: standard deviation of the strength in the background, from the median over the image."""
        return float(self.sigma**2 * 1.4826 * np.median(np.abs(self.xx[::4, ::4])))

    def ridges(self, polarity: str, least: float) -> Ridges:
        """The ridges of at least this strength, of lines that are "dark" or "light" against their surroundings."""
        sign = 1 if polarity == "dark" else -1
        row, column = np.nonzero(sign * self._mean + self._deviator >= least / self.sigma**2)
        xx, xy, yy = (sign * part[row, column].astype(np.float64) for part in (self.xx, self.xy, self.yy))
        half, deviator = (xx - yy) / 2, self._deviator[row, column].astype(np.float64)
        mean = (xx + yy) / 2
        across, along = mean + deviator, mean - deviator
        # Of the two formulas for the eigenvector, the one without cancellation.
        flat = half > 0
        normal = np.stack([np.where(flat, deviator + half, xy), np.where(flat, xy, deviator - half)], axis=1)
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
        slope = sign * (self.x[row, column] * normal[:, 0] + self.y[row, column] * normal[:, 1])
        offset = -slope / across
        kept = (np.abs(offset) <= max(FIRST_REACH_PX, FIRST_REACH * self.sigma)) & (along <= ROUNDNESS * across)
        point = np.stack([column, row], axis=1) + offset[:, None] * normal
        return Ridges(point, offset, normal, self.sigma**2 * across, row, column)[kept]


def derivative_kernels(sigma: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A Gaussian of σ px and its first two derivatives as filters, exact on polynomials of second degree."""
    x = np.arange(-np.ceil(4 * sigma), np.ceil(4 * sigma) + 1)
    smooth = np.exp(-0.5 * (x / sigma) ** 2)
    smooth /= smooth.sum()
    slope = x * smooth
    slope /= (slope * x).sum()
    bend = (x * x / sigma**2 - 1) * smooth
    bend -= bend.mean()
    bend /= (bend * x * x).sum() / 2
    return tuple(kernel.astype(np.float32) for kernel in (smooth, slope, bend))


def pieces(ridges: Ridges, strong: float, shortest_px: float) -> np.ndarray:
    """(N,) int: the connected piece of line that a point belongs to; 0 where that is too short, or has no ``strong`` point."""
    if not len(ridges.row):
        return np.zeros(0, dtype=np.int32)
    row, column = ridges.row - ridges.row.min(), ridges.column - ridges.column.min()
    mask = np.zeros((row.max() + 1, column.max() + 1), dtype=np.uint8)
    mask[row, column] = 1
    label = cv2.connectedComponents(mask, connectivity=8, ltype=cv2.CV_32S)[1][row, column]
    peak = np.zeros(label.max() + 1)
    np.maximum.at(peak, label, ridges.strength)
    kept = (np.bincount(label) >= shortest_px * POINTS_PER_PX) & (peak >= strong)
    return np.where(kept[label], label, 0)


# --- the two edges of a line --------------------------------------------------------------------------------------------

STEP_PX = 0.25
MOST_ROWS = 20_000  # rows that OpenCV samples at once; it takes fewer than 32 768

EDGE_SIGMA = 1.0  # px by which an image is smoothed before edges are sought across a line


@dataclass(frozen=True)
class Edges:
    """The two edges of a line at N of its points.

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
    smooth, slope, _ = derivative_kernels(EDGE_SIGMA)
    return cv2.merge([cv2.sepFilter2D(image, cv2.CV_32F, across, down, borderType=cv2.BORDER_REPLICATE)
                      for across, down in ((slope, smooth), (smooth, slope))])


def edges_across(gradients: np.ndarray, point: np.ndarray, normal: np.ndarray, polarity: str, reach_px: float) -> Edges:
    """The strongest edge on either side of each of (N, 2) points, within ``reach_px`` along ``normal``.

    gradients  of the image, from :func:`gradient`. These are interpolated, and not the brightness, because OpenCV rounds the
               places of samples to 1/32 px: near the slope's extremum that matters little, but differences of the brightness
               would jump.
    """
    if not len(point):
        return Edges(*np.empty((4, 0)))
    middle = int(np.ceil(reach_px / STEP_PX))
    place = STEP_PX * np.arange(-middle, middle + 1)
    slope = np.empty((len(point), len(place)), dtype=np.float32)
    for first in range(0, len(point), MOST_ROWS):
        rows = slice(first, first + MOST_ROWS)
        at = (point[rows, None] + place[:, None] * normal[rows, None]).astype(np.float32)
        sampled = cv2.remap(gradients, at[..., 0], at[..., 1], cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        slope[rows] = (sampled * normal[rows, None].astype(np.float32)).sum(axis=-1) * (1 if polarity == "dark" else -1)
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
