"""The centre line that was found in an image: points with directions and widths."""

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from doo_ti.system.arguments import typed


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

    def copy(self) -> "Detection":
        """The same in arrays of its own."""
        arrays = {name: getattr(self, name).copy() for name in ("points", "direction", "strength")}
        return replace(self, **arrays, width=None if self.width is None else self.width.copy())

    @property
    def count(self) -> int:
        return len(self.points)


def thinned(detection: Detection) -> tuple[np.ndarray, np.ndarray]:
    """The strongest point of each pixel (N', 2), and its direction: about one for each pixel of line."""
    order = np.argsort(-detection.strength, kind="stable")
    cells = np.round(detection.points[order]).astype(np.int64)
    _, first = np.unique(cells[:, 1] * (detection.shape[1] + 1) + cells[:, 0], return_index=True)
    kept = order[np.sort(first)]
    return detection.points[kept], detection.direction[kept]


def moved(detection: Detection, corner: tuple[int, int]) -> Detection:
    """What was detected in a region that begins at ``corner``, in px of the whole image."""
    return replace(detection, points=detection.points + corner) if any(corner) else detection


def in_whole_pixels(scale: float, points: np.ndarray, direction: np.ndarray, *values: np.ndarray) -> tuple[np.ndarray, ...]:
    """Points with directions and (N,) ``values`` of an image that has one pixel for ``scale``, in px of the image itself and
    again at most a pixel apart."""
    if scale == 1:
        return points, direction, *values
    between = np.arange(scale) - (scale - 1) / 2
    points = (scale * points[:, None] + between[:, None] * direction[:, None]).reshape(-1, 2)
    return points, *(np.repeat(array, len(between), axis=0) for array in (direction, *values))
