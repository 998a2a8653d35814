"""Forces and masses at vertices: closed forms, dense f64 linear algebra, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.special import ellipeinc, ellipk, ellipkinc

from doo_ti import Descent, Newton, Plane, PointLoads, Springs, end_loads, pullback, relax, sensitivity
from doo_ti.rod.shapes import end_clamps, straight_rod
from doo_ti.rod.types import Clamp, Material
from tests.conftest import check_refused
from tests.oracle.external import where_found
from tests.references.rods import certified
from tests.relaxation.test_external import ALL_ENDS, UP, dense, rods_under_springs

LENGTH, BEND = 200.0, 1e5
ROD, NONE = straight_rod(LENGTH, 20), np.zeros((1, 21, 3))
HELD = end_clamps(ROD, Clamp.FRAME, Clamp.FREE)
SHARP = Newton(tolerance=1e-10)
HELD_ENDS = tuple(pair for pair in ALL_ENDS if pair != (Clamp.FREE, Clamp.FREE))


@pytest.mark.sampled(1)
@pytest.mark.parametrize("as_mass", [True, False])
def test_a_cantilever_under_a_tip_load_is_the_elastica(as_mass):
    """P L²/EI = 4: the tip is down by two thirds of the length (elliptic integrals, Bisshopp and Drucker 1945)."""
    load = 4.0

    def missing(slope):
        k = (1 + np.sin(slope)) / 2
        return ellipk(k) - ellipkinc(np.arcsin(1 / np.sqrt(2 * k)), k) - np.sqrt(load)

    k = (1 + np.sin(brentq(missing, 1e-3, np.pi / 2 - 1e-9))) / 2  # the modulus, squared
    phi = np.arcsin(1 / np.sqrt(2 * k))
    deflection = 1 - 2 / np.sqrt(load) * (ellipeinc(np.pi / 2, k) - ellipeinc(phi, k))
    reach = np.sqrt(2 * (2 * k - 1) / load)
    off = []
    for edges in (40, 80, 160):
        rod = straight_rod(LENGTH, edges, vertex_clamps=True)
        forces, masses = np.zeros((1, rod.edges + 1, 3)), np.zeros((1, rod.edges + 1))
        force = load * BEND / LENGTH**2
        forces[0, -1, 2], masses[0, -1] = (0.0, force) if as_mass else (-force, 0.0)
        solution = relax(rod, Material(BEND, BEND, 0.0), end_clamps(rod, Clamp.FRAME, Clamp.FREE), SHARP,
                         external=PointLoads(forces, masses))
        tip = solution.configuration.vertices[0, -1] / LENGTH
        off.append(np.hypot(tip[0] - reach, tip[2] + deflection))
    assert off[-1] < 1e-3 and np.log2(off[1] / off[2]) == pytest.approx(2, abs=0.1)


def test_a_mass_weighs_what_its_grams_do():
    material = Material.from_physical(EI=1e-4, GJ=1e-4, weight_per_length=0.2)
    force, mass = np.zeros((1, 21, 3)), np.zeros((1, 21))
    force[0, -1, 2], mass[0, -1] = -5e-3 * 9.80665, 5.0
    loads = PointLoads.from_physical(force, material), PointLoads.from_physical(NONE, material, mass), None
    one, other, light = (relax(ROD, material, HELD, external=own) for own in loads)
    np.testing.assert_allclose(one.configuration.vertices, other.configuration.vertices, atol=1e-9)
    assert one.configuration.vertices[0, -1, 2] < light.configuration.vertices[0, -1, 2] - 1.0


@pytest.mark.thorough
@pytest.mark.parametrize("isotropic", [True, False], ids=["isotropic", "general"])
@pytest.mark.parametrize("kind", ["springs", "loads", "both"])
def test_minima_are_those_of_dense_linear_algebra(rng, kind, isotropic):
    """All pairs of clamps, with springs those of rods that nothing holds, too: minimum, energy and force of the far clamp."""
    start, clamps, material, springs = rods_under_springs(rng, 2, isotropic, ends=HELD_ENDS if kind == "loads" else ALL_ENDS)
    loads = PointLoads(300.0 * rng.normal(size=springs.points.shape), rng.uniform(0, 300, springs.stiffness.shape),
                       springs if kind == "both" else None)
    whole = (kind != "springs") * (loads.force - loads.mass[..., None] * UP / np.linalg.norm(UP))
    solution = certified(relax(start, material, clamps, Newton.careful(tolerance=1e-9), up=UP,
                               external=springs if kind == "springs" else loads))
    assert solution.closure.max() < 1e-12
    for row in range(start.count):
        own = None if kind == "loads" else dense(springs, row)
        here = where_found(solution.configuration, material, clamps, row, UP, own, whole[row])
        assert solution.energy[row] == pytest.approx(here.energy, rel=1e-11)
        assert here.residual < 1e-9 and here.eigenvalues[0] > -1e-9 * here.eigenvalues[-1]  # a round rod may spin freely
        np.testing.assert_allclose(-solution.end_force[row], here.force, atol=1e-8 * np.abs(here.force).max())


@pytest.mark.thorough
def test_obstacles_and_the_clamp_carry_all_loads():
    rod, material = straight_rod(LENGTH, 20, start=(0.0, 0.0, 20.0)), Material(BEND, BEND, 1.0)
    masses = 500.0 * (np.arange(21) == 10)[None]
    for ends in ((Clamp.FRAME, Clamp.FREE), (Clamp.FREE, Clamp.FRAME)):
        solution = relax(rod, material, end_clamps(rod, *ends), external=PointLoads(NONE, masses),
                         obstacles=[Plane((0, 0, 0), (0, 0, 1))], radius=1.0)
        assert solution.converged.all() and solution.contact.touching.any()
        loads = end_loads(solution)
        together = loads.start_force + loads.end_force + solution.contact.force.sum(axis=1)
        np.testing.assert_allclose(together[0], [0.0, 0.0, 2.0 * LENGTH + 500.0], atol=1e-2)


def test_what_has_no_derivatives_is_refused():
    sprung = PointLoads(NONE, springs=Springs(ROD.vertices, np.ones((1, 21))))
    for loads, parameters, field in ((PointLoads(NONE, 1.0), ("up",), "parameters"), (sprung, ("bend",), "solution")):
        solution = relax(ROD, Material(BEND, BEND), HELD, external=loads)
        check_refused(f": {field}: ", sensitivity, solution, parameters)
        check_refused(f": {field}: ", pullback, solution, None, parameters)


def test_wrong_input_is_reported_in_one_sentence():
    material, physical = Material(1e5, 1e5), Material.from_physical([1e-4, 2e-4], 1e-4, 0.2)
    loose = replace(HELD, start=Clamp.FREE)
    for call, said in (
            (lambda: PointLoads(np.zeros((21, 3))), "PointLoads: force"),
            (lambda: PointLoads(NONE, np.zeros(21)), "PointLoads: mass"), (lambda: PointLoads(NONE, -1.0), "PointLoads: mass"),
            (lambda: PointLoads(np.full((1, 21, 3), np.nan)), "PointLoads: force"),
            (lambda: PointLoads(NONE, springs=Springs(np.zeros((1, 9, 3)), np.zeros((1, 9)))), "PointLoads: springs"),
            (lambda: PointLoads.from_physical(NONE, material), "PointLoads: material"),
            (lambda: PointLoads.from_physical(NONE, physical), "PointLoads: force"),
            (lambda: relax(ROD, material, HELD, external=PointLoads(np.zeros((1, 9, 3)))), "external: points"),
            (lambda: relax(ROD, replace(material, weight=0.0), loose, external=PointLoads(NONE)), "clamps: start, end"),
            (lambda: relax(ROD, material, HELD, Descent(), external=PointLoads(NONE)), "relax: solver")):
        check_refused(f"^{said}: ", call)
