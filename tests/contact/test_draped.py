"""Ropes that are held at one end and fall onto a floor, a slope or an obstacle: nothing else holds them in their
place along it."""

import numpy as np
import pytest

from doo_ti import Box, Capsule, Clamp, Clamps, Configuration, Material, Newton, Plane, Solution, Sphere, Status, relax
from doo_ti.rod.shapes import straight_rod
from tests.references.rods import clamps_at

LENGTH, EDGES, RADIUS, COUNT = 200.0, 40, 1.0, 120
HELD = [(Clamp.FRAME, Clamp.FREE), (Clamp.POSITION, Clamp.FREE), (Clamp.FREE, Clamp.FRAME), (Clamp.FREE, Clamp.POSITION)]
THINGS = {"peg": Capsule((40, -200, 15), (40, 200, 15), 8.0), "box": Box((0, 0, -5), (60, 60, 15)),
          "sphere": Sphere((60, 10, 0), 20.0)}


def released(kinds: tuple[Clamp, Clamp]) -> tuple[Configuration, Material, Clamps]:
    """Straight ropes at random heights, directions and stiffnesses, to be let go at one end."""
    random = np.random.default_rng(2011)
    direction = random.normal(size=(COUNT, 3))
    direction[:, 2] = 0.3 * np.abs(direction[:, 2])
    height = random.uniform(20, 150, COUNT)
    rods = Configuration.concatenate([straight_rod(LENGTH, EDGES, (0.0, 0.0, z), along)
                                      for z, along in zip(height, direction, strict=True)])
    material = Material(10 ** random.uniform(3, 6, COUNT), 10 ** random.uniform(3, 6, COUNT))
    return rods, material, clamps_at(rods, *kinds)


def come_to_rest(kinds: tuple[Clamp, Clamp], obstacles: list, share: float) -> Solution:
    """Such ropes, let go above ``obstacles``: at least that ``share`` converge, to minima outside the obstacles."""
    rods, material, clamps = released(kinds)
    found = relax(rods, material, clamps, obstacles=obstacles, radius=RADIUS)
    feasible = found.status != Status.INFEASIBLE
    print(f"{found.converged[feasible].mean():.3f} converge, {np.median(found.iterations[feasible]):.0f} iterations")
    assert feasible.mean() > 0.9 and found.converged[feasible].mean() >= share
    assert found.stable[found.converged].all() and found.contact.gap[found.converged].min() > -1e-3 * RADIUS
    return found


@pytest.mark.sampled(2)
@pytest.mark.parametrize("kinds", HELD, ids=lambda kinds: f"{kinds[0].name} {kinds[1].name}")
@pytest.mark.parametrize("slope, share", [(0.0, 0.98), (0.1, 0.95)])
def test_ropes_come_to_rest(kinds, slope, share):
    found = come_to_rest(kinds, [Plane((0, 0, -5), (slope, 0.3 * slope, 1))], share)
    assert found.contact.touching[found.converged].any(axis=1).mean() > 0.7


@pytest.mark.sampled(1)
@pytest.mark.parametrize("kinds", HELD[:3], ids=lambda kinds: f"{kinds[0].name} {kinds[1].name}")
@pytest.mark.parametrize("thing", THINGS)
def test_ropes_come_to_rest_over_things(kinds, thing):
    """The ropes slide along the obstacle and the floor, while their energy hardly changes."""
    come_to_rest(kinds, [Plane((0, 0, -20), (0, 0, 1)), THINGS[thing]], 0.93)


@pytest.mark.thorough
def test_f64_finishes_what_f32_cannot():
    """A rope that hangs from a point to a flat floor turns about it at no cost, which f32 cannot certify."""
    rods, material, clamps = released((Clamp.POSITION, Clamp.FREE))
    found = relax(rods, material, clamps, obstacles=[Plane((0, 0, -5), (0, 0, 1))], radius=RADIUS, precision="f32")
    feasible = found.status != Status.INFEASIBLE
    print(f"{(found.precision == 64)[feasible].mean():.2f} by f64, {found.iterations[feasible].max()} iterations at most")
    assert found.converged[feasible].all() and found.stable[feasible].all()


@pytest.mark.parametrize("first_shift", [0.0, 0.05])
def test_a_rope_that_hangs_over_a_floor_by_its_far_end_moves_with_it(first_shift):
    """From rest and without a first shift, as predictions follow a branch: at first nothing holds the free end."""
    rods, material, clamps = released((Clamp.FREE, Clamp.FRAME))
    floor = dict(obstacles=[Plane((0, 0, -5), (0, 0, 1))], radius=RADIUS)
    rest = relax(rods, material, clamps, **floor)
    rows = np.flatnonzero(rest.converged & rest.contact.touching.any(axis=1))
    assert len(rows) > 40
    held = clamps.take(rows)
    held.end_position[:, 0] += 1.0
    found = relax(rest.configuration.take(rows), material.take(rows), held, Newton(first_shift=first_shift), **floor)
    assert found.converged.mean() > 0.97 and np.median(found.iterations) < 60
