"""The paper's own scheme against Newton, from the same starts: same minima, and its stopping criteria."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from doo_ti import Clamp, Descent, Material, Newton, Status, relax
from tests.references.rods import clamps_at, jiggled
from tests.relaxation.rods import PAIRS, definite, vertex_distance, wandering, with_kinds

SAME = 0.02  # mm


@pytest.mark.parametrize("kind", ["isotropic", "general"])
def test_every_pair_of_clamps(rng, kind):
    """Both schemes start at the same closed shape and take small steps: same energies to what 1e-7 leaves of them."""
    rods = wandering(rng, len(PAIRS), 8, 3.0, wander=0.2)
    clamps, start = with_kinds(clamps_at(rods), PAIRS), jiggled(rods, rng, 0.02)
    bend = 2e5 if kind == "isotropic" else definite(rng, len(PAIRS), 8)
    material = Material(bend, 1.5e5, 200.0)
    newton = relax(start, material, clamps, Newton.careful())
    descent = relax(start, material, clamps, Descent(tolerance=1e-5, max_iterations=60_000))
    apart = vertex_distance(newton.configuration, descent.configuration)
    # Two that hang by one point may turn about the vertical.
    settled = np.array([{Clamp.FREE, Clamp.POSITION} != set(pair) for pair in PAIRS])
    assert newton.converged.all() and descent.converged.all() and (apart[settled] < SAME).all()
    np.testing.assert_allclose(descent.energy, newton.energy, rtol=1e-7)
    assert descent.residual.max() <= 1e-5 and descent.closure.max() <= 1e-12


def test_statuses(rng):
    rods = wandering(rng, 3, 10)
    clamps, start, material = clamps_at(rods), jiggled(rods, rng, 0.05), Material(3e5, 2e5, 1.0)
    loose, tight = (relax(start, material, clamps, Descent(tolerance=tolerance)) for tolerance in (1e-1, 1e-3))
    assert loose.converged.all() and loose.residual.max() <= 1e-1 and loose.iterations.max() < tight.iterations.min()
    short = relax(start, material, clamps, Descent(max_iterations=3))
    assert (short.status == Status.ITERATION_LIMIT).all() and not short.stable.any()
    double, single = (relax(start, material, clamps, Descent(tolerance=1e-2), precision=name) for name in ("f64", "f32"))
    assert single.converged.all()
    np.testing.assert_allclose(single.energy, double.energy, rtol=1e-3)


def test_far_starts_are_closed_or_said_not_to_be(rng):
    rods = wandering(rng, 40, 20, 3.0)
    clamps = clamps_at(rods)
    turned = Rotation.random(40, random_state=rng).as_matrix()
    away = turned[:, 0] * np.linspace(3.0, 45.0, 40)[:, None]
    far = replace(clamps, end_position=clamps.start_position + away, end_frame=turned)
    newton = relax(rods, Material(3e5, 2e5, 1.0), far)
    assert newton.converged.all() and newton.closure.max() < 1e-12
    descent = relax(rods, Material(3e5, 2e5, 1.0), far, Descent(tolerance=1e-3, max_iterations=30_000))
    assert (descent.closure[descent.converged] <= 1e-12).all() and descent.converged.mean() > 0.9
