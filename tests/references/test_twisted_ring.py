"""A closed ring, twisted: stable as a circle up to Φ = 2π√3 α/β, unstable beyond (Michell 1889).

The chain ends on its own first edge: E − 1 joints turn by 2π, and the far point is the end of the first edge, so the
regular polygon with even twist is an equilibrium by symmetry and only its stability is in question. The ring may turn
freely about its clamped edge (each section spinning back in place costs nothing): a trace of weight makes it hang.

Uniform discrete arcs and helices: exact equilibria of an isotropic rod without weight.

With one rotation q at every joint the curvature binormal is |κb| = 2 tan(φ/2) everywhere. The energy is
(E−1)(α|κb|² + β m²)/l̄.
"""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from doo_ti import Configuration, Material, Newton, relax
from tests.references.rods import certified, chain, clamps_at, jiggled, stacked

ALPHA, BETA, RADIUS = 6e5, 4e5, 20.0
HANGING = (0, -1, 0)  # up: the ring's centre lies at +y of its clamped edge
THRESHOLD = 2 * np.pi * np.sqrt(3) * ALPHA / BETA


def ring(joints: int, turn: float) -> Configuration:
    angle = 2 * np.pi * np.arange(joints + 1) / joints
    tangents = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    return chain(tangents, [0, 0, 1], 2 * RADIUS * np.sin(np.pi / joints), spin=turn * np.arange(joints + 1) / joints)


def circle_energy(joints: int, turns):
    """joints (α|κb|² + β m²)/l̄ with |κb| = 2 tan(π/joints), m = Φ/joints."""
    bend = ALPHA * (2 * np.tan(np.pi / joints)) ** 2
    return joints * (bend + BETA * (np.asarray(turns) / joints) ** 2) / (4 * RADIUS * np.sin(np.pi / joints))


@pytest.mark.parametrize("sign", [1, -1])
def test_ring_stays_a_circle_below_and_leaves_it_above(rng, sign):
    joints = 32
    turns = sign * THRESHOLD * np.array([0.0, 0.8, 1.2])
    rings = stacked([ring(joints, turn) for turn in turns])
    material = Material(ALPHA, BETA, 1e-3 * ALPHA / RADIUS**3)
    solution = certified(relax(jiggled(rings, rng, 1e-3), material, clamps_at(rings), up=HANGING))
    away = np.linalg.norm(solution.configuration.vertices - rings.vertices, axis=2).max(axis=1)
    assert (away[:2] < 0.01 * RADIUS).all()
    np.testing.assert_allclose(solution.energy[:2], circle_energy(joints, turns[:2]), rtol=5e-3)
    # Nothing stops the writhing ring from passing through itself: it may end as a circle with two turns less.
    assert solution.energy[2] < 0.9 * circle_energy(joints, turns[2])


EDGES, LENGTH = 24, 3.0


def uniform_rod(bend_angle: float, twist_angle: float) -> Configuration:
    """Each joint turns by half the twist, the bend about m2, half the twist: m is the twist and φ the bend angle."""
    half, first = Rotation.from_rotvec([twist_angle / 2, 0, 0]), Rotation.from_rotvec([0.3, -0.4, 0.2])
    joint = half * Rotation.from_rotvec([0, 0, bend_angle]) * half
    quaternions = np.array([[(first * joint**k).as_quat(scalar_first=True) for k in range(EDGES)]])
    return Configuration(np.array([[5.0, -3.0, 2.0]]), quaternions, np.full(EDGES, LENGTH))


@pytest.mark.parametrize(("bend_angle", "twist_angle"), [(0.12, 0.0), (0.2, 0.08), (0.25, -0.15)])
def test_uniform_rod_is_found_again_with_its_energy(rng, bend_angle, twist_angle):
    rod, material = uniform_rod(bend_angle, twist_angle), Material(ALPHA, BETA, 0.0)
    solution = certified(relax(jiggled(rod, rng, 0.05), material, clamps_at(rod), Newton(tolerance=1e-9)))
    np.testing.assert_allclose(solution.configuration.vertices, rod.vertices, atol=1e-7)
    expected = (EDGES - 1) * (ALPHA * (2 * np.tan(bend_angle / 2)) ** 2 + BETA * twist_angle**2) / (2 * LENGTH)
    assert solution.energy[0] == pytest.approx(expected, rel=1e-11)
