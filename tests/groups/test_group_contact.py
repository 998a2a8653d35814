"""Rods of a group that press against each other, that are hooked into each other, and that lie on obstacles."""

from dataclasses import replace

import numpy as np
import pytest

from doo_ti import Clamp, Configuration, Cylinder, Group, Itself, Material, Plane, Status, Tie, Touch, follow_group, relax_group
from doo_ti.rod.shapes import end_clamps, rod_along, straight_rod
from tests.contact.topology import linking
from tests.oracle.chain_form import chain_energy, rod_of
from tests.references.rods import certified
from tests.relaxation.rods import wandering
from tools.studies.group_study import drawn

RADIUS, STIFFNESS = 1.0, 1e5
WEIGHTLESS, TABLE = Material(STIFFNESS, STIFFNESS, 0.0), Plane((0, 0, 0), (0, 0, 1))


def compliance(length: float, reach: float) -> float:
    """Deflection over a force across a cantilever of edges of that ``length``, at ``reach`` from its clamp: every vertex before
    is a hinge of stiffness B over the length."""
    hinges = np.arange(1, int(reach / length) + 1) * length
    return float(((reach - hinges) ** 2).sum() * length / STIFFNESS)


@pytest.mark.parametrize("radii", [(RADIUS, RADIUS), (2.5 * RADIUS, RADIUS), (RADIUS, 4.0 * RADIUS)])
def test_crossed_rods_press_against_each_other(radii):
    """Cantilevers, the upper one held so low that together they have to give way by ``depth``."""
    depth = 0.3
    rods = [straight_rod(100.0, 20), straight_rod(80.0, 16, (72.5, -62.5, sum(radii) - depth), (0.0, 1.0, 0.0))]
    group = Group(rods, WEIGHTLESS, [end_clamps(rod, Clamp.FRAME, Clamp.FREE) for rod in rods])
    solution = certified(relax_group(group, radius=[radii]))
    assert abs(solution.gap[0]) < 1e-3 * RADIUS
    energy = sum(sum(chain_energy(rod_of(one, WEIGHTLESS), one.start[0], one.quaternions[0])) for one in solution.rods)
    assert solution.energy[0] == pytest.approx(energy, rel=1e-10)
    force = np.array([part[0].sum(axis=0) for part in solution.contact_force])
    assert np.abs(force.sum(axis=0)).max() < 1e-9 * np.abs(force).max()
    assert force[1, 2] == pytest.approx(depth / (compliance(5.0, 72.5) + compliance(5.0, 62.5)), rel=3e-3)
    assert np.allclose(solution.start_force[0], -force, atol=1e-9)
    through = relax_group(group, radius=[radii], contact=False)
    assert through.gap[0] == np.inf and np.abs(through.rods[0].vertices - rods[0].vertices).max() < 1e-9


def test_rods_lie_as_high_as_they_are_thick():
    """Heavy rods that begin with their ends in the board, from which these are moved out."""
    radii, material = np.array([[1.0, 4.0, 2.0], [1.5, 1.0, 0.5]]), Material(STIFFNESS, STIFFNESS)
    rods = [replace(straight_rod(120.0, 24, direction=(1.0, 0.0, -0.01)).take([0, 0]),
                    start=np.stack([0.0 * own, 20.0 * number + 0.0 * own, own + 1.0], axis=-1))
            for number, own in enumerate(radii.T)]
    clamps = [end_clamps(rod, Clamp.FRAME, Clamp.FREE) for rod in rods]
    solution = certified(relax_group(Group(rods, material, clamps), radius=radii, obstacles=[TABLE]))
    assert np.abs(solution.gap).max() < 1e-3
    for rod, own in zip(solution.rods, radii.T, strict=True):
        np.testing.assert_allclose(rod.vertices[:, -8:-1, 2], np.repeat(own[:, None], 7, axis=1), atol=1e-3)
    alone = relax_group(Group(rods[1:2], material, clamps[1:2]), radius=radii[:, 1], obstacles=[TABLE])
    np.testing.assert_allclose(solution.rods[1].vertices, alone.rods[0].vertices, atol=1e-3)
    assert solution.group.take([0]).radii(radii[:1]).tolist() == [[1.0, 4.0, 2.0]]


def linked(rods) -> float:
    """The linking number of two hooked loops, each closed by the line between its ends."""
    return linking(*(rod.vertices[0] for rod in rods))


def drawn_apart(clamps, shift: float):
    """The clamps of both loops, moved away from each other."""
    return [replace(held, start_position=held.start_position + [sense * shift, 0.0, 0.0],
                    end_position=held.end_position + [sense * shift, 0.0, 0.0])
            for held, sense in zip(clamps, (-1.0, 1.0), strict=True)]


@pytest.mark.thorough
def test_hooked_loops_stay_hooked():
    """They are drawn apart until they hang in each other, in small steps and in one, and further than they reach."""
    angle = np.linspace(0.0, np.pi, 200)
    across, along = 15.0 * np.cos(angle), 25.0 * np.sin(angle)
    rods = [rod_along(np.stack(trace, axis=-1), 33)
            for trace in ((along - 19.0, across, 0.0 * angle), (19.0 - along, 0.0 * angle, across))]
    clamps = [end_clamps(rod, Clamp.FRAME, Clamp.FRAME) for rod in rods]
    before = linked(rods)
    assert abs(abs(before) - 1.0) < 1e-9
    moments = list(follow_group(Group(rods, WEIGHTLESS, clamps), [drawn_apart(clamps, shift) for shift in (2.0, 4.0, 6.0, 7.0)],
                                radius=RADIUS))
    at_once = relax_group(Group(rods, WEIGHTLESS, drawn_apart(clamps, 7.0)), radius=RADIUS)
    for solution in (*moments, at_once):
        assert abs(linked(certified(solution).rods) - before) < 1e-9
    for solution in (moments[-1], at_once):
        assert abs(solution.gap[0]) < 1e-3 * RADIUS
        pulls = (solution.start_force + solution.end_force)[0]
        assert pulls[1, 0] > 10.0 and np.allclose(pulls[0], -pulls[1], atol=1e-6 * pulls[1, 0])
    assert abs(moments[-1].energy[0] - at_once.energy[0]) < 1e-2 * at_once.energy[0]
    torn = relax_group(Group(rods, WEIGHTLESS, drawn_apart(clamps, 15.0)), radius=RADIUS)
    assert not torn.converged[0] and abs(linked(torn.rods) - before) < 1e-9


@pytest.mark.thorough
def test_tied_rods_lie_on_a_plane():
    """A Y whose ends are held above a table: the weight that the clamps do not hold is the table's."""
    corners = np.array([[0.0, 0.0, 12.0], [80.0, 0.0, 12.0], [40.0, 70.0, 12.0]])
    middle = corners.mean(axis=0) - [0.0, 0.0, 6.0]
    rods = [straight_rod(float(np.linalg.norm(middle - corner)) + 6.0, 20, corner, middle - corner) for corner in corners]
    group = Group(rods, Material(1e4, 1e4), [end_clamps(rod, Clamp.POSITION, Clamp.FREE) for rod in rods],
                  [Tie((0, 20), (1, 20)), Tie((0, 20), (2, 20))])
    solution = certified(relax_group(group, obstacles=[TABLE], radius=RADIUS, contact=False))
    assert abs(solution.gap[0]) < 1e-3 * RADIUS
    table = sum(part[0].sum(axis=0) for part in solution.contact_force)
    weight = 2.0 * sum(rod.rest_length.sum() for rod in rods)
    assert table[2] > 1.0 and table[2] + solution.start_force[0, :, 2].sum() == pytest.approx(weight, rel=1e-6)


def rubbing(coefficient: float, shifts, angles=(90.0,)) -> list:
    """The solutions, one after the other, of rods that lie across two cantilevers at those angles to them and are pulled along
    by ``shifts`` mm."""
    count, angle = len(angles), np.radians(angles)
    rails = [straight_rod(25.0, 10, (x, -12.0, 0.0), (0.0, 1.0, 0.0)) for x in (20.0, 80.0)]
    along = np.stack([np.sin(angle), np.cos(angle), 0.0 * angle], axis=-1)
    top = Configuration.concatenate([straight_rod(100.0, 25, (0.0, 0.2, 2.0 * RADIUS), way) for way in along])
    rods = [*(rail.take(np.zeros(count, dtype=int)) for rail in rails), top]
    clamps = [end_clamps(rod, Clamp.FRAME, Clamp.FREE) for rod in rods]
    stiff = Material(1e6, 1e6, 0.0)
    group = Group(rods, [stiff, stiff, Material(1e6, 1e6, 1.0)], clamps)
    moments = [[*clamps[:2], replace(clamps[2], start_position=clamps[2].start_position - shift * along)] for shift in shifts]
    return list(follow_group(group, moments, obstacles=[Itself(friction=coefficient)], radius=RADIUS))


def shares(solution, rail: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of what a rail bears: its size along the normal of both rods, that of the rest, and the rest's part along the top rod."""
    top, under = solution.rods[2].vertices, solution.rods[rail].vertices
    force = -solution.contact_force[rail].sum(axis=1)
    tangents = []
    for rod, other in ((top, under), (under, top)):
        middle, others = 0.5 * (rod[:, 1:] + rod[:, :-1]), 0.5 * (other[:, 1:] + other[:, :-1])
        nearest = np.linalg.norm(middle[:, :, None] - others[:, None], axis=-1).min(axis=2).argmin(axis=1)
        tangents.append(np.diff(rod, axis=1)[np.arange(len(rod)), nearest])
    normal = np.cross(*tangents)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    normal *= np.sign(normal[:, 2:])
    pressed = (force * normal).sum(axis=-1)
    rest = force - pressed[:, None] * normal
    along = tangents[0] / np.linalg.norm(tangents[0], axis=-1, keepdims=True)
    return pressed, np.linalg.norm(rest, axis=-1), (rest * along).sum(axis=-1)


@pytest.mark.thorough
def test_rods_that_are_drawn_over_others_stick_and_then_slip():
    """Against Coulomb's law: the friction is held by what the rails bend until it is the coefficient times the force."""
    coefficient, shifts = 0.3, (0.0, 0.003, 0.006, 2.0, 2.5, 2.5)
    moments = rubbing(coefficient, shifts, (90.0, 86.0))
    assert all(found.converged.all() for found in moments)
    normal, rest, along = np.moveaxis([[shares(found, rail) for rail in (0, 1)] for found in moments], 2, 0)
    ratios = rest / normal
    assert ratios[0].max() < 5e-3  # there is none at first
    assert (np.diff(ratios[:3], axis=0) > 0.01).all() and ratios[:3].max() < 0.99 * coefficient
    np.testing.assert_allclose(ratios[3:], coefficient, rtol=2e-3)
    assert (along[3:] > 0.0).all()  # the rails are drawn along with the top rod's pull
    touch = [np.unique(found.touch[2]).tolist() for found in moments]
    assert touch[1] == touch[2] == [Touch.NONE, Touch.STICKS] and touch[3] == touch[4] == [Touch.NONE, Touch.SLIPS]
    np.testing.assert_allclose(moments[4].friction_work, coefficient * normal[4].sum(axis=0) * 0.5, rtol=5e-3)
    assert all(np.abs(found.friction_work).max() < 1e-3 for found in (*moments[:3], moments[5]))
    assert moments[5].iterations.max() < 10  # a moment begins with the contacts of the one before


def test_a_group_rubs_alone_as_among_others():
    both, one = rubbing(0.2, (0.0, 1.5), (90.0, 86.0)), rubbing(0.2, (0.0, 1.5), (86.0,))
    np.testing.assert_array_equal(both[1].rods[2].vertices[1], one[1].rods[2].vertices[0])
    assert both[1].friction_work[1] == one[1].friction_work[0]


@pytest.mark.thorough
def test_ties_that_are_closed_at_the_start_take_no_round(rng):
    """Of two ropes of any stiffness, tied where they start and held at an end each: their forces change from the first step."""
    iterations = []
    for _ in range(40):
        first, second = wandering(rng, 1, 12, 12.0, wander=0.25), wandering(rng, 1, 16, 10.0, wander=0.25)
        second = replace(second, start=second.start + first.vertices[0, 6] - second.vertices[0, 4])
        bend = 150.0**3 * 10 ** rng.uniform(-2.0, 0.0, 2)
        clamps = [end_clamps(first, Clamp.FRAME, Clamp.FREE), end_clamps(second, Clamp.FREE, Clamp.POSITION)]
        materials = [Material(own, own) for own in bend]
        found = certified(relax_group(Group([first, second], materials, clamps, [Tie((0, 6), (1, 4))]), radius=0.5))
        iterations.append(found.iterations[0])
    assert np.median(iterations) < 33


@pytest.mark.sampled(2)
@pytest.mark.parametrize("friction, on_rod", [(0.3, True), (0.0, False), (0.3, False)])
def test_a_heavy_end_stays_on_its_side_of_a_peg(friction, on_rod):
    """A soft rope over a cylinder, or a rod, holds a mass fifty times its own: by statics the other end is held with as much
    or, where it is drawn and slips, with e^(μ π) times that at every moment. The mass hangs on a short rod tied to the rope."""
    peg, radius, mu = 30.0, 1.5, 1e-4
    angle = np.linspace(np.pi, 0, 40)
    arc = (peg + radius + 0.01) * np.stack([np.cos(angle), 0 * angle, np.sin(angle)], axis=-1)
    rope = rod_along(np.concatenate([[arc[0] - [0, 0, 150]], arc, [arc[-1] - [0, 0, 150]]]), 80)
    weight, bar = straight_rod(10.0, 4, rope.vertices[0, 0], (0, 0, -1)), straight_rod(100.0, 5, (0, -50, 0), (0, 1, 0))
    load, rods = 50 * 2 * mu * float(rope.rest_length.sum()), [rope, weight, bar][: 2 + on_rod]
    own, *rest = map(end_clamps, rods, 3 * [Clamp.FREE], (Clamp.POSITION, Clamp.FREE, Clamp.FRAME))
    materials = [Material(bend, bend, weight=mu) for bend in (10.0, 10.0, 1e7)[: len(rods)]]
    group = Group(rods, materials, [own, *rest], [Tie((0, 0), (1, 0), weight=load)])
    drawn = [[replace(own, end_position=own.end_position - [0, 0, way]), *rest] for way in np.arange(8 if friction else 1) / 2]
    on = Itself(friction=friction) if on_rod else Cylinder((0, -50, 0), (0, 50, 0), peg, friction=friction)
    for step, found in enumerate(follow_group(group, drawn, obstacles=[on], radius=[[radius, radius, peg][: len(rods)]])):
        ratio = (2 * mu * 150.0 - certified(found).end_force[0, 0, 2]) / (load + 2 * mu * 160.0)
        assert ratio == pytest.approx(np.exp(friction * np.pi * (step > 0)), rel=0.01)


@pytest.mark.parametrize("clamp", [Clamp.POSITION, Clamp.FRAME])
@pytest.mark.thorough
def test_ropes_that_are_tied_and_touch_come_to_rest(clamp):
    """Of random groups, whose points to tie are 70 mm apart at first, nearly all."""
    group = drawn(np.random.default_rng(3), 30, clamp, tied=True)
    solution = relax_group(group, radius=RADIUS)
    sound = solution.status != Status.INFEASIBLE
    assert sound.sum() > 25 and solution.stable[sound].mean() > 0.93
