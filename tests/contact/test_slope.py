"""A stiff rod that lies on a slope: it stays where friction holds it, and otherwise slides as a block does."""

import numpy as np
import pytest

from doo_ti import Clamp, Configuration, Grippers, Material, Plane, simulate
from doo_ti.dynamics.parameters import GRAVITY, Dynamics, Stepping

SLOPE, LENGTH, EDGES, RADIUS, RATE, INSTANTS = np.deg2rad(20.0), 40.0, 6, 1.0, 200.0, 41

STEPPING = Stepping(RATE)


def on_slope(frictions, stepping: Stepping = STEPPING):
    """The motion of rods across slopes with these coefficients of friction, from rest."""
    up = np.array([-np.sin(SLOPE), 0.0, np.cos(SLOPE)])
    one = Configuration.straight(np.array([0.0, 0.0, RADIUS]), np.array([0.0, 1.0, 0.0]), LENGTH, EDGES)
    count = len(frictions)
    rods = Configuration(np.repeat(one.start, count, 0), np.repeat(one.quaternions, count, 0), one.rest_length)
    x, frames = rods.vertices, rods.frames
    ends = [np.repeat(place[:, None], INSTANTS, 1) for place in (x[:, 0], x[:, -1], frames[:, 0], frames[:, -1])]
    plane = Plane((0, 0, 0), (0, 0, 1), friction=np.array(frictions))
    return simulate(rods, Material(1e7, 1e7), Grippers(Clamp.FREE, Clamp.FREE, *ends), Dynamics(), stepping, up=up,
                    obstacles=[plane], radius=RADIUS)


@pytest.fixture(scope="module")
def moved():
    return on_slope([0.0, 0.2, 0.5])


def test_it_slides_as_a_block_does(moved):
    assert moved.converged.all()
    t = np.arange(1, INSTANTS) / RATE
    for rod, friction in enumerate([0.0, 0.2]):
        pull = GRAVITY * (np.sin(SLOPE) - friction * np.cos(SLOPE))
        assert np.abs(moved.positions[rod, :, :, 0].mean(axis=-1) - 0.5 * pull * t**2).max() < 0.01 * 0.5 * pull * t[-1] ** 2


def test_it_stays_where_friction_is_large_enough(moved):
    assert np.abs(moved.positions[2, :, :, 0]).max() < 1e-3 * RADIUS
    assert moved.friction_work[2, -1] < 1e-3 * moved.friction_work[1, -1]


def test_forces_hold_the_weight(moved):
    weight = 2.0 * LENGTH
    force = moved.contact_force[:, -1].sum(axis=1)
    assert np.allclose(force[:, 2], weight * np.cos(SLOPE), rtol=1e-3)
    assert np.allclose(-force[1, 0], 0.2 * force[1, 2], rtol=1e-3)
    assert np.allclose(-force[2, 0], weight * np.sin(SLOPE), rtol=1e-3)


def test_friction_takes_the_energy_that_sliding_lacks(moved):
    distance = moved.positions[1, -1, :, 0].mean()
    assert np.isclose(moved.friction_work[1, -1], 0.2 * 2.0 * LENGTH * np.cos(SLOPE) * distance, rtol=1e-2)


def test_a_rod_moves_alone_as_among_others(moved):
    alone = on_slope([0.2])
    assert np.array_equal(alone.positions[0], moved.positions[1])
    assert np.array_equal(alone.contact_force[0], moved.contact_force[1])
