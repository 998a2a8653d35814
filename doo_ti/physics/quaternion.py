"""Unit quaternions as material frames: t, m1, m2 are the columns of R(Q) (§III-A)."""

import taichi as ti

from doo_ti.physics.tuples import cross, dot, plus, scaled


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
def from_matrix(m):
    """The unit quaternion of a rotation (t, m1, m2), nine numbers row by row; its scalar is positive where that exceeds a half,
    else its largest component.

    Each row of 4 q qᵀ is q up to length: the first serves unless the scalar is small, the largest always.
    """
    w, x, y, z = (1.0 + m[0] + m[4] + m[8], m[7] - m[5], m[2] - m[6], m[3] - m[1])
    if not m[0] + m[4] + m[8] > 0.0:
        ww = w
        xx, yy, zz = (1.0 + m[0] - m[4] - m[8], 1.0 - m[0] + m[4] - m[8], 1.0 - m[0] - m[4] + m[8])
        wx, wy, wz = (x, y, z)
        xy, xz, yz = (m[1] + m[3], m[2] + m[6], m[5] + m[7])
        most = ww
        if xx > most:
            most = xx
            w, x, y, z = (wx, xx, xy, xz)
        if yy > most:
            most = yy
            w, x, y, z = (wy, xy, yy, yz)
        if zz > most:
            w, x, y, z = (wz, xz, yz, zz)
    return normalised((w, x, y, z))
