"""The distance of two straight edges inside kernels, a function of their four ends with two derivatives (docs/contact.md).

With the ends x_i, x_i + p of one edge and x_j, x_j + q of the other, w = x_j − x_i and ε a small square of a length,

    D² = min over 0 ≤ s, t ≤ 1 of |w + t q − s p|² + ε ((s − ½)² + (t − ½)²).

The term with ε makes the minimum unique, and D smooth, where the edges are parallel. With r = w + t q − s p at the minimum
and c = (s − 1, −s, 1 − t, t), the gradient of D by the ends is c_k r/D, and the second derivatives of D² are those at fixed s
and t, 2 c_k c_l I, less what s and t give by moving along.
"""

import taichi as ti

from doo_ti.physics.tuples import choose, dot, minus, plus, record, scaled, traced


@traced
def pair_weights(s, t) -> tuple:
    """c: how r depends on the four ends."""
    return (s - 1.0, 0.0 - s, 1.0 - t, t)


@ti.func
def within(value):
    """A share of an edge, at least none of it and at most all."""
    zero = 0.0 * value
    return ti.min(ti.max(value, zero), zero + 1.0)


@ti.func
def nearest_places(w, p, q, even):
    """A record of the nearest places ``s`` and ``t`` of two edges, of ``square``, D² there, of which ``s_moves`` and
    ``t_moves``, one or zero, and of the entries ``pp``, ``pq``, ``qq`` of half the second derivative by s and −t."""
    zero = 0.0 * even
    pp, qq, pq = dot(p, p) + even, dot(q, q) + even, dot(p, q)
    wp, wq, ww = dot(w, p) + 0.5 * even, dot(w, q) - 0.5 * even, dot(w, w) + 0.5 * even
    determinant = pp * qq - pq * pq
    s, t = (wp * qq - wq * pq) / determinant, (wp * pq - wq * pp) / determinant
    best = record(s=zero, t=zero, square=zero + 1e30)
    # First both places within their edges: of parallel ones rounding decides if they are. Then one at an end of its edge, the
    # other the nearest to it.
    for side in ti.static(range(-1, 4)):
        end = zero + float(side % 2)
        if ti.static(side >= 2):
            s, t = within((wp + pq * end) / pp), end
        elif ti.static(side >= 0):
            s, t = end, within((pq * end - wq) / qq)
        inside = (s >= 0.0) & (s <= 1.0) & (t >= 0.0) & (t <= 1.0)
        square = ww + s * (s * pp - 2.0 * wp) + t * (t * qq + 2.0 * wq) - 2.0 * s * t * pq
        nearer = inside & (square < best.square)
        choose(best, nearer, s=s, t=t, square=square)
    one = zero + 1.0
    s_moves = ti.select((best.s > 0.0) & (best.s < 1.0), one, zero)
    t_moves = ti.select((best.t > 0.0) & (best.t < 1.0), one, zero)
    return record(s=best.s, t=best.t, s_moves=s_moves, t_moves=t_moves, pp=pp, pq=pq, qq=qq)


@ti.func
def pair_distance(w, p, q, even):
    """A record: the nearest places ``s`` and ``t``; ``value`` D; ``normal`` r/D; ``across`` r; and the entries of the inverse
    of half the second derivative of D² by s and t, zero for a place at an end, ``ss``, ``st``, ``tt``."""
    found = nearest_places(w, p, q, even)
    across = plus(minus(w, scaled(p, found.s)), scaled(q, found.t))
    off_s, off_t = found.s - 0.5, found.t - 0.5
    value = ti.sqrt(dot(across, across) + even * (off_s * off_s + off_t * off_t) + 1e-30)
    both = found.s_moves * found.t_moves
    scale = 1.0 / (found.pp * found.qq - both * found.pq * found.pq)
    return record(s=found.s, t=found.t, value=value, normal=scaled(across, 1.0 / value), across=across,
                  ss=found.s_moves * scale * found.qq, st=both * scale * found.pq, tt=found.t_moves * scale * found.pp)


@traced
def pair_slopes(weights, seen, p, q) -> tuple:
    """Half the mixed second derivatives of D² by the ends and by s, and by the ends and by t: two times four vectors."""
    of_p, of_q = (-1.0, 1.0, 0.0, 0.0), (0.0, 0.0, -1.0, 1.0)
    return tuple(
        0.0 - weights[k] * p[a] - of_p[k] * seen.across[a] for k in range(4) for a in range(3)
    ) + tuple(weights[k] * q[a] + of_q[k] * seen.across[a] for k in range(4) for a in range(3))


@traced
def pair_block(own, other, seen, push, stiffness) -> tuple:
    """The second derivative by two ends, row by row, of an energy of D, of which −``push`` is the first and ``stiffness`` the
    second derivative. Of both ends the ``weight``, and the mixed derivatives ``by_s`` and ``by_t`` of :func:`pair_slopes`.

    ∇∇D = (∇∇(D²)/2 − ∇D ∇Dᵀ)/D.
    """
    share = push / seen.value
    both = own.weight * other.weight
    outer = both * (stiffness + share)
    block = []
    for a in range(3):
        for b in range(3):
            moved = (own.by_s[a] * (seen.ss * other.by_s[b] + seen.st * other.by_t[b])
                     + own.by_t[a] * (seen.st * other.by_s[b] + seen.tt * other.by_t[b]))
            entry = outer * seen.normal[a] * seen.normal[b] + share * moved
            block.append(entry - both * share if a == b else entry)
    return tuple(block)
