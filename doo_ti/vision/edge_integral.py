"""E_proj of an edge on the device: the distance to the nearest detected point, integrated along its image (§IV-A).

With p(x) the distorted image of a point, v = ∂p/∂x Δ its motion along the edge Δ and D the distance map,

    E_proj = ∫ D(p) |v| ds ≈ (1/n) Σ_k D(p_k) |v_k|   at n places s_k = (k − ½)/n along the edge:

the mean distance in px times the length of the image in px. D is capped smoothly, D/√(1 + D²/cap²): a gap in the detection
costs, it does not veto.
"""

from types import SimpleNamespace

import taichi as ti

from doo_ti.physics.algebra import largest_of
from doo_ti.vision.projection import CAMERA_COLUMNS, camera_functions
from doo_ti.vision.sampling import WINDOW_COLUMNS, map_sampling

# Columns of the numbers of a set and a camera: the camera's, the window's, then how to integrate.
WINDOW = CAMERA_COLUMNS
POINTS = WINDOW + WINDOW_COLUMNS
INVERSE_CAP = POINTS + 1  # 1/cap², px⁻²
REACH = POINTS + 2  # px: see ``moments``
COLUMNS = POINTS + 3
CREASE = 13 / 32
"""px: what the spline makes of |x| where x is 0, on average over places between pixels. Left in, a perfect image would cost in
proportion to its length, and rods would gain by making their images shorter."""
UNSEEN = 1e5
"""px²: an edge that a camera cannot see, for being behind it, costs this much, whatever it does."""
SLOWEST = 1e-6
"""px: an edge that points at the camera is no shorter."""


def edge_integrals(number) -> SimpleNamespace:
    """``error`` and ``moments`` as Taichi functions for one kind of number.

    Both take the maps' ``values``, the ``numbers`` (A, C, COLUMNS), each rod's set ``row``, the camera c with its
    ``lens`` and ``frame`` (see ``window``), and the edge's start a and direction d in the camera's axes.
    """
    camera, sampling = camera_functions(number), map_sampling(number, WINDOW)
    normalised, bent, bending = camera.normalised, camera.bent, camera.bending
    curling, speed = camera.curling, camera.speed
    value, derivatives = sampling.value, sampling.derivatives
    scalar = number.scalar

    @ti.func
    def places(numbers: ti.template()):
        """(n, 1/n)."""
        points = numbers[0, 0, POINTS]
        return ti.cast(points, ti.i32), ti.cast(1.0 / points, scalar)

    @ti.func
    def error(values: ti.template(), numbers: ti.template(), row, c, frame, lens, a, d):
        """(E_proj, share of the edge that is not seen)."""
        total, hidden = (0.0 * row, 0.0 * row)
        points, step = places(numbers)
        inverse_cap = ti.cast(numbers[0, 0, INVERSE_CAP], scalar)
        s = 0.5 * step
        for _ in range(points):
            x0, x1, inverse, seen = normalised(lens, (a[0] + s * d[0], a[1] + s * d[1], a[2] + s * d[2]))
            pixel, jacobian = bent(lens, x0, x1)
            far = value(values, numbers, row, c, frame, pixel) - CREASE
            cost = far * speed(lens, jacobian, x0, x1, inverse, d) / ti.sqrt(1.0 + inverse_cap * far * far)
            total = total + ti.select(seen, cost, 0.0 * row + UNSEEN)
            hidden = hidden + ti.select(seen, 0.0 * row, 0.0 * row + 1.0)
            s += step
        return step * total, step * hidden

    @ti.func
    def convex(second):
        """What of a symmetric 2×2 matrix (11, 12, 22) is positive semidefinite."""
        middle = 0.5 * (second[0] + second[2])
        half = 0.5 * (second[0] - second[2])
        root = ti.sqrt(half * half + second[1] * second[1])
        none = 0.0 * middle
        high = largest_of(middle + root, none)
        low = largest_of(middle - root, none)
        share = ti.select(root > 0.0, 0.5 * (high - low) / ti.select(root > 0.0, root, none + 1.0), none)
        mean = 0.5 * (high + low)
        return (mean + share * half, share * second[1], mean - share * half)

    @ti.func
    def from_image(form, mixed, slope, x0, x1, inverse):
        """A second derivative by (X, Y, 1/y3) as one by the point y, six numbers.

        ``form`` (11, 12, 22) in (X, Y), ``mixed`` (13, 23) with 1/y3, where it has no curvature of its own; ``slope`` the
        first derivatives.
        """
        scale = inverse * inverse
        a = x0 * form[0] + x1 * form[1] + inverse * mixed[0]
        b = x0 * form[1] + x1 * form[2] + inverse * mixed[1]
        c = x0 * a + x1 * b + inverse * (x0 * mixed[0] + x1 * mixed[1])
        d = 2.0 * (x0 * slope[0] + x1 * slope[1] + inverse * slope[2])
        return (scale * form[0], scale * form[1], 0.0 - scale * (a + slope[0]),
                scale * form[2], 0.0 - scale * (b + slope[1]), scale * (c + d))

    @ti.func
    def place(values: ti.template(), numbers: ti.template(), row, c, frame, lens, y, d, coarse):
        """D(p(y)) |∂p/∂y d| with its derivatives by y and d: (E, ∂y, ∂d, ∂yy, ∂yd, ∂dd, whether it is seen).

        It is F m/y3 with F(X, Y) the capped distance and m = |A w| of the lens' Jacobian A in px and w = (d1 − X d3,
        d2 − Y d3): all derivatives are taken by (X, Y, 1/y3) first.
        """
        inverse_cap = ti.cast(numbers[0, 0, INVERSE_CAP], scalar)
        reach = ti.cast(numbers[0, 0, REACH], scalar)
        fx, fy = (lens[0], lens[1])
        x0, x1, inverse, seen = normalised(lens, y)
        pixel, j = bent(lens, x0, x1)
        t = bending(lens, x0, x1)
        w0, w1 = (d[0] - x0 * d[2], d[1] - x1 * d[2])
        v0, v1 = (fx * (j[0] * w0 + j[1] * w1), fy * (j[1] * w0 + j[2] * w1))
        m = largest_of(ti.sqrt(v0 * v0 + v1 * v1), 0.0 * v0 + SLOWEST)
        slower = 1.0 / m
        # The image's direction and the one across it, in px of the lens' bent coordinates.
        u0, u1 = (fx * v0 * slower, fy * v1 * slower)
        n0, n1 = (0.0 - fx * v1 * slower, fy * v0 * slower)
        along = (u0 * j[0] + u1 * j[1], u0 * j[1] + u1 * j[2])
        across = (n0 * j[0] + n1 * j[1], n0 * j[1] + n1 * j[2])
        turn = (u0 * t[0] + u1 * t[1], u0 * t[1] + u1 * t[2], u0 * t[2] + u1 * t[3])
        swing0 = (n0 * t[0] + n1 * t[1]) * w0 + (n0 * t[1] + n1 * t[2]) * w1 - d[2] * across[0]
        swing1 = (n0 * t[1] + n1 * t[2]) * w0 + (n0 * t[2] + n1 * t[3]) * w1 - d[2] * across[1]
        m0 = turn[0] * w0 + turn[1] * w1 - d[2] * along[0]
        m1 = turn[1] * w0 + turn[2] * w1 - d[2] * along[1]
        q = curling(lens, x0, x1)
        q0, q1, q2, q3 = (u0 * q[0] + u1 * q[1], u0 * q[1] + u1 * q[2], u0 * q[2] + u1 * q[3], u0 * q[3] + u1 * q[4])
        m00 = q0 * w0 + q1 * w1 - 2.0 * d[2] * turn[0] + slower * swing0 * swing0
        m01 = q1 * w0 + q2 * w1 - 2.0 * d[2] * turn[1] + slower * swing0 * swing1
        m11 = q2 * w0 + q3 * w1 - 2.0 * d[2] * turn[2] + slower * swing1 * swing1
        # The capped distance.
        smoothed, slope, second = derivatives(values, numbers, row, c, frame, pixel)
        far = smoothed - CREASE
        square = 1.0 / (1.0 + inverse_cap * far * far)
        root = ti.sqrt(square)
        steep = square * root
        fade = 0.0 - 3.0 * inverse_cap * far * square * steep
        f = far * root
        s0, s1 = (fx * steep * slope[0], fy * steep * slope[1])
        f0, f1 = (s0 * j[0] + s1 * j[1], s0 * j[1] + s1 * j[2])
        convex_part = convex(second)
        grade = slope[0] * slope[0] + slope[1] * slope[1] + 1e-12
        own = slope[0] * slope[0] * convex_part[0] + slope[1] * slope[1] * convex_part[2]
        own = (own + 2.0 * slope[0] * slope[1] * convex_part[1]) / grade
        more = largest_of(1.0 / largest_of(far, 0.0 * far + reach) - own, 0.0 * far) * steep / grade
        rank = ti.select(coarse > 0.5, more, fade)
        c00 = fx * fx * (steep * ti.select(coarse > 0.5, convex_part[0], second[0]) + rank * slope[0] * slope[0])
        c01 = fx * fy * (steep * ti.select(coarse > 0.5, convex_part[1], second[1]) + rank * slope[0] * slope[1])
        c11 = fy * fy * (steep * ti.select(coarse > 0.5, convex_part[2], second[2]) + rank * slope[1] * slope[1])
        fine = 1.0 - coarse
        f00 = j[0] * (c00 * j[0] + 2.0 * c01 * j[1]) + c11 * j[1] * j[1] + fine * (s0 * t[0] + s1 * t[1])
        f01 = j[0] * (c00 * j[1] + c01 * j[2]) + j[1] * (c01 * j[1] + c11 * j[2]) + fine * (s0 * t[1] + s1 * t[2])
        f11 = j[1] * (c00 * j[1] + 2.0 * c01 * j[2]) + c11 * j[2] * j[2] + fine * (s0 * t[2] + s1 * t[3])
        # F m/y3 by (X, Y, 1/y3), then by y; and by d.
        i0, i1 = (f0 * m + f * m0, f1 * m + f * m1)
        e0, e1 = (inverse * i0, inverse * i1)
        form = (inverse * (f00 * m + fine * (2.0 * f0 * m0 + f * m00)),
                inverse * (f01 * m + fine * (f0 * m1 + f1 * m0 + f * m01)),
                inverse * (f11 * m + fine * (2.0 * f1 * m1 + f * m11)))
        rise = fine * inverse
        by_y = (inverse * e0, inverse * e1, 0.0 - inverse * (x0 * e0 + x1 * e1 + inverse * f * m))
        by_yy = from_image(form, (fine * i0, fine * i1), (fine * e0, fine * e1, fine * f * m), x0, x1, inverse)
        g = inverse * f
        by_d = (g * along[0], g * along[1], 0.0 - g * (x0 * along[0] + x1 * along[1]))
        a00 = rise * (f0 * along[0] + f * (slower * swing0 * across[0] + turn[0]))
        a01 = rise * (f0 * along[1] + f * (slower * swing0 * across[1] + turn[1]))
        a10 = rise * (f1 * along[0] + f * (slower * swing1 * across[0] + turn[1]))
        a11 = rise * (f1 * along[1] + f * (slower * swing1 * across[1] + turn[2]))
        a02 = 0.0 - x0 * a00 - x1 * a01 - rise * f * along[0]
        a12 = 0.0 - x0 * a10 - x1 * a11 - rise * f * along[1]
        by_yd = (inverse * a00, inverse * a01, inverse * a02, inverse * a10, inverse * a11, inverse * a12,
                 0.0 - inverse * (x0 * a00 + x1 * a10 + rise * f * along[0]),
                 0.0 - inverse * (x0 * a01 + x1 * a11 + rise * f * along[1]),
                 0.0 - inverse * (x0 * a02 + x1 * a12 - rise * f * (x0 * along[0] + x1 * along[1])))
        stretch = g * slower
        b00, b01, b11 = (stretch * across[0] * across[0], stretch * across[0] * across[1], stretch * across[1] * across[1])
        b02 = 0.0 - x0 * b00 - x1 * b01
        b12 = 0.0 - x0 * b01 - x1 * b11
        by_dd = (b00, b01, b02, b11, b12, 0.0 - x0 * b02 - x1 * b12)
        return g * m, by_y, by_d, by_yy, by_yd, by_dd, seen

    @ti.func
    def moments(values: ti.template(), numbers: ti.template(), row, c, frame, lens, a, d, coarse):
        """E_proj and the moments (Σ γ, Σ s γ, Σ K, Σ s K, Σ s² K) of its derivatives, in the camera's axes.

        Where ``coarse`` is zero all are exact, of the B-spline; Σ s K, of the edge's start by the edge's direction, is no
        symmetric matrix. Where it is one, K is positive semidefinite: what is convex of D, and of the length by the edge's
        direction. Off its crease D grows evenly and has no curvature along its gradient: there K has 1/D instead, from
        ``REACH`` px up, whose Newton step ends on the crease.
        """
        zero = 0.0 * row
        energy = zero
        g0, g1, g2, h0, h1, h2 = (zero, zero, zero, zero, zero, zero)
        k0, k1, k2, k3, k4, k5 = (zero, zero, zero, zero, zero, zero)
        l0, l1, l2, l3, l4, l5, l6, l7, l8 = (zero, zero, zero, zero, zero, zero, zero, zero, zero)
        m0, m1, m2, m3, m4, m5 = (zero, zero, zero, zero, zero, zero)
        points, step = places(numbers)
        s = 0.5 * step
        for _ in range(points):
            e, y, z, k, n, m, seen = place(
                values, numbers, row, c, frame, lens, (a[0] + s * d[0], a[1] + s * d[1], a[2] + s * d[2]), d, coarse)
            weight = ti.select(seen, zero + step, zero)
            energy = energy + ti.select(seen, step * e, zero + step * UNSEEN)
            g0, g1, g2 = (g0 + weight * y[0], g1 + weight * y[1], g2 + weight * y[2])
            h0, h1, h2 = (h0 + weight * (s * y[0] + z[0]), h1 + weight * (s * y[1] + z[1]), h2 + weight * (s * y[2] + z[2]))
            k0, k1, k2 = (k0 + weight * k[0], k1 + weight * k[1], k2 + weight * k[2])
            k3, k4, k5 = (k3 + weight * k[3], k4 + weight * k[4], k5 + weight * k[5])
            l0, l1, l2 = (l0 + weight * (s * k[0] + n[0]), l1 + weight * (s * k[1] + n[1]), l2 + weight * (s * k[2] + n[2]))
            l3, l4, l5 = (l3 + weight * (s * k[1] + n[3]), l4 + weight * (s * k[3] + n[4]), l5 + weight * (s * k[4] + n[5]))
            l6, l7, l8 = (l6 + weight * (s * k[2] + n[6]), l7 + weight * (s * k[4] + n[7]), l8 + weight * (s * k[5] + n[8]))
            m0 = m0 + weight * (s * (s * k[0] + 2.0 * n[0]) + m[0])
            m1 = m1 + weight * (s * (s * k[1] + n[1] + n[3]) + m[1])
            m2 = m2 + weight * (s * (s * k[2] + n[2] + n[6]) + m[2])
            m3 = m3 + weight * (s * (s * k[3] + 2.0 * n[4]) + m[3])
            m4 = m4 + weight * (s * (s * k[4] + n[5] + n[7]) + m[4])
            m5 = m5 + weight * (s * (s * k[5] + 2.0 * n[8]) + m[5])
            s += step
        return (energy, (g0, g1, g2), (h0, h1, h2), (k0, k1, k2, k3, k4, k5), (l0, l1, l2, l3, l4, l5, l6, l7, l8),
                (m0, m1, m2, m3, m4, m5))

    return SimpleNamespace(error=error, moments=moments, window=sampling.window, **vars(camera))
