"""Newton: rods of capsules with joints that stretch, shear, bend and twist, by Vertex Block Descent in f32, damped until they
rest. The outer edge at each end is a body without motion.

All rods are in one model. Lengths are ten times those of the problem: of real size the inertia of an edge is too small for f32.
Stretch and shear are softer than a solid section's, by as much as makes iterations converge: an edge changes by 1 % at most.
"""

import time

import numpy as np

from doo_ti.dynamics.parameters import GRAVITY
from doo_ti.rod.frames import quaternion_from_matrix
from tools.studies.peers.flex import DENSITY, RADIUS
from tools.studies.peers.problem import BEND, EDGES, LENGTH, Problem

SCALE = 10.0
EDGE, THICK = SCALE * LENGTH * 1e-3 / EDGES, SCALE * RADIUS  # m: length and radius of an edge
SOFTER = 0.03  # of stretch and shear
DAMPING = 0.02  # s: damping of bending over its stiffness
ITERATIONS = 20
STILL = 1e-4  # m/s: the fastest edge of a rod at rest. Rounding leaves 0.00005
MOST_SECONDS = 5.0  # simulated
CHECKED, COMPILING = 20, 2


def settled(problem: Problem, step: float) -> tuple[np.ndarray, float, float]:
    """(R, V, 3) mm at rest, processor seconds for each rod, and the speed that is left, m/s, both of the rods of the problem's
    size. Raises ImportError where Newton is absent.

    step  s, of the larger rods
    """
    import warp

    warp.config.quiet = True  # it reports on standard output
    import newton

    builder = newton.ModelBuilder(up_axis=newton.Axis.Z, gravity=(0.0, 0.0, -GRAVITY * 1e-3))
    bodies = [_added(newton, builder, problem, row) for row in range(problem.start.count)]
    builder.color()
    model = builder.finalize(device="cpu")
    solver = newton.solvers.SolverVBD(model, iterations=ITERATIONS)
    states, control, now = [model.state(), model.state()], model.control(), 0.0

    def stepped(count: int) -> None:
        for _ in range(count):
            solver.step(*states, control, None, step)
            states.reverse()

    stepped(COMPILING)
    began = time.process_time()
    while now < MOST_SECONDS:
        stepped(CHECKED)
        now += CHECKED * step
        speed = np.abs(states[0].body_qd.numpy()[:, :3]).max()
        if not speed >= STILL:
            break
    taken = time.process_time() - began
    poses = states[0].body_q.numpy()
    return np.array([_vertices(poses[rows]) for rows in bodies]), taken / len(bodies), float(speed / np.sqrt(SCALE))


def _added(newton, builder, problem: Problem, row: int) -> list[int]:
    """The bodies of one rod, put into the model."""
    frames = problem.start.frames[row].copy()
    frames[0], frames[-1] = problem.clamps.start_frame[row], problem.clamps.end_frame[row]  # a whole turn less, and no twist
    area = np.pi * THICK**2
    bend = BEND * SCALE**3 * DENSITY * area * GRAVITY * 1e-3 / 2e9  # N m²
    stretch = SOFTER * 4 * bend / THICK**2
    rod = newton.Rod(SCALE * 1e-3 * problem.start.vertices[row], rest_straight=True, radius=THICK, stretch_rigidity=stretch,
                     quaternions=np.roll(quaternion_from_matrix(frames[:, :, [1, 2, 0]]), -1, axis=1),  # t is their third axis
                     shear_rigidity=stretch / 3, bend_rigidity=bend, twist_rigidity=bend)
    loose = newton.ModelBuilder.ShapeConfig(density=DENSITY, has_shape_collision=False, has_particle_collision=False)
    damping = DAMPING * bend / EDGE
    bodies, _ = builder.add_rod(rod=rod, cfg=loose, bend_damping=damping, twist_damping=damping)
    mass = DENSITY * area * EDGE
    for body in bodies:  # the capsules' own mass counts their round ends, which overlap
        builder.body_inertia[body] *= mass / builder.body_mass[body]
        builder.body_inv_inertia[body] *= builder.body_mass[body] / mass
        builder.body_mass[body], builder.body_inv_mass[body] = mass, 1.0 / mass
    for body in (bodies[0], bodies[-1]):
        builder.body_mass[body] = builder.body_inv_mass[body] = 0.0
        builder.body_inertia[body] *= 0.0
        builder.body_inv_inertia[body] *= 0.0
    return bodies


def _vertices(poses: np.ndarray) -> np.ndarray:
    """(V, 3) mm from poses (E, 7) of the edges' centres: in the middle between the ends of neighbours, which joints hold
    together."""
    x, y, z, w = poses[:, 3:].T
    half = 0.5 * EDGE * np.stack([2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x**2 + y**2)], axis=-1)
    first, last = poses[:, :3] - half, poses[:, :3] + half
    return 1e3 / SCALE * np.concatenate([first[:1], 0.5 * (last[:-1] + first[1:]), last[-1:]])
