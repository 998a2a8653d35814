"""Where on a landscape to begin a refinement (§III-E)."""

import numpy as np

from doo_ti.grid import Grid
from doo_ti.refinement.unknowns import Theta


def lowest_cells(grid: Grid, mean_distance: np.ndarray, count: int) -> np.ndarray:
    """Up to ``count`` cells of a landscape (G,) that no neighbour along any axis is below, the lowest first.

    Cells that are NaN are none, and bound nobody.
    """
    height = np.nan_to_num(np.asarray(mean_distance, dtype=np.float64), nan=np.inf).reshape(grid.shape)
    lowest = np.isfinite(height)
    for axis in range(height.ndim):
        wall = np.full_like(np.take(height, [0], axis=axis), np.inf)
        beside = np.concatenate([wall, height, wall], axis=axis)
        size = height.shape[axis]
        for shift in (0, 2):
            lowest &= height <= np.take(beside, np.arange(shift, shift + size), axis=axis)
    cells = np.flatnonzero(lowest)
    return cells[np.argsort(height.ravel()[cells], kind="stable")][:count]


def theta_of_cell(grid: Grid, cell: int, up) -> Theta:
    """Θ of a grid's cell."""
    return Theta.of(grid.materials(np.array([cell])), up=up)
