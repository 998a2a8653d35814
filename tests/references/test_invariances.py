"""Invariances of a rod: rigid motion with the vertical, reading it from its other end, a common factor, units.

Both clamps on one line: an experiment that hardly depends on Θ, and planar rods.

The paper's rod, 99 mm in 33 edges, both end tangents along the line between the ends, weight 1.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from doo_ti import Clamp, Clamps, Configuration, Material, Newton, relax
from doo_ti.rod.frames import quaternion_from_matrix
from tests.references.rods import chain, clamps_at, jiggled, stacked

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
        0.01 * rng.normal(size=(1, EDGES - 1, 2)),
    )
    return jiggled(rod, rng, 0.05), material, clamps_at(rod, *request.param), np.array([0.0, 0.0, 1.0])


def relaxed(problem, tolerance=1e-11):
    start, material, clamps, up = problem
    solution = relax(start, material, clamps, Newton(tolerance=tolerance), up=up)
    assert solution.converged.all() and solution.stable.all()
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
        material, moved_clamps(clamps, lambda x: x @ turn.T + shift, lambda f: turn @ f), turned_up,
    )
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
               clamps.end_frame @ mirror, clamps.start_frame @ mirror), up,
    )
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


def test_metres_for_millimetres(problem):
    """Stiffness over weight is a length cubed, an energy over weight a length squared, a residual one over a length."""
    start, material, clamps, up = problem
    metres = (
        replace(start, start=1e-3 * start.start, rest_length=1e-3 * start.rest_length),
        Material(1e-9 * material.bend, 1e-9 * material.twist, material.weight, 1e3 * material.rest_curvature),
        moved_clamps(clamps, lambda x: 1e-3 * x, lambda f: f), up,
    )
    before, after = relaxed(problem), relaxed(metres, tolerance=1e-8)
    np.testing.assert_allclose(1e3 * after.configuration.vertices, before.configuration.vertices, atol=1e-7)
    assert 1e6 * after.energy[0] == pytest.approx(before.energy[0], rel=1e-10)


PAPER_EDGES, EDGE = 33, 3.0


def bow(distance: float, rotation: float) -> Configuration:
    """An even bow that hangs in the vertical plane, its end turned by ``rotation`` degrees."""
    along = np.arange(PAPER_EDGES) / (PAPER_EDGES - 1)
    shape = np.sin(2 * np.pi * along)
    size = brentq(lambda a: np.sum(EDGE * np.cos(a * shape)) - distance, 0, 2)
    tangents = np.stack([np.cos(size * shape), 0 * shape, -np.sin(size * shape)], axis=1)
    return chain(tangents, [0, 1, 0], EDGE, spin=np.radians(rotation) * along)


def largest_movement(distance: float, rotation: float) -> float:
    """Farthest any vertex gets from where the range's middle has it, mm: bend and twist ratio over a factor 25 each."""
    bend, ratio = (grid.ravel() for grid in np.meshgrid(np.geomspace(4e5, 1e7, 9), np.geomspace(0.24, 6.0, 9)))
    rod = bow(distance, rotation)
    solution = relax(rod, Material(bend, bend * ratio, 1.0), clamps_at(rod))
    assert solution.converged.all() and solution.stable.all()
    vertices = solution.configuration.vertices
    return np.linalg.norm(vertices - vertices[len(vertices) // 2], axis=2).max()


def test_54_mm_and_120_degrees_is_nearly_blind_to_the_parameters():
    movement = {rotation: largest_movement(54.0, rotation) for rotation in (60, 120, 180)}
    assert movement[120] < 0.6
    assert movement[60] > 3 * movement[120] and movement[180] > 3 * movement[120]


def test_stiff_enough_in_twist_the_planar_bow_is_stable():
    rods = stacked([bow(distance, 0.0) for distance in (42.0, 54.0, 66.0)])
    solution = relax(rods, Material(6e5, 6e5, 1.0), clamps_at(rods))
    assert solution.converged.all() and solution.stable.all()
    assert np.abs(solution.configuration.vertices[..., 1]).max() < 1e-6
