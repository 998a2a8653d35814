"""Sweeps along a rod whose state lies in scratch: step, closure, energy, and the block-tridiagonal Newton system.

The Hessian of a chain of frames is block-tridiagonal with 3×3 blocks, bordered by the three columns A of closure. One
forward sweep closes, evaluates, assembles and eliminates it, one backward sweep gives the step (§III-D). Scratch holds, per
edge, the items named below; ``number`` says how many rods a value holds and ``stride`` how far apart the items of an edge lie.
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
    largest_of,
    positive_eigenvalues,
    solve_symmetric,
    weighted,
)
from doo_ti.physics.angle import twist_angle_function
from doo_ti.physics.closure import closing_rotation, linear_gradient, linear_hessian, normal_matrix
from doo_ti.physics.quaternion import first_director, second_director, tangent, turned_in_body, turned_in_world

# Items of an edge in scratch. Those of a vertex (1/l̄, β, ω̄) lie with the edge that leaves it.
FRAME = 0
STANDING = 4  # the frame to go back to where the step is not taken
LENGTH = 8
INVERSE_LENGTH = 9
ROTATION = 10  # the right-hand side while eliminating, the step after back-substitution
ELIMINATED_NEXT = 13
ELIMINATED_CLOSURE = 22
BENT = 22  # until then: curvature and twist at the vertex where the edge ends
PIVOTS = 31
ISOTROPIC_ITEMS = 37
BEND = 37
TWIST = 40
REST = 41
GENERAL_ITEMS = 43


def item_count(isotropic: bool) -> int:
    """Items of an edge."""
    return ISOTROPIC_ITEMS if isotropic else GENERAL_ITEMS


def chain_sweeps(number, isotropic: bool, stride: int, extra: int = 0) -> SimpleNamespace:
    """The sweeps as Taichi functions for one kind of number and of material.

    ``free = (spin_start, tilt_start, spin_end, tilt_end, tilt_inner)`` is one where that rotation of the first edge, of
    the last or of those between is unknown, zero where it is held. ``closed`` is one where the far point is fixed.
    ``material`` is (α, β) for isotropic rods and unused otherwise; ``gravity`` is μ times the unit vector up,
    ``released`` one where vertex 0 is free and the far end holds the rod. ``extra`` items of an edge are somebody else's.
    """
    twist_angle = twist_angle_function(number)
    items = item_count(isotropic) + extra
    largest = number.lanes().largest

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
    def load_bent(scratch: ti.template(), at):
        """(X, Y, 1/s, m, e^{im}) at the end of an edge: see :mod:`doo_ti.physics.pair`."""
        b = at + BENT * stride
        return (
            (scratch[b], scratch[b + stride]),
            (scratch[b + 2 * stride], scratch[b + 3 * stride]),
            scratch[b + 4 * stride],
            scratch[b + 5 * stride],
            (scratch[b + 6 * stride], scratch[b + 7 * stride]),
        )

    @ti.func
    def energy_of(bent, s):
        x, y, inverse, m, turn = bent
        if ti.static(isotropic):
            return pair.isotropic_energy(x, m, s)
        else:
            return pair.general_energy(x, y, m, s)

    @ti.func
    def gradient_of(bent, s):
        x, y, inverse, m, turn = bent
        if ti.static(isotropic):
            return pair.isotropic_gradient(x, y, inverse, m, s)
        else:
            return pair.general_gradient(x, y, inverse, turn, m, s)

    @ti.func
    def derivatives(bent, s):
        """(g_left, g_right, H_left, H_right, H_across) of a pair."""
        x, y, inverse, m, turn = bent
        if ti.static(isotropic):
            return gradient_of(bent, s) + pair.isotropic_hessian(x, y, inverse, turn, m, s)
        else:
            return gradient_of(bent, s) + pair.general_hessian(x, y, inverse, turn, m, s)

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
    def plus(total, lost, value):
        """``total`` + ``value``, and what rounding lost of it, to be made good with the next: the far end of a chain comes to
        1e-7 of its length in f32 only so."""
        if ti.static(number.bits == 32):
            wanted = value - lost
            reached = total + wanted
            return reached, (reached - total) - wanted
        else:
            return total + value, lost

    @ti.func
    def step(scratch: ti.template(), origin, edges, scale, moving, target, closed, free):
        """Frames Q (1, scale ω/2), and x of the projection that puts them back on closure, both only where ``moving``; and AᵀA
        over the edges that may tilt."""
        zero = 0.0 * scale
        stepping = (scale > 0.0) | (scale < 0.0)
        c0, c1, c2, k0, k1, k2 = (zero, zero, zero, zero, zero, zero)
        n0, n1, n2, n3, n4, n5 = (zero, zero, zero, zero, zero, zero)
        at = origin
        for e in range(edges):
            full = load3(scratch, at + ROTATION * stride)
            # A lane that does not step may hold anything there, even what is not a number.
            w = (
                ti.select(stepping, full[0] * scale, zero),
                ti.select(stepping, full[1] * scale, zero),
                ti.select(stepping, full[2] * scale, zero),
            )
            standing = load4(scratch, at)
            store(scratch, at + STANDING * stride, standing)
            q = turned_in_body(standing, w)
            store(scratch, at, q)
            length = scratch[at + LENGTH * stride]
            t = tangent(q)
            c0, k0 = plus(c0, k0, length * t[0])
            c1, k1 = plus(c1, k1, length * t[1])
            c2, k2 = plus(c2, k2, length * t[2])
            a = normal_matrix(length, t)
            tilt = tilt_of(e, edges, free)
            n0, n1, n2 = (n0 + tilt * a[0], n1 + tilt * a[1], n2 + tilt * a[2])
            n3, n4, n5 = (n3 + tilt * a[3], n4 + tilt * a[4], n5 + tilt * a[5])
            at += ti.static(items * stride)
        miss = ((c0 - target[0]) * closed, (c1 - target[1]) * closed, (c2 - target[2]) * closed)
        normal = _regular((n0, n1, n2, n3, n4, n5))
        x, minors = solve_symmetric(normal, miss)
        # x·miss is the sum of the squared rotations: keep their root mean square below 0.15 rad in one projection.
        size = ti.sqrt(ti.max(dot(x, miss), zero) / ti.cast(edges, number.scalar)) + 1e-30
        shrink = moving * ti.min(0.0 * size + 1.0, 0.15 / size)
        return (x[0] * shrink, x[1] * shrink, x[2] * shrink), normal

    @ti.func
    def _regular(n):
        """AᵀA made regular where all free edges are parallel."""
        e = ti.static(1e-6 if number.bits == 32 else 1e-13) * (n[0] + n[3] + n[5]) + 1e-30
        return (n[0] + e, n[1], n[2], n[3] + e, n[4], n[5] + e)

    @ti.func
    def close(scratch: ti.template(), origin, edges, x, normal, target, material, gravity, closed, free, total, released):
        """Turn the stepped frames onto closure by the minimum-norm rotation of :func:`step`, and evaluate them.

        Returns energy (gravity from vertex 0 or the far point), its magnitude (sum of absolute terms, the scale of its
        rounding), what closure is left, and the least-squares multiplier λ = −(AᵀA)⁻¹ Aᵀ g, with AᵀA from before the closing.
        This loop and that of :func:`step` keep apart what edges do by themselves from :func:`eliminate`, where each waits
        for the one before: here there is always another edge to get on with.
        """
        zero = 0.0 * total
        energy, potential, magnitude = (zero, zero, zero)
        c0, c1, c2, k0, k1, k2 = (zero, zero, zero, zero, zero, zero)
        b0, b1, b2 = (zero, zero, zero)
        p0, p1, p2, p3 = (zero, zero, zero, zero)
        u0, u1, u2, v0, v1, v2 = (zero, zero, zero, zero, zero, zero)  # l m1 and l m2 of the edge before
        carry1, carry2 = (zero, zero)  # its gradient so far
        remaining = total
        some_taut = largest(1.0 - free[4]) > 0.5
        at = origin
        for e in range(edges):
            raw = load4(scratch, at)
            length = scratch[at + LENGTH * stride]
            r0, r1, r2 = closing_rotation(length, tangent(raw), x)
            levers = length
            if e == 0 or e == edges - 1 or some_taut:
                tilt = tilt_of(e, edges, free)
                r0, r1, r2 = (r0 * tilt, r1 * tilt, r2 * tilt)
                levers = length * tilt
            q = turned_in_world(raw, (r0, r1, r2))
            store(scratch, at, q)
            right1, right2 = (zero, zero)
            if e > 0:
                previous = at - ti.static(items * stride)
                px, py, inverse, turn, r = pair.curvature((p0, p1, p2, p3), q)
                m = twist_angle(r)
                bent = (px, py, inverse, m, turn)
                store(scratch, previous + BENT * stride, px + py + (inverse, m) + turn)
                s = stiffness(scratch, previous, at, material)
                energy = energy + energy_of(bent, s)
                left, right = gradient_of(bent, s)
                f1, f2 = (carry1 + left[1], carry2 + left[2])
                b0, b1, b2 = (b0 + f2 * u0 - f1 * v0, b1 + f2 * u1 - f1 * v1, b2 + f2 * u2 - f1 * v2)
                right1, right2 = (right[1], right[2])
            t = tangent(q)
            m1 = first_director(q)
            m2 = second_director(q)
            u0, u1, u2 = (levers * m1[0], levers * m1[1], levers * m1[2])
            v0, v1, v2 = (levers * m2[0], levers * m2[1], levers * m2[2])
            remaining = remaining - length
            hang = hanging_weight(length, remaining, total, released)
            pull = (gravity[0] * hang, gravity[1] * hang, gravity[2] * hang)
            height = length * dot(pull, t)
            potential = potential + height
            magnitude = magnitude + absolute(height)
            # Where the edge may not tilt these are zero, and so is its share of Aᵀg.
            l1, l2 = linear_gradient(pull, levers, m1, m2)
            carry1, carry2 = (right1 + l1, right2 + l2)
            c0, k0 = plus(c0, k0, length * t[0])
            c1, k1 = plus(c1, k1, length * t[1])
            c2, k2 = plus(c2, k2, length * t[2])
            p0, p1, p2, p3 = q
            at += ti.static(items * stride)
        b0, b1, b2 = (
            b0 + carry2 * u0 - carry1 * v0, b1 + carry2 * u1 - carry1 * v1, b2 + carry2 * u2 - carry1 * v2)
        miss = ((c0 - target[0]) * closed, (c1 - target[1]) * closed, (c2 - target[2]) * closed)
        fit, minors = solve_symmetric(normal, (b0, b1, b2))
        multiplier = (0.0 - fit[0] * closed, 0.0 - fit[1] * closed, 0.0 - fit[2] * closed)
        return energy + potential, energy + magnitude, miss, multiplier

    @ti.func
    def restore(scratch: ti.template(), origin, edges, lost):
        """Go back to the frames from before the step in the lanes where it is not taken."""
        at = origin
        for e in range(edges):
            for k in ti.static(range(4)):
                here = scratch[at + k * stride]
                scratch[at + k * stride] = ti.select(lost > 0.5, scratch[at + (STANDING + k) * stride], here)
            at += ti.static(items * stride)

    @ti.func
    def stirred(scratch: ti.template(), at, edge, right, gradient, noise, echo, slope):
        """The right-hand side of an edge with the noise and the echo of :func:`eliminate`, and the slope along the echo."""
        none = 0.0 * echo
        w = load3(scratch, at + ROTATION * stride)
        # A lane without an echo may hold anything there, even what is not a number.
        k0, k1, k2 = (
            ti.select(echo > 0.0, echo * w[0], none),
            ti.select(echo > 0.0, echo * w[1], none),
            ti.select(echo > 0.0, echo * w[2], none),
        )
        return (
            right[0] + noise * ((5 * edge + 2) % 7 - 2.5) + k0,
            right[1] + noise * ((3 * edge + 1) % 7 - 2.5) + k1,
            right[2] + noise * ((4 * edge + 3) % 7 - 2.5) + k2,
            slope + gradient[0] * k0 + gradient[1] * k1 + gradient[2] * k2,
        )

    @ti.func
    def store_eliminated(scratch: ti.template(), at, f, right, neighbour, border):
        """What :func:`solved_edge` needs of an edge: its factors, W_r, and three columns each of W_U and of the border."""
        store(scratch, at + PIVOTS * stride, (f[0], f[1], f[2], f[3], f[4], f[5]))
        store(scratch, at + ROTATION * stride, right)
        store(scratch, at + ELIMINATED_NEXT * stride, neighbour)
        store(scratch, at + ELIMINATED_CLOSURE * stride, border)

    @ti.func
    def solved_edge(scratch: ti.template(), at, border, w):
        """ω = L⁻ᵀ D⁻¹ (W_r − W_border border − W_U ω_neighbour) of an edge, into its place."""
        f0, f1, f2, f3, f4, f5 = load6(scratch, at + PIVOTS * stride)
        r = load3(scratch, at + ROTATION * stride)
        wu0 = load3(scratch, at + ELIMINATED_NEXT * stride)
        wu1 = load3(scratch, at + (ELIMINATED_NEXT + 3) * stride)
        wu2 = load3(scratch, at + (ELIMINATED_NEXT + 6) * stride)
        wb0 = load3(scratch, at + ELIMINATED_CLOSURE * stride)
        wb1 = load3(scratch, at + (ELIMINATED_CLOSURE + 3) * stride)
        wb2 = load3(scratch, at + (ELIMINATED_CLOSURE + 6) * stride)
        b = border
        y0 = r[0] - wb0[0] * b[0] - wb1[0] * b[1] - wb2[0] * b[2] - wu0[0] * w[0] - wu1[0] * w[1] - wu2[0] * w[2]
        y1 = r[1] - wb0[1] * b[0] - wb1[1] * b[1] - wb2[1] * b[2] - wu0[1] * w[0] - wu1[1] * w[1] - wu2[1] * w[2]
        y2 = r[2] - wb0[2] * b[0] - wb1[2] * b[1] - wb2[2] * b[2] - wu0[2] * w[0] - wu1[2] * w[1] - wu2[2] * w[2]
        rotation = backward((f0, f1, f2, f3, f4, f5), (y0, y1, y2))
        store(scratch, at + ROTATION * stride, rotation)
        return rotation

    @ti.func
    def eliminate(scratch: ti.template(), origin, edges, shift, noise, echo, multiplier, miss, material, gravity,
                  closed, free, total, released, anchor):
        """Assemble H + shift at the closed frames and eliminate it from the first edge to the last.

        To find the way off a saddle, ``noise`` adds a fixed perturbation to the right-hand side and ``echo`` that many times
        the last step: inverse iterations towards the softest direction; both are zero otherwise. Returns the
        largest moment on a free edge |g + Aλ|, the largest diagonal entry of H, δλ, the inertia: negative pivots plus
        positive eigenvalues of the Schur complement, three at a minimum (or saddle-free step), the slope along the echo, and
        an external energy with its magnitude, here none (see :mod:`doo_ti.relaxation.loaded_chain`).
        """
        zero = 0.0 * total
        one = zero + 1.0
        squared, slope = (zero, zero)
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
        some_taut = largest(1.0 - free[4]) > 0.5
        searching = largest(noise + echo) > 0.0
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
                left, right, hl, hr, ha = derivatives(load_bent(scratch, at), stiffness(scratch, at, after, material))
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
            b0, b1, b2 = (0.0 - g0 - r0, 0.0 - g1 - r1, 0.0 - g2 - r2)
            if searching:
                b0, b1, b2, slope = stirred(scratch, at, e, (b0, b1, b2), (g0, g1, g2), noise, echo, slope)
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
            scale = largest_of(scale, largest_of(h0, largest_of(h3, h5)))
            squared = largest_of(squared, largest_of(g0 * g0, largest_of(g1 * g1, g2 * g2)))
            f = factor((d0, d1, d2, d3, d4, d5))
            wr = forward(f, (b0, b1, b2))
            wu0 = forward(f, (u0, u3, u6))
            wu1 = forward(f, (u1, u4, u7))
            wu2 = forward(f, (u2, u5, u8))
            wa0 = forward(f, (a0, a3, a6))
            wa1 = forward(f, (a1, a4, a7))
            wa2 = forward(f, (a2, a5, a8))
            store_eliminated(scratch, at, f, wr, wu0 + wu1 + wu2, wa0 + wa1 + wa2)
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
        solved, minors = solve_symmetric(schur, (z0 + miss[0], z1 + miss[1], z2 + miss[2]))
        change = (solved[0] * closed, solved[1] * closed, solved[2] * closed)
        inertia = negative + positive_eigenvalues(minors)
        return ti.sqrt(squared), scale, change, inertia, slope, zero, zero

    @ti.func
    def substitute(scratch: ti.template(), origin, edges, change):
        """Back-substitution ω = L⁻ᵀ D⁻¹ (W_r − W_A δλ − W_U ω_next); returns the largest rotation, rad."""
        zero = 0.0 * change[0]
        w0, w1, w2 = (zero, zero, zero)
        longest = zero
        at = origin + (edges - 1) * ti.static(items * stride)
        for _ in range(edges):
            w0, w1, w2 = solved_edge(scratch, at, change, (w0, w1, w2))
            longest = largest_of(longest, dot((w0, w1, w2), (w0, w1, w2)))
            at -= ti.static(items * stride)
        return ti.sqrt(longest)

    return SimpleNamespace(
        step=step, close=close, eliminate=eliminate, restore=restore, substitute=substitute, items=items, load3=load3,
        load4=load4, load_bent=load_bent, stiffness=stiffness, derivatives=derivatives, hanging_weight=hanging_weight,
        stirred=stirred, store_eliminated=store_eliminated, solved_edge=solved_edge)
