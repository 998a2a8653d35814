"""A few rods of each hard row: every rod has a status, and its status is correct; of a thousand nearly all converge."""

from functools import cache

import numpy as np
import pytest

from doo_ti import Clamp, Solution, Status
from doo_ti.relaxation.newton import TOLERANCES
from tests.oracle.chain_form import rod_of
from tests.oracle.equilibrium import State, clamped_start
from tests.oracle.external import minimum
from tests.relaxation.hard_rods import PRECISIONS, ROWS, Rods, edge_error, rods_of
from tests.relaxation.rods import vertex_distance

COUNT = 8
SAME = 0.02  # mm, mean vertex distance of two rods in the same minimum
LEAST = 5  # rods of a row that converge in f64 and in mixed, or else there is nothing to compare
NAMELESS = (Status.NOT_FINITE, Status.INFEASIBLE)

every_row = pytest.mark.parametrize("row", ROWS)


@cache
def hard(row: str) -> Rods:
    return rods_of(row, COUNT)


@cache
def relaxed(row: str, precision: str) -> Solution:
    return hard(row).relaxed(precision)


@pytest.mark.parametrize("precision", PRECISIONS)
@every_row
def test_every_status_is_right(row, precision):
    """Nothing is NaN without saying so; converged means residual, closure and edge lengths."""
    solution, clamps = relaxed(row, precision), hard(row).clamps
    assert np.isin(solution.status, list(Status)).all() and np.isin(solution.precision, (32, 64)).all()
    sound = ~np.isin(solution.status, NAMELESS)
    for values in (solution.energy, solution.residual, solution.closure):
        assert np.isfinite(values[sound]).all()
    assert np.isfinite(solution.configuration.vertices[sound]).all()
    assert (solution.iterations[sound] > 0).all()
    assert not solution.stable[~solution.converged].any()
    assert (solution.status != Status.INFEASIBLE).all()
    done = solution.converged
    coarse = solution.precision[done] == 32
    assert (solution.residual[done] <= np.where(coarse, TOLERANCES[32], TOLERANCES[64])).all()
    # mm: the edges to rounding, the far end within what closure is asked for; in f32 the edges' rounding adds up along the rod.
    assert (edge_error(solution.configuration)[done] <= np.where(coarse, 1e-5, 1e-10)).all()
    vertices, frames = solution.configuration.vertices[done], solution.configuration.frames[done]
    np.testing.assert_array_equal(vertices[:, 0], clamps.start_position[done])
    if clamps.end != Clamp.FREE:
        miss = np.linalg.norm(vertices[:, -1] - clamps.end_position[done], axis=1)
        assert (miss <= np.where(coarse, 1e-4, 1e-10)).all(), miss
    for kind, edge, held in ((clamps.start, 0, clamps.start_frame), (clamps.end, -1, clamps.end_frame)):
        if kind == Clamp.FRAME:
            np.testing.assert_allclose(frames[:, edge], held[done], atol=1e-6 if coarse.any() else 1e-14)


@every_row
def test_mixed_and_f64_have_one_energy_where_they_are_in_one_minimum(row):
    exact, mixed, material = relaxed(row, "f64"), relaxed(row, "mixed"), hard(row).material
    both = exact.converged & mixed.converged
    assert both.sum() >= LEAST
    apart = vertex_distance(exact.configuration, mixed.configuration)
    same = both & (apart <= SAME)
    scale = np.abs(exact.energy) + np.linalg.eigvalsh(material.bend[:, 0])[:, -1] / 99.0
    difference = np.abs(exact.energy - mixed.energy) / scale
    print(f"{row}: {same.sum()} of {both.sum()} in one minimum, up to {difference[same].max(initial=0):.1e} of the energy "
          f"apart, the others {np.sort(difference[both & ~same])}")
    assert (difference[same] <= 1e-8).all()
    # A rod without weight swings about its line at no cost: other places, the same energy.
    alike = difference <= 1e-8 if row.endswith("no weight") else same
    assert (alike & both).sum() >= LEAST - 2


@pytest.mark.parametrize("row", [row for row in ROWS if row != "512 edges"])
def test_dense_linear_algebra_agrees_with_the_reported_rod(row):
    """Residual, energy and certificate of one converged rod of each row, in f64, from full matrices."""
    rods, solution = hard(row), relaxed(row, "f64")
    at = int(np.flatnonzero(solution.converged)[0])
    rod = rod_of(rods.start, rods.material, at)
    _, ends = clamped_start(rods.start, rods.clamps, at)
    found = State(solution.configuration.start[at], solution.configuration.quaternions[at])
    dense = minimum(rod, None, found, ends, max_iterations=0)
    softest = dense.smallest_eigenvalue / dense.eigenvalues[-1]
    print(f"{row}: residual {solution.residual[at]:.1e}, dense {dense.residual:.1e}, softest eigenvalue {softest:.1e}")
    assert solution.energy[at] == pytest.approx(dense.energy, rel=1e-10)
    if solution.stable[at]:
        assert softest > -1e-11
    # A rod that sags more than it resists is judged by its largest gravity moment instead of B.
    assert row.startswith("soft") or dense.residual <= 1e-8


@pytest.mark.slow
@every_row
def test_mixed_converges_on_99_percent_of_a_thousand(row):
    """Of those that are feasible."""
    solution = rods_of(row, 1000).relaxed("mixed")
    assert solution.converged[solution.status != Status.INFEASIBLE].mean() >= 0.99
