"""Prediction, without and with inertia: rods follow their clamps, keep their turns, and report where they could not."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from doo_ti import ClampPath, Dynamics, Grippers, PointLoads, Stepping, hanging, relax, simulate, straight_rod
from doo_ti.motion.path import Motion, carry
from doo_ti.motion.predict import predict, predict_moving, predict_step, rate_of
from doo_ti.rod.types import Clamp, Clamps, Configuration, Material, Status
from tests.conftest import check_refused
from tests.references.rods import at_rest, bows, clamps_at

MATERIAL = Material(6e5, 8e5)
EDGES = 33
SHIFTS = np.linspace(0, 1, 5)[:, None] * [-6.0, 3.0, 2.0]
LOSSES = Dynamics(bend_damping=0.01, drag=1.0)


@pytest.fixture(scope="module")
def rods():
    return at_rest(bows(0.6, 0.9, edges=EDGES), MATERIAL)


@pytest.fixture
def clamps(rods):
    return clamps_at(rods)


def line(clamps: Clamps, *shifts, rotation=None) -> ClampPath:
    """The far clamp at shifts (3,) from where it is, one each second."""
    moments = len(shifts) if shifts else len(rotation)
    positions = clamps.end_position + np.array(shifts, float)[:, None] if shifts else None
    return ClampPath(np.arange(float(moments)), end_position=positions,
                     end_rotation=None if rotation is None else np.array(rotation)[:, None])


def test_it_is_where_small_steps_lead(rods, clamps):
    """Against the lab's own carrier, with steps of another size and in f64."""
    shift, turn = SHIFTS[-1], np.radians(120.0)
    motion = Motion(clamps, end_shift=np.tile(shift, (2, 1)), end_turn=turn * clamps.end_frame[..., 0])
    there, _ = carry(rods, MATERIAL, motion.states(50))
    prediction = predict(rods, MATERIAL, clamps, line(clamps, np.zeros(3), shift, rotation=[0.0, turn]), between=3)
    assert prediction.vertices.shape == (4, 2, EDGES + 1, 3) and prediction.followed.all()
    np.testing.assert_allclose(prediction.vertices[-1], there.configuration.vertices, atol=1e-4)
    np.testing.assert_allclose(prediction.energy[-1], there.energy, rtol=1e-8)
    np.testing.assert_allclose(prediction.end_force[-1], there.end_force, rtol=1e-3, atol=1.0)
    np.testing.assert_allclose(prediction.time, [0, 1 / 3, 2 / 3, 1])
    way = prediction.vertices[:, :, -1] - clamps.end_position
    np.testing.assert_allclose(way, np.tile(np.outer([0, 1 / 3, 2 / 3, 1], shift)[:, None], (1, 2, 1)), atol=1e-6)


def test_every_material_with_every_start():
    """R = G·N rods of several lengths, material by material, each as if it were alone."""
    rods, clamps = hanging(np.array([100.0, 120.0]), 12, (0, 0, 0), (60, 0, 0))
    materials = Material(np.array([6e5, 2e6, 3e5]), 8e5)
    path = line(clamps, np.zeros(3), np.array([-5.0, 2.0, 1.0]))
    together = predict(rods, materials, clamps, path)
    assert together.material.tolist() == [0, 0, 1, 1, 2, 2] and together.motion.tolist() == [0, 1] * 3
    alone = predict(rods.take([1]), Material(2e6, 8e5), clamps.take([1]), line(clamps.take([1]), np.zeros(3), [-5.0, 2.0, 1.0]))
    np.testing.assert_array_equal(together.quaternions[:, 3], alone.quaternions[:, 0])
    np.testing.assert_array_equal(together.energy[:, 3], alone.energy[:, 0])


@pytest.mark.thorough
def test_turns_stay_where_a_rod_is_straight():
    """Pulled nearly straight a rod cannot writhe: what the clamp turns is twist, to the degree."""
    straight = straight_rod(3.0 * EDGES, EDGES)
    clamps = replace(clamps_at(straight), end_position=np.array([[3.0 * EDGES - 0.02, 0, 0]]))
    prediction = predict(straight, Material(6e5, 1e4), clamps, line(clamps, rotation=np.radians([0.0, 300.0, 840.0])))
    assert prediction.followed.all() and not prediction.jumps.any()
    np.testing.assert_allclose(np.degrees(prediction.total_twist[:, 0]), [0, 300, 840], atol=2.0)
    here = replace(clamps, end_frame=prediction.at(-1).frames[:, -1])
    back = predict(prediction.at(-1), Material(6e5, 1e4), here, line(here, rotation=np.radians([0.0, -840.0])))
    np.testing.assert_allclose(np.degrees(back.total_twist[:, 0]), [840, 0], atol=2.0)


def test_it_is_brought_to_where_the_path_begins(rods, clamps):
    shift = np.array([-4.0, 1.0, 0.0])
    approached = predict(rods, MATERIAL, clamps, line(clamps, shift, 2 * shift))
    at_once = predict(rods, MATERIAL, clamps, line(clamps, np.zeros(3), shift, 2 * shift))
    np.testing.assert_allclose(approached.vertices, at_once.vertices[1:], atol=1e-5)
    np.testing.assert_allclose(approached.end_rotation, 0, atol=1e-12)


def test_relative_paths_set_out_from_each_rod(rods, clamps):
    about_z = Rotation.from_euler("z", 40.0, degrees=True).as_matrix()
    path = ClampPath(np.array([0.0, 1.0]), end_position=np.array([[[9.0, 9, 9]], [[4.0, 10, 9]]]),
                     end_frame=np.stack([np.eye(3), about_z])[:, None])
    own = path.relative_to(clamps)
    np.testing.assert_allclose(own.end_position[0], clamps.end_position, atol=1e-12)
    np.testing.assert_allclose(own.end_position[1] - own.end_position[0], np.tile([-5.0, 1, 0], (2, 1)), atol=1e-12)
    np.testing.assert_allclose(own.end_frame[1], about_z @ clamps.end_frame, atol=1e-12)
    assert predict(rods, MATERIAL, clamps, own).followed.all()


def test_a_rod_that_is_pulled_too_far_is_lost_alone(rods, clamps):
    positions = np.repeat(clamps.end_position[None], 3, axis=0)
    positions[1, 0] += [80.0, 0, 0]
    prediction = predict(rods, MATERIAL, clamps, ClampPath(np.arange(3.0), end_position=positions))
    assert prediction.status[:, 0].tolist() == [Status.CONVERGED, Status.INFEASIBLE, prediction.status[2, 0]]
    assert prediction.followed.tolist() == [[True, True], [False, True], [False, True]]
    assert not prediction.stable[1:, 0].any() and not prediction.jumps[1:, 0].any()
    assert np.isnan(prediction.vertices[1, 0, 1:]).all() and np.isfinite(prediction.vertices[:, 1]).all()
    alone = predict(rods.take([1]), MATERIAL, clamps.take([1]), ClampPath(np.arange(3.0), end_position=positions[:, 1:]))
    np.testing.assert_array_equal(prediction.quaternions[:, 1], alone.quaternions[:, 0])


@pytest.mark.thorough
def test_candidates_of_one_rod(rods, clamps):
    """For planners: the same as each motion predicted alone, with and without detection of jumps."""
    rod, held = rods.take([0]), clamps.take([0])
    shifts = np.array([[-3.0, 0, 0], [0, 3.0, 0], [-2.0, 1.0, 4.0]])
    rotation = np.radians([0.0, 40.0, -360.0])
    turned = Configuration.concatenate([
        predict(rod, MATERIAL, held, line(held, np.zeros(3), shift, rotation=[0.0, angle])).at(-1)
        for shift, angle in zip(shifts, rotation, strict=True)])
    goal = replace(held.take([0, 0, 0]), end_position=held.end_position + shifts, end_frame=turned.frames[:, -1])
    for watch in (True, False):
        solution, jumps = predict_step(rod, MATERIAL, held, goal, rotation=rotation, watch=watch)
        assert solution.converged.all() and (jumps is None) == (not watch)
        np.testing.assert_allclose(solution.configuration.vertices, turned.vertices, atol=2e-2)
    infeasible = replace(goal, end_position=goal.end_position + [[0, 0, 0], [90.0, 0, 0], [0, 0, 0]])
    solution, _ = predict_step(rod, MATERIAL, held, infeasible, rotation=rotation, watch=False)
    assert solution.status.tolist() == [Status.CONVERGED, Status.INFEASIBLE, Status.CONVERGED]


def test_numbers_that_do_not_match_are_named(rods, clamps):
    one, held = rods.take([0]), clamps.take([0])
    for path, loads, words in ((ClampPath(np.arange(2.0), end_position=np.zeros((2, 3, 3))), None, "one motion for all"),
                               (line(clamps, np.zeros(3), np.zeros(3)), PointLoads(np.zeros((3, EDGES + 1, 3))), "loads")):
        check_refused(words, predict, rods, MATERIAL, clamps, path, loads=loads)
    for given, loads, words in (((rods, MATERIAL, held), None, "configuration: 2 rows"),
                                ((one, Material([6e5, 7e5], 8e5), held), None, "material: 2 rows"),
                                ((one, MATERIAL, clamps), None, "clamps: 2 rows"),
                                ((one, MATERIAL, held), PointLoads(np.zeros((1, 9, 3))), "loads")):
        check_refused(f"predict_step: {words}", predict_step, *given, clamps, loads=loads)


def test_spin_free_ends_go_along_with_their_tangents(rods, clamps):
    held = replace(clamps, start=Clamp.TANGENT, end=Clamp.TANGENT)
    about_z = Rotation.from_euler("z", 30.0, degrees=True).as_matrix()
    path = ClampPath(np.arange(2.0), end_frame=np.stack([clamps.end_frame, about_z @ clamps.end_frame]), tangents_only=True)
    prediction = predict(rods, MATERIAL, held, path)
    assert prediction.followed.all() and (prediction.end_rotation == 0).all()
    np.testing.assert_allclose(prediction.at(-1).frames[:, -1, :, 0], (about_z @ clamps.end_frame)[..., 0], atol=1e-9)
    np.testing.assert_allclose(prediction.total_twist[-1], 0, atol=1e-6)


@pytest.mark.thorough
def test_loads_go_along(rods, clamps):
    """Each rod carries its own: both predictions end where relaxing under them does, and a candidate motion too."""
    force, mass = np.zeros((2, EDGES + 1, 3)), np.zeros((2, EDGES + 1))
    force[0, 12], mass[1, 20] = (0.0, 150.0, 0.0), 100.0
    loads, path = PointLoads(force, mass), line(clamps, *SHIFTS[::2])
    goal = replace(clamps, end_position=clamps.end_position + SHIFTS[-1])
    found = predict(rods, MATERIAL, clamps, path, loads=loads)
    assert found.followed.all() and (found.jumps == 0).all()
    there = relax(found.at(-1), MATERIAL, goal, external=loads)
    np.testing.assert_allclose(found.vertices[-1], there.configuration.vertices, atol=1e-4)
    np.testing.assert_allclose(found.energy[-1], there.energy, rtol=1e-8)
    bare = predict(rods, MATERIAL, clamps, path)
    assert (np.abs(found.vertices[-1] - bare.vertices[-1]).max(axis=(1, 2)) > 0.3).all()
    slowly = predict_moving(rods, MATERIAL, clamps, path, Dynamics(), Stepping(1.0, quasi_static=True), loads=loads)
    np.testing.assert_allclose(slowly.vertices[-1], there.configuration.vertices, atol=1e-3)
    one = PointLoads(force[:1])
    begin = relax(rods.take([0]), MATERIAL, clamps.take([0]), external=one).configuration
    step, jumps = predict_step(begin, MATERIAL, clamps.take([0]), goal.take([0, 0]), loads=one, precision="f64")
    assert (jumps == 0).all()
    np.testing.assert_allclose(step.configuration.vertices, there.configuration.vertices[[0, 0]], atol=1e-4)


@pytest.mark.thorough
def test_a_slow_motion_is_that_of_statics(rods, clamps):
    path = line(clamps, *SHIFTS, rotation=np.radians(40.0) * np.arange(5))
    still = predict(rods, MATERIAL, clamps, path, between=2)
    slow = predict_moving(rods, MATERIAL, clamps, path, LOSSES, Stepping(0.02), between=2)
    np.testing.assert_allclose(slow.vertices[[0, -1]], still.vertices[[0, -1]], atol=1e-3)
    np.testing.assert_allclose(slow.end_rotation[::2], still.end_rotation[::2], atol=1e-6)
    np.testing.assert_allclose(slow.total_twist[-1], still.total_twist[-1], atol=1e-4)
    np.testing.assert_allclose(slow.energy[[0, -1]], still.energy[[0, -1]], rtol=1e-5)
    np.testing.assert_allclose(slow.end_force[-1], still.end_force[-1], rtol=1e-2, atol=5.0)
    assert slow.followed.all()


def test_a_fast_motion_is_that_of_the_time_steps(rods, clamps):
    """Of two materials, every rod as it moves alone, with grippers on the same path."""
    material, path = Material([6e5, 2e5], [8e5, 3e5]), line(clamps, *SHIFTS)
    found = predict_moving(rods, material, clamps, path, LOSSES, Stepping(1000.0, 4), between=3)
    assert found.vertices.shape == (13, 4, 34, 3) and found.followed.all()
    np.testing.assert_allclose(found.time, np.arange(13) / 3000.0)
    grippers = replace(Grippers.resting(clamps, 5), end_position=clamps.end_position[:, None] + SHIFTS).refined(3)
    for rod in range(4):
        of_material, motion = divmod(rod, 2)
        alone = simulate(found.at(0).take([rod]), material.take([of_material]), grippers.take([motion]), LOSSES,
                         Stepping(3000.0, 4))
        np.testing.assert_allclose(found.vertices[1:, rod], alone.positions[0], atol=1e-9)
    slow = predict(rods, material, clamps, path, between=3)
    assert np.abs(found.vertices - slow.vertices).max() > 1.0


def test_motions_whose_speed_or_sense_is_unclear_are_refused(rods, clamps):
    spun = line(clamps, rotation=[0.0, 7.0])
    check_refused("end_rotation", predict_moving, rods, MATERIAL, clamps, spun, LOSSES, Stepping(10.0))
    check_refused("time_s", rate_of, ClampPath(np.array([0.0, 1.0, 3.0]), end_position=np.zeros((3, 1, 3))))
    assert rate_of(ClampPath(np.array([1.0, 1.5, 2.0]), end_position=np.zeros((3, 1, 3)))) == pytest.approx(2.0)
