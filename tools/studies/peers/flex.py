"""MuJoCo: a 1-D flex, damped until it rests. Its outer two vertices at each end are held by equality constraints."""

import resource

import numpy as np

from doo_ti.dynamics.parameters import GRAVITY
from tools.studies.peers.problem import BEND, EDGES, LENGTH, Problem

RADIUS, DENSITY = 0.0005, 1000.0  # m, kg/m³: only EI over weight matters
HELD = (0, 1, EDGES - 1, EDGES)
"""Vertices: position and tangent of both ends."""
STILL = 1e-5
"""m/s: the fastest vertex of a rod at rest."""
MOST_SECONDS = 20.0
"""Simulated."""


IMPEDANCE = "0.9999 0.9999 0.0001"
"""Of all constraints: the largest that MuJoCo accepts. With 0.99 edges stretch by 2 %."""
DAMPING = 0.01
"""Of the elasticity; it has little effect on the time to rest."""


def model(step: float) -> str:
    weight = DENSITY * np.pi * RADIUS**2 * GRAVITY * 1e-3  # N/m
    young = BEND * weight / 2e9 / (np.pi * RADIUS**4 / 4)
    mass = DENSITY * np.pi * RADIUS**2 * LENGTH * 1e-3
    held = "".join(f'<connect name="hold{k}" body1="rod_{k}" body2="world" anchor="0 0 0" solref="{2 * step} 1" '
                   f'solimp="{IMPEDANCE}"/>' for k in HELD)
    return f"""<mujoco>
<option timestep="{step}" integrator="discrete" gravity="0 0 {-GRAVITY * 1e-3}"><flag contact="disable"/></option>
<worldbody><flexcomp name="rod" type="grid" count="{EDGES + 1} 1 1" spacing="{LENGTH * 1e-3 / EDGES} 1 1" dim="1"
radius="{RADIUS}" mass="{mass}" dof="full"><edge equality="true" damping="0" solref="{2 * step} 1" solimp="{IMPEDANCE}"/>
<elasticity young="{young}" poisson="0" damping="{DAMPING}"/></flexcomp></worldbody><equality>{held}</equality></mujoco>"""


def settled(problem: Problem, step: float) -> tuple[np.ndarray, float, float]:
    """(R, V, 3) mm at rest, processor seconds for each rod, and the speed that is left, m/s. Raises ImportError where MuJoCo is
    absent."""
    import mujoco

    shapes, taken, left = [], [], []
    for start in problem.start.vertices:
        system = mujoco.MjModel.from_xml_string(model(step))
        data = mujoco.MjData(system)
        mujoco.mj_forward(system, data)
        straight = data.flexvert_xpos.reshape(-1, 3).copy()
        data.qpos[: straight.size] = (1e-3 * start - straight).ravel()  # behind them the roll of each edge
        for vertex in HELD:
            system.eq_data[system.equality(f"hold{vertex}").id, 3:6] = 1e-3 * start[vertex]
        before = resource.getrusage(resource.RUSAGE_SELF)
        for count in range(round(MOST_SECONDS / step)):
            mujoco.mj_step(system, data)
            if count % 50 == 49 and np.abs(data.qvel).max() < STILL:
                break
        after = resource.getrusage(resource.RUSAGE_SELF)
        taken.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
        left.append(np.abs(data.qvel).max())
        shapes.append(1e3 * data.flexvert_xpos.reshape(-1, 3))
    return np.array(shapes), float(np.mean(taken)), float(max(left))
