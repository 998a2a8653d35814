"""Steps of ``simulate`` against dense f64 linear algebra on the equations of motion."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from doo_ti import Clamp, Dynamics, Grippers, Material, MovingStart, Newton, Springs, Status, Stepping, simulate
from doo_ti.dynamics import simulate as simulation
from doo_ti.rod.frames import quaternion_product, smallest_rotation
from tests.dynamics.dense import Body, Instant, step
from tests.oracle.algebra import directors
from tests.oracle.chain_form import rod_of
from tests.oracle.equilibrium import clamped_start, vertices_of
from tests.relaxation.rods import wandering

KINDS = (
    (Clamp.FRAME, Clamp.FREE), (Clamp.FRAME, Clamp.FRAME), (Clamp.FRAME, Clamp.TANGENT), (Clamp.POSITION, Clamp.FREE),
    (Clamp.FREE, Clamp.FREE), (Clamp.TANGENT, Clamp.POSITION), (Clamp.FREE, Clamp.FRAME))
UP = np.array([0.4, -0.5, 0.7])
EDGES, INSTANTS, RATE = 5, 4, 1000.0


def flattened(rng, count: int) -> np.ndarray:
    """(count, EDGES, 2, 2) symmetric B, stiffer in one direction."""
    slant = rng.uniform(-80, 80, (count, EDGES, 1, 1)) * (1.0 - np.eye(2))
    return slant + rng.uniform(400, 800, (count, EDGES, 2, 1)) * np.eye(2)


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
    return Instant(x, v, state.quaternions), Instant(
        earlier, v - h * acceleration, quaternion_product(back, state.quaternions))


def dense_motion(rods, material, grippers, dynamics, velocity, springs, row, scheme, smooth):
    """((T − 1, V, 3) positions, (T − 1, 3) forces of the far clamp) of one rod."""
    rod, h = rod_of(rods, material, row, up=UP), 1.0 / RATE
    numbers = (dynamics.drag, dynamics.quadratic_drag, dynamics.bend_damping, dynamics.twist_damping)
    body = Body.of(rod, dynamics.density[row], dynamics.point_mass[row], *(value[row] for value in numbers),
                   springs.points[row], springs.stiffness[row])
    acceleration = np.zeros((EDGES + 1, 3))
    if smooth:
        tried, _ = step(body, *histories(rod, rods, grippers, velocity, row, acceleration, h), grippers.at(1), row, h, "euler")
        acceleration = (tried.v - velocity[row]) / h
    last, before = histories(rod, rods, grippers, velocity, row, acceleration, h)
    positions, forces = [], []
    for k in range(1, INSTANTS):
        following, force = step(body, last, before, grippers.at(k), row, h, scheme)
        last, before = following, last
        positions.append(last.x)
        forces.append(force)
    return np.array(positions), np.array(forces)


def random_rods(rng, general: bool):
    """A rod for each pair of KINDS, moving clamps, drag, point masses and springs; general rods are flat, damped and curved at
    rest."""
    total = len(KINDS)
    rods = wandering(rng, total, EDGES, rng.uniform(2, 5, EDGES), wander=0.25, twist=0.05)
    rods = type(rods)(rods.start, rods.quaternions, rods.rest_length[0])
    if general:
        material = Material(flattened(rng, total), rng.uniform(300, 900, (total, EDGES - 1)),
                            rng.uniform(0.5, 1.5, total), 0.02 * rng.normal(size=(total, EDGES - 1, 2)))
    else:
        material = Material(rng.uniform(300, 900, total), rng.uniform(300, 900, total), rng.uniform(0.5, 1.5, total))
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
    print("positions off by {:.1e} of the length, converged further {:.1e}, forces {:.1e}".format(*apart.max(axis=1)))
    assert apart[0].max() < 1e-7
    assert apart[1].max() < 1e-9
    assert apart[2].max() < 1e-7
