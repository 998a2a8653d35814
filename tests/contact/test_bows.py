"""Straight rods between clamps that need slack: how they are bowed among obstacles, and where they come to rest."""

from dataclasses import replace

import numpy as np
import pytest

from doo_ti import Box, Capsule, Clamp, Clamps, Configuration, Material, Plane, relax, straight_rod
from tests.references.rods import clamps_at

TABLE = Plane((0, 0, 0), (0, 0, 1))
BOXES = [Box((35, -4, 10), (6, 6, 12)), Box((70, 5, 12), (7, 7, 20)), Box((100, -3, 8), (5, 30, 6))]


def slack_rods(heights, spans, aside, length: float, edges: int, kind: Clamp) -> tuple[Configuration, Clamps]:
    """Straight rods along x at these heights, whose far ends are clamped ``spans`` mm from the near ones and ``aside``."""
    start = np.stack([0 * heights, 0 * heights, heights], axis=1)
    rods = replace(straight_rod(length, edges).take(np.zeros(len(heights), dtype=int)), start=start)
    return rods, replace(clamps_at(rods, kind, kind), end_position=start + np.stack([spans, aside, 0 * spans], axis=1))


@pytest.mark.parametrize("kind", [Clamp.POSITION, Clamp.FRAME], ids=["hinged", "clamped"])
def test_ropes_with_slack_come_to_rest_on_a_table(rng, kind):
    """Ropes of 300 mm, a third to five sixths of that between their ends, from 5 to 60 mm above the table."""
    count = 48
    heights, spans, aside = rng.uniform(5, 60, count), rng.uniform(100, 250, count), rng.uniform(-50, 50, count)
    rods, clamps = slack_rods(heights, spans, aside, 300.0, 40, kind)
    bend = 10 ** rng.uniform(3, 5, count)
    found = relax(rods, Material(bend, bend), clamps, obstacles=[TABLE], radius=2.0)
    print(f"{found.converged.mean():.3f} converged in {found.iterations.mean():.0f} iterations")
    assert found.converged.all() and found.stable.all() and (found.contact.gap > -4e-4).all()
    assert found.iterations.mean() < 80


@pytest.mark.thorough
def test_a_rod_does_not_fall_through_a_thin_peg():
    """It would sag far below a peg that crosses below its middle."""
    heights = np.array([6.0, 9.0, 12.0])
    rods, clamps = slack_rods(heights, np.full(3, 80.0), np.zeros(3), 100.0, 33, Clamp.FRAME)
    peg = Capsule((40, -60, 0), (40, 60, 0), 1.5)
    found = relax(rods, Material(1e4, 1e4), clamps, obstacles=[peg], radius=1.0)
    assert found.converged.all()
    for x in found.configuration.vertices:
        assert np.interp(40.0, x[:, 0], x[:, 2]) > 2.4


@pytest.mark.thorough
def test_no_edge_begins_across_the_corner_of_a_box(rng):
    """Rods of 5 mm edges over boxes of 5 to 7 mm."""
    count = 128
    spans, aside = rng.uniform(110, 140, count), rng.uniform(-15, 15, count)
    rods, clamps = slack_rods(np.full(count, 25.0), spans, aside, 150.0, 30, Clamp.FRAME)
    bend = 10 ** rng.uniform(3.5, 5, count)
    found = relax(rods, Material(bend, bend), clamps, obstacles=BOXES, radius=1.0)
    print(f"{found.converged.mean():.3f} converged")
    assert found.converged.mean() > 0.97


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
    found = relax(rod, Material(bend, bend), clamps, obstacles=BOXES, radius=1.0)
    assert found.converged[0] and found.stable[0]
