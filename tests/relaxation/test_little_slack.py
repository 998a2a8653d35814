"""Rods with hardly any slack, standing rods, and starts inside obstacles: what converges though it is hard."""

import numpy as np
import pytest

from doo_ti import Clamp, Clamps, Configuration, Itself, Material, Plane, end_clamps, hanging, relax, rod_along, straight_rod
from doo_ti.contact.obstacles import Sphere


@pytest.mark.parametrize("kind", [Clamp.POSITION, Clamp.TANGENT, Clamp.FRAME])
@pytest.mark.parametrize("stiffness", [1e-3, 1e-5, 1e-7])
def test_little_slack(kind, stiffness):
    slack = np.geomspace(3e-8, 3e-4, 17)
    ropes, clamps = hanging(np.full(17, 1000.0), 40, (0, 0, 0), np.column_stack([1000.0 * (1 - slack), 0 * slack, 0 * slack]))
    frames = np.repeat(np.eye(3)[None], 17, axis=0)
    held = Clamps(kind, kind, clamps.start_position, clamps.end_position, frames, frames)
    solution = relax(ropes, Material.from_physical(stiffness, stiffness, 0.5), held)
    assert solution.converged.all() and solution.stable.all()


def test_standing_rods_fall_and_are_certified():
    count = 100
    rod = straight_rod(300.0, 30, (0, 0, 0), (0, 0, 1))
    rods = Configuration(np.zeros((count, 3)), np.repeat(rod.quaternions, count, axis=0), rod.rest_length)
    bend = np.geomspace(1e5, 1e9, count)
    solution = relax(rods, Material(bend, 0.8 * bend), end_clamps(rods, Clamp.FRAME, Clamp.FREE))
    print(np.bincount(solution.status, minlength=5), solution.iterations.mean())
    assert solution.converged.mean() >= 0.98 and solution.stable[solution.converged].all()
    assert solution.iterations.mean() < 40


@pytest.mark.thorough
def test_a_released_start_falls_though_the_rod_may_touch_itself():
    rod = straight_rod(300.0, 30)
    clamps, material = end_clamps(rod, Clamp.FREE, Clamp.FRAME), Material(1e6, 0.8e6)
    alone, itself = relax(rod, material, clamps), relax(rod, material, clamps, obstacles=[Itself()], radius=1.0)
    assert itself.converged.all() and itself.stable.all()
    np.testing.assert_allclose(itself.configuration.vertices, alone.configuration.vertices, atol=1e-4)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("length", [350.0, 600.0, 900.0])
def test_a_start_below_a_table_is_moved_above_it(length):
    rope, clamps = hanging(length, 40, (0, 0, 0), (300, 0, 0))
    solution = relax(rope, Material(1e6, 1e6), clamps, obstacles=[Plane((0, 0, -100), (0, 0, 1))], radius=2.0)
    assert solution.converged.all() and solution.stable.all() and solution.contact.gap.min() > -1e-3


@pytest.mark.thorough
def test_marks_that_noise_has_put_into_a_table(rng):
    marks = np.column_stack([np.linspace(0, 200, 31), 20 * np.sin(np.linspace(0, 5, 31)), rng.normal(0, 0.6, 31)])
    marks[[0, -1], 2] = 0.5
    rod = rod_along(marks, 30)
    solution = relax(rod, Material(1e6, 1e6), end_clamps(rod, Clamp.POSITION, Clamp.POSITION),
                     obstacles=[Plane((0, 0, 0), (0, 0, 1))], radius=0.5)
    assert solution.converged.all() and solution.contact.gap.min() > -1e-3


def test_clamps_inside_an_obstacle_remain_infeasible():
    rope, clamps = hanging(350.0, 20, (0, 0, 0), (300, 0, 0))
    solution = relax(rope, Material(1e6, 1e6), clamps, obstacles=[Sphere((0, 0, 0), 10.0)], radius=2.0)
    assert solution.status[0] == 4 and np.isnan(solution.configuration.vertices).all()
