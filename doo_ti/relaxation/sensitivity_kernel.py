"""The kernels behind :mod:`doo_ti.relaxation.sensitivity`, for rods that touch nothing and for those at obstacles."""

from collections.abc import Callable
from functools import cache, partial

import numpy as np
import taichi as ti

from doo_ti.physics.algebra import against, forward
from doo_ti.physics.number import Number, device_functions
from doo_ti.physics.tuples import chosen, negated, plus, record, repeated, scaled, variable
from doo_ti.relaxation import tables as of
from doo_ti.relaxation.batch import launch, layout_for
from doo_ti.relaxation.chain import edge_layout
from doo_ti.relaxation.contact_sensitivity import ContactSensitivity
from doo_ti.relaxation.elimination import Elimination
from doo_ti.relaxation.kernel_factory import INDEX1, RODS, TABLE1, TABLE2, TABLE3, TABLE4, loop_kernel
from doo_ti.relaxation.loading import Loading
from doo_ti.relaxation.newton import OBSTACLES
from doo_ti.relaxation.parameter_gradient import DIRECTION_COLUMNS, KEPT
from doo_ti.relaxation.sensitivity_columns import LOADS, SensitivityColumns
from doo_ti.relaxation.tables import Tables
from doo_ti.rod.types import Solution

MOST_THREADS_ON_A_GPU = 4096


@device_functions
class SensitivitySweep(SensitivityColumns, Elimination):
    """The columns of rods that touch nothing."""

    def __init__(self, number: Number, stride: int):
        super().__init__(number, False, stride, edge_layout(False, KEPT))
        self.loading = Loading(self, in_millimetres=True)

    def edge_pull(self, rod, edge, weight):
        """With the point loads, which are kept with the forces of obstacles."""
        return plus(scaled(rod.gravity, weight), edge.external.beyond)

    def solve_column(self, rod, column, schur, closure):
        """dω into the place of the step, where closure is changed by ``closure``; returns dλ."""
        right = variable(closure)  # Σ W_Aᵀ D⁻¹ W_b and ∂c/∂θ
        er = variable(repeated(0.0 * rod.total, 3))  # W_Uᵀ D⁻¹ W_b of the edge before
        first = self.first_changed(rod, column)  # before it b is zero
        for e in range(first, rod.edges):
            edge = self.edge(rod.head, e)
            f = edge.pivots
            wb = forward(f, self.right_of(rod, edge, e, column, er))
            edge.rotation = wb
            right = plus(right, against(f, edge.border, wb))
            er = against(f, edge.neighbour, wb)
        change, positive = self.bordered(rod, schur, right)
        self.substitute(rod, record(change=change))
        return change

    def started(self, rod, column):
        """What vertex 0 moves by."""
        x = variable(column.move)
        if self.largest(rod.released) > 0.5:  # held at the far end, which then stays where it is
            far = variable(repeated(0.0 * rod.total, 3))
            for e in range(rod.edges):
                edge = self.edge(rod.head, e)
                far = self.end_of_turned(edge, far, edge.rotation, column.stretch)
            x = chosen(rod.released > 0.5, negated(far), x)
        return x


def run_sensitivity(solution: Solution, usable: np.ndarray, directions: np.ndarray, modes: np.ndarray, first: int, last: int,
                    rotations: bool = True, loads: bool = True):
    """dx (R, V, 3, P), dω (R, E, 3, P), the change of the loads (R, 4, 3, P), the moments at both ends (R, 2, 3) and which rods
    (R,) have them, of the R rods from ``first`` to ``last`` of a solution that are ``usable``; NaN in others.

    directions  (P, DIRECTION_COLUMNS); with P = 0 only the moments are computed, and no rod needs to be at a minimum
    modes       (M, E−1, 3) changes at the joints that ``directions`` name by their row: of ω̄, or of ln B and ln β
    rotations, loads  whether those are computed; without, they have no columns

    Loads are forces and moments of the clamps on the rod in the world: force at the start, moment there, the same at the end.
    """
    count, edges, columns = last - first, solution.tables.edges, len(directions)
    outputs = (of.room(count, edges + 1, 3, columns), of.room(count, edges, 3, columns * rotations),
               of.room(count, LOADS, 3, columns * loads), of.room(count, 2, 3, 1))
    # Kernels take no arrays without entries.
    written = {name: array if array.shape[3] else np.empty((1,) * array.ndim)
               for name, array in zip(COLUMNS, outputs, strict=True)}
    lost = ~run_at_rest(solution, usable, SOLVING, directions, modes, written, first, last, packed=True, contacts=columns > 0)
    for array in outputs:
        array[lost] = np.nan
    return *outputs[:3], outputs[3][..., 0], ~lost


def run_at_rest(solution: Solution, usable: np.ndarray, kernels: Callable, directions: np.ndarray, modes: np.ndarray,
                arrays: dict, first: int, last: int, packed: bool = False, contacts: bool = True) -> np.ndarray:
    """Launch kernels over the rods from ``first`` to ``last`` of a solution that are ``usable``; ``directions`` and ``modes``
    as :func:`run_sensitivity` has them.

    kernels   :func:`kernels_at_rest`
    arrays    further ones of the kernels
    packed    whether that of rods that touch nothing takes packs of rods
    contacts  whether what rods touch matters

    Returns which rods (R,) are at a minimum and have results.
    """
    table, count, columns = solution.tables, last - first, len(directions)
    # Those of f32 are unit quaternions to seven digits.
    frames = solution.configuration.quaternions[first:last]
    frames = np.ascontiguousarray(frames / np.sqrt(np.einsum("rek,rek->re", frames, frames))[..., None], dtype=np.float64)
    results = np.zeros((count, of.LOADED_RESULTS))
    released = table.released[table.configuration_index[first:last], None]  # there the chain closes nothing
    results[:, of.FORCE : of.FORCE + 3] = np.where(released, 0.0, np.nan_to_num(solution.end_force[first:last]))
    results[:, of.DRIFT :] = solution.configuration.start[first:last] - table.anchor[table.configuration_index[first:last]]
    directions = np.ascontiguousarray(directions) if columns else np.zeros((1, DIRECTION_COLUMNS))
    sound = np.zeros(count, dtype=np.int32)
    given = arrays | {"frames": frames.reshape(-1), "results": results, "beyond": _beyond(table, first, last), "sound": sound,
                      "directions": directions, "modes": np.ascontiguousarray(modes), "columns": columns}
    touching = np.zeros(count, dtype=bool)  # or with vertex 0 free among obstacles
    if contacts and table.contact is not None:
        loose = table.clamp[table.configuration_index[first:last], of.LOOSE] > 0
        touching = loose | (table.contact.forces[first:last] != 0.0).any(axis=(1, 2))
    for part, contact in ((~touching, None), (touching, table.contact)):
        rods = table.continued(np.ones(table.count, dtype=bool), first + np.flatnonzero(usable[first:last] & part))
        if not len(rods):
            continue
        rods[:, of.RESULT_ROW] -= first
        kernel, more = kernels, {}
        if contact is not None:
            obstacles, radius = (array if len(array) == 1 else array[first:last]
                                 for array in (contact.obstacles, contact.radius))
            loads = np.zeros((1, 1, 3)) if table.external is None else point_loads(table)[first:last]
            kernel = partial(kernels, has_grid=contact.has_grid)
            more = {"obstacles": obstacles, "kinds": contact.kinds, "grids": contact.grids, "radius": radius,
                    "memory": contact.memory[first:last], "point_loads": loads}
        layout = layout_for(len(rods), 64, width=None if packed and contact is None else 1, most=MOST_THREADS_ON_A_GPU)
        launch(layout, kernel, start=table.start.reshape(-1), rest_length=table.rest_length, clamp=table.clamp,
               material=table.material, up=np.array(table.up, dtype=np.float64), rods=rods, **given, **more)
    return sound != 0


def _beyond(table: Tables, first: int, last: int) -> np.ndarray:
    """(R, E, 3) the forces of obstacles and of point loads on all vertices after the first one of every edge, with the sign of
    a gradient, less those on all vertices where a rod hangs from its far end; one number where there are none."""
    if table.contact is None and table.external is None:
        return np.zeros((1, 1, 1))
    forces = vertex_forces(table)[first:last]
    beyond = -np.cumsum(forces[:, :0:-1], axis=1)[:, ::-1]
    hanging = table.released[table.configuration_index[first:last]]
    beyond[hanging] += forces[hanging].sum(axis=1)[:, None]
    return beyond.copy()


def vertex_forces(table: Tables) -> np.ndarray:
    """(R, V, 3) of obstacles and of point loads with their masses' weight."""
    forces = np.zeros((table.count, table.edges + 1, 3)) if table.contact is None else table.contact.forces
    return forces if table.external is None else forces + point_loads(table)


def point_loads(table: Tables) -> np.ndarray:
    """(R, V, 3) forces and the weight of masses, of rods that have them."""
    return table.external.whole_force[table.external_index]


# What kernels are given: for rods at rest of any kind, and where their derivatives go.
AT_REST = RODS | {
    "start": TABLE1,  # as the Newton kernel has it
    "up": TABLE1,  # [3] against gravity
    "frames": TABLE1,  # [row · edge · 4] the equilibria
    "results": TABLE2,  # [row, LOADED_RESULTS] of which −λ and how far vertex 0 has moved are read
    "beyond": TABLE3,  # [row, edge, 3] forces of obstacles, see :func:`_beyond`
    "directions": TABLE2,  # [column, DIRECTION_COLUMNS]
    "modes": TABLE3,  # [mode, joint, 3]
    "columns": ti.i32,
    "sound": INDEX1,  # [row] out: one where there are results
}
COLUMNS = {
    "vertices": TABLE4, "rotations": TABLE4,  # [row, vertex or edge, 3, column] out; a single number of what is not wanted
    "loads": TABLE4,  # [row, LOADS, 3, column] out
    "moments": TABLE4,  # [row, end, 3, 0] out: at the start and at the end
}
CONTACTS_AT_REST = {name: OBSTACLES[name] for name in ("obstacles", "kinds", "grids", "radius", "memory")} | {
    "point_loads": TABLE3}  # [row, vertex, 3], or a single one of zero


def kernels_at_rest(name: str, results: dict, alone: type, touching: type) -> Callable:
    """What :func:`run_at_rest` takes as ``kernels``, made as by :func:`.newton_kernel` of these sweeps: for rods that touch
    nothing, and with ``has_grid`` for those that touch obstacles. They write ``results``."""
    @cache
    def kernel(number: Number, stride: int, block: int, has_grid: bool | None = None):
        if has_grid is None:
            return loop_kernel(name, number, AT_REST | results, alone(number, stride), block)
        given = AT_REST | results | CONTACTS_AT_REST
        return loop_kernel(f"{name}_in_contact", number, given, touching(stride, has_grid), block, brief=True)

    return kernel


SOLVING = kernels_at_rest("solve", COLUMNS, SensitivitySweep, ContactSensitivity)
