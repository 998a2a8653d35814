"""A ribbon in a bend between two planes, which lies along both of them."""

import numpy as np
import pytest

from doo_ti import Clamp, Clamps, Material, Newton, Plane, relax
from tests.contact.elastica import along

BEND, RADIUS = 4e4, 1.0
# Stiff across the plane in which it buckles.
RIBBON = Material(BEND * np.diag([10.0, 1.0]), 10.0 * BEND, weight=1e-9)
FRAME = np.eye(3)[None]
BACK = np.diag([-1.0, 1.0, -1.0])[None]
EXACT = Newton(max_iterations=1000, gap_tolerance=1e-6)


def planes(height: float) -> list[Plane]:
    """Between them the rod's centreline has ``height`` to both sides."""
    return [Plane((0, 0, height + RADIUS), (0, 0, -1)), Plane((0, 0, -height - RADIUS), (0, 0, 1))]


DISTANCE, BEND_LENGTH = 40.0, 100.0
TWO_POINTS = 2.396280
"""Curvature at the middle times the distance, 2 ∫ √sin φ dφ over a quarter turn: the two-point bending of fibres."""


def bend_errors(edges: int, solver: Newton | None = None) -> tuple[float, float]:
    """Relative errors of the largest curvature and of the force on the upper plane. Both ends are held: with a free one the
    bend rolls along the planes at no cost, until that end has passed it."""
    half = 0.5 * DISTANCE
    inside = 0.97 * half
    leg = 0.5 * (BEND_LENGTH - np.pi * inside)
    angle = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 300)
    turn = np.stack([leg + inside * np.cos(angle), 0.0 * angle, inside * np.sin(angle)], -1)
    trace = np.concatenate([[[0.0, 0.0, -inside]], turn, [[0.0, 0.0, inside]]])
    begin = np.array([[0.0, 0.0, -half]])
    start = along(trace + [0.0, 0.0, inside - half], edges, BEND_LENGTH)
    clamps = Clamps(Clamp.FRAME, Clamp.FRAME, begin, begin * [1.0, 1.0, -1.0], FRAME, BACK)
    found = relax(start, RIBBON, clamps, solver, obstacles=planes(half), radius=RADIUS)
    assert found.converged.all() and found.stable.all()
    pushed = -np.minimum(found.contact_force[0, :, 2], 0.0).sum()
    force = 0.5 * BEND * (TWO_POINTS / DISTANCE) ** 2
    return found.configuration.curvature.max() * DISTANCE / TWO_POINTS - 1.0, pushed / force - 1.0


@pytest.mark.thorough
def test_a_bend_between_planes_has_the_curvature_and_force_of_two_point_bending():
    curvature, force = np.abs(bend_errors(160))
    # Legs that lie along the planes are stiff: what gaps are off by shows in the force.
    assert curvature < 1e-3 and force < 5e-3
    coarse, fine = (np.abs(bend_errors(edges, EXACT)) for edges in (80, 160))
    assert (fine < 1e-3).all()
    assert (coarse / fine > 3.0).all(), "second order in the length of an edge"
