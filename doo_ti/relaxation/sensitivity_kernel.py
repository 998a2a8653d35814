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
from doo_ti.relaxation.loading import Loading
from doo_ti.relaxation.parameter_gradient import KEPT_ITEMS, NO_MODE, ParameterGradient
from doo_ti.types import Solution

INERTIA_OF_A_MINIMUM = 3.0
TRACE = 1e-12
"""Eigenvalues of H below this share of its largest diagonal entry are neutral motions, as the certificate has it."""
MOST_THREADS_ON_A_GPU = 4096


def run_sensitivity(solution: Solution, usable: np.ndarray, directions: np.ndarray, modes: np.ndarray, first: int, last: int):
    """dx (R, V, 3, P), dω (R, E, 3, P) and which rods (R,) have them, of the R rods from ``first`` to ``last`` of a solution
    that are ``usable``; NaN in others.

    directions  (P, DIRECTION_COLUMNS)
    modes       (M, E−1, 2) changes of ω̄ at the joints that ``directions`` name by their row
    """
    table = solution.tables
    count, edges, columns = last - first, table.edges, len(directions)
    vertices = np.full((count, edges + 1, 3, columns), np.nan)
    rotations = np.full((count, edges, 3, columns), np.nan)
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
        frames = frames / np.linalg.norm(frames, axis=-1, keepdims=True)
        sensitivity_kernel(stride, 1 if on_cpu else 64)(
            table.start.reshape(-1), table.rest_length, table.clamp, table.material, *table.up, rods, frames.reshape(-1),
            np.nan_to_num(solution.end_force[first:last]), np.ascontiguousarray(directions), np.ascontiguousarray(modes),
            threads, np.zeros(threads * items), vertices, rotations, sound,
        )
    lost = sound == 0
    vertices[lost], rotations[lost] = np.nan, np.nan
    return vertices, rotations, ~lost


@ti.data_oriented
class SensitivitySweep(ParameterGradient):
    """The work of a thread. ``tables`` is the record of the kernel's arrays."""

    def __init__(self, stride: int):
        super().__init__(stride)
        self.loading = Loading(self, in_millimetres=True)

    @ti.func
    def work(self, tables, scratch: ti.template(), threads, thread):
        """Every rod of this thread, and every column for it."""
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
            tables.sound[row] = ti.cast(self.certify(rod, multiplier) == INERTIA_OF_A_MINIMUM, ti.i32)
            schur = self.schur_complement(rod)
            for p in range(tables.directions.shape[0]):
                column = self.column(tables, rod, index, p, multiplier)
                right = self.eliminate_column(rod, column)
                change, positive = self.bordered(rod, schur, right)
                self.substitute(rod, record(change=change))
                self.store_column(tables, rod, row, p, column.stretch)
            index += threads

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
        for e in range(rod.edges):
            remaining = remaining - rod.scratch[at + chain.LENGTH * self.stride]
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
        w = self.load3(rod.scratch, at + chain.ROTATION * self.stride)
        turned = minus(scaled(first_director(q), w[2]), scaled(second_director(q), w[1]))
        moved = plus(turned, scaled(tangent(q), stretch))
        return plus(x, scaled(moved, rod.scratch[at + chain.LENGTH * self.stride]))

    @ti.func
    def store_column(self, tables, rod, row, p, stretch):
        """dω from the place of the step, and dx, into row ``row`` of the results."""
        x = variable(repeated(0.0 * rod.total, 3))
        if rod.released > 0.5:  # held at the far end, which then stays where it is
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


@cache
def sensitivity_kernel(stride: int, block: int):
    """The compiled-on-first-use kernel; ``stride`` and ``block`` as Newton's kernel has them."""
    sweep = SensitivitySweep(stride)
    table1, table2, table4 = (ti.types.ndarray(dtype=ti.f64, ndim=size) for size in (1, 2, 4))

    @ti.kernel
    def solve(
        start: table1, rest_length: table2, clamp: table2, material: table2,  # as the Newton kernel has them
        up0: ti.f64, up1: ti.f64, up2: ti.f64,
        rods: ti.types.ndarray(dtype=ti.i32, ndim=2),  # [rod, ROD_COLUMNS]
        frames: table1,  # [row · edge · 4] the equilibria
        end_force: table2,  # [row, 3] −λ
        directions: table2,  # [column, DIRECTION_COLUMNS]
        modes: ti.types.ndarray(dtype=ti.f64, ndim=3),  # [mode, joint, 2]
        threads: ti.i32, scratch: table1,
        vertices: table4, rotations: table4,  # [row, vertex or edge, 3, column] out
        sound: ti.types.ndarray(dtype=ti.i32, ndim=1),  # [row] out: one where the inertia is a minimum's
    ):
        ti.loop_config(block_dim=block)
        for thread in range(threads):
            tables = record(
                start=start, rest_length=rest_length, clamp=clamp, material=material, up=(up0, up1, up2), rods=rods,
                frames=frames, end_force=end_force, directions=directions, modes=modes, vertices=vertices,
                rotations=rotations, sound=sound, results=end_force, numbers=material, field=material, contacts=0,
                kinds=rods)
            sweep.work(tables, scratch, threads, thread)

    return solve
