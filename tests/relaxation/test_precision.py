"""The precision ladder: f32, f64 and mixed end in the same minima; ``precision`` says which arithmetic ended a rod."""

import numpy as np
import pytest

from doo_ti import Material, Newton, relax
from doo_ti.relaxation.newton import TOLERANCES
from tests.references.rods import clamps_at, jiggled
from tests.relaxation.lab import vertex_distance
from tests.relaxation.rods import definite, wandering

SAME = 0.02  # mm, mean vertex distance of two rods in the same minimum


@pytest.mark.parametrize("kind", ["isotropic", "general"])
def test_random_rods(rng, kind):
    rods = wandering(rng, 40, 33, 3.0)
    material = Material(6e5, 5e5, 1.0) if kind == "isotropic" else Material(definite(rng, 40), 1e5, 1.0)
    start, clamps = jiggled(rods, rng, 0.05), clamps_at(rods)
    solutions = {name: relax(start, material, clamps, precision=name) for name in ("f64", "f32", "mixed")}
    for name, solution in solutions.items():
        assert (solution.converged & solution.stable).all(), name
        assert (vertex_distance(solution.configuration, solutions["f64"].configuration) < SAME).mean() >= 0.9, name
        assert solution.residual.max() <= TOLERANCES[32 if name == "f32" else 64]
    assert (solutions["f64"].precision == 64).all() and (solutions["mixed"].precision == 64).all()
    assert (solutions["f32"].precision == 32).mean() > 0.9


def test_f64_takes_over_what_f32_cannot_finish(rng):
    rods = wandering(rng, 10, 12)
    start, clamps = jiggled(rods, rng, 0.05), clamps_at(rods)
    material = Material(2e5, 1e5, 1.0)
    plain = relax(start, material, clamps, precision="f32")
    assert (plain.precision == 32).all() and plain.configuration.quaternions.dtype == np.float64
    demanding = relax(start, material, clamps, Newton(tolerance=1e-9), precision="f32")
    assert (demanding.precision == 64).all() and demanding.converged.all() and demanding.residual.max() <= 1e-9
    np.testing.assert_allclose(demanding.energy, relax(start, material, clamps).energy, rtol=1e-10)
