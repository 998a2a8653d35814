"""MuJoCo: a 1-D flex, damped until it rests. Its outer two vertices at each end are held by equality constraints."""

import time

import numpy as np

from doo_ti.dynamics.parameters import GRAVITY
from tools.studies.peers.problem import BEND, EDGES, LENGTH, Problem

RADIUS, DENSITY = 0.0005, 1000.0  # m, kg/m³: only EI over weight matters
HELD = (0, 1, EDGES - 1, EDGES)  # vertices: position and tangent of both ends
STILL = 1e-5  # m/s: the fastest vertex of a rod at rest
MOST_SECONDS = 20.0  # simulated
IMPEDANCE = "0.9999 0.9999 0.0001"  # of all constraints: the largest that MuJoCo accepts. With 0.99 edges stretch by 2 %
DAMPING = 0.01  # of the elasticity; it has little effect on the time to rest


def model(step: float, length: float, edges: int, bend: float, radius: float, impedance: str, damping: float, pinned: str = "",
          equality: str = "") -> str:
    """MuJoCo's model of a rod of ``length`` mm, ``bend`` mm³ and ``radius`` m, in steps of ``step`` s; ``damping`` is that of
    the elasticity, ``pinned`` and ``equality`` are elements that hold vertices."""
    weight = DENSITY * np.pi * radius**2 * GRAVITY * 1e-3  # N/m
    young = bend * weight / 2e9 / (np.pi * radius**4 / 4)
    mass = DENSITY * np.pi * radius**2 * length * 1e-3
    return f"""<mujoco>
<option timestep="{step}" integrator="discrete" gravity="0 0 {-GRAVITY * 1e-3}"><flag contact="disable"/></option>
<worldbody><flexcomp name="rod" type="grid" count="{edges + 1} 1 1" spacing="{length * 1e-3 / edges} 1 1" dim="1"
radius="{radius}" mass="{mass}" dof="full"><edge equality="true" damping="0" solref="{2 * step} 1" solimp="{impedance}"/>
<elasticity young="{young}" poisson="0" damping="{damping}"/>{pinned}</flexcomp></worldbody>{equality}</mujoco>"""


def settled(problem: Problem, step: float) -> tuple[np.ndarray, float, float]:
    """(R, V, 3) mm at rest, processor seconds for each rod, and the speed that is left, m/s. Raises ImportError where MuJoCo is
    absent."""
    import mujoco

    held = "".join(f'<connect name="hold{k}" body1="rod_{k}" body2="world" anchor="0 0 0" solref="{2 * step} 1" '
                   f'solimp="{IMPEDANCE}"/>' for k in HELD)
    text = model(step, LENGTH, EDGES, BEND, RADIUS, IMPEDANCE, DAMPING, equality=f"<equality>{held}</equality>")
    shapes, taken, left = [], [], []
    for start in problem.start.vertices:
        system = mujoco.MjModel.from_xml_string(text)
        data = mujoco.MjData(system)
        mujoco.mj_forward(system, data)
        straight = data.flexvert_xpos.reshape(-1, 3).copy()
        data.qpos[: straight.size] = (1e-3 * start - straight).ravel()  # behind them the roll of each edge
        for vertex in HELD:
            system.eq_data[system.equality(f"hold{vertex}").id, 3:6] = 1e-3 * start[vertex]
        began = time.process_time()
        for count in range(round(MOST_SECONDS / step)):
            mujoco.mj_step(system, data)
            if count % 50 == 49 and np.abs(data.qvel).max() < STILL:
                break
        taken.append(time.process_time() - began)
        left.append(np.abs(data.qvel).max())
        shapes.append(1e3 * data.flexvert_xpos.reshape(-1, 3))
    return np.array(shapes), float(np.mean(taken)), float(max(left))
