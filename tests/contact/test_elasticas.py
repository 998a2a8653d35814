"""Rods on obstacles against smooth ones by shooting."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import fsolve

from doo_ti import Clamp, Clamps, Configuration, Material, Newton, Plane, Ring, Sphere, Springs, end_clamps, relax, straight_rod
from doo_ti.rod.shapes import rod_along
from tests.references.rods import certified

ANGLE, CURVATURE, X, Z = range(4)
BEND, LENGTH, RADIUS, FRAME = 4e4, 200.0, 1.0, np.eye(3)[None]
WEIGHT = 2.0  # per mm, of a material of weight 1
EXACT = Newton(max_iterations=1000, gap_tolerance=1e-7)  # the usual tolerance shows in shapes that are so exact


def arc(angle: float, curvature: float, force, length: float, weight: float = 0.0):
    """The solution (θ, κ, x, z) over arc length from the origin of B θ″ = n_x sin θ − (n_z + w s) cos θ, ``force`` n being what
    the part beyond exerts on the part before."""
    def slope(s, y):
        moment = force[0] * np.sin(y[0]) - (force[1] + weight * s) * np.cos(y[0])
        return [y[1], moment / BEND, np.cos(y[0]), np.sin(y[0])]
    return solve_ivp(slope, (0.0, length), [angle, curvature, 0.0, 0.0], rtol=1e-11, atol=1e-12, dense_output=True).sol


def solved(miss, first) -> np.ndarray:
    found, _, good, text = fsolve(miss, first, xtol=1e-12, full_output=True)
    assert good == 1 or np.abs(miss(found)).max() < 1e-9, text
    return found


def along(trace: np.ndarray, edges: int, length: float) -> Configuration:
    """A rod of equal edges, without twist, along a trace (N, 3) of about that length."""
    return replace(rod_along(trace, edges), rest_length=np.full(edges, length / edges))


HEIGHT = 25.0


def heavy_elastica() -> tuple[float, object]:
    """(free length, shape over arc length from lift-off) of the heavy elastica: where it lifts off, θ and the moment B θ′ are
    zero, and at the clamp θ is zero again."""
    def shape(length, reaction):
        return arc(0.0, 0.0, (0.0, -reaction), length, WEIGHT)

    def miss(unknowns):
        end = shape(*unknowns)(unknowns[0])
        return [end[ANGLE] * 100.0, end[Z] - (HEIGHT - RADIUS)]

    first = (72.0 * BEND * (HEIGHT - RADIUS) / WEIGHT) ** 0.25
    found = solved(miss, [first, WEIGHT * first / 3.0])
    return found[0], shape(*found)


def errors_on_table(edges: int) -> tuple[float, float]:
    """(relative error of the free length, largest error of the height over the clamp's) with so many edges."""
    start = straight_rod(LENGTH, edges, (0.0, 0.0, HEIGHT))
    table = Plane((0, 0, 0), (0, 0, 1))
    solution = certified(relax(start, Material(BEND, BEND), end_clamps(start), obstacles=[table], radius=RADIUS))
    height, force = solution.configuration.vertices[0, :, 2], solution.contact_force[0, :, 2]
    held = LENGTH / edges / 2  # the clamp of a discrete rod is the middle of the edge that it holds
    free, shape = heavy_elastica()
    # The length that lies from the sum of the forces and their moment about the free end.
    place = np.linspace(0.0, LENGTH, edges + 1)
    whole, moment = force.sum(), (force * (LENGTH - place)).sum()
    lying = (whole - np.sqrt(whole**2 - 2.0 * WEIGHT * moment)) / WEIGHT
    s = free + held - place
    exact = np.where(s > 0, shape(np.clip(s, 0, free))[Z], 0.0) + RADIUS
    return (LENGTH - held - lying) / free - 1.0, np.abs(height - exact)[place > held].max() / HEIGHT


def test_lift_off_and_shape_of_a_heavy_rod_on_a_table():
    coarse, fine = errors_on_table(40), errors_on_table(80)
    assert np.abs(fine).max() < 2e-3 and coarse[1] / fine[1] > 3.5, "second order in the length of an edge"


SLOPE = np.deg2rad(20.0)
UPHILL, NORMAL = np.array([np.cos(SLOPE), 0.0, np.sin(SLOPE)]), np.array([-np.sin(SLOPE), 0.0, np.cos(SLOPE)])
HELD = np.array([0.0, 0.0, 60.0])


def test_at_rest_on_a_smooth_slope():
    """A limp rope, from a little above where it lies: shape, load on the slope and tension. Where it lifts off, its tension is
    w a sin α, with a the length that lies, and its direction that of the slope."""
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

    clamps = Clamps(Clamp.FREE, Clamp.POSITION, np.zeros((1, 3)), HELD[None], FRAME, FRAME)
    start = along(place(np.linspace(0.0, LENGTH, 4001)) + 0.2 * NORMAL, 50, LENGTH)
    found = certified(relax(start, Material(5.0, 5.0), clamps, obstacles=[Plane(-RADIUS * NORMAL, NORMAL)], radius=RADIUS))
    apart = found.configuration.vertices[0] - place(np.linspace(0.0, LENGTH, 51))
    assert np.linalg.norm(apart, axis=1).max() < 1e-4 * LENGTH
    force = found.contact_force[0].sum(axis=0)
    np.testing.assert_allclose([force @ NORMAL, -force[0]], [WEIGHT * lying * np.cos(SLOPE), c * WEIGHT], rtol=2e-4)


RIBBON = Material(BEND * np.diag([10.0, 1.0]), 10.0 * BEND, weight=1e-9)  # stiff across the plane in which it buckles
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
    planes = [Plane((0, 0, side * (half + RADIUS)), (0, 0, -side)) for side in (1, -1)]
    clamps = Clamps(Clamp.FRAME, Clamp.FRAME, begin, begin * [1.0, 1.0, -1.0], FRAME, np.diag([-1.0, 1.0, -1.0])[None])
    found = certified(relax(start, RIBBON, clamps, solver, obstacles=planes, radius=RADIUS))
    pushed = -np.minimum(found.contact_force[0, :, 2], 0.0).sum()
    force = 0.5 * BEND * (TWO_POINTS / DISTANCE) ** 2
    return found.configuration.curvature.max() * DISTANCE / TWO_POINTS - 1.0, pushed / force - 1.0


@pytest.mark.thorough
def test_a_bend_between_planes_has_the_curvature_and_force_of_two_point_bending():
    curvature, force = np.abs(bend_errors(160))
    # Legs that lie along the planes are stiff: what gaps are off by shows in the force.
    assert curvature < 1e-3 and force < 5e-3
    coarse, fine = (np.abs(bend_errors(edges, EXACT)) for edges in (80, 160))
    assert (fine < 1e-3).all() and (coarse / fine > 3.0).all(), "second order in the length of an edge"


# --- a rod over a sphere or through a ring: on its arc it is pressed with T/R, beyond it is an elastica ---

ROUND, HALF_ANGLE, TENSION, FREE = 30.0, np.deg2rad(18.0), 900.0, 20.0
ARC = ROUND + RADIUS
HALF = ARC * HALF_ANGLE + FREE
FAR = 1e4


def drawn_reference():
    """(force at the right end, place at an arc length from the middle) of a rod on a circle through both half angles, and then
    an elastica to an end without moment."""
    tangent = np.array([np.cos(HALF_ANGLE), -np.sin(HALF_ANGLE)])
    outward = np.array([np.sin(HALF_ANGLE), np.cos(HALF_ANGLE)])

    def beyond(press):
        return arc(-HALF_ANGLE, -1.0 / ARC, TENSION * tangent - press * outward, FREE)

    press = solved(lambda press: [1e3 * beyond(press[0])(FREE)[CURVATURE]], [np.sqrt(TENSION * BEND) / ARC])[0]
    shape = beyond(press)

    def place(s):
        angle = np.clip(np.abs(s), 0.0, ARC * HALF_ANGLE) / ARC
        free = shape(np.clip(np.abs(s) - ARC * HALF_ANGLE, 0.0, FREE))[X:]
        x, z = ARC * np.array([np.sin(angle), np.cos(angle)]) + free
        return np.stack([np.sign(s) * x, 0.0 * s, z], -1)

    return TENSION * tangent - press * outward, place


def drawn_errors(obstacle, edges: int, solver: Newton | None = None) -> tuple[float, float, float]:
    """Of the shape over the length, and relative ones of the whole force and of the force per length on the arc."""
    force, place = drawn_reference()
    pull = np.linalg.norm(force)
    s = np.linspace(-HALF, HALF, edges + 1)
    exact = place(s)
    # A soft spring from far away draws the right end, with a force that hardly changes.
    points, stiffness = np.zeros((1, edges + 1, 3)), np.zeros((1, edges + 1))
    points[0, -1] = exact[-1] + FAR / pull * np.array([force[0], 0.0, force[1]])
    stiffness[0, -1] = pull / FAR
    start = along(place(np.linspace(-HALF, HALF, 4001)) * (1.0 + 6.0 * (HALF / edges / ARC) ** 2), edges, 2 * HALF)
    clamps = Clamps(Clamp.POSITION, Clamp.FREE, exact[:1], exact[-1:], FRAME, FRAME)
    found = certified(relax(start, Material(BEND, BEND, weight=1e-9), clamps, solver, obstacles=[obstacle], radius=RADIUS,
                            external=Springs(points, stiffness)))
    pushed = found.contact_force[0]
    middle = np.linalg.norm(pushed[np.abs(s) < 0.4 * ARC * HALF_ANGLE], axis=1).mean() * edges / (2 * HALF)
    return (np.linalg.norm(found.configuration.vertices[0] - exact, axis=1).max() / (2 * HALF),
            np.linalg.norm(pushed.sum(axis=0) / (-2 * force[1]) - [0.0, 0.0, 1.0]), abs(middle * ARC / TENSION - 1.0))


@pytest.mark.thorough
@pytest.mark.parametrize("obstacle", [Sphere((0, 0, 0), ROUND), Ring((0, 0, 4 * ROUND), (1, 0, 0), 4 * ROUND, ROUND)],
                         ids=("sphere", "ring"))
def test_the_shape_and_the_forces_are_those_of_an_elastica(obstacle):
    assert (np.array(drawn_errors(obstacle, 160)) < [1e-4, 1e-3, 5e-3]).all()
    coarse, fine = (np.array(drawn_errors(obstacle, edges, EXACT)) for edges in (40, 160))
    assert (coarse[:2] / fine[:2] > 9.0).all(), "nearly second order in the length of an edge"
