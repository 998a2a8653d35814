"""A limp rope that hangs from a point and lies on a smooth slope."""

import numpy as np

from doo_ti import Clamp, Clamps, Material, Plane, relax
from tests.contact.elastica import along, solved

SLOPE, LENGTH, RADIUS, EDGES = np.deg2rad(20.0), 200.0, 2.0, 50
WEIGHT = 2.0  # per mm, of a material of weight 1
LIMP = Material(5.0, 5.0)
UPHILL, NORMAL = np.array([np.cos(SLOPE), 0.0, np.sin(SLOPE)]), np.array([-np.sin(SLOPE), 0.0, np.cos(SLOPE)])
HELD = np.array([0.0, 0.0, 60.0])


def catenary():
    """(length that lies, horizontal tension, place at an arc length from the lower end): where the rope lifts off its tension
    is w a sin α and its direction that of the slope."""
    steep, share = np.tan(SLOPE), np.sin(SLOPE) * np.cos(SLOPE)

    def miss(unknowns):
        lying, foot, end = unknowns
        c = lying * share
        return [c * (np.sinh(end) - steep) - LENGTH + lying, c * (end - np.arcsinh(steep)) - HELD[0] + foot,
                c * (np.cosh(end) - np.hypot(1.0, steep)) - HELD[2] + foot * steep]

    lying, foot, _ = solved(miss, [0.5 * LENGTH, HELD[0] - 0.3 * LENGTH, 1.5])
    c = lying * share

    def place(s):
        angle = np.arcsinh(steep + np.maximum(s - lying, 0.0) / c)
        hanging = np.stack([c * (angle - np.arcsinh(steep)), 0.0 * s, c * (np.cosh(angle) - np.hypot(1.0, steep))], -1)
        return np.array([foot, 0.0, foot * steep]) + np.minimum(s - lying, 0.0)[:, None] * UPHILL + hanging

    return lying, c * WEIGHT, place


def test_at_rest_on_a_smooth_slope():
    """From a little above where it lies: shape, load on the slope and tension."""
    lying, tension, place = catenary()
    frame = np.eye(3)[None]
    clamps = Clamps(Clamp.FREE, Clamp.POSITION, np.zeros((1, 3)), HELD[None], frame, frame)
    start = along(place(np.linspace(0.0, LENGTH, 4001)) + 0.2 * NORMAL, EDGES, LENGTH)
    found = relax(start, LIMP, clamps, obstacles=[Plane(-RADIUS * NORMAL, NORMAL)], radius=RADIUS)
    assert found.converged.all() and found.stable.all()
    apart = found.configuration.vertices[0] - place(np.linspace(0.0, LENGTH, EDGES + 1))
    assert np.linalg.norm(apart, axis=1).max() < 1e-4 * LENGTH
    forces = found.contact_force[0]
    assert np.isclose((forces @ NORMAL).sum(), WEIGHT * lying * np.cos(SLOPE), rtol=2e-4)
    assert np.isclose(-forces[:, 0].sum(), tension, rtol=2e-4)
