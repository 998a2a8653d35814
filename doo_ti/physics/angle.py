"""Angles of twist without trigonometric functions, which packs of lanes do not have."""

import math
from fractions import Fraction

import taichi as ti

from doo_ti.physics.algebra import absolute


def _arctangent_coefficients(terms: int) -> tuple[float, ...]:
    """c_k of atan(t) = t Σ c_k t^{2k} on [−1, 1]: Chebyshev interpolation of atan(√s)/√s on s in [0, 1].

    Its weights need every digit, and the polynomials T_k(2s − 1) have huge integer coefficients: both are summed exactly.
    """
    angles = [math.pi * (j + 0.5) / terms for j in range(terms)]
    roots = [math.cos(0.5 * angle) for angle in angles]  # s = (1 + cos θ)/2
    values = [math.atan(root) / root for root in roots]
    weights = [
        (2 if k else 1) / terms * math.fsum(v * math.cos(k * a) for v, a in zip(values, angles, strict=True))
        for k in range(terms)
    ]
    total = [Fraction(0)] * terms
    before, here = [Fraction(1)], [Fraction(-1), Fraction(2)]
    for weight in weights:
        for power, coefficient in enumerate(before):
            total[power] += Fraction(weight) * coefficient
        # T_{k+1} = 2 (2s − 1) T_k − T_{k−1}
        after = [Fraction(0)] * (len(here) + 1)
        for power, coefficient in enumerate(here):
            after[power] -= 2 * coefficient
            after[power + 1] += 4 * coefficient
        for power, coefficient in enumerate(before):
            after[power] -= coefficient
        before, here = here, after
    return tuple(float(coefficient) for coefficient in total)


ARCTANGENT_32 = _arctangent_coefficients(9)
ARCTANGENT_64 = _arctangent_coefficients(20)


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


def signed_angle_function(number):
    """The angle in (−π, π] of the direction (cosine, sine), of any length."""
    half_angle = half_turn_angle_function(number)
    scalar = number.scalar

    @ti.func
    def signed_angle(cosine, sine):
        none = 0.0 * sine
        half_turn = ti.select(sine < 0.0, none - scalar(math.pi), none + scalar(math.pi))
        return half_angle(cosine, sine) + ti.select(cosine < 0.0, half_turn, none)

    return signed_angle


def twist_angle_function(number):
    """m = 2 atan(q1/q0) in (−π, π] of a relative rotation, of either sign."""
    half_angle = half_turn_angle_function(number)

    @ti.func
    def twist_angle(q):
        return 2.0 * half_angle(q[0], q[1])

    return twist_angle


def half_turn_angle_function(number):
    """The angle in (−π/2, π/2] of the line through (cosine, sine): that of the direction or of its opposite."""
    arctangent = arctangent_function(number)
    scalar = number.scalar

    @ti.func
    def half_turn_angle(cosine, sine):
        none = 0.0 * sine
        steep = sine * sine > cosine * cosine
        quarter = ti.select(cosine * sine < 0.0, none - scalar(0.5 * math.pi), none + scalar(0.5 * math.pi))
        ratio = ti.select(steep, 0.0 - cosine, sine) / ti.select(steep, sine, cosine)
        return arctangent(ratio) + ti.select(steep, quarter, none)

    return half_turn_angle


@ti.func
def turned_about_own_tangent(p, q):
    """(cos φ, sin φ) of the angle φ about its tangent by which the frame q is turned against the frame p transported to q's
    tangent: that of the twist in p⁻¹ q, the rest of which is the transport."""
    w = p[0] * q[0] + p[1] * q[1] + p[2] * q[2] + p[3] * q[3]
    x = p[0] * q[1] - p[1] * q[0] - p[2] * q[3] + p[3] * q[2]
    return w * w - x * x, 2.0 * w * x


@ti.func
def passed_half_turn(before, after):
    """±1 where the shorter way between two angles, given as (cos, sin) of any length, passes half a turn, else 0."""
    one = 0.0 * before[0] + 1.0
    below = before[1] < 0.0
    lowest = before[0] * absolute(after[1]) + after[0] * absolute(before[1])
    passes = (before[1] * after[1] < 0.0) & (lowest < 0.0)
    return ti.select(passes, ti.select(below, 0.0 - one, one), 0.0 * one)
