"""A ribbon pressed between two planes: it buckles against one of them, or lies along both of them in a bend."""

import numpy as np
import pytest

from doo_ti import Clamp, Clamps, Material, Newton, Plane, relax
from tests.contact.elastica import ANGLE, X, Z, along, arc, solved

BEND, RADIUS = 4e4, 1.0
# Stiff across the plane in which it buckles.
RIBBON = Material(BEND * np.diag([10.0, 1.0]), 10.0 * BEND, weight=1e-9)
FRAME = np.eye(3)[None]
BACK = np.diag([-1.0, 1.0, -1.0])[None]
EXACT = Newton(max_iterations=1000, gap_tolerance=1e-6)


def planes(height: float) -> list[Plane]:
    """Between them the rod's centreline has ``height`` to both sides."""
    return [Plane((0, 0, height + RADIUS), (0, 0, -1)), Plane((0, 0, -height - RADIUS), (0, 0, 1))]


# --- both ends held: it touches one plane at a point ---

LENGTH, HEIGHT = 200.0, 20.0
SYMMETRIC, BESIDE = (5.25, (0.008, -60.0, -4.0, 97.0, 4.0)), (7.5, (0.008, -111.0, -20.0, 80.0, 10.0))
"""By how much the ends approach, and roughly the curvature at the start, the force before the contact, the length to there, and
the lift after it: at the middle, and beside it where that has become unstable."""


def buckled(span: float, length: float, first: tuple):
    """(the unknowns of ``first``, place at an arc length) of the elastica from clamp to clamp through its contact."""
    def parts(curvature, thrust, lift, contact, lift_after):
        before = arc(BEND, 0.0, curvature, (thrust, lift), contact)
        touching = before(contact)
        return before, touching, arc(BEND, 0.0, touching[1], (thrust, lift_after), length - contact)

    def miss(unknowns):
        _, touching, after = parts(*unknowns)
        end = after(length - unknowns[3])
        return [10 * touching[ANGLE], touching[Z] - HEIGHT, 10 * end[ANGLE], end[Z] + HEIGHT, touching[X] + end[X] - span]

    unknowns = solved(miss, first)
    before, touching, after = parts(*unknowns)
    contact = unknowns[3]

    def place(s):
        beyond = touching[X:, None] + after(np.clip(s - contact, 0.0, length - contact))[X:]
        return np.where(s <= contact, before(np.clip(s, 0.0, contact))[X:], beyond)

    return unknowns, place


def trapezoid(span: float) -> np.ndarray:
    """(N, 3) a bow of the length of the rod that stays below the plane."""
    share = np.linspace(0.0, 1.0, 2000)

    def trace(height):
        z = np.minimum(0.5 * height * (1.0 - np.cos(2 * np.pi * share)), 0.97 * HEIGHT)
        return np.stack([share * span, 0.0 * share, z], -1)

    low, high = 0.5 * HEIGHT, 3.0 * HEIGHT
    for _ in range(60):
        middle = 0.5 * (low + high)
        short = np.linalg.norm(np.diff(trace(middle), axis=0), axis=1).sum() < LENGTH
        low, high = (middle, high) if short else (low, middle)
    return trace(low)


def errors(case: tuple, edges: int) -> tuple[float, float, float]:
    """Relative errors of the thrust and of the contact force, and that of the shape over the height."""
    shorter, first = case
    start = along(trapezoid(LENGTH - shorter), edges, LENGTH)
    clamps = Clamps(Clamp.FRAME, Clamp.FRAME, np.zeros((1, 3)), np.array([[LENGTH - shorter, 0.0, 0.0]]), FRAME, FRAME)
    found = relax(start, RIBBON, clamps, obstacles=planes(HEIGHT), radius=RADIUS)
    assert found.converged.all() and found.stable.all()
    edge = LENGTH / edges
    held = 0.5 * edge  # the clamp of a discrete rod is the middle of the edge that it holds
    (_, thrust, lift, _, lift_after), place = buckled(LENGTH - shorter - edge, LENGTH - edge, first)
    x, s = found.configuration.vertices[0, 1:-1], edge * np.arange(1, edges) - held
    # Where it touches on the far side of its middle, it is the mirror image.
    both = x[:, [0, 2]], (np.array([LENGTH - shorter, 0.0]) + x[:, [0, 2]] * [-1.0, 1.0])[::-1]
    off = min((np.hypot(*(one.T - place(s) - [[held], [0.0]])) for one in both), key=np.max)
    pushed = found.contact_force[0, :, 2].sum()
    return found.end_force[0, 0] / thrust - 1.0, pushed / (lift - lift_after) - 1.0, off.max() / HEIGHT


@pytest.mark.thorough
def test_pressed_against_a_plane_it_touches_at_its_middle():
    coarse, fine = (np.abs(errors(SYMMETRIC, edges)) for edges in (80, 160))
    assert (fine < 5e-3).all()
    assert (coarse / fine > 3.5).all(), "second order in the length of an edge"


@pytest.mark.thorough
def test_pressed_more_it_touches_beside_its_middle():
    """The vertices that touch are up to an edge beside the contact of a smooth rod."""
    thrust, _, shape = np.abs(errors(BESIDE, 160))
    assert thrust < 5e-3 and shape < 5e-3


# --- a bend between both planes, which lies along them ---

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
