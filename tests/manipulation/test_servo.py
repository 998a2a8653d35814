"""The servo on rods that it does not know: whether they reach their targets, what it learns, and what it does elsewhere."""

from functools import cache

import numpy as np
import pytest

import doo_ti as d
from doo_ti.contact.surroundings import Surroundings
from doo_ti.manipulation.model import Model, held
from doo_ti.rod.shapes import with_end_edges
from tests.conftest import check_refused
from tools.studies.servo_tasks import BEND, NOISE, Plant, Tasks, tasks

PLANTS = {"own mesh": Plant(), "finer mesh, clips, rest curvature": Plant(3, 0.7, 2.0, 6e-4)}
NEAR = 2.0  # mm, mean distance


@cache
def some(name: str) -> Tasks:
    return tasks(12, 3, PLANTS[name])


def servo_of(own: Tasks, **other) -> d.Servo:
    return d.Servo(**(dict(rod=own.rods, material=own.nominal, clamps=own.clamps, targets=d.Targets(own.goal)) | other))


def servo_of_two(**other) -> d.Servo:
    return servo_of(some("own mesh").take(np.arange(2)), **other)


def run(own: Tasks, servo: d.Servo, steps: int) -> d.Simulation:
    """The true rods after so many steps."""
    random, simulation = np.random.default_rng(5), own.simulation()
    for _ in range(steps):
        simulation.step(held(servo.step(own.marks(simulation.state.configuration, 11, random)), own.clip))
    return simulation


def apart(shapes: np.ndarray, goals: np.ndarray) -> np.ndarray:
    """(B,) mm: mean distances of vertices (B, V, 3)."""
    return np.linalg.norm(shapes - goals, axis=-1).mean(axis=1)


def within(servo: d.Servo, truth) -> np.ndarray:
    """(B,) whether the intervals of bend hold the truth."""
    low, high = servo.material.bend_interval.T
    return (low <= truth) & (truth <= high)


@pytest.mark.thorough
def test_intervals_hold_the_stiffness_of_rods_off_a_drum():
    """Bent at rest to radii of some 300 mm, by clips that are not where they are thought to be."""
    own = tasks(60, 6, Plant(3, 0.7, 2.0, 3e-3))
    servo = servo_of(own)
    distance = apart(own.vertices(run(own, servo, 30).state.configuration), own.goal)
    assert np.median(distance) < 0.5 and within(servo, BEND * own.factors[0]).mean() > 0.9


@pytest.mark.sampled(1)
@pytest.mark.parametrize("name", PLANTS)
def test_unknown_rods_reach_their_goals(name):
    own = some(name)
    servo = servo_of(own)
    distance = apart(own.vertices(run(own, servo, 30).state.configuration), own.goal)
    assert (distance < NEAR).sum() >= 11 and np.median(distance) < 0.3
    if name == "own mesh":
        assert abs(np.median(servo.material.misfit) / NOISE - 1) < 0.15
    assert within(servo, BEND * own.factors[0]).sum() >= 10
    low, high = servo.material.bend_interval.T
    assert np.median(high / low) < 1.7  # of a prior of exp(4 · 0.4) = 4.8; rests of many degrees are not excluded


@pytest.mark.thorough
@pytest.mark.parametrize("factor", [0.5, 2.0])
@pytest.mark.parametrize("table", [True, False])
def test_intervals_hold_the_truth_where_contacts_move(table, factor):
    """Rods on a table of half the stiffness that the model has, or twice: both touch it at other places."""
    around = {"obstacles": [d.Plane((0, 0, -60), (0, 0, 1))], "radius": 2.0} if table else {}
    rod = d.rod_along([[-60, 0, 0], [0, 0, -10], [70, 30, -55], [150, 0, -10], [200, 0, 0]], 33)
    clamps, nominal, true = d.end_clamps(rod, d.Clamp.FRAME, d.Clamp.FRAME), d.Material(BEND, BEND), d.Material(
        factor * BEND, factor * BEND)
    random, many = np.random.default_rng(7), np.zeros(12, dtype=int)
    goals, real = clamps.take(many), d.relax(rod, true, clamps, **around).configuration.take(many)
    for name, low, high in (("start_position", [-10, -60, -30], [30, 60, 30]), ("end_position", [-30, -60, -30], [10, 60, 30])):
        getattr(goals, name)[:] += random.uniform(low, high, (12, 3))
    there = d.Simulation(real, true, clamps.take(many), **around).step(goals)
    simulation = d.Simulation(real, true, clamps.take(many), **around)
    model = d.relax(rod, nominal, clamps, **around).configuration.take(many)
    servo = d.Servo(model, nominal, clamps.take(many), d.Targets(np.nan_to_num(there.configuration.vertices)),
                    d.ServoOptions(noise_mm=NOISE), **around)
    for _ in range(30):
        seen = simulation.state.configuration.vertices
        simulation.step(servo.step(seen + NOISE * random.normal(size=seen.shape)))
    assert within(servo, factor * BEND)[there.converged].mean() > 0.8
    off = apart(simulation.state.configuration.vertices, there.configuration.vertices)
    assert (off[there.converged] < NEAR).sum() >= 10  # others are beyond a fold


def test_no_step_is_longer_than_allowed_nor_moves_a_held_gripper():
    own = tasks(4, 8, both=False)
    options = d.ServoOptions(free=("end_shift", "end_turn"), step_mm=10.0)
    servo = servo_of(own, options=options)
    random, simulation = np.random.default_rng(1), own.simulation()
    for _ in range(5):
        before = servo.clamps
        after = servo.step(own.marks(simulation.state.configuration, 11, random))
        simulation.step(after)
        assert np.array_equal(after.start_position, own.clamps.start_position)
        assert np.array_equal(after.start_frame, own.clamps.start_frame)
        shift = np.linalg.norm(after.end_position - before.end_position, axis=1)
        cosine = 0.5 * (np.einsum("bij,bij->b", after.end_frame, before.end_frame) - 1.0)
        assert (np.hypot(shift, options.lever_mm * np.arccos(np.clip(cosine, -1, 1))) < 10.0 + 1e-6).all()


def test_a_loop_does_not_depend_on_the_others():
    """Its poses are equal bit by bit, whatever is seen of the others and whether these snap or are refused steps."""
    own = some("finer mesh, clips, rest curvature")
    alone, random = own.take(np.array([5])), np.random.default_rng(2)
    together, one = servo_of(own), servo_of(alone)
    simulation = own.simulation()
    for _ in range(8):
        seen = own.marks(simulation.state.configuration, 11, random)
        seen[2] += 40.0 * random.normal()  # as if it had snapped
        mine = seen[[5]].copy()
        mine[:, 10] = seen[5, 10] = np.nan
        clamps, lone = together.step(seen), one.step(mine)
        for name in ("start_position", "start_frame", "end_position", "end_frame"):
            assert np.array_equal(getattr(clamps, name)[5], getattr(lone, name)[0])
        simulation.step(held(clamps, own.clip))
    assert together.status[5] == one.status[0] and np.array_equal(together.vertices[5], one.vertices[0])


@pytest.mark.parametrize("rods", [[2], pytest.param(range(6), marks=pytest.mark.thorough)])
def test_a_rod_that_its_boxes_keep_from_its_goal_stays_where_it_is_nearest(rods):
    """The model is the rod: the way to a goal beyond the box would lead it away, and nowhere."""
    own, distances = some("own mesh").take(np.array(rods)), []
    low, high = own.clamps.end_position.min(axis=0) - 10.0, own.clamps.end_position.max(axis=0) + 10.0
    simulation = d.Simulation(own.rods, own.nominal, own.clamps)
    servo = servo_of(own, options=d.ServoOptions(end_box=(tuple(low.tolist()), tuple(high.tolist()))))
    begun = servo.distance
    for _ in range(25):
        clamps = servo.step(simulation.state.configuration.vertices)
        assert (low <= clamps.end_position).all() and (clamps.end_position <= high).all()
        distances.append(apart(simulation.step(clamps).configuration.vertices, own.goal))
    assert (distances[-1] <= np.min(distances, axis=0) + 0.5).all() and (distances[-1] < begun).all()


@pytest.mark.parametrize("held", ["obstacles", "vertex clamps", "one unknown"])
def test_other_rods_come_nearer_too(held):
    """Above a table that they do not touch; between clamps that act at their vertices; with clips that are known."""
    own = some("own mesh").take(np.arange(2))
    rods, options, around = own.rods, d.ServoOptions(), {}
    if held == "obstacles":
        around = dict(obstacles=[d.Plane((0, 0, -400.0), (0, 0, 1))], radius=1.5)
    elif held == "vertex clamps":
        rods = with_end_edges(rods)
    else:
        options = d.ServoOptions(ratio=0.0, clip_mm=0.0, clip_deg=0.0, compliance=0.0, curvature=0.0)
    goal = np.full((2, rods.edges + 1, 3), np.nan)
    goal[:, 1:-1] = own.goal if held == "vertex clamps" else own.goal[:, 1:-1]
    servo = d.Servo(rods, own.nominal, own.clamps, d.Targets(goal), options, **around)
    before, model = servo.distance, d.Simulation(rods, own.nominal, own.clamps)
    for _ in range(3):
        model.step(servo.step(model.state.configuration.vertices))
    assert (servo.distance < before - 15.0).all() and servo.vertices.shape == goal.shape
    assert within(servo, BEND).all()


HUNG = d.Material.from_physical(1e-4, 0.75e-4, 0.3)


def hung(**around) -> tuple[d.Configuration, d.Clamps]:
    rod, clamps = d.hanging(330.0, 33, start=(0, 0, 0), end=(200, 0, 0), clamp=d.Clamp.FRAME)
    return d.relax(rod, HUNG, clamps, **around).configuration, clamps


@pytest.mark.thorough
def test_grippers_do_not_enter_a_wall():
    """The target is behind it. Each gripper holds an edge of 10 mm, which the model lets turn."""
    around = {"obstacles": [d.Plane((0, 40, 0), (0, -1, 0))], "radius": 1.5}
    rod, clamps = hung(**around)
    servo = d.Servo(rod, HUNG, clamps, d.Targets(rod.vertices + [0, 160, 0]), **around)
    for _ in range(12):
        now = servo.step(servo.vertices)
        tips = now.start_position + 10 * now.start_frame[..., 0], now.end_position - 10 * now.end_frame[..., 0]
        assert max(tip[0, 1] for tip in (*tips, now.start_position, now.end_position)) < 38.5 + 1e-6
    assert servo.status[0] in (d.ServoStatus.NEAREST, d.ServoStatus.BLOCKED)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("off_mm", [2.0, 1.0])
def test_clips_that_are_farther_apart_than_reported_do_not_stretch_a_rod(off_mm):
    """A straight target; each clip is off outwards by one or two standard deviations of what is not known of it."""
    rod, clamps = hung()
    straight = np.linspace((-65.0, 0, 0), (265.0, 0, 0), 34)
    outwards = np.array([[-off_mm, 0, 0, 0, 0, 0, off_mm, 0, 0, 0, 0, 0]])
    simulation, random = d.Simulation(rod, HUNG, held(clamps, outwards)), np.random.default_rng(3)
    servo = d.Servo(rod, HUNG, clamps, d.Targets(straight[None]))
    for _ in range(25):
        seen = simulation.state.configuration.vertices
        true = held(servo.step(seen + 0.3 * random.normal(size=seen.shape)), outwards)
        tips = true.start_position + 10 * true.start_frame[..., 0], true.end_position - 10 * true.end_frame[..., 0]
        assert np.linalg.norm(tips[1] - tips[0]) < 310.0 and simulation.step(true).converged.all()


def test_marks_that_are_late_are_said_to_misfit():
    """By one step: the stiffness that is learned is wrong, and its interval says so; nothing is reached that marks do not
    show."""
    own = some("own mesh")
    servo, simulation, random = servo_of(own), own.simulation(), np.random.default_rng(5)
    late = simulation.state.configuration
    for _ in range(15):
        marks, late = own.marks(late, 11, random), simulation.state.configuration
        simulation.step(held(servo.step(marks), own.clip))
        far = np.sqrt(np.nanmean(np.sum((marks - own.goal) ** 2, axis=-1), axis=1)) > 0.5 + 4 * NOISE
        assert not (far & (servo.status == d.ServoStatus.REACHED)).any()
    assert np.mean(within(servo, BEND * own.factors[0])) > 0.8
    assert np.median(servo.material.misfit) > 3 * NOISE


def test_nothing_seen_moves_as_the_model_says():
    own = some("own mesh")
    servo = servo_of(own)
    before = servo.distance
    for _ in range(3):
        servo.step(np.full_like(own.goal, np.nan))
    assert (servo.distance < before).sum() >= 11 and np.allclose(servo.material.bend, BEND)


def test_targets_of_a_few_vertices():
    own = some("own mesh").take(np.arange(4))
    asked = np.full_like(own.goal, np.nan)
    asked[:, 16:18] = own.goal[:, 16:18]
    servo = servo_of(own, targets=d.Targets(asked))
    off = np.linalg.norm(run(own, servo, 20).state.configuration.vertices[:, 16:18] - own.goal[:, 16:18], axis=-1)
    assert (off < NEAR).all() and (servo.status == d.ServoStatus.REACHED).all()


@pytest.mark.thorough
def test_targets_out_of_reach_are_approached_and_said():
    own = some("own mesh").take(np.arange(3))
    asked = np.full_like(own.goal, np.nan)
    asked[:, 0], asked[:, -1] = [0.0, 0, 0], [500.0, 0, 0]
    servo = servo_of(own, targets=d.Targets(asked))
    state = run(own, servo, 30).state
    assert state.converged.all() and np.isin(servo.status, (d.ServoStatus.NEAREST, d.ServoStatus.BLOCKED)).all()
    assert (np.linalg.norm(state.configuration.vertices[:, -1] - state.configuration.vertices[:, 0], axis=-1) > 280.0).all()


def test_poses_are_the_caller_s_own_and_marks_may_be_whole_numbers():
    one, other = servo_of_two(), servo_of_two()
    seen = some("own mesh").take(np.arange(2)).rods.vertices.round()
    one.step(seen.astype(np.int64)).end_position[:] += 100.0
    other.step(seen)
    np.testing.assert_array_equal(one.clamps.end_position, other.clamps.end_position)


def test_small_steps_on_a_long_way_are_no_end_of_it():
    material = d.Material.from_physical(0.002, 0.002, weight_per_length=0.6)
    rod, clamps = d.hanging(1000.0, 40, start=(0, 0, 0), end=(600, 0, 0), clamp=d.Clamp.FRAME)
    shape = d.relax(rod, material, clamps).configuration.vertices
    servo = d.Servo(rod, material, clamps, d.Targets(shape + [300.0, 0, 0]), d.ServoOptions(step_mm=5.0))
    simulation = d.Simulation(rod, material, clamps)
    for _ in range(6):
        simulation.step(servo.step(simulation.state.configuration.vertices))
        assert servo.status[0] == d.ServoStatus.MOVING
    assert servo.distance[0] < 285.0
    learned, (low, high) = servo.material, servo.material.EI_interval[0]
    assert low < 0.002 < high and learned.EI[0] == pytest.approx(0.002, rel=0.1) and learned.GJ.shape == (1,)
    assert learned.GJ_interval[0, 0] < learned.GJ[0] < learned.GJ_interval[0, 1]


def test_marks_in_metres_are_warned_of_once():
    servo, metres = servo_of_two(), some("own mesh").take(np.arange(2)).rods.vertices / 1000
    with pytest.warns(UserWarning, match="give mm"):
        servo.step(metres)
    servo.step(metres)
    assert servo.material.EI is None


def test_shapes_are_found_again_from_marks():
    """From where the rods were before a long move of their grippers: drawn to a few marks, then let go."""
    own = tasks(20, 4)
    there = d.Simulation(own.rods, own.nominal, own.clamps).step(own.goal_clamps)
    own, shapes = (part.take(np.flatnonzero(there.converged & there.stable)) for part in (own, there.configuration))
    marks = np.where(np.arange(34)[:, None] % 3 == 0, shapes.vertices, np.nan)
    model = Model(own.nominal, np.zeros((own.count, 12)), np.array([0, 0, 1.0]), Surroundings())
    drawn = model.drawn(own.rods, own.goal_clamps, marks, np.isfinite(marks).all(axis=-1))
    found = model.relaxed(drawn, own.goal_clamps).configuration.vertices
    assert (np.linalg.norm(found - shapes.vertices, axis=-1).max(axis=1) < 0.1).mean() > 0.9


@pytest.mark.parametrize(("call", "field"), [
    (lambda: servo_of_two(targets=d.Targets(np.zeros((1, 5, 3)))), "targets"),
    (lambda: servo_of_two(targets=d.Targets(np.zeros((3, 34, 3)))), "clamps, material, targets"),
    (lambda: servo_of_two(material=d.Material.diagonal(6e5, 1e5, 6e5)), "material"),
    (lambda: servo_of_two().step(np.zeros((2, 5, 3))), "seen"),
    (lambda: d.Targets(np.array([np.zeros((4, 3)), np.full((4, 3), np.nan)])), "vertices"),  # nothing is asked of one
    (lambda: d.Targets(np.zeros((1, 4, 3)), np.array([[1.0, -1, 0, 0]])), "weight"),
    (lambda: d.ServoOptions(free=("start",)), "free"), (lambda: d.ServoOptions(step_mm=0.0), "step_mm"),
    (lambda: d.ServoOptions(end_box=((1.0, 0.0, 0.0), (0.0, 0.0, 0.0))), "end_box")])
def test_what_does_not_match_is_refused(call, field):
    check_refused(f": {field}: ", call)
