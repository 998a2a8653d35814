"""Sweeps along a rod in the paper's own variables, vertices and material frames: step, projection, twist, gradient (§III-D).

The counterpart of :mod:`doo_ti.relaxation.chain` for :mod:`doo_ti.relaxation.descent`. Scratch holds, per vertex and the edge
that leaves it, the
items named below; ``number`` says how many rods a value holds and ``stride`` how far apart the items of a vertex lie.
"""

from types import SimpleNamespace

import taichi as ti

from doo_ti.physics import vertex_form
from doo_ti.physics.algebra import absolute, larger
from doo_ti.physics.angle import signed_angle_function
from doo_ti.physics.tuples import cross, dot

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


def vertex_sweeps(number, stride: int) -> SimpleNamespace:
    """The sweeps as Taichi functions for one kind of number; materials are always general.

    ``held`` = (vertex 0, vertex 1, vertex E−1, vertex E, all) is one where the vertex is held; ``spin_start`` and
    ``spin_end`` are one where the first and last frame may spin.
    """
    signed_angle = signed_angle_function(number)
    put = number.lanes().put
    row = ITEMS * stride

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
        """One where the vertex may move."""
        free = 1.0 - held[4]
        if vertex == 0:
            free = free * (1.0 - held[0])
        if vertex == 1:
            free = free * (1.0 - held[1])
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
    def load_rod(scratch: ti.template(), origin, edges, slot, s, g, vertices: ti.template(), directors: ti.template(),
                 rest_length: ti.template(), bend: ti.template(), twist: ti.template(), rest: ti.template()):
        """One rod's start and stiffness into lane ``slot``; returns (longest edge, shortest edge)."""
        ls = ti.min(s, rest_length.shape[0] - 1)
        longest = ti.cast(0.0, ti.f64)
        shortest = ti.cast(1e30, ti.f64)
        at = origin
        for v in range(edges + 1):
            for k in ti.static(range(3)):
                put(scratch, at + (POSITION + k) * stride, slot, vertices[s, v, k])
                put(scratch, at + (FORCE + k) * stride, slot, 0.0)
            if v < edges:
                longest = ti.max(longest, rest_length[ls, v])
                shortest = ti.min(shortest, rest_length[ls, v])
                put(scratch, at + LENGTH * stride, slot, rest_length[ls, v])
                for k in ti.static(range(3)):
                    put(scratch, at + (DIRECTOR + k) * stride, slot, directors[s, v, k])
                    put(scratch, at + (BEND + k) * stride, slot, bend[g, ti.min(v, bend.shape[1] - 1), k])
                if v > 0:
                    both = rest_length[ls, v - 1] + rest_length[ls, v]
                    put(scratch, at + INVERSE_LENGTH * stride, slot, 1.0 / both)
                    put(scratch, at + TWIST * stride, slot, twist[g, ti.min(v, twist.shape[1]) - 1])
                    for k in ti.static(range(2)):
                        put(scratch, at + (REST + k) * stride, slot,
                            0.5 * both * rest[g, ti.min(v, rest.shape[1]) - 1, k])
            at += row
        return longest, shortest

    return SimpleNamespace(
        load_rod=load_rod, move=move, minimise_twist=minimise_twist, evaluate=evaluate,
        eliminate_lengths=eliminate_lengths, apply_lengths=apply_lengths, adopt=adopt,
    )
