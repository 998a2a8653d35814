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
SHARP = Newton(tolerance=1e-10)
HELD_ENDS = tuple(pair for pair in ALL_ENDS if pair != (Clamp.FREE, Clamp.FREE))


def cantilever(force: float, edges: int, mass: float = 0.0):
    """The solution of a rod along x without weight, clamped at its start, with a force down and a mass at its tip."""
    rod = straight_rod(LENGTH, edges, vertex_clamps=True)
    forces, masses = np.zeros((1, rod.edges + 1, 3)), np.zeros((1, rod.edges + 1))
    forces[0, -1, 2], masses[0, -1] = -force, mass
    return relax(rod, Material(BEND, BEND, 0.0), end_clamps(rod, Clamp.FRAME, Clamp.FREE), SHARP,
                 external=PointLoads(forces, masses))


@pytest.mark.sampled(1)
@pytest.mark.parametrize("as_mass", [True, False])
def test_a_cantilever_under_a_tip_load_is_the_elastica(as_mass):
    """P L²/EI = 4: the tip is down by two thirds of the length (elliptic integrals, Bisshopp and Drucker 1945)."""
    load = 4.0
    k, phi = _elastica(load)
    deflection = 1 - 2 / np.sqrt(load) * (ellipeinc(np.pi / 2, k) - ellipeinc(phi, k))
    reach = np.sqrt(2 * (2 * k - 1) / load)
    off = []
    for edges in (40, 80, 160):
        force = load * BEND / LENGTH**2
        solution = cantilever(0.0, edges, mass=force) if as_mass else cantilever(force, edges)
        tip = solution.configuration.vertices[0, -1] / LENGTH
        off.append(np.hypot(tip[0] - reach, tip[2] + deflection))
    assert off[-1] < 1e-3 and np.log2(off[1] / off[2]) == pytest.approx(2, abs=0.1)


def _elastica(load: float) -> tuple[float, float]:
    """(k², φ₁) of a cantilever under P L²/EI = ``load``."""
    def missing(slope):
        k = (1 + np.sin(slope)) / 2
        return ellipk(k) - ellipkinc(np.arcsin(1 / np.sqrt(2 * k)), k) - np.sqrt(load)
    k = (1 + np.sin(brentq(missing, 1e-3, np.pi / 2 - 1e-9))) / 2
    return k, np.arcsin(1 / np.sqrt(2 * k))


def test_a_mass_weighs_what_its_grams_do():
    """A rod of 0.2 N/m with 5 g at its tip, and a force of as much."""
    material = Material.from_physical(EI=1e-4, GJ=1e-4, weight_per_length=0.2)
    rod = straight_rod(LENGTH, 20)
    clamps = end_clamps(rod, Clamp.FRAME, Clamp.FREE)
    force, mass = np.zeros((1, 21, 3)), np.zeros((1, 21))
    force[0, -1, 2], mass[0, -1] = -5e-3 * 9.80665, 5.0
    one = relax(rod, material, clamps, external=PointLoads.from_physical(force, material))
    other = relax(rod, material, clamps, external=PointLoads.from_physical(np.zeros((1, 21, 3)), material, mass))
    np.testing.assert_allclose(one.configuration.vertices, other.configuration.vertices, atol=1e-9)
    light = relax(rod, material, clamps)
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
    """A rod with a mass on it that lies on a table half-way, held at its start or at its end."""
    rod, material = straight_rod(LENGTH, 20, start=(0.0, 0.0, 20.0)), Material(BEND, BEND, 1.0)
    masses = np.zeros((1, 21))
    masses[0, 10] = 500.0
    for ends in ((Clamp.FRAME, Clamp.FREE), (Clamp.FREE, Clamp.FRAME)):
        solution = relax(rod, material, end_clamps(rod, *ends), external=PointLoads(np.zeros((1, 21, 3)), masses),
                         obstacles=[Plane((0, 0, 0), (0, 0, 1))], radius=1.0)
        assert solution.converged.all() and solution.contact.touching.any()
        loads = end_loads(solution)
        together = loads.start_force + loads.end_force + solution.contact.force.sum(axis=1)
        np.testing.assert_allclose(together[0], [0.0, 0.0, 2.0 * LENGTH + 500.0], atol=1e-2)


def test_what_has_no_derivatives_is_refused():
    rod = straight_rod(LENGTH, 20)
    material, held = Material(BEND, BEND), end_clamps(rod, Clamp.FRAME, Clamp.FREE)
    masses = PointLoads(np.zeros((1, 21, 3)), 1.0)
    sprung = PointLoads(np.zeros((1, 21, 3)), springs=Springs(rod.vertices, np.ones((1, 21))))
    for solution, parameters, field in (
        (relax(rod, material, held, external=masses), ("up",), "parameters"),
        (relax(rod, material, held, external=sprung), ("bend",), "solution")):
        for call in (lambda: sensitivity(solution, parameters), lambda: pullback(solution, None, parameters)):
            check_refused(f": {field}: ", call)


def test_wrong_input_is_reported_in_one_sentence():
    zero, material = np.zeros((1, 21, 3)), Material(1e5, 1e5)
    rod = straight_rod(LENGTH, 20)
    held, loose = end_clamps(rod, Clamp.FRAME, Clamp.FREE), end_clamps(rod, Clamp.FREE, Clamp.FREE)
    physical = Material.from_physical([1e-4, 2e-4], 1e-4, 0.2)
    for call, source, field in (
        (lambda: PointLoads(np.zeros((21, 3))), "PointLoads", "force"),
        (lambda: PointLoads(zero, np.zeros(21)), "PointLoads", "mass"),
        (lambda: PointLoads(zero, -1.0), "PointLoads", "mass"),
        (lambda: PointLoads(np.full((1, 21, 3), np.nan)), "PointLoads", "force"),
        (lambda: PointLoads(zero, springs=Springs(np.zeros((1, 9, 3)), np.zeros((1, 9)))), "PointLoads", "springs"),
        (lambda: PointLoads.from_physical(zero, material), "PointLoads", "material"),
        (lambda: PointLoads.from_physical(zero, physical), "PointLoads", "force"),
        (lambda: relax(rod, material, held, external=PointLoads(np.zeros((1, 9, 3)))), "external", "points"),
        (lambda: relax(rod, replace(material, weight=0.0), loose, external=PointLoads(zero)), "clamps", "start, end"),
        (lambda: relax(rod, material, held, Descent(), external=PointLoads(zero)), "relax", "solver")):
        check_refused(f"^{source}: {field}: ", call)
