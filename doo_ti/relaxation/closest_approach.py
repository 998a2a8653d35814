"""Whether a rod touches itself on the straight way of its vertices from one shape to another (docs/contact.md).

The way is followed for every pair of edges that may come near to each other, from one instant to the first at which the two
could touch: their distance then, less that at which they touch, over the largest change of any distance between them.
"""

import taichi as ti

from doo_ti.physics.tuples import dot, minus, picked, plus, scaled
from doo_ti.physics.view import Layout, exact
from doo_ti.relaxation.pair_distance import nearest_places, within

WAY = Layout(before=3, after=3, arc=1)
"""Of a vertex: its place before and after, and the length of rod up to it."""
ENOUGH = 1e-3
"""Radii, nearer than which two edges touch."""


@ti.func
def least_distance(before, change):
    """The least distance of two places on their straight ways: ``before`` from one to the other at first, and the ``change`` of
    that."""
    share = within((0.0 - dot(before, change)) / (dot(change, change) + 1e-30))
    nearest = plus(before, scaled(change, share))
    return ti.sqrt(dot(nearest, nearest))


@ti.data_oriented
class ClosestApproach:
    """The ways of rods.

    A ``rod`` is a record of ``head``, the view of its vertex 0 in a lane of scratch, its ``edges``, the distance ``near`` at
    which two of them touch, to within ``enough``, and the length ``least_arc`` of rod that is between any two that count, mm.
    """

    @picked
    def vertex(self, head, v):
        """The view of vertex ``v``."""
        return head.part(WAY, v * len(WAY))

    @ti.func
    def before(self, rod, vertex):
        return exact(self.vertex(rod.head, vertex).before)

    @ti.func
    def after(self, rod, vertex):
        return exact(self.vertex(rod.head, vertex).after)

    @ti.func
    def arc(self, rod, first, last):
        """The length of rod between two vertices."""
        return exact(self.vertex(rod.head, last).arc) - exact(self.vertex(rod.head, first).arc)

    @ti.func
    def apart(self, rod, first, last, share):
        """From one vertex to another when both have gone that ``share`` of their ways."""
        old = minus(self.before(rod, last), self.before(rod, first))
        return plus(old, scaled(self.moved(rod, first, last), share))

    @ti.func
    def moved(self, rod, first, last):
        """The displacement of a vertex against another."""
        whole = minus(self.after(rod, last), self.before(rod, last))
        return minus(whole, minus(self.after(rod, first), self.before(rod, first)))

    @ti.func
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

    @ti.func
    def room_of_middles(self, rod, i, j):
        """By how much the middles of two edges stay too far apart on the way for the edges to touch."""
        before = scaled(plus(self.apart(rod, i, j, 0.0), self.apart(rod, i + 1, j + 1, 0.0)), 0.5)
        change = scaled(plus(self.moved(rod, i, j), self.moved(rod, i + 1, j + 1)), 0.5)
        return least_distance(before, change) - 0.5 * (self.arc(rod, i, i + 1) + self.arc(rod, j, j + 1)) - rod.near

    @ti.func
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

    @ti.func
    def missing_arc(self, rod, first, last, share):
        """How much too little of the rod is between two vertices at that ``share`` of the way, and by how much this may change
        on all of it."""
        missing, most = rod.least_arc, ti.cast(0.0, ti.f64)
        for e in range(first, last):
            edge, change = self.apart(rod, e, e + 1, share), self.moved(rod, e, e + 1)
            missing, most = missing - ti.sqrt(dot(edge, edge)), most + ti.sqrt(dot(change, change))
        return missing, most
