"""PyElastica: a Cosserat rod, explicit in time, damped until it rests. Its outer two vertices at each end are held.

Only EI over weight matters, so that the rod's thickness is free: steps of a thick rod may be longer, but it shears and
stretches more.
"""

import time

import numpy as np

from doo_ti.dynamics.parameters import GRAVITY
from tools.studies.peers.flex import DENSITY, HELD, MOST_SECONDS, STILL
from tools.studies.peers.problem import BEND, EDGES, LENGTH, Problem

DAMPING = 50.0  # 1/s, of all velocities: with 20 and with 100 the rods rest later
STABLE = 0.5
"""The step, over the time in which a wave of stretch crosses an edge, or a wave of shear the radius; with 1 it diverges."""
CHECKED = 200  # steps between two looks at the speed
LEAST_SECONDS = 0.05  # simulated, before a rod may be said to rest
COMPILING = 3  # steps before the time is taken


def settled(problem: Problem, radius: float) -> tuple[np.ndarray, float, float]:
    """(R, V, 3) mm at rest, processor seconds for each rod, and the speed that is left, m/s. Raises ImportError where
    PyElastica is absent.

    radius  of the rod, m
    """
    import elastica

    class Simulator(elastica.BaseSystemCollection, elastica.Constraints, elastica.Forcing, elastica.Damping):
        pass

    area = np.pi * radius**2
    young = BEND * DENSITY * area * GRAVITY * 1e-3 / 2e9 / (np.pi * radius**4 / 4)
    wave, edge = np.sqrt(young / DENSITY), LENGTH * 1e-3 / EDGES
    step = np.float64(STABLE * min(edge / wave, radius / (wave / np.sqrt(3.0))))  # of shear: G = E/3
    shapes, taken, left = [], [], []
    stepper = elastica.PositionVerlet()
    for start, frames in zip(problem.start.vertices, problem.start.frames, strict=True):
        directors = np.ascontiguousarray(frames[:, :, [1, 2, 0]].transpose(2, 1, 0))  # rows m1, m2, t of every edge
        rod = elastica.CosseratRod.straight_rod(EDGES, 1e-3 * start[0], frames[0, :, 0], frames[0, :, 1], LENGTH * 1e-3, radius,
                                                DENSITY, youngs_modulus=young, position=1e-3 * start.T.copy(),
                                                directors=directors)
        simulator = Simulator()
        simulator.append(rod)
        simulator.constrain(rod).using(elastica.FixedConstraint, constrained_position_idx=HELD)
        simulator.add_forcing_to(rod).using(elastica.GravityForces, acc_gravity=np.array([0.0, 0.0, -GRAVITY * 1e-3]))
        simulator.dampen(rod).using(elastica.AnalyticalLinearDamper, uniform_damping_constant=DAMPING, time_step=step)
        simulator.finalize()
        now = np.float64(0.0)
        for _ in range(COMPILING):
            now = stepper.step(simulator, now, step)
        began = time.process_time()
        while now < MOST_SECONDS:
            for _ in range(CHECKED):
                now = stepper.step(simulator, now, step)
            speed = np.abs(rod.velocity_collection).max()
            if speed < STILL and now > LEAST_SECONDS or not np.isfinite(speed):
                break
        taken.append(time.process_time() - began)
        left.append(speed)
        shapes.append(1e3 * rod.position_collection.T)
    return np.array(shapes), float(np.mean(taken)), float(max(left))
