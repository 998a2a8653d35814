"""Plans, whether rods follow them to their targets; steps of damped least squares, the same in any batch."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import doo_ti as d
from doo_ti.contact.surroundings import Surroundings
from doo_ti.manipulation.damped_steps import DampedSteps, normal_equations
from doo_ti.manipulation.equilibria import Clearance, Shapes
from doo_ti.manipulation.model import drawn_in, moved, slack, slack_gradient
from doo_ti.rod.frames import rotation_matrix
from tests.conftest import check_refused
from tools.studies.servo_tasks import LENGTH, Tasks, tasks

LENGTHS = np.full(20, 5.0)


def test_shapes_are_those_of_their_rods_and_a_way_leads_from_one_to_the_other_at_a_constant_pace():
    one = Shapes.at_random(4, np.zeros(3), np.full(3, 50.0), LENGTHS, 10, np.random.default_rng(3))
    again, other = Shapes.of(one.rods, 10), one.take(np.array([1, 2, 3, 0]))
    assert np.allclose(again.place, one.place) and np.allclose(again.joints, one.joints, atol=1e-12)
    assert np.allclose(one.apart(again, 60.0), 0.0, atol=1e-5)
    assert np.allclose(Shapes.of(one.rods, 0).rods.vertices, one.rods.vertices)
    whole = one.apart(other, 60.0)
    assert np.allclose(one.towards(other, np.ones(4)).rods.vertices, other.rods.vertices)
    half = one.towards(other, np.full(4, 0.5))
    assert np.allclose(one.apart(half, 60.0), whole / 2) and np.allclose(half.apart(other, 60.0), whole / 2)


def test_a_thin_obstacle_between_two_shapes_is_found():
    rods = Shapes(np.zeros((2, 3)), np.tile([1.0, 0, 0, 0], (2, 1)), np.zeros((2, 19, 3)), LENGTHS, 10).rods.vertices
    clearance = Clearance(Surroundings([d.Capsule((3.0, 11.3, -50), (3.0, 11.3, 50), 0.2)], 0.3), 100.0, 20)
    for shift, clear in ((9.0, True), (40.0, False)):
        after = rods + [0, shift, 0]
        assert (clearance.between(rods, after, clearance.of(rods), clearance.of(after)) == clear).all()


def test_slack_and_its_gradient():
    random = np.random.default_rng(3)
    frames = rotation_matrix(random.normal(size=(2, 5, 3)))
    clamps = d.Clamps(d.Clamp.FRAME, d.Clamp.FRAME, random.normal(size=(5, 3)), 100 + random.normal(size=(5, 3)), *frames)
    stiff, change = np.full(5, 7.0), 1e-5 * random.normal(size=(5, 12))
    there, back = (slack(moved(clamps, sign * change), 300.0, stiff) for sign in (1, -1))
    assert np.allclose((there - back) / 2, np.sum(slack_gradient(clamps, stiff) * change, axis=1), atol=1e-11)
    for free in (np.ones(12, dtype=bool), np.arange(12) >= 6):
        looser = slack(drawn_in(clamps, np.full(5, 2.0), stiff, free), 300.0, stiff)
        assert np.allclose(looser, slack(clamps, 300.0, stiff) + 2.0)


def test_a_plan_goes_round_an_obstacle_rather_than_to_a_shape_far_away():
    """The middle of a hanging cable is led past a ball; it would also be there with both grippers 300 mm further down."""
    theta = d.Material.from_physical(2.5e-3, GJ=2.5e-3, weight_per_length=0.245)
    rope, clamps = d.hanging(500.0, 20, start=(0, 0, 0), end=(340, 0, 0), clamp=d.Clamp.FRAME)
    rest = d.relax(rope, theta, clamps).configuration
    places = np.full_like(rest.vertices, np.nan)
    places[0, 10] = rest.vertices[0, 10] + [0, 120.0, 40.0]
    ball = d.Sphere(tuple(rest.vertices[0, 10] + [0, 60.0, 12.0]), 30.0)
    path = d.plan_manipulation(rest, theta, clamps, d.Targets(places), obstacles=[ball], radius=3.0)
    moved = path.end_position[-1, 0] - path.end_position[0, 0]
    assert path.reached and np.linalg.norm(moved - [0, 120.0, 40.0]) < 60.0


@cache
def some() -> Tasks:
    return tasks(6, 21)


def followed(own: Tasks, path: d.ManipulationPath, **around) -> np.ndarray:
    """(T, V, 3) of the rod that follows the path; certified, and without a jump."""
    prediction = d.predict(own.real, own.true, own.clamps, path, **around)
    assert prediction.followed.all() and not prediction.jumps.any()
    return prediction.vertices[:, 0]


def plan(own: Tasks, goal: np.ndarray, **options) -> d.ManipulationPath:
    return d.plan_manipulation(own.real, own.true, own.clamps, d.Targets(goal), **options)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("asked", [[10, 22], [16]])
def test_a_few_vertices_are_lifted(asked):
    """By 260 mm. Pulling the grippers apart lifts them with shorter moves, until the rod is taut; then both have to rise."""
    hung, clamps = d.hanging(330.0, 33, (0, 0, 0), (200, 0, 0), clamp=d.Clamp.FRAME)
    material = d.Material(6e5, 6e5)
    hung, goal = d.relax(hung, material, clamps).configuration, np.full((1, 34, 3), np.nan)
    goal[0, asked] = hung.vertices[0, asked] + [0, 0, 260]
    path = d.plan_manipulation(hung, material, clamps, d.Targets(goal))
    assert path.reached and path.distance < 0.5


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
    ended, begun = (d.Targets(asked).distance(shape)[0] for shape in (followed(own, path)[-1:], own.real.vertices))
    assert not path.reached and np.isclose(path.distance, ended, atol=1e-3) and path.distance < begun


@pytest.mark.thorough
def test_no_rod_is_pulled_taut_to_a_straight_target():
    """Level and straight, a rod with weight would need an infinite force."""
    own = some().take(np.array([0]))
    place = np.linspace(0.0, LENGTH, own.real.edges + 1)
    path = plan(own, np.stack([place, 0 * place, 0 * place], axis=-1)[None], options=d.PlanOptions(seconds=4.0))
    assert not path.reached and np.linalg.norm(path.end_position[-1] - path.start_position[-1]) < 0.998 * LENGTH


@pytest.mark.thorough
def test_obstacles_are_kept_clear_of():
    """A ball where the straight motion of the grippers would take the rod."""
    own, shift = some().take(np.array([1])), np.zeros((1, 12))
    shift[:, [1, 7]] = 300.0
    ball = d.Sphere(own.real.vertices[0, 16] + [0.0, 150.0, 0.0], 25.0)
    straight = d.ClampPath(np.arange(2.0), *(np.stack([getattr(one, name) for one in (own.clamps, moved(own.clamps, shift))])
                                             for name in ("start_position", "end_position")))
    around = Surroundings([ball], 1.5)
    assert around.smallest_gap(d.predict(own.real, own.true, own.clamps, straight, between=20).vertices[:, 0]).min() < 0
    path = plan(own, own.real.vertices + [0, 300.0, 0], obstacles=[ball], radius=1.5, options=d.PlanOptions(seconds=60.0))
    assert path.reached and around.smallest_gap(followed(own, path)).min() > 0.0


@pytest.mark.thorough
def test_a_rod_that_rests_on_an_obstacle_is_lifted_off_it():
    own = some().take(np.array([1]))
    middle = own.real.vertices[0, 16] - [0.0, 0, 5.0]
    around = {"obstacles": [d.Capsule(middle - [0.0, 200.0, 0], middle + [0.0, 200.0, 0], 6.0)], "radius": 1.5}
    start = d.relax(own.real, own.true, own.clamps, **around)
    far = d.relax(own.real, own.true, moved(own.clamps, np.array([[60.0, 0, 60, 0, 0, 0] * 2])))
    assert np.abs(start.contact_force).max() > 1.0
    own = replace(own, real=start.configuration)
    path = plan(own, far.configuration.vertices, **around)
    assert path.reached and len(followed(own, path, **around))


def test_what_cannot_be_planned_is_refused():
    own = some().take(np.array([0]))
    given = dict(rod=own.real, material=own.true, clamps=own.clamps, targets=d.Targets(own.goal))
    for wrong, field in ((dict(rod=some().real), "rod"), (dict(targets=d.Targets(np.zeros((1, 5, 3)))), "targets"),
                         (dict(clamps=replace(own.clamps, end=d.Clamp.FREE)), "clamps"),
                         (dict(clamps=replace(own.clamps, end_position=own.clamps.end_position + 500.0)), "rod"),
                         (dict(obstacles=[d.Plane((0, 0, -500), (0, 0, 1), friction=0.3)], radius=1.0), "obstacles")):
        check_refused(f": {field}: ", d.plan_manipulation, **given | wrong)
    check_refused("seconds", d.PlanOptions, seconds=0.0)
    check_refused("PlanOptions: free", d.PlanOptions, free=("x",))


def problems(count: int, size: int):
    """JᵀJ (B, K, K) of columns of very different lengths, Jᵀe (B, K), lengths, a (B, K) and c (B,)."""
    random = np.random.default_rng(0)
    jacobian = random.normal(size=(count, 3 * size, size)) * np.geomspace(1e-3, 3.0, size)
    across = np.swapaxes(jacobian, 1, 2)
    return (across @ jacobian, (across @ random.normal(size=(count, 3 * size, 1)))[..., 0], random.uniform(0.01, 2.0, count),
            random.normal(size=(count, size)), random.uniform(-0.1, 0.3, count))


def test_normal_equations():
    random = np.random.default_rng(1)
    columns, residual = random.normal(size=(19, 6, 3, 7)), random.normal(size=(19, 6, 3))
    weight = random.uniform(0, 2, (19, 6)) * (random.random((19, 6)) < 0.6)
    normal, right = normal_equations(columns, weight, residual)
    np.testing.assert_allclose(normal, np.einsum("bv,bvxi,bvxj->bij", weight, columns, columns), atol=1e-12)
    np.testing.assert_allclose(right, np.einsum("bv,bvxi,bvx->bi", weight, columns, residual), atol=1e-12)
    np.testing.assert_array_equal(normal_equations(columns[-1:], weight[-1:], residual[-1:])[0], normal[-1:])


@pytest.mark.parametrize("count, size", [(1, 2), (200, 12)])
def test_damped_steps_are_the_best_of_their_length_and_within_their_limit(count, size):
    """Optimality: Jᵀe − JᵀJ u is λ u plus what lies along the limit, λ and the multiplier are not negative."""
    normal, gradient, length, across, room = problems(count, size)
    steps = DampedSteps(normal, gradient).below(length, across, room)
    free = DampedSteps(normal, gradient).below(length, np.zeros_like(across), np.zeros_like(room))
    active = np.sum(across * free, axis=1) > room
    np.testing.assert_array_equal(steps[~active], free[~active])
    np.testing.assert_allclose(np.sum(across * steps, axis=1)[active], room[active], atol=1e-9)
    shortest = np.abs(room) / np.linalg.norm(across, axis=1)  # that reaches the limit
    size = np.linalg.norm(steps, axis=1)
    assert (size <= np.maximum(length, shortest * active) * (1 + 1e-9)).all()
    for row in np.flatnonzero(length > shortest):
        left = gradient[row] - normal[row] @ steps[row]
        parts = np.stack([steps[row], across[row]])[: 1 + active[row]]
        multipliers, *_ = np.linalg.lstsq(parts.T, left, rcond=None)
        np.testing.assert_allclose(multipliers @ parts, left, atol=1e-4 * np.linalg.norm(gradient[row]))
        assert (multipliers > -1e-4).all()
    np.testing.assert_array_equal(DampedSteps(normal[:1], gradient[:1]).below(length[:1], across[:1], room[:1]), steps[:1])


def test_no_step_where_none_is_allowed():
    normal, gradient, length, across, room = problems(9, 12)
    length[::2] = 0.0
    steps = DampedSteps(normal, gradient).below(length, across, room)
    assert not steps[::2].any() and steps[1::2].any(axis=1).all()
    assert DampedSteps(normal[:0], gradient[:0]).below(length[:0], across[:0], room[:0]).shape == (0, 12)
