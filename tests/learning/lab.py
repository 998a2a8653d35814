"""A small virtual lab, the rods of the development data, and landscapes made by hand, as sweeps would have left them."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from doo_ti import Axis, Grid, InterruptedRunError, Landscape, Material, Observations, Status, sweep
from doo_ti.io.scene import Synthesis
from doo_ti.lab.synthesis import synthesise
from doo_ti.learning import sweeps
from doo_ti.learning.experiment import Experiment, SweepOptions
from tests.relaxation.rods import lab

GRID = Grid((Axis("bend", [2e5, 4e5, 8e5, 1.6e6]), Axis("twist_ratio", [0.5, 1.0, 2.0])))
DYNAMIC = SweepOptions(objective="dynamic")


@cache
def small_lab() -> Observations:
    """Two end distances, end rotations of 0, 60 and 120 degrees."""
    return synthesise(Synthesis(bend=4e5, twist=4e5, end_distances_mm=(42.0, 66.0), end_rotations_deg=(0.0, 60.0, 120.0)))


def interrupted(run: Path, monkeypatch, chunks: int, observations: Observations | None = None, *,
                error: BaseException = KeyboardInterrupt(), said: str | None = None, **options) -> Path:
    """A sweep that an error ends after so many chunks of three cells of six rods, with a message that holds ``said``."""
    work, calls = sweeps.relax_hypotheses, []

    def stopping(*arguments):
        calls.append(arguments)
        if len(calls) > chunks:
            raise error
        return work(*arguments)
    with monkeypatch.context() as patched:
        patched.setattr(sweeps, "CHUNK_BYTES", 18 * 32 * 33)
        patched.setattr(sweeps, "relax_hypotheses", stopping)
        with pytest.raises(InterruptedRunError, match=said):
            sweep(run, small_lab() if observations is None else observations, GRID, **options)
    return run


def lab_rods(folder: Path, name: str, **options) -> tuple[Experiment, Material]:
    """The dynamic experiment on one rod of the development data, and its true material."""
    rod = lab(folder, name)
    return Experiment(rod.observations, GRID, SweepOptions(objective="dynamic", **options)), rod.material


def grid_of(cells: int) -> Grid:
    return Grid((Axis("bend", np.geomspace(1e5, 1e6, cells)),))


def static(name: str, distance: np.ndarray, end_distance=np.nan, stable=True) -> Landscape:
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
