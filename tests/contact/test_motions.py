"""Rods that grippers carry against pegs, step by step without inertia, with friction."""

import numpy as np
import pytest

from doo_ti import Capsule, Clamp, Clamps, Configuration, Dynamics, Grippers, Material, Plane, Stepping, relax, simulate
from tests.contact.clutter import gaps

LENGTH, EDGES, RADIUS, FRAMES, COUNT = 100.0, 33, 0.5, 12, 12
OBSTACLES = [Plane((0, 0, 0), (0, 0, 1), friction=0.2),
             *(Capsule((x, y, -5), (x, y, 60), r, friction=0.2) for x, y, r in ((30, -18, 2), (50, -25, 3), (70, -18, 2)))]


def carried(rows=slice(None)):
    """The motion of some of the rods, at rest beside the pegs and then carried 40 mm past them."""
    one = Configuration.straight(np.array([0.0, 20.0, 15.0]), np.array([1.0, 0.0, 0.0]), LENGTH, EDGES)
    rods = Configuration(np.repeat(one.start, COUNT, 0), np.repeat(one.quaternions, COUNT, 0), one.rest_length)
    frames = np.repeat(one.frames[:, 0], COUNT, 0)
    end = rods.start + np.stack([np.linspace(45, 64, COUNT), np.linspace(4, -4, COUNT), np.zeros(COUNT)], -1)
    clamps = Clamps(Clamp.FRAME, Clamp.FRAME, rods.start, end, frames, frames)
    material = Material(np.geomspace(1e4, 1e6, COUNT), np.full(COUNT, 1e5))
    rest = relax(rods, material, clamps, up=(0.0, -1.0, -0.2)).configuration
    rest = relax(rest, material, clamps, obstacles=OBSTACLES, radius=RADIUS)
    assert rest.converged.all()
    way = np.linspace(0.0, 1.0, FRAMES + 1)[:, None] * [0.0, -40.0, 4.0]
    held = np.repeat(frames[:, None], FRAMES + 1, 1)
    grippers = Grippers(Clamp.FRAME, Clamp.FRAME, rods.start[:, None] + way, end[:, None] + way, held, held)
    rows = np.arange(COUNT)[rows]
    return simulate(rest.configuration.take(rows), material.take(rows), grippers.take(rows), Dynamics(),
                    Stepping(rate=1.0, quasi_static=True), obstacles=OBSTACLES, radius=RADIUS)


@pytest.fixture(scope="module")
def moved():
    return carried()


@pytest.mark.thorough
def test_steps_of_many_radii_end_in_equilibria_outside_the_pegs(moved):
    assert moved.converged.all()
    x = moved.positions.reshape(-1, EDGES + 1, 3)
    assert gaps(OBSTACLES, x, RADIUS).min() > -1e-3 * RADIUS
    assert (moved.friction_work[:, -1] > 0).mean() > 0.8


@pytest.mark.thorough
def test_a_rod_moves_alone_and_in_another_order_as_among_others(moved):
    for rows in (slice(3, 4), slice(None, None, -1)):
        other = carried(rows)
        assert np.array_equal(other.positions, moved.positions[rows])
        assert np.array_equal(other.iterations, moved.iterations[rows])
