"""Steps of ``simulate`` against dense f64 linear algebra on the equations of motion.

A rod in motion by dense f64 linear algebra: each implicit step solves the equations of motion over all unknowns at once.

With D u = (c0 u + c1 u1 + c2 u2)/h, u1 and u2 the values at the last two instants, the equations are, for every vertex i,

    m_i D(D x)_i + (d_i + e_i |w_i|) (D x)_i + ∂E/∂x_i = 0,   w = 2 v1 − v2 the speed extrapolated to the end of the step,

and in every joint, besides the elastic moments, τ B Dω of bending and likewise of twist; edges keep their lengths and clamps
hold what they hold. The unknowns are the translation of vertex 0 and the body rotations of all frames.
"""

from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from doo_ti import Dynamics, Grippers, MovingStart, Newton, Springs, Stepping, simulate
from doo_ti.dynamics import simulate as simulation
from doo_ti.rod.frames import quaternion_product, smallest_rotation
from doo_ti.rod.types import Clamp, Clamps, Configuration, Material, Status
from tests.oracle.algebra import body_rotated, directors, gradient_and_hessian
from tests.oracle.chain_form import assembled, linear_derivatives, rod_of
from tests.oracle.equilibrium import clamped_start, free_variables, moved, vertices_of
from tests.oracle.external import Springs as DenseSprings
from tests.oracle.external import total_derivatives, vertex_jacobian
from tests.oracle.pair import quadratic, seeded_pairs, strains
from tests.relaxation.rods import definite, wandering

GRAVITY = 9806.65
COEFFICIENTS = {"euler": (1.0, -1.0, 0.0), "bdf2": (1.5, -2.0, 0.5)}


class Instant(NamedTuple):
    """Positions (V, 3), velocities (V, 3) and frames (E, 4) of a rod at one time."""

    x: np.ndarray
    v: np.ndarray
    q: np.ndarray


def joint_strains(q: np.ndarray) -> np.ndarray:
    """(5, E − 1) ω^left, ω^right and m of the joints of frames (E, 4)."""
    left, right, turn = strains(list(q[:-1].T), list(q[1:].T))
    return np.array([*left, *right, turn])


def damping_derivatives(body, q: np.ndarray, previous: np.ndarray, rate: float) -> tuple[np.ndarray, np.ndarray]:
    """(3E,) gradient and (3E, 3E) Hessian of the potential of the damping moments, rate = c0/h; previous (5, E − 1) is where
    the strains' derivative in time is zero."""
    rod, y = body.rod, previous[:, :, None, None]
    left, right, turn = strains(*seeded_pairs(q[:-1], q[1:], body_rotated))
    length = (rod.rest_length[:-1] + rod.rest_length[1:])[:, None, None]
    bending = sum(quadratic(bend[:, None, None], [u[0] - at[0], u[1] - at[1]])
                  for bend, u, at in ((rod.bend[:-1], left, y[:2]), (rod.bend[1:], right, y[2:4])))
    twisting = (turn - y[4]) * (turn - y[4]) * rod.twist[:, None, None]
    energy = (bending * (0.5 * body.bend_damping) + twisting * body.twist_damping) * (rate / length)
    return assembled(*gradient_and_hessian(energy, (rod.edges - 1,), 6))


def step(body, last: Instant, before: Instant, clamps: Clamps, index: int, h: float, scheme: str) -> tuple:
    """(the rod a step after ``last``, force (3,) of the far clamp on it), its ends held by row ``index`` of ``clamps``."""
    rod, (c0, c1, c2) = body.rod, COEFFICIENTS[scheme]
    guess = Configuration(np.array([last.x[0]]), np.array([last.q]), rod.rest_length)
    state, ends = clamped_start(guess, clamps.take([index]), 0)
    free = free_variables(rod, ends)
    is_round = (rod.bend == rod.bend[0, 0, 0] * np.eye(2)).all() and not rod.rest_curvature.any()
    if is_round and Clamp.FRAME not in (ends.start, ends.end):
        free = free[free != 3]  # the spin about itself, which costs nothing
    drag = body.drag + body.drag_by_speed * np.linalg.norm(2.0 * last.v - before.v, axis=1)
    stiffness = body.mass * (c0 / h) ** 2 + drag * c0 / h + body.spring_stiffness
    damped_to = -(c1 * joint_strains(last.q) + c2 * joint_strains(before.q)) / c0
    force = np.zeros(3)
    for _ in range(60):
        x = vertices_of(rod, state)
        v = (c0 * x + c1 * last.x + c2 * before.x) / h
        pull = (body.mass[:, None] * (c0 * v + c1 * last.v + c2 * before.v) / h + drag[:, None] * v
                + body.load[:, None] * rod.up + body.spring_stiffness[:, None] * (x - body.spring_points))
        gradient, hessian = total_derivatives(rod, DenseSprings.at_vertices(stiffness, x - pull / stiffness[:, None]), state)
        damping = damping_derivatives(body, state.quaternions, damped_to, c0 / h)
        gradient[3:] += damping[0]
        hessian[3:, 3:] += damping[1]
        rows, miss = np.zeros((0, len(free))), np.zeros(0)
        if ends.end_position is not None:
            rows = vertex_jacobian(rod, state.quaternions)[-1][:, free]
            miss = x[-1] - ends.end_position
            hessian[3:, 3:] += linear_derivatives(rod, state.quaternions, force)[1]
        matrix = np.block([[hessian[np.ix_(free, free)], rows.T], [rows, np.zeros((len(miss),) * 2)]])
        # Unknowns in units of equal stiffness.
        unit = 1.0 / np.sqrt(np.maximum(np.abs(np.diag(matrix)), 1e-30))
        unit[len(free) :] = 1.0 / np.maximum(np.linalg.norm(rows * unit[: len(free)], axis=1), 1e-30)
        right = -np.append(gradient[free], miss)
        found = unit * np.linalg.solve(unit[:, None] * matrix * unit, unit * right)
        turn, force = found[: len(free)], found[len(free) :] if len(miss) else force
        largest = np.abs(turn[free >= 3]).max()
        state = moved(state, free, turn * min(1.0, 0.3 / max(largest, 1e-300)))
        if largest < 1e-13:
            break
    x = vertices_of(rod, state)
    return Instant(x, (c0 * x + c1 * last.x + c2 * before.x) / h, state.quaternions), -force


KINDS = (
    (Clamp.FRAME, Clamp.FREE), (Clamp.FRAME, Clamp.FRAME), (Clamp.FRAME, Clamp.TANGENT), (Clamp.POSITION, Clamp.FREE),
    (Clamp.FREE, Clamp.FREE), (Clamp.TANGENT, Clamp.POSITION), (Clamp.FREE, Clamp.FRAME))
UP = np.array([0.4, -0.5, 0.7])
EDGES, INSTANTS, RATE = 5, 4, 1000.0


def moving(rods, kinds, rng) -> Grippers:
    """Grippers that hold the ends of ``rods`` at the first instant, then go and turn at rates of their own."""
    times = np.arange(INSTANTS) / RATE
    x, frames = rods.vertices, rods.frames
    common = 100.0 * rng.normal(size=(rods.count, 3))
    approach = common - 3.0 * (x[:, -1] - x[:, 0]) + 10.0 * rng.normal(size=(rods.count, 3))
    ends = []
    for place, frame, speed in ((x[:, 0], frames[:, 0], common), (x[:, -1], frames[:, -1], approach)):
        turn = Rotation.from_rotvec((2.0 * rng.normal(size=(rods.count, 1, 3)) * times[:, None]).reshape(-1, 3)).as_matrix()
        ends.append((place[:, None] + speed[:, None] * times[:, None],
                     turn.reshape(rods.count, INSTANTS, 3, 3) @ frame[:, None]))
    start, end = np.array(kinds).T
    return Grippers(start, end, ends[0][0], ends[1][0], ends[0][1], ends[1][1])


def histories(rod, rods, grippers, velocity, row, acceleration, h) -> tuple[Instant, Instant]:
    """The rod at the first instant and a step before."""
    state, _ = clamped_start(rods, grippers.at(0), row)
    x, v = vertices_of(rod, state), velocity[row]
    earlier = x - h * v + 0.5 * h**2 * acceleration
    tangents = np.diff(earlier, axis=0)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    back = smallest_rotation(np.array(directors(state.quaternions.T)[0]).T, tangents)
    return Instant(x, v, state.quaternions), Instant(earlier, v - h * acceleration, quaternion_product(back, state.quaternions))


def dense_motion(rods, material, grippers, dynamics, velocity, springs, row, scheme, smooth):
    """((T − 1, V, 3) positions, (T − 1, 3) forces of the far clamp) of one rod."""
    rod, h, point = rod_of(rods, material, row, up=UP), 1.0 / RATE, dynamics.point_mass[row]  # mm of rod
    own = dynamics.density[row] / GRAVITY * rod.vertex_length
    # Of vertices: mass in energy s²/mm², drag in energy s/mm², drag_by_speed in energy s²/mm³; load, of point masses.
    body = SimpleNamespace(
        rod=rod, mass=own + 2.0 * dynamics.density[row] / GRAVITY * point, load=2.0 * rod.weight * point,
        drag=dynamics.drag[row] * own, drag_by_speed=dynamics.quadratic_drag[row] * own,
        bend_damping=dynamics.bend_damping[row], twist_damping=dynamics.twist_damping[row],
        spring_points=springs.points[row], spring_stiffness=springs.stiffness[row])
    acceleration = np.zeros((EDGES + 1, 3))
    if smooth:
        tried, _ = step(body, *histories(rod, rods, grippers, velocity, row, acceleration, h), grippers.at(1), row, h, "euler")
        acceleration = (tried.v - velocity[row]) / h
    last, before = histories(rod, rods, grippers, velocity, row, acceleration, h)
    found = []
    for k in range(1, INSTANTS):
        (last, force), before = step(body, last, before, grippers.at(k), row, h, scheme), last
        found.append((last.x, force))
    return tuple(np.array(values) for values in zip(*found, strict=True))


def random_rods(rng, general: bool):
    """A rod for each pair of KINDS under loads of all kinds; general rods are flat, damped and curved at rest."""
    total = len(KINDS)
    rods = wandering(rng, total, EDGES, rng.uniform(2, 5, EDGES), wander=0.25, twist=0.05)
    rods = type(rods)(rods.start, rods.quaternions, rods.rest_length[0])
    bend = definite(rng, total, EDGES, scale=600.0) if general else rng.uniform(300, 900, total)
    material = Material(bend, rng.uniform(300, 900, (total, EDGES - 1) if general else total), rng.uniform(0.5, 1.5, total),
                        0.02 * rng.normal(size=(total, EDGES - 1, 2)) if general else None)
    damping = rng.uniform(0.005, 0.03, (2, total)) * general
    dynamics = Dynamics(
        density=rng.uniform(0.5, 2.0, total), bend_damping=damping[0], twist_damping=damping[1], drag=rng.uniform(0, 5, total),
        quadratic_drag=rng.uniform(0, 0.02, total), point_mass=rng.uniform(0, 5, (total, EDGES + 1)))
    springs = Springs(rods.vertices + 2.0 * rng.normal(size=rods.vertices.shape), rng.uniform(0, 3, (total, EDGES + 1)))
    velocity = 50.0 * rng.normal(size=(total, 1, 3)) + 20.0 * rng.normal(size=rods.vertices.shape)
    return rods, material, moving(rods, KINDS, rng), dynamics, velocity, springs


@pytest.mark.thorough
@pytest.mark.parametrize("general, scheme, smooth", [(False, "bdf2", False), (True, "euler", True), (True, "bdf2", True)])
def test_steps_are_those_of_dense_linear_algebra(rng, monkeypatch, general, scheme, smooth):
    rods, material, grippers, dynamics, velocity, springs = random_rods(rng, general)

    def moved():
        return simulate(MovingStart(rods, velocity, smooth=smooth), material, grippers, dynamics, Stepping(RATE, scheme=scheme),
                        springs=springs, up=UP)

    usual = moved()
    monkeypatch.setattr(simulation, "_newton", lambda *_: Newton(tolerance=1e-10, first_shift=0.0, max_escapes=0))
    exact = moved()
    assert (usual.status == Status.CONVERGED).all() and (exact.status == Status.CONVERGED).all()
    apart = np.zeros((3, rods.count))
    for row in range(rods.count):
        expected, force = dense_motion(rods, material, grippers, dynamics, velocity, springs, row, scheme, smooth)
        apart[0, row], apart[1, row] = (np.abs(found.positions[row] - expected).max() / rods.rest_length.sum()
                                        for found in (usual, exact))
        if KINDS[row][1] != Clamp.FREE:
            apart[2, row] = np.abs(exact.end_force[row] - force).max() / np.abs(force).max()
    assert (apart.max(axis=1) < [1e-7, 1e-9, 1e-7]).all()
