"""A limp rope that hangs from a point and lies on a slope, at rest without friction and drawn up the slope with it."""

import numpy as np
import pytest

from doo_ti import Clamp, Clamps, Configuration, Dynamics, Grippers, Material, Plane, Stepping, relax, simulate
from tests.contact.elastica import along, solved

SLOPE, LENGTH, RADIUS, EDGES = np.deg2rad(20.0), 200.0, 2.0, 50
WEIGHT = 2.0  # per mm, of a material of weight 1
LIMP = Material(5.0, 5.0)
UPHILL, NORMAL = np.array([np.cos(SLOPE), 0.0, np.sin(SLOPE)]), np.array([-np.sin(SLOPE), 0.0, np.cos(SLOPE)])
HELD = np.array([0.0, 0.0, 60.0])
FRICTION, DRAWN, RATE, INSTANTS = 0.3, 40.0, 10.0, 61


def catenary(friction: float, held: np.ndarray):
    """(length that lies, horizontal tension, place at an arc length from the lower end) of a rope on the point of slipping up.

    Where it lifts off its tension is w a (sin α + μ cos α) and its direction that of the slope.
    """
    steep = np.tan(SLOPE)
    share = (np.sin(SLOPE) + friction * np.cos(SLOPE)) * np.cos(SLOPE)

    def miss(unknowns):
        lying, foot, end = unknowns
        c = lying * share
        return [c * (np.sinh(end) - steep) - LENGTH + lying, c * (end - np.arcsinh(steep)) - held[0] + foot,
                c * (np.cosh(end) - np.hypot(1.0, steep)) - held[2] + foot * steep]

    lying, foot, _ = solved(miss, [0.5 * LENGTH, held[0] - 0.3 * LENGTH, 1.5])
    c = lying * share

    def place(s):
        angle = np.arcsinh(steep + np.maximum(s - lying, 0.0) / c)
        hanging = np.stack([c * (angle - np.arcsinh(steep)), 0.0 * s, c * (np.cosh(angle) - np.hypot(1.0, steep))], -1)
        return np.array([foot, 0.0, foot * steep]) + np.minimum(s - lying, 0.0)[:, None] * UPHILL + hanging

    return lying, c * WEIGHT, place


def laid() -> Configuration:
    """The rope a little above where it lies without friction."""
    return along(catenary(0.0, HELD)[2](np.linspace(0.0, LENGTH, 4001)) + 0.2 * NORMAL, EDGES, LENGTH)


def check(x: np.ndarray, forces: np.ndarray, friction: float, held: np.ndarray, bar: float) -> None:
    """Compare shape (V, 3), load on the slope and tension with the closed form."""
    lying, tension, place = catenary(friction, held)
    assert np.linalg.norm(x - place(np.linspace(0.0, LENGTH, EDGES + 1)), axis=1).max() < bar * LENGTH
    assert np.isclose((forces @ NORMAL).sum(), WEIGHT * lying * np.cos(SLOPE), rtol=2 * bar)
    assert np.isclose(-forces[:, 0].sum(), tension, rtol=2 * bar)


def test_at_rest_on_a_smooth_slope():
    frame = np.eye(3)[None]
    clamps = Clamps(Clamp.FREE, Clamp.POSITION, np.zeros((1, 3)), HELD[None], frame, frame)
    found = relax(laid(), LIMP, clamps, obstacles=[Plane(-RADIUS * NORMAL, NORMAL)], radius=RADIUS)
    assert found.converged.all() and found.stable.all()
    check(found.configuration.vertices[0], found.contact_force[0], 0.0, HELD, 1e-4)


@pytest.mark.thorough
def test_drawn_up_a_slope_with_friction():
    path = (HELD + np.linspace(0.0, DRAWN, INSTANTS)[:, None] * UPHILL)[None]
    frames = np.broadcast_to(np.eye(3), (1, INSTANTS, 3, 3)).copy()
    moved = simulate(laid(), LIMP, Grippers(Clamp.FREE, Clamp.POSITION, 0 * path, path, frames, frames), Dynamics(drag=2.0),
                     Stepping(RATE, scheme="euler"), obstacles=[Plane(-RADIUS * NORMAL, NORMAL, friction=FRICTION)],
                     radius=RADIUS)
    assert moved.converged.all()
    check(moved.positions[0, -1], moved.contact_force[0, -1], FRICTION, path[0, -1], 1e-3)
