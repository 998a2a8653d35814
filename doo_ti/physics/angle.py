"""Angles of twist without trigonometric functions, which packs of lanes do not have."""

import numpy as np
import taichi as ti


def _arctangent_coefficients(terms: int) -> tuple[float, ...]:
    """c_k of atan(t) = t Σ c_k t^{2k} on [−1, 1]: Chebyshev interpolation of atan(√s)/√s on s in [0, 1]."""

    def ratio(s):
        root = np.sqrt(np.maximum(s, 1e-300))
        return np.where(s < 1e-12, 1.0, np.arctan(root) / root)

    chebyshev = np.polynomial.Chebyshev.interpolate(ratio, terms - 1, domain=[0.0, 1.0])
    return tuple(chebyshev.convert(kind=np.polynomial.Polynomial).coef)


ARCTANGENT_32 = _arctangent_coefficients(10)
ARCTANGENT_64 = _arctangent_coefficients(22)


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
        zero = 0.0 * cosine
        one = zero + 1.0
        half_cosine = ti.sqrt(ti.max(0.5 + 0.5 * cosine, zero))
        small = 0.5 * sine / ti.max(half_cosine, 0.5 * one)
        large = ti.sqrt(ti.max(0.5 - 0.5 * cosine, zero))
        half_sine = ti.select(cosine > 0.0, small, ti.select(sine < 0.0, 0.0 - large, large))
        return 4.0 * arctangent(half_sine / (one + half_cosine))

    return signed_angle
