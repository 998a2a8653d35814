"""Every status provoked, and what a rod that ends with it reports."""

import numpy as np
import pytest

from doo_ti.errors import InputError
from doo_ti.relaxation.relax import Descent, Newton, relax
from doo_ti.types import Clamp, Clamps, Material, Status
from tests.references.rods import chain, clamps_at, jiggled
from tests.relax.rods import wandering

MATERIAL = Material(2e5, 1e5, 1.0)


def bows(rng, count: int = 9):
    rods = wandering(rng, count, 12)
    return jiggled(rods, rng, 0.1), clamps_at(rods)


def pulled(clamps: Clamps, excess_mm: float, reach_mm: float) -> Clamps:
    """Both end tangents along x and the far end ``excess_mm`` further than the rod reaches."""
    count = len(clamps.start_position)
    frame = np.tile(np.eye(3), (count, 1, 1))
    end = clamps.start_position + [reach_mm + excess_mm, 0.0, 0.0]
    return Clamps(Clamp.FRAME, Clamp.FRAME, clamps.start_position, end, frame, frame)


@pytest.mark.parametrize("precision", ["f64", "f32", "mixed"])
def test_converged(rng, precision):
    start, clamps = bows(rng)
    solution = relax(start, MATERIAL, clamps, precision=precision)
    assert (solution.status == Status.CONVERGED).all() and solution.converged.all() and solution.stable.all()
    tolerance, closure = (1e-6, 1e-7) if precision == "f32" else (1e-9, 1e-12)
    print(f"{precision}: residual up to {solution.residual.max():.1e}, closure up to {solution.closure.max():.1e}")
    assert solution.residual.max() <= tolerance and solution.closure.max() <= closure
    assert (solution.iterations > 1).all()
    tight = relax(start, MATERIAL, clamps, Newton(tolerance=1e-12))
    assert tight.converged.all() and tight.residual.max() <= 1e-12


@pytest.mark.parametrize("precision", ["f64", "f32", "mixed"])
def test_iteration_limit(rng, precision):
    start, clamps = bows(rng)
    solution = relax(start, MATERIAL, clamps, Newton(max_iterations=3), precision=precision)
    assert (solution.status == Status.ITERATION_LIMIT).all() and not solution.stable.any()
    # What f32 could not finish f64 takes over.
    assert (solution.iterations == (3 if precision == "f64" else 6)).all() and (solution.precision == 64).all()
    # What it got to is still a rod in its clamps.
    vertices = solution.configuration.vertices
    assert np.isfinite(solution.energy).all() and np.isfinite(vertices).all()
    np.testing.assert_allclose(np.linalg.norm(np.diff(vertices, axis=1), axis=2), 3.0, atol=1e-5)


def test_iteration_limit_of_descent(rng):
    start, clamps = bows(rng)
    solution = relax(start, MATERIAL, clamps, Descent(max_iterations=7))
    assert (solution.status == Status.ITERATION_LIMIT).all() and (solution.iterations == 7).all()
    assert (solution.residual > 1e-6).all() and np.isfinite(solution.energy).all()


def test_stalled(rng):
    """A tolerance below rounding: the rod stops by itself, long before the limit, as good as it can be."""
    start, clamps = bows(rng)
    solution = relax(start, MATERIAL, clamps, Newton(tolerance=1e-19))
    print(f"f64 floor: residuals {solution.residual.min():.1e} to {solution.residual.max():.1e}")
    assert (solution.status == Status.STALLED).all() and not solution.stable.any()
    assert (solution.iterations < 100).all() and (solution.residual < 1e-12).all()


@pytest.mark.parametrize("solver", [Newton(), Descent(max_iterations=20)], ids=["newton", "descent"])
@pytest.mark.parametrize("precision", ["f64", "f32", "mixed"])
def test_infeasible_by_a_hair(rng, precision, solver):
    """The clamped edges taken off, the span exceeds the free rest lengths, by any amount above rounding."""
    start, clamps = bows(rng, 3)
    for excess in (1e-6, 0.1, 100.0):
        solution = relax(start, MATERIAL, pulled(clamps, excess, 36.0), solver, precision=precision)
        assert (solution.status == Status.INFEASIBLE).all(), excess
        assert np.isnan(solution.energy).all() and not solution.stable.any() and (solution.iterations == 0).all()


def test_a_clamped_edge_counts_for_the_span():
    """Bent back clamps take their edges' length twice: 33 mm of rod cannot span 30 mm so."""
    rod = chain(np.tile([1.0, 0.0, 0.0], (11, 1)), [0, 0, 1], 3.0)
    back = np.diag([-1.0, -1.0, 1.0])[None]
    ends = np.array([[30.0, 0.0, 0.0]])
    backwards = Clamps(Clamp.FRAME, Clamp.FRAME, np.zeros((1, 3)), ends, back, back)
    assert relax(rod, MATERIAL, backwards).status[0] == Status.INFEASIBLE
    forwards = Clamps(Clamp.FRAME, Clamp.FRAME, np.zeros((1, 3)), ends, np.eye(3)[None], np.eye(3)[None])
    assert relax(rod, MATERIAL, forwards).status[0] == Status.CONVERGED
    positions = Clamps(Clamp.POSITION, Clamp.POSITION, np.zeros((1, 3)), ends, back, back)
    assert relax(rod, MATERIAL, positions).status[0] == Status.CONVERGED


@pytest.mark.parametrize("bad", [
    lambda: Newton(tolerance=0.0), lambda: Newton(tolerance=-1e-9), lambda: Newton(max_iterations=0),
    lambda: Newton(max_rotation=0.0), lambda: Newton(max_rotation=2.0), lambda: Newton(first_shift=-1.0),
    lambda: Newton(tolerance=np.nan), lambda: Descent(tolerance=0.0), lambda: Descent(max_iterations=0),
    lambda: Descent(largest_move=0.0), lambda: Descent(largest_move=0.5)])
def test_options_out_of_range_are_refused(bad):
    with pytest.raises(InputError) as caught:
        bad()
    assert caught.value.field and caught.value.remedy
