"""Ropes that are held at one end and fall onto obstacles, and straight rods between clamps that need slack."""

from dataclasses import replace

import numpy as np
import pytest

from doo_ti import Box, Capsule, Newton, Plane, Sphere, relax, straight_rod
from doo_ti.rod.types import Clamp, Clamps, Configuration, Material, Solution, Status
from tests.references.rods import certified, clamps_at

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


TABLE = Plane((0, 0, 0), (0, 0, 1))
BOXES = [Box((35, -4, 10), (6, 6, 12)), Box((70, 5, 12), (7, 7, 20)), Box((100, -3, 8), (5, 30, 6))]


def slack_rods(heights, spans, aside, length: float, edges: int, kind: Clamp) -> tuple[Configuration, Clamps]:
    """Straight rods along x at these heights, whose far ends are clamped ``spans`` mm from the near ones and ``aside``."""
    start = np.stack([0 * heights, 0 * heights, heights], axis=1)
    rods = replace(straight_rod(length, edges).take(np.zeros(len(heights), dtype=int)), start=start)
    return rods, replace(clamps_at(rods, kind, kind), end_position=start + np.stack([spans, aside, 0 * spans], axis=1))


@pytest.mark.parametrize("kind", [Clamp.POSITION, Clamp.FRAME], ids=["hinged", "clamped"])
def test_ropes_with_slack_come_to_rest_on_a_table(rng, kind):
    count = 48
    heights, spans, aside = rng.uniform(5, 60, count), rng.uniform(100, 250, count), rng.uniform(-50, 50, count)
    rods, clamps = slack_rods(heights, spans, aside, 300.0, 40, kind)
    bend = 10 ** rng.uniform(3, 5, count)
    found = certified(relax(rods, Material(bend, bend), clamps, obstacles=[TABLE], radius=2.0))
    assert (found.contact.gap > -4e-4).all() and found.iterations.mean() < 80


@pytest.mark.thorough
def test_no_edge_begins_across_the_corner_of_a_box(rng):
    count = 128
    spans, aside = rng.uniform(110, 140, count), rng.uniform(-15, 15, count)
    rods, clamps = slack_rods(np.full(count, 25.0), spans, aside, 150.0, 30, Clamp.FRAME)
    bend = 10 ** rng.uniform(3.5, 5, count)
    assert relax(rods, Material(bend, bend), clamps, obstacles=BOXES, radius=1.0).converged.mean() > 0.97


@pytest.mark.sampled(1)
@pytest.mark.parametrize("seed, row", [(12, 24), (13, 87), (15, 117)])
def test_an_edge_pushed_into_a_box_comes_out_again(seed, row):
    """On their way these rods are pushed into the thin box so far that their centreline is inside, between two of its faces:
    there φ has a kink along the rod's edge, and no curvature."""
    random = np.random.default_rng(seed)
    starts = random.uniform(-10, 10, 128)
    ahead = np.stack([random.uniform(110, 140, 128), random.uniform(-15, 15, 128), random.uniform(-5, 5, 128)], -1)
    bend = 10 ** random.uniform(3.5, 5, 128)[row]
    rod = straight_rod(150.0, 30, (0.0, starts[row], 25.0))
    clamps = replace(clamps_at(rod), end_position=rod.start + ahead[row])
    certified(relax(rod, Material(bend, bend), clamps, obstacles=BOXES, radius=1.0))
