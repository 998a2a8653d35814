"""The distance of two straight edges inside kernels, a function of their four ends with two derivatives, and whether a rod
touches itself on the straight way of its vertices from one shape to another (docs/contact.md).

With the ends x_i, x_i + p of one edge and x_j, x_j + q of the other, w = x_j − x_i and ε a small square of a length,

    D² = min over 0 ≤ s, t ≤ 1 of |w + t q − s p|² + ε ((s − ½)² + (t − ½)²).

The term with ε makes the minimum unique, and D smooth, where the edges are parallel. With r = w + t q − s p at the minimum
and c = (s − 1, −s, 1 − t, t), the gradient of D by the ends is c_k r/D, and the second derivatives of D² are those at fixed s
and t, 2 c_k c_l I, less what s and t give by moving along.

The way is followed for every pair of edges that may come near to each other, from one instant to the first at which the two
could touch: their distance then, less that at which they touch, over the largest change of any distance between them.
"""

import taichi as ti

from doo_ti.physics.number import Layout, device_functions, in_f64
from doo_ti.physics.tuples import dot, minus, picked, plus, record, scaled, traced


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
        best.s, best.t = ti.select(nearer, s, best.s), ti.select(nearer, t, best.t)
        best.square = ti.select(nearer, square, best.square)
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


WAY = Layout(before=3, after=3, arc=1)  # of a vertex: its place before and after, and the length of rod up to it
ENOUGH = 1e-3  # radii, nearer than which two edges touch


@ti.func
def least_distance(before, change):
    """The least distance of two places on straight ways: ``before`` from one to the other at first, and by its ``change``."""
    share = within((0.0 - dot(before, change)) / (dot(change, change) + 1e-30))
    nearest = plus(before, scaled(change, share))
    return ti.sqrt(dot(nearest, nearest))


@device_functions
class ClosestApproach:
    """The ways of rods.

    A ``rod`` is a record of ``head``, the view of its vertex 0 in a lane of scratch, its ``edges``, the distance ``near`` at
    which two of them touch, to within ``enough``, and the length ``least_arc`` of rod that is between any two that count, mm.
    """

    @picked
    def vertex(self, head, v):
        """The view of vertex ``v``."""
        return head.part(WAY, v * len(WAY))

    def arc(self, rod, first, last):
        """The length of rod between two vertices."""
        return in_f64(self.vertex(rod.head, last).arc) - in_f64(self.vertex(rod.head, first).arc)

    def apart(self, rod, first, last, share):
        """From one vertex to another when both have gone that ``share`` of their ways."""
        old = minus(in_f64(self.vertex(rod.head, last).before), in_f64(self.vertex(rod.head, first).before))
        return plus(old, scaled(self.moved(rod, first, last), share))

    def moved(self, rod, first, last):
        """The displacement of a vertex against another."""
        one, other = self.vertex(rod.head, first), self.vertex(rod.head, last)
        return minus(minus(in_f64(other.after), in_f64(other.before)), minus(in_f64(one.after), in_f64(one.before)))

    def touches(self, rod):
        """Whether any two edges touch on their way, or are not finite."""
        longest = ti.cast(0.0, ti.f64)
        for e in range(rod.edges):
            longest = ti.max(longest, self.arc(rod, e, e + 1))
        touching, i = False, 0
        while i < rod.edges - 2 and not touching:
            j = i + 2
            while j < rod.edges and not touching:
                ahead = 1
                if self.arc(rod, i + 1, j) > rod.least_arc:
                    room = self.room_of_middles(rod, i, j)
                    if room > 0.0:
                        # A place further along the rod is nearer by no more than it is further along.
                        ahead += ti.cast(ti.min(room / longest, 1e6), ti.i32)
                    else:
                        touching = self.edges_touch(rod, i, j)
                j += ahead
            i += 1
        return touching

    def room_of_middles(self, rod, i, j):
        """By how much the middles of two edges stay too far apart on the way for the edges to touch."""
        before = scaled(plus(self.apart(rod, i, j, 0.0), self.apart(rod, i + 1, j + 1, 0.0)), 0.5)
        change = scaled(plus(self.moved(rod, i, j), self.moved(rod, i + 1, j + 1)), 0.5)
        return least_distance(before, change) - 0.5 * (self.arc(rod, i, i + 1) + self.arc(rod, j, j + 1)) - rod.near

    def edges_touch(self, rod, i, j):
        """Whether edges i and j touch on their way, or are not finite."""
        fastest = ti.cast(0.0, ti.f64)
        for a in ti.static(range(2)):
            for b in ti.static(range(2)):
                change = self.moved(rod, i + a, j + b)
                fastest = ti.max(fastest, ti.sqrt(dot(change, change)))
        share, touching = ti.cast(0.0, ti.f64), False
        while share < 1.0 and not touching:
            w, p, q = self.apart(rod, i, j, share), self.apart(rod, i, i + 1, share), self.apart(rod, j, j + 1, share)
            found = nearest_places(w, p, q, 0.0 * share)
            across = plus(minus(w, scaled(p, found.s)), scaled(q, found.t))
            room = ti.sqrt(dot(across, across)) - rod.near
            if room > rod.enough:
                share += room / (fastest + 1e-30)
            else:
                # Edges shorten on the way where they turn far. Enough of the rod has to be between two that touch.
                missing, change = self.missing_arc(rod, i + 1, j, share)
                touching = not missing > rod.enough
                share += missing / (change + 1e-30)
        return touching

    def missing_arc(self, rod, first, last, share):
        """How much too little of the rod is between two vertices at that ``share`` of the way; by how much it may change."""
        missing, most = rod.least_arc, ti.cast(0.0, ti.f64)
        for e in range(first, last):
            edge, change = self.apart(rod, e, e + 1, share), self.moved(rod, e, e + 1)
            missing, most = missing - ti.sqrt(dot(edge, edge)), most + ti.sqrt(dot(change, change))
        return missing, most
