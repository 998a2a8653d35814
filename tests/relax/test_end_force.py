"""The force at the far clamp is the slope of the energy in where the clamp is."""

from dataclasses import replace

import numpy as np
import pytest

from doo_ti import Clamp, Material, relax
from tests.references.rods import chain, clamps_at
from tests.relax.rods import wandering, with_kinds


@pytest.mark.parametrize("kind", [Clamp.POSITION, Clamp.TANGENT, Clamp.FRAME], ids=lambda kind: kind.name.lower())
def test_energy_grows_by_the_force_times_the_way(rng, kind):
    rods = wandering(rng, 5, 12)
    clamps = with_kinds(clamps_at(rods), [(Clamp.FRAME, kind)] * 5)
    material = Material(2e5, 1e5, 1.0)
    solution = relax(rods, material, clamps)
    assert (solution.converged & solution.stable).all()
    step = 1e-4
    slopes = []
    for direction in np.eye(3):
        near = [relax(solution.configuration, material,
                      replace(clamps, end_position=clamps.end_position + sign * step * direction)).energy for sign in (1, -1)]
        slopes.append((near[0] - near[1]) / (2 * step))
    error = np.abs(np.stack(slopes, axis=-1) - solution.end_force).max()
    print(f"{kind.name.lower()}: force {np.linalg.norm(solution.end_force, axis=1).max():.4g}, slope off by {error:.1e}")
    assert error < 1e-5 * np.linalg.norm(solution.end_force, axis=1).max()


def test_a_free_end_is_not_pulled(rng):
    rods = wandering(rng, 3, 12)
    clamps = with_kinds(clamps_at(rods), [(Clamp.FRAME, Clamp.FREE)] * 3)
    assert (relax(rods, Material(2e5, 1e5, 1.0), clamps).end_force == 0).all()


def test_the_force_lifts_half_of_a_symmetric_bow():
    """Clamped level and symmetric under gravity: each end carries half of the weight 2 μ L."""
    angle = np.linspace(-0.8, 0.8, 33)
    tangents = np.stack([np.cos(angle), 0 * angle, np.sin(angle)], axis=1)
    rod = chain(tangents, [0, 1, 0], 3.0)
    solution = relax(rod, Material(1e5, 1e5, 1.0), clamps_at(rod))
    assert solution.stable.all()
    assert solution.end_force[0, 2] == pytest.approx(99.0, rel=1e-6)
