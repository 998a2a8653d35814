"""Landscapes made by hand, as sweeps would have left them."""

from pathlib import Path

import numpy as np

from doo_ti import Axis, Grid, Landscape, Status


def grid_of(cells: int) -> Grid:
    return Grid((Axis("bend", np.geomspace(1e5, 1e6, cells)),))


def static(name: str, distance: np.ndarray, end_distance=np.nan, stable=True) -> Landscape:
    """A landscape under Eq. 2 of distances (G, D)."""
    cells, count = distance.shape
    terms = np.arange(count)
    return Landscape(Path(f"{name}_static"), name, grid_of(cells), "static", distance,
                     np.full(distance.shape, Status.CONVERGED), np.broadcast_to(stable, distance.shape), terms, terms,
                     np.ones(count), np.broadcast_to(np.float64(end_distance), count), np.full(count, np.nan))


def dynamic(name: str, distance: np.ndarray, pairs: list[tuple[int, int]], weight=1.0, end_distance=np.nan) -> Landscape:
    """A landscape under Eq. 3 of distances (G, N) for N ``pairs`` (from, to); ``end_distance`` (D,) of observations."""
    cells, count = distance.shape
    start, target = np.array(pairs).T
    labels = np.full(count, end_distance) if np.isscalar(end_distance) else end_distance[target]
    return Landscape(Path(f"{name}_dynamic"), name, grid_of(cells), "dynamic", distance,
                     np.full(distance.shape, Status.CONVERGED), np.ones(distance.shape, bool), target, start,
                     np.broadcast_to(np.float64(weight), count), labels, np.full(count, np.nan), np.zeros(distance.shape, int))
