"""The precision ladder: f32, f64 and mixed end in the same minima; ``precision`` says which arithmetic ended a rod."""

import numpy as np
import pytest

from doo_ti import Material, Newton, relax
from doo_ti.relaxation.newton import TOLERANCES
from tests.references.rods import clamps_at, jiggled
from tests.relaxation.lab import SUTURES, lab, vertex_distance
from tests.relaxation.rods import definite, wandering

SAME = 0.02  # mm, mean vertex distance of two rods in the same minimum


def compared(start, material, clamps, **index) -> dict:
    solutions = {name: relax(start, material, clamps, precision=name, **index) for name in ("f64", "f32", "mixed")}
    for name, solution in solutions.items():
        apart = vertex_distance(solution.configuration, solutions["f64"].configuration)
        print(f"{name}: {np.mean(solution.converged & solution.stable):.1%} converged and stable, "
              f"{np.mean(solution.precision == 64):.1%} ended in f64, {solution.iterations.mean():.1f} iterations, "
              f"from f64 median {np.median(apart):.1e}, most {apart.max():.1e} mm")
    return solutions


@pytest.mark.parametrize("kind", ["isotropic", "general"])
def test_random_rods(rng, kind):
    rods = wandering(rng, 40, 33, 3.0)
    material = Material(6e5, 5e5, 1.0) if kind == "isotropic" else Material(definite(rng, 40), 1e5, 1.0)
    start, clamps = jiggled(rods, rng, 0.05), clamps_at(rods)
    solutions = compared(start, material, clamps)
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


@pytest.mark.parametrize(("name", "share"), [*((suture, 0.99) for suture in SUTURES), ("ribbon", 0.97)])
def test_lab(laboratory, name, share):
    """Every third observation over 3 × 3 cells around the truth."""
    rod = lab(laboratory, name).take(np.arange(0, 60, 3))
    bend, twist = (axis.ravel() for axis in np.meshgrid([0.1, 1.0, 3.0], [0.3, 1.0, 3.0]))
    material = Material(bend[:, None, None] * rod.bend, twist * bend * rod.twist, 1.0)
    rows = np.arange(20).repeat(9), np.tile(np.arange(9), 20)
    solutions = compared(rod.start, material, rod.clamps, configuration_index=rows[0], material_index=rows[1])
    for precision, solution in solutions.items():
        assert (solution.converged & solution.stable).all(), precision
        same = vertex_distance(solution.configuration, solutions["f64"].configuration) <= SAME
        assert same.mean() >= share, precision
