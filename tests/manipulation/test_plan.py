"""Plans: whether rods follow them to their targets, without jumps and clear of obstacles, and what they say where none can."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import doo_ti as d
from doo_ti.contact.surroundings import Surroundings
from doo_ti.manipulation.model import moved
from tools.studies.servo_tasks import Tasks, tasks


@cache
def some() -> Tasks:
    return tasks(6, 21)


def followed(own: Tasks, path: d.ManipulationPath) -> np.ndarray:
    """(T, V, 3) of the rod that follows the path; certified, and without a jump."""
    prediction = d.predict(own.real, own.true, own.clamps, path)
    assert prediction.followed.all() and not prediction.jumps.any()
    return prediction.vertices[:, 0]


def plan(own: Tasks, goal: np.ndarray, **options) -> d.ManipulationPath:
    return d.plan_manipulation(own.real, own.true, own.clamps, d.Targets(goal), **options)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("row", range(3))
def test_a_rod_that_follows_the_plan_comes_to_its_target(row):
    own = some().take(np.array([row]))
    path = plan(own, own.goal)
    shapes = followed(own, path)
    assert path.reached and path.distance < 0.5
    assert np.linalg.norm(shapes[-1] - own.goal[0], axis=-1).mean() < 0.5
    assert np.allclose(path.start_position[0], own.clamps.start_position)


@pytest.mark.thorough
def test_a_held_gripper_stays():
    own = tasks(2, 4, both=False).take(np.array([0]))
    path = plan(own, own.goal, options=d.PlanOptions(free=("end_shift", "end_turn")))
    assert path.reached and np.abs(path.start_position - own.clamps.start_position).max() == 0.0


@pytest.mark.thorough
def test_targets_out_of_reach_are_approached_and_said():
    own = some().take(np.array([0]))
    asked = np.full_like(own.goal, np.nan)
    asked[:, 0], asked[:, -1] = [0.0, 0, 0], [400.0, 0, 0]
    path = plan(own, asked, options=d.PlanOptions(seconds=2.0))
    shapes = followed(own, path)
    assert not path.reached and np.isclose(path.distance, d.Targets(asked).distance(shapes[-1:])[0], atol=1e-3)
    assert path.distance < d.Targets(asked).distance(own.real.vertices)[0]


@pytest.mark.thorough
def test_obstacles_are_kept_clear_of():
    """A ball where the straight motion of the grippers would take the rod."""
    own = some().take(np.array([1]))
    shift = np.zeros((1, 12))
    shift[:, [1, 7]] = 300.0
    goal = own.real.vertices + shift[:, None, :3]
    ball = d.Sphere(own.real.vertices[0, 16] + [0.0, 150.0, 0.0], 25.0)
    straight = d.ClampPath(np.arange(2.0), *(np.stack([getattr(one, name) for one in (own.clamps, moved(own.clamps, shift))])
                                             for name in ("start_position", "end_position")))
    around = Surroundings([ball], 1.5)
    assert around.smallest_gap(d.predict(own.real, own.true, own.clamps, straight, between=20).vertices[:, 0]).min() < 0
    path = plan(own, goal, obstacles=[ball], radius=1.5, options=d.PlanOptions(seconds=60.0))
    shapes = followed(own, path)
    assert path.reached and around.smallest_gap(shapes).min() > 0.0


@pytest.mark.thorough
def test_a_rod_that_rests_on_an_obstacle_is_lifted_off_it():
    """The start is in contact, the goal behind the pole."""
    own = some().take(np.array([1]))
    middle = own.real.vertices[0, 16] - [0.0, 0, 5.0]
    pole = d.Capsule(middle - [0.0, 200.0, 0], middle + [0.0, 200.0, 0], 6.0)
    start = d.relax(own.real, own.true, own.clamps, obstacles=[pole], radius=1.5)
    far = d.relax(own.real, own.true, moved(own.clamps, np.array([[60.0, 0, 60, 0, 0, 0] * 2])))
    assert np.abs(start.contact_force).max() > 1.0
    path = d.plan_manipulation(start.configuration, own.true, own.clamps, d.Targets(far.configuration.vertices),
                               obstacles=[pole], radius=1.5)
    seen = d.predict(start.configuration, own.true, own.clamps, path, obstacles=[pole], radius=1.5)
    assert path.reached and seen.followed.all() and not seen.jumps.any()


def test_what_cannot_be_planned_is_refused():
    own = some().take(np.array([0]))
    two = some().take(np.array([0, 1]))
    for wrong, field in ((dict(rod=two.real), "rod"), (dict(targets=d.Targets(np.zeros((1, 5, 3)))), "targets"),
                         (dict(clamps=replace(own.clamps, end=d.Clamp.FREE)), "clamps"),
                         (dict(clamps=replace(own.clamps, end_position=own.clamps.end_position + 500.0)), "rod"),
                         (dict(obstacles=[d.Plane((0, 0, -500), (0, 0, 1), friction=0.3)], radius=1.0), "obstacles")):
        given = dict(rod=own.real, material=own.true, clamps=own.clamps, targets=d.Targets(own.goal))
        with pytest.raises(d.InputError) as caught:
            d.plan_manipulation(**(given | wrong))
        assert caught.value.field == field
    with pytest.raises(d.InputError, match="seconds"):
        d.PlanOptions(seconds=0.0)
