"""Rods that are relaxed together: ties, held ends, and the forces in both, against a dense reference and single rods."""

from dataclasses import replace

import numpy as np
import pytest

from doo_ti import Group, Newton, Tie, end_clamps, follow_group, hanging, relax, relax_group, straight_rod
from doo_ti.rod.frames import rotation_matrix
from doo_ti.rod.types import Clamp, Clamps, Configuration, Material, Status
from tests.conftest import check_refused
from tests.groups.reference import nearest_equilibrium
from tests.references.rods import certified

MATERIAL = Material(1e5, 8e4)
EXACT = Newton(tolerance=1e-10)
FREE = (Clamp.FREE, Clamp.FREE)
MOST = 60  # iterations
LOOP = hanging(300.0, 30, start=(0.0, 0.0, 0.0), end=(0.0, 0.0, 0.0))  # both ends on one nail


def two_hanging():
    first, held = hanging(100.0, 20, (0, 0, 0), (70, 0, 0))
    second, also = hanging(80.0, 16, (5, 30, 0), (60, 40, 10), clamp=Clamp.FRAME)
    return [first, second], [held, also]


def a_y(edges: int = 20) -> Group:
    """Three ropes that hang from three points, tied at their other ends."""
    corners = np.array([[0.0, 0.0, 0.0], [80.0, 0.0, 10.0], [40.0, 70.0, 0.0]])
    middle = corners.mean(axis=0) - [0.0, 0.0, 25.0]
    rods = [straight_rod(60.0, edges, corner, middle - corner) for corner in corners]
    clamps = [end_clamps(rod, Clamp.POSITION, Clamp.FREE) for rod in rods]
    return Group(rods, MATERIAL, clamps, [Tie((0, -1), (1, -1), weight=5.0), Tie((2, -1), (0, -1))])


def a_rod_cut_in_two() -> Group:
    """And tied again, by a hinge."""
    whole, held = hanging(100.0, 36, (0, 0, 0), (70, 0, 0), clamp=Clamp.FRAME)
    x = whole.vertices
    parts = [Configuration(x[:, 0], whole.quaternions[:, :20], whole.rest_length[:20]),
             Configuration(x[:, 20], whole.quaternions[:, 20:], whole.rest_length[20:])]
    far = Clamps(Clamp.FREE, Clamp.FRAME, x[:, 20], held.end_position, held.end_frame, held.end_frame)
    return Group(parts, MATERIAL, [end_clamps(parts[0], Clamp.FRAME, Clamp.FREE), far], [Tie((0, -1), (1, 0))])


@pytest.mark.sampled(1)
@pytest.mark.parametrize("group", [a_y, a_rod_cut_in_two])
def test_tied_rods_are_those_of_the_reference(group):
    """Shapes to a millionth of the length, and forces; what the clamps hold together is the weight of rods and connector."""
    solution = certified(relax_group(group()))
    assert solution.closure[0] < 1e-10
    exact = nearest_equilibrium(solution.group)
    assert exact.least > -1e-11 and exact.step < 1e-6  # a round rod between two points may spin
    length = [rod.rest_length.sum() for rod in solution.rods]
    for rod, vertices in zip(solution.rods, exact.vertices, strict=True):
        assert np.abs(rod.vertices[0] - vertices).max() < 1e-6 * max(length)
    for name in ("tie_force", "end_force"):
        assert np.allclose(getattr(solution, name)[0], getattr(exact, name), rtol=1e-5, atol=1e-3)
    weight = 2.0 * sum(length) + sum(tie.weight for tie in solution.group.ties)
    assert np.allclose((solution.start_force + solution.end_force)[0].sum(axis=0), [0.0, 0.0, weight], atol=1e-3)


@pytest.mark.thorough
def test_a_moment_without_a_place_is_passed_over():
    """The group goes on from the moment before."""
    starts, clamps = two_hanging()
    group = Group(starts, MATERIAL, clamps, [Tie((0, 10), (1, 8))])
    far = replace(clamps[1], end_position=clamps[1].end_position + [200.0, 0.0, 0.0])
    first, lost, last = follow_group(group, [clamps, [clamps[0], far], clamps])
    assert lost.status[0] == Status.INFEASIBLE and first.converged[0] and last.converged[0]
    assert np.isnan(lost.energy[0]) and np.isnan(lost.rods[0].vertices).all() and np.isnan(lost.gap[0])
    assert np.abs(first.rods[1].vertices - last.rods[1].vertices).max() < 1e-6


def test_welded_rods_are_one():
    """Two halves that are welded in one line are a rod with one edge twice as long there, as stiff at its ends as the others:
    its bend stiffness twice, and the twist stiffness at its ends one and a half times."""
    halves = [straight_rod(50.0, 10), straight_rod(50.0, 10, start=(50.0, 0.0, 0.0))]
    place, turn = np.array([[60.0, 30.0, 10.0]]), rotation_matrix(np.array([[0.9, 0.4, 0.8]]))
    held = Clamps(Clamp.FRAME, Clamp.FRAME, np.zeros((1, 3)), place, np.eye(3)[None], turn)
    first, last = replace(held, end=Clamp.FREE), replace(held, start=Clamp.FREE)
    tied = certified(relax_group(Group(halves, MATERIAL, [first, last], [Tie((0, -1), (1, 0), weld=True)]), EXACT))
    assert tied.closure[0] < 1e-9
    bend, twist = np.tile(1e5 * np.eye(2), (1, 19, 1, 1)), np.full((1, 18), 8e4)
    bend[:, 9], twist[:, 8:10] = 2e5 * np.eye(2), 1.2e5
    lengths = np.repeat([5.0, 10.0, 5.0], [9, 1, 9])
    whole = Configuration(np.zeros((1, 3)), np.tile(halves[0].quaternions[:, :1], (1, 19, 1)), lengths)
    alone = relax(whole, Material(bend, twist), held, EXACT)
    assert alone.converged[0]
    x = np.concatenate([tied.rods[0].vertices[0, :10], tied.rods[1].vertices[0, 1:]])
    assert np.abs(x - alone.configuration.vertices[0]).max() < 1e-6 * 100.0
    assert abs(tied.energy[0] - alone.energy[0]) < 1e-7 * abs(alone.energy[0])
    assert np.allclose(tied.end_force[0, 1], alone.end_force[0], rtol=1e-5, atol=1e-3)
    again = relax_group(tied.group, EXACT, before=tied)
    assert again.iterations[0] < tied.iterations[0]
    assert np.allclose(again.tie_moment, tied.tie_moment, rtol=1e-4) and np.abs(tied.tie_moment).max() > 1.0


def test_a_branch_leans_on_its_trunk():
    """A weightless branch, welded to a cantilever at a right angle, bears what its end bears: force and moment go through."""
    trunk, branch = straight_rod(60.0, 12), straight_rod(40.0, 8, start=(60.0, 0.0, 0.0), direction=(0.0, 1.0, 0.0))
    mid = straight_rod(10.0, 2, start=branch.vertices[0, -1])
    group = Group([trunk, branch, mid], Material(1e6, 1e6, 0.0), [
        end_clamps(trunk, Clamp.FRAME, Clamp.FREE), *(end_clamps(rod, Clamp.FREE, Clamp.FREE) for rod in (branch, mid))],
        [Tie((0, -1), (1, 0), weld=True), Tie((1, -1), (2, 0), weight=20.0, weld=True)])
    solution = certified(relax_group(group))
    assert np.allclose(solution.tie_force[0, 0], [0.0, 0.0, -20.0], atol=1e-4)
    way = solution.rods[1].vertices[0, -1] - solution.rods[0].vertices[0, -1]
    assert np.allclose(solution.tie_moment[0], [np.cross(way, [0.0, 0.0, -20.0]), np.zeros(3)], atol=1e-2)
    assert abs(solution.rods[0].frames[0, -1, :, 0] @ solution.rods[1].frames[0, 0, :, 0]) < 1e-8


@pytest.mark.thorough
def test_points_apart_are_drawn_together_as_far_as_they_can_be():
    starts, clamps = two_hanging()
    drawn = certified(relax_group(Group(starts, MATERIAL, clamps, [Tie((0, 10), (1, 8))])))
    assert np.linalg.norm(drawn.rods[0].vertices[0, 10] - drawn.rods[1].vertices[0, 8]) < 1e-7
    away, held = hanging(80.0, 16, (5, 530, 0), (60, 540, 10), clamp=Clamp.FRAME)
    apart = relax_group(Group([starts[0], away], MATERIAL, [clamps[0], held], [Tie((0, 10), (1, 8))]))
    assert apart.status[0] == Status.INFEASIBLE  # the way along both rods is shorter


@pytest.mark.thorough
def test_rods_that_begin_in_each_other_are_infeasible():
    crossing = [straight_rod(100.0, 20, (-50, 0, 0)), straight_rod(80.0, 16, (0, -40, 0), (0, 1, 0))]
    ends = [end_clamps(rod, Clamp.FRAME, Clamp.FREE) for rod in crossing]
    assert relax_group(Group(crossing, MATERIAL, ends), radius=1.0).status[0] == Status.INFEASIBLE


def test_wrong_groups_are_one_line():
    starts, clamps = two_hanging()
    group = Group(starts, MATERIAL, clamps)
    for message, wrong in (
            ("ties: tie 0 is at vertex 21 of rod 0; give vertices from 0 to 20", {"ties": [Tie((0, 21), (1, 0))]}),
            ("ties: tie 0 is at rod 2; give rods from 0 to 1", {"ties": [Tie((2, 0), (1, 0))]}),
            ("ties vertex -1 of rod 0 to itself; give two", {"ties": [Tie((0, -1), (0, 20))]}),
            ("welds edge 19 of rod 0 to itself", {"ties": [Tie((0, 19), (0, 20), weld=True)]}),
            ("ties: a tuple; give a Tie", {"ties": [((0, 1), (1, 0))]}),
            ("rods: 2 rows of rod 1, 1 of rod 0; give one row", {"rods": [starts[0], starts[1].take([0, 0])]}),
            ("rods: a Configuration; give a list", {"rods": starts[0]}),
            ("clamps: 1 for 2 rods; give one", {"clamps": clamps[:1]}),
            ("materials: 3 for 2 rods; give one for each", {"materials": [MATERIAL] * 3})):
        check_refused(message, replace, group, **wrong)
    uneven = replace(group, materials=[MATERIAL, Material(1e5, [[1e5, 1e5, 1e5]])])
    loose = replace(group, clamps=[clamps[0], end_clamps(starts[1], *FREE)])
    for message, given, options in (
            ("rod 1: material.twist: 3 entries", uneven, {}), ("rod 1 has weight and nothing holds it", loose, {}),
            ("group: a Configuration; give a Group", starts[0], {}), ("radius", group, {"radius": -1.0}),
            ("radius: shape .* give one number of mm", group, {"radius": np.ones((1, 3))}),
            ("before: .no solution", group, {"before": "no solution"})):
        check_refused(message, relax_group, given, **options)
    check_refused("Tie: weight: -1", Tie, (0, 0), (1, 0), weight=-1.0)
    check_refused("Tie: first: 3; give 2 values, each a whole number", Tie, 3, (1, 0))


@pytest.mark.parametrize("end", [(0.0, 0.0, 0.0), (0.0, 0.0, 100.0), (1.0, 0.0, 0.0)])
@pytest.mark.parametrize("material", [
    Material(1e4, 1e4), Material(1e6, 1e6), Material(1e8, 1e8), Material.diagonal(1e6, 1e5, 1e5),
    Material(1e5, 1e5, rest_curvature=[0.01, 0.005])], ids=["limp", "soft", "stiff", "ribbon", "curved"])
def test_a_rod_between_two_nails_hangs_as_alone(material, end):
    """The nails are at one place, above each other, or almost."""
    rope, clamps = hanging(300.0, 30, start=(0.0, 0.0, 0.0), end=end)
    alone, group = (certified(found) for found in (
        relax(rope, material, clamps), relax_group(Group([rope], material, [clamps]))))
    assert group.iterations[0] < MOST and group.closure[0] < 1e-10
    assert group.energy[0] == pytest.approx(alone.energy[0], rel=1e-9)
    for shape in (lambda x: x[:, 2], lambda x: np.linalg.norm(x - x[0], axis=1)):  # neither knows of turns about the vertical
        one, other = shape(alone.configuration.vertices[0]), shape(group.rods[0].vertices[0])
        assert min(np.abs(one - other).max(), np.abs(one[::-1] - other).max()) < 1e-5 * 300.0


def test_tied_ends_on_a_nail_are_the_same_loop():
    (rope, both), material = LOOP, Material(1e6, 1e6)
    held = relax_group(Group([rope], material, [both]))
    nailed = end_clamps(rope, Clamp.POSITION, Clamp.FREE)
    tied = certified(relax_group(Group([rope], material, [nailed], [Tie((0, 0), (0, -1))])))
    assert tied.iterations[0] < MOST
    assert tied.energy[0] == pytest.approx(held.energy[0], rel=1e-9)
    assert tied.start_force[0, 0] == pytest.approx([0.0, 0.0, 600.0], abs=1e-3)


def test_a_loop_follows_its_nail():
    """Each moment begins with the forces of the one before."""
    rope, clamps = LOOP
    moments = [[replace(clamps, start_position=clamps.start_position + shift, end_position=clamps.end_position + shift)]
               for shift in np.array([5.0, 1.0, 2.0]) * np.arange(4)[:, None, None]]
    found = [certified(moment).energy[0] for moment in follow_group(Group([rope], Material(1e6, 1e6), [clamps]), moments)]
    np.testing.assert_allclose(found, found[0] + 2.0 * 300.0 * 2.0 * np.arange(4), rtol=1e-9)


def test_what_is_free_to_move_as_a_whole_comes_to_rest():
    """Weightless rods that nothing holds, rods that swing about one nail, and ties that say the same thing twice."""
    first, second = straight_rod(60.0, 12), straight_rod(50.0, 10, (60.0, 5.0, 3.0), (0.3, 1.0, 0.2))
    rods, loose = [first, second], [end_clamps(rod, *FREE) for rod in (first, second)]
    nailed = [end_clamps(first, Clamp.POSITION, Clamp.FREE), loose[1]]
    nothing, heavy = Material(1e5, 8e4, 0.0), Material(1e5, 8e4)
    tie, weld = Tie((0, -1), (1, 0)), Tie((0, -1), (1, 0), weld=True)
    ring, ring_weld = LOOP[0], [Tie((0, 0), (0, -1), weld=True)]
    for group in (Group(rods, nothing, loose, [tie]), Group(rods, nothing, loose, [tie, Tie((0, 2), (1, 8))]),
                  Group(rods, nothing, loose, [weld, Tie((0, 2), (1, 8))]), Group(rods, heavy, nailed, [tie]),
                  Group(rods, heavy, nailed, [weld]), Group(rods, heavy, nailed, [tie, Tie((1, 0), (0, -1))]),
                  Group([ring], nothing, [end_clamps(ring, *FREE)], ring_weld),
                  Group([ring], heavy, [end_clamps(ring, Clamp.POSITION, Clamp.FREE)], ring_weld)):
        assert certified(relax_group(group)).closure[0] < 1e-10


@pytest.mark.parametrize("escapes", [0, 3])
def test_rods_that_stand_upright_are_at_no_minimum(escapes):
    """Two rods in one line on a nail, which turn about that line at no cost, but fall over."""
    rods = [straight_rod(50.0, 10, (0.0, 0.0, z), (0.0, 0.0, 1.0)) for z in (0.0, 50.0)]
    group = Group(rods, Material(1e6, 1e6), [end_clamps(rods[0], Clamp.POSITION, Clamp.FREE), end_clamps(rods[1], *FREE)],
                  [Tie((0, -1), (1, 0))])
    solution = relax_group(group, Newton(max_iterations=1000, max_escapes=escapes))
    assert solution.status[0] == Status.CONVERGED and solution.stable[0] == (escapes > 0)
    assert solution.rods[1].vertices[0, -1, 2] == pytest.approx(-100.0 if escapes else 100.0, abs=1e-3)


def test_what_hangs_on_a_tie_is_carried_whichever_rod_the_tie_names_first():
    """A straight hanging rope with a tail and a connector a hundred times as heavy as both: where it starts is the answer."""
    upper, lower = straight_rod(500.0, 20, (0, 0, 0), (0, 0, -1)), straight_rod(300.0, 10, (0, 0, -500), (0, 0, -1))
    clamps = [end_clamps(upper, Clamp.POSITION, Clamp.FREE), end_clamps(lower, *FREE)]
    for ends in (((0, -1), (1, 0)), ((1, 0), (0, -1))):
        tie, material = Tie(*ends, weight=160.0), Material(100.0, 100.0, weight=1e-3)
        solution = certified(relax_group(Group([upper, lower], material, clamps, [tie])))
        assert solution.iterations[0] < 20
        np.testing.assert_allclose(solution.start_force[0, 0], [0, 0, 160.0 + 2e-3 * 800.0], rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(solution.rods[1].vertices[0, -1], [0, 0, -800.0], atol=1e-4)
