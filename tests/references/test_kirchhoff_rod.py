"""A twisted rod between two clamps under its weight against Kirchhoff's equations: second order in edge length.

    r' = t        d_k' = u × d_k        n' = w up        M' = −t × n
    M·m2 = (B(ω − ω̄))₁,   −M·m1 = (B(ω − ω̄))₂,   M·t = β u·t,   ω = (u·m2, −u·m1)

with EI = B, GJ = β and weight per length w = 2μ. Unknowns: r, the frame as a quaternion, force n and moment M.

A closed ring, twisted: stable as a circle up to Φ = 2π√3 α/β, unstable beyond (Michell 1889). The chain ends on its own
first edge: E − 1 joints turn by 2π, and the far point is the end of the first edge, so the regular polygon with even twist
is an equilibrium by symmetry and only its stability is in question. The ring may turn freely about its clamped edge (each
section spinning back in place costs nothing): a trace of weight makes it hang.

Uniform discrete arcs and helices, exact equilibria of an isotropic rod without weight: with one rotation q at every joint
the curvature binormal is |κb| = 2 tan(φ/2) everywhere. The energy is (E−1)(α|κb|² + β m²)/l̄.
"""

import numpy as np
import pytest
from scipy.integrate import solve_bvp
from scipy.spatial.transform import Rotation

from doo_ti import Clamp, Clamps, Configuration, Material, Newton, relax
from doo_ti.rod.frames import matrix_from_quaternion, quaternion_product
from tests.references.rods import certified, chain, clamps_at, jiggled, orders, stacked

FREE_LENGTH = 90.0


def continuum(bend, twist: float, weight: float, rest_curvature, positions, quaternions, s, places, frames):
    """y(s) of a rod of such a material between clamps, positions (2, 3) and quaternions (2, 4), from a guess: places (n, 3)
    and frames (n, 4) at s (n,)."""
    def derivative(s, y):
        quaternion, force, moment = y[3:7].T, y[7:10].T, y[10:13].T
        frame = matrix_from_quaternion(quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True))
        t, m1, m2 = np.moveaxis(frame, -1, 0)
        pair = np.stack([np.sum(moment * m2, axis=-1), -np.sum(moment * m1, axis=-1)], axis=-1)
        omega = pair @ np.linalg.inv(bend) + rest_curvature
        along = np.sum(moment * t, axis=-1) / twist
        u = along[:, None] * t + omega[:, :1] * m2 - omega[:, 1:] * m1
        spin = np.concatenate([0 * s[:, None], u], axis=1)
        load = np.broadcast_to([0.0, 0.0, 2 * weight], force.shape)
        return np.concatenate([t, 0.5 * quaternion_product(spin, quaternion), load, -np.cross(t, force)], axis=1).T

    def ends(left, right):
        turn = quaternion_product(quaternions[1] * [1, -1, -1, -1], right[3:7])
        begin, end = left[:7] - np.append(positions[0], quaternions[0]), right[:3] - positions[1]
        return np.concatenate([begin, end, turn[1:]])

    frames = frames.copy()
    for j in range(1, len(frames)):  # one sign along the rod
        frames[j] *= np.sign(frames[j] @ frames[j - 1])
    frames *= np.sign(frames[0] @ quaternions[0])
    state = np.concatenate([places, frames, np.zeros((len(s), 6))], axis=1).T
    answer = solve_bvp(derivative, ends, s, state, tol=1e-8, max_nodes=5000)
    assert answer.success, answer.message
    return answer.sol


def first_guess(edges: int, graded: bool):
    """A hanging bow that leaves its plane, twisted by 2 rad; FREE_LENGTH from middle to middle of the end edges."""
    along = np.arange(edges) / (edges - 1)
    lengths = 1 + (0.5 * np.sin(np.pi * along) if graded else 0 * along)
    lengths *= FREE_LENGTH / (lengths.sum() - 0.5 * (lengths[0] + lengths[-1]))
    middles = np.cumsum(lengths) - lengths / 2 - lengths[0] / 2
    s = middles / FREE_LENGTH
    tangents = np.stack([np.ones(edges), 0.8 * np.sin(2 * np.pi * s) + 0.3 * s, -1.1 * np.cos(np.pi * s)], axis=1)
    return chain(tangents, [0, 1, 0], lengths, spin=2.0 * s), middles


@pytest.mark.sampled(1)
@pytest.mark.parametrize("graded", [False, True], ids=["even", "graded"])
@pytest.mark.parametrize("bend, rest", [
    (4e5 * np.eye(2), None), (np.array([[6e5, 1e5], [1e5, 2e5]]), np.array([0.006, -0.004]))],
                         ids=["isotropic", "general B, curved at rest"])
def test_rod_converges_to_kirchhoffs_with_second_order(bend, rest, graded):
    material = Material(bend, 3e5, 1.0, rest)
    fine, _ = first_guess(97, False)
    # The clamped edges have the frames and, at their middles, the positions of those of one rod.
    places, turned = 0.5 * (fine.vertices[0, [0, -2]] + fine.vertices[0, [1, -1]]), fine.frames[0, [0, -1]]
    joints, errors, curve = [64, 32, 16], [], None
    for count in joints:
        rod, middles = first_guess(count + 1, graded)
        held = places + (rod.rest_length[[0, -1]] * [-0.5, 0.5])[:, None] * turned[..., 0]
        clamps = Clamps(Clamp.FRAME, Clamp.FRAME, held[:1], held[1:], turned[:1], turned[1:])
        solution = certified(relax(rod, material, clamps, Newton(tolerance=1e-9)))
        vertices, quaternions = solution.configuration.vertices[0], solution.configuration.quaternions[0]
        if curve is None:  # the finest chain is where the collocation starts from, no more
            ends = Rotation.from_matrix(turned).as_quat(scalar_first=True)
            curve = continuum(bend, 3e5, 1.0, 0.0 if rest is None else rest, places, ends, middles,
                              0.5 * (vertices[1:] + vertices[:-1]), quaternions)
        along = np.cumsum(rod.rest_length)[:-1] - 0.5 * rod.rest_length[0]
        away = np.linalg.norm(vertices[1:-1] - curve(along)[:3].T, axis=1).max() / FREE_LENGTH
        frames = np.abs(np.sum(quaternions * curve(middles)[3:7].T, axis=1))
        errors.append([away, 2 * np.arccos(np.clip(frames, -1, 1)).max()])
    errors = np.array(errors)[::-1]
    for away in errors.T:
        assert (orders(joints[::-1], away) > 1.8).all()
    assert errors[-1, 0] < 1e-3


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
