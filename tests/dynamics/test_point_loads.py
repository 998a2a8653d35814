"""Forces and masses on rods in motion: a pendulum, the end states, the account of energies, and point masses of the rod."""

import numpy as np
import pytest

from doo_ti import Clamp, Grippers, Material, PointLoads, Springs, end_clamps, relax, simulate, straight_rod
from doo_ti.dynamics.parameters import GRAVITY, Dynamics, Stepping
from tests.conftest import check_refused

LENGTH, EDGES = 200.0, 16
ROD = straight_rod(LENGTH, EDGES)
CANTILEVER = end_clamps(ROD, Clamp.FRAME, Clamp.FREE)
MATERIAL = Material(1e7, 1e7)


def at_tip(force=(0.0, 0.0, 0.0), mass: float = 0.0) -> PointLoads:
    forces, masses = np.zeros((1, EDGES + 1, 3)), np.zeros((1, EDGES + 1))
    forces[0, -1], masses[0, -1] = force, mass
    return PointLoads(forces, masses)


def test_a_heavy_mass_on_a_light_rod_is_a_pendulum():
    """Let go at 3° from the vertical: one period of 2π √(L/g), 0.02 % more at this amplitude."""
    angle = np.radians(3.0)
    rod = straight_rod(LENGTH, EDGES, direction=(np.sin(angle), 0.0, -np.cos(angle)))
    hung = end_clamps(rod, Clamp.POSITION, Clamp.FREE)
    period = 2 * np.pi * np.sqrt(LENGTH / GRAVITY) * (1 + angle**2 / 16)
    trajectory = simulate(rod, Material(1e9, 1e9, 1.0), Grippers.resting(hung, 401), Dynamics(), Stepping(400 / period),
                          loads=at_tip(mass=2.0 * LENGTH * 1e4))
    assert (trajectory.status == 0).all()
    quarter, half, whole = trajectory.positions[0, [99, 199, 399], -1, 0] / (LENGTH * np.sin(angle))
    assert abs(quarter) < 5e-3 and abs(half + 1) <= 2e-3 and abs(whole - 1) <= 2e-3


@pytest.mark.parametrize("quasi_static", [False, True])
def test_motions_end_where_relax_does(quasi_static):
    loads, dynamics = at_tip((0.0, 300.0, 100.0), 500.0), Dynamics(drag=15.0, bend_damping=0.05)
    rest = relax(ROD, MATERIAL, CANTILEVER, external=loads).configuration
    trajectory = simulate(relax(ROD, MATERIAL, CANTILEVER).configuration, MATERIAL, Grippers.resting(CANTILEVER, 400), dynamics,
                          Stepping(20.0, quasi_static=quasi_static), loads=loads)
    np.testing.assert_allclose(trajectory.positions[0, -1], rest.vertices[0], atol=1e-4)


def test_masses_are_as_point_masses_of_the_rod():
    """With and without inertia; their weight does not depend on the rod's."""
    mass, weight = np.linspace(0.0, 40.0, EDGES + 1)[None], 1.3
    material, still = Material(1e7, 1e7, weight), Grippers.resting(CANTILEVER, 30)
    for stepping in (Stepping(50.0, detailed=True), Stepping(50.0, quasi_static=True)):
        one = simulate(ROD, material, still, Dynamics(point_mass=mass), stepping)
        other = simulate(ROD, material, still, Dynamics(), stepping,
                         loads=PointLoads(np.zeros((1, EDGES + 1, 3)), 2.0 * weight * mass))
        np.testing.assert_allclose(other.positions, one.positions, atol=1e-9)
        if stepping.detailed:
            np.testing.assert_allclose(other.detail.energies["sum"], one.detail.energies["sum"], rtol=1e-9)
    unloaded = simulate(ROD, material, still, Dynamics(), Stepping(50.0, quasi_static=True))
    assert one.positions[0, -1, -1, 2] < unloaded.positions[0, -1, -1, 2] - 10.0


@pytest.mark.thorough
def test_the_account_of_energies_holds_them():
    loads, start = at_tip((0.0, 300.0, 0.0), 200.0), relax(ROD, MATERIAL, CANTILEVER).configuration
    left = []
    for substeps in (4, 8, 16):
        found = simulate(start, MATERIAL, Grippers.resting(CANTILEVER, 20), Dynamics(drag=2.0),
                         Stepping(100.0, substeps, detailed=True), loads=loads)
        left.append(np.abs(found.detail.energies["unaccounted"]).max() / np.abs(found.detail.energies["loads"]).max())
    print(f"unaccounted: {', '.join(f'{share:.1e}' for share in left)} of the loads' energy")
    assert left[-1] < 2e-3 and np.log2(left[1] / left[2]) > 1.5


def test_springs_of_loads_are_springs_and_rods_have_rows_of_their_own():
    springs = Springs(np.tile(ROD.vertices, (2, 1, 1)) + [0, 0, 30.0], np.full((2, EDGES + 1), 20.0))
    rods, clamps = ROD.take([0, 0]), CANTILEVER.take([0, 0])
    moving = rods, MATERIAL, Grippers.resting(clamps, 10), Dynamics(), Stepping(50.0)
    one = simulate(*moving, springs=springs)
    force = np.zeros((2, EDGES + 1, 3))
    np.testing.assert_array_equal(simulate(*moving, loads=PointLoads(force, springs=springs)).positions, one.positions)
    force[1, -1, 1] = 50.0
    other = simulate(*moving, loads=PointLoads(force, springs=springs)).positions
    np.testing.assert_array_equal(other[0], one.positions[0])
    assert other[1, -1, -1, 1] > 0.5


def test_wrong_input_is_reported_in_one_sentence():
    moving = ROD, MATERIAL, Grippers.resting(CANTILEVER, 3), Dynamics(), Stepping(50.0)
    springs = Springs(ROD.vertices, np.ones((1, EDGES + 1)))
    for given, field in (({"loads": PointLoads(np.zeros((1, 9, 3)))}, "loads"),
                         ({"loads": PointLoads(np.zeros((3, EDGES + 1, 3)))}, "loads"),
                         ({"loads": at_tip(), "springs": springs}, "springs")):
        check_refused(f"^simulate: {field}: ", simulate, *moving, **given)
