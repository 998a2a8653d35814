"""Friction in motions: a stiff rod on a slope slides as a block does or stays; a rope on a table of which one end is pushed
sticks and slips; and rods that grippers carry against pegs stay outside these."""

from dataclasses import replace

import numpy as np
import pytest

from doo_ti import Capsule, Clamp, Grippers, Material, Plane, Touch, end_clamps, relax, simulate, straight_rod
from doo_ti.dynamics.parameters import GRAVITY, Dynamics, Stepping
from tests.contact.clutter import gaps

# --- on a slope ---

SLOPE, LENGTH, RADIUS, RATE, INSTANTS = np.deg2rad(20.0), 40.0, 1.0, 200.0, 41
STEPPING = Stepping(RATE)


def on_slope(frictions, stepping: Stepping = STEPPING):
    """The motion of rods across slopes with these coefficients of friction, from rest."""
    up = np.array([-np.sin(SLOPE), 0.0, np.cos(SLOPE)])
    rods = straight_rod(LENGTH, 6, (0.0, 0.0, RADIUS), (0.0, 1.0, 0.0)).take(np.zeros(len(frictions), dtype=int))
    free = Grippers.resting(end_clamps(rods, Clamp.FREE, Clamp.FREE), INSTANTS)
    plane = Plane((0, 0, 0), (0, 0, 1), friction=np.array(frictions))
    return simulate(rods, Material(1e7, 1e7), free, Dynamics(), stepping, up=up, obstacles=[plane], radius=RADIUS)


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


def test_forces_hold_the_weight_and_friction_takes_the_energy_that_sliding_lacks(moved):
    weight = 2.0 * LENGTH
    force = moved.contact_force[:, -1].sum(axis=1)
    assert np.allclose(force[:, 2], weight * np.cos(SLOPE), rtol=1e-3)
    assert np.allclose(-force[1, 0], 0.2 * force[1, 2], rtol=1e-3)
    assert np.allclose(-force[2, 0], weight * np.sin(SLOPE), rtol=1e-3)
    distance = moved.positions[1, -1, :, 0].mean()
    assert np.isclose(moved.friction_work[1, -1], 0.2 * weight * np.cos(SLOPE) * distance, rtol=1e-2)


def test_a_rod_moves_alone_as_among_others(moved):
    alone = on_slope([0.2])
    assert np.array_equal(alone.positions[0], moved.positions[1])
    assert np.array_equal(alone.contact_force[0], moved.contact_force[1])


# --- a bowed rope on a table ---

FRAMES, PUSH = 4, 4.0  # mm


def pushed(coefficient: float):
    """The motion, how far each vertex moves at each instant, and what it does then."""
    table = [Plane((0, 0, 0), (0, 0, 1), friction=coefficient)]
    rod = straight_rod(300.0, 40, (0.0, 0.0, RADIUS))
    still = Grippers.resting(end_clamps(rod, Clamp.POSITION, Clamp.POSITION), FRAMES + 1)
    way = np.linspace(0.0, PUSH, FRAMES + 1)[:, None] * [1.0, 0.0, 0.0]
    grippers = replace(still, start_position=still.start_position + way, end_position=still.end_position - [40.0, 0.0, 0.0])
    material = Material(2e4, 2e4, 2.0)
    # Bowed along the table before it lies on it.
    rest = relax(rod, material, grippers.at(0), up=(0.0, 1.0, 0.0)).configuration
    rest = relax(rest, material, grippers.at(0), obstacles=table, radius=RADIUS)
    found = simulate(rest.configuration, material, grippers, Dynamics(), Stepping(1.0, quasi_static=True), obstacles=table,
                     radius=RADIUS)
    assert rest.converged.all() and found.converged.all()
    places, touch = np.concatenate([rest.configuration.vertices[:, None], found.positions], axis=1), found.touch[0]
    moves = np.linalg.norm(np.diff(places, axis=1), axis=-1)[0]
    print(f"stick {(touch == Touch.STICKS).sum(axis=1)}, slip {(touch == Touch.SLIPS).sum(axis=1)}; moved {moves[-1]}")
    return found, moves, touch


def test_what_moves_slips_and_what_stays_sticks():
    found, moves, touch = pushed(0.4)
    assert (touch[-1] == Touch.STICKS).any() and (touch[-1] == Touch.SLIPS).any()
    assert (moves[touch == Touch.STICKS] < 1e-2).all()
    assert (touch[(moves > 0.1) & (touch != Touch.NONE)] == Touch.SLIPS).all()
    assert found.friction_work[0, -1] > 0


def test_with_hardly_any_friction_all_that_moves_slips():
    """The whole bow moves, but for its far end."""
    _, moves, touch = pushed(1e-5)
    assert (moves[:, :-1] > 0.05).all() and (touch[:, :-1] != Touch.STICKS).all()


# --- against pegs ---

COUNT, THIN, WAYS = 12, 0.5, 12
PEGS = [Plane((0, 0, 0), (0, 0, 1), friction=0.2),
        *(Capsule((x, y, -5), (x, y, 60), r, friction=0.2) for x, y, r in ((30, -18, 2), (50, -25, 3), (70, -18, 2)))]


@pytest.mark.thorough
def test_steps_of_many_radii_end_in_equilibria_outside_the_pegs():
    """Rods at rest beside the pegs and then carried 40 mm past them."""
    rods = straight_rod(100.0, 33, (0.0, 20.0, 15.0)).take(np.zeros(COUNT, dtype=int))
    end = rods.start + np.stack([np.linspace(45, 64, COUNT), np.linspace(4, -4, COUNT), np.zeros(COUNT)], -1)
    clamps = replace(end_clamps(rods, Clamp.FRAME, Clamp.FRAME), end_position=end)
    material = Material(np.geomspace(1e4, 1e6, COUNT), np.full(COUNT, 1e5))
    rest = relax(rods, material, clamps, up=(0.0, -1.0, -0.2)).configuration
    rest = relax(rest, material, clamps, obstacles=PEGS, radius=THIN)
    assert rest.converged.all()
    way = np.linspace(0.0, 1.0, WAYS + 1)[:, None] * [0.0, -40.0, 4.0]
    still = Grippers.resting(clamps, WAYS + 1)
    grippers = replace(still, start_position=still.start_position + way, end_position=still.end_position + way)
    carried = simulate(rest.configuration, material, grippers, Dynamics(), Stepping(1.0, quasi_static=True), obstacles=PEGS,
                       radius=THIN)
    assert carried.converged.all()
    assert gaps(PEGS, carried.positions.reshape(-1, 34, 3), THIN).min() > -1e-3 * THIN
    assert (carried.friction_work[:, -1] > 0).mean() > 0.8
