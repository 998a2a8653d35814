"""What solutions and predictions say of contact."""

from dataclasses import replace

import numpy as np
import pytest

from doo_ti import Capsule, ClampPath, Dynamics, Grippers, Group, Newton, Plane, Stepping, relax, simulate
from doo_ti.groups.relax_group import relax_group
from doo_ti.motion.predict import predict, predict_step
from doo_ti.rod.shapes import rod_along, straight_rod
from doo_ti.rod.types import Clamp, Clamps, Configuration, Material, Solution, Status
from tests.conftest import check_refused
from tests.references.rods import certified, clamps_at
from tests.relaxation.rods import assert_same
from tools.bench import contact as pegs
from tools.bench.contact import Specimens

TABLE, RADIUS = Plane((0, 0, 0), (0, 0, 1)), 2.0
PEG = Capsule((48.0, 0.0, -50.0), (48.0, 0.0, 60.0), 4.0)


def held(heights) -> tuple[Configuration, Clamps]:
    """Rods of 200 mm, held horizontally at these heights by one end."""
    rods = Configuration.concatenate([straight_rod(200.0, 20, (0.0, 0.0, height)) for height in heights])
    return rods, clamps_at(rods, Clamp.FRAME, Clamp.FREE)


@pytest.fixture(scope="module")
def solution():
    rods, clamps = held([20.0, 500.0, -20.0])
    return relax(rods, Material(6e5, 6e5), clamps, obstacles=[TABLE], radius=RADIUS)


def test_forces_follow_their_rods_and_obstacles_do_not(solution):
    both = Solution.concatenate([solution.take([1, 0]), solution.take([0])])
    assert (both.contact_force == solution.contact_force[[1, 0, 0]]).all() and both.contact is None
    rods, clamps = held([20.0])
    alone = relax(rods, Material(6e5, 6e5), clamps)
    assert alone.contact is None and alone.contact_force is None and alone.take([0]).contact_force is None


@pytest.mark.parametrize("options", [{}, {"solver": Newton(max_iterations=1), "precision": "f32"}], ids=["at rest", "stopped"])
def test_out_of_reach_of_obstacles_rods_are_as_without(options):
    """Also where f32 cannot finish them."""
    rods, clamps = held([900.0, 950.0])
    far, alone = (relax(rods, Material(6e5, 6e5), clamps, **options, **more)
                  for more in ({"obstacles": [TABLE], "radius": 1.0}, {}))
    assert_same(far, slice(None), alone, slice(None))
    assert not far.contact.touching.any()


def test_each_rod_has_its_own_obstacles_along_a_path():
    rods, clamps = held([20.0, 20.0])
    tables = Plane([[0, 0, 0], [0, 0, -30]], [[0, 0, 1], [0, 0, 1]])
    places = np.array([[0.0, 0, 20], [0, 0, 10]])[:, None]
    path = ClampPath(np.array([0.0, 1.0]), places, None, None, None, None, source="lowered")
    found = predict(rods, Material(6e5, 6e5), clamps, path, precision="f64", obstacles=[tables], radius=[2.0, 3.0])
    assert found.followed.all() and found.contact_force.shape == (2, 2, 21, 3)
    assert found.vertices[..., 2].min(axis=-1) == pytest.approx(np.array([[2.0, -27.0]] * 2), abs=1e-3)


def test_a_straight_rod_that_is_pushed_onto_a_table_from_above_bends_away():
    rod = straight_rod(99.0, 20, (0.0, 0.0, 100.0), (0.0, 0.0, -1.0))
    clamps = replace(clamps_at(rod, Clamp.FRAME, Clamp.FREE), start_position=np.array([[0.0, 0.0, 99.0 + RADIUS - 0.3]]))
    found = certified(relax(rod, Material(1e5, 1e5), clamps, obstacles=[TABLE], radius=RADIUS))
    tip = found.configuration.vertices[0, -1]
    assert tip[2] == pytest.approx(RADIUS, abs=1e-3) and np.abs(tip[:2]).max() > 1.0


def test_candidate_motions_end_on_the_table(solution):
    rods, clamps = held([20.0])
    places = np.array([[0.0, 0, 20], [10, 0, 12], [0, 0, 60]])
    goal = replace(clamps.take([0, 0, 0]), start_position=places, end_position=places)
    lying = solution.configuration.take([0])
    found, _ = predict_step(lying, Material(6e5, 6e5), clamps, goal, precision="f64", obstacles=[TABLE], radius=RADIUS)
    assert found.converged.all() and found.contact.touching.any(axis=1).all()
    assert found.contact.gap.min() > -1e-3 * RADIUS
    alone = relax(rods, Material(6e5, 6e5), goal.take([1]), obstacles=[TABLE], radius=RADIUS)
    assert np.abs(found.configuration.vertices[1] - alone.configuration.vertices[0]).max() < 1e-3
    check_refused("radius: missing beside obstacles", predict_step, lying, Material(6e5, 6e5), clamps, goal, obstacles=[TABLE])


@pytest.mark.thorough
@pytest.mark.parametrize("clamp, status", [(Clamp.FRAME, Status.INFEASIBLE), (Clamp.POSITION, Status.CONVERGED)])
def test_a_clamp_that_holds_the_middle_of_an_edge_in_a_peg_is_infeasible(clamp, status):
    """Both its vertices are outside. A clamp of the point alone lets the edge turn away."""
    rod = straight_rod(60.0, 20)
    clamps = clamps_at(rod, clamp, Clamp.POSITION)
    clamps.end_position[:, 0] -= 6.0
    peg = Capsule((1.5, -4.95, -50.0), (1.5, -4.95, 50.0), 4.0)
    assert peg.distance(rod.vertices[:, :2])[0].min() > 1.0
    around = dict(up=(0.0, 1.0, 0.0), obstacles=[peg], radius=1.0)
    found = relax(rod, Material(1e5, 1e5), clamps, **around)
    group = relax_group(Group([rod], Material(1e5, 1e5), [clamps]), **around)
    assert found.status[0] == group.status[0] == status


def round_a_peg(height: float) -> tuple[Configuration, Clamps]:
    """A rod along x whose middle, at that height, goes round the side of a peg, and clamps of its ends."""
    x = np.linspace(0.0, 96.0, 200)
    rod = rod_along(np.stack([x, 12.0 * np.sin(np.pi * x / 96.0) ** 2, np.full(200, height)], axis=1), 33)
    return rod, clamps_at(rod, Clamp.POSITION, Clamp.POSITION)


@pytest.mark.parametrize("precision", ["f64", pytest.param("f32", marks=pytest.mark.thorough)])
def test_a_rod_that_is_too_short_to_get_round_a_peg_is_stalled_before_its_forces_overflow(precision):
    """It lies round the peg, and its ends are then drawn further apart than that allows."""
    (rod, clamps), material = round_a_peg(1.02), Material(1e5, 1e5, 6.0)
    clamps.end_position[:] = rod.start + [rod.rest_length.sum() - 0.1, 0.0, 0.0]
    found = relax(rod, material, clamps, precision=precision, obstacles=[TABLE, PEG], radius=1.0)
    assert found.status[0] == Status.STALLED and found.iterations[0] < 400 and np.isfinite(found.contact_force).all()
    # Relaxed again it begins anew, without the forces that it has ended with.
    assert relax(found, material, precision=precision).iterations[0] > 20


@pytest.mark.thorough
def test_a_step_in_which_forces_overflow_is_tried_again_in_parts():
    """A try that begins with what they have grown to would end at once; each of the tries takes dozens of trips."""
    (rod, clamps), material = round_a_peg(0.0), Material(1e5, 1e5, 1.0)
    around = dict(obstacles=[PEG], radius=1.0, up=(0.0, -1.0, 0.0))
    rest = relax(rod, material, clamps, **around).configuration
    far = rod.start + np.outer([96.0, 98.0, rod.rest_length.sum() - 0.5], [1.0, 0.0, 0.0])
    grippers = replace(Grippers.resting(clamps, 3), end_position=far[None])
    moved = simulate(rest, material, grippers, Dynamics(), Stepping(10.0, quasi_static=True), **around)
    assert moved.status[0].tolist() == [Status.CONVERGED, Status.STALLED] and moved.iterations[0, 1] > 700


@pytest.mark.thorough
@pytest.mark.parametrize("precision", ["f32", "f64"])
def test_rods_at_rest_are_relaxed_again_with_other_material(precision):
    """Some are so tight around a peg that it bears thousands of times what bends the rod."""
    specimens = Specimens(4096)
    rest, found = specimens.on_table, specimens.relaxed_again(precision)
    assert found.converged[rest.converged].mean() > 0.9995 and np.median(found.iterations) < 12
    assert found.contact.gap[found.converged].min() > -1e-3


@pytest.mark.thorough
def test_a_solution_among_the_same_obstacles_begins_with_its_forces():
    """From where it is it would have to find them again; among other obstacles it does."""
    rods, material, clamps = Specimens(64).laid_down
    around = dict(obstacles=pegs.obstacles(), radius=pegs.RADIUS)
    rest = relax(rods, material, clamps, **around)
    again, without = (relax(start, material, clamps, **around) for start in (rest, rest.configuration))
    assert again.converged.all() and again.iterations.mean() < 0.6 * without.iterations.mean()
    assert np.abs(again.configuration.vertices - rest.configuration.vertices).max() < 2e-3 * pegs.RADIUS
    lower = dict(obstacles=pegs.obstacles(0.5), radius=pegs.RADIUS)
    lowered, expected = (relax(start, material, clamps, **lower) for start in (rest, rest.configuration))
    np.testing.assert_array_equal(lowered.configuration.quaternions, expected.configuration.quaternions)
