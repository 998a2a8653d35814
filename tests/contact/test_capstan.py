"""A limp rope that is pulled over a cylinder or through a ring with friction: the tensions at its ends are e^(μ φ) apart."""

import numpy as np
import pytest

from doo_ti import Clamp, Cylinder, Dynamics, Grippers, Material, Ring, Springs, Stepping, simulate
from doo_ti.rod.frames import across, unit_vectors
from tests.references.rods import chain

ROPE, DRUM, STRAIGHT = 0.2, 20.0, 30.0
DRAWN, STEPS = 4.0, 40
HELD, FAR = 10.0, 1e4


def wound(angle: float, edges: int, pitch: float) -> np.ndarray:
    """(V, 3) a rope that comes straight, follows a helix on the drum through that angle and leaves straight."""
    r = DRUM + ROPE
    wrapped = np.hypot(r * angle, pitch * angle)
    total = 2 * STRAIGHT + wrapped
    s = np.linspace(-STRAIGHT, wrapped + STRAIGHT, 40 * edges + 1)
    turn = np.clip(s / wrapped, 0.0, 1.0) * angle
    beyond = s - np.clip(s, 0.0, wrapped)
    along = np.stack([-np.sin(turn) * r, np.cos(turn) * r, np.full_like(turn, pitch)], -1)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    x = np.stack([r * np.cos(turn), r * np.sin(turn), pitch * turn], -1) + beyond[:, None] * along
    # Chords of equal length, a trace outside the drum.
    x[:, :2] *= 1.0 + 1.5 * (total / edges) ** 2 / (8 * r**2)
    arc = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(x, axis=0), axis=1)))
    return np.stack([np.interp(np.linspace(0, arc[-1], edges + 1), arc, x[:, k]) for k in range(3)], -1)


def tensions(obstacle, angle: float, pitch: float, edges: int = 60) -> tuple[float, float]:
    """(of the end that is drawn, of the end that follows), at the end of the motion."""
    x = wound(angle, edges, pitch)
    step = np.diff(x, axis=0)
    tangents = unit_vectors(step)
    rod = chain(tangents, across(tangents[:1])[0], np.linalg.norm(step, axis=1), x[0])
    # A soft spring from far away holds the end that follows, with a force that hardly changes.
    points, stiffness = np.zeros((1, edges + 1, 3)), np.zeros((1, edges + 1))
    points[0, 0], stiffness[0, 0] = x[0] - FAR * tangents[0], HELD / FAR
    share = np.linspace(0.0, 1.0, STEPS + 1)[:, None]
    end = x[-1] + DRAWN * share * tangents[-1]
    frame = np.broadcast_to(np.eye(3), (1, STEPS + 1, 3, 3)).copy()
    grippers = Grippers(Clamp.FREE, Clamp.POSITION, np.repeat(x[None, :1], STEPS + 1, 1), end[None], frame, frame)
    material = Material(2.0, 2.0, weight=1e-6)
    moved = simulate(rod, material, grippers, Dynamics(density=1e-2, drag=20.0), Stepping(rate=100.0, scheme="euler"),
                     springs=Springs(points, stiffness), radius=ROPE, obstacles=[obstacle])
    assert moved.converged.all(), moved.status[0]
    drawn = moved.end_force[0, -1]
    held = -(drawn + moved.contact_force[0, -1].sum(axis=0))
    return np.linalg.norm(drawn), np.linalg.norm(held)


@pytest.mark.thorough
@pytest.mark.parametrize("degrees, friction", [(90, 0.1), (90, 0.5), (180, 0.3), (360, 0.1), (360, 0.5), (720, 0.3),
                                               (720, 0.5)])
def test_the_tensions_are_apart_by_the_capstan_equation(degrees, friction):
    angle = np.deg2rad(degrees)
    cylinder, edges = Cylinder((0, 0, -80), (0, 0, 80), DRUM, friction=friction), 60 if degrees < 360 else degrees // 3
    drawn, held = tensions(cylinder, angle, 0.4, edges)
    assert abs(held / HELD - 1.0) < 0.01
    assert abs(drawn / held / np.exp(friction * angle) - 1.0) < 0.02


@pytest.mark.thorough
@pytest.mark.parametrize("degrees, friction", [(60, 0.3), (90, 0.3), (120, 0.2)])
def test_pulled_through_a_ring_too(degrees, friction):
    angle = np.deg2rad(degrees)
    inward = np.array([np.cos(0.5 * angle), np.sin(0.5 * angle), 0.0])
    ring = Ring(3 * DRUM * inward, np.cross([0, 0, 1], inward), 3 * DRUM, DRUM, friction=friction)
    drawn, held = tensions(ring, angle, 0.0)
    assert abs(drawn / held / np.exp(friction * angle) - 1.0) < 0.005
