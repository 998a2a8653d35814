"""One pair of neighbouring edges and one edge under a dead force, with exact derivatives in body rotations.

Arrays come and go with any batch axes in front, written `...`; quaternions are (..., 4), scalar first.
"""

import numpy as np

from tests.oracle import algebra


def strains(q0, q1):
    """(ω^0, ω^1, m) of a pair, from two quaternions given as lists of four numbers (docs/chain.md).

    q = conj(Q0) ⊗ Q1 with q0 ≥ 0, s = q0² + q1²:
    ω^0 = 2/s (q1q2 + q0q3, q1q3 − q0q2),  ω^1 = 2/s (q0q3 − q1q2, −q0q2 − q1q3),  m = 2 atan2(q1, q0).
    """
    q = algebra.product(algebra.conjugate(q0), q1)
    q = [algebra.choose(algebra.real(q[0]) < 0, -part, part) for part in q]
    factor = 2.0 / (q[0] * q[0] + q[1] * q[1])
    omega0 = [factor * (q[1] * q[2] + q[0] * q[3]), factor * (q[1] * q[3] - q[0] * q[2])]
    omega1 = [factor * (q[0] * q[3] - q[1] * q[2]), factor * (-(q[0] * q[2]) - q[1] * q[3])]
    return omega0, omega1, 2.0 * algebra.angle(q[1], q[0])


def quadratic(bend, offset):
    """offset · B offset of two numbers of any kind; bend (..., 2, 2)."""
    return sum(bend[..., a, b] * offset[a] * offset[b] for a in range(2) for b in range(2))


def pair_parts(q0, q1, l0, l1, bend0, bend1, twist, rest):
    """Bend and twist energy of a pair, from two quaternions given as lists of four numbers.

    l0, l1, twist (...,); bend0, bend1 (..., 2, 2); rest (..., 2) in 1/mm.
    """
    omega0, omega1, turn = strains(q0, q1)
    length = l0 + l1
    bending = sum(quadratic(bend, [omega[k] - rest[..., k] * length / 2.0 for k in range(2)]) / (2.0 * length)
                  for omega, bend in ((omega0, bend0), (omega1, bend1)))
    return bending, twist * turn * turn / length


def _components(quaternion):
    return [np.asarray(quaternion)[..., k] for k in range(4)]


def pair_energy(q0, q1, l0, l1, bend0, bend1, twist, rest):
    """Bend plus twist energy of a pair (...,)."""
    return sum(pair_parts(_components(q0), _components(q1), l0, l1, bend0, bend1, twist, rest))


def pair_gradient_hessian(q0, q1, l0, l1, bend0, bend1, twist, rest, turned):
    """(..., 6) gradient and (..., 6, 6) Hessian of :func:`pair_energy` in the body rotations (w0, w1), made by ``turned``."""
    values = [np.asarray(a, dtype=np.float64) for a in (l0, l1, twist)]
    shape = np.broadcast_shapes(
        np.shape(q0)[:-1], np.shape(q1)[:-1], np.shape(bend0)[:-2], np.shape(bend1)[:-2], rest.shape[:-1],
        *(a.shape for a in values))
    widen = [np.broadcast_to(a, shape)[..., None, None] for a in values]
    matrices = [np.broadcast_to(b, (*shape, 2, 2))[..., None, None, :, :] for b in (bend0, bend1)]
    rests = np.broadcast_to(rest, (*shape, 2))[..., None, None, :]
    w = algebra.seeds(6, like=len(shape))
    frames = []
    for quaternion, rotation in ((q0, w[:3]), (q1, w[3:])):
        parts = [np.broadcast_to(part, shape)[..., None, None] for part in _components(quaternion)]
        frames.append(turned(parts, rotation))
    energy = sum(pair_parts(*frames, widen[0], widen[1], *matrices, widen[2], rests))
    return algebra.gradient_and_hessian(energy, shape, 6)


def linear_gradient_hessian(force, quaternion, length, turned=algebra.body_rotated):
    """(..., 3) gradient and (..., 3, 3) Hessian of c·t·l in the body rotation of Q (..., 4), made by ``turned``; c (..., 3),
    l (...,)."""
    force, length = np.asarray(force, dtype=np.float64), np.asarray(length, dtype=np.float64)
    shape = np.broadcast_shapes(force.shape[:-1], np.shape(quaternion)[:-1], length.shape)
    c = [np.broadcast_to(force[..., k], shape)[..., None, None] for k in range(3)]
    parts = [np.broadcast_to(part, shape)[..., None, None] for part in _components(quaternion)]
    tangent = algebra.directors(turned(parts, algebra.seeds(3, like=len(shape))))[0]
    energy = algebra.dot(c, tangent) * np.broadcast_to(length, shape)[..., None, None]
    return algebra.gradient_and_hessian(energy, shape, 3)
