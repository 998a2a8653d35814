"""Vectors and quaternions as plain sequences of numbers, so that floats, complex and hyper-dual numbers all pass.

No conjugation anywhere: with complex entries the functions are analytic, as complex-step derivatives need.
"""

from tests.oracle.hyper_dual import sqrt


def dot(a, b):
    return sum(x * y for x, y in zip(a, b, strict=True))


def cross(a, b):
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def scale(factor, a):
    return [factor * x for x in a]


def add(*vectors):
    return [sum(parts) for parts in zip(*vectors, strict=True)]


def subtract(a, b):
    return [x - y for x, y in zip(a, b, strict=True)]


def normalise(a):
    return scale(1.0 / sqrt(dot(a, a)), a)


def product(a, b):
    """Hamilton product of two quaternions, scalar first."""
    vector = add(scale(a[0], b[1:]), scale(b[0], a[1:]), cross(a[1:], b[1:]))
    return [a[0] * b[0] - dot(a[1:], b[1:]), *vector]


def conjugate(q):
    return [q[0], -q[1], -q[2], -q[3]]


def directors(q):
    """t, m1, m2: the columns of the rotation R(q), by rotating the three axes one after the other."""
    axes = ([0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0])
    return [product(product(q, axis), conjugate(q))[1:] for axis in axes]


def body_rotated(q, w):
    """normalise(Q ⊗ (1, w/2)): the rotation vector w of docs/chain.md."""
    return normalise(product(q, [1.0, *scale(0.5, w)]))


def spun_and_tilted(q, w):
    """Q spun about its tangent by w_0, then tilted by (w_1, w_2), as in docs/chain.md: normalise(Q ⊗ tilt ⊗ spin)."""
    spin, *tilt = scale(0.5, w)
    return normalise(product(product(q, [1.0, 0.0, *tilt]), [1.0, spin, 0.0, 0.0]))


def transport(source, target, vector):
    """P(vector), P the smallest rotation with P(source) = target, unit vectors (§III-C)."""
    axis, cosine = cross(source, target), dot(source, target)
    return add(scale(cosine, vector), cross(axis, vector), scale(dot(axis, vector) / (1.0 + cosine), axis))
