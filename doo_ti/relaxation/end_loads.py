"""Forces and moments with which the clamps hold the two ends of rods at rest.

    loads = end_loads(solution)
    loads.start_force, loads.end_moment, loads.force_unit      # (R, 3), (R, 3), "N"
"""

from dataclasses import dataclass, replace

import numpy as np

from doo_ti.relaxation import tables as of
from doo_ti.relaxation.point_loads import PointLoads
from doo_ti.relaxation.sensitivity_kernel import run_sensitivity, vertex_forces
from doo_ti.relaxation.tables import Tables
from doo_ti.rod.material import force_in_newton
from doo_ti.rod.types import Solution
from doo_ti.system import runtime
from doo_ti.system.arguments import short_repr, typed
from doo_ti.system.errors import InputError


@dataclass(frozen=True)
class EndLoads:
    """Forces and moments of the clamps on R rods, in the axes of the world; moments about the clamped vertex. The energy grows
    by force · d when a clamp moves by d, and by moment · a when it turns by the small rotation vector a.

    start_force, start_moment, end_force, end_moment  (R, 3), or (R, 3, P) where they are derivatives by P parameters
    physical                                          whether in N and N m; else energies are mm² (relative to weight), forces
                                                      mm and moments mm²
    """

    __repr__ = short_repr

    start_force: np.ndarray
    start_moment: np.ndarray
    end_force: np.ndarray
    end_moment: np.ndarray
    physical: bool

    @property
    def force_unit(self) -> str:
        """"N", or "mm"."""
        return "N" if self.physical else "mm"

    @property
    def moment_unit(self) -> str:
        """"N m", or "mm²"."""
        return "N m" if self.physical else "mm²"

    @classmethod
    def of(cls, loads: np.ndarray, table: Tables, first: int, last: int) -> "EndLoads":
        """``loads`` (R, 4, 3, …) of the rods from ``first`` to ``last`` of ``table``, in N and N m where its materials are in
        physical units."""
        physical = table.weight_per_length is not None
        if physical:
            rows = table.material_index[first:last]
            newton = force_in_newton(1.0, table.weight_per_length[rows], table.material[rows, of.WEIGHT])
            loads = loads * np.stack([newton, 1e-3 * newton] * 2, axis=1).reshape(-1, 4, *[1] * (loads.ndim - 2))
        return cls(*(loads[:, k] for k in range(4)), physical)


@typed
@runtime.exclusive
def end_loads(solution: Solution) -> EndLoads:
    """The forces and moments at both ends of every rod of ``solution``, which also holds its materials, clamps and the
    direction of gravity. In N and N m where the material has a weight per length (``Material.from_physical``), else relative to
    weight (:class:`EndLoads`).

    What an end does not hold is zero: the moment at a position clamp, all of a free end. Both forces together carry the rod's
    weight, and point loads. NaN in rods that have not converged, and in taut ones (:class:`doo_ti.rod.types.Solution`).

    Raises InputError for joined solutions, and for rods under an external energy other than forces and masses.
    """
    solution = alone("end_loads", solution)
    table = solution.tables
    runtime.start()
    nothing = np.zeros((0, 0)), np.zeros((1, table.edges - 1, 2))
    moments = run_sensitivity(solution, solution.converged, *nothing, 0, table.count)[3]
    clamp = table.clamp[table.configuration_index]
    total = 2.0 * table.material[table.material_index, of.WEIGHT, None] * clamp[:, of.TOTAL, None] * table.up
    weight = total - vertex_forces(table).sum(axis=1)
    end = np.where(clamp[:, of.RELEASED, None] > 0, weight, solution.end_force)
    loads = np.stack([weight - end, moments[:, 0], end, moments[:, 1]], axis=1)
    loads[~solution.converged | (clamp[:, of.TILT_INNER] == 0)] = np.nan
    return EndLoads.of(loads, table, 0, table.count)


def alone(function: str, solution: Solution) -> Solution:
    """``solution``, an argument of ``function``, as one of rods without an external energy, but for point loads: those held at
    the far end alone hang from there. Raises InputError where it has no tables, and under other external energies."""
    table = solution.tables
    if table is None:
        raise InputError(function, "solution", "joins several calls", "relax where its rods ended")
    loads = table.external
    if loads is None:
        return solution
    if not isinstance(loads, PointLoads) or loads.springs is not None:
        raise InputError(function, "solution", "rods under an external energy",
                         "relax them without, or under forces and masses")
    if table.contact is not None:  # among obstacles vertex 0 is free to move with or without them
        return solution
    clamp = table.clamp.copy()
    loose = clamp[:, of.LOOSE] > 0
    clamp[loose, of.LOOSE], clamp[loose, of.RELEASED], clamp[loose, of.CLOSED] = 0.0, 1.0, 0.0
    force = np.where(loose[table.configuration_index, None], 0.0, solution.end_force)
    return replace(solution, end_force=force, tables=replace(table, clamp=clamp))
