"""The chain of frames of docs/chain.md in JAX: closure, the whole energy and its derivatives, and the Newton step of W rods.

A number of each of W rods is an array (W,), one of each edge an array (E, W); vectors, quaternions, matrices and complex
numbers are tuples of such arrays. E counts the edges, of which the first and the last are held.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax

MAX_PROJECTION = 0.15  # rad, root mean square over the edges
UPPER = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
"""Entries of a symmetric 3×3, in the order they are kept in."""


class Task(NamedTuple):
    """Parameters of W rods, energies in units of α. Where the last axis has length one, all rods share the value.

    length (E, 1 or W) of the edges and arm (E, 1 or W) Σ l̄ beyond each, mm; joint (E−1, 1 or W) 1/l̄, 1/mm; total and
    edge (1 or W) the rod's length and its longest edge, mm; twist (W,) β/α; gravity three of (W,) μ/α upwards, 1/mm³;
    target three of (W,) from the rod's start to its end, mm.
    """

    length: np.ndarray
    arm: np.ndarray
    joint: np.ndarray
    total: np.ndarray
    edge: np.ndarray
    twist: np.ndarray
    gravity: tuple
    target: tuple


def stepped(frames: tuple, step: tuple, cap) -> tuple:
    """The frames after the share ``cap`` (W,) of the rotations ``step``, three of (E−2, W), of the free edges."""
    free = tuple(part[1:-1] for part in frames)
    # Where no step is taken its value may be anything, even NaN.
    half = tuple(jnp.where(cap > 0, 0.5 * cap * part, 0) for part in step)
    return _between(frames, normalised(product(free, (jnp.ones_like(half[0]), *half))))


def closed(bits: int, task: Task, frames: tuple, moving) -> tuple:
    """The frames after one projection onto closure, in the rods that are ``moving`` (W,)."""
    tangent = _tangent(frames)
    miss = tuple(jnp.sum(task.length * t, 0) - end for t, end in zip(tangent, task.target, strict=True))
    inner, length = tuple(t[1:-1] for t in tangent), task.length[1:-1]
    normal = [jnp.sum(length * length * (float(i == k) - inner[i] * inner[k]), 0) for i, k in UPPER]
    trace = (1e-6 if bits == 32 else 1e-13) * (normal[0] + normal[3] + normal[5])  # against parallel edges
    x, _ = _solve(on_diagonal(normal, trace), miss)
    size = jnp.sqrt(jnp.maximum(dot(x, miss), 0) / len(task.length)) + 1e-30
    share = jnp.where(moving, jnp.minimum(1, MAX_PROJECTION / size), 0)
    turn = _cross(inner, tuple(-0.5 * share * part for part in x))
    free = tuple(part[1:-1] for part in frames)
    return _between(frames, normalised(product((jnp.ones_like(turn[0]), *(length * part for part in turn)), free)))


def energy(task: Task, frames: tuple, elastic):
    """(energy, sum of its terms' absolute values, by how much the end misses), ``elastic`` (E−1, W) being the pairs'."""
    bent = jnp.sum(elastic, 0)
    tangent = _tangent(frames)
    height = task.length * task.arm * dot(task.gravity, tangent)
    miss = tuple(jnp.sum(task.length * t, 0) - end for t, end in zip(tangent, task.target, strict=True))
    return bent + jnp.sum(height, 0), bent + jnp.sum(jnp.abs(height), 0), miss


def derivatives(task: Task, frames: tuple, pairs: tuple, multiplier: tuple):
    """(g + Aλ, diagonal blocks (11, 12, 13, 22, 23, 33), blocks to the next edge, non-zero rows of A) of the free edges;
    ``pairs`` is (g_left, g_right, H_left, H_right, H_across) of each pair."""
    from_left, from_right, left, right, across = pairs
    free = tuple(part[1:-1] for part in frames)
    length = task.length[1:-1]
    force = tuple(length * (g * task.arm[1:-1] + m) for g, m in zip(task.gravity, multiplier, strict=True))
    m1, m2 = _first_director(free), _second_director(free)
    ct, c1, c2 = (dot(force, axis) for axis in (_tangent(free), m1, m2))
    gradient = tuple(a[:-1] + b[1:] for a, b in zip(from_right, from_left, strict=True))
    diagonal = tuple(a[:-1] + b[1:] for a, b in zip(right, left, strict=True))
    none = jnp.zeros_like(ct)
    gradient = tuple(a + b for a, b in zip(gradient, (none, -c2, c1), strict=True))
    linear = (none, c1 / 2, c2 / 2, -ct, none, -ct)
    diagonal = tuple(a + b for a, b in zip(diagonal, linear, strict=True))
    across = tuple(jnp.concatenate([part[1:-1], none[:1]]) for part in across)
    closure = (tuple(-length * part for part in m2), tuple(length * part for part in m1))
    return gradient, diagonal, across, closure


def solved(gradient: tuple, diagonal: tuple, across: tuple, closure: tuple, miss: tuple):
    """(δλ, whether the inertia is right, step three of (E−2, W)) by block LDLᵀ, bordered by the columns of closure."""
    none = jnp.zeros_like(miss[0])
    begin = ((none,) * 6, (none,) * 3, (none,) * 9, (none,) * 6, (none,) * 3, none)
    (_, _, _, schur, right_side, negative), kept = lax.scan(_eliminated, begin, (gradient, diagonal, across, closure))
    change, minors = _solve(schur, tuple(a + b for a, b in zip(right_side, miss, strict=True)))
    signs = [minors[0] > 0, (minors[0] > 0) == (minors[1] > 0), (minors[1] > 0) == (minors[2] > 0)]
    lower, (u0, u1, u2), r, a = kept
    r = tuple(part - dot(change, of_a) for part, of_a in zip(r, zip(*a, strict=True), strict=True))

    def substituted(after, row):
        (l21, l31, l32), u, (r0, r1, r2) = row
        w2 = r2 - dot(u[2], after)
        w1 = r1 - dot(u[1], after) - l32 * w2
        w0 = r0 - dot(u[0], after) - l21 * w1 - l31 * w2
        return (w0, w1, w2), (w0, w1, w2)

    _, step = lax.scan(substituted, (none,) * 3, (lower, tuple(zip(u0, u1, u2, strict=True)), r), reverse=True)
    return change, negative + sum(sign.astype(jnp.int32) for sign in signs) == 3, step


def _eliminated(before: tuple, row: tuple):
    """One edge of the forward sweep: W = L⁻¹ [U | −g | A], kept over the pivots, and what it takes off the next edge."""
    (e0, e1, e2, e3, e4, e5), taken, (a0, a1, a2, a3, a4, a5, a6, a7, a8), schur, right_side, negative = before
    gradient, (d0, d1, d2, d3, d4, d5), u, (minus_m2, m1) = row
    p0, b, c, e, f, g = d0 - e0, d1 - e1, d2 - e2, d3 - e3, d4 - e4, d5 - e5
    i0 = 1 / p0
    l21, l31 = b * i0, c * i0
    p1, rest = e - l21 * b, f - l21 * c
    i1 = 1 / p1
    l32 = rest * i1
    p2 = g - l31 * c - l32 * rest
    i2 = 1 / p2

    def forward(x, y, z):
        y = y - l21 * x
        return x, y, z - l31 * x - l32 * y

    def over(w):
        return w[0] * i0, w[1] * i1, w[2] * i2

    wu = [forward(u[k], u[3 + k], u[6 + k]) for k in range(3)]
    wr = forward(*(-part - off for part, off in zip(gradient, taken, strict=True)))
    wa = [forward(-x, first - y, second - z) for x, first, y, second, z in zip(
        (a0, a1, a2), minus_m2, (a3, a4, a5), m1, (a6, a7, a8), strict=True)]
    vu, vr, va = [over(w) for w in wu], over(wr), [over(w) for w in wa]
    schur = tuple(s + dot(va[i], wa[k]) for s, (i, k) in zip(schur, UPPER, strict=True))
    right_side = tuple(z + dot(v, wr) for z, v in zip(right_side, va, strict=True))
    negative = negative + (p0 < 0) + (p1 < 0) + (p2 < 0)
    after = (tuple(dot(vu[i], wu[k]) for i, k in UPPER), tuple(dot(v, wr) for v in vu),
             tuple(dot(v, w) for v in vu for w in wa), schur, right_side, negative)
    return after, ((l21, l31, l32), vu, vr, va)


# --- quaternions and small matrices ----------------------------------------------------------------------------------


def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def on_diagonal(m, value) -> tuple:
    """M + value of a symmetric M."""
    return tuple(entry + value if i == k else entry for entry, (i, k) in zip(m, UPPER, strict=True))


def largest(a, b, c):
    return jnp.maximum(a, jnp.maximum(b, c))


def _solve(m, b):
    """x with M x = b for a symmetric M, by Cramer's rule, and M's leading minors."""
    c11, c12, c13 = m[3] * m[5] - m[4] * m[4], m[2] * m[4] - m[1] * m[5], m[1] * m[4] - m[2] * m[3]
    c22, c23, c33 = m[0] * m[5] - m[2] * m[2], m[1] * m[2] - m[0] * m[4], m[0] * m[3] - m[1] * m[1]
    third = m[0] * c11 + m[1] * c12 + m[2] * c13
    return tuple(dot(row, b) / third for row in ((c11, c12, c13), (c12, c22, c23), (c13, c23, c33))), (m[0], c33, third)


def product(p, q):
    return (p[0] * q[0] - p[1] * q[1] - p[2] * q[2] - p[3] * q[3], p[0] * q[1] + p[1] * q[0] + p[2] * q[3] - p[3] * q[2],
            p[0] * q[2] + p[2] * q[0] + p[3] * q[1] - p[1] * q[3], p[0] * q[3] + p[3] * q[0] + p[1] * q[2] - p[2] * q[1])


def normalised(q):
    size = 1 / jnp.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    return tuple(part * size for part in q)


def _between(ends, inner):
    """Frames with the first and last of ``ends``."""
    return tuple(jnp.concatenate([end[:1], part, end[-1:]]) for end, part in zip(ends, inner, strict=True))


def _tangent(q):
    return 1 - 2 * (q[2] * q[2] + q[3] * q[3]), 2 * (q[1] * q[2] + q[0] * q[3]), 2 * (q[1] * q[3] - q[0] * q[2])


def _first_director(q):
    return 2 * (q[1] * q[2] - q[0] * q[3]), 1 - 2 * (q[1] * q[1] + q[3] * q[3]), 2 * (q[2] * q[3] + q[0] * q[1])


def _second_director(q):
    return 2 * (q[1] * q[3] + q[0] * q[2]), 2 * (q[2] * q[3] - q[0] * q[1]), 1 - 2 * (q[1] * q[1] + q[2] * q[2])
