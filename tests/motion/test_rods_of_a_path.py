"""Clamps carried in sub-steps: rods follow their branch with any size of sub-steps."""

import numpy as np
import pytest

from doo_ti import Material, relax
from doo_ti.motion.path import carried_clamps, carry
from tests.references.rods import bows, clamps_at
from tests.relaxation.lab import vertex_distance
from tests.relaxation.rods import assert_same

MATERIALS = {"round": Material(6e5, 8e5, 1.0), "flat": Material.diagonal(3e6, 2e5, 5e5)}


def relaxed_bows(material: Material):
    """Three of them at rest, and their clamps."""
    rods = bows(0.6, 0.9, 1.2)
    clamps = clamps_at(rods)
    solution = relax(rods, material, clamps)
    assert (solution.converged & solution.stable).all()
    return solution, clamps


def turned(clamps, degrees: float):
    """(R, 3) rotation vectors about the end tangents."""
    return np.radians(degrees) * clamps.end_frame[..., 0]


@pytest.mark.parametrize("kind", MATERIALS)
def test_halving_the_steps_changes_nothing(kind):
    at_rest, clamps = relaxed_bows(MATERIALS[kind])
    goal = clamps.end_position + [-6.0, 3.0, 2.0]
    ends = []
    for steps in (24, 48):
        path = carried_clamps(clamps, goal, turned(clamps, 120.0), steps)
        solution, last = carry(at_rest.configuration, MATERIALS[kind], path)
        assert (solution.converged & solution.stable).all()
        np.testing.assert_allclose(solution.configuration.vertices[:, -1], goal, atol=1e-9)
        ends.append(solution)
    apart = vertex_distance(ends[0].configuration, ends[1].configuration).max()
    print(f"{kind}: 48 steps end {apart:.1e} mm from 24")
    assert apart < 1e-4
    np.testing.assert_allclose(ends[1].energy, ends[0].energy, rtol=1e-9)


def test_there_and_back():
    """No snap on the way: the rod comes back to where it started."""
    material = MATERIALS["round"]
    at_rest, clamps = relaxed_bows(material)
    goal = clamps.end_position + [-12.0, 6.0, 3.0]
    there, last = carry(at_rest.configuration, material, carried_clamps(clamps, goal, turned(clamps, 90.0), 18))
    assert vertex_distance(there.configuration, at_rest.configuration).min() > 1
    back, _ = carry(there.configuration, material, carried_clamps(last, clamps.end_position, turned(last, -90.0), 18))
    apart = vertex_distance(back.configuration, at_rest.configuration).max()
    print(f"there and back: {apart:.1e} mm from the start")
    assert apart < 1e-4


def test_whole_turns_stay_in_the_rod():
    """A clamp that makes a whole turn ends with the frame it had, and with its turn in the rod."""
    material = Material(6e5, 1e5, 1.0)
    at_rest, clamps = relaxed_bows(material)
    path = carried_clamps(clamps, clamps.end_position, turned(clamps, 360.0), 72)
    solution, last = carry(at_rest.configuration, material, path)
    np.testing.assert_allclose(last.end_frame, clamps.end_frame, atol=1e-9)
    assert (solution.converged & solution.stable).all()
    assert (solution.energy > at_rest.energy * 1.05).all()
    here = relax(solution.configuration, material, clamps)
    np.testing.assert_allclose(here.energy, solution.energy, rtol=1e-9)


def test_clamps_on_the_way():
    """Positions on a line, frames about one axis in equal shares; the near clamp stays."""
    _, clamps = relaxed_bows(MATERIALS["round"])
    goal, turn = clamps.end_position + [3.0, 6.0, 9.0], turned(clamps, 90.0)
    path = list(carried_clamps(clamps, goal, turn, 3))
    assert len(path) == 3
    for k, step in enumerate(path, 1):
        np.testing.assert_allclose(step.end_position, clamps.end_position + np.array([1.0, 2.0, 3.0]) * k, atol=1e-12)
        angle = np.radians(30.0 * k)
        m1 = np.cos(angle) * clamps.end_frame[..., 1] + np.sin(angle) * clamps.end_frame[..., 2]
        np.testing.assert_allclose(step.end_frame[..., 1], m1, atol=1e-12)
        np.testing.assert_array_equal(step.start_frame, clamps.start_frame)
        np.testing.assert_array_equal(step.start_position, clamps.start_position)
    still = list(carried_clamps(clamps, clamps.end_position, 0 * turn, 2))
    np.testing.assert_allclose(still[-1].end_frame, clamps.end_frame, atol=1e-12)


def test_a_rod_that_is_pulled_too_far_is_named_alone():
    material = MATERIALS["round"]
    at_rest, clamps = relaxed_bows(material)
    goal = clamps.end_position + np.array([[0.0, 0, 0], [80.0, 0, 0], [0, 0, 0]])
    solution, _ = carry(at_rest.configuration, material, carried_clamps(clamps, goal, turned(clamps, 20.0), 4))
    near = carried_clamps(clamps, clamps.end_position, turned(clamps, 20.0), 4)
    alone, _ = carry(at_rest.configuration, material, near)
    assert solution.status.tolist() == [0, 4, 0]
    assert_same(solution, [0, 2], alone, [0, 2])
