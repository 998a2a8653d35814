"""Ridges of an image to a fraction of a pixel (Steger, *An unbiased detector of curvilinear structures*, 1998), and the edges
beside them.

On a line the brightness, smoothed to about the line's width, has an extremum across it: the first derivative along the
eigenvector n of the Hessian is zero and the second is large. From the derivatives g and H at a pixel, the extremum lies at

    t n with t = −(g·n) / (nᵀ H n).

At the border of something wide the first derivative is not zero, so that borders are no ridges.

A round thread lit from one side is brighter on that side; the extremum of its brightness then lies off its middle, but the
middle between its edges does not.

How the thread looks, dark or light, how wide, how distinct, and roughly where, is found by them on a pyramid of ever coarser
images: a line stands out as a ridge at the level that fits its width.

Likeness to the thread's colours is exp(−(d/τ)²) of the distance d in CIE Lab to the nearest of them, 255 where equal. A thread
becomes a light line on dark, whatever its background. Where it is lit from one side likeness is largest on one side of it: so
likeness says which line is the thread, and the edges in the image itself where it is.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import cv2
import numpy as np
from scipy.spatial import cKDTree

from doo_ti.rod.frames import normal_to, unit_vectors

REACH_PX = 0.75  # pixels this near to a line give a point of it, so that points are at most a pixel apart in any direction
FIRST_REACH_PX, FIRST_REACH = 2.0, 0.5
"""Bounds of t before edges are found, px and over σ: t is too large away from the ridge, and uncertain on flat ridges."""
WORKING_WIDTH = 16.0  # px: wider threads are sought in halved images, where they take no longer, and borders are smoother
POINTS_PER_PX = 2 * REACH_PX  # mean number of points per px of a line
ROUNDNESS = 0.6  # largest curvature along the line, of the same sign, over that across; with more it is a speck or a crossing


@dataclass(frozen=True)
class Ridges:
    """Points of ridges, one for each of N pixels near one."""

    point: np.ndarray  # (N, 2) px, x and y
    offset: np.ndarray  # (N,) px from the pixel along the normal to the point
    normal: np.ndarray  # (N, 2) unit vectors across, of either sign
    strength: np.ndarray  # (N,) grey levels: the second derivative across times σ², 0.48 of the contrast of a bar 2 σ wide
    row: np.ndarray  # (N,) the pixels
    column: np.ndarray  # (N,)

    def __getitem__(self, kept: np.ndarray) -> "Ridges":
        return Ridges(*(getattr(self, field.name)[kept] for field in fields(self)))

    def moved(self, shift: np.ndarray) -> "Ridges":
        """The same with the points ``shift`` (N,) px farther along their normals."""
        return replace(self, point=self.point + shift[:, None] * self.normal, offset=self.offset + shift)

    @property
    def tangent(self) -> np.ndarray:
        """(N, 2) unit vectors along, of either sign."""
        return normal_to(self.normal)


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
        normal = unit_vectors(np.stack([np.where(flat, deviator + half, xy), np.where(flat, xy, deviator - half)], axis=1))
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
ROWS = 4096  # points that are sampled at once: few stay in the processor's cache, and OpenCV takes fewer than 32 768

EDGE_SIGMA = 1.0  # px by which an image is smoothed before edges are sought across a line


@dataclass(frozen=True)
class Edges:
    """The two edges of a line at N of its points."""

    shift: np.ndarray  # (N,) px from the point along its normal to the middle between the edges
    width: np.ndarray  # (N,) px between the edges
    slope: np.ndarray  # (N,) grey levels per px: the weaker edge's
    balance: np.ndarray  # (N,) the weaker edge's slope over the stronger one's: 0 where only one side differs from the line


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
    middle, sign = int(np.ceil(reach_px / STEP_PX)), 1 if polarity == "dark" else -1
    place, found = STEP_PX * np.arange(-middle, middle + 1), np.empty((4, len(point)))
    for first in range(0, len(point), ROWS):
        rows = slice(first, first + ROWS)
        x, y = ((point[rows, k, None] + place * normal[rows, k, None]).astype(np.float32) for k in (0, 1))
        along, down = cv2.split(cv2.remap(gradients, x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE))
        across = normal[rows].astype(np.float32) * sign
        slope = along * across[:, :1] + down * across[:, 1:]
        left, fall = peak(-slope[:, middle::-1])
        right, rise = peak(slope[:, middle:])
        left, right, weaker = -left * STEP_PX, right * STEP_PX, np.minimum(fall, rise)
        found[:, rows] = (left + right) / 2, right - left, weaker, weaker / np.maximum(np.maximum(fall, rise), 1e-30)
    return Edges(*found)


def edges_about(image: np.ndarray, point: np.ndarray, normal: np.ndarray, polarity: str, width: float
                ) -> tuple[Edges, np.ndarray]:
    """The edges of a line ``width`` px wide in an image (H, W) float32, and (N,) bool: they are about that far apart."""
    edges = edges_across(gradient(image), point, normal, polarity, 0.75 * width + 2)
    return edges, (edges.width > width / 2) & (edges.width < 1.5 * width + 1)


def peak(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Place, in columns, and height of each row's highest value, by the parabola through it and its neighbours."""
    rows = np.arange(len(values))
    at = np.clip(np.argmax(values, axis=1), 1, values.shape[1] - 2)
    before, here, after = values[rows, at - 1], values[rows, at], values[rows, at + 1]
    bend = before - 2 * here + after
    offset = np.clip(np.where(bend < 0, (before - after) / (2 * np.where(bend < 0, bend, -1)), 0), -1, 1)
    return at + offset, np.maximum(here, 0)


# --- how the thread looks --------------------------------------------------------------------------------------------------

LEVELS = 5  # levels of the pyramid above the image itself: halves to 32nds, for threads up to some 150 px wide
SIGMA = 1.2  # smoothing, px of a level
SURE = 7.0  # times the noise: strength of lines that are certainly not noise
BAR = 0.4  # strength over contrast of a line at the level that fits it
SHORTEST = 5.0  # px of a level: shorter pieces are regarded as noise
SLENDER = 16.0  # px of a level: least length of a slender piece, a few px wide
BLUR_PX = 4.0  # largest standard deviation of the blur of a thread's edge; edges with more are shading of the background
LEAST_BALANCE = 0.25  # least ratio of the slopes of a thread's two edges; with less, the line is the border of something else
WITHIN = 0.8  # least share of a glint that is in the thread
SAMPLES = 400  # largest number of points where the width is measured


@dataclass(frozen=True)
class Appearance:
    """How the thread looks in an image."""

    polarity: str  # "dark" or "light" against the background
    width_px: float  # median distance between its edges
    slope: float  # grey levels per px of its edges, smoothed by EDGE_SIGMA
    box: tuple[int, int, int, int]  # left, top, right, bottom of the box around it in px, right and bottom exclusive
    shiny: bool = False  # glints within it are more distinct than it


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
    found.sort(key=lambda entry: -entry[0])
    for k, (score, sign, scale, ridges, slender) in enumerate(found):
        look = _measured(image, ridges, slender, sign, scale, width_px) if score > 0 else None
        if look is None:
            continue
        for _, other, coarse, around, apart in found[k + 1 :]:  # of a glint the thread that it is in
            if other == sign or coarse <= scale or not apart.any():
                continue
            off = cKDTree(coarse * around.point[apart]).query(scale * ridges.point[slender])[0]
            if np.average(off <= 1.5 * coarse, weights=ridges.strength[slender] ** 3) >= WITHIN:
                thread = _measured(dull(image, other, 2 * look.width_px), around, apart, other, coarse, width_px)
                if thread is not None and thread.width_px > 2 * look.width_px:
                    return replace(thread, shiny=True)
        return look
    return None


def dull(image: np.ndarray, polarity: str, widest: float) -> np.ndarray:
    """An image (H, W) of a thread of that polarity without what is unlike it and at most ``widest`` px wide, such as glints."""
    side = int(widest) // 2 * 2 + 1
    return cv2.morphologyEx(image, cv2.MORPH_OPEN if polarity == "dark" else cv2.MORPH_CLOSE, np.ones((side, side)))


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


# --- colours ---------------------------------------------------------------------------------------------------------------

TOLERANCE = 18.0  # τ: distances in Lab by which shading changes a colour
_STEPS = 64  # levels of each channel in the table of colours: within one, Lab differs by some 2


def lab(colours: np.ndarray) -> np.ndarray:
    """(..., 3) CIE Lab, L from 0 to 100, of (..., 3) B, G, R from 0 to 255."""
    flat = np.ascontiguousarray(colours, dtype=np.float32).reshape(1, -1, 3) / 255
    return cv2.cvtColor(flat, cv2.COLOR_BGR2LAB).reshape(np.shape(colours))


def likeness_table(colours: Sequence[np.ndarray], tolerance: float = TOLERANCE, shaded: bool = False) -> np.ndarray:
    """(64, 64, 64) float32 likeness, 0 to 255, of blue, green and red to any of the ``colours``, each (3,) in Lab.

    shaded  less light multiplies (L + 16, a, b), the cube roots of intensities, by a number. Along this line colours are as
            much nearer as the colour is saturated: what is grey is known by its lightness alone
    """
    level = (np.arange(_STEPS) + 0.5) * (256 / _STEPS) - 0.5
    cells = lab(np.stack(np.meshgrid(level, level, level, indexing="ij"), axis=-1))
    nearest = np.min([_squared(cells, np.float32(colour), tolerance, shaded) for colour in colours], axis=0)
    return 255 * np.exp(-nearest / tolerance**2, dtype=np.float32)


def _squared(cells: np.ndarray, colour: np.ndarray, tolerance: float, shaded: bool) -> np.ndarray:
    """Squared distances of ``cells`` (..., 3) from a colour (3,), as :func:`likeness_table` takes them."""
    away = cells - colour
    square = (away**2).sum(axis=-1)
    if shaded:
        chroma = (colour[1:] ** 2).sum() / tolerance**2
        square -= (away @ unit_vectors(colour + np.float32([16, 0, 0]))) ** 2 * np.float32(chroma / (1 + chroma))
    return square


def likeness(image: np.ndarray, table: np.ndarray) -> np.ndarray:
    """(H, W) float32 likeness of an image (H, W, 3) uint8 in OpenCV's order, by a table of :func:`likeness_table`."""
    blue, green, red = (image[..., channel] // (256 // _STEPS) for channel in range(3))
    return table[blue, green, red]


def between_edges(image: np.ndarray, point: np.ndarray, tangent: np.ndarray, width: float
                  ) -> tuple[np.ndarray, float]:
    """(N, 2) points of a line about ``width`` px wide with ``tangent`` (N, 2), each moved across to the middle between the
    line's edges in an image (H, W, 3) uint8, and px between these: those in the channel of Lab, and of the polarity, in which
    they are most distinct. Of a thread lit from one side, only that side may be alike in colour."""
    normal = normal_to(tangent)
    channels = [gradient(np.ascontiguousarray(part)) for part in cv2.split(lab(image))]
    found = [edges_across(slopes, point, normal, sign, 1.25 * width + 2) for slopes in channels for sign in ("dark", "light")]
    edges = found[int(np.argmax([np.median(one.slope) for one in found]))]
    sound = (edges.balance > LEAST_BALANCE) & (edges.width > width / 2) & (edges.width < 2.5 * width + 1)
    if 2 * sound.sum() < len(point):
        return point, width
    # Where something hides an edge the line is moved as beside that.
    nearest = np.flatnonzero(sound)[cKDTree(point[sound]).query(point)[1]]
    return point + edges.shift[nearest, None] * normal[nearest], float(np.median(edges.width[sound]))


def as_colour(image: np.ndarray) -> np.ndarray:
    """(H, W, 3) uint8 of an image (H, W) or (H, W, 3) with levels from 0 to 255."""
    levels = image if image.dtype == np.uint8 else np.clip(np.nan_to_num(image), 0, 255).round().astype(np.uint8)
    return levels if levels.ndim == 3 else np.repeat(levels[..., None], 3, axis=2)
