"""Groups of rods in N m² and N/m, each relative to a weight of its own: their forces on each other are in one unit. Rings
whose end edges without length are welded close without a joint and with second order."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_bvp

from doo_ti import Dynamics, Group, GroupSolution, Newton, Tie, follow_group, relax_group
from doo_ti.rod.shapes import end_clamps, hanging, rod_along, straight_rod
from doo_ti.rod.types import Clamp, Configuration, Material
from tests.conftest import check_refused
from tests.groups.reference import nearest_equilibrium
from tests.references.rods import certified, orders

TRUNK, BRANCH = {"EI": 1e-4, "GJ": 8e-5, "weight_per_length": 0.6}, {"EI": 2e-6, "GJ": 1e-6, "weight_per_length": 0.05}
PHYSICAL = [Material.from_physical(**rod) for rod in (TRUNK, BRANCH)]
UNIT = 0.25  # N/m that the hand-made materials are relative to
NEWTON = UNIT / 2.0 * 1e-3


def by_hand(rod: dict) -> Material:
    """The same in mm³, relative to :data:`UNIT`."""
    return Material(2e9 * rod["EI"] / UNIT, 2e9 * rod["GJ"] / UNIT, rod["weight_per_length"] / UNIT)


def tied(weight: float = 0.0) -> Group:
    """A trunk, held at its start, and a branch that hangs between the trunk's end and a clamp of its own."""
    trunk = straight_rod(300.0, 20)
    branch, held = hanging(100.0, 16, (300.0, 0.0, 0.0), (350.0, 40.0, 0.0))
    clamps = [end_clamps(trunk, Clamp.FRAME, Clamp.FREE), replace(held, start=Clamp.FREE)]
    return Group([trunk, branch], PHYSICAL, clamps, [Tie((0, -1), (1, 0), weight=weight)])


@pytest.mark.parametrize("order", [1, -1])
def test_tied_rods_of_different_weight(order):
    """Shapes and forces are those of a dense reference in one unit; the clamps carry all weight, in N."""
    rods = (TRUNK, BRANCH)[::order]  # the unit is that of the first
    connector = 0.02 / PHYSICAL[::order][0].newton[0]
    group = tied(connector)
    if order < 0:
        group = Group(group.rods[::-1], group.materials[::-1], group.clamps[::-1], [Tie((1, -1), (0, 0), weight=connector)])
    solution = certified(relax_group(group, Newton(tolerance=1e-10, max_iterations=1000)))
    exact = nearest_equilibrium(replace(solution.group, materials=[by_hand(rod) for rod in rods],
                                        ties=[replace(group.ties[0], weight=0.02 / NEWTON)]))
    for rod, vertices in zip(solution.rods, exact.vertices, strict=True):
        assert np.abs(rod.vertices[0] - vertices).max() < 1e-6 * 300.0
    unit = solution.group.newton[0]
    assert np.allclose(unit * solution.tie_force[0], NEWTON * exact.tie_force, rtol=1e-5, atol=1e-8)
    carried = unit * (solution.start_force + solution.end_force)[0].sum(axis=0)
    assert np.allclose(carried, [0.0, 0.0, 0.6 * 0.3 + 0.05 * 0.1 + 0.02], atol=1e-8)


def test_pressed_rods_of_different_weight():
    """A cantilever lies on a tenth as heavy one: each pushes the other as hard, and the clamps carry both."""
    lower, upper = straight_rod(100.0, 20, (0.0, 0.0, 0.0)), straight_rod(80.0, 16, (62.5, -42.5, 2.0), (0.0, 1.0, 0.0))
    clamps = [end_clamps(rod, Clamp.FRAME, Clamp.FREE) for rod in (lower, upper)]
    stiff, limp = TRUNK | {"EI": 1e-3, "GJ": 1e-3}, BRANCH | {"EI": 1e-5, "GJ": 1e-5}
    given, exact = (relax_group(Group([lower, upper], materials, clamps), radius=1.0) for materials in (
        [Material.from_physical(**stiff), Material.from_physical(**limp)], [by_hand(stiff), by_hand(limp)]))
    assert given.converged[0] and given.stable[0] and given.group.newton[0] == pytest.approx(3e-4)
    pushed = [given.group.newton[0] * part[0].sum(axis=0) for part in given.contact_force]
    assert pushed[1][2] > 1e-4 and np.allclose(pushed[0], -pushed[1], rtol=1e-9)
    for one, other, push, known in zip(given.rods, exact.rods, pushed, exact.contact_force, strict=True):
        assert np.abs(one.vertices - other.vertices).max() < 1e-5
        assert np.allclose(push, NEWTON * known[0].sum(axis=0), rtol=1e-3, atol=1e-9)
    assert given.group.newton[0] * given.start_force[0].sum(axis=0)[2] == pytest.approx(0.6 * 0.1 + 0.05 * 0.08, rel=1e-6)


@pytest.mark.thorough
@pytest.mark.parametrize("density", [None, 1.5])
def test_groups_in_motion(density):
    """With damping, and a density that is relative to each rod's own weight."""
    moving = Dynamics(density, bend_damping=[0.01], twist_damping=0.01, drag=0.2)
    light = replace(moving, bend_damping=np.zeros(1), twist_damping=np.zeros(1))
    heavy, branch = (None if density is None else density * rod["weight_per_length"] / UNIT for rod in (TRUNK, BRANCH))
    given = tied()
    known = replace(given, materials=[by_hand(TRUNK), by_hand(BRANCH)])
    moments = [[replace(own, start_position=own.start_position + [0.0, 0.0, 3.0 * moment]) for own in given.clamps]
               for moment in range(4)]
    exact = Newton(tolerance=1e-10, max_iterations=1000)
    found = list(follow_group(given, moments, exact, dynamics=[moving, light], rate=100.0))
    same = list(follow_group(known, moments, exact, rate=100.0, dynamics=[
        replace(moving, density=heavy), replace(light, density=branch)]))
    for one, other in zip(found, same, strict=True):
        assert one.converged[0] and other.converged[0]
        assert all(np.abs(rod.vertices - alike.vertices).max() < 1e-6
                   for rod, alike in zip(one.rods, other.rods, strict=True))
        assert given.newton[0] * one.kinetic[0] == pytest.approx(NEWTON * other.kinetic[0], rel=1e-6, abs=1e-12)


def test_rows_have_units_of_their_own_and_units_cannot_be_mixed():
    weights = np.array([0.6, 0.3])
    group = replace(tied().take([0, 0]), materials=[Material.from_physical(1e-4, 8e-5, weights), PHYSICAL[1]])
    solution = relax_group(group)
    assert solution.converged.all() and group.newton == pytest.approx(weights / 2e3)
    carried = group.newton * (solution.start_force + solution.end_force)[..., 2].sum(axis=1)
    assert np.allclose(carried, weights * 0.3 + 0.05 * 0.1, atol=1e-7)
    for materials, rods in (([PHYSICAL[0], Material(1e5, 1e5)], "rod 0 .* rod 1"),
                            ([Material(1e5, 1e5, 0.0), PHYSICAL[1]], "rod 1 .* rod 0")):
        check_refused(f"Group: materials: that of {rods} is relative to weight; give all", replace, tied(), materials=materials)


LENGTH = 300.0
RADIUS = LENGTH / (2 * np.pi)
EDGES = (10, 20, 40, 80)


def circle(edges: int) -> Configuration:
    """A ring that stands, from its top and back to it."""
    angle = np.linspace(0, 2 * np.pi, 40 * edges + 1)
    ring = rod_along(np.stack([np.sin(angle), 0 * angle, np.cos(angle) - 1], axis=-1) * RADIUS, edges, vertex_clamps=True)
    return Configuration(ring.start, ring.quaternions, ring.rest_length * (LENGTH / ring.rest_length.sum()))


def closed(edges: int, material: Material, clamp: Clamp) -> GroupSolution:
    """That ring, its ends welded to each other."""
    ring, weld = circle(edges), Tie((0, 0), (0, -1), weld=True)
    return certified(relax_group(Group([ring], material, [end_clamps(ring, clamp, Clamp.FREE)], [weld])))


def test_a_ring_closes_without_a_joint_and_its_end_edges_have_the_directions_of_the_curve():
    exact = 0.5 * (2 * np.pi) ** 2 / LENGTH
    errors = [abs(closed(edges, Material(1.0, 5.0, 0.0), Clamp.POSITION).energy[0] / exact - 1) for edges in EDGES]
    assert (orders(EDGES, errors) > 1.81).all() and errors[-1] < 1.1e-3
    assert np.allclose(circle(20).frames[0, [0, -1], :, 0], [1, 0, 0], atol=1e-9)
    assert np.allclose(straight_rod(100.0, 5, direction=(0, 0, 2), vertex_clamps=True).frames[0, :, :, 0], [0, 0, 1])


@pytest.mark.thorough
def test_a_heavy_ring_hangs_as_the_smooth_one():
    """The smooth one over its R, of EI = R³ and unit weight: x, z, direction, curvature and level force along one half."""
    s = np.linspace(0, np.pi, 201)
    y = np.stack([np.sin(s), np.cos(s) - 1, -s, -np.ones_like(s), 0 * s])
    for load in np.linspace(0, 1, 21):
        half = solve_bvp(
            lambda s, y, q=load: np.stack([np.cos(y[2]), np.sin(y[2]), y[3],
                                           np.sin(y[2]) * y[4] + np.cos(y[2]) * q * (np.pi - s), 0 * s]),
            lambda a, b: np.array([a[0], a[1], a[2], b[0], b[2] + np.pi]), s, y, tol=1e-9, max_nodes=100_000)
        s, y = half.x, half.y
    exact, material = -RADIUS * y[1, -1], Material(2.0 * RADIUS**3, RADIUS**3)
    hung = [closed(edges, material, Clamp.TANGENT).rods[0].vertices[..., 2] for edges in EDGES]
    errors = [abs(np.ptp(heights) / exact - 1) for heights in hung]
    assert (orders(EDGES, errors)[1:] > 1.81).all() and errors[-1] < 2e-4
