"""Where on a landscape to begin a refinement, and the best of several (§III-E)."""

from collections.abc import Sequence

import numpy as np

from doo_ti.dataset import Observations
from doo_ti.grid import Grid
from doo_ti.refinement.parametrisation import Theta
from doo_ti.refinement.refine import Refinement, RefinementOptions, refine
from doo_ti.types import Clamps


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


def refine_from(observations: Observations, clamps: Clamps, thetas: Sequence[Theta],
                options: RefinementOptions = RefinementOptions()) -> tuple[Refinement, ...]:
    """Refinements from each of ``thetas``, the best first: the one with most rods, and of those with the smallest misfit."""
    found = [refine(observations, clamps, theta, options) for theta in thetas]
    return tuple(sorted(found, key=lambda one: (-one.used.sum(), one.reduced_chi_square if one.sigma is None else one.sigma)))
