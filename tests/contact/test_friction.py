"""Friction in motions: on a slope, on a table, against pegs, and of ropes drawn over a cylinder or through a ring."""

from dataclasses import replace

import numpy as np
import pytest

from doo_ti import Capsule, Clamp, Cylinder, Material, Plane, Ring, Springs, Touch, end_clamps, relax, simulate, straight_rod
from doo_ti.dynamics.grippers import Grippers
from doo_ti.dynamics.parameters import GRAVITY, Dynamics, Stepping
from doo_ti.rod.frames import across, unit_vectors
from doo_ti.rod.types import Configuration
from tests.contact.clutter import gaps
from tests.references.rods import chain

SLOPE, LENGTH, RADIUS, RATE, INSTANTS = np.deg2rad(20.0), 40.0, 1.0, 200.0, 41
FRICTIONS = np.array([0.0, 0.2, 0.5])


@pytest.fixture(scope="module")
def moved():
    up = np.array([-np.sin(SLOPE), 0.0, np.cos(SLOPE)])
    rods = straight_rod(LENGTH, 6, (0.0, 0.0, RADIUS), (0.0, 1.0, 0.0)).take(np.zeros(len(FRICTIONS), dtype=int))
    free = Grippers.resting(end_clamps(rods, Clamp.FREE, Clamp.FREE), INSTANTS)
    plane = Plane((0, 0, 0), (0, 0, 1), friction=FRICTIONS)
    return simulate(rods, Material(1e7, 1e7), free, Dynamics(), Stepping(RATE), up=up, obstacles=[plane], radius=RADIUS)


def test_it_slides_as_a_block_does_or_stays_where_friction_is_large_enough(moved):
    assert moved.converged.all()
    t = np.arange(1, INSTANTS) / RATE
    for rod, friction in enumerate(FRICTIONS[:2]):
        pull = GRAVITY * (np.sin(SLOPE) - friction * np.cos(SLOPE))
        assert np.abs(moved.positions[rod, :, :, 0].mean(axis=-1) - 0.5 * pull * t**2).max() < 0.01 * 0.5 * pull * t[-1] ** 2
    assert np.abs(moved.positions[2, :, :, 0]).max() < 1e-3 * RADIUS
    assert moved.friction_work[2, -1] < 1e-3 * moved.friction_work[1, -1]


def test_forces_hold_the_weight_and_friction_takes_the_energy_that_sliding_lacks(moved):
    weight = 2.0 * LENGTH
    force = moved.contact_force[:, -1].sum(axis=1)
    assert np.allclose(force[:, 2], weight * np.cos(SLOPE), rtol=1e-3)
    assert np.allclose(-force[1:, 0], [0.2 * force[1, 2], weight * np.sin(SLOPE)], rtol=1e-3)
    distance = moved.positions[1, -1, :, 0].mean()
    assert np.isclose(moved.friction_work[1, -1], 0.2 * weight * np.cos(SLOPE) * distance, rtol=1e-2)


FRAMES, PUSH = 4, 4.0  # mm


def pushed(coefficient: float):
    """The motion, how far each vertex moves at each instant, and what it does then."""
    table = [Plane((0, 0, 0), (0, 0, 1), friction=coefficient)]
    rod = straight_rod(300.0, 40, (0.0, 0.0, RADIUS))
    still = Grippers.resting(end_clamps(rod, Clamp.POSITION, Clamp.POSITION), FRAMES + 1)
    way = np.outer(np.linspace(0.0, PUSH, FRAMES + 1), [1.0, 0.0, 0.0])
    grippers = replace(still, start_position=still.start_position + way, end_position=still.end_position - [40.0, 0.0, 0.0])
    material = Material(2e4, 2e4, 2.0)
    # Bowed along the table before it lies on it.
    rest = relax(rod, material, grippers.at(0), up=(0.0, 1.0, 0.0)).configuration
    rest = relax(rest, material, grippers.at(0), obstacles=table, radius=RADIUS)
    found = simulate(rest.configuration, material, grippers, Dynamics(), Stepping(1.0, quasi_static=True), obstacles=table,
                     radius=RADIUS)
    assert rest.converged.all() and found.converged.all()
    places = np.concatenate([rest.configuration.vertices, found.positions[0]])
    return found, np.linalg.norm(np.diff(places, axis=0), axis=-1), found.touch[0]


def test_what_moves_slips_and_what_stays_sticks():
    """With hardly any friction the whole bow moves, but for its far end."""
    found, moves, touch = pushed(0.4)
    assert (touch[-1] == Touch.STICKS).any() and (touch[-1] == Touch.SLIPS).any()
    assert (moves[touch == Touch.STICKS] < 1e-2).all()
    assert (touch[(moves > 0.1) & (touch != Touch.NONE)] == Touch.SLIPS).all()
    assert found.friction_work[0, -1] > 0
    _, moves, touch = pushed(1e-5)
    assert (moves[:, :-1] > 0.05).all() and (touch[:, :-1] != Touch.STICKS).all()


COUNT, THIN, WAYS = 12, 0.5, 12
PEGS = [Plane((0, 0, 0), (0, 0, 1), friction=0.2),
        *(Capsule((x, y, -5), (x, y, 60), r, friction=0.2) for x, y, r in ((30, -18, 2), (50, -25, 3), (70, -18, 2)))]


@pytest.mark.thorough
def test_steps_of_many_radii_end_in_equilibria_outside_the_pegs():
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
    assert carried.converged.all() and (carried.friction_work[:, -1] > 0).mean() > 0.8
    assert gaps(PEGS, carried.positions.reshape(-1, 34, 3), THIN).min() > -1e-3 * THIN


ROPE, DRUM, STRAIGHT = 0.2, 20.0, 30.0
DRAWN, STEPS = 4.0, 40
HELD, FAR = 10.0, 1e4


def wound(angle: float, edges: int, pitch: float) -> Configuration:
    """A rope that comes straight, follows a helix on the drum through that angle and leaves straight."""
    r = DRUM + ROPE
    wrapped = np.hypot(r * angle, pitch * angle)
    total = 2 * STRAIGHT + wrapped
    s = np.linspace(-STRAIGHT, wrapped + STRAIGHT, 40 * edges + 1)
    turn = np.clip(s / wrapped, 0.0, 1.0) * angle
    beyond = s - np.clip(s, 0.0, wrapped)
    along = unit_vectors(np.stack([-np.sin(turn) * r, np.cos(turn) * r, np.full_like(turn, pitch)], -1))
    x = np.stack([r * np.cos(turn), r * np.sin(turn), pitch * turn], -1) + beyond[:, None] * along
    # Chords of equal length, a trace outside the drum.
    x[:, :2] *= 1.0 + 1.5 * (total / edges) ** 2 / (8 * r**2)
    arc = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(x, axis=0), axis=1)))
    step = np.diff([np.interp(np.linspace(0, arc[-1], edges + 1), arc, x[:, k]) for k in range(3)]).T
    return chain(step, across(unit_vectors(step[:1]))[0], np.linalg.norm(step, axis=1), x[0])


def tensions(obstacle, angle: float, pitch: float, edges: int = 60) -> tuple[float, float]:
    """(of the end that is drawn, of the end that follows), at the end of the motion."""
    rod = wound(angle, edges, pitch)
    x, tangents = rod.vertices[0], rod.frames[0, :, :, 0]
    # A soft spring from far away holds the end that follows, with a force that hardly changes.
    points, stiffness = np.zeros((1, edges + 1, 3)), np.zeros((1, edges + 1))
    points[0, 0], stiffness[0, 0] = x[0] - FAR * tangents[0], HELD / FAR
    still = Grippers.resting(end_clamps(rod, Clamp.FREE, Clamp.POSITION), STEPS + 1)
    way = np.outer(np.linspace(0.0, DRAWN, STEPS + 1), tangents[-1])
    moved = simulate(rod, Material(2.0, 2.0, weight=1e-6), replace(still, end_position=still.end_position + way),
                     Dynamics(density=1e-2, drag=20.0), Stepping(rate=100.0, scheme="euler"),
                     springs=Springs(points, stiffness), radius=ROPE, obstacles=[obstacle])
    assert moved.converged.all(), moved.status[0]
    drawn = moved.end_force[0, -1]
    held = -(drawn + moved.contact_force[0, -1].sum(axis=0))
    return np.linalg.norm(drawn), np.linalg.norm(held)


@pytest.mark.thorough
@pytest.mark.parametrize("on, degrees, friction", [
    ("drum", 90, 0.1), ("drum", 90, 0.5), ("drum", 180, 0.3), ("drum", 360, 0.1), ("drum", 360, 0.5), ("drum", 720, 0.3),
    ("drum", 720, 0.5), ("ring", 60, 0.3), ("ring", 90, 0.3), ("ring", 120, 0.2)])
def test_the_tensions_are_apart_by_the_capstan_equation(on, degrees, friction):
    angle = np.deg2rad(degrees)
    inward = np.array([np.cos(0.5 * angle), np.sin(0.5 * angle), 0.0])
    obstacle = Cylinder((0, 0, -80), (0, 0, 80), DRUM, friction=friction) if on == "drum" else Ring(
        3 * DRUM * inward, np.cross([0, 0, 1], inward), 3 * DRUM, DRUM, friction=friction)
    drawn, held = tensions(obstacle, angle, 0.4 if on == "drum" else 0.0, 60 if degrees < 360 else degrees // 3)
    assert on == "ring" or abs(held / HELD - 1.0) < 0.01
    assert abs(drawn / held / np.exp(friction * angle) - 1.0) < (0.02 if on == "drum" else 0.005)
