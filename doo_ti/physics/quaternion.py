"""Unit quaternions as material frames: t, m1, m2 are the columns of R(Q) (§III-A)."""

import taichi as ti


@ti.func
def tangent(q):
    return (
        1.0 - 2.0 * (q[2] * q[2] + q[3] * q[3]),
        2.0 * (q[1] * q[2] + q[0] * q[3]),
        2.0 * (q[1] * q[3] - q[0] * q[2]),
    )


@ti.func
def first_director(q):
    """m1."""
    return (
        2.0 * (q[1] * q[2] - q[0] * q[3]),
        1.0 - 2.0 * (q[1] * q[1] + q[3] * q[3]),
        2.0 * (q[2] * q[3] + q[0] * q[1]),
    )


@ti.func
def second_director(q):
    """m2."""
    return (
        2.0 * (q[1] * q[3] + q[0] * q[2]),
        2.0 * (q[2] * q[3] - q[0] * q[1]),
        1.0 - 2.0 * (q[1] * q[1] + q[2] * q[2]),
    )


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
def normalised(q):
    scale = 1.0 / ti.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    return (q[0] * scale, q[1] * scale, q[2] * scale, q[3] * scale)


@ti.func
def turned_in_body(q, w):
    """q (1, w/2) normalised: turned by the rotation vector w given in q's own axes, to second order."""
    a = 0.5 * w[0]
    b = 0.5 * w[1]
    c = 0.5 * w[2]
    return normalised(
        (
            q[0] - q[1] * a - q[2] * b - q[3] * c,
            q[1] + q[0] * a + q[2] * c - q[3] * b,
            q[2] + q[0] * b + q[3] * a - q[1] * c,
            q[3] + q[0] * c + q[1] * b - q[2] * a,
        )
    )


@ti.func
def turned_in_world(q, w):
    """(1, w/2) q normalised: turned by the rotation vector w given in world axes, to second order."""
    a = 0.5 * w[0]
    b = 0.5 * w[1]
    c = 0.5 * w[2]
    return normalised(
        (
            q[0] - a * q[1] - b * q[2] - c * q[3],
            q[1] + a * q[0] + b * q[3] - c * q[2],
            q[2] + b * q[0] + c * q[1] - a * q[3],
            q[3] + c * q[0] + a * q[2] - b * q[1],
        )
    )
