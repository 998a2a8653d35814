"""Pairs of neighbouring edges and edges under dead forces, with exact derivatives in body rotations; quaternions (n, 4)."""

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
    """Bend and twist energy of pairs of quaternions, four numbers each; lengths, twist (...,), B (..., 2, 2), ω̄ (..., 2)."""
    omega0, omega1, turn = strains(q0, q1)
    length = l0 + l1
    bending = sum(quadratic(bend, [omega[k] - rest[..., k] * length / 2.0 for k in range(2)]) / (2.0 * length)
                  for omega, bend in ((omega0, bend0), (omega1, bend1)))
    return bending, twist * turn * turn / length


def pair_energy(q0, q1, *properties):
    """(n,) bend plus twist energy of pairs of frames."""
    return sum(pair_parts(q0.T, q1.T, *properties))


def seeded_pairs(q0, q1, turned):
    """The frames of n pairs as numbers whose derivatives are those in the body rotations (w0, w1), made by ``turned``."""
    w = algebra.seeds(6)
    return [turned(q.T[..., None, None], turn) for q, turn in ((q0, w[:3]), (q1, w[3:]))]


def pair_gradient_hessian(q0, q1, l0, l1, bend0, bend1, twist, rest, turned):
    """(n, 6) gradients and (n, 6, 6) Hessians of :func:`pair_energy`."""
    properties = [value[:, None, None] for value in (l0, l1, bend0, bend1, twist, rest)]
    return algebra.gradient_and_hessian(sum(pair_parts(*seeded_pairs(q0, q1, turned), *properties)), twist.shape, 6)


def linear_gradient_hessian(force, quaternions, length, turned=algebra.body_rotated):
    """(..., n, 3) gradients and (..., n, 3, 3) Hessians of c·t·l in the body rotations of n edges, made by ``turned``;
    c (..., n, 3) or the same for all edges (3,)."""
    tangent = algebra.directors(turned(quaternions.T[..., None, None], algebra.seeds(3)))[0]
    energy = algebra.dot(np.moveaxis(force, -1, 0)[..., None, None], tangent) * length[:, None, None]
    return algebra.gradient_and_hessian(energy, np.broadcast_shapes(force.shape[:-1], length.shape), 3)
