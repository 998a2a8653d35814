"""The paper's own relaxation scheme (§III-D), for many rods at once: the reference for Newton's basins.

Per iteration: a step down the gradient of E with respect to the vertices, twist angles held; frames follow their tangents
by parallel transport; twist angles are minimised (one Newton round, exact for isotropic rods); vertices are reprojected onto
inextensibility and the clamps by fast projection, a tridiagonal system per round, with the multipliers of the last
projection in the gradient (augmented Lagrangian). The step length is spectral (Barzilai–Borwein), capped to a small
fraction of an edge so that the path stays close to steepest descent, and accepted against a running mean of the energy.
"""

from dataclasses import dataclass
from functools import lru_cache

import taichi as ti

from doo_ti.errors import InputError
from doo_ti.newton import CLOSURE, ENERGY, ITERATIONS, RELEASED, RESIDUAL, SPIN_END, SPIN_START, STABLE, STATUS
from doo_ti.newton import TARGET, TILT_END, TILT_START, CLOSED
from doo_ti.physics import vertex_form
from doo_ti.physics.algebra import absolute, cross, dot, larger
from doo_ti.physics.angle import signed_angle_function
from doo_ti.physics.number import Number
from doo_ti.types import Status


@dataclass(frozen=True)
class Descent:
    """Options of the descent solver.

    tolerance       scaled residual to reach, 1/mm
    max_iterations  gradient steps allowed per rod
    largest_move    largest move of a vertex in one step, over its edge length: smaller follows the path more closely
    """

    tolerance: float = 1e-6
    max_iterations: int = 100_000
    largest_move: float = 0.05

    def __post_init__(self):
        if not self.tolerance > 0:
            raise InputError("Descent", "tolerance", f"{self.tolerance} is not positive", "give a positive number")
        if self.max_iterations < 1:
            raise InputError("Descent", "max_iterations", f"{self.max_iterations} is below one", "give one or more")
        if not 0 < self.largest_move <= 0.2:
            raise InputError("Descent", "largest_move", f"{self.largest_move}", "give a fraction above 0, at most 0.2")


# Items in scratch, per vertex (with the edge that leaves it; the last vertex has a row of its own).
POSITION = 0
DIRECTOR = 3
FORCE = 6  # projected gradient at the vertex
TRIAL_POSITION = 9
TRIAL_DIRECTOR = 12
TRIAL_FORCE = 15
RATIO = 18  # elimination factor and right-hand side of the tridiagonal systems
RIGHT = 19
LENGTH = 20
INVERSE_LENGTH = 21
BEND = 22
TWIST = 25
REST = 26
ITEMS = 28

PROJECTION_ROUNDS = 2
LONG_STEP_EVERY = 12.0
MEMORY = 0.9  # weight of the past in the running mean of the energy
PATIENCE = 20_000  # iterations in which neither energy nor residual came down noticeably


@lru_cache(maxsize=None)
def descent_kernel(number: Number, stride: int, block: int):
    """The kernel for one kind of number; materials are always general. See :func:`doo_ti.newton.newton_kernel`."""
    largest, lane, with_lane, constant, put = number.lanes()
    signed_angle = signed_angle_function(number)
    width, scalar = number.width, number.scalar
    rounding = 2e-6 if number.bits == 32 else 1e-13
    row = ITEMS * stride
    table1 = ti.types.ndarray(dtype=ti.f64, ndim=1)
    table2 = ti.types.ndarray(dtype=ti.f64, ndim=2)
    table3 = ti.types.ndarray(dtype=ti.f64, ndim=3)

    @ti.func
    def load3(scratch: ti.template(), at):
        return (scratch[at], scratch[at + stride], scratch[at + 2 * stride])

    @ti.func
    def store3(scratch: ti.template(), at, v):
        for k in ti.static(range(3)):
            scratch[at + k * stride] = v[k]

    @ti.func
    def edge_vector(scratch: ti.template(), at, item):
        return (
            scratch[at + row + item * stride] - scratch[at + item * stride],
            scratch[at + row + (item + 1) * stride] - scratch[at + (item + 1) * stride],
            scratch[at + row + (item + 2) * stride] - scratch[at + (item + 2) * stride],
        )

    @ti.func
    def mobility(vertex, edges, held):
        """One where the vertex may move. ``held`` = (vertex 0, vertex 1, vertex E−1, vertex E) held."""
        free = 0.0 * held[0] + 1.0
        if vertex == 0:
            free = free - held[0]
        if vertex == 1:
            free = free - held[1]
        if vertex == edges - 1:
            free = free * (1.0 - held[2])
        if vertex == edges:
            free = free * (1.0 - held[3])
        return free

    @ti.func
    def eliminate_lengths(scratch: ti.template(), origin, edges, item, held, of_gradient: ti.template()):
        """Forward half of (J Jᵀ) y = b, J the Jacobian of (|e|² − l²)/2l at the trial vertices; b is J times the trial
        gradient, or the violated constraints themselves."""
        one = 0.0 * held[0] + 1.0
        p0, p1, p2 = (one, one, one)
        ratio = 0.0 * one
        right = 0.0 * one
        at = origin
        for e in range(edges):
            length = scratch[at + LENGTH * stride]
            v = edge_vector(scratch, at, item)
            u = (v[0] / length, v[1] / length, v[2] / length)
            here = mobility(e, edges, held)
            there = mobility(e + 1, edges, held)
            value = 0.5 * (dot(u, v) - length)
            if ti.static(of_gradient):
                g0 = load3(scratch, at + TRIAL_FORCE * stride)
                g1 = load3(scratch, at + row + TRIAL_FORCE * stride)
                value = there * dot(u, g1) - here * dot(u, g0)
            off = 0.0 * one
            if e > 0:
                off = 0.0 - here * dot((p0, p1, p2), u)
            pivot = (here + there) * dot(u, u) - off * ratio
            pivot = ti.select(here + there > 0.5, pivot, one)
            right = (value - off * right) / pivot
            right = ti.select(here + there > 0.5, right, 0.0 * one)
            scratch[at + RIGHT * stride] = right
            # Coupling to the next edge, needed here so that the ratio is known going back.
            ratio = 0.0 * one
            if e < edges - 1:
                v_next = edge_vector(scratch, at + row, item)
                l_next = scratch[at + row + LENGTH * stride]
                ratio = 0.0 - there * dot(u, v_next) / l_next / pivot
                ratio = ti.select(here + there > 0.5, ratio, 0.0 * one)
            scratch[at + RATIO * stride] = ratio
            p0, p1, p2 = u
            at += row

    @ti.func
    def apply_lengths(scratch: ti.template(), origin, edges, held, of_gradient: ti.template()):
        """Backward half: take Jᵀ y off the trial vertices, or off the trial gradient (which it masks where held).

        Returns Σ |gradient| over the vertices (zero for positions)."""
        zero = 0.0 * held[0]
        y = zero
        p0, p1, p2 = (zero, zero, zero)
        total = zero
        at = origin + (edges - 1) * row
        for k in range(edges):
            e = edges - 1 - k
            length = scratch[at + LENGTH * stride]
            v = edge_vector(scratch, at, TRIAL_POSITION)
            y = scratch[at + RIGHT * stride] - scratch[at + RATIO * stride] * y
            n0, n1, n2 = (v[0] * y / length, v[1] * y / length, v[2] * y / length)
            there = mobility(e + 1, edges, held)
            item = ti.static(TRIAL_FORCE if of_gradient else TRIAL_POSITION)
            x = load3(scratch, at + row + item * stride)
            d0, d1, d2 = (there * (n0 - p0), there * (n1 - p1), there * (n2 - p2))
            if ti.static(of_gradient):
                new = (there * x[0] - d0, there * x[1] - d1, there * x[2] - d2)
                store3(scratch, at + row + item * stride, new)
                total = total + ti.sqrt(dot(new, new))
            else:
                store3(scratch, at + row + item * stride, (x[0] - d0, x[1] - d1, x[2] - d2))
            p0, p1, p2 = (n0, n1, n2)
            at -= row
        here = mobility(0, edges, held)
        item = ti.static(TRIAL_FORCE if of_gradient else TRIAL_POSITION)
        x = load3(scratch, origin + item * stride)
        if ti.static(of_gradient):
            new = (here * (x[0] + p0), here * (x[1] + p1), here * (x[2] + p2))
            store3(scratch, origin + item * stride, new)
            total = total + ti.sqrt(dot(new, new))
        else:
            store3(scratch, origin + item * stride, (x[0] + here * p0, x[1] + here * p1, x[2] + here * p2))
        return total

    @ti.func
    def move(scratch: ti.template(), origin, edges, step, held):
        """Trial vertices: the step down the gradient, the projection, and the frames carried along."""
        at = origin
        for v in range(edges + 1):
            x = load3(scratch, at + POSITION * stride)
            g = load3(scratch, at + FORCE * stride)
            store3(scratch, at + TRIAL_POSITION * stride, (x[0] - step * g[0], x[1] - step * g[1], x[2] - step * g[2]))
            at += row
        for r in ti.static(range(PROJECTION_ROUNDS)):
            eliminate_lengths(scratch, origin, edges, TRIAL_POSITION, held, False)
            apply_lengths(scratch, origin, edges, held, False)
        at = origin
        for e in range(edges):
            old = direction(edge_vector(scratch, at, POSITION))
            new = direction(edge_vector(scratch, at, TRIAL_POSITION))
            m1 = vertex_form.transported(old, new, load3(scratch, at + DIRECTOR * stride))
            store3(scratch, at + TRIAL_DIRECTOR * stride, vertex_form.across(m1, new))
            at += row

    @ti.func
    def direction(v):
        scale = 1.0 / ti.sqrt(dot(v, v))
        return (v[0] * scale, v[1] * scale, v[2] * scale)

    @ti.func
    def joint(scratch: ti.template(), at):
        """What happens at the vertex between the edges at ``at`` and after it, from the trial vertices and directors."""
        after = at + row
        a = edge_vector(scratch, at, TRIAL_POSITION)
        b = edge_vector(scratch, after, TRIAL_POSITION)
        la = scratch[at + LENGTH * stride]
        lb = scratch[after + LENGTH * stride]
        inverse = scratch[after + INVERSE_LENGTH * stride]
        kb, bottom = vertex_form.curvature_binormal(a, b, la, lb)
        ta = direction(a)
        tb = direction(b)
        m1a = load3(scratch, at + TRIAL_DIRECTOR * stride)
        m1b = load3(scratch, after + TRIAL_DIRECTOR * stride)
        m2a = cross(ta, m1a)
        m2b = cross(tb, m1b)
        reference = vertex_form.transported(ta, tb, m1a)
        twist = signed_angle(dot(reference, m1b), dot(cross(reference, m1b), tb))
        rest = (scratch[after + REST * stride], scratch[after + (REST + 1) * stride])
        oa = vertex_form.material_curvature(kb, m1a, m2a)
        ob = vertex_form.material_curvature(kb, m1b, m2b)
        fa = vertex_form.bend_moment(load3(scratch, at + BEND * stride), oa, rest, inverse)
        fb = vertex_form.bend_moment(load3(scratch, after + BEND * stride), ob, rest, inverse)
        return (a, b, la, lb, kb, bottom, m1a, m2a, m1b, m2b, twist, rest, oa, ob, fa, fb, inverse)

    @ti.func
    def minimise_twist(scratch: ti.template(), origin, edges, spin_start, spin_end):
        """One Newton round on the twist angles, the vertices held: a scalar tridiagonal system."""
        one = 0.0 * spin_start + 1.0
        zero = 0.0 * one
        gradient = zero
        curvature = zero
        ratio = zero
        right = zero
        coupling = zero
        at = origin
        for e in range(edges):
            g = gradient
            h = curvature
            gradient = zero
            curvature = zero
            b2 = zero
            if e < edges - 1:
                a, b, la, lb, kb, bottom, m1a, m2a, m1b, m2b, twist, rest, oa, ob, fa, fb, inverse = joint(scratch, at)
                b2 = 2.0 * scratch[at + row + TWIST * stride] * inverse
                first, second = vertex_form.spin_derivatives(load3(scratch, at + BEND * stride), fa, oa, inverse)
                g = g + first - b2 * twist
                h = h + second + b2
                first, second = vertex_form.spin_derivatives(load3(scratch, at + row + BEND * stride), fb, ob, inverse)
                gradient = first + b2 * twist
                curvature = second + b2
            free = one
            if e == 0:
                free = spin_start
            if e == edges - 1:
                free = spin_end
            after_free = one
            if e == edges - 2:
                after_free = spin_end
            pivot = h - coupling * ratio
            pivot = ti.select((free > 0.5) & (pivot > 0.0), pivot, one)
            right = free * (0.0 - g - coupling * right) / pivot
            coupling = 0.0 - b2 * free * after_free
            ratio = coupling / pivot
            scratch[at + RIGHT * stride] = right
            scratch[at + RATIO * stride] = ratio
            at += row
        angle = zero
        at = origin + (edges - 1) * row
        for e in range(edges):
            angle = scratch[at + RIGHT * stride] - scratch[at + RATIO * stride] * angle
            t = direction(edge_vector(scratch, at, TRIAL_POSITION))
            m1 = load3(scratch, at + TRIAL_DIRECTOR * stride)
            turn = ti.min(ti.max(angle, 0.0 * angle - 0.5), 0.0 * angle + 0.5)
            store3(scratch, at + TRIAL_DIRECTOR * stride, vertex_form.spun(m1, cross(t, m1), turn))
            at -= row

    @ti.func
    def evaluate(scratch: ti.template(), origin, edges, gravity, spin_start, spin_end):
        """Energy, its magnitude and the largest moment of spin; the gradient goes to TRIAL_FORCE."""
        zero = 0.0 * spin_start
        energy = zero
        potential = zero
        magnitude = zero
        spin = zero
        unspent = zero
        n0, n1, n2 = (zero, zero, zero)
        carried = zero
        at = origin
        before = zero
        for v in range(edges + 1):
            # ∂E/∂x_v = N_{v−1} − N_v + μ l̄_v up, N_j the derivative with respect to edge j.
            length = zero
            if v < edges:
                length = scratch[at + LENGTH * stride]
            weight = before + length
            before = length
            x = load3(scratch, at + TRIAL_POSITION * stride)
            hang = weight * dot(gravity, x)
            potential = potential + hang
            magnitude = magnitude + absolute(hang)
            f0, f1, f2 = (n0 + weight * gravity[0], n1 + weight * gravity[1], n2 + weight * gravity[2])
            # Take the next edge's derivative: what the vertex before left for it, and the joint after it.
            n0, n1, n2 = (zero, zero, zero)
            if v < edges:
                n0, n1, n2 = load3(scratch, at + TRIAL_FORCE * stride)
                if v == 0:
                    n0, n1, n2 = (zero, zero, zero)
                moment = carried
                carried = zero
                if v < edges - 1:
                    a, b, la, lb, kb, bottom, m1a, m2a, m1b, m2b, twist, rest, oa, ob, fa, fb, inverse = joint(scratch, at)
                    beta = scratch[at + row + TWIST * stride] * inverse
                    energy = energy + beta * twist * twist + vertex_form.bend_energy(fa, oa, rest)
                    energy = energy + vertex_form.bend_energy(fb, ob, rest)
                    pa, pb = vertex_form.bend_force(fa, fb, m1a, m2a, m1b, m2b, kb, bottom, a, b)
                    # Holonomy: δm = ½ κb·(δe⁻/|e⁻| + δe⁺/|e⁺|).
                    ha = beta * twist / la
                    hb = beta * twist / lb
                    n0, n1, n2 = (n0 + pa[0] + ha * kb[0], n1 + pa[1] + ha * kb[1], n2 + pa[2] + ha * kb[2])
                    store3(scratch, at + row + TRIAL_FORCE * stride,
                           (pb[0] + hb * kb[0], pb[1] + hb * kb[1], pb[2] + hb * kb[2]))
                    first, unspent = vertex_form.spin_derivatives(load3(scratch, at + BEND * stride), fa, oa, inverse)
                    moment = moment + first - 2.0 * beta * twist
                    first, unspent = vertex_form.spin_derivatives(
                        load3(scratch, at + row + BEND * stride), fb, ob, inverse)
                    carried = first + 2.0 * beta * twist
                if v == 0:
                    moment = moment * spin_start
                if v == edges - 1:
                    moment = moment * spin_end
                spin = larger(spin, absolute(moment))
            store3(scratch, at + TRIAL_FORCE * stride, (f0 - n0, f1 - n1, f2 - n2))
            at += row
        return energy + potential, energy + magnitude, spin

    @ti.func
    def adopt(scratch: ti.template(), origin, edges, accepted):
        """Make the trial the state where accepted; returns s·s, s·y, y·y of the change of vertices and gradient, and the
        largest gradient of any vertex."""
        zero = 0.0 * accepted
        ss, sy, yy, top = (zero, zero, zero, zero)
        at = origin
        for v in range(edges + 1):
            for k in ti.static(range(3)):
                x = scratch[at + (POSITION + k) * stride]
                g = scratch[at + (FORCE + k) * stride]
                new_x = scratch[at + (TRIAL_POSITION + k) * stride]
                new_g = scratch[at + (TRIAL_FORCE + k) * stride]
                dx = new_x - x
                dg = new_g - g
                ss = ss + dx * dx
                sy = sy + dx * dg
                yy = yy + dg * dg
                scratch[at + (POSITION + k) * stride] = ti.select(accepted > 0.5, new_x, x)
                scratch[at + (FORCE + k) * stride] = ti.select(accepted > 0.5, new_g, g)
                old = scratch[at + (DIRECTOR + k) * stride]
                scratch[at + (DIRECTOR + k) * stride] = ti.select(
                    accepted > 0.5, scratch[at + (TRIAL_DIRECTOR + k) * stride], old)
            f = load3(scratch, at + FORCE * stride)
            top = ti.max(top, dot(f, f))
            at += row
        return ss, sy, yy, ti.sqrt(top)

    @ti.func
    def load_rod(scratch: ti.template(), origin, edges, l, s, g, vertices: ti.template(), directors: ti.template(),
                 rest_length: ti.template(), bend: ti.template(), twist: ti.template(), rest: ti.template()):
        """One rod's start and stiffness into lane l; returns (longest edge, shortest edge)."""
        ls = ti.min(s, rest_length.shape[0] - 1)
        longest = ti.cast(0.0, ti.f64)
        shortest = ti.cast(1e30, ti.f64)
        at = origin
        for v in range(edges + 1):
            for k in ti.static(range(3)):
                put(scratch, at + (POSITION + k) * stride, l, vertices[s, v, k])
                put(scratch, at + (FORCE + k) * stride, l, 0.0)
            if v < edges:
                longest = ti.max(longest, rest_length[ls, v])
                shortest = ti.min(shortest, rest_length[ls, v])
                put(scratch, at + LENGTH * stride, l, rest_length[ls, v])
                for k in ti.static(range(3)):
                    put(scratch, at + (DIRECTOR + k) * stride, l, directors[s, v, k])
                    put(scratch, at + (BEND + k) * stride, l, bend[g, ti.min(v, bend.shape[1] - 1), k])
                if v > 0:
                    both = rest_length[ls, v - 1] + rest_length[ls, v]
                    put(scratch, at + INVERSE_LENGTH * stride, l, 1.0 / both)
                    put(scratch, at + TWIST * stride, l, twist[g, ti.min(v, twist.shape[1]) - 1])
                    for k in ti.static(range(2)):
                        put(scratch, at + (REST + k) * stride, l,
                            0.5 * both * rest[g, ti.min(v, rest.shape[1]) - 1, k])
            at += row
        return longest, shortest

    @ti.kernel
    def descent(
        vertices: table3,  # [configuration, vertex, 3] mm from the anchor
        directors: table3,  # [configuration, edge, 3] m1
        rest_length: table2,  # [1 or configuration, edge] mm
        clamp: table2,  # [configuration, CLAMP_COLUMNS]
        bend: table3,  # [material, 1 or edge, (11, 22, 12)] mm³
        twist: table2,  # [material, 1 or inner vertex] mm³
        rest: table3,  # [material, 1 or inner vertex, 2] 1/mm
        weight: table1,  # [material]
        rods: ti.types.ndarray(dtype=ti.i32, ndim=2),  # [rod, (configuration, material, row of the results)]
        divisor: table1,  # [rod] of the scaled residual
        up: ti.math.vec3,
        tolerance: ti.f64,
        max_iterations: ti.i32,
        largest_move: ti.f64,
        threads: ti.i32,
        origin_stride: ti.i32,
        scratch: ti.types.ndarray(dtype=number.type, ndim=1),
        lane_rod: ti.types.ndarray(dtype=ti.i32, ndim=1),  # [thread · lane]
        queue: ti.types.ndarray(dtype=ti.i32, ndim=1),  # [1] the next rod
        positions: table3,  # [rod, vertex, 3] out
        material_axes: table3,  # [rod, edge, 3] out: m1
        results: table2,  # [rod, RESULTS] out
    ):
        edges = directors.shape[1]
        ti.loop_config(block_dim=block)
        for thread in range(threads):
            origin = thread * origin_stride
            zero = constant(0.0)
            one = constant(1.0)
            held_first, held_second, held_inner, held_last = (zero, zero, zero, zero)
            spin_start, spin_end, length, scale, limit_move = (zero, zero, one, one, one)
            gravity0, gravity1, gravity2 = (zero, zero, zero)
            energy, lowest, mean, count, step, residual, best = (zero, zero, zero, zero, zero, zero, one)
            fresh, trips, still, status = (zero, zero, zero, zero)
            short0, short1, short2 = (one, one, one)
            active, finished = (zero, one)
            running = 1
            while running == 1:
                if largest(finished) > 0.5:
                    for l in range(width):
                        if lane(finished, l) > 0.5:
                            finished = with_lane(finished, l, 0.0)
                            if lane(active, l) > 0.5:
                                place = rods[lane_rod[thread * width + l], 2]
                                at = origin
                                for v in range(edges + 1):
                                    for k in ti.static(range(3)):
                                        positions[place, v, k] = lane(scratch[at + (POSITION + k) * stride], l)
                                        if v < edges:
                                            material_axes[place, v, k] = lane(
                                                scratch[at + (DIRECTOR + k) * stride], l)
                                    at += row
                                results[place, ENERGY] = lane(energy, l)
                                results[place, RESIDUAL] = lane(residual, l)
                                results[place, CLOSURE] = 0.0
                                results[place, ITERATIONS] = lane(trips, l)
                                results[place, STATUS] = lane(status, l)
                                results[place, STABLE] = 0.0
                            active = with_lane(active, l, 0.0)
                            rod = ti.atomic_add(queue[0], 1)
                            if rod < rods.shape[0]:
                                lane_rod[thread * width + l] = rod
                                s = rods[rod, 0]
                                g = rods[rod, 1]
                                longest, shortest = load_rod(scratch, origin, edges, l, s, g, vertices, directors,
                                                             rest_length, bend, twist, rest)
                                length = with_lane(length, l, longest)
                                limit_move = with_lane(limit_move, l, largest_move * shortest)
                                scale = with_lane(scale, l, divisor[rods[rod, 2]])
                                start_held = ti.max(clamp[s, CLOSED], 1.0 - clamp[s, RELEASED])
                                end_held = ti.max(clamp[s, CLOSED], clamp[s, RELEASED])
                                held_first = with_lane(held_first, l, start_held)
                                held_second = with_lane(held_second, l, start_held * (1.0 - clamp[s, TILT_START]))
                                held_inner = with_lane(held_inner, l, end_held * (1.0 - clamp[s, TILT_END]))
                                held_last = with_lane(held_last, l, end_held)
                                spin_start = with_lane(spin_start, l, clamp[s, SPIN_START])
                                spin_end = with_lane(spin_end, l, clamp[s, SPIN_END])
                                gravity0 = with_lane(gravity0, l, weight[g] * up[0])
                                gravity1 = with_lane(gravity1, l, weight[g] * up[1])
                                gravity2 = with_lane(gravity2, l, weight[g] * up[2])
                                count = with_lane(count, l, 0.0)
                                step = with_lane(step, l, 0.0)
                                best = with_lane(best, l, 1e30)
                                lowest = with_lane(lowest, l, 1e30)
                                fresh = with_lane(fresh, l, 1.0)
                                short0 = with_lane(short0, l, 1e30)
                                short1 = with_lane(short1, l, 1e30)
                                short2 = with_lane(short2, l, 1e30)
                                trips = with_lane(trips, l, 0.0)
                                still = with_lane(still, l, 0.0)
                                active = with_lane(active, l, 1.0)
                if largest(active) < 0.5:
                    running = 0
                else:
                    held = (held_first, held_second, held_inner, held_last)
                    move(scratch, origin, edges, step, held)
                    minimise_twist(scratch, origin, edges, spin_start, spin_end)
                    new_energy, magnitude, spin = evaluate(
                        scratch, origin, edges, (gravity0, gravity1, gravity2), spin_start, spin_end)
                    eliminate_lengths(scratch, origin, edges, TRIAL_POSITION, held, True)
                    force = apply_lengths(scratch, origin, edges, held, True)
                    tolerated = mean + rounding * magnitude
                    sound = new_energy == new_energy
                    accepted = ti.select(sound & ((fresh > 0.5) | (new_energy <= tolerated)), one, zero)
                    ss, sy, yy, top = adopt(scratch, origin, edges, accepted)
                    # The largest moment is at most the longest edge times the sum of forces: an upper bound, no estimate.
                    bound = (length * force + spin) / scale
                    residual = ti.select(accepted > 0.5, bound, residual)
                    energy = ti.select(accepted > 0.5, new_energy, energy)
                    heavier = MEMORY * count + 1.0
                    mean = ti.select(accepted > 0.5, (MEMORY * count * mean + new_energy) / heavier, mean)
                    count = ti.select(accepted > 0.5, heavier, count)
                    # Barzilai–Borwein: the long step s·s/s·y, or where the gradient is mostly stiff directions the shortest of
                    # the last four short ones s·y/y·y; now and then a long one all the same, to get on in narrow valleys.
                    curved = sy > 0.0
                    shortest_step = ti.min(ti.min(sy / yy, short0), ti.min(short1, short2))
                    phase = trips - LONG_STEP_EVERY * ti.floor(trips / LONG_STEP_EVERY)
                    spectral = ti.select((sy * sy < 0.5 * ss * yy) & (phase > 0.5), shortest_step, ss / sy)
                    store_short = curved & (accepted > 0.5)
                    short2 = ti.select(store_short, short1, short2)
                    short1 = ti.select(store_short, short0, short1)
                    short0 = ti.select(store_short, sy / yy, short0)
                    longer = ti.select(curved, spectral, 2.0 * step)
                    first = 0.05 * limit_move / (top + 1e-30)
                    chosen = ti.select(fresh > 0.5, first, longer)
                    step = ti.select(accepted > 0.5, ti.min(chosen, limit_move / (top + 1e-30)), 0.25 * step)
                    lost = ((fresh > 0.5) & (accepted < 0.5)) | (residual != residual)
                    progress = (residual < 0.9 * best) | (energy < lowest - 1e-7 * magnitude)
                    lowest = ti.select(progress, energy, lowest)
                    best = ti.select(progress, ti.min(best, residual), best)
                    still = ti.select(progress, zero, still + 1.0)
                    fresh = zero
                    trips = trips + active
                    ended = residual <= ti.cast(tolerance, scalar)
                    late = trips >= ti.cast(max_iterations, scalar)
                    stuck = still > PATIENCE
                    status = ti.select(stuck, constant(int(Status.STALLED)), constant(int(Status.ITERATION_LIMIT)))
                    status = ti.select(lost, constant(int(Status.NOT_FINITE)), status)
                    status = ti.select(ended, constant(int(Status.CONVERGED)), status)
                    finished = ti.select((ended | late | stuck | lost) & (active > 0.5), one, zero)

    return descent
