"""Every status, the results of a rod that ends with it, and which arithmetic ended it."""

from dataclasses import replace

import numpy as np
import pytest

from doo_ti import Clamp, Clamps, Descent, Material, Newton, Status, relax, straight_rod
from tests.references.rods import clamps_at, jiggled
from tests.relaxation.rods import wandering

MATERIAL = Material(2e5, 1e5, 1.0)


def bows(rng, count: int = 9):
    rods = wandering(rng, count, 12)
    return jiggled(rods, rng, 0.1), clamps_at(rods)


@pytest.mark.parametrize("precision", ["f64", "f32", "mixed"])
def test_iteration_limit(rng, precision):
    start, clamps = bows(rng)
    solution = relax(start, MATERIAL, clamps, Newton(max_iterations=3), precision=precision)
    assert (solution.status == Status.ITERATION_LIMIT).all() and not solution.stable.any()
    # What f32 could not finish f64 takes over.
    assert (solution.iterations == (3 if precision == "f64" else 6)).all() and (solution.precision == 64).all()
    vertices = solution.configuration.vertices
    assert np.isfinite(solution.energy).all() and np.isfinite(vertices).all()
    np.testing.assert_allclose(np.linalg.norm(np.diff(vertices, axis=1), axis=2), 3.0, atol=1e-5)


def test_stalled(rng):
    """A tolerance below rounding: the rod stops by itself, long before the limit, as good as it can be."""
    start, clamps = bows(rng)
    solution = relax(start, MATERIAL, clamps, Newton(tolerance=1e-17))
    assert (solution.status == Status.STALLED).all() and not solution.stable.any()
    assert (solution.iterations < 100).all() and (solution.residual < 1e-10).all()


@pytest.mark.parametrize("solver", [Newton(), Descent(max_iterations=20)], ids=["newton", "descent"])
@pytest.mark.parametrize("precision", ["f64", "f32", "mixed"])
def test_infeasible_by_a_hair(rng, precision, solver):
    """The clamped edges taken off, the span exceeds the free rest lengths, by any amount above rounding."""
    (start, clamps), frame = bows(rng, 3), np.tile(np.eye(3), (3, 1, 1))
    for excess in (1e-6, 0.1, 100.0):
        ahead = clamps.start_position + [36.0 + excess, 0.0, 0.0]
        beyond = Clamps(Clamp.FRAME, Clamp.FRAME, clamps.start_position, ahead, frame, frame)
        solution = relax(start, MATERIAL, beyond, solver, precision=precision)
        assert (solution.status == Status.INFEASIBLE).all(), excess
        assert np.isnan(solution.energy).all() and not solution.stable.any() and (solution.iterations == 0).all()


@pytest.mark.parametrize("far, status", [(5.0, Status.INFEASIBLE), (29.0, Status.INFEASIBLE), (31.0, Status.CONVERGED)])
def test_an_edge_that_is_longer_than_the_others_and_the_line_together(far, status):
    """Clamps can be too near to each other, too."""
    rod = replace(straight_rod(90.0, 4), rest_length=np.array([10.0, 60.0, 10.0, 10.0]))
    clamps = replace(clamps_at(rod, Clamp.POSITION, Clamp.POSITION), end_position=np.array([[far, 0.0, 0.0]]))
    assert relax(rod, MATERIAL, clamps).status[0] == status


def test_f64_takes_over_what_f32_cannot_finish(rng):
    start, clamps = bows(rng)
    demanding = relax(start, MATERIAL, clamps, Newton(tolerance=1e-9), precision="f32")
    assert (demanding.precision == 64).all() and demanding.converged.all() and demanding.residual.max() <= 1e-9
    np.testing.assert_allclose(demanding.energy, relax(start, MATERIAL, clamps).energy, rtol=1e-10)
