"""Where points lie, for what is drawn around them: finite for any points, also for a single one, or none."""

import numpy as np

A_POINT, ROOM = 1e-9, 1.0
"""Of the coordinates, below which a box is a point; and how wide such a box is drawn, mm."""


def box(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(..., k) lowest and highest coordinates of the finite ones among (..., N, k) points; the origin where none is finite."""
    finite = np.isfinite(points).all(axis=-1, keepdims=True)
    some = finite.any(axis=-2)
    low = np.where(finite, points, np.inf).min(axis=-2, initial=np.inf)
    high = np.where(finite, points, -np.inf).max(axis=-2, initial=-np.inf)
    return np.where(some, low, 0.0), np.where(some, high, 0.0)


def widest(low: np.ndarray, high: np.ndarray) -> float:
    """The longest side of boxes with the corners (..., k), mm; that of a point is :data:`ROOM`."""
    side = float(np.max(high - low))
    return side if side > A_POINT * float(np.max(np.maximum(np.abs(low), np.abs(high)))) else ROOM


def deviations(points: np.ndarray, axis: int = -2) -> np.ndarray:
    """Points (..., k) less the mean of the finite ones along ``axis``; zero where they are not finite."""
    finite = np.isfinite(points).all(axis=-1, keepdims=True)
    mean = np.sum(points, axis=axis, keepdims=True, where=finite) / np.maximum(finite.sum(axis=axis, keepdims=True), 1)
    return np.where(finite, points - mean, 0.0)
