"""Groups that turn or move at no cost: about a vertical line through a nail, about a chord, or as a whole."""

from dataclasses import replace

import numpy as np
import pytest

from doo_ti import Clamp, Group, Material, Newton, Status, Tie, follow_group, relax, relax_group
from doo_ti.rod.shapes import end_clamps, hanging, straight_rod

FREE = (Clamp.FREE, Clamp.FREE)
MOST = 60
"""Iterations."""


@pytest.mark.parametrize("end", [(0.0, 0.0, 0.0), (0.0, 0.0, 100.0), (1.0, 0.0, 0.0)])
@pytest.mark.parametrize("material", [
    Material(1e4, 1e4), Material(1e6, 1e6), Material(1e8, 1e8), Material.diagonal(1e6, 1e5, 1e5),
    Material(1e5, 1e5, rest_curvature=[0.01, 0.005])], ids=["limp", "soft", "stiff", "ribbon", "curved"])
def test_a_rod_between_two_nails_hangs_as_alone(material, end):
    """The nails are at one place, above each other, or almost."""
    rope, clamps = hanging(300.0, 30, start=(0.0, 0.0, 0.0), end=end)
    alone, group = relax(rope, material, clamps), relax_group(Group([rope], material, [clamps]))
    assert alone.converged[0] and alone.stable[0]
    assert group.converged[0] and group.stable[0] and group.iterations[0] < MOST and group.closure[0] < 1e-10
    assert group.energy[0] == pytest.approx(alone.energy[0], rel=1e-9)
    for shape in (lambda x: x[:, 2], lambda x: np.linalg.norm(x - x[0], axis=1)):  # neither knows of turns about the vertical
        one, other = shape(alone.configuration.vertices[0]), shape(group.rods[0].vertices[0])
        apart = min(np.abs(one - other).max(), np.abs(one[::-1] - other).max())
        assert apart < 1e-5 * 300.0


def test_tied_ends_on_a_nail_are_the_same_loop():
    rope, both = hanging(300.0, 30, start=(0.0, 0.0, 0.0), end=(0.0, 0.0, 0.0))
    held = relax_group(Group([rope], Material(1e6, 1e6), [both]))
    nailed = end_clamps(rope, Clamp.POSITION, Clamp.FREE)
    tied = relax_group(Group([rope], Material(1e6, 1e6), [nailed], [Tie((0, 0), (0, -1))]))
    assert tied.converged[0] and tied.stable[0] and tied.iterations[0] < MOST
    assert tied.energy[0] == pytest.approx(held.energy[0], rel=1e-9)
    assert tied.start_force[0, 0] == pytest.approx([0.0, 0.0, 600.0], abs=1e-3)


def test_a_loop_follows_its_nail():
    """Each moment begins with the forces of the one before."""
    rope, clamps = hanging(300.0, 30, start=(0.0, 0.0, 0.0), end=(0.0, 0.0, 0.0))
    moments = [[replace(clamps, start_position=clamps.start_position + shift, end_position=clamps.end_position + shift)]
               for shift in np.array([5.0, 1.0, 2.0]) * np.arange(4)[:, None, None]]
    found = list(follow_group(Group([rope], Material(1e6, 1e6), [clamps]), moments))
    assert all(moment.converged[0] and moment.stable[0] for moment in found)
    assert [moment.energy[0] for moment in found[1:]] == pytest.approx([found[0].energy[0] + 2.0 * 300.0 * 2.0 * number
                                                                       for number in (1, 2, 3)], rel=1e-9)


def test_what_is_free_to_move_as_a_whole_comes_to_rest():
    """Weightless rods that nothing holds, rods that swing about one nail, and ties that say the same thing twice."""
    first, second = straight_rod(60.0, 12), straight_rod(50.0, 10, (60.0, 5.0, 3.0), (0.3, 1.0, 0.2))
    rods, loose = [first, second], [end_clamps(rod, *FREE) for rod in (first, second)]
    nailed = [end_clamps(first, Clamp.POSITION, Clamp.FREE), loose[1]]
    nothing, heavy = Material(1e5, 8e4, 0.0), Material(1e5, 8e4)
    tie, weld = Tie((0, -1), (1, 0)), Tie((0, -1), (1, 0), weld=True)
    ring = hanging(300.0, 30, start=(0.0, 0.0, 0.0), end=(0.0, 0.0, 0.0))[0]
    for group in (Group(rods, nothing, loose, [tie]), Group(rods, nothing, loose, [tie, Tie((0, 2), (1, 8))]),
                  Group(rods, nothing, loose, [weld, Tie((0, 2), (1, 8))]), Group(rods, heavy, nailed, [tie]),
                  Group(rods, heavy, nailed, [weld]), Group(rods, heavy, nailed, [tie, Tie((1, 0), (0, -1))]),
                  Group([ring], nothing, [end_clamps(ring, *FREE)], [Tie((0, 0), (0, -1), weld=True)]),
                  Group([ring], heavy, [end_clamps(ring, Clamp.POSITION, Clamp.FREE)], [Tie((0, 0), (0, -1), weld=True)])):
        solution = relax_group(group)
        assert solution.converged[0] and solution.stable[0] and solution.closure[0] < 1e-10


@pytest.mark.parametrize("escapes", [0, 3])
def test_rods_that_stand_upright_are_at_no_minimum(escapes):
    """Two rods in one line on a nail, which turn about that line at no cost, but fall over."""
    rods = [straight_rod(50.0, 10, (0.0, 0.0, z), (0.0, 0.0, 1.0)) for z in (0.0, 50.0)]
    group = Group(rods, Material(1e6, 1e6), [end_clamps(rods[0], Clamp.POSITION, Clamp.FREE), end_clamps(rods[1], *FREE)],
                  [Tie((0, -1), (1, 0))])
    solution = relax_group(group, Newton(max_iterations=1000, max_escapes=escapes))
    assert solution.status[0] == Status.CONVERGED and solution.stable[0] == (escapes > 0)
    assert solution.rods[1].vertices[0, -1, 2] == pytest.approx(-100.0 if escapes else 100.0, abs=1e-3)
