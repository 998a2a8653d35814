"""The kernel behind :mod:`doo_ti.refinement.sensitivity`: the certificate's factors, and right-hand sides one after the other.

Everything about H is Newton's own (:mod:`doo_ti.relaxation.chain`), on one rod at a time: H is assembled and eliminated without
shift; then for every column b = −∂g/∂θ runs forward through the factors, S dλ = Σ W_Aᵀ D⁻¹ W_b, and back-substitution
gives dω.
"""

from functools import cache

import numpy as np
import taichi as ti

from doo_ti import runtime
from doo_ti.physics import pair
from doo_ti.physics.algebra import forward, solve_symmetric, weighted
from doo_ti.physics.angle import twist_angle_function
from doo_ti.physics.closure import linear_gradient
from doo_ti.physics.number import Number
from doo_ti.physics.quaternion import first_director, second_director
from doo_ti.relaxation import chain
from doo_ti.relaxation.columns import OF_MATERIAL, OF_RESULT, WEIGHT
from doo_ti.relaxation.loading import (
    ASKED_CLOSED,
    ASKED_FREE,
    ASKED_GRAVITY,
    ASKED_ITEMS,
    ASKED_RELEASED,
    ASKED_SCALE,
    ASKED_TOTAL,
    ASKED_UNIT,
    lane_loading,
)
from doo_ti.types import Solution

# A column changes B by BEND = (11, 22, 12), β by TWIST, ω̄ at the vertex JOINT or at every one by REST, and gravity by PULL,
# which is multiplied by μ where TIMES_WEIGHT is one.
BEND, TWIST, REST, JOINT, PULL, TIMES_WEIGHT, DIRECTION_COLUMNS = 0, 3, 4, 6, 7, 10, 11
EVERY_JOINT = -1

NUMBER = Number(1, 64)
KEPT = chain.GENERAL_ITEMS
"""Curvature and twist at the vertex where an edge ends, kept: eliminating writes over the place where chain has them."""
KEPT_ITEMS = 8
INERTIA_OF_A_MINIMUM = 3.0
TRACE = 1e-12
"""Eigenvalues of H below this share of its largest diagonal entry are neutral motions, as the certificate has it."""
MOST_THREADS_ON_A_GPU = 4096


def run_sensitivity(solution: Solution, usable: np.ndarray, directions: np.ndarray):
    """dx (R, V, 3, P), dω (R, E, 3, P) and which rods (R,) have them, of those that are ``usable`` (R,); NaN in others."""
    table = solution.tables
    count, edges, columns = table.count, table.edges, len(directions)
    vertices = np.full((count, edges + 1, 3, columns), np.nan)
    rotations = np.full((count, edges, 3, columns), np.nan)
    sound = np.zeros(count, dtype=np.int32)
    rods = table.continued(usable, np.flatnonzero(usable))
    if len(rods):
        on_cpu = runtime.start() == "cpu"
        threads = min(len(rods), runtime.thread_count() if on_cpu else MOST_THREADS_ON_A_GPU)
        stride = 1 if on_cpu else threads
        items = ASKED_ITEMS + (chain.GENERAL_ITEMS + KEPT_ITEMS) * edges
        # Those of f32 are unit quaternions to seven digits.
        frames = solution.configuration.quaternions
        frames = frames / np.linalg.norm(frames, axis=-1, keepdims=True)
        sensitivity_kernel(stride, 1 if on_cpu else 64)(
            table.start.reshape(-1), table.rest_length, table.clamp, table.material, *table.up, rods, frames.reshape(-1),
            np.ascontiguousarray(solution.end_force), np.ascontiguousarray(directions), threads, np.zeros(threads * items),
            vertices, rotations, sound,
        )
    lost = sound == 0
    vertices[lost], rotations[lost] = np.nan, np.nan
    return vertices, rotations, ~lost


@cache
def sensitivity_kernel(stride: int, block: int):
    """The compiled-on-first-use kernel; ``stride`` and ``block`` as Newton's kernel has them."""
    sweep = chain.chain_sweeps(NUMBER, False, stride, KEPT_ITEMS)
    loading = lane_loading(NUMBER, False, stride, sweep.items)
    twist_angle = twist_angle_function(NUMBER)
    items, load3, load4 = sweep.items, sweep.load3, sweep.load4
    table1 = ti.types.ndarray(dtype=ti.f64, ndim=1)
    table2 = ti.types.ndarray(dtype=ti.f64, ndim=2)
    table4 = ti.types.ndarray(dtype=ti.f64, ndim=4)

    @ti.func
    def load_factors(scratch: ti.template(), at):
        """Factors of an edge's pivot block, and the three columns each of W_U and of W_A."""
        return (
            load3(scratch, at + chain.PIVOTS * stride) + load3(scratch, at + (chain.PIVOTS + 3) * stride),
            (load3(scratch, at + chain.ELIMINATED_NEXT * stride), load3(scratch, at + (chain.ELIMINATED_NEXT + 3) * stride),
             load3(scratch, at + (chain.ELIMINATED_NEXT + 6) * stride)),
            (load3(scratch, at + chain.ELIMINATED_CLOSURE * stride),
             load3(scratch, at + (chain.ELIMINATED_CLOSURE + 3) * stride),
             load3(scratch, at + (chain.ELIMINATED_CLOSURE + 6) * stride)),
        )

    @ti.func
    def bend_pairs(scratch: ti.template(), origin, edges):
        """Curvature and twist at every vertex, to where they are eliminated from and to where they are kept."""
        at = origin
        for _ in range(edges - 1):
            x, y, inverse, turn, r = pair.curvature(load4(scratch, at), load4(scratch, at + ti.static(items * stride)))
            bent = x + y + (inverse, twist_angle(r)) + turn
            for k in ti.static(range(KEPT_ITEMS)):
                scratch[at + (chain.BENT + k) * stride] = bent[k]
                scratch[at + (KEPT + k) * stride] = bent[k]
            at += ti.static(items * stride)

    @ti.func
    def schur_complement(scratch: ti.template(), origin, edges, closed):
        """S = Σ W_Aᵀ D⁻¹ W_A, the identity without closure."""
        loose = 1.0 - closed
        s0, s1, s2, s3, s4, s5 = (loose, 0.0 * loose, 0.0 * loose, loose, 0.0 * loose, loose)
        at = origin
        for _ in range(edges):
            f, u, a = load_factors(scratch, at)
            s0, s1, s2 = (s0 + weighted(f, a[0], a[0]), s1 + weighted(f, a[0], a[1]), s2 + weighted(f, a[0], a[2]))
            s3, s4, s5 = (s3 + weighted(f, a[1], a[1]), s4 + weighted(f, a[1], a[2]), s5 + weighted(f, a[2], a[2]))
            at += ti.static(items * stride)
        return (s0, s1, s2, s3, s4, s5)

    @ti.func
    def changed_pair(scratch: ti.template(), at, joint, p, directions: ti.template(), unit):
        """∂g/∂θ of the pair at ``joint``, where the edge at ``at`` ends: (left, right)."""
        after = at + ti.static(items * stride)
        x, y, inverse, m, turn = sweep.load_bent(scratch, at + (KEPT - chain.BENT) * stride)
        b_left, b_right, inverse_length, twist, rest = sweep.stiffness(scratch, at, after, (unit, unit))
        b = (directions[p, BEND] / unit, directions[p, BEND + 1] / unit, directions[p, BEND + 2] / unit)
        stiffness = (b, b, inverse_length, directions[p, TWIST] / unit * inverse_length, rest)
        left, right = pair.general_gradient(x, y, inverse, turn, m, stiffness)
        l0, l1, l2, r0, r1, r2 = left + right
        here = ti.cast(directions[p, JOINT], ti.i32)
        if (here == EVERY_JOINT or here == joint) and (directions[p, REST] != 0.0 or directions[p, REST + 1] != 0.0):
            # g is linear in u = ω − ω̄ l̄/2: what ω̄ adds is the difference it makes.
            none = 0.0 * inverse_length
            half = 0.5 / inverse_length
            bent_at_rest = (half * directions[p, REST], half * directions[p, REST + 1])
            with_left, with_right = pair.general_gradient(
                x, y, inverse, turn, m, (b_left, b_right, inverse_length, none, bent_at_rest))
            old_left, old_right = pair.general_gradient(
                x, y, inverse, turn, m, (b_left, b_right, inverse_length, none, (none, none)))
            l0, l1, l2 = (
                l0 + with_left[0] - old_left[0], l1 + with_left[1] - old_left[1], l2 + with_left[2] - old_left[2])
            r0, r1, r2 = (
                r0 + with_right[0] - old_right[0], r1 + with_right[1] - old_right[1], r2 + with_right[2] - old_right[2])
        return (l0, l1, l2), (r0, r1, r2)

    @ti.func
    def eliminate_column(scratch: ti.template(), origin, edges, p, directions: ti.template(), pull, unit, free, total,
                         released):
        """W_b of b = −∂g/∂θ, into the place of the step; returns Σ W_Aᵀ D⁻¹ W_b. ``pull`` is the change of gravity."""
        g0, g1, g2, r0, r1, r2, z0, z1, z2 = (0.0 * total, 0.0 * total, 0.0 * total, 0.0 * total, 0.0 * total, 0.0 * total,
                                              0.0 * total, 0.0 * total, 0.0 * total)
        remaining = total
        at = origin
        for e in range(edges):
            q = load4(scratch, at)
            length = scratch[at + chain.LENGTH * stride]
            remaining = remaining - length
            hang = sweep.hanging_weight(length, remaining, total, released)
            c = (pull[0] * hang, pull[1] * hang, pull[2] * hang)
            l1, l2 = linear_gradient(c, length, first_director(q), second_director(q))
            next0, next1, next2 = (0.0 * total, 0.0 * total, 0.0 * total)
            if e < edges - 1:
                left, right = changed_pair(scratch, at, e, p, directions, unit)
                g0, g1, g2 = (g0 + left[0], g1 + left[1], g2 + left[2])
                next0, next1, next2 = right
            spin, tilt = (1.0 + 0.0 * total, free[4])
            if e == 0:
                spin, tilt = (free[0], free[1])
            if e == edges - 1:
                spin, tilt = (free[2], free[3])
            b = (0.0 - spin * (g0 + r0), 0.0 - tilt * (g1 + l1 + r1), 0.0 - tilt * (g2 + l2 + r2))
            f, u, a = load_factors(scratch, at)
            w = forward(f, b)
            for k in ti.static(range(3)):
                scratch[at + (chain.ROTATION + k) * stride] = w[k]
            z0, z1, z2 = (z0 + weighted(f, a[0], w), z1 + weighted(f, a[1], w), z2 + weighted(f, a[2], w))
            r0, r1, r2 = (weighted(f, u[0], w), weighted(f, u[1], w), weighted(f, u[2], w))
            g0, g1, g2 = (next0, next1, next2)
            at += ti.static(items * stride)
        return (z0, z1, z2)

    @ti.func
    def moved_end(scratch: ti.template(), at, x):
        """x + l (dω × t): what the end of an edge moves by, where its start moves by ``x``."""
        q = load4(scratch, at)
        length = scratch[at + chain.LENGTH * stride]
        w = load3(scratch, at + chain.ROTATION * stride)
        m1 = first_director(q)
        m2 = second_director(q)
        return (
            x[0] + length * (w[2] * m1[0] - w[1] * m2[0]),
            x[1] + length * (w[2] * m1[1] - w[1] * m2[1]),
            x[2] + length * (w[2] * m1[2] - w[1] * m2[2]),
        )

    @ti.func
    def store_column(scratch: ti.template(), origin, edges, released, row, p, vertices: ti.template(),
                     rotations: ti.template()):
        x0, x1, x2 = (0.0 * released, 0.0 * released, 0.0 * released)
        if released > 0.5:  # held at the far end, which then stays where it is
            at = origin
            for _ in range(edges):
                x0, x1, x2 = moved_end(scratch, at, (x0, x1, x2))
                at += ti.static(items * stride)
            x0, x1, x2 = (0.0 - x0, 0.0 - x1, 0.0 - x2)
        at = origin
        for e in range(edges):
            vertices[row, e, 0, p], vertices[row, e, 1, p], vertices[row, e, 2, p] = (x0, x1, x2)
            for k in ti.static(range(3)):
                rotations[row, e, k, p] = scratch[at + (chain.ROTATION + k) * stride]
            x0, x1, x2 = moved_end(scratch, at, (x0, x1, x2))
            at += ti.static(items * stride)
        vertices[row, edges, 0, p], vertices[row, edges, 1, p], vertices[row, edges, 2, p] = (x0, x1, x2)

    @ti.kernel
    def solve(
        start: table1, rest_length: table2, clamp: table2, material: table2,  # as the Newton kernel has them
        up0: ti.f64, up1: ti.f64, up2: ti.f64,
        rods: ti.types.ndarray(dtype=ti.i32, ndim=2),  # [rod, ROD_COLUMNS]
        frames: table1,  # [row · edge · 4] the equilibria
        end_force: table2,  # [row, 3] −λ
        directions: table2,  # [column, DIRECTION_COLUMNS]
        threads: ti.i32, scratch: table1,
        vertices: table4, rotations: table4,  # [row, vertex or edge, 3, column] out
        sound: ti.types.ndarray(dtype=ti.i32, ndim=1),  # [row] out: one where the inertia is a minimum's
    ):
        ti.loop_config(block_dim=block)
        for thread in range(threads):
            edges = rest_length.shape[1]
            head = thread
            if ti.static(stride == 1):
                head = thread * (ASKED_ITEMS + items * edges)
            origin = head + ti.static(ASKED_ITEMS * stride)
            last = origin + (edges - 1) * ti.static(items * stride)
            rod = thread
            while rod < rods.shape[0]:
                row = rods[rod, OF_RESULT]
                loading.load(
                    scratch, head, edges, 0, rod, 0.0, (up0, up1, up2), rods, start, frames, rest_length, clamp, material,
                    material)
                unit = scratch[head + ASKED_UNIT * stride]
                closed = scratch[head + ASKED_CLOSED * stride]
                released = scratch[head + ASKED_RELEASED * stride]
                total = scratch[head + ASKED_TOTAL * stride]
                gravity = load3(scratch, head + ASKED_GRAVITY * stride)
                free = (load3(scratch, head + ASKED_FREE * stride)
                        + (scratch[head + (ASKED_FREE + 3) * stride], scratch[head + (ASKED_FREE + 4) * stride]))
                none = 0.0 * unit
                multiplier = (none - end_force[row, 0] / unit, none - end_force[row, 1] / unit, none - end_force[row, 2] / unit)
                # A neutral motion shows when H is lowered a trace. Raised by one instead, H keeps the rod from moving along it.
                trace = TRACE * scratch[head + ASKED_SCALE * stride]
                shift = none - trace
                inertia = none
                for _ in range(2):
                    bend_pairs(scratch, origin, edges)
                    residual, scale, change, inertia_here, slope, energy, magnitude = sweep.eliminate(
                        scratch, origin, edges, shift, none, none, multiplier, (none, none, none), (unit, unit), gravity,
                        closed, free, total, released, gravity)
                    inertia = inertia_here
                    shift = ti.select(inertia == INERTIA_OF_A_MINIMUM, none, trace)
                sound[row] = ti.cast(inertia == INERTIA_OF_A_MINIMUM, ti.i32)
                schur = schur_complement(scratch, origin, edges, closed)
                for p in range(directions.shape[0]):
                    factor = 1.0 / unit
                    if directions[p, TIMES_WEIGHT] == 1.0:
                        factor = material[rods[rod, OF_MATERIAL], WEIGHT] / unit
                    pull = (factor * directions[p, PULL], factor * directions[p, PULL + 1], factor * directions[p, PULL + 2])
                    z = eliminate_column(scratch, origin, edges, p, directions, pull, unit, free, total, released)
                    solved, minors = solve_symmetric(schur, z)
                    force = (solved[0] * closed, solved[1] * closed, solved[2] * closed)
                    w0, w1, w2 = (none, none, none)
                    at = last
                    for _ in range(edges):
                        w0, w1, w2 = sweep.solved_edge(scratch, at, force, (w0, w1, w2))
                        at -= ti.static(items * stride)
                    store_column(scratch, origin, edges, released, row, p, vertices, rotations)
                rod += threads

    return solve
