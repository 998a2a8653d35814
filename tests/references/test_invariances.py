"""Invariances of a rod: rigid motion with the vertical, reading it from its other end, a common factor."""


import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from doo_ti import Clamp, Clamps, Configuration, Material, Newton, relax
from doo_ti.rod.frames import quaternion_from_matrix
from tests.references.rods import certified, chain, clamps_at, jiggled

EDGES = 14
KINDS = [(Clamp.FRAME, Clamp.FRAME), (Clamp.FRAME, Clamp.TANGENT), (Clamp.TANGENT, Clamp.FREE), (Clamp.FREE, Clamp.FRAME)]


@pytest.fixture(params=KINDS, ids=lambda kinds: "-".join(kind.name.lower() for kind in kinds))
def problem(request, rng):
    """(start, material, clamps, up) with everything uneven and nothing on an axis."""
    angle = 0.15 * np.arange(EDGES)
    tangents = np.stack([np.cos(angle), np.sin(angle), 0.3 * np.cos(2 * angle)], axis=1)
    rod = chain(tangents, [0, 0, 1], rng.uniform(2, 4, EDGES), start=(4, -2, 9), spin=0.1 * np.arange(EDGES))
    root = rng.normal(size=(1, EDGES, 2, 2)) * 200
    material = Material(
        root @ np.swapaxes(root, -1, -2) + 1e5 * np.eye(2), rng.uniform(5e4, 2e5, (1, EDGES - 1)), 1.0,
        0.01 * rng.normal(size=(1, EDGES - 1, 2)))
    return jiggled(rod, rng, 0.05), material, clamps_at(rod, *request.param), np.array([0.0, 0.0, 1.0])


def relaxed(problem):
    start, material, clamps, up = problem
    solution = certified(relax(start, material, clamps, Newton(tolerance=1e-11), up=up))
    return solution


def moved_clamps(clamps: Clamps, position, frame) -> Clamps:
    return Clamps(clamps.start, clamps.end, position(clamps.start_position), position(clamps.end_position),
                  frame(clamps.start_frame), frame(clamps.end_frame))


@pytest.mark.parametrize("vector", [(0, 0, 1.3), (0.7, -0.4, 0.9)], ids=["about z", "any, with up"])
def test_rigid_motion(problem, vector):
    start, material, clamps, up = problem
    turn, shift = Rotation.from_rotvec(vector).as_matrix(), np.array([7.0, -3.0, 11.0])
    turned_up = turn @ up
    moved = (
        Configuration(start.start @ turn.T + shift, quaternion_from_matrix(turn @ start.frames), start.rest_length),
        material, moved_clamps(clamps, lambda x: x @ turn.T + shift, lambda f: turn @ f), turned_up)
    before, after = relaxed(problem), relaxed(moved)
    np.testing.assert_allclose(after.configuration.vertices, before.configuration.vertices @ turn.T + shift, atol=1e-7)
    np.testing.assert_allclose(after.configuration.frames, turn @ before.configuration.frames, atol=1e-8)
    lifted = 2 * start.rest_length.sum() * (shift @ turned_up)
    assert after.energy[0] - before.energy[0] == pytest.approx(lifted, rel=1e-9)


def test_reversal(problem):
    """From the other end the frame is (−t, m1, −m2): ω2, and with it B's off-diagonal and ω̄2, change sign."""
    start, material, clamps, up = problem
    mirror, flip = np.diag([-1.0, 1.0, -1.0]), np.diag([1.0, -1.0])
    back = (
        Configuration(
            start.vertices[:, -1], quaternion_from_matrix(start.frames[:, ::-1] @ mirror),
            start.rest_length[::-1].copy()),
        Material(flip @ material.bend[:, ::-1] @ flip, material.twist[:, ::-1], material.weight,
                 material.rest_curvature[:, ::-1] @ flip),
        Clamps(clamps.end, clamps.start, clamps.end_position, clamps.start_position,
               clamps.end_frame @ mirror, clamps.start_frame @ mirror), up)
    before, after = relaxed(problem), relaxed(back)
    if clamps.start != Clamp.FREE and clamps.end != Clamp.FREE:
        assert after.energy[0] == pytest.approx(before.energy[0], rel=1e-10)
    np.testing.assert_allclose(after.configuration.vertices[:, ::-1], before.configuration.vertices, atol=1e-7)
    np.testing.assert_allclose(after.configuration.frames[:, ::-1] @ mirror, before.configuration.frames, atol=1e-8)


def test_common_factor_of_the_parameters(problem):
    start, material, clamps, up = problem
    scaled = Material(700 * material.bend, 700 * material.twist, 700 * material.weight, material.rest_curvature)
    before, after = relaxed(problem), relaxed((start, scaled, clamps, up))
    np.testing.assert_allclose(after.configuration.vertices, before.configuration.vertices, atol=1e-8)
    assert after.energy[0] == pytest.approx(700 * before.energy[0], rel=1e-11)
