"""Sweeps along a rod with a free end under an external energy at its vertices: the Riccati form of :mod:`.chain`.

Where a vertex is depends on every edge before it, so an energy at vertices fills the Hessian of the frames. It stays a chain
in the displacement ξ of an edge's first vertex and the rotation ω of the edge before: eliminating from the free end, the
energy of all that follows is a quadratic form in the two,

    ½ ξᵀC ξ + ξᵀZ ω + ½ ωᵀF ω + c·ξ + f·ω,

and an edge passes it on to the one before by minimising over its own rotation. Forward, ξ grows by Aᵀω, A = l (0; −m2ᵀ; m1ᵀ).
"""

from types import SimpleNamespace

import taichi as ti

from doo_ti.physics.algebra import absolute, dot, factor, forward, largest_of, weighted
from doo_ti.physics.closure import linear_gradient, linear_hessian
from doo_ti.physics.quaternion import first_director, second_director, tangent
from doo_ti.relaxation import chain
from doo_ti.relaxation.chain import LENGTH


def unloaded(eliminate):
    """``eliminate`` of the plain chain, with what an external energy would need left unused."""

    @ti.func
    def function(scratch: ti.template(), origin, edges, shift, noise, echo, multiplier, miss, material, gravity, closed, free,
                 total, released, anchor, numbers: ti.template(), field: ti.template(), coarse):
        return eliminate(scratch, origin, edges, shift, noise, echo, multiplier, miss, material, gravity, closed, free, total,
                         released, anchor)

    return function


def loaded_sweeps(number, isotropic: bool, stride: int, external: type, functions) -> SimpleNamespace:
    """The sweeps of :func:`doo_ti.relaxation.chain.chain_sweeps` under an external energy, with the same interface.

    ``functions`` are those of the class ``external`` (see :class:`doo_ti.relaxation.external.ExternalFunctions`).
    """
    plain = chain.chain_sweeps(number, isotropic, stride, external.items)
    load4, items, largest = plain.load4, plain.items, number.lanes().largest
    evaluate = functions.evaluate

    @ti.func
    def quadratic(s, a, b):
        """aᵀ S b for a symmetric S."""
        return (
            a[0] * (s[0] * b[0] + s[1] * b[1] + s[2] * b[2])
            + a[1] * (s[1] * b[0] + s[3] * b[1] + s[4] * b[2])
            + a[2] * (s[2] * b[0] + s[4] * b[1] + s[5] * b[2])
        )

    @ti.func
    def tip(scratch: ti.template(), origin, edges, anchor):
        x0, x1, x2 = anchor
        at = origin
        for e in range(edges):
            t = tangent(load4(scratch, at))
            length = scratch[at + LENGTH * stride]
            x0, x1, x2 = (x0 + length * t[0], x1 + length * t[1], x2 + length * t[2])
            at += ti.static(items * stride)
        return x0, x1, x2

    @ti.func
    def eliminate(scratch: ti.template(), origin, edges, shift, noise, echo, multiplier, miss, material, gravity,
                  closed, free, total, released, anchor, numbers: ti.template(), field: ti.template(), coarse):
        """Assemble H + shift and eliminate it from the free end to the clamp; as :func:`.chain.chain_sweeps`' own.

        The nominal force p, the sum of all gradients further out, enters the geometric part of H and the residual; what
        elimination made of it, c, the right-hand side.
        """
        zero = 0.0 * total
        one = zero + 1.0
        squared, slope, scale, negative = (zero, zero, zero, zero)
        energy, magnitude = (zero, zero)
        x0, x1, x2 = tip(scratch, origin, edges, anchor)
        p0, p1, p2 = (zero, zero, zero)
        c0, c1, c2 = (zero, zero, zero)
        f0, f1, f2 = (zero, zero, zero)
        s0, s1, s2, s3, s4, s5 = (zero, zero, zero, zero, zero, zero)  # C
        o0, o1, o2, o3, o4, o5 = (zero, zero, zero, zero, zero, zero)  # F
        z0, z1, z2, z3, z4, z5, z6, z7, z8 = (zero, zero, zero, zero, zero, zero, zero, zero, zero)  # Z, a row per direction
        h0, h1, h2, h3, h4, h5 = (zero, zero, zero, zero, zero, zero)  # H of the pair with the edge after
        g0, g1, g2 = (zero, zero, zero)
        beyond = zero
        searching = largest(noise + echo) > 0.0
        at = origin + (edges - 1) * ti.static(items * stride)
        for back in range(edges):
            e = edges - 1 - back
            q = load4(scratch, at)
            t = tangent(q)
            m1 = first_director(q)
            m2 = second_director(q)
            length = scratch[at + LENGTH * stride]
            here = (x0 - length * t[0], x1 - length * t[1], x2 - length * t[2])
            value, gamma, gamma_s, k, k_s, k_ss = evaluate(
                scratch, at, numbers, field, here, (x0, x1, x2), coarse)
            energy = energy + value
            magnitude = magnitude + absolute(value)
            x0, x1, x2 = here
            hang = plain.hanging_weight(length, beyond, total, released)
            beyond = beyond + length
            own = (gravity[0] * hang + gamma_s[0], gravity[1] * hang + gamma_s[1], gravity[2] * hang + gamma_s[2])
            force = (own[0] + p0, own[1] + p1, own[2] + p2)
            l1, l2 = linear_gradient(force, length, m1, m2)
            r1, r2 = linear_gradient((own[0] + c0, own[1] + c1, own[2] + c2), length, m1, m2)
            lh = linear_hessian(force, length, t, m1, m2)
            # The pair with the edge before: its right block is this edge's, its left one the next's to come.
            u0, u1, u2, u3, u4, u5, u6, u7, u8 = (zero, zero, zero, zero, zero, zero, zero, zero, zero)
            before0, before1, before2, before3, before4, before5 = (zero, zero, zero, zero, zero, zero)
            b0, b1, b2 = (zero, zero, zero)
            if e > 0:
                previous = at - ti.static(items * stride)
                left, right, hl, hr, ha = plain.derivatives(
                    plain.load_bent(scratch, previous), plain.stiffness(scratch, previous, at, material))
                g0, g1, g2 = (g0 + right[0], g1 + right[1], g2 + right[2])
                h0, h1, h2 = (h0 + hr[0], h1 + hr[1], h2 + hr[2])
                h3, h4, h5 = (h3 + hr[3], h4 + hr[4], h5 + hr[5])
                b0, b1, b2 = left
                before0, before1, before2, before3, before4, before5 = hl
                u0, u1, u2, u3, u4, u5, u6, u7, u8 = ha
            # A = (0; a1; a2) and its products with Z, C and the curvature on the edge.
            a1 = (0.0 - length * m2[0], 0.0 - length * m2[1], 0.0 - length * m2[2])
            a2 = (length * m1[0], length * m1[1], length * m1[2])
            row1 = (dot(a1, (z0, z3, z6)), dot(a1, (z1, z4, z7)), dot(a1, (z2, z5, z8)))
            row2 = (dot(a2, (z0, z3, z6)), dot(a2, (z1, z4, z7)), dot(a2, (z2, z5, z8)))
            h0, h1, h2 = (h0, h1 + lh[0], h2 + lh[1])
            h3, h4, h5 = (h3 + lh[2] + quadratic(k_ss, a1, a1), h4 + quadratic(k_ss, a1, a2),
                          h5 + lh[2] + quadratic(k_ss, a2, a2))
            scale = largest_of(scale, largest_of(h0, largest_of(h3, h5)))
            d0 = h0 + shift + o0
            d1 = h1 + o1 + row1[0]
            d2 = h2 + o2 + row2[0]
            d3 = h3 + shift + o3 + 2.0 * row1[1] + quadratic((s0, s1, s2, s3, s4, s5), a1, a1)
            d4 = h4 + o4 + row1[2] + row2[1] + quadratic((s0, s1, s2, s3, s4, s5), a1, a2)
            d5 = h5 + shift + o5 + 2.0 * row2[2] + quadratic((s0, s1, s2, s3, s4, s5), a2, a2)
            stretch0 = (s0 + k_s[0], s1 + k_s[1], s2 + k_s[2])
            stretch1 = (s1 + k_s[3], s3 + k_s[4], s4 + k_s[5])
            stretch2 = (s2 + k_s[6], s4 + k_s[7], s5 + k_s[8])
            w1 = (dot(stretch0, a1), dot(stretch1, a1), dot(stretch2, a1))
            w2 = (dot(stretch0, a2), dot(stretch1, a2), dot(stretch2, a2))
            z1, z4, z7 = (z1 + w1[0], z4 + w1[1], z7 + w1[2])
            z2, z5, z8 = (z2 + w2[0], z5 + w2[1], z8 + w2[2])
            # The step solves M ω = rhs, less what ξ and the edge before add.
            rhs0, rhs1, rhs2 = (0.0 - g0 - f0, 0.0 - g1 - r1 - f1, 0.0 - g2 - r2 - f2)
            g1, g2 = (g1 + l1, g2 + l2)
            if searching:
                rhs0, rhs1, rhs2, slope = plain.stirred(
                    scratch, at, e, (rhs0, rhs1, rhs2), (g0, g1, g2), noise, echo, slope)
            if e == 0:
                spin, tilt = (free[0], free[1])
                g0, g1, g2 = (spin * g0, tilt * g1, tilt * g2)
                rhs0, rhs1, rhs2 = (spin * rhs0, tilt * rhs1, tilt * rhs2)
                d0, d1, d2 = (spin * d0 + (1.0 - spin), spin * tilt * d1, spin * tilt * d2)
                d3, d4, d5 = (tilt * d3 + (1.0 - tilt), tilt * d4, tilt * d5 + (1.0 - tilt))
            squared = largest_of(squared, largest_of(g0 * g0, largest_of(g1 * g1, g2 * g2)))
            f = factor((d0, d1, d2, d3, d4, d5))
            negative = negative + f[6]
            wr = forward(f, (rhs0, rhs1, rhs2))
            wz0 = forward(f, (z0, z1, z2))
            wz1 = forward(f, (z3, z4, z5))
            wz2 = forward(f, (z6, z7, z8))
            wu0 = forward(f, (u0, u1, u2))
            wu1 = forward(f, (u3, u4, u5))
            wu2 = forward(f, (u6, u7, u8))
            plain.store_eliminated(scratch, at, f, wr, wu0 + wu1 + wu2, wz0 + wz1 + wz2)
            s0, s1, s2 = (s0 + k[0] - weighted(f, wz0, wz0), s1 + k[1] - weighted(f, wz0, wz1),
                          s2 + k[2] - weighted(f, wz0, wz2))
            s3, s4, s5 = (s3 + k[3] - weighted(f, wz1, wz1), s4 + k[4] - weighted(f, wz1, wz2),
                          s5 + k[5] - weighted(f, wz2, wz2))
            c0 = c0 + gamma[0] + weighted(f, wz0, wr)
            c1 = c1 + gamma[1] + weighted(f, wz1, wr)
            c2 = c2 + gamma[2] + weighted(f, wz2, wr)
            p0, p1, p2 = (p0 + gamma[0], p1 + gamma[1], p2 + gamma[2])
            z0, z1, z2 = (0.0 - weighted(f, wz0, wu0), 0.0 - weighted(f, wz0, wu1), 0.0 - weighted(f, wz0, wu2))
            z3, z4, z5 = (0.0 - weighted(f, wz1, wu0), 0.0 - weighted(f, wz1, wu1), 0.0 - weighted(f, wz1, wu2))
            z6, z7, z8 = (0.0 - weighted(f, wz2, wu0), 0.0 - weighted(f, wz2, wu1), 0.0 - weighted(f, wz2, wu2))
            o0, o1, o2 = (0.0 - weighted(f, wu0, wu0), 0.0 - weighted(f, wu0, wu1), 0.0 - weighted(f, wu0, wu2))
            o3, o4, o5 = (0.0 - weighted(f, wu1, wu1), 0.0 - weighted(f, wu1, wu2), 0.0 - weighted(f, wu2, wu2))
            f0, f1, f2 = (weighted(f, wu0, wr), weighted(f, wu1, wr), weighted(f, wu2, wr))
            h0, h1, h2, h3, h4, h5 = (before0, before1, before2, before3, before4, before5)
            g0, g1, g2 = (b0, b1, b2)
            at -= ti.static(items * stride)
        # No closure: three is what a minimum counts.
        return ti.sqrt(squared), scale, (zero, zero, zero), negative + 3.0 * one, slope, energy, magnitude

    @ti.func
    def substitute(scratch: ti.template(), origin, edges, change):
        """ω = L⁻ᵀ D⁻¹ (W_r − W_Z ξ − W_U ω_before), from the clamp to the free end; returns the largest rotation, rad."""
        zero = 0.0 * change[0]
        w0, w1, w2 = (zero, zero, zero)
        x0, x1, x2 = (zero, zero, zero)
        longest = zero
        at = origin
        for _ in range(edges):
            w0, w1, w2 = plain.solved_edge(scratch, at, (x0, x1, x2), (w0, w1, w2))
            q = load4(scratch, at)
            m1 = first_director(q)
            m2 = second_director(q)
            length = scratch[at + LENGTH * stride]
            x0 = x0 + length * (m1[0] * w2 - m2[0] * w1)
            x1 = x1 + length * (m1[1] * w2 - m2[1] * w1)
            x2 = x2 + length * (m1[2] * w2 - m2[2] * w1)
            longest = largest_of(longest, dot((w0, w1, w2), (w0, w1, w2)))
            at += ti.static(items * stride)
        return ti.sqrt(longest)

    return SimpleNamespace(step=plain.step, close=plain.close, eliminate=eliminate, restore=plain.restore,
                           substitute=substitute, items=items, load3=plain.load3, load4=load4)
