"""Contact of a chain with itself: between any two edges with enough of the rod between them (docs/contact.md).

It is the contact of :mod:`.contact_energy`, with the distance of two edges less two radii for the gap. It couples edges far
from each other along the rod, so the Newton system is no longer a band (:mod:`.dense_elimination`).
"""

import taichi as ti

from doo_ti.contact.itself import LEAST_ARC
from doo_ti.physics.algebra import largest_of
from doo_ti.physics.tuples import chosen, dot, full, minus, plus, record, repeated, scaled, variable
from doo_ti.relaxation.contact_layout import (
    CLOSEST,
    CROSSING,
    DEEPEST,
    LOADED,
    PLACE,
    RADIUS,
    STANDING,
    STIFFNESS,
    TOLERANCE,
    contact_items,
)
from doo_ti.relaxation.contacts import Contacts
from doo_ti.relaxation.pair_distance import pair_block, pair_distance, pair_slopes, pair_weights
from doo_ti.relaxation.pair_layout import (
    ARC,
    COEFFICIENT,
    DEEPEST_STEP,
    DISTANCE,
    DISTANCE_STANDING,
    FORCE,
    FRICTION,
    LEAST_DISTANCE,
    LOAD,
    PAIR_ITEMS,
    PINCHED,
    PLACES,
    PULL,
    REACH,
    ROD_ITEMS,
    ROUNDED,
    RUBBED_NORMAL,
    RUBBED_PLACES,
    SLOPES,
    VERTEX_ITEMS,
    WEIGHTS,
    pair_items,
)


@ti.data_oriented
class SelfContactEnergy(Contacts):
    """The contacts with obstacles and the energy of those of the rod with itself."""

    def __init__(self, number, stride: int, kinds: frozenset[int], rub: bool = False, moves: bool = False):
        super().__init__(number, stride, kinds, rub, moves)
        # Without the barrier parts of the rod could pass through each other, thin as they are.
        self.first_phase, self.settles_early = LOADED, False

    # --- items in scratch ---

    @ti.func
    def own(self, rod):
        """Where the items of the rod's contact with itself begin."""
        return rod.contacts + contact_items(rod.edges, rod.obstacles) * self.stride

    @ti.func
    def own_vertex(self, rod, index):
        return self.own(rod) + (ROD_ITEMS + index * VERTEX_ITEMS) * self.stride

    @ti.func
    def pair(self, rod, i, j):
        """Of the edges ``i`` < ``j``."""
        number = j * (j - 1) // 2 + i
        return self.own(rod) + (ROD_ITEMS + (rod.edges + 1) * VERTEX_ITEMS + number * PAIR_ITEMS) * self.stride

    @ti.func
    def matrix_at(self, rod):
        """Where the dense matrix begins."""
        return self.own(rod) + pair_items(rod.edges) * self.stride

    @ti.func
    def block(self, rod, row, column, r: ti.template()):
        """Row ``r`` of the block of two vertices in the lower triangle of the matrix."""
        line = 3 * row + r
        return self.matrix_at(rod) + (line * (line + 1) // 2 + 3 * column) * self.stride

    @ti.func
    def add_to(self, scratch: ti.template(), at, values):
        for k in ti.static(range(len(values))):
            scratch[at + k * self.stride] = scratch[at + k * self.stride] + values[k]

    @ti.func
    def add_load(self, rod, index, values):
        """Add to the gradient at a vertex."""
        self.add_to(rod.scratch, self.own_vertex(rod, index) + LOAD * self.stride, values)

    @ti.func
    def add_block(self, rod, row, column, values):
        """Add nine numbers to the block of two vertices."""
        for r in ti.static(range(3)):
            self.add_to(rod.scratch, self.block(rod, row, column, r), (values[3 * r], values[3 * r + 1], values[3 * r + 2]))

    @ti.func
    def add_diagonal(self, rod, row, values):
        """The same on the diagonal, of which the lower triangle is kept."""
        self.add_to(rod.scratch, self.block(rod, row, row, 0), (values[0],))
        self.add_to(rod.scratch, self.block(rod, row, row, 1), (values[3], values[4]))
        self.add_to(rod.scratch, self.block(rod, row, row, 2), (values[6], values[7], values[8]))

    @ti.func
    def place(self, rod, index):
        return self.load3(rod.scratch, self.vertex(rod, index) + PLACE * self.stride)

    @ti.func
    def measure_arc(self, rod):
        """Note how much of the rod lies before each vertex."""
        arc = 0.0 * rod.total
        before = variable(repeated(arc, 3))
        for v in range(rod.edges + 1):
            place = self.place(rod, v)
            if v > 0:
                edge = minus(place, before)
                arc = arc + ti.sqrt(dot(edge, edge))
            before = place
            self.store(rod.scratch, self.own_vertex(rod, v) + PULL * self.stride, repeated(0.0 * arc, 3))
            rod.scratch[self.own_vertex(rod, v) + ARC * self.stride] = arc

    # --- the energy ---

    @ti.func
    def touch_itself(self, rod):
        """Measure the distances of all edges from each other, where the rod is, and add the energy of their contacts to the
        sums, its gradient to the vertices and its second derivative to the matrix."""
        zero, radius = 0.0 * rod.total, self.item(rod, RADIUS)
        self.measure_arc(rod)
        rod.scratch[self.own(rod) + PINCHED * self.stride] = zero
        for j in range(2, rod.edges):
            start, end = self.place(rod, j), self.place(rod, j + 1)
            arc = rod.scratch[self.own_vertex(rod, j) + ARC * self.stride] - LEAST_ARC * radius
            for i in range(j - 1):
                at = self.pair(rod, i, j)
                self.note_crossing(rod, i, j, at)
                first, last = self.place(rod, i), self.place(rod, i + 1)
                away = minus(plus(start, end), plus(first, last))
                # No two places are nearer than the middles less half of both edges.
                bound = 0.5 * ti.sqrt(dot(away, away)) - rod.longest
                apart = self.apart(rod, i, at, arc)
                rod.scratch[at + DISTANCE * self.stride] = ti.select(apart, bound, zero + 1e30)
                near = apart & (self.pair_clearance(rod, i, j, bound) < REACH * radius)
                if self.some(near, zero):
                    self.touch(rod, i, j, at, near, minus(start, first), minus(last, first), minus(end, start))
                if ti.static(self.rub):
                    # Friction stays as long as its round, however far the edges move apart.
                    self.rub_pair(rod, i, j, at)
        for v in range(rod.edges + 1):
            at = self.own_vertex(rod, v)
            self.add_to(rod.scratch, at + LOAD * self.stride, self.load3(rod.scratch, at + PULL * self.stride))

    @ti.func
    def apart(self, rod, i, at, arc):
        """Whether edge ``i`` may touch an edge that begins ``arc`` along the rod less what must lie between them; their items
        begin ``at``."""
        return arc > rod.scratch[self.own_vertex(rod, i + 1) + ARC * self.stride]

    @ti.func
    def pair_clearance(self, rod, i, j, distance):
        """The ``distance`` of two edges, less what is added to RADIUS on both (:meth:`clearance`)."""
        return self.clearance(rod, j + 1, self.clearance(rod, i + 1, distance))

    @ti.func
    def touch(self, rod, i, j, at, near, w, p, q):
        """The same of two edges p and q, with w from the start of the first to that of the second, in the lanes where they are
        ``near`` to each other."""
        zero, radius = 0.0 * rod.total, self.item(rod, RADIUS)
        seen = pair_distance(w, p, q, ROUNDED * radius * radius)
        self.store(rod.scratch, at + PLACES * self.stride, (seen.s, seen.t) + seen.normal)
        rod.scratch[at + DISTANCE * self.stride] = ti.select(near, seen.value, rod.scratch[at + DISTANCE * self.stride])
        self.note_depth(rod, at, near, seen.value)
        gap = ti.select(near, self.pair_clearance(rod, i, j, seen.value) - 2.0 * radius, zero + 1e30)
        depth = ti.select(near, seen.value - LEAST_DISTANCE * radius, zero + 1e30)
        held = (self.held_edge(rod, i) > 0.5) & (self.held_edge(rod, j) > 0.5)
        self.lower(rod.scratch, rod.contacts + DEEPEST * self.stride, depth)
        self.lower(rod.scratch, self.own(rod) + PINCHED * self.stride, ti.select(held, gap, zero))
        self.lower(rod.scratch, rod.contacts + CLOSEST * self.stride, ti.select(held, zero + 1e30, gap))
        pushed = self.push(rod, rod.scratch[at + FORCE * self.stride], gap)
        push, stiffness = ti.select(near, pushed.push, zero), ti.select(near, pushed.stiffness, zero)
        self.add_penalty(rod, ti.select(near, pushed.energy, zero), push * rod.total)
        if self.some((push > 0.0) | (stiffness > 0.0), zero):
            weights = pair_weights(seen.s, seen.t)
            self.store(rod.scratch, self.end(rod, 0), weights + pair_slopes(weights, seen, p, q))
            for k in range(4):
                own = self.load_end(rod, k)
                pull = self.own_vertex(rod, self.vertex_of(i, j, k)) + PULL * self.stride
                self.add_to(rod.scratch, pull, scaled(seen.normal, 0.0 - push * own.weight))
                for m in range(k + 1):
                    block = pair_block(own, self.load_end(rod, m), seen, push, stiffness)
                    self.add_ends(rod, i, j, k, m, block)

    @ti.func
    def end(self, rod, k):
        """Where the weight of end ``k`` of four is, of the two edges that are looked at."""
        return self.own(rod) + (WEIGHTS + k) * self.stride

    @ti.func
    def load_end(self, rod, k):
        """A record of the weight of an end, and of the mixed derivatives by it and by the places on both edges."""
        slopes = self.own(rod) + (SLOPES + 3 * k) * self.stride
        return record(weight=rod.scratch[self.end(rod, k)], by_s=self.load3(rod.scratch, slopes),
                      by_t=self.load3(rod.scratch, slopes + 12 * self.stride))

    @ti.func
    def vertex_of(self, i, j, k):
        """The vertex that is end ``k`` of the edges ``i`` and ``j``."""
        return ti.select(k < 2, i + k, j + k - 2)

    @ti.func
    def add_ends(self, rod, i, j, k, m, values):
        """Add nine numbers to the block of two of the four ends, m ≤ k."""
        if k == m:
            self.add_diagonal(rod, self.vertex_of(i, j, k), values)
        else:
            self.add_block(rod, self.vertex_of(i, j, k), self.vertex_of(i, j, m), values)

    @ti.func
    def pinched_pairs(self, rod):
        """Whether clamps hold two edges where they are in each other."""
        return rod.scratch[self.own(rod) + PINCHED * self.stride] < 0.0 - self.item(rod, TOLERANCE)

    @ti.func
    def held_edge(self, rod, edge):
        """One where clamps hold both ends of an edge."""
        return ti.min(self.held(rod, edge), self.held(rod, edge + 1))

    @ti.func
    def note_crossing(self, rod, i, j, at):
        """By how much of their distance before the step two edges have come nearer to each other at most."""
        most = 0.0 * rod.total
        for a in ti.static(range(2)):
            for b in ti.static(range(2)):
                shift = minus(self.shift(rod, j + b), self.shift(rod, i + a))
                most = largest_of(most, dot(shift, shift))
        before = rod.scratch[at + DISTANCE_STANDING * self.stride]
        crossing = rod.contacts + CROSSING * self.stride
        rod.scratch[crossing] = largest_of(rod.scratch[crossing], most / (before * before + 1e-20))

    @ti.func
    def note_depth(self, rod, at, near, value):
        """Note that the step is refused where it brings two edges nearer than :data:`DEEPEST_STEP`, in the lanes where they are
        ``near``: the distance is a little too large there, so that they could pass through each other."""
        zero = 0.0 * value
        before = rod.scratch[at + DISTANCE_STANDING * self.stride]
        nearer = near & (value < DEEPEST_STEP * self.item(rod, RADIUS)) & (value < before)
        crossing = rod.contacts + CROSSING * self.stride
        rod.scratch[crossing] = largest_of(rod.scratch[crossing], ti.select(nearer, zero + 1.0, zero))

    @ti.func
    def shift(self, rod, index):
        """How far a vertex has moved in this step."""
        at = self.vertex(rod, index)
        return minus(self.load3(rod.scratch, at + PLACE * self.stride), self.load3(rod.scratch, at + STANDING * self.stride))

    # --- friction ---

    @ti.func
    def moved_pair(self, rod, i, j, at):
        """How far the places at which friction acts on two edges have moved along each other since the instant before."""
        s, t = rod.scratch[at + RUBBED_PLACES * self.stride], rod.scratch[at + (RUBBED_PLACES + 1) * self.stride]
        first = plus(scaled(self.moved(rod, self.vertex(rod, i)), 1.0 - s), scaled(self.moved(rod, self.vertex(rod, i + 1)), s))
        late = plus(scaled(self.moved(rod, self.vertex(rod, j)), 1.0 - t), scaled(self.moved(rod, self.vertex(rod, j + 1)), t))
        return minus(late, first)

    @ti.func
    def rubbed_pair(self, rod, i, j, at):
        """Friction of two edges, as :meth:`.ContactEnergy.rubbed`."""
        limit = rod.scratch[self.own(rod) + COEFFICIENT * self.stride] * rod.scratch[at + FORCE * self.stride]
        friction = self.load3(rod.scratch, at + FRICTION * self.stride)
        normal = self.load3(rod.scratch, at + RUBBED_NORMAL * self.stride)
        return self.rubbed(rod, limit, friction, normal, self.moved_pair(rod, i, j, at))

    @ti.func
    def rub_pair(self, rod, i, j, at):
        """Add the friction of two edges."""
        zero = 0.0 * rod.total
        acting = rod.scratch[at + FORCE * self.stride] > 0.0
        if self.some(acting, zero):
            rubbed = self.rubbed_pair(rod, i, j, at)
            pull = chosen(acting, rubbed.pull, repeated(zero, 3))
            bent = chosen(acting, rubbed.stiffness, repeated(zero, 6))
            square = ti.select(acting, dot(pull, pull), zero) / self.item(rod, STIFFNESS)
            self.add_penalty(rod, ti.select(acting, rubbed.energy, zero), square)
            weights = pair_weights(rod.scratch[at + RUBBED_PLACES * self.stride],
                                   rod.scratch[at + (RUBBED_PLACES + 1) * self.stride])
            self.store(rod.scratch, self.end(rod, 0), weights)
            for k in range(4):
                weight = rod.scratch[self.end(rod, k)]
                vertex = self.own_vertex(rod, self.vertex_of(i, j, k))
                self.add_to(rod.scratch, vertex + PULL * self.stride, scaled(pull, weight))
                for m in range(k + 1):
                    self.add_ends(rod, i, j, k, m, full(scaled(bent, weight * rod.scratch[self.end(rod, m)])))
