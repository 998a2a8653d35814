"""How a rod at rest answers to its parameters: dΓ*/dΘ at stable equilibria by the implicit function theorem (§III-E).

At rest g(ω, Θ) + Aλ = 0 and closure c = 0 hold, so a small change of a parameter θ turns the frames by the solution of

    [H  A] [dω/dθ]     [∂g/∂θ]
    [Aᵀ 0] [dλ/dθ] = − [  0  ],

the very system whose inertia certifies the minimum, with one more right-hand side for each parameter. Vertices follow as
dx_{i+1} = dx_i + l_i (dω_i × t_i). Parameters by name, and the columns each of them adds:

    bend                      α of B = αI: adds to both diagonal entries; mm³
    bend_1, bend_2, bend_12   entries of B; mm³
    twist                     β; mm³
    weight                    μ
    rest_curvature            2: ω̄, constant along the rod; 1/mm
    rest_curvature_per_joint  2 (E−1): joint by joint, its two components together; 1/mm
    up                        2: turns of up about the axes of :func:`tilt_axes`; rad
    gravity                   3: the vector μ up in the world
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from doo_ti import runtime
from doo_ti.errors import InputError
from doo_ti.frames import matrix_from_quaternion, smallest_rotation
from doo_ti.refinement.sensitivity_kernel import (
    BEND,
    DIRECTION_COLUMNS,
    EVERY_JOINT,
    JOINT,
    PULL,
    REST,
    TIMES_WEIGHT,
    TWIST,
    run_sensitivity,
)
from doo_ti.types import Configuration, Solution

PARAMETERS = ("bend", "bend_1", "bend_2", "bend_12", "twist", "weight", "rest_curvature", "rest_curvature_per_joint", "up",
              "gravity")


@dataclass(frozen=True)
class Sensitivity:
    """dΓ*/dΘ of R rods for P columns; NaN in rods that are not usable.

    columns        (P,) what each column is the derivative by, such as "bend", "rest_curvature[1]", "up[0]"
    vertices       (R, V, 3, P) dx, mm per unit of the parameter
    rotations      (R, E, 3, P) rotation of each frame in its own axes (t, m1, m2), rad per unit
    usable         (R,) bool: the rod is at a stable equilibrium
    configuration  the rods
    """

    columns: tuple[str, ...]
    vertices: np.ndarray
    rotations: np.ndarray
    usable: np.ndarray
    configuration: Configuration

    @property
    def directors(self) -> np.ndarray:
        """(R, E, 3, P) change of m1: its turn about t towards m2, less that about m2 towards −t."""
        frames = self.configuration.frames
        about_t, about_m2 = self.rotations[:, :, None, 0], self.rotations[:, :, None, 2]
        return frames[..., 2, None] * about_t - frames[..., 0, None] * about_m2


@runtime.exclusive
def sensitivity(solution: Solution, parameters: Sequence[str] = ("bend", "twist", "weight")) -> Sensitivity:
    """dΓ*/dΘ of every rod of ``solution``, which also holds its materials, clamps and the direction of gravity.

    solution    of :func:`doo_ti.relaxation.relax.relax` in f64: an equilibrium reached to a residual r is off by about r, and
                so are its derivatives
    parameters  from PARAMETERS, in the order of the columns

    Rods that have not converged, are not certified stable, or are infeasible come out as NaN. A round rod with both spins
    free keeps its first spin; along other motions that cost nothing (a weightless bow about its chord, a rod that hangs from a
    point about up) a rod does not move either.

    Raises InputError for unknown or repeated parameters, and for rods under an external energy.
    """
    table = solution.tables
    if table is None:
        raise InputError("sensitivity", "solution", "was put together of several calls", "relax where its rods ended")
    if table.external is not None:
        raise InputError("sensitivity", "solution", "rods under an external energy", "relax them without one")
    names, directions = parameter_directions(parameters, table.edges, table.up)
    usable = solution.converged & solution.stable
    runtime.start()
    vertices, rotations, sound = run_sensitivity(solution, usable, directions)
    return Sensitivity(names, vertices, rotations, sound, solution.configuration)


def tilt_axes(up: np.ndarray) -> np.ndarray:
    """(2, 3) unit axes across ``up`` about which it is tilted: x and y of the world, turned as z must turn to ``up``."""
    return matrix_from_quaternion(smallest_rotation(np.array([0.0, 0.0, 1.0]), up))[:, :2].T


def parameter_directions(parameters: Sequence[str], edges: int, up: np.ndarray) -> tuple[tuple[str, ...], np.ndarray]:
    """Names (P,) of the columns of ``parameters`` and what changes along each (P, DIRECTION_COLUMNS)."""
    known = ", ".join(PARAMETERS)
    if isinstance(parameters, str) or not parameters:
        raise InputError("sensitivity", "parameters", f"{parameters!r}", f"give a list of {known}")
    for name in parameters:
        if name not in PARAMETERS:
            raise InputError("sensitivity", "parameters", f"{name!r} is unknown", f"use {known}")
    if len(set(parameters)) < len(parameters):
        raise InputError("sensitivity", "parameters", f"{', '.join(parameters)}", "give each parameter once")
    names, blocks = [], []
    for name in parameters:
        block = _directions(name, edges, up)
        names += [name] if len(block) == 1 else [f"{name}[{k}]" for k in range(len(block))]
        blocks.append(block)
    return tuple(names), np.concatenate(blocks)


def _directions(name: str, edges: int, up: np.ndarray) -> np.ndarray:
    """The rows of :func:`parameter_directions` of one parameter."""
    counts = {"rest_curvature": 2, "rest_curvature_per_joint": 2 * (edges - 1), "up": 2, "gravity": 3}
    rows = np.zeros((counts.get(name, 1), DIRECTION_COLUMNS))
    rows[:, JOINT] = EVERY_JOINT
    if name in ("bend", "bend_1", "bend_2", "bend_12"):
        rows[0, BEND : BEND + 3] = {"bend": (1, 1, 0), "bend_1": (1, 0, 0), "bend_2": (0, 1, 0), "bend_12": (0, 0, 1)}[name]
    elif name == "twist":
        rows[0, TWIST] = 1.0
    elif name == "weight":
        rows[0, PULL : PULL + 3] = up
    elif name == "up":
        rows[:, PULL : PULL + 3] = np.cross(tilt_axes(up), up)
        rows[:, TIMES_WEIGHT] = 1.0
    elif name == "gravity":
        rows[:, PULL : PULL + 3] = np.eye(3)
    else:
        rows[:, REST : REST + 2] = np.tile(np.eye(2), (len(rows) // 2, 1))
        if name == "rest_curvature_per_joint":
            rows[:, JOINT] = np.repeat(np.arange(edges - 1), 2)
    return rows
