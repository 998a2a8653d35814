"""Extreme rods and starts: what converges though it is hard."""

from dataclasses import replace

import numpy as np
import pytest

from doo_ti import Clamp, Configuration, Itself, Material, Newton, Plane, relax
from doo_ti.rod.shapes import end_clamps, hanging, straight_rod
from tests.oracle.external import where_found
from tests.references.rods import certified, chain, clamps_at, jiggled
from tests.relaxation.rods import definite, wandering

MATERIAL = Material(6e5, 5e5, 1.0)
every_precision = pytest.mark.parametrize("precision", ["f64", "f32", "mixed"])


def straight(edges: int, direction=(1.0, 0.0, 0.0), turns: float = 0.0) -> Configuration:
    """99 mm of straight rod, its frames turning ``turns`` times along it."""
    across = [0, 0, 1] if direction[2] == 0 else [1, 0, 0]
    spin = 2 * np.pi * turns * np.arange(edges) / (edges - 1)
    return chain(np.tile(direction, (edges, 1)), across, 99.0 / edges, spin=spin)


def well(solution, precision: str = "f64") -> None:
    """Converged and certified, and closed: f64 finished the rods that f32 could not."""
    assert np.isfinite(certified(solution).energy).all()
    assert solution.closure.max() <= (1e-7 if precision == "f32" else 1e-12)


@pytest.mark.thorough
@every_precision
@pytest.mark.parametrize("direction", [(1.0, 0.0, 0.0), (0.6, 0.8, 0.0), (0.0, 0.0, 1.0)], ids=["x", "x-y", "upright"])
@pytest.mark.parametrize("weight", [0.0, 1.0])
def test_straight_starts_that_must_shorten(direction, weight, precision):
    """A straight rod cannot shorten to first order, and no side is preferred."""
    material = Material(6e5, 5e5, weight)
    rod = straight(9, direction)
    bow = jiggled(rod, np.random.default_rng(3), 0.1)
    for share in (0.95, 0.8, 0.4):
        near = replace(clamps_at(rod), end_position=99.0 * share * np.array([direction]))
        solution = relax(rod, material, near, precision=precision)
        well(solution, precision)
        if precision == "f64" and share == 0.8:
            assert solution.energy[0] == pytest.approx(relax(bow, material, near).energy[0], rel=1e-8)


@pytest.mark.sampled(3)
@every_precision
@pytest.mark.parametrize("turns", [1, 3, 10])
@pytest.mark.parametrize("shape", ["straight", "bow"])
def test_whole_turns_of_twist(shape, turns, precision):
    """Two radians per joint at ten turns: no turn is lost on the way, although loops form."""
    def rod(turns: int) -> Configuration:
        if shape == "straight":
            return straight(33, turns=turns)
        angle, spin = np.linspace(-1, 1, 33), 2 * np.pi * turns * np.linspace(0, 1, 33)
        return chain(np.stack([np.cos(angle), 0 * angle, np.sin(angle)], axis=1), [0, 1, 0], 3.0, spin=spin)

    clamps = clamps_at(rod(turns))
    clamps = clamps if shape == "bow" else replace(clamps, end_position=np.array([[80.0, 0.0, 0.0]]))
    solution, untwisted = relax(rod(turns), MATERIAL, clamps, precision=precision), relax(rod(0), MATERIAL, clamps)
    well(solution, precision)
    even = 5e5 * (2 * np.pi * turns) ** 2 / (2 * 96.0)
    assert untwisted.energy[0] < solution.energy[0] < untwisted.energy[0] + even * (1 + 1e-6)


@pytest.mark.sampled(4)
@every_precision
@pytest.mark.parametrize(("edges", "kinds"), [
    (2, (3, 0)), (2, (0, 2)), (2, (1, 1)), (3, (3, 0)), (3, (1, 3)), (3, (2, 1)), (3, (1, 1)), (4, (3, 3)), (4, (2, 2))])
def test_few_edges(edges, kinds, precision):
    """As few as there can be: an arc in the vertical plane, against the dense solver."""
    angle = 0.5 * (np.arange(edges) - 0.5 * (edges - 1))
    tangents = np.stack([np.cos(angle), 0 * angle, np.sin(angle)], axis=1)
    rod = chain(tangents, [0, 1, 0], 3.0, spin=0.2 * np.arange(edges))
    clamps, material = clamps_at(rod, *(Clamp(kind) for kind in kinds)), Material(2e4, 1e4, 50.0)
    solution = relax(rod, material, clamps, precision=precision)
    well(solution, precision)
    here, single = where_found(solution.configuration, material, clamps, 0), precision == "f32"
    assert solution.energy[0] == pytest.approx(here.energy, rel=2e-5 if single else 1e-12)
    assert here.residual * 3.0 * edges < (1e-2 if single else 1e-5)
    assert here.eigenvalues[0] > -(1e-5 if single else 1e-9) * here.eigenvalues[-1]  # a hinged rod may spin freely


@pytest.mark.sampled(1)
@pytest.mark.parametrize("edges", [2, 3, 6, 12])
def test_coarse_rods_that_swing_about_their_chord(rng, edges):
    """Bowed any way between two positions they swing down under their weight, a long way round for few edges."""
    rods = wandering(rng, 128, edges)
    well(relax(rods, MATERIAL, clamps_at(rods, Clamp.POSITION, Clamp.POSITION)))


@pytest.mark.sampled(1)
@pytest.mark.parametrize("seed", [3, 2011])
def test_limp_and_stiff_with_any_bend_matrix(seed):
    rng = np.random.default_rng(seed)
    rods, decades = wandering(rng, 12, 33), np.geomspace(1e2, 1e8, 13)
    material = Material(definite(rng, 13, scale=1.0) * decades[:, None, None], decades, 1.0)
    well(relax(rods, material, clamps_at(rods), Newton(max_iterations=600),
               configuration_index=np.arange(12).repeat(13), material_index=np.tile(np.arange(13), 12)))


@pytest.mark.parametrize("kind", [Clamp.POSITION, Clamp.TANGENT, Clamp.FRAME])
@pytest.mark.parametrize("stiffness", [1e-3, 1e-5, 1e-7])
def test_little_slack(kind, stiffness):
    slack = np.geomspace(3e-8, 3e-4, 17)
    ropes, clamps = hanging(np.full(17, 1000.0), 40, (0, 0, 0), np.column_stack([1000.0 * (1 - slack), 0 * slack, 0 * slack]))
    frames = np.repeat(np.eye(3)[None], 17, axis=0)
    held = replace(clamps, start=kind, end=kind, start_frame=frames, end_frame=frames)
    certified(relax(ropes, Material.from_physical(stiffness, stiffness, 0.5), held))


def test_standing_rods_fall_and_are_certified():
    rods, bend = straight_rod(300.0, 30, (0, 0, 0), (0, 0, 1)).take([0] * 100), np.geomspace(1e5, 1e9, 100)
    solution = relax(rods, Material(bend, 0.8 * bend), end_clamps(rods, Clamp.FRAME, Clamp.FREE))
    assert solution.converged.mean() >= 0.98 and solution.stable[solution.converged].all()
    assert solution.iterations.mean() < 40


@pytest.mark.thorough
def test_a_released_start_falls_though_the_rod_may_touch_itself():
    rod = straight_rod(300.0, 30)
    clamps, material = end_clamps(rod, Clamp.FREE, Clamp.FRAME), Material(1e6, 0.8e6)
    alone = relax(rod, material, clamps)
    itself = certified(relax(rod, material, clamps, obstacles=[Itself()], radius=1.0))
    np.testing.assert_allclose(itself.configuration.vertices, alone.configuration.vertices, atol=1e-4)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("length", [350.0, 600.0, 900.0])
def test_a_start_below_a_table_is_moved_above_it(length):
    rope, clamps = hanging(length, 40, (0, 0, 0), (300, 0, 0))
    solution = certified(relax(rope, Material(1e6, 1e6), clamps, obstacles=[Plane((0, 0, -100), (0, 0, 1))], radius=2.0))
    assert solution.contact.gap.min() > -1e-3
