"""How alike the pixels of an image are to the thread's colours: exp(−(d/τ)²) of the distance d in CIE Lab to the nearest of
them, 255 where equal. A thread becomes a light line on dark, whatever its background."""

from collections.abc import Sequence

import numpy as np

TOLERANCE = 18.0
"""τ: distances in Lab by which shading changes a colour."""
_STEPS = 64
"""Levels of each channel in the table of colours: within one, Lab differs by some 2."""


def lab(colours: np.ndarray) -> np.ndarray:
    """(..., 3) CIE Lab, L from 0 to 100, of (..., 3) B, G, R from 0 to 255."""
    import cv2

    flat = np.ascontiguousarray(colours, dtype=np.float32).reshape(1, -1, 3) / 255
    return cv2.cvtColor(flat, cv2.COLOR_BGR2LAB).reshape(np.shape(colours))


def likeness_table(colours: Sequence[np.ndarray], tolerance: float = TOLERANCE) -> np.ndarray:
    """(64, 64, 64) float32 likeness, 0 to 255, of blue, green and red to any of the ``colours``, each (3,) in Lab."""
    level = (np.arange(_STEPS) + 0.5) * (256 / _STEPS) - 0.5
    cells = lab(np.stack(np.meshgrid(level, level, level, indexing="ij"), axis=-1))
    nearest = np.min([((cells - np.float32(colour)) ** 2).sum(axis=-1) for colour in colours], axis=0)
    return 255 * np.exp(-nearest / tolerance**2, dtype=np.float32)


def likeness(image: np.ndarray, table: np.ndarray) -> np.ndarray:
    """(H, W) float32 likeness of an image (H, W, 3) uint8 in OpenCV's order, by a table of :func:`likeness_table`."""
    blue, green, red = (image[..., channel] // (256 // _STEPS) for channel in range(3))
    return table[blue, green, red]


def as_colour(image: np.ndarray) -> np.ndarray:
    """(H, W, 3) uint8 of an image (H, W) or (H, W, 3) with levels from 0 to 255."""
    levels = image if image.dtype == np.uint8 else np.clip(np.nan_to_num(image), 0, 255).round().astype(np.uint8)
    return levels if levels.ndim == 3 else np.repeat(levels[..., None], 3, axis=2)
