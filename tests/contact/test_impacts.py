"""Rods that meet obstacles come to rest there: they do not bounce, and no step raises their energy."""

import numpy as np
import pytest

from doo_ti import Clamp, Configuration, Dynamics, Grippers, Material, Plane, Stepping, simulate
from tests.contact.impacts import SCENES, moved
from tests.references.rods import clamps_at

LENGTH, EDGES, RADIUS = 300.0, 20, 3.0


def straight(direction, start=(0.0, 0.0, 0.0)) -> Configuration:
    return Configuration.straight(np.array(start), np.array(direction), LENGTH, EDGES)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("scheme", ["bdf2", "euler"])
@pytest.mark.parametrize("bend", [1e3, 1e6])
def test_a_rod_that_falls_flat_stays_down(scheme, bend):
    fall, rate = 60.0, 200.0
    rod = straight([1.0, 0.0, 0.0], [0.0, 0.0, fall + RADIUS])
    grippers = Grippers.resting(clamps_at(rod, Clamp.FREE, Clamp.FREE), 61)
    found = simulate(rod, Material(bend, bend), grippers, Dynamics(), Stepping(rate, scheme=scheme),
                     obstacles=[Plane((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))], radius=RADIUS)
    height = found.positions[0, ..., 2] - RADIUS
    down = np.flatnonzero(height.max(axis=1) < 1.0)[0]
    assert found.converged.all() and down < 30 and height[down:].max() < 1.0 and height.min() > -0.01


@pytest.mark.sampled(1)
@pytest.mark.parametrize("scheme", ["bdf2", "euler"])
@pytest.mark.parametrize("speed", [0.0, 20.0])
def test_a_rod_that_swings_into_a_wall_stays_there(scheme, speed):
    """Whether its gripper rests or moves along the wall."""
    rod, rate, instants = straight([np.sin(1.0), 0.0, -np.cos(1.0)]), 100.0, 101
    still = Grippers.resting(clamps_at(rod, Clamp.POSITION, Clamp.FREE), instants)
    way = speed * np.arange(instants)[None, :, None] / rate * [0.0, 1.0, 0.0]
    grippers = Grippers(still.start, still.end, still.start_position + way, still.end_position, still.start_frame,
                        still.end_frame)
    found = simulate(rod, Material(1e4, 1e4), grippers, Dynamics(), Stepping(rate, scheme=scheme),
                     obstacles=[Plane((-RADIUS, 0.0, 0.0), (1.0, 0.0, 0.0))], radius=RADIUS)
    tip = found.positions[0, :, -1, 0]
    assert found.converged.all() and tip[np.flatnonzero(tip < 1.0)[0] :].max() < 0.01 * LENGTH


def largest_rise(found) -> np.ndarray:
    """(R,) of the energy in a step, over its range."""
    energy = found.detail.energies["sum"]
    return np.nanmax(np.diff(energy, axis=1), axis=1) / (np.nanmax(energy, axis=1) - np.nanmin(energy, axis=1))


def no_step_raises_the_energy(rng, count: int, scenes, most: float, **options):
    rises, failed = [], 0
    for scene in scenes:
        found = moved(rng, scene, count, detailed=True, **options)
        rises.append(largest_rise(found))
        failed += np.sum(~found.converged)
    rises = np.concatenate(rises)
    print(f"{options}: {len(rises)} rods, {failed} stop; the energy rises by {rises.max():.1e} of its range at most")
    assert rises.max() < most and failed <= 0.02 * len(rises)


@pytest.mark.parametrize("scheme", ["bdf2", "euler"])
@pytest.mark.parametrize("friction, damping", [(0.0, 0.0), (0.0, 0.02), (0.3, 0.0)])
@pytest.mark.thorough
def test_no_step_raises_the_energy_of_some_rods(rng, scheme, friction, damping):
    no_step_raises_the_energy(rng, 24, SCENES, 2e-6, scheme=scheme, friction=friction, damping=damping)


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["bdf2", "euler"])
@pytest.mark.parametrize("friction, damping, rate", [
    (0.0, 0.0, 100.0), (0.0, 0.0, 400.0), (0.0, 0.02, 100.0), (0.3, 0.0, 100.0)])
def test_no_step_raises_the_energy_of_a_thousand_rods(rng, scheme, friction, damping, rate):
    no_step_raises_the_energy(rng, 170, SCENES, 1e-6, scheme=scheme, friction=friction, damping=damping, rate=rate)


@pytest.mark.thorough
@pytest.mark.parametrize("damping", [0.0, 0.02])
def test_impacts_are_the_same_in_several_launches_and_alone(damping):
    """What a step makes of an impact, the steps of later launches remember."""
    def motion(**more):
        return moved(np.random.default_rng(5), "table", 9, damping=damping, **more)

    whole, parts = motion(), motion(detailed=True)
    np.testing.assert_array_equal(whole.positions, parts.positions)
    np.testing.assert_array_equal(whole.iterations, parts.iterations)


@pytest.mark.thorough
def test_energies_balance_across_impacts(rng):
    """What an impact takes is unaccounted, never gained."""
    energies = moved(rng, "table", 20, damping=0.02, detailed=True, rate=400.0).detail.energies
    assert (energies["unaccounted"] > -1e-3 * np.ptp(energies["sum"], axis=1)[:, None]).all()
