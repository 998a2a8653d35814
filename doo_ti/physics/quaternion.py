"""Unit quaternions as material frames: t, m1, m2 are the columns of R(Q) (§III-A). And angles of twist, without trigonometric
functions, which packs of lanes do not have."""

import math

import taichi as ti

from doo_ti.physics.algebra import absolute
from doo_ti.physics.tuples import cross, dot, plus, scaled, variable


@ti.func
def tangent(q):
    return (1.0 - 2.0 * (q[2] * q[2] + q[3] * q[3]), 2.0 * (q[1] * q[2] + q[0] * q[3]), 2.0 * (q[1] * q[3] - q[0] * q[2]))


@ti.func
def first_director(q):
    """m1."""
    return (2.0 * (q[1] * q[2] - q[0] * q[3]), 1.0 - 2.0 * (q[1] * q[1] + q[3] * q[3]), 2.0 * (q[2] * q[3] + q[0] * q[1]))


@ti.func
def second_director(q):
    """m2."""
    return (2.0 * (q[1] * q[3] + q[0] * q[2]), 2.0 * (q[2] * q[3] - q[0] * q[1]), 1.0 - 2.0 * (q[1] * q[1] + q[2] * q[2]))


@ti.func
def directors(q):
    """t, m1 and m2."""
    return tangent(q), first_director(q), second_director(q)


@ti.func
def relative_rotation(p, q):
    """conj(p) q, of either sign: the rotation between neighbouring frames."""
    return (
        p[0] * q[0] + p[1] * q[1] + p[2] * q[2] + p[3] * q[3],
        p[0] * q[1] - p[1] * q[0] - p[2] * q[3] + p[3] * q[2],
        p[0] * q[2] - p[2] * q[0] - p[3] * q[1] + p[1] * q[3],
        p[0] * q[3] - p[3] * q[0] - p[1] * q[2] + p[2] * q[1],
    )


@ti.func
def product(p, q):
    """p q."""
    return (
        p[0] * q[0] - p[1] * q[1] - p[2] * q[2] - p[3] * q[3],
        p[0] * q[1] + p[1] * q[0] + p[2] * q[3] - p[3] * q[2],
        p[0] * q[2] + p[2] * q[0] + p[3] * q[1] - p[1] * q[3],
        p[0] * q[3] + p[3] * q[0] + p[1] * q[2] - p[2] * q[1],
    )


@ti.func
def normalised(q):
    scale = 1.0 / ti.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    return scaled(q, scale)


@ti.func
def partway(p, q, share):
    """The rotation at that ``share`` of the shorter way from p to q, on the chord between them."""
    alike = ti.select(dot(p, q) < 0.0, 0.0 - share, share)
    return normalised(plus(scaled(p, 1.0 - share), scaled(q, alike)))


@ti.func
def rotated(q, x):
    """R(q) x."""
    return plus(plus(scaled(tangent(q), x[0]), scaled(first_director(q), x[1])), scaled(second_director(q), x[2]))


@ti.func
def turned_in_body(q, w, spins_first):
    """q turned by w in its own axes, angles to second order.

    Where ``spins_first`` is zero, by the rotation vector w: q (1, w/2) normalised. Where it is one, q spins about its tangent
    by w[0] and then tilts about w[1] m1 + w[2] m2 of before: q (1, 0, w[1]/2, w[2]/2) (1, w[0]/2, 0, 0) normalised. The tangent
    then goes where the tilt takes it, however far the frame spins.
    """
    a, r, s = 0.5 * w[0], 0.5 * w[1], 0.5 * w[2]
    mixed = spins_first * a
    b, c = r + mixed * s, s - mixed * r
    return normalised((
        q[0] - q[1] * a - q[2] * b - q[3] * c, q[1] + q[0] * a + q[2] * c - q[3] * b,
        q[2] + q[0] * b + q[3] * a - q[1] * c, q[3] + q[0] * c + q[1] * b - q[2] * a))


@ti.func
def turned_in_world(q, w):
    """(1, w/2) q normalised: turned by the rotation vector w given in world axes, to second order."""
    a, b, c = 0.5 * w[0], 0.5 * w[1], 0.5 * w[2]
    return normalised((
        q[0] - a * q[1] - b * q[2] - c * q[3], q[1] + a * q[0] + b * q[3] - c * q[2],
        q[2] + b * q[0] + c * q[1] - a * q[3], q[3] + c * q[0] + a * q[2] - b * q[1]))


@ti.func
def transported(q, source, target):
    """q turned by the parallel transport that takes ``source`` to ``target``, unit vectors that are not opposite (§III-C)."""
    axis = cross(source, target)
    share = 2.0 / (1.0 + dot(source, target))
    return turned_in_world(q, scaled(axis, share))


@ti.func
def turned_to(q, target):
    """q turned so that its tangent is the unit vector ``target``: by parallel transport, which keeps the spin, or where the two
    are opposite by half a turn about its m2, but for what keeps a joint that is folded so from dividing by zero."""
    source = tangent(q)
    turned = variable(transported(q, source, target))
    if 1.0 + dot(source, target) <= 1e-14:
        turned = turned_in_world(q, scaled(second_director(q), 1e30))
    return turned


@ti.func
def from_matrix(m):
    """The unit quaternion of a rotation (t, m1, m2), nine numbers row by row; its scalar is positive where that exceeds a half,
    else its largest component.

    Each row of 4 q qᵀ is q up to length: the first serves unless the scalar is small, the largest always.
    """
    wx, wy, wz = (m[7] - m[5], m[2] - m[6], m[3] - m[1])
    most = 1.0 + m[0] + m[4] + m[8]
    q = variable((most, wx, wy, wz))
    if not m[0] + m[4] + m[8] > 0.0:
        xx, yy, zz = (1.0 + m[0] - m[4] - m[8], 1.0 - m[0] + m[4] - m[8], 1.0 - m[0] - m[4] + m[8])
        xy, xz, yz = (m[1] + m[3], m[2] + m[6], m[5] + m[7])
        if xx > most:
            q, most = (wx, xx, xy, xz), xx
        if yy > most:
            q, most = (wy, xy, yy, yz), yy
        if zz > most:
            q = (wz, xz, yz, zz)
    return normalised(q)


# --- angles ---


# c_k of atan(t) = t Σ c_k t^{2k} on [−1, 1], to the rounding of f32 and of f64: Chebyshev interpolation of atan(√s)/√s on
# s in [0, 1].
ARCTANGENT_32 = (
    0.9999999817886561, -0.3333303670929785, 0.1999187202936523, -0.14197797796103093, 0.10618370644642738,
    -0.07456854841877827, 0.04213762377106965, -0.01573124923103841, 0.0027662835283182277)
ARCTANGENT_64 = (
    0.9999999999999992, -0.33333333333327675, 0.19999999999551873, -0.14285714246575537, 0.11111109675041028,
    -0.0909088137348786, 0.0769197669262008, -0.06663983020101555, 0.058667190121604505, -0.05195258167679075,
    0.04536417919528809, -0.037645220867725884, 0.028064421244298553, -0.017415735311806204, 0.008034231327474118,
    -0.0020977132022380832, -0.00019510388374328604, 0.00041359663009643555, -0.0001514434814453125, 2.0599365234375e-05)


def arctangent_function(number):
    """atan(t) for |t| ≤ 1 by an odd polynomial, to the rounding of ``number``.

    Four sums, each of every fourth term, run in parallel: in a single one every product would wait for the one before.
    """
    coefficients = ARCTANGENT_32 if number.bits == 32 else ARCTANGENT_64
    rows = [coefficients[k : k + 4] for k in range(0, len(coefficients), 4)]
    rows = tuple((*row, *(0.0,) * (4 - len(row))) for row in reversed(rows))
    scalar = number.scalar

    @ti.func
    def arctangent(t):
        square = t * t
        fourth = square * square
        eighth = fourth * fourth
        none = 0.0 * square
        a, b, c, d = (none, none, none, none)
        for k in ti.static(range(len(rows))):
            a = a * eighth + scalar(rows[k][0])
            b = b * eighth + scalar(rows[k][1])
            c = c * eighth + scalar(rows[k][2])
            d = d * eighth + scalar(rows[k][3])
        return t * ((a + square * b) + fourth * (c + square * d))

    return arctangent


def twist_angle_function(number):
    """m = 2 atan(q1/q0) in (−π, π] of a relative rotation, of either sign."""
    arctangent = arctangent_function(number)
    scalar = number.scalar

    @ti.func
    def twist_angle(q):
        none = 0.0 * q[1]
        steep = q[1] * q[1] > q[0] * q[0]
        quarter = ti.select(q[0] * q[1] < 0.0, none - scalar(0.5 * math.pi), none + scalar(0.5 * math.pi))
        ratio = ti.select(steep, 0.0 - q[0], q[1]) / ti.select(steep, q[1], q[0])
        return 2.0 * (arctangent(ratio) + ti.select(steep, quarter, none))

    return twist_angle


@ti.func
def turned_about_own_tangent(p, q):
    """(cos φ, sin φ) of the angle φ about its tangent by which the frame q is turned against the frame p transported to q's
    tangent: that of the twist in p⁻¹ q, the rest of which is the transport."""
    r = relative_rotation(p, q)
    return r[0] * r[0] - r[1] * r[1], 2.0 * r[0] * r[1]


@ti.func
def passed_half_turn(before, after):
    """±1 where the shorter way between two angles, given as (cos, sin) of any length, passes half a turn, else 0."""
    one = 0.0 * before[0] + 1.0
    below = before[1] < 0.0
    lowest = before[0] * absolute(after[1]) + after[0] * absolute(before[1])
    passes = (before[1] * after[1] < 0.0) & (lowest < 0.0)
    return ti.select(passes, ti.select(below, 0.0 - one, one), 0.0 * one)
