"""Angles of twist without trigonometric functions, which packs of lanes do not have."""

import math
from fractions import Fraction

import taichi as ti


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
    """atan(t) for |t| ≤ 1 by an odd polynomial, to the rounding of ``number``."""
    coefficients = tuple(reversed(ARCTANGENT_32 if number.bits == 32 else ARCTANGENT_64))
    scalar = number.scalar

    @ti.func
    def arctangent(t):
        square = t * t
        total = 0.0 * square
        for k in ti.static(range(len(coefficients))):
            total = total * square + scalar(coefficients[k])
        return t * total

    return arctangent


def twist_angle_function(number):
    """m = 2 atan2(q1, q0) = 4 atan(q1/(√s + q0)) of a relative rotation, given √s = √(q0² + q1²)."""
    arctangent = arctangent_function(number)

    @ti.func
    def twist_angle(q, root):
        return 4.0 * arctangent(q[1] / (root + q[0]))

    return twist_angle


def signed_angle_function(number):
    """The angle in (−π, π] with the given cosine and sine, through its quarter."""
    arctangent = arctangent_function(number)

    @ti.func
    def signed_angle(cosine, sine):
        one = 0.0 * cosine + 1.0
        # Of cos(m/2) and |sin(m/2)| the larger by the half-angle formula, the other from the sine: nothing cancels.
        size = ti.max(sine, 0.0 - sine)
        major = ti.sqrt(0.5 + 0.5 * ti.max(cosine, 0.0 - cosine))
        minor = 0.5 * size / major
        half_cosine = ti.select(cosine > 0.0, major, minor)
        half_size = ti.select(cosine > 0.0, minor, major)
        half_sine = ti.select(sine < 0.0, 0.0 - half_size, half_size)
        return 4.0 * arctangent(half_sine / (one + half_cosine))

    return signed_angle
