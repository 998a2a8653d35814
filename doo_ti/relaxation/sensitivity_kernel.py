"""The kernel behind :mod:`doo_ti.relaxation.sensitivity`: the certificate's factors, and right-hand sides one after the other.

Everything about H is Newton's own (:mod:`doo_ti.relaxation.elimination`), on one rod at a time: H is assembled and eliminated
without shift; then for every column b = −∂g/∂θ runs forward through the factors, S dλ = Σ W_Aᵀ D⁻¹ W_b, and back-substitution
gives dω.
"""

from functools import cache

import numpy as np
import taichi as ti

from doo_ti import runtime
from doo_ti.physics.quaternion import first_director, second_director, tangent
from doo_ti.physics.tuples import (
    against,
    forward,
    minus,
    negated,
    plus,
    products,
    record,
    repeated,
    scaled,
    symmetric_gram,
    variable,
)
from doo_ti.relaxation import chain
from doo_ti.relaxation import tables as of
from doo_ti.relaxation.end_moments import FIRST, LAST, EndMoments
from doo_ti.relaxation.loading import Loading
from doo_ti.relaxation.parameter_gradient import DIRECTION_COLUMNS, KEPT_ITEMS, NO_MODE
from doo_ti.types import Solution

INERTIA_OF_A_MINIMUM = 3.0
TRACE = 1e-12
"""Eigenvalues of H below this share of its largest diagonal entry are neutral motions, as the certificate has it."""
MOST_THREADS_ON_A_GPU = 4096

# The loads of a rod: force and moment at its start, force and moment at its end.
START_FORCE, START_MOMENT, END_FORCE, END_MOMENT, LOADS = 0, 3, 6, 9, 12


def run_sensitivity(solution: Solution, usable: np.ndarray, directions: np.ndarray, modes: np.ndarray, first: int, last: int):
    """dx (R, V, 3, P), dω (R, E, 3, P), the change of the loads (R, 4, 3, P), the moments at both ends (R, 2, 3) and which rods
    (R,) have them, of the R rods from ``first`` to ``last`` of a solution that are ``usable``; NaN in others.

    directions  (P, DIRECTION_COLUMNS); with P = 0 only the moments are computed, and no rod needs to be at a minimum
    modes       (M, E−1, 2) changes of ω̄ at the joints that ``directions`` name by their row

    Loads are forces and moments of the clamps on the rod in the world: force at the start, moment there, the same at the end.
    """
    table = solution.tables
    count, edges, columns = last - first, table.edges, len(directions)
    vertices, rotations = of.room(count, edges + 1, 3, columns), of.room(count, edges, 3, columns)
    loads, moments = of.room(count, LOADS, columns), np.empty((count, 6))
    sound = np.zeros(count, dtype=np.int32)
    rods = table.continued(usable, first + np.flatnonzero(usable[first:last]))
    rods[:, of.RESULT_ROW] -= first
    if len(rods):
        on_cpu = runtime.start() == "cpu"
        threads = min(len(rods), runtime.thread_count() if on_cpu else MOST_THREADS_ON_A_GPU)
        stride = 1 if on_cpu else threads
        items = chain.PARAMETERS + (chain.GENERAL_ITEMS + KEPT_ITEMS) * edges
        # Those of f32 are unit quaternions to seven digits.
        frames = solution.configuration.quaternions[first:last]
        frames = frames / np.sqrt(np.einsum("rek,rek->re", frames, frames))[..., None]
        # Kernels take no arrays without entries.
        arrays, given = (vertices, rotations, loads), np.ascontiguousarray(directions)
        if not columns:
            arrays, given = tuple(np.empty((1,) * array.ndim) for array in arrays), np.zeros((1, DIRECTION_COLUMNS))
        sensitivity_kernel(stride, 1 if on_cpu else 64)(
            table.start.reshape(-1), table.rest_length, table.clamp, table.material, *table.up, rods, frames.reshape(-1),
            np.nan_to_num(solution.end_force[first:last]), given, np.ascontiguousarray(modes), columns, threads,
            np.zeros(threads * items), *arrays, moments, sound,
        )
    lost = sound == 0
    for array in (vertices, rotations, loads, moments):
        array[lost] = np.nan
    return vertices, rotations, loads.reshape(count, 4, 3, columns), moments.reshape(count, 2, 3), ~lost


@ti.data_oriented
class SensitivitySweep(EndMoments):
    """The work of a thread. ``tables`` is the record of the kernel's arrays."""

    def __init__(self, stride: int):
        super().__init__(stride)
        self.loading = Loading(self, in_millimetres=True)

    @ti.func
    def work(self, tables, scratch: ti.template(), columns, threads, thread):
        """Every rod of this thread, and ``columns`` columns for it."""
        edges = tables.rest_length.shape[1]
        head = thread
        if ti.static(self.stride == 1):
            head = thread * (self.parameters + self.items * edges)
        index = thread
        while index < tables.rods.shape[0]:
            row = tables.rods[index, of.RESULT_ROW]
            self.loading.load(tables, scratch, head, 0, index, 0.0)
            rod = self.rods(tables, scratch, head, 0.0)
            unit = scratch[head + chain.OF_ENERGY_UNIT * self.stride]
            force = (tables.end_force[row, 0] / unit, tables.end_force[row, 1] / unit, tables.end_force[row, 2] / unit)
            multiplier = negated(force)
            if columns == 0:
                self.bend_pairs(rod)
                tables.sound[row] = 1
            else:
                tables.sound[row] = ti.cast(self.certify(rod, multiplier) == INERTIA_OF_A_MINIMUM, ti.i32)
            self.put_vector(tables.moments, row, 0, scaled(self.end_moment(rod, FIRST, multiplier), unit))
            self.put_vector(tables.moments, row, 3, scaled(self.end_moment(rod, LAST, multiplier), unit))
            schur = self.schur_complement(rod)
            for p in range(columns):
                column = self.column(tables, rod, index, p, multiplier)
                right = self.eliminate_column(rod, column)
                change, positive = self.bordered(rod, schur, right)
                self.substitute(rod, record(change=change))
                self.store_column(tables, rod, row, p, column)
                self.store_loads(tables, rod, row, p, column, change)
            index += threads

    @ti.func
    def put_vector(self, table: ti.template(), row, place: ti.template(), v):
        """Three numbers into a table's row."""
        for k in ti.static(range(3)):
            table[row, place + k] = v[k]

    @ti.func
    def certify(self, rod, multiplier):
        """Eliminate H and leave its factors in scratch; returns the inertia.

        A neutral motion shows when H is lowered a trace. Raised by one instead, H keeps the rod from moving along it.
        """
        none = 0.0 * rod.total
        trace = TRACE * rod.scratch[rod.head + chain.OF_SCALE * self.stride]
        shift = none - trace
        inertia = none
        for _ in range(2):
            self.bend_pairs(rod)
            inertia = self.eliminate(rod, shift, (none, none), multiplier, repeated(none, 3)).inertia
            shift = ti.select(inertia == INERTIA_OF_A_MINIMUM, none, trace)
        return inertia

    @ti.func
    def factors(self, rod, at):
        """Factors of an edge's pivot block, W_U and W_A."""
        return (
            self.load6(rod.scratch, at + chain.PIVOTS * self.stride),
            self.load9(rod.scratch, at + chain.ELIMINATED_NEXT * self.stride),
            self.load9(rod.scratch, at + chain.ELIMINATED_BORDER * self.stride),
        )

    @ti.func
    def schur_complement(self, rod):
        """S = Σ W_Aᵀ D⁻¹ W_A."""
        s = variable(repeated(0.0 * rod.total, 6))
        at = rod.origin
        for _ in range(rod.edges):
            f, wu, wa = self.factors(rod, at)
            s = plus(s, symmetric_gram(f, wa))
            at += self.edge_stride
        return s

    @ti.func
    def eliminate_column(self, rod, column):
        """W_b of b = −∂g/∂θ, into the place of the step; returns Σ W_Aᵀ D⁻¹ W_b, less what closure is changed by.

        Edges that clamps hold turn by what stands for them in b, where the identity stands in H.
        """
        zero = 0.0 * rod.total
        change = record(pair=repeated(zero, 3), own=repeated(zero, 3), after=repeated(zero, 3), closure=repeated(zero, 3),
                        moment=(zero, zero), end_moment=(zero, zero))
        er = variable(repeated(zero, 3))  # W_Uᵀ D⁻¹ W_b of the edge before
        remaining = rod.total
        at = rod.origin
        begin = 0
        if column.local:  # up to the last two edges b is zero
            begin = ti.max(rod.edges - 2, 0)
        for _ in range(begin):
            remaining = remaining - self.length_at(rod, at)
            self.store(rod.scratch, at + chain.ROTATION * self.stride, repeated(zero, 3))
            at += self.edge_stride
        for e in range(begin, rod.edges):
            remaining = remaining - self.length_at(rod, at)
            edge = self.edge(rod, at, remaining)
            l1, l2 = self.linear_change(rod, edge, column)
            change.own = (zero, l1, l2)
            change.after = repeated(zero, 3)
            if e < rod.edges - 1 and (column.bends or column.mode != NO_MODE):
                left, right = self.pair_change(rod, at, e, column)
                change.pair = plus(change.pair, left)
                change.after = right
            if column.turned and (e == 0 or e >= rod.edges - 2):
                self.turn_neighbours(rod, at, e, column, change)
                self.turn_end(rod, edge, e, column, change)
            if column.stretch != 0.0:
                change.closure = plus(change.closure, scaled(edge.t, column.stretch * edge.length))
            held = variable(repeated(zero, 3))
            if e == 0:
                held = column.turn_start
            if e == rod.edges - 1:
                held = column.turn_end
            b = minus(held, products(self.freedom(rod, e), plus(plus(change.pair, change.own), er)))
            f, wu, wa = self.factors(rod, at)
            wb = forward(f, b)
            self.store(rod.scratch, at + chain.ROTATION * self.stride, wb)
            change.closure = plus(change.closure, against(f, wa, wb))
            er = against(f, wu, wb)
            change.pair = change.after
            at += self.edge_stride
        return minus(change.closure, column.shift)

    @ti.func
    def moved_end(self, rod, at, x, stretch):
        """x + l (dω × t + stretch t): what the end of an edge moves by, where its start moves by ``x``."""
        q = self.load4(rod.scratch, at)
        w = self.rotation_at(rod, at)
        turned = minus(scaled(first_director(q), w[2]), scaled(second_director(q), w[1]))
        moved = plus(turned, scaled(tangent(q), stretch))
        return plus(x, scaled(moved, self.length_at(rod, at)))

    @ti.func
    def store_column(self, tables, rod, row, p, column):
        """dω from the place of the step, and dx, into row ``row`` of the results."""
        stretch = column.stretch
        x = variable(column.move)
        if rod.released > 0.5:  # held at the far end, which then stays where it is
            x = repeated(0.0 * rod.total, 3)
            at = rod.origin
            for _ in range(rod.edges):
                x = self.moved_end(rod, at, x, stretch)
                at += self.edge_stride
            x = negated(x)
        at = rod.origin
        for e in range(rod.edges):
            for k in ti.static(range(3)):
                tables.vertices[row, e, k, p] = x[k]
                tables.rotations[row, e, k, p] = rod.scratch[at + (chain.ROTATION + k) * self.stride]
            x = self.moved_end(rod, at, x, stretch)
            at += self.edge_stride
        for k in ti.static(range(3)):
            tables.vertices[row, rod.edges, k, p] = x[k]

    @ti.func
    def store_loads(self, tables, rod, row, p, column, change):
        """The change of the loads into row ``row`` of the results, where closure's multiplier changes by ``change``.

        Both forces together carry the weight 2 μ L, one of them alone where the other end is free.
        """
        unit = rod.scratch[rod.head + chain.OF_ENERGY_UNIT * self.stride]
        weight = scaled(plus(column.pull, scaled(rod.gravity, column.stretch)), 2.0 * rod.total)
        end = minus(scaled(weight, rod.released), change)
        self.put_load(tables, row, p, START_FORCE, minus(weight, end), unit)
        self.put_load(tables, row, p, START_MOMENT, self.moment_change(rod, FIRST, column, change), unit)
        self.put_load(tables, row, p, END_FORCE, end, unit)
        self.put_load(tables, row, p, END_MOMENT, self.moment_change(rod, LAST, column, change), unit)

    @ti.func
    def put_load(self, tables, row, p, place: ti.template(), v, unit):
        """A force or a moment, in the rod's unit of energy, into column ``p`` of the loads."""
        for k in ti.static(range(3)):
            tables.loads[row, place + k, p] = v[k] * unit


@cache
def sensitivity_kernel(stride: int, block: int):
    """The compiled-on-first-use kernel; ``stride`` and ``block`` as Newton's kernel has them."""
    sweep = SensitivitySweep(stride)
    table1, table2, table3, table4 = (ti.types.ndarray(dtype=ti.f64, ndim=size) for size in (1, 2, 3, 4))

    @ti.kernel
    def solve(
        start: table1, rest_length: table2, clamp: table2, material: table2,  # as the Newton kernel has them
        up0: ti.f64, up1: ti.f64, up2: ti.f64,
        rods: ti.types.ndarray(dtype=ti.i32, ndim=2),  # [rod, ROD_COLUMNS]
        frames: table1,  # [row · edge · 4] the equilibria
        end_force: table2,  # [row, 3] −λ
        directions: table2,  # [column, DIRECTION_COLUMNS]
        modes: table3,  # [mode, joint, 2]
        columns: ti.i32, threads: ti.i32, scratch: table1,
        vertices: table4, rotations: table4,  # [row, vertex or edge, 3, column] out
        loads: table3,  # [row, LOADS, column] out
        moments: table2,  # [row, 6] out: at the start and at the end
        sound: ti.types.ndarray(dtype=ti.i32, ndim=1),  # [row] out: one where there are results
    ):
        ti.loop_config(block_dim=block)
        for thread in range(threads):
            tables = record(
                start=start, rest_length=rest_length, clamp=clamp, material=material, up=(up0, up1, up2), rods=rods,
                frames=frames, end_force=end_force, directions=directions, modes=modes, vertices=vertices,
                rotations=rotations, loads=loads, moments=moments, sound=sound, results=end_force, numbers=material,
                field=material, contacts=0, kinds=rods, grids=material)
            sweep.work(tables, scratch, columns, threads, thread)

    return solve
