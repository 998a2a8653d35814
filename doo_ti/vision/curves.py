"""Curves of points in an image or in space: lengths along them, places between their points, and directions across them."""

import numpy as np


def arc_lengths(points: np.ndarray) -> np.ndarray:
    """(N,) length of the curve from the first of ``points`` (N, d) to each."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])


def curve_length(points: np.ndarray) -> float:
    """Length of the curve through ``points`` (N, d)."""
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def placed(place: np.ndarray, arc: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(..., d) points at lengths ``place`` (...) along a curve whose ``points`` (N, d) are at the lengths ``arc`` (N,)."""
    return np.stack([np.interp(place, arc, column) for column in points.T], axis=-1)


def normal_to(direction: np.ndarray) -> np.ndarray:
    """(..., 2) vectors across ``direction`` (..., 2), as long as these."""
    return np.stack([-direction[..., 1], direction[..., 0]], axis=-1)
