"""A closed ring, twisted: stable as a circle up to Φ = 2π√3 α/β, unstable beyond (Michell 1889).

The chain ends on its own first edge: E − 1 joints turn by 2π, and the far point is the end of the first edge, so the
regular polygon with even twist is an equilibrium by symmetry and only its stability is in question. The ring may turn
freely about its clamped edge (each section spinning back in place costs nothing): a trace of weight makes it hang.
"""

import numpy as np
import pytest

from doo_ti import Configuration, Material, Newton, relax
from tests.references.rods import chain, clamps_at, jiggled, orders, show, stacked

ALPHA, BETA, RADIUS = 6e5, 4e5, 20.0
HANGING = (0, -1, 0)  # up: the ring's centre lies at +y of its clamped edge
THRESHOLD = 2 * np.pi * np.sqrt(3) * ALPHA / BETA


def ring(joints: int, turn: float) -> Configuration:
    angle = 2 * np.pi * np.arange(joints + 1) / joints
    tangents = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    return chain(tangents, [0, 0, 1], 2 * RADIUS * np.sin(np.pi / joints), spin=turn * np.arange(joints + 1) / joints)


def circle_is_stable(joints: int, turns) -> np.ndarray:
    """The certificate at the twisted circle itself: the tolerance is above the trace of weight, so no step is taken."""
    rings = stacked([ring(joints, turn) for turn in turns])
    material = Material(ALPHA, BETA, 1e-8 * ALPHA / RADIUS**3)
    solution = relax(rings, material, clamps_at(rings), Newton(tolerance=1e-4, max_escapes=0), up=HANGING)
    assert solution.converged.all()
    np.testing.assert_allclose(solution.configuration.vertices, rings.vertices, atol=1e-6 * RADIUS)
    np.testing.assert_allclose(solution.energy, circle_energy(joints, turns), rtol=1e-6)
    return solution.stable


def circle_energy(joints: int, turns):
    """joints (α|κb|² + β m²)/l̄ with |κb| = 2 tan(π/joints), m = Φ/joints."""
    bend = ALPHA * (2 * np.tan(np.pi / joints)) ** 2
    return joints * (bend + BETA * (np.asarray(turns) / joints) ** 2) / (4 * RADIUS * np.sin(np.pi / joints))


@pytest.mark.thorough
def test_certificate_flips_at_michells_twist():
    """The flip, found on ever finer grids of twists in three batches, converges to 2π√3 α/β with second order."""
    joints, errors = [12, 24, 48], []
    for count in joints:
        low, high = 0.7 * THRESHOLD, 1.3 * THRESHOLD
        for _ in range(3):
            turns = np.linspace(low, high, 21)
            stable = circle_is_stable(count, turns)
            flip = np.flatnonzero(stable)[-1]
            assert stable[: flip + 1].all() and flip < 20
            low, high = turns[flip], turns[flip + 1]
        errors.append(abs(0.5 * (low + high) / THRESHOLD - 1))
    show("Michell's instability of the twisted ring", joints, errors)
    assert (orders(joints, errors) > 1.8).all() and errors[-1] < 0.02


@pytest.mark.parametrize("sign", [1, -1])
def test_ring_stays_a_circle_below_and_leaves_it_above(rng, sign):
    joints = 32
    turns = sign * THRESHOLD * np.array([0.0, 0.8, 1.2])
    rings = stacked([ring(joints, turn) for turn in turns])
    material = Material(ALPHA, BETA, 1e-3 * ALPHA / RADIUS**3)
    solution = relax(jiggled(rings, rng, 1e-3), material, clamps_at(rings), up=HANGING)
    assert solution.converged.all() and solution.stable.all()
    away = np.linalg.norm(solution.configuration.vertices - rings.vertices, axis=2).max(axis=1)
    assert (away[:2] < 0.01 * RADIUS).all()
    np.testing.assert_allclose(solution.energy[:2], circle_energy(joints, turns[:2]), rtol=5e-3)
    # Nothing stops the writhing ring from passing through itself: it may end as a circle with two turns less.
    assert solution.energy[2] < 0.9 * circle_energy(joints, turns[2])
