"""A rod drawn over a sphere, and one through a ring: on its arc it is pressed with T/R, beyond it is an elastica."""

import numpy as np
import pytest

from doo_ti import Clamp, Clamps, Material, Newton, Ring, Sphere, Springs, relax
from tests.contact.elastica import CURVATURE, X, along, arc, solved

BEND, RADIUS, ROUND, HALF_ANGLE, TENSION, FREE = 4e4, 1.0, 30.0, np.deg2rad(18.0), 900.0, 20.0
ARC = ROUND + RADIUS
HALF = ARC * HALF_ANGLE + FREE
FAR = 1e4


def reference():
    """(force at the right end, place at an arc length from the middle) of a rod on a circle through both half angles, and then
    an elastica to an end without moment."""
    tangent = np.array([np.cos(HALF_ANGLE), -np.sin(HALF_ANGLE)])
    outward = np.array([np.sin(HALF_ANGLE), np.cos(HALF_ANGLE)])

    def beyond(press):
        return arc(BEND, -HALF_ANGLE, -1.0 / ARC, TENSION * tangent - press * outward, FREE)

    press = solved(lambda press: [1e3 * beyond(press[0])(FREE)[CURVATURE]], [np.sqrt(TENSION * BEND) / ARC])[0]
    shape = beyond(press)

    def place(s):
        angle = np.clip(np.abs(s), 0.0, ARC * HALF_ANGLE) / ARC
        free = shape(np.clip(np.abs(s) - ARC * HALF_ANGLE, 0.0, FREE))[X:]
        x, z = ARC * np.array([np.sin(angle), np.cos(angle)]) + free
        return np.stack([np.sign(s) * x, 0.0 * s, z], -1)

    return TENSION * tangent - press * outward, place


def errors(obstacle, edges: int, solver: Newton | None = None) -> tuple[float, float, float]:
    """Of the shape over the length, and relative ones of the whole force and of the force per length on the arc."""
    force, place = reference()
    pull = np.linalg.norm(force)
    s = np.linspace(-HALF, HALF, edges + 1)
    exact = place(s)
    # A soft spring from far away draws the right end, with a force that hardly changes.
    points, stiffness = np.zeros((1, edges + 1, 3)), np.zeros((1, edges + 1))
    points[0, -1] = exact[-1] + FAR / pull * np.array([force[0], 0.0, force[1]])
    stiffness[0, -1] = pull / FAR
    start = along(place(np.linspace(-HALF, HALF, 4001)) * (1.0 + 6.0 * (HALF / edges / ARC) ** 2), edges, 2 * HALF)
    frame = np.eye(3)[None]
    clamps = Clamps(Clamp.POSITION, Clamp.FREE, exact[:1], exact[-1:], frame, frame)
    found = relax(start, Material(BEND, BEND, weight=1e-9), clamps, solver, obstacles=[obstacle], radius=RADIUS,
                  external=Springs(points, stiffness))
    assert found.converged.all() and found.stable.all()
    pushed = found.contact_force[0]
    middle = np.linalg.norm(pushed[np.abs(s) < 0.4 * ARC * HALF_ANGLE], axis=1).mean() * edges / (2 * HALF)
    return (np.linalg.norm(found.configuration.vertices[0] - exact, axis=1).max() / (2 * HALF),
            np.linalg.norm(pushed.sum(axis=0) / (-2 * force[1]) - [0.0, 0.0, 1.0]), abs(middle * ARC / TENSION - 1.0))


@pytest.mark.thorough
@pytest.mark.parametrize("obstacle", [Sphere((0, 0, 0), ROUND), Ring((0, 0, 4 * ROUND), (1, 0, 0), 4 * ROUND, ROUND)],
                         ids=("sphere", "ring"))
def test_the_shape_and_the_forces_are_those_of_an_elastica(obstacle):
    assert (np.array(errors(obstacle, 160)) < [1e-4, 1e-3, 5e-3]).all()
    exact = Newton(max_iterations=1000, gap_tolerance=1e-6)  # the usual tolerance shows in shapes that are so exact
    coarse, fine = (np.array(errors(obstacle, edges, exact)) for edges in (40, 160))
    assert (coarse[:2] / fine[:2] > 9.0).all(), "nearly second order in the length of an edge"
