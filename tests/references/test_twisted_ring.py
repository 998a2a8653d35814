"""A closed ring, twisted: stable as a circle up to Φ = 2π√3 α/β, unstable beyond (Michell 1889).

The chain ends on its own first edge: E − 1 joints turn by 2π, and the far point is the end of the first edge, so the
regular polygon with even twist is an equilibrium by symmetry and only its stability is in question. The ring may turn
freely about its clamped edge (each section spinning back in place costs nothing): a trace of weight makes it hang.

Uniform discrete arcs and helices: exact equilibria of an isotropic rod without weight, forces and moments included.

With one rotation q at every joint the curvature binormal is |κb| = 2 tan(φ/2) everywhere. The energy is
(E−1)(α|κb|² + β m²)/l̄; a joint carries the moment 4α tan(φ/2) sec²(φ/2)/l̄ b + 2βm/l̄ (t0 + t1)/(1 + cos φ), and
balance of an inner edge, M_j − M_{j+1} + l t × λ = 0, fixes the force λ along the axis of the screw.
"""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from doo_ti import Clamps, Configuration, Material, Newton, relax
from doo_ti.rod.frames import quaternion_from_matrix
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


EDGES, LENGTH = 24, 3.0


def uniform_rod(bend_angle: float, twist_angle: float) -> Configuration:
    """Each joint turns by half the twist, the bend about m2, half the twist: m is the twist and φ the bend angle."""
    half = Rotation.from_rotvec([twist_angle / 2, 0, 0])
    joint = half * Rotation.from_rotvec([0, 0, bend_angle]) * half
    frames = [Rotation.from_rotvec([0.3, -0.4, 0.2])]
    for _ in range(EDGES - 1):
        frames.append(frames[-1] * joint)
    quaternions = quaternion_from_matrix(np.array([frame.as_matrix() for frame in frames]))
    return Configuration(np.array([[5.0, -3.0, 2.0]]), quaternions[None], np.full(EDGES, LENGTH))


def joint_moment(frame0, frame1, twist_angle):
    """World moment that edge 1 needs against the joint: the energy's derivative in a world rotation of edge 1."""
    t0, t1 = frame0[:, 0], frame1[:, 0]
    cosine = t0 @ t1
    binormal = np.cross(t0, t1)
    sine = np.linalg.norm(binormal)
    bend = 4 * ALPHA * (sine / (1 + cosine)) * (2 / (1 + cosine)) / (2 * LENGTH) * binormal / sine
    return bend + 2 * BETA * twist_angle / (2 * LENGTH) * (t0 + t1) / (1 + cosine)


def end_force_and_moment(rod, twist_angle):
    """Closed forms at the far clamp: dE/dx_E and dE/d(rotation about x_E) in world axes."""
    frames = rod.frames[0]
    first, second = joint_moment(frames[0], frames[1], twist_angle), joint_moment(frames[1], frames[2], twist_angle)
    screw = Rotation.from_matrix(frames[1] @ frames[0].T).as_rotvec()
    axis = screw / np.linalg.norm(screw)
    lever = LENGTH * np.cross(frames[1][:, 0], axis)
    size = (second - first) @ lever / (lever @ lever) if lever @ lever > 1e-20 else 0.0
    multiplier = size * axis
    np.testing.assert_allclose(first - second + LENGTH * np.cross(frames[1][:, 0], multiplier), 0, atol=1e-9 * ALPHA)
    last = joint_moment(frames[-2], frames[-1], twist_angle)
    return -multiplier, last + LENGTH * np.cross(frames[-1][:, 0], multiplier)


@pytest.mark.parametrize(("bend_angle", "twist_angle"), [(0.12, 0.0), (0.2, 0.08), (0.25, -0.15)])
def test_uniform_rod_is_found_again_with_its_energy(rng, bend_angle, twist_angle):
    rod, material = uniform_rod(bend_angle, twist_angle), Material(ALPHA, BETA, 0.0)
    solution = relax(jiggled(rod, rng, 0.05), material, clamps_at(rod), Newton(tolerance=1e-9))
    assert solution.converged.all() and solution.stable.all()
    np.testing.assert_allclose(solution.configuration.vertices, rod.vertices, atol=1e-7)
    expected = (EDGES - 1) * (ALPHA * (2 * np.tan(bend_angle / 2)) ** 2 + BETA * twist_angle**2) / (2 * LENGTH)
    assert solution.energy[0] == pytest.approx(expected, rel=1e-11)


@pytest.mark.parametrize(("bend_angle", "twist_angle"), [(0.12, 0.0), (0.2, 0.08)])
def test_end_force_and_moment_are_the_closed_forms(bend_angle, twist_angle):
    """Central differences of the relaxed energy as the far clamp is moved and turned by a little, all in one batch."""
    rod, material, step = uniform_rod(bend_angle, twist_angle), Material(ALPHA, BETA, 0.0), 1e-4
    held = clamps_at(rod)
    positions, frames = [], []
    for axis in np.eye(3):
        for sign in (1, -1):
            positions += [held.end_position[0] + sign * step * axis, held.end_position[0]]
            frames += [held.end_frame[0], Rotation.from_rotvec(sign * step * axis).as_matrix() @ held.end_frame[0]]
    count = len(positions)
    clamps = Clamps(
        held.start, held.end, np.repeat(held.start_position, count, 0), np.array(positions),
        np.repeat(held.start_frame, count, 0), np.array(frames),
    )
    solution = relax(rod.take(np.zeros(count, dtype=int)), material, clamps)
    assert solution.converged.all()
    slopes = solution.energy.reshape(3, 2, 2)
    force, moment = ((slopes[:, 0, kind] - slopes[:, 1, kind]) / (2 * step) for kind in (0, 1))
    expected_force, expected_moment = end_force_and_moment(rod, twist_angle)
    scale = np.linalg.norm(expected_moment)
    np.testing.assert_allclose(moment, expected_moment, atol=1e-6 * scale)
    np.testing.assert_allclose(force, expected_force, atol=1e-6 * scale / LENGTH)
