"""A part of a grid spread evenly over it, where all of it would be too much to keep."""

import numpy as np


def thinned(shape: tuple[int, ...], most: int, kept: list[tuple[int, ...]]) -> tuple[np.ndarray, ...]:
    """For each axis of a grid of ``shape`` the ascending indices to keep, so that together they are at most ``most`` cells.

    They are spread evenly, both ends included, and hold all cells ``kept`` (an index per axis each), which may take more
    cells than ``most``.
    """
    needed = [sorted({int(cell[axis]) for cell in kept}) for axis in range(len(shape))]
    least = [max(min(2, size), len(some)) for size, some in zip(shape, needed, strict=True)]
    counts = list(shape)
    while np.prod(counts) > most and counts != least:
        spare = [count if count > low else 0 for count, low in zip(counts, least, strict=True)]
        counts[int(np.argmax(spare))] -= 1
    return tuple(_spread(size, count, some) for size, count, some in zip(shape, counts, needed, strict=True))


def _spread(size: int, count: int, needed: list[int]) -> np.ndarray:
    """``count`` indices below ``size``, evenly, each of ``needed`` in place of the nearest."""
    found = np.round(np.linspace(0, size - 1, count)).astype(int)
    free = np.ones(count, dtype=bool)
    for index in needed:
        nearest = int(np.argmin(np.where(free, np.abs(found - index), size)))
        found[nearest], free[nearest] = index, False
    return np.sort(found)
