"""Uniform discrete arcs and helices: exact equilibria of an isotropic rod without weight, forces and moments included.

With one rotation q at every joint the curvature binormal is |κb| = 2 tan(φ/2) everywhere. The energy is
(E−1)(α|κb|² + β m²)/l̄; a joint carries the moment 4α tan(φ/2) sec²(φ/2)/l̄ b + 2βm/l̄ (t0 + t1)/(1 + cos φ), and
balance of an inner edge, M_j − M_{j+1} + l t × λ = 0, fixes the force λ along the axis of the screw.
"""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from doo_ti import Clamps, Configuration, Material, Newton, relax
from doo_ti.rod.frames import quaternion_from_matrix
from tests.references.rods import clamps_at, jiggled

EDGES, LENGTH, ALPHA, BETA = 24, 3.0, 6e5, 4e5


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
