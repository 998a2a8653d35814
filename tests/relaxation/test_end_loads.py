"""Forces and moments at both ends, and the derivatives by both grippers' poses, against rods relaxed again."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from doo_ti import Clamp, Material, Newton, PointLoads, Springs, end_loads, gripper_jacobian, relax, sensitivity
from doo_ti.relaxation.newton import TOLERANCES
from tests.conftest import check_refused
from tests.references.rods import certified, chain, clamps_at, jiggled
from tests.relaxation.rods import LOADS, PAIRS, one_of_three_at_rest, relaxed_again, wandering, with_kinds

SHARP = Newton(tolerance=1e-11)
UP = np.array([0.2, -0.1, 1.0]) / np.linalg.norm([0.2, -0.1, 1.0])
RIBBON = Material(np.array([[2e5, 3e4], [3e4, 1e5]]), 1.5e5, 1.2, np.array([2e-3, -1e-3]))


def held_rods(rng, case: str):
    """(solution of rods held in every way, function that relaxes them again after a change along a column)."""
    rods = wandering(rng, len(PAIRS), 12, rest_length=rng.uniform(2, 4, 12))
    clamps, material = with_kinds(clamps_at(rods), PAIRS), Material(2e5, 1.5e5, 0.8) if case == "round" else RIBBON
    loads = PointLoads(20.0 * rng.normal(size=(len(PAIRS), 13, 3)), rng.uniform(0, 20, (len(PAIRS), 13)))
    around = {"up": UP, "external": loads if case == "loaded" else None}
    solution = relax(rods, material, clamps, SHARP, **around)
    return solution, partial(relaxed_again, solution, material, clamps, SHARP, **around)


every_case = pytest.mark.parametrize("case", ["ribbon", "loaded", "round"])
POSES = ("start_shift", "start_turn", "end_shift", "end_turn")
STEPS = {"bend_1": 20.0, "bend_12": 20.0, "twist": 15.0, "weight": 1e-4, "rest_curvature": 1e-6, "up": 1e-4, "length": 1e-6}


@pytest.mark.sampled(1)
@every_case
def test_derivatives_are_the_differences(rng, case):
    """By every coordinate of both poses and what rods are made of, for every pair of clamps: vertices, directors, and forces
    and moments at both ends, to 1e-6 of the largest entry of a column, of which one under loads is of a very soft rod."""
    solution, moved = held_rods(rng, case)
    bound = 1e-5 if case == "loaded" else 1e-6
    made_of = {"ribbon": STEPS, "loaded": ("bend_1", "bend_12", "weight", "length"), "round": ()}
    found = sensitivity(solution, (*POSES, *made_of[case]))
    np.testing.assert_array_equal(gripper_jacobian(solution).vertices, found.vertices[..., :12])
    pendulum = np.array([set(pair) == {Clamp.FREE, Clamp.POSITION} for pair in PAIRS])  # its angle is not determined
    for column, title in enumerate(found.columns):
        step = STEPS.get(title.partition("[")[0], 5e-4 if "shift" in title else 2e-5)
        near = [moved(title, sign * step) for sign in (-2, -1, 1, 2)]
        rows = found.usable & ~pendulum & np.all([solution.converged for solution in near], axis=0)
        assert rows.sum() > 0.7 * len(PAIRS)
        shapes, loads = [solution.configuration for solution in near], [end_loads(solution) for solution in near]
        pairs = [(found.vertices, [shape.vertices for shape in shapes]),
                 (found.directors, [shape.frames[..., 1] for shape in shapes])]
        pairs += [(getattr(found.loads, name), [getattr(one, name) for one in loads]) for name in LOADS]
        for derivative, values in pairs:
            own = derivative[rows, ..., column]
            expected = (values[0] - 8 * values[1] + 8 * values[2] - values[3])[rows] / (12 * step)
            np.testing.assert_allclose(own, expected, atol=bound * np.abs(own).max(), err_msg=title)


@pytest.mark.sampled(1)
@every_case
def test_the_energy_grows_by_the_loads_times_the_ways(rng, case):
    """By every coordinate of both poses, for every pair of clamps, and so all forces together carry weight and loads."""
    solution, moved = held_rods(rng, case)
    loads = end_loads(solution)
    work = np.concatenate([getattr(loads, name) for name in LOADS], axis=1)
    rows = solution.converged & solution.stable
    for column, name in enumerate(gripper_jacobian(solution).columns):
        step = 1e-4 if "shift" in name else 1e-5
        slope = (moved(name, step).energy - moved(name, -step).energy) / (2 * step)
        np.testing.assert_allclose(work[rows, column], slope[rows], atol=2e-6 * np.abs(work[rows]).max())


def test_in_newton_where_the_weight_is_known():
    """A steel wire of 0.1 m, 1e-4 N m², bent by half a turn, without a noticeable weight: the moment EI κ at both ends."""
    angle = (np.arange(50) + 0.5) * np.pi / 50
    rod = chain(np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1), [0, 0, 1], 2.0)
    solution = relax(rod, Material.from_physical(1e-4, 1e-4, 1e-6), clamps_at(rod))
    loads = end_loads(solution)
    assert (loads.force_unit, loads.moment_unit) == ("N", "N m")
    moment = 1e-4 * solution.configuration.curvature.mean() * 1e3
    moments = [loads.start_moment[0], loads.end_moment[0]]
    np.testing.assert_allclose(moments, [[0, 0, -moment], [0, 0, moment]], rtol=1e-2, atol=1e-6)
    assert np.abs(loads.end_force).max() < 1e-2 * moment / 0.1
    relative = end_loads(relax(rod, Material(2e2 * 1e6, 2e2 * 1e6, 1.0), clamps_at(rod)))
    assert (relative.force_unit, relative.moment_unit) == ("mm", "mm²")


def test_curvature_of_a_circle():
    angle = 0.05 * np.arange(20)
    rod = chain(np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1), [0, 0, 1], 3.0)
    np.testing.assert_allclose(rod.curvature, np.full((1, 19), 2 * np.tan(0.025) / 3.0))
    np.testing.assert_allclose(rod.curvature_binormal[..., 2], rod.curvature)


def test_loads_of_rods_that_have_none(rng):
    loads = end_loads(one_of_three_at_rest(rng))
    assert np.isfinite(loads.start_moment[0]).all() and np.isnan(loads.start_moment[1]).all()
    taut = chain(np.tile([1.0, 0.0, 0.0], (8, 1)), [0, 0, 1], 3.0)
    solution = relax(taut, Material(1e5, 1e5), clamps_at(taut))
    assert np.isnan(end_loads(solution).start_force).all() and np.isnan(gripper_jacobian(solution).loads.end_force).all()
    check_refused("joins several", end_loads, solution.take([0]))
    free, springs = clamps_at(taut, Clamp.FRAME, Clamp.FREE), Springs(taut.vertices, np.full((1, 9), 50.0))
    check_refused("external", end_loads, relax(taut, Material(1e5, 1e5), free, external=springs))


def taut(slack: float, kind: Clamp):
    """99 mm of straight rod along (0.6, 0.8, 0), 0.4 turns of twist in it, and clamps by ``slack`` of its length closer."""
    rod = chain(np.tile([0.6, 0.8, 0.0], (33, 1)), [0, 0, 1], 3.0, spin=0.8 * np.pi * np.arange(33) / 32)
    clamps = clamps_at(rod, kind, kind)
    return rod, replace(clamps, end_position=(1 - slack) * clamps.end_position)


@pytest.mark.parametrize("precision", ["f64", "f32", "mixed"])
@pytest.mark.parametrize("kind", [Clamp.FRAME, Clamp.POSITION], ids=lambda kind: kind.name.lower())
@pytest.mark.parametrize("weight", [0.0, 1.0])
@pytest.mark.parametrize("slack", [0.0, 1e-9])
def test_the_pull_on_a_taut_rod_is_undetermined(slack, weight, kind, precision):
    """Converged, certified, and NaN where the force is not determined: any tension keeps the rod straight."""
    rod, clamps = taut(slack, kind)
    solution = certified(relax(rod, Material(6e5, 8e5, weight), clamps, precision=precision))
    assert np.isfinite(solution.energy).all() and np.isnan(solution.end_force).all()
    assert solution.residual[0] < TOLERANCES[solution.precision[0]]
    assert solution.closure[0] == pytest.approx(slack, abs=1e-12 if solution.precision[0] == 64 else 2e-7)


@pytest.mark.parametrize("precision", ["f64", "f32 only"])
def test_the_residual_of_a_taut_rod_is_its_moment_about_the_tangents(rng, precision):
    """Stopped before it is at rest: E = Σ β m²/l̄, and of each free frame |∂E/∂θ| L/α."""
    rod, clamps = taut(0.0, Clamp.FRAME)
    solution = relax(jiggled(rod, rng, 0.05), Material(6e5, 8e5), clamps, Newton(max_iterations=1), precision=precision)
    m1, m2 = np.moveaxis(solution.configuration.frames[0, ..., 1:], -1, 0)
    twist = np.arctan2(np.sum(m1[1:] * m2[:-1], axis=1), np.sum(m1[1:] * m1[:-1], axis=1))
    moment = np.abs(np.diff(2 * 8e5 * twist / 6.0)).max()
    assert moment > 100 and np.isnan(solution.end_force).all()
    assert solution.residual[0] == pytest.approx(moment * 99.0 / 6e5, rel=1e-9 if precision == "f64" else 1e-4)


@pytest.mark.parametrize("kind", [Clamp.FRAME, Clamp.POSITION], ids=lambda kind: kind.name.lower())
def test_a_rod_with_a_little_slack_is_pulled_ever_harder(kind):
    """Up to where it is taut the pull is known; half of its weight hangs from either end, however little it sags."""
    found = [relax(rod, Material(6e5, 8e5, 1.0), clamps) for rod, clamps in (taut(2e-6, kind), taut(2e-7, kind))]
    pulls = np.array([solution.end_force[0] for solution in found])
    np.testing.assert_allclose(pulls[:, 2], 99.0, rtol=1e-6)
    along = pulls @ [0.6, 0.8, 0.0]
    assert all(solution.converged.all() for solution in found) and 2 * along[0] < along[1] < 4 * along[0]
