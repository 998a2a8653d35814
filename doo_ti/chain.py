"""Sweeps along a rod whose state lies in scratch: step, projection, energy, and the block-tridiagonal Newton system.

The Hessian of a chain of frames is block-tridiagonal with 3×3 blocks, bordered by the three columns A of closure. One
forward sweep assembles and eliminates it, one backward sweep gives the step (§III-D). Scratch holds, per edge, the items
named below; ``number`` says how many rods a value holds and ``stride`` how far apart the items of an edge lie.
"""

from types import SimpleNamespace

import taichi as ti

from doo_ti.physics import pair
from doo_ti.physics.algebra import (
    absolute,
    backward,
    dot,
    factor,
    forward,
    larger,
    largest_component,
    positive_eigenvalues,
    solve_symmetric,
    weighted,
)
from doo_ti.physics.angle import twist_angle_function
from doo_ti.physics.closure import closing_rotation, linear_gradient, linear_hessian, normal_matrix
from doo_ti.physics.quaternion import first_director, second_director, tangent, turned_in_body, turned_in_world

# Items of an edge in scratch. Those of a vertex (1/l̄, β, ω̄) lie with the edge that leaves it.
FRAME = 0
TRIAL = 4
LENGTH = 8
INVERSE_LENGTH = 9
ROTATION = 10  # the right-hand side while eliminating, the step after back-substitution
ELIMINATED_NEXT = 13
ELIMINATED_CLOSURE = 22
PIVOTS = 31
ISOTROPIC_ITEMS = 37
BEND = 37
TWIST = 40
REST = 41
GENERAL_ITEMS = 43


def chain_sweeps(number, isotropic: bool, stride: int) -> SimpleNamespace:
    """The sweeps as Taichi functions for one kind of number and of material.

    ``free = (spin_start, tilt_start, spin_end, tilt_end, tilt_inner)`` is one where that rotation of the first edge, of
    the last or of those between is unknown, zero where it is held. ``closed`` is one where the far point is fixed.
    ``material`` is (α, β) for isotropic rods and unused otherwise; ``gravity`` is μ times the unit vector up,
    ``released`` one where vertex 0 is free and the far end holds the rod.
    """
    twist_angle = twist_angle_function(number)
    items = ISOTROPIC_ITEMS if isotropic else GENERAL_ITEMS
    largest = number.lanes()[0]

    @ti.func
    def load3(scratch: ti.template(), at):
        return (scratch[at], scratch[at + stride], scratch[at + 2 * stride])

    @ti.func
    def load4(scratch: ti.template(), at):
        return (scratch[at], scratch[at + stride], scratch[at + 2 * stride], scratch[at + 3 * stride])

    @ti.func
    def load6(scratch: ti.template(), at):
        return load3(scratch, at) + load3(scratch, at + 3 * stride)

    @ti.func
    def store(scratch: ti.template(), at, values):
        for k in ti.static(range(len(values))):
            scratch[at + k * stride] = values[k]

    @ti.func
    def stiffness(scratch: ti.template(), left, right, material):
        """Stiffness tuple of :mod:`doo_ti.physics.pair` for the vertex between two neighbouring edges."""
        inverse = scratch[right + INVERSE_LENGTH * stride]
        if ti.static(isotropic):
            return (material[0] * inverse, material[1] * inverse)
        else:
            return (
                load3(scratch, left + BEND * stride),
                load3(scratch, right + BEND * stride),
                inverse,
                scratch[right + TWIST * stride] * inverse,
                (scratch[right + REST * stride], scratch[right + (REST + 1) * stride]),
            )

    @ti.func
    def energy_and_gradient(p, q, s):
        x, y, inverse, turn, r, root = pair.curvature(p, q)
        m = twist_angle(r, root)
        if ti.static(isotropic):
            left, right = pair.isotropic_gradient(x, y, inverse, m, s)
            return pair.isotropic_energy(x, m, s), left, right
        else:
            left, right = pair.general_gradient(x, y, inverse, turn, m, s)
            return pair.general_energy(x, y, m, s), left, right

    @ti.func
    def derivatives(p, q, s):
        x, y, inverse, turn, r, root = pair.curvature(p, q)
        m = twist_angle(r, root)
        if ti.static(isotropic):
            g_left, g_right = pair.isotropic_gradient(x, y, inverse, m, s)
            h_left, h_right, h_across = pair.isotropic_hessian(x, y, inverse, turn, m, s)
            return g_left, g_right, h_left, h_right, h_across
        else:
            g_left, g_right = pair.general_gradient(x, y, inverse, turn, m, s)
            h_left, h_right, h_across = pair.general_hessian(x, y, inverse, turn, m, s)
            return g_left, g_right, h_left, h_right, h_across

    @ti.func
    def tilt_of(edge, edges, free):
        """One where the edge may tilt."""
        tilt = free[4]
        if edge == 0:
            tilt = free[1]
        if edge == edges - 1:
            tilt = free[3]
        return tilt

    @ti.func
    def hanging_weight(length, remaining, total, released):
        """Coefficient of gravity on an edge: Σ_{i>j} l̄_i, less Σ_i l̄_i where the rod hangs from its far end."""
        return length + 2.0 * remaining - 2.0 * total * released

    @ti.func
    def step(scratch: ti.template(), origin, edges, scale, target, closed, free):
        """Trial frames Q (1, scale ω/2), then how far they miss closure, and x of the projection that puts it back."""
        zero = 0.0 * scale
        c0, c1, c2 = (zero, zero, zero)
        n0, n1, n2, n3, n4, n5 = (zero, zero, zero, zero, zero, zero)
        at = origin
        for e in range(edges):
            w = load3(scratch, at + ROTATION * stride)
            q = turned_in_body(load4(scratch, at), (w[0] * scale, w[1] * scale, w[2] * scale))
            store(scratch, at + TRIAL * stride, q)
            length = scratch[at + LENGTH * stride]
            t = tangent(q)
            c0, c1, c2 = (c0 + length * t[0], c1 + length * t[1], c2 + length * t[2])
            a = normal_matrix(length, t)
            tilt = tilt_of(e, edges, free)
            n0, n1, n2 = (n0 + tilt * a[0], n1 + tilt * a[1], n2 + tilt * a[2])
            n3, n4, n5 = (n3 + tilt * a[3], n4 + tilt * a[4], n5 + tilt * a[5])
            at += ti.static(items * stride)
        miss = ((c0 - target[0]) * closed, (c1 - target[1]) * closed, (c2 - target[2]) * closed)
        x, minors = solve_symmetric(_regular((n0, n1, n2, n3, n4, n5)), miss)
        # x·miss is the sum of the squared rotations: keep their root mean square below 0.15 rad in one projection.
        size = ti.sqrt(ti.max(dot(x, miss), zero) / ti.cast(edges, number.scalar)) + 1e-30
        shrink = ti.min(0.0 * size + 1.0, 0.15 / size)
        return (x[0] * shrink, x[1] * shrink, x[2] * shrink)

    @ti.func
    def _regular(n):
        """AᵀA made regular where all free edges are parallel."""
        e = ti.static(1e-6 if number.bits == 32 else 1e-13) * (n[0] + n[3] + n[5]) + 1e-30
        return (n[0] + e, n[1], n[2], n[3] + e, n[4], n[5] + e)

    @ti.func
    def project(scratch: ti.template(), origin, edges, x, material, gravity, target, closed, free, total, released):
        """Close the trial frames by the minimum-norm rotation of :func:`step`, then evaluate them.

        Returns energy (gravity from vertex 0 or the far point), its magnitude (sum of absolute terms, the scale of its
        rounding), what closure is left, and the least-squares multiplier λ = −(AᵀA)⁻¹ Aᵀ g.
        """
        zero = 0.0 * total
        energy = zero
        potential = zero
        magnitude = zero
        c0, c1, c2 = (zero, zero, zero)
        n0, n1, n2, n3, n4, n5 = (zero, zero, zero, zero, zero, zero)
        b0, b1, b2 = (zero, zero, zero)
        carry1, carry2 = (zero, zero)
        remaining = total
        at = origin
        for e in range(edges):
            length = scratch[at + LENGTH * stride]
            tilt = tilt_of(e, edges, free)
            raw = load4(scratch, at + TRIAL * stride)
            v = closing_rotation(length, tangent(raw), x)
            q = turned_in_world(raw, (v[0] * tilt, v[1] * tilt, v[2] * tilt))
            store(scratch, at + TRIAL * stride, q)
            left1, left2 = (zero, zero)
            right1, right2 = (zero, zero)
            before1, before2 = (carry1, carry2)
            if e > 0:
                previous = at - ti.static(items * stride)
                p = load4(scratch, previous + TRIAL * stride)
                value, left, right = energy_and_gradient(p, q, stiffness(scratch, previous, at, material))
                energy = energy + value
                left1, left2 = (left[1], left[2])
                right1, right2 = (right[1], right[2])
                # The gradient of the edge before is complete now: its share of Aᵀg.
                pm1 = first_director(p)
                pm2 = second_director(p)
                l_before = scratch[previous + LENGTH * stride] * tilt_of(e - 1, edges, free)
                f1 = l_before * (before1 + left1)
                f2 = l_before * (before2 + left2)
                b0, b1, b2 = (
                    b0 + f2 * pm1[0] - f1 * pm2[0],
                    b1 + f2 * pm1[1] - f1 * pm2[1],
                    b2 + f2 * pm1[2] - f1 * pm2[2],
                )
            t = tangent(q)
            m1 = first_director(q)
            m2 = second_director(q)
            remaining = remaining - length
            w = hanging_weight(length, remaining, total, released)
            c = (gravity[0] * w, gravity[1] * w, gravity[2] * w)
            weight = length * dot(c, t)
            potential = potential + weight
            magnitude = magnitude + absolute(weight)
            g1, g2 = linear_gradient(c, length, m1, m2)
            carry1, carry2 = (right1 + g1, right2 + g2)
            c0, c1, c2 = (c0 + length * t[0], c1 + length * t[1], c2 + length * t[2])
            a = normal_matrix(length, t)
            n0, n1, n2 = (n0 + tilt * a[0], n1 + tilt * a[1], n2 + tilt * a[2])
            n3, n4, n5 = (n3 + tilt * a[3], n4 + tilt * a[4], n5 + tilt * a[5])
            if e == edges - 1:
                f1 = length * tilt * carry1
                f2 = length * tilt * carry2
                b0, b1, b2 = (
                    b0 + f2 * m1[0] - f1 * m2[0],
                    b1 + f2 * m1[1] - f1 * m2[1],
                    b2 + f2 * m1[2] - f1 * m2[2],
                )
            at += ti.static(items * stride)
        miss = ((c0 - target[0]) * closed, (c1 - target[1]) * closed, (c2 - target[2]) * closed)
        pull, minors = solve_symmetric(_regular((n0, n1, n2, n3, n4, n5)), (b0, b1, b2))
        multiplier = (0.0 - pull[0] * closed, 0.0 - pull[1] * closed, 0.0 - pull[2] * closed)
        return energy + potential, energy + magnitude, miss, multiplier

    @ti.func
    def take(scratch: ti.template(), at, accepted):
        """Make the trial frame the edge's frame in the lanes that accepted it."""
        for k in ti.static(range(4)):
            old = scratch[at + k * stride]
            scratch[at + k * stride] = ti.select(accepted > 0.5, scratch[at + (TRIAL + k) * stride], old)

    @ti.func
    def eliminate(scratch: ti.template(), origin, edges, accepted, shift, noise, echo, multiplier, miss, material, gravity,
                  closed, free, total, released):
        """Take the accepted trial frames, assemble H + shift and eliminate it from the first edge to the last.

        To find the way off a saddle, ``noise`` adds a fixed perturbation to the right-hand side and ``echo`` that many times
        the last step: inverse iterations towards the softest direction; both are zero otherwise. Returns the
        largest moment on a free edge |g + Aλ|, the largest diagonal entry of H, δλ, and the inertia: negative pivots plus
        positive eigenvalues of the Schur complement, three at a minimum (or saddle-free step).
        """
        zero = 0.0 * total
        one = zero + 1.0
        residual = zero
        scale = zero
        negative = zero
        h0, h1, h2, h3, h4, h5 = (zero, zero, zero, zero, zero, zero)  # H of the pair before
        g0, g1, g2 = (zero, zero, zero)  # its gradient
        e0, e1, e2, e3, e4, e5 = (zero, zero, zero, zero, zero, zero)  # what eliminating the edge before takes off
        r0, r1, r2 = (zero, zero, zero)
        a0, a1, a2, a3, a4, a5, a6, a7, a8 = (zero, zero, zero, zero, zero, zero, zero, zero, zero)
        s0, s1, s2, s3, s4, s5 = (zero, zero, zero, zero, zero, zero)
        z0, z1, z2 = (zero, zero, zero)
        remaining = total
        at = origin
        take(scratch, at, accepted)
        some_taut = largest(1.0 - free[4]) > 0.5
        for e in range(edges):
            q = load4(scratch, at)
            t = tangent(q)
            m1 = first_director(q)
            m2 = second_director(q)
            length = scratch[at + LENGTH * stride]
            remaining = remaining - length
            hang = hanging_weight(length, remaining, total, released)
            c = (gravity[0] * hang + multiplier[0], gravity[1] * hang + multiplier[1], gravity[2] * hang + multiplier[2])
            l1, l2 = linear_gradient(c, length, m1, m2)
            lh = linear_hessian(c, length, t, m1, m2)
            g1, g2 = (g1 + l1, g2 + l2)
            h1, h2, h3, h5 = (h1 + lh[0], h2 + lh[1], h3 + lh[2], h5 + lh[2])
            u0, u1, u2, u3, u4, u5, u6, u7, u8 = (zero, zero, zero, zero, zero, zero, zero, zero, zero)
            next0, next1, next2, next3, next4, next5 = (zero, zero, zero, zero, zero, zero)
            f0, f1, f2 = (zero, zero, zero)
            if e < edges - 1:
                after = at + ti.static(items * stride)
                take(scratch, after, accepted)
                left, right, hl, hr, ha = derivatives(q, load4(scratch, after), stiffness(scratch, at, after, material))
                g0, g1, g2 = (g0 + left[0], g1 + left[1], g2 + left[2])
                h0, h1, h2 = (h0 + hl[0], h1 + hl[1], h2 + hl[2])
                h3, h4, h5 = (h3 + hl[3], h4 + hl[4], h5 + hl[5])
                f0, f1, f2 = (right[0], right[1], right[2])
                next0, next1, next2, next3, next4, next5 = (hr[0], hr[1], hr[2], hr[3], hr[4], hr[5])
                u0, u1, u2, u3, u4 = (ha[0], ha[1], ha[2], ha[3], ha[4])
                u5, u6, u7, u8 = (ha[5], ha[6], ha[7], ha[8])
            keep = length * closed
            a0, a1, a2 = (0.0 - a0, 0.0 - a1, 0.0 - a2)
            a3, a4, a5 = (0.0 - keep * m2[0] - a3, 0.0 - keep * m2[1] - a4, 0.0 - keep * m2[2] - a5)
            a6, a7, a8 = (keep * m1[0] - a6, keep * m1[1] - a7, keep * m1[2] - a8)
            w = load3(scratch, at + ROTATION * stride)
            b0 = echo * w[0] + noise * ((5 * e + 2) % 7 - 2.5) - g0 - r0
            b1 = echo * w[1] + noise * ((3 * e + 1) % 7 - 2.5) - g1 - r1
            b2 = echo * w[2] + noise * ((4 * e + 3) % 7 - 2.5) - g2 - r2
            d0, d1, d2 = (h0 + shift - e0, h1 - e1, h2 - e2)
            d3, d4, d5 = (h3 + shift - e3, h4 - e4, h5 + shift - e5)
            if e == 0 or e >= edges - 2 or some_taut:
                # Held rotations: rows and columns of the identity, so that they stay zero and add no negative pivot.
                spin = one
                tilt = free[4]
                if e == 0:
                    spin, tilt = (free[0], free[1])
                if e == edges - 1:
                    spin, tilt = (free[2], free[3])
                spin_after = one
                tilt_after = free[4]
                if e == edges - 2:
                    spin_after, tilt_after = (free[2], free[3])
                g0, g1, g2 = (spin * g0, tilt * g1, tilt * g2)
                b0, b1, b2 = (spin * b0, tilt * b1, tilt * b2)
                h0, h3, h5 = (spin * h0, tilt * h3, tilt * h5)
                d0, d1, d2 = (spin * d0 + (1.0 - spin), spin * tilt * d1, spin * tilt * d2)
                d3, d4, d5 = (tilt * d3 + (1.0 - tilt), tilt * d4, tilt * d5 + (1.0 - tilt))
                a0, a1, a2 = (spin * a0, spin * a1, spin * a2)
                a3, a4, a5, a6, a7, a8 = (tilt * a3, tilt * a4, tilt * a5, tilt * a6, tilt * a7, tilt * a8)
                u0, u1, u2 = (spin * spin_after * u0, spin * tilt_after * u1, spin * tilt_after * u2)
                u3, u4, u5 = (tilt * spin_after * u3, tilt * tilt_after * u4, tilt * tilt_after * u5)
                u6, u7, u8 = (tilt * spin_after * u6, tilt * tilt_after * u7, tilt * tilt_after * u8)
            scale = ti.max(scale, ti.max(h0, ti.max(h3, h5)))
            residual = larger(residual, largest_component((g0, g1, g2)))
            f = factor((d0, d1, d2, d3, d4, d5))
            wr = forward(f, (b0, b1, b2))
            wu0 = forward(f, (u0, u3, u6))
            wu1 = forward(f, (u1, u4, u7))
            wu2 = forward(f, (u2, u5, u8))
            wa0 = forward(f, (a0, a3, a6))
            wa1 = forward(f, (a1, a4, a7))
            wa2 = forward(f, (a2, a5, a8))
            store(scratch, at + PIVOTS * stride, (f[0], f[1], f[2], f[3], f[4], f[5]))
            store(scratch, at + ROTATION * stride, wr)
            store(scratch, at + ELIMINATED_NEXT * stride, wu0)
            store(scratch, at + (ELIMINATED_NEXT + 3) * stride, wu1)
            store(scratch, at + (ELIMINATED_NEXT + 6) * stride, wu2)
            store(scratch, at + ELIMINATED_CLOSURE * stride, wa0)
            store(scratch, at + (ELIMINATED_CLOSURE + 3) * stride, wa1)
            store(scratch, at + (ELIMINATED_CLOSURE + 6) * stride, wa2)
            negative = negative + f[6]
            s0, s1, s2 = (s0 + weighted(f, wa0, wa0), s1 + weighted(f, wa0, wa1), s2 + weighted(f, wa0, wa2))
            s3, s4, s5 = (s3 + weighted(f, wa1, wa1), s4 + weighted(f, wa1, wa2), s5 + weighted(f, wa2, wa2))
            z0, z1, z2 = (z0 + weighted(f, wa0, wr), z1 + weighted(f, wa1, wr), z2 + weighted(f, wa2, wr))
            e0, e1, e2 = (weighted(f, wu0, wu0), weighted(f, wu0, wu1), weighted(f, wu0, wu2))
            e3, e4, e5 = (weighted(f, wu1, wu1), weighted(f, wu1, wu2), weighted(f, wu2, wu2))
            r0, r1, r2 = (weighted(f, wu0, wr), weighted(f, wu1, wr), weighted(f, wu2, wr))
            a0, a1, a2 = (weighted(f, wu0, wa0), weighted(f, wu0, wa1), weighted(f, wu0, wa2))
            a3, a4, a5 = (weighted(f, wu1, wa0), weighted(f, wu1, wa1), weighted(f, wu1, wa2))
            a6, a7, a8 = (weighted(f, wu2, wa0), weighted(f, wu2, wa1), weighted(f, wu2, wa2))
            h0, h1, h2, h3, h4, h5 = (next0, next1, next2, next3, next4, next5)
            g0, g1, g2 = (f0, f1, f2)
            at += ti.static(items * stride)
        # Without closure the Schur complement is the identity: λ stays zero and three positive eigenvalues are counted.
        loose = 1.0 - closed
        schur = (s0 + loose, s1, s2, s3 + loose, s4, s5 + loose)
        change, minors = solve_symmetric(schur, (z0 + miss[0], z1 + miss[1], z2 + miss[2]))
        inertia = negative + positive_eigenvalues(minors)
        return residual, scale, (change[0] * closed, change[1] * closed, change[2] * closed), inertia

    @ti.func
    def substitute(scratch: ti.template(), origin, edges, change):
        """Back-substitution ω = L⁻ᵀ D⁻¹ (W_r − W_A δλ − W_U ω_next); returns the largest rotation, rad."""
        zero = 0.0 * change[0]
        w0, w1, w2 = (zero, zero, zero)
        longest = zero
        at = origin + (edges - 1) * ti.static(items * stride)
        for _ in range(edges):
            f0, f1, f2, f3, f4, f5 = load6(scratch, at + PIVOTS * stride)
            r = load3(scratch, at + ROTATION * stride)
            wu0 = load3(scratch, at + ELIMINATED_NEXT * stride)
            wu1 = load3(scratch, at + (ELIMINATED_NEXT + 3) * stride)
            wu2 = load3(scratch, at + (ELIMINATED_NEXT + 6) * stride)
            wa0 = load3(scratch, at + ELIMINATED_CLOSURE * stride)
            wa1 = load3(scratch, at + (ELIMINATED_CLOSURE + 3) * stride)
            wa2 = load3(scratch, at + (ELIMINATED_CLOSURE + 6) * stride)
            y0 = r[0] - wa0[0] * change[0] - wa1[0] * change[1] - wa2[0] * change[2] - wu0[0] * w0 - wu1[0] * w1 - wu2[0] * w2
            y1 = r[1] - wa0[1] * change[0] - wa1[1] * change[1] - wa2[1] * change[2] - wu0[1] * w0 - wu1[1] * w1 - wu2[1] * w2
            y2 = r[2] - wa0[2] * change[0] - wa1[2] * change[1] - wa2[2] * change[2] - wu0[2] * w0 - wu1[2] * w1 - wu2[2] * w2
            w0, w1, w2 = backward((f0, f1, f2, f3, f4, f5), (y0, y1, y2))
            store(scratch, at + ROTATION * stride, (w0, w1, w2))
            longest = larger(longest, dot((w0, w1, w2), (w0, w1, w2)))
            at -= ti.static(items * stride)
        return ti.sqrt(longest)

    return SimpleNamespace(step=step, project=project, eliminate=eliminate, substitute=substitute)
