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
from doo_ti.physics.algebra import solve_symmetric
from doo_ti.physics.angle import twist_angle_function
from doo_ti.physics.closure import linear_gradient, linear_hessian
from doo_ti.physics.number import Number
from doo_ti.physics.quaternion import first_director, second_director, tangent
from doo_ti.physics.tuples import dot, forward, record
from doo_ti.relaxation import chain
from doo_ti.relaxation.columns import (
    OF_CLAMP,
    OF_MATERIAL,
    OF_RESULT,
    SPIN_END,
    SPIN_START,
    TILT_END,
    TILT_START,
    WEIGHT,
)
from doo_ti.relaxation.elimination import Elimination
from doo_ti.relaxation.loading import Loading
from doo_ti.types import Solution

# A column changes B by BEND = (11, 22, 12), β by TWIST, ω̄ along the rod by row MODE of the table of modes (NO_MODE: not at
# all), gravity by PULL, which is multiplied by μ where TIMES_WEIGHT is one, all lengths by the factor 1 + STRETCH, the far
# point by SHIFT, and the frames that the clamps hold by the rotations TURN_START and TURN_END, all three in the world.
BEND, TWIST, MODE, PULL, TIMES_WEIGHT, STRETCH = 0, 3, 4, 5, 8, 9
SHIFT, TURN_START, TURN_END, DIRECTION_COLUMNS = 10, 13, 16, 19
NO_MODE = -1

NUMBER = Number(1, 64)
KEPT = chain.GENERAL_ITEMS
"""Curvature and twist at the vertex where an edge ends, kept: eliminating writes over the place where chain has them."""
KEPT_ITEMS = 8
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
    rods[:, OF_RESULT] -= first
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
            np.ascontiguousarray(solution.end_force[first:last]), np.ascontiguousarray(directions), np.ascontiguousarray(modes),
            threads, np.zeros(threads * items), vertices, rotations, sound,
        )
    lost = sound == 0
    vertices[lost], rotations[lost] = np.nan, np.nan
    return vertices, rotations, ~lost


@cache
def sensitivity_kernel(stride: int, block: int):
    """The compiled-on-first-use kernel; ``stride`` and ``block`` as Newton's kernel has them."""
    sweep = Elimination(NUMBER, False, stride, KEPT_ITEMS)
    loading = Loading(sweep)
    twist_angle = twist_angle_function(NUMBER)
    items, load3, load4 = sweep.items, sweep.load3, sweep.load4
    table1 = ti.types.ndarray(dtype=ti.f64, ndim=1)
    table2 = ti.types.ndarray(dtype=ti.f64, ndim=2)
    table4 = ti.types.ndarray(dtype=ti.f64, ndim=4)

    @ti.func
    def weighted(f, a, b):
        """aᵀ D⁻¹ b."""
        return a[0] * f[0] * b[0] + a[1] * f[1] * b[1] + a[2] * f[2] * b[2]

    @ti.func
    def load_factors(scratch: ti.template(), at):
        """Factors of an edge's pivot block, and the three columns each of W_U and of W_A."""
        return (
            load3(scratch, at + chain.PIVOTS * stride) + load3(scratch, at + (chain.PIVOTS + 3) * stride),
            (load3(scratch, at + chain.ELIMINATED_NEXT * stride), load3(scratch, at + (chain.ELIMINATED_NEXT + 3) * stride),
             load3(scratch, at + (chain.ELIMINATED_NEXT + 6) * stride)),
            (load3(scratch, at + chain.ELIMINATED_BORDER * stride),
             load3(scratch, at + (chain.ELIMINATED_BORDER + 3) * stride),
             load3(scratch, at + (chain.ELIMINATED_BORDER + 6) * stride)),
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
    def bend_changes(directions: ti.template(), p):
        """Whether column ``p`` changes the pairs by more than their rest curvature."""
        change = directions[p, STRETCH] * directions[p, STRETCH]
        for k in ti.static(range(4)):
            change += directions[p, BEND + k] * directions[p, BEND + k]
        return change > 0.0

    @ti.func
    def changed_pair(scratch: ti.template(), at, joint, p, directions: ti.template(), modes: ti.template(), bends, unit):
        """∂g/∂θ of the pair at ``joint``, where the edge at ``at`` ends: (left, right)."""
        after = at + ti.static(items * stride)
        x, y, inverse, m, turn = sweep.bent(scratch, at + (KEPT - chain.BENT) * stride)
        b_left, b_right, inverse_length, twist, rest = sweep.stiffness(scratch, at, after, (unit, unit))
        none = 0.0 * inverse_length
        l0, l1, l2, r0, r1, r2 = (none, none, none, none, none, none)
        if bends:
            # Stretched, B/l̄ and β/l̄ fall; what is left of the strain at rest, ω̄/2, does not depend on the lengths.
            stretch = directions[p, STRETCH]
            b = (directions[p, BEND] / unit, directions[p, BEND + 1] / unit, directions[p, BEND + 2] / unit)
            changed = directions[p, TWIST] / unit * inverse_length - stretch * twist
            left, right = pair.general_gradient(x, y, inverse, turn, m, (b, b, inverse_length, changed, rest))
            l0, l1, l2, r0, r1, r2 = left + right
            if stretch != 0.0:
                stiff_left, stiff_right = pair.general_gradient(
                    x, y, inverse, turn, m, (b_left, b_right, inverse_length, none, (none, none)))
                l0, l1, l2 = (
                    l0 - stretch * stiff_left[0], l1 - stretch * stiff_left[1], l2 - stretch * stiff_left[2])
                r0, r1, r2 = (
                    r0 - stretch * stiff_right[0], r1 - stretch * stiff_right[1], r2 - stretch * stiff_right[2])
        mode = ti.cast(directions[p, MODE], ti.i32)
        if mode != NO_MODE:
            w0, w1 = modes[mode, joint, 0], modes[mode, joint, 1]
            if w0 != 0.0 or w1 != 0.0:
                # g is linear in u = ω − ω̄ l̄/2: what ω̄ adds is the difference it makes.
                half = 0.5 / inverse_length
                with_left, with_right = pair.general_gradient(
                    x, y, inverse, turn, m, (b_left, b_right, inverse_length, none, (half * w0, half * w1)))
                old_left, old_right = pair.general_gradient(
                    x, y, inverse, turn, m, (b_left, b_right, inverse_length, none, (none, none)))
                l0, l1, l2 = (
                    l0 + with_left[0] - old_left[0], l1 + with_left[1] - old_left[1], l2 + with_left[2] - old_left[2])
                r0, r1, r2 = (
                    r0 + with_right[0] - old_right[0], r1 + with_right[1] - old_right[1], r2 + with_right[2] - old_right[2])
        return (l0, l1, l2), (r0, r1, r2)

    @ti.func
    def held_turn(scratch: ti.template(), at, directions: ti.template(), p, column: ti.template(), holds):
        """The rotation of a clamped edge in column ``p``, given in the world, in its own axes: only what the clamp holds of it,
        (spin, tilt) = ``holds``."""
        q = load4(scratch, at)
        w = (directions[p, column], directions[p, column + 1], directions[p, column + 2])
        return (holds[0] * dot(w, tangent(q)), holds[1] * dot(w, first_director(q)), holds[1] * dot(w, second_director(q)))

    @ti.func
    def across_times(ha, w):
        """U w of the block U = H_across [left row, right column]."""
        return (
            ha[0] * w[0] + ha[1] * w[1] + ha[2] * w[2],
            ha[3] * w[0] + ha[4] * w[1] + ha[5] * w[2],
            ha[6] * w[0] + ha[7] * w[1] + ha[8] * w[2],
        )

    @ti.func
    def times_across(ha, w):
        """Uᵀ w."""
        return (
            ha[0] * w[0] + ha[3] * w[1] + ha[6] * w[2],
            ha[1] * w[0] + ha[4] * w[1] + ha[7] * w[2],
            ha[2] * w[0] + ha[5] * w[1] + ha[8] * w[2],
        )

    @ti.func
    def eliminate_column(scratch: ti.template(), origin, edges, p, directions: ti.template(), modes: ti.template(), pull,
                         unit, free, total, released, gravity, multiplier, turn_start, turn_end):
        """W_b of b = −∂g/∂θ, into the place of the step; returns Σ W_Aᵀ D⁻¹ W_b, less what closure is changed by.

        ``pull`` is the change of gravity. Edges that clamps hold turn by ``turn_start`` and ``turn_end``: these stand in b
        where the identity stands in H, and what they do to their neighbours goes over to the right-hand side.
        """
        none = 0.0 * total
        g0, g1, g2, r0, r1, r2, z0, z1, z2 = (none, none, none, none, none, none, none, none, none)
        bends = bend_changes(directions, p)
        stretch = directions[p, STRETCH]
        turned = turn_start[0] * turn_start[0] + turn_start[1] * turn_start[1] + turn_start[2] * turn_start[2] + (
            turn_end[0] * turn_end[0] + turn_end[1] * turn_end[1] + turn_end[2] * turn_end[2]) > 0.0
        moment1, moment2, end_moment1, end_moment2 = (none, none, none, none)
        remaining = total
        at = origin
        for e in range(edges):
            q = load4(scratch, at)
            length = scratch[at + chain.LENGTH * stride]
            remaining = remaining - length
            hang = length + 2.0 * remaining - 2.0 * total * released
            # Gravity's term grows with the square of the lengths, that of the multiplier with the first power.
            c = (
                pull[0] * hang + stretch * (2.0 * gravity[0] * hang + multiplier[0]),
                pull[1] * hang + stretch * (2.0 * gravity[1] * hang + multiplier[1]),
                pull[2] * hang + stretch * (2.0 * gravity[2] * hang + multiplier[2]),
            )
            m1 = first_director(q)
            m2 = second_director(q)
            l1, l2 = linear_gradient(c, length, m1, m2)
            l0 = none
            next0, next1, next2 = (none, none, none)
            if e < edges - 1:
                left, right = changed_pair(scratch, at, e, p, directions, modes, bends, unit)
                g0, g1, g2 = (g0 + left[0], g1 + left[1], g2 + left[2])
                next0, next1, next2 = right
            if turned and (e == 0 or e >= edges - 2):
                if e < edges - 1 and (e == 0 or e == edges - 2):
                    after = at + ti.static(items * stride)
                    own_left, own_right, hl, hr, ha = sweep.derivatives(
                        sweep.bent(scratch, at + (KEPT - chain.BENT) * stride),
                        sweep.stiffness(scratch, at, after, (unit, unit)))
                    if e == 0:
                        n0, n1, n2 = times_across(ha, turn_start)
                        next0, next1, next2 = (next0 + n0, next1 + n1, next2 + n2)
                        l0 = l0 + hl[1] * turn_start[1] + hl[2] * turn_start[2]
                        moment1, moment2 = (own_left[1], own_left[2])
                    if e == edges - 2:
                        n0, n1, n2 = across_times(ha, turn_end)
                        g0, g1, g2 = (g0 + n0, g1 + n1, g2 + n2)
                        next0 = next0 + hr[1] * turn_end[1] + hr[2] * turn_end[2]
                        end_moment1, end_moment2 = (own_right[1], own_right[2])
                if e == 0 or e == edges - 1:
                    w0, w1, w2 = turn_start
                    if e == edges - 1:
                        w0, w1, w2 = turn_end
                        moment1, moment2 = (end_moment1, end_moment2)
                    whole = (gravity[0] * hang + multiplier[0], gravity[1] * hang + multiplier[1],
                             gravity[2] * hang + multiplier[2])
                    lh = linear_hessian(whole, length, tangent(q), m1, m2)
                    # Where a clamp holds the tangent, the moment g with which it does turns with it: dg = H w + ½ g × w.
                    pull1, pull2 = linear_gradient(whole, length, m1, m2)
                    l0 = l0 + lh[0] * w1 + lh[1] * w2 + 0.5 * ((moment1 + pull1) * w2 - (moment2 + pull2) * w1)
                    z0, z1, z2 = (
                        z0 + length * (w2 * m1[0] - w1 * m2[0]),
                        z1 + length * (w2 * m1[1] - w1 * m2[1]),
                        z2 + length * (w2 * m1[2] - w1 * m2[2]),
                    )
            if stretch != 0.0:
                t = tangent(q)
                z0, z1, z2 = (
                    z0 + stretch * length * t[0], z1 + stretch * length * t[1], z2 + stretch * length * t[2])
            spin, tilt = (1.0 + none, free[4])
            held0, held1, held2 = (none, none, none)
            if e == 0:
                spin, tilt = (free[0], free[1])
                held0, held1, held2 = turn_start
            if e == edges - 1:
                spin, tilt = (free[2], free[3])
                held0, held1, held2 = turn_end
            b = (held0 - spin * (g0 + l0 + r0), held1 - tilt * (g1 + l1 + r1), held2 - tilt * (g2 + l2 + r2))
            f, u, a = load_factors(scratch, at)
            w = forward(f, b)
            for k in ti.static(range(3)):
                scratch[at + (chain.ROTATION + k) * stride] = w[k]
            z0, z1, z2 = (z0 + weighted(f, a[0], w), z1 + weighted(f, a[1], w), z2 + weighted(f, a[2], w))
            r0, r1, r2 = (weighted(f, u[0], w), weighted(f, u[1], w), weighted(f, u[2], w))
            g0, g1, g2 = (next0, next1, next2)
            at += ti.static(items * stride)
        return (z0 - directions[p, SHIFT], z1 - directions[p, SHIFT + 1], z2 - directions[p, SHIFT + 2])

    @ti.func
    def moved_end(scratch: ti.template(), at, x, stretch):
        """x + l (dω × t + stretch t): what the end of an edge moves by, where its start moves by ``x``."""
        q = load4(scratch, at)
        length = scratch[at + chain.LENGTH * stride]
        w = load3(scratch, at + chain.ROTATION * stride)
        t = tangent(q)
        m1 = first_director(q)
        m2 = second_director(q)
        return (
            x[0] + length * (w[2] * m1[0] - w[1] * m2[0] + stretch * t[0]),
            x[1] + length * (w[2] * m1[1] - w[1] * m2[1] + stretch * t[1]),
            x[2] + length * (w[2] * m1[2] - w[1] * m2[2] + stretch * t[2]),
        )

    @ti.func
    def store_column(scratch: ti.template(), origin, edges, released, stretch, row, p, vertices: ti.template(),
                     rotations: ti.template()):
        x0, x1, x2 = (0.0 * released, 0.0 * released, 0.0 * released)
        if released > 0.5:  # held at the far end, which then stays where it is
            at = origin
            for _ in range(edges):
                x0, x1, x2 = moved_end(scratch, at, (x0, x1, x2), stretch)
                at += ti.static(items * stride)
            x0, x1, x2 = (0.0 - x0, 0.0 - x1, 0.0 - x2)
        at = origin
        for e in range(edges):
            vertices[row, e, 0, p], vertices[row, e, 1, p], vertices[row, e, 2, p] = (x0, x1, x2)
            for k in ti.static(range(3)):
                rotations[row, e, k, p] = scratch[at + (chain.ROTATION + k) * stride]
            x0, x1, x2 = moved_end(scratch, at, (x0, x1, x2), stretch)
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
        modes: ti.types.ndarray(dtype=ti.f64, ndim=3),  # [mode, joint, 2]
        threads: ti.i32, scratch: table1,
        vertices: table4, rotations: table4,  # [row, vertex or edge, 3, column] out
        sound: ti.types.ndarray(dtype=ti.i32, ndim=1),  # [row] out: one where the inertia is a minimum's
    ):
        ti.loop_config(block_dim=block)
        for thread in range(threads):
            edges = rest_length.shape[1]
            head = thread
            if ti.static(stride == 1):
                head = thread * (chain.PARAMETERS + items * edges)
            origin = head + ti.static(chain.PARAMETERS * stride)
            last = origin + (edges - 1) * ti.static(items * stride)
            tables = record(start=start, rest_length=rest_length, clamp=clamp, material=material, up=(up0, up1, up2), rods=rods,
                            frames=frames, results=material)
            rod = thread
            while rod < rods.shape[0]:
                row = rods[rod, OF_RESULT]
                loading.load(tables, scratch, head, 0, rod, 0.0)
                own = sweep.rods(scratch, head, edges, material, material, 0.0)
                closed, released, total, gravity, free = own.closed, own.released, own.total, own.gravity, own.free
                unit = scratch[head + chain.OF_UNIT * stride]
                none = 0.0 * unit
                multiplier = (none - end_force[row, 0] / unit, none - end_force[row, 1] / unit, none - end_force[row, 2] / unit)
                # A neutral motion shows when H is lowered a trace. Raised by one instead, H keeps the rod from moving along it.
                trace = TRACE * scratch[head + chain.OF_SCALE * stride]
                shift = none - trace
                inertia = none
                for _ in range(2):
                    bend_pairs(scratch, origin, edges)
                    inertia = sweep.eliminate(own, shift, (none, none), multiplier, (none, none, none)).inertia
                    shift = ti.select(inertia == INERTIA_OF_A_MINIMUM, none, trace)
                sound[row] = ti.cast(inertia == INERTIA_OF_A_MINIMUM, ti.i32)
                schur = schur_complement(scratch, origin, edges, closed)
                s = rods[rod, OF_CLAMP]
                holds_start = (1.0 - clamp[s, SPIN_START], 1.0 - clamp[s, TILT_START])
                holds_end = (1.0 - clamp[s, SPIN_END], 1.0 - clamp[s, TILT_END])
                for p in range(directions.shape[0]):
                    factor = 1.0 / unit
                    if directions[p, TIMES_WEIGHT] == 1.0:
                        factor = material[rods[rod, OF_MATERIAL], WEIGHT] / unit
                    pull = (factor * directions[p, PULL], factor * directions[p, PULL + 1], factor * directions[p, PULL + 2])
                    z = eliminate_column(
                        scratch, origin, edges, p, directions, modes, pull, unit, free, total, released, gravity, multiplier,
                        held_turn(scratch, origin, directions, p, TURN_START, holds_start),
                        held_turn(scratch, last, directions, p, TURN_END, holds_end))
                    solved, minors = solve_symmetric(schur, z)
                    force = (solved[0] * closed, solved[1] * closed, solved[2] * closed)
                    w0, w1, w2 = (none, none, none)
                    at = last
                    for _ in range(edges):
                        w0, w1, w2 = sweep.solved_edge(own, at, force, (w0, w1, w2))
                        at -= ti.static(items * stride)
                    store_column(scratch, origin, edges, released, directions[p, STRETCH], row, p, vertices, rotations)
                rod += threads

    return solve
