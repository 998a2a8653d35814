"""Many rods in motion at once: each moves as it does alone, one that fails stops alone, and both precisions agree."""

from dataclasses import replace

import numpy as np
import pytest

from doo_ti import Clamp, Dynamics, Grippers, Material, Springs, Stepping, simulate
from doo_ti.dynamics import simulate as simulation
from tests.conftest import check_refused
from tests.dynamics.test_energies import CURVED, at_rest, shaken
from tests.references.rods import clamps_at
from tests.relaxation.rods import wandering

INSTANTS, RATE = 6, 100.0
MATERIAL, DYNAMICS = Material(3e4, 2e4), Dynamics(drag=1.0)


def swung(rng, count: int):
    """Rods held at both ends that come nearer each other, at speeds of their own."""
    rods = wandering(rng, count, 8, 10.0, wander=0.1)
    clamps = clamps_at(rods, Clamp.FRAME, Clamp.POSITION)
    still = Grippers.resting(clamps, INSTANTS)
    times = np.arange(INSTANTS)[None, :, None] / RATE
    way = (-(clamps.end_position - clamps.start_position) * rng.uniform(1, 3, (count, 1)))[:, None] * times
    return rods, replace(still, end_position=still.end_position + way)


def moved(rods, grippers, **stepping):
    return simulate(rods, MATERIAL, grippers, DYNAMICS, Stepping(RATE, **stepping))


@pytest.mark.parametrize("tolerance", [None, pytest.param(0.1, marks=pytest.mark.thorough)])
def test_a_rod_moves_and_is_refined_alone_as_among_others(rng, tolerance):
    rods, grippers = swung(rng, 40)
    together = moved(rods, grippers, tolerance=tolerance)
    assert together.converged.all()
    for order in (rng.permutation(40), [7]):
        elsewhere = moved(rods.take(order), grippers.take(order), tolerance=tolerance)
        for name in ("positions", "status", "iterations", "residual", "end_force", "substeps", "error"):
            np.testing.assert_array_equal(getattr(elsewhere, name), getattr(together, name)[order])
    for steps in np.unique(together.substeps):
        chosen, fixed = together.substeps == steps, moved(rods, grippers, substeps=int(steps))
        np.testing.assert_array_equal(together.positions[chosen], fixed.positions[chosen])
        np.testing.assert_array_equal(together.memory.places[chosen], fixed.memory.places[chosen])


@pytest.mark.thorough
def test_launches_continue_one_another(rng, monkeypatch):
    """A long motion is several launches; both ends free, drag that grows with speed, and a rod that fails on the way."""
    rods, grippers = swung(rng, 6)
    grippers.end_position[2, 3:] += 1000.0
    ends = np.array([Clamp.POSITION, Clamp.FREE, Clamp.POSITION, Clamp.FREE, Clamp.FRAME, Clamp.TANGENT])
    starts = np.array([Clamp.FREE, Clamp.FREE, Clamp.FRAME, Clamp.POSITION, Clamp.FREE, Clamp.TANGENT])
    grippers = replace(grippers, start=starts, end=ends)
    dynamics = Dynamics(quadratic_drag=1e-3, bend_damping=0.01)
    at_once = simulate(rods, MATERIAL, grippers, dynamics, Stepping(RATE, 2))
    monkeypatch.setattr(simulation, "NUMBERS_AT_ONCE", 1)
    in_parts = simulate(rods, MATERIAL, grippers, dynamics, Stepping(RATE, 2))
    np.testing.assert_array_equal(at_once.converged, np.arange(6) != 2)
    for name in ("status", "positions"):
        np.testing.assert_array_equal(getattr(in_parts, name), getattr(at_once, name))


def test_steps_between_instants_are_steps_of_refined_grippers(rng):
    rods, grippers = swung(rng, 4)
    between = moved(rods, grippers, substeps=3)
    refined = simulate(rods, MATERIAL, grippers.refined(3), DYNAMICS, Stepping(3 * RATE))
    np.testing.assert_array_equal(between.positions, refined.positions[:, 2::3])
    np.testing.assert_array_equal(between.iterations.sum(axis=1), refined.iterations.sum(axis=1))
    np.testing.assert_allclose(grippers.refined(3).end_position[:, ::3], grippers.end_position, atol=1e-12)


@pytest.mark.parametrize("tolerance", [None, pytest.param(0.1, marks=pytest.mark.thorough)])
def test_pairs_springs_and_detail_go_with_their_rods(rng, tolerance):
    rods, grippers = swung(rng, 3)
    material, dynamics = Material([3e4, 6e4], [2e4, 4e4]), Dynamics(drag=[1.0, 2.0], density=[1.0, 1.5])
    pairs = np.array([0, 2, 2, 1]), np.array([1, 0, 1, 0])
    springs = Springs(rods.vertices[pairs[0]], np.linspace(0.0, 0.3, 4)[:, None] * np.ones(9))
    found = simulate(rods, material, grippers, dynamics, Stepping(RATE, tolerance=tolerance, detailed=True), springs=springs,
                     pairs=pairs)
    assert (len(np.unique(found.substeps)) > 1) == (tolerance is not None)
    for k, (r, g) in enumerate(zip(*pairs, strict=True)):
        own = Springs(springs.points[[k]], springs.stiffness[[k]])
        fixed = Stepping(RATE, int(found.substeps[k]), detailed=True)
        alone = simulate(rods.take([r]), material.take([g]), grippers.take([r]),
                         Dynamics(drag=dynamics.drag[g], density=dynamics.density[g]), fixed, springs=own)
        np.testing.assert_array_equal(found.positions[k], alone.positions[0])
        np.testing.assert_array_equal(found.detail.velocities[k], alone.detail.velocities[0])
        for name, value in alone.detail.energies.items():
            np.testing.assert_array_equal(found.detail.energies[name][k], value[0])


@pytest.mark.sampled(1)
@pytest.mark.parametrize("scheme", ["bdf2", "euler"])
def test_the_estimated_error_holds_against_much_finer_steps(rng, scheme):
    rods = at_rest(rng, CURVED, Clamp.FRAME, Clamp.POSITION, 12)
    grippers, dynamics = shaken(rods, Clamp.FRAME, Clamp.POSITION), Dynamics(drag=1.0, bend_damping=0.005)
    finest = simulate(rods, CURVED, grippers, dynamics, Stepping(RATE, 256))
    tolerance = 0.02 if scheme == "bdf2" else 0.2
    found = simulate(rods, CURVED, grippers, dynamics, Stepping(RATE, scheme=scheme, tolerance=tolerance, most_substeps=256))
    error = np.linalg.norm(found.positions - finest.positions, axis=-1).max(axis=(1, 2))
    assert found.converged.all() and (found.error <= tolerance).all() and (error < 1.1 * found.error).all()
    assert len(np.unique(found.substeps)) > 1


@pytest.mark.thorough
def test_rods_that_fail_or_never_agree_are_reported(rng):
    rods, grippers = swung(rng, 4)
    grippers.end_position[1, 3:] += 1000.0
    found = moved(rods, grippers, tolerance=1e-9, most_substeps=4)
    np.testing.assert_array_equal(found.converged, [True, False, True, True])
    np.testing.assert_array_equal(found.substeps, 4)
    assert np.isinf(found.error[1]) and (found.error[[0, 2, 3]] > 1e-9).all()


def test_what_cannot_be_is_refused():
    for wrong in ({"tolerance": 0.0}, {"tolerance": np.nan}, {"tolerance": 1.0, "most_substeps": 1}):
        check_refused("tolerance|most_substeps", Stepping, RATE, **wrong)
