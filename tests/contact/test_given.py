"""What functions are given of obstacles: rows that do not match, missing radii, and what is no obstacle."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from doo_ti import Clamp, ClampPath, Group, Material, Newton, end_loads, predict, relax, relax_group, simulate
from doo_ti.contact.obstacles import Box, Capsule, Plane, Ring, Sphere
from doo_ti.contact.surroundings import Itself, Moving, Surroundings
from doo_ti.dynamics.grippers import Grippers, obstacle_path
from doo_ti.dynamics.parameters import Dynamics, Stepping
from doo_ti.relaxation.time_loading import POSE_COLUMNS
from doo_ti.rod.frames import rotation_matrix
from doo_ti.rod.shapes import end_clamps, hanging, rod_along, straight_rod
from doo_ti.rod.types import Configuration
from tests.conftest import check_refused
from tests.contact.clutter import gaps
from tests.contact.test_obstacle_files import sampled

FLOOR = Plane((0, 0, -10), (0, 0, 1))
MATERIAL = Material(1e5, 1e5)
ROD = straight_rod(60.0, 10)
HELD = end_clamps(ROD, Clamp.FRAME, Clamp.FREE)
RING = Ring((27, 0, 0), (0, 0, 1), 3.0, 0.6)


def simulated(count: int = 4, **around):
    rods, clamps = hanging(100.0, 12, start=np.zeros((count, 3)), end=(70, 0, 0))
    return simulate(rods, MATERIAL, Grippers.resting(clamps, 3), Dynamics(), Stepping(100.0), **around)


@pytest.mark.parametrize("rows", [3, 6])
def test_rows_that_do_not_match_the_rods(rows):
    spheres = Sphere(np.tile([0.0, 500.0, 0.0], (rows, 1)), 5.0)
    for given in (spheres, Moving(spheres, np.zeros((3, 3)))):
        check_refused(f"obstacles: {rows} rows of Sphere for 4 rods", simulated, obstacles=[given], radius=1.0)
    check_refused(f"radius: {rows} for 4 rods", simulated, obstacles=[FLOOR], radius=np.ones(rows))


@pytest.mark.parametrize("obstacles", [[Itself()], [FLOOR], [Moving(FLOOR, np.zeros((3, 3)))]])
@pytest.mark.parametrize("radius, problem", [(None, "missing beside obstacles"), (-1.0, "-1"), (np.nan, "nan")])
def test_a_radius_that_is_none(obstacles, radius, problem):
    check_refused(f"radius: {problem}", simulated, obstacles=obstacles, radius=radius)
    if radius is not None:
        check_refused(f"radius: {problem}", relax, ROD, MATERIAL, HELD, radius=radius)
    elif not isinstance(obstacles[0], Moving):
        check_refused("radius: missing", relax_group, Group([ROD], MATERIAL, [HELD]), obstacles=obstacles)


@pytest.mark.parametrize("wrong, problem", [(FLOOR, "a Plane; give a list"), (None, "None"), (["x"], "'x'"),
                                            ([Itself(), Itself()], "Itself more than once")])
def test_what_is_no_list_of_obstacles(wrong, problem):
    for call in (partial(relax, ROD, MATERIAL, HELD), simulated, partial(relax_group, Group([ROD], MATERIAL, [HELD]))):
        check_refused(f"obstacles: {problem}", call, obstacles=wrong, radius=1.0)


def test_friction_in_predictions_and_reflections_are_refused():
    path = ClampPath(time=np.arange(2.0), end_position=np.zeros((2, 1, 3)))
    rough = replace(FLOOR, friction=0.3)
    check_refused("obstacles: with friction", predict, ROD, MATERIAL, HELD, path, obstacles=[rough], radius=1.0)
    mirror = np.diag([1.0, 1.0, -1.0])
    check_refused("rotation: a reflection", Box, (0, 0, 0), (1, 1, 1), mirror)
    check_refused("rotation: a reflection", Moving, FLOOR, np.zeros((2, 3)), np.stack([np.eye(3), mirror]))


def test_a_moving_capsule_of_which_one_end_has_rows():
    body = Capsule((0, 0, 0), [[0, 0, 4], [0, 2, 4]], 1.0)
    np.testing.assert_allclose(Moving(body, np.zeros((2, 3))).pivot, [[0, 0, 2], [0, 1, 2]])


@pytest.mark.thorough
def test_relaxing_again_leaves_the_first_solution_as_it_was():
    rods, clamps = hanging(100.0, 20, start=np.zeros((3, 3)), end=(50, 0, 0))
    first = relax(rods, MATERIAL, clamps, obstacles=[Plane((0, 0, -36), (0, 0, 1))], radius=1.0)
    loads, force = end_loads(first).start_force.copy(), first.contact_force.copy()
    assert (force != 0).any()
    heavy, again = (relax(first, Material(1e5, 1e5, 3.0)) for _ in range(2))
    np.testing.assert_array_equal(end_loads(first).start_force, loads)
    np.testing.assert_array_equal(first.contact_force, force)
    np.testing.assert_array_equal(heavy.configuration.vertices, again.configuration.vertices)


@pytest.mark.thorough
def test_f64_restarts_from_the_start():
    """A rod that f32 could not finish begins in f64 where it was given, though vertex 0 is free."""
    rod, around = straight_rod(100.0, 20, (0, 0, 30), (1, 0, 0)), dict(obstacles=[FLOOR], radius=1.0)
    held = end_clamps(rod, Clamp.FREE, Clamp.POSITION)
    held.end_position[:, 1] += 60.0
    single = relax(rod, MATERIAL, held, Newton(max_iterations=4), precision="f32", **around)
    double = relax(rod, MATERIAL, held, Newton(max_iterations=4, first_shift=0.0), **around)
    assert not single.converged[0] and single.precision[0] == 64
    np.testing.assert_array_equal(single.configuration.vertices, double.configuration.vertices)


def test_obstacles_of_single_rods_are_as_shared_ones():
    """In which way a straight start is bowed does not depend on how the obstacle is given."""
    rod = straight_rod(100.0, 20)
    held = replace(end_clamps(rod, Clamp.POSITION, Clamp.POSITION), end_position=np.array([[70.0, 0, 0]]))
    for side in (-12.0, 12.0):
        one, spheres = Sphere((35, 0, side), 8.0), Sphere([[35, 0, side], [35, 300, side]], 8.0)
        alone = relax(rod, MATERIAL, held, obstacles=[one], radius=1.0)
        both = relax(rod.take([0, 0]), MATERIAL, held.take([0, 0]), obstacles=[spheres], radius=1.0)
        assert alone.status[0] == both.status[0]
        np.testing.assert_array_equal(alone.configuration.vertices[0], both.configuration.vertices[0])


def test_no_rod_is_stable_whose_forces_still_change():
    """The trips run out at shapes that are minima under forces of which the rounds are not over."""
    rod = straight_rod(100.0, 30, (0.0, 0.0, 1.5)).take([0] * 32)
    held = end_clamps(rod, Clamp.FRAME, Clamp.POSITION)
    held.end_position[:, 0] -= np.linspace(5.0, 40.0, 32)
    around = dict(obstacles=[Plane((0, 0, 0), (0, 0, 1)), Capsule((50.0, 3.0, -5.0), (50.0, 3.0, 60.0), 2.0)], radius=1.0)
    for most in (14, 16, 18):
        found = relax(rod, Material(1e5, 1e5, 5.0), held, Newton(max_iterations=most), **around)
        assert not found.converged.all() and not found.stable[~found.converged].any()


@pytest.mark.parametrize("push", [1.0, 3.0, 12.0])
def test_a_straight_start_has_room_in_a_channel(push):
    """Between four planes it is bowed in more and lower waves: no wide arch fits."""
    rod = straight_rod(90.0, 45)
    held = end_clamps(rod, Clamp.FRAME, Clamp.FRAME)
    held.end_position[:, 0] -= push
    walls = [Plane(np.multiply(-8.0, normal), normal) for normal in ((0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1))]
    found = relax(rod, MATERIAL, held, obstacles=walls, radius=0.7)
    assert found.converged[0] and found.contact.gap[0] > -1e-3


@pytest.mark.parametrize("edges, ring, least", [
    (10, RING, 0.7), (30, RING, 0.95),
    pytest.param(10, sampled(RING, 0.2, (22, -5, -2), (32, 5, 2)), 0.7, id="grid", marks=pytest.mark.thorough)])
def test_no_rod_that_has_converged_is_inside_a_ring(rng, edges, ring, least):
    """Also where an edge is twice as long as the ring's hole is wide, and near to it twice: such a rod is stalled."""
    count, radius = 60, 0.3
    place = np.stack([np.zeros(count), rng.uniform(-4, 4, count), rng.uniform(8, 16, count)], -1)
    rod = replace(straight_rod(60.0, edges).take([0] * count), start=place)
    held = end_clamps(rod, Clamp.FRAME, Clamp.FRAME)
    held.end_position[:, 0] -= rng.uniform(1, 15, count)
    found = relax(rod, Material(10 ** rng.uniform(2.5, 4.5, count), 1e4), held, obstacles=[ring], radius=radius)
    gap = gaps([ring], found.configuration.vertices, radius, along=60)
    assert (gap[found.converged] > -0.05 * radius).all() and not found.stable[~found.converged].any()
    assert found.converged.mean() > least


def test_moving_planes_of_single_rods_count_where_these_are():
    """Two rods a metre apart, each with a table that tilts about it: neither limits the other's step."""
    begin = np.array([[0.0, 0, 0], [1000.0, 0, 0]])
    rods, _ = hanging(100.0, 12, start=begin, end=begin + [70.0, 0, 0])
    tilt = rotation_matrix(np.outer(0.004 * np.arange(3.0), [0, 1.0, 0]))
    own, shared = (Moving(Plane(point, (0, 0, 1)), np.zeros((3, 3)), tilt) for point in (begin - [0, 0, 60], (0, 0, -60)))
    assert obstacle_path(Surroundings([own], 1.0), Stepping(100.0), 3, rods).shape == (2, 3, 1, POSE_COLUMNS)
    check_refused("a Plane moves by 4", obstacle_path, Surroundings([shared], 1.0), Stepping(100.0), 3, rods)


@pytest.mark.parametrize("wire", [0.5, 0.275, 0.05])
def test_limp_ropes_over_a_wire_of_any_thickness(rng, wire):
    """The same zone that centrelines may not enter, however wire and rod share it."""
    count = 40
    place = np.stack([np.zeros(count), rng.uniform(-3, 3, count), rng.uniform(5, 40, count)], -1)
    rope = replace(straight_rod(100.0, 40).take([0] * count), start=place)
    found = relax(rope, Material(10 ** rng.uniform(2.5, 4, count), 1e5), end_clamps(rope, Clamp.FRAME, Clamp.FREE),
                  obstacles=[Capsule((50, -300, 0), (50, 300, 0), wire)], radius=0.55 - wire)
    assert found.converged.all() and (found.contact_force != 0).any(axis=(1, 2)).mean() > 0.5


@pytest.mark.thorough
def test_long_edges_do_not_pass_through_thin_pegs(rng):
    """Of 10 mm, a hundred times as long as the pegs are thick, over which the rods begin."""
    count, x = 400, np.linspace(0.0, 1.0, 200)
    height, place = rng.uniform(5.0, 25.0, count), rng.uniform(30.0, 60.0, count)
    rods = Configuration.concatenate([
        rod_along(np.stack([90.0 * x, 0.0 * x, high * np.sin(np.pi * x)], axis=1), 12) for high in height])
    point = np.stack([place, 0.0 * place, rng.uniform(-20.0, 0.6 * height)], axis=1)
    pegs = Capsule(point - [0, 50, 0], point + [0, 50, 0], np.full(count, 0.05))
    held = end_clamps(rods, Clamp.POSITION, Clamp.POSITION)
    found = relax(rods, Material(1e4, 1e4, 1.0), held, obstacles=[pegs], radius=0.05)

    def above(vertices):
        return np.array([np.interp(at[0], one[:, 0], one[:, 2]) - at[2] for at, one in zip(point, vertices, strict=True)])

    over = found.converged & (above(rods.vertices) > 0.1)
    assert over.sum() > 100 and (above(found.configuration.vertices)[over] > 0.0).all()
