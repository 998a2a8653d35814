"""The force at the far clamp is the derivative of the energy with respect to the clamp's position."""

from dataclasses import replace

import numpy as np
import pytest

from doo_ti import Clamp, Material, Newton, relax
from doo_ti.relaxation.newton import TOLERANCES
from tests.references.rods import chain, clamps_at, jiggled


def taut(slack: float, kind: Clamp):
    """99 mm of straight rod along (0.6, 0.8, 0), 0.4 turns of twist in it, and clamps by ``slack`` of its length closer."""
    rod = chain(np.tile([0.6, 0.8, 0.0], (33, 1)), [0, 0, 1], 3.0, spin=0.8 * np.pi * np.arange(33) / 32)
    clamps = clamps_at(rod, kind, kind)
    return rod, replace(clamps, end_position=(1 - slack) * clamps.end_position)


@pytest.mark.parametrize("precision", ["f64", "f32", "mixed"])
@pytest.mark.parametrize("kind", [Clamp.FRAME, Clamp.POSITION], ids=lambda kind: kind.name.lower())
@pytest.mark.parametrize("weight", [0.0, 1.0])
@pytest.mark.parametrize("slack", [0.0, 1e-9])
def test_the_pull_on_a_taut_rod_is_undetermined(slack, weight, kind, precision):
    """Converged, certified, and NaN where the force is not determined: any tension keeps the rod straight."""
    rod, clamps = taut(slack, kind)
    solution = relax(rod, Material(6e5, 8e5, weight), clamps, precision=precision)
    assert solution.converged.all() and solution.stable.all() and np.isfinite(solution.energy).all()
    assert np.isnan(solution.end_force).all()
    assert solution.residual[0] < TOLERANCES[solution.precision[0]]
    assert solution.closure[0] == pytest.approx(slack, abs=1e-12 if solution.precision[0] == 64 else 2e-7)


@pytest.mark.parametrize("precision", ["f64", "f32 only"])
def test_the_residual_of_a_taut_rod_is_its_moment_about_the_tangents(rng, precision):
    """Stopped before it is at rest: E = Σ β m²/l̄, and of each free frame |∂E/∂θ| L/α."""
    rod, clamps = taut(0.0, Clamp.FRAME)
    solution = relax(jiggled(rod, rng, 0.05), Material(6e5, 8e5), clamps, Newton(max_iterations=1), precision=precision)
    frames = solution.configuration.frames[0]
    m1, m2 = frames[..., 1], frames[..., 2]
    twist = np.arctan2(np.sum(m1[1:] * m2[:-1], axis=1), np.sum(m1[1:] * m1[:-1], axis=1))
    moment = np.abs(np.diff(2 * 8e5 * twist / 6.0)).max()
    assert moment > 100 and np.isnan(solution.end_force).all()
    assert solution.residual[0] == pytest.approx(moment * 99.0 / 6e5, rel=1e-9 if precision == "f64" else 1e-4)


@pytest.mark.parametrize("kind", [Clamp.FRAME, Clamp.POSITION], ids=lambda kind: kind.name.lower())
def test_a_rod_with_a_little_slack_is_pulled_ever_harder(kind):
    """Up to where it is taut the pull is known; half of its weight hangs from either end, however little it sags."""
    rods = [taut(slack, kind) for slack in (2e-6, 2e-7)]
    found = [relax(rod, Material(6e5, 8e5, 1.0), clamps) for rod, clamps in rods]
    pulls = np.array([solution.end_force[0] for solution in found])
    np.testing.assert_allclose(pulls[:, 2], 99.0, rtol=1e-6)
    along = pulls @ [0.6, 0.8, 0.0]
    assert all(solution.converged.all() for solution in found) and 2 * along[0] < along[1] < 4 * along[0]
