"""Groups with inertia: as single rods where nothing ties them, and by the momentum that they have."""

from dataclasses import replace

import numpy as np
import pytest

from doo_ti import Clamp, Grippers, Group, Material, Newton, Plane, follow_group, relax_group, simulate
from doo_ti.dynamics.parameters import GRAVITY, Dynamics, MovingStart, Stepping, vertex_lengths
from doo_ti.rod.shapes import end_clamps, straight_rod
from tests.conftest import check_refused
from tests.groups.test_groups import a_y

MATERIAL = Material(3e5, 2e5, rest_curvature=np.array([2e-3, -1e-3]))
LOSSES = Dynamics(bend_damping=0.02, twist_damping=0.01, drag=0.3, quadratic_drag=1e-4, point_mass=2.0)
RATE, MOMENTS = 100.0, 30
EXACT = Newton(tolerance=1e-9, max_iterations=1000)


def shaken(rod, end) -> Grippers:
    """Of a rod whose start is held and moves to and fro, and its far end half as much."""
    still = Grippers.resting(end_clamps(rod, Clamp.FRAME, end), MOMENTS)
    aside = 8.0 * np.sin(0.3 * np.arange(MOMENTS))[:, None] * [1.0, 0.0, 0.0]
    nearer = 0.0 if end == Clamp.FREE else 0.3 * (still.end_position - still.start_position)
    return replace(still, start_position=still.start_position + aside, end_position=still.end_position - nearer + 0.5 * aside)


def followed(group: Group, moments: list, **options) -> list:
    """The solutions, one after the other, all of which have converged."""
    found = list(follow_group(group, moments, EXACT, **options))
    assert all(moment.converged.all() for moment in found)
    return found


def places(solutions) -> np.ndarray:
    """(T, all vertices, 3) of the first group."""
    return np.array([np.concatenate([rod.vertices[0] for rod in solution.rods]) for solution in solutions])


@pytest.mark.sampled(1)
@pytest.mark.parametrize("vertex_clamps", [False, True])
@pytest.mark.parametrize("scheme", ["bdf2", "euler"])
@pytest.mark.parametrize("end", [Clamp.FREE, Clamp.TANGENT])
def test_rods_that_are_not_tied_move_as_each_alone(vertex_clamps, scheme, end):
    """With all losses, and another material for the second: against `simulate`, to 1e-6 of the length."""
    rods = [straight_rod(100.0, 20, (0, 0, 0), (0.5, 0, -1.0), vertex_clamps=vertex_clamps),
            straight_rod(80.0, 16, (0, 200, 0), (0, 0.2, -1.0), vertex_clamps=vertex_clamps)]
    materials = [MATERIAL, Material(1e5, 1e5, 0.5)]
    dynamics = [LOSSES, Dynamics(density=1.5, drag=0.1)]
    grippers = [shaken(rod, end) for rod in rods]
    moments = [[held.at(moment) for held in grippers] for moment in range(MOMENTS)]
    found = followed(Group(rods, materials, moments[0]), moments, dynamics=dynamics, rate=RATE, scheme=scheme)
    kinetic = potential = 0.0
    for number, held in enumerate(grippers):
        start = MovingStart(found[0].rods[number], smooth=False)
        alone = simulate(start, materials[number], held, dynamics[number], Stepping(RATE, scheme=scheme, detailed=True))
        own = np.array([moment.rods[number].vertices[0] for moment in found[1:]])
        assert np.abs(own - alone.positions[0]).max() < 1e-7 * rods[number].rest_length.sum()
        if end != Clamp.FREE:
            forces = np.array([moment.end_force[0, number] for moment in found[1:]])
            assert np.abs(forces - alone.end_force[0]).max() < 1e-4 * np.abs(forces).max()
        energies = alone.detail.energies
        kinetic += energies["kinetic"][0]
        potential += sum(energies[name][0] for name in ("bending", "twist", "gravity"))
    assert np.allclose([moment.kinetic[0] for moment in found], kinetic, rtol=1e-4, atol=1e-6 * kinetic.max())
    own = np.array([moment.energy[0] for moment in found])
    assert np.abs(own - own[0] - potential + potential[0]).max() < 1e-5 * np.abs(own - own[0]).max()


def harness(count: int = 1) -> Group:
    """As often, the ropes that hang from three points and are tied, with a weight, at their other ends; of three materials."""
    return replace(a_y(12).take(np.zeros(count, dtype=int)), materials=[
        Material(1e5, 8e4), Material(1e5, 8e4, 0.5), Material(2e5, 8e4)])


def slope(values: np.ndarray) -> np.ndarray:
    """Per second, by BDF2, of (T, ...) values that are constant before the first."""
    steps = np.diff(values, axis=0, prepend=values[:1])
    return RATE * (1.5 * steps[1:] - 0.5 * steps[:-1])


def test_clamps_change_the_momentum():
    """Ropes tied at a weight, whose grippers move: the force of all clamps is what the momentum gains, and the weight."""
    group = harness()
    moments = [[replace(held, start_position=held.start_position + [[6.0 * np.sin(0.25 * moment + number), 0.0, moment / 10]])
                for number, held in enumerate(group.clamps)] for moment in range(MOMENTS)]
    found = followed(group, moments, dynamics=Dynamics(), rate=RATE)
    assert max(moment.closure[0] for moment in found) < 1e-9
    weight = np.concatenate([2.0 * material.weight[0] * vertex_lengths(rod.rest_length)
                             for rod, material in zip(group.rods, group.each_material, strict=True)])
    for tie, (vertex, _) in zip(group.ties, group.tied, strict=True):
        weight[vertex] += tie.weight
    speed = np.pad(slope(places(found)), ((1, 0), (0, 0), (0, 0)))
    gain = weight / GRAVITY @ slope(speed)
    clamps = np.array([(moment.start_force + moment.end_force)[0].sum(axis=0) for moment in found[1:]])
    assert np.abs(clamps - gain - [0.0, 0.0, weight.sum()]).max() < 1e-5 * weight.sum()
    kinetic = 0.5 * (speed[1:] ** 2).sum(axis=-1) @ weight / GRAVITY
    np.testing.assert_allclose(kinetic, [moment.kinetic[0] for moment in found[1:]], rtol=1e-9)


@pytest.mark.thorough
def test_rods_that_collide_keep_their_momentum():
    """A weightless rod that clamps have thrown hits another one, which nothing holds."""
    thrown, hit = straight_rod(60.0, 12, (0, 0, 0), (1, 0, 0)), straight_rod(60.0, 12, (30, 7, -20), (0, 0, 1))
    group = Group([thrown, hit], Material(2e4, 2e4, 0.0), [end_clamps(rod, Clamp.FRAME, Clamp.FREE) for rod in (thrown, hit)])
    held, still = group.clamps
    free = end_clamps(hit, Clamp.FREE, Clamp.FREE)
    moving = [replace(held, start_position=held.start_position + [[0.0, moment, 0.0]]) for moment in range(1, 4)]
    moments = [[held, still], *([clamps, free] for clamps in moving), *[[free, free]] * 30]
    found = followed(group, moments, dynamics=Dynamics(density=1.0), rate=200.0, scheme="euler", radius=1.5)
    mass = np.tile(2.0 / GRAVITY * vertex_lengths(hit.rest_length), 2)
    momentum = np.diff(places(found), axis=0).transpose(0, 2, 1) @ mass * 200.0
    assert np.abs(momentum[4:] - momentum[3]).max() < 1e-4 * np.linalg.norm(momentum[3])
    gap, moved = np.array([moment.gap[0] for moment in found]), found[-1].rods[1].vertices - hit.vertices
    assert gap.min() > -1e-3 * 1.5 and (gap < 0.01).any() and moved[..., 1].mean() > 1.0


@pytest.mark.thorough
def test_a_group_moves_among_others_as_alone():
    group = harness(3)
    rods = [replace(rod, start=rod.start + [[0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [2.0, 0.0, 0.0]]) for rod in group.rods]
    group = replace(group, rods=rods)
    moments = [[replace(end_clamps(rod, Clamp.POSITION, Clamp.FREE), start_position=rod.start + [[2.0 * moment, 0.0, 0.0]])
                for rod in rods] for moment in range(4)]
    options = {"dynamics": LOSSES, "rate": RATE, "radius": 1.0, "contact": False,
               "obstacles": [Plane((0, 0, -32), (0, 0, 1), friction=0.3)]}
    together = list(follow_group(group, moments, **options))
    own = np.array([1])
    alone = list(follow_group(group.take(own), [[held.take(own) for held in moment] for moment in moments], **options))
    for every, one in zip(together, alone, strict=True):
        assert all(np.array_equal(rod.vertices[1], single.vertices[0])
                   for rod, single in zip(every.rods, one.rods, strict=True))
        assert every.kinetic[1] == one.kinetic[0] and np.array_equal(every.tie_force[1], one.tie_force[0])
    assert np.abs(together[-1].contact_force[0]).max() > 0.0


def test_at_rest_a_group_stays_there():
    """Point masses pull from the first moment on."""
    group = harness()
    rest = relax_group(group, EXACT)
    for dynamics in (replace(LOSSES, point_mass=0.0), LOSSES):
        moments = list(follow_group(group, [group.clamps] * 4, EXACT, dynamics=dynamics, rate=RATE))
        assert np.abs(places(moments[1:]) - places(moments[:1])).max() < 1e-5 and moments[-1].kinetic[0] < 1e-6
        assert abs(moments[-1].energy[0] - moments[0].energy[0]) < 1e-7 * abs(rest.energy[0])
        assert (np.abs(places(moments[:1]) - places([rest])).max() < 1e-5) == (dynamics is not LOSSES)


def test_what_does_not_match_is_named():
    group = harness()
    moments = [group.clamps] * 2
    for options, message in (
            ({"dynamics": Dynamics()}, "rate: missing beside dynamics"), ({"rate": 10.0}, "dynamics: missing beside rate"),
            ({"dynamics": Dynamics(), "rate": -1.0}, "rate"), ({"dynamics": [Dynamics()], "rate": 10.0}, "1 for 3 rods"),
            ({"dynamics": 3.0, "rate": 10.0}, "dynamics: 3.0; give a Dynamics"),
            ({"dynamics": Dynamics(), "rate": 10.0, "scheme": "rk4"}, "rk4"),
            ({"dynamics": Dynamics(drag=[0.1, 0.2]), "rate": 10.0}, "2 rows for rod 0"),
            ({"dynamics": Dynamics(density=0.0), "rate": 10.0}, "rod 0: density"),
            ({"dynamics": Dynamics(point_mass=np.ones((1, 5))), "rate": 10.0}, "5 vertices")):
        check_refused(message, lambda given: list(follow_group(group, moments, **given)), options)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("tilt", [0.0, 0.3])
def test_groups_do_not_bounce_off_obstacles(tilt):
    rod = straight_rod(60.0, 12, (0.0, 0.0, 12.0), (1.0, 0.0, tilt))
    held, free = (end_clamps(rod, start, Clamp.FREE) for start in (Clamp.FRAME, Clamp.FREE))
    found = followed(Group([rod], [Material(1e6, 1e6)], [held]), [[held]] + [[free]] * 39, radius=1.0, contact=False,
                     obstacles=[Plane((0, 0, 0), (0, 0, 1))], dynamics=Dynamics(density=1.0), rate=200.0)
    energy = np.array([moment.energy[0] + moment.kinetic[0] for moment in found[1:]])
    assert np.diff(energy).max() < 1e-6 * np.ptp(energy)
    assert np.abs(found[-1].rods[0].vertices[..., 2] - 1.0).max() < 1e-3
