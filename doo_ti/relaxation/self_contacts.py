"""Contact of a chain with itself: between any two edges with enough of the rod between them (docs/contact.md).

It is the contact of :mod:`.contact_energy`, with the distance of two edges less two radii for the gap, and with steps in which
the rod does not pass through itself. It couples edges far from each other along the rod, so the Newton system is not a band any
more (:mod:`.dense_elimination`).
"""

import taichi as ti

from doo_ti.contact.surroundings import LEAST_ARC
from doo_ti.physics.algebra import full, largest_of, row
from doo_ti.physics.number import NUMBERS, device_functions
from doo_ti.physics.tuples import add, choose, chosen, dot, minus, picked, plus, record, repeated, scaled, variable
from doo_ti.relaxation import contact_table as layout
from doo_ti.relaxation.contacts import NONE, RodContacts
from doo_ti.relaxation.pair_distance import pair_block, pair_distance, pair_slopes, pair_weights


@device_functions
class SelfContacts(RodContacts):
    """The contacts with obstacles and those of the rod with itself."""

    itself = True

    def __init__(self, number, has_grid: bool, rub: bool = False, moves: bool = False):
        super().__init__(number, has_grid, rub, moves)
        self.updates_in_steps = False

    # --- views of scratch ---

    @picked
    def items(self, tables):
        edges = tables.rest_length.shape[1]
        return layout.contact_items(edges, tables.kinds.shape[0]) + layout.pair_items(edges) + layout.matrix_items(edges + 1)

    @picked
    def own(self, rod):
        """That of the rod's contact with itself."""
        return rod.contacts.part(layout.ITSELF, layout.contact_items(rod.edges, rod.obstacles))

    @picked
    def own_vertex(self, rod, index):
        return self.own(rod).part(layout.ITSELF_VERTEX, len(layout.ITSELF) + index * len(layout.ITSELF_VERTEX))

    @picked
    def pair(self, rod, i, j):
        """Of the edges ``i`` < ``j``."""
        return self.numbered_pair(rod, j * (j - 1) // 2 + i)

    @picked
    def numbered_pair(self, rod, number):
        before = len(layout.ITSELF) + (rod.edges + 1) * len(layout.ITSELF_VERTEX)
        return self.own(rod).part(layout.PAIR, before + number * len(layout.PAIR))

    @picked
    def matrix(self, rod):
        return self.own(rod).part(NUMBERS, layout.pair_items(rod.edges))

    @picked
    def block(self, rod, row, column, r: int):
        """Row ``r`` of the block of two vertices in the lower triangle of the matrix."""
        line = 3 * row + r
        return self.matrix(rod).part(NUMBERS, line * (line + 1) // 2 + 3 * column)

    def add_load(self, rod, index, values):
        """Add to the gradient at a vertex."""
        add(self.own_vertex(rod, index), load=values)

    def add_block(self, rod, line, column, values):
        """Add nine numbers to the block of two vertices."""
        for r in ti.static(range(3)):
            add(self.block(rod, line, column, r), three=row(values, r))

    def add_diagonal(self, rod, line, values):
        """The same on the diagonal, of which the lower triangle is kept."""
        add(self.block(rod, line, line, 0), one=values[0])
        add(self.block(rod, line, line, 1), two=(values[3], values[4]))
        add(self.block(rod, line, line, 2), three=row(values, 2))

    # --- the energy ---

    def touch_itself(self, rod):
        """Measure the distances of all edges from each other, where the rod is, and add the energy of their contacts to the
        sums, its gradient to the vertices and its second derivative to the matrix."""
        zero, radius = 0.0 * rod.total, rod.contacts.radius
        arc, before = zero, variable(repeated(zero, 3))
        for v in range(rod.edges + 1):  # how much of the rod lies before each vertex
            place = self.vertex(rod, v).place
            if v > 0:
                edge = minus(place, before)
                arc = arc + ti.sqrt(dot(edge, edge))
            before = place
            self.own_vertex(rod, v).pull = repeated(zero, 3)
            self.own_vertex(rod, v).arc = arc
        self.own(rod).pinched = zero
        for j in range(2, rod.edges):
            start, end = self.vertex(rod, j).place, self.vertex(rod, j + 1).place
            least_arc = self.own_vertex(rod, j).arc - LEAST_ARC * radius
            for i in range(j - 1):
                at = self.pair(rod, i, j)
                self.note_crossing(rod, i, j, at)
                first, last = self.vertex(rod, i).place, self.vertex(rod, i + 1).place
                away = minus(plus(start, end), plus(first, last))
                # No two places are nearer than the middles less half of both edges.
                bound = 0.5 * ti.sqrt(dot(away, away)) - rod.longest
                counts = self.may_touch(rod, i, at, least_arc)
                at.distance_standing = at.distance
                at.distance = ti.select(counts, bound, zero + 1e30)
                near = counts & (self.pair_clearance(rod, i, j, bound) < layout.REACH * radius)
                if self.some(near, zero):
                    self.touch(rod, i, j, at, near, minus(start, first), minus(last, first), minus(end, start))
                if ti.static(self.rub):
                    # Friction stays as long as its round, however far the edges move apart.
                    self.rub_pair(rod, i, j, at)
        for v in range(rod.edges + 1):
            at = self.own_vertex(rod, v)
            add(at, load=at.pull)

    def may_touch(self, rod, i, at, arc):
        """Whether edge ``i`` may touch an edge that begins ``arc`` along the rod less what must lie between them; their items
        begin ``at``."""
        return arc > self.own_vertex(rod, i + 1).arc

    def pair_clearance(self, rod, i, j, distance):
        """The ``distance`` of two edges, less by how much the rod is thicker at both (:meth:`clearance`)."""
        return self.clearance(rod, j + 1, self.clearance(rod, i + 1, distance))

    def touch(self, rod, i, j, at, near, w, p, q):
        """The same of two edges p and q, with w from the start of the first to that of the second, in the lanes where they are
        ``near`` to each other."""
        zero, radius = 0.0 * rod.total, rod.contacts.radius
        seen = pair_distance(w, p, q, layout.ROUNDED * radius * radius)
        at.nearest = (seen.s, seen.t) + seen.normal
        at.distance = ti.select(near, seen.value, at.distance)
        # The step is refused where it brings two edges nearer than that: the distance is a little too large there, so that they
        # could pass through each other.
        nearer = near & (seen.value < layout.DEEPEST_STEP * radius) & (seen.value < at.distance_standing)
        rod.contacts.crossing = largest_of(rod.contacts.crossing, ti.select(nearer, zero + 1.0, zero))
        gap = ti.select(near, self.pair_clearance(rod, i, j, seen.value) - 2.0 * radius, zero + 1e30)
        depth = ti.select(near, seen.value - layout.LEAST_DISTANCE * radius, zero + 1e30)
        held = (self.held_edge(rod, i) > 0.5) & (self.held_edge(rod, j) > 0.5)
        rod.contacts.least_phi = ti.min(rod.contacts.least_phi, depth)
        own = self.own(rod)
        own.pinched = ti.min(own.pinched, ti.select(held, gap, zero))
        rod.contacts.least_gap = ti.min(rod.contacts.least_gap, ti.select(held, zero + 1e30, gap))
        pushed = self.push(rod, at.force, gap)
        push, stiffness = ti.select(near, pushed.push, zero), ti.select(near, pushed.stiffness, zero)
        self.add_penalty(rod, ti.select(near, pushed.energy, zero), push * rod.total)
        if self.some((push > 0.0) | (stiffness > 0.0), zero):
            weights = pair_weights(seen.s, seen.t)
            own.ends = weights + pair_slopes(weights, seen, p, q)
            for k in range(4):
                end = self.end(rod, k)
                add(self.own_vertex(rod, self.vertex_of(i, j, k)), pull=scaled(seen.normal, 0.0 - push * end.weight))
                for m in range(k + 1):
                    block = pair_block(end, self.end(rod, m), seen, push, stiffness)
                    self.add_ends(rod, i, j, k, m, block)

    def end(self, rod, k):
        """A record of the weight of end ``k`` of four, of the two edges that are looked at, and of the mixed derivatives by it
        and by the places on both edges."""
        slopes = self.own(rod).of("slopes").part(NUMBERS, 3 * k)
        return record(weight=self.own(rod).of("weights")[k], by_s=slopes.three, by_t=slopes.part(NUMBERS, 12).three)

    def vertex_of(self, i, j, k):
        """The vertex that is end ``k`` of the edges ``i`` and ``j``."""
        return ti.select(k < 2, i + k, j + k - 2)

    def add_ends(self, rod, i, j, k, m, values):
        """Add nine numbers to the block of two of the four ends, m ≤ k."""
        if k == m:
            self.add_diagonal(rod, self.vertex_of(i, j, k), values)
        else:
            self.add_block(rod, self.vertex_of(i, j, k), self.vertex_of(i, j, m), values)

    def pinched_pairs(self, rod):
        """Whether clamps hold two edges where they are in each other."""
        return self.own(rod).pinched < 0.0 - rod.contacts.tolerance

    def held_edge(self, rod, edge):
        """One where clamps hold both ends of an edge."""
        return ti.min(self.held(rod, edge), self.held(rod, edge + 1))

    def note_crossing(self, rod, i, j, at):
        """By how much of their distance before the step two edges have come nearer to each other at most."""
        most = 0.0 * rod.total
        for a in ti.static(range(2)):
            for b in ti.static(range(2)):
                last, first = self.vertex(rod, j + b), self.vertex(rod, i + a)
                shift = minus(minus(last.place, last.standing), minus(first.place, first.standing))
                most = largest_of(most, dot(shift, shift))
        before = at.distance_standing
        rod.contacts.crossing = largest_of(rod.contacts.crossing, most / (before * before + 1e-20))

    # --- friction ---

    def moved_pair(self, rod, i, j, at):
        """How far the places at which friction acts on two edges have moved along each other since the instant before."""
        s, t = at.rubbed_places[0], at.rubbed_places[1]
        first = plus(scaled(self.moved(rod, self.vertex(rod, i)), 1.0 - s), scaled(self.moved(rod, self.vertex(rod, i + 1)), s))
        last = plus(scaled(self.moved(rod, self.vertex(rod, j)), 1.0 - t), scaled(self.moved(rod, self.vertex(rod, j + 1)), t))
        return minus(last, first)

    def rubbed_pair(self, rod, i, j, at):
        """Friction of two edges, as :meth:`.ContactEnergy.rubbed`.

        Its penalty stiffness is κ, or less where that would turn a small friction round within the tolerance of gaps: Newton's
        steps would jump to and fro across such a kink.
        """
        limit, stiffness = self.own(rod).coefficient * at.force, rod.contacts.stiffness
        softer = ti.min(stiffness, ti.max(limit / rod.contacts.tolerance, 1e-6 * stiffness))
        return self.rubbed(rod, limit, at.friction, at.rubbed_normal, self.moved_pair(rod, i, j, at), softer)

    def rub_pair(self, rod, i, j, at):
        """Add the friction of two edges."""
        zero = 0.0 * rod.total
        acting = at.force > 0.0
        if self.some(acting, zero):
            rubbed = self.rubbed_pair(rod, i, j, at)
            pull = chosen(acting, rubbed.pull, repeated(zero, 3))
            bent = chosen(acting, rubbed.stiffness, repeated(zero, 6))
            square = ti.select(acting, dot(pull, pull), zero) / rod.contacts.stiffness
            self.add_penalty(rod, ti.select(acting, rubbed.energy, zero), square)
            self.own(rod).weights = pair_weights(at.rubbed_places[0], at.rubbed_places[1])
            weights = self.own(rod).of("weights")
            for k in range(4):
                weight = weights[k]
                add(self.own_vertex(rod, self.vertex_of(i, j, k)), pull=scaled(pull, weight))
                for m in range(k + 1):
                    self.add_ends(rod, i, j, k, m, full(scaled(bent, weight * weights[m])))

    # --- steps ---

    def restore_pairs(self, rod, lost):
        """Restore the distances of edges before a step in the lanes that reject it."""
        for number in range(rod.edges * (rod.edges - 1) // 2):
            at = self.numbered_pair(rod, number)
            choose(at, lost > 0.5, distance=at.distance_standing)

    def approach_itself(self, rod):
        """The square of the largest share that the next step, the moves of all vertices, takes of the distance or of the gap of
        two edges."""
        zero, radius = 0.0 * rod.total, rod.contacts.radius
        most = zero
        for j in range(2, rod.edges):
            for i in range(j - 1):
                at = self.pair(rod, i, j)
                distance = at.distance
                largest = zero
                for a in ti.static(range(2)):
                    for b in ti.static(range(2)):
                        change = minus(self.own_vertex(rod, j + b).move, self.own_vertex(rod, i + a).move)
                        largest = largest_of(largest, dot(change, change))
                clearance = self.pair_clearance(rod, i, j, distance)
                near = clearance < layout.REACH * radius
                most = largest_of(most, largest / (distance * distance + 1e-20))
                if self.some(near, zero):
                    weights = pair_weights(at.places[0], at.places[1])
                    first, second = self.own_vertex(rod, i), self.own_vertex(rod, i + 1)
                    third, fourth = self.own_vertex(rod, j), self.own_vertex(rod, j + 1)
                    change = plus(plus(scaled(first.move, weights[0]), scaled(second.move, weights[1])),
                                  plus(scaled(third.move, weights[2]), scaled(fourth.move, weights[3])))
                    gap = ti.max(clearance - 2.0 * radius, zero) + layout.PRESSED_IN * radius
                    share = 0.0 - dot(at.normal, change) / ti.max(gap, 1e-6 * radius)
                    most = ti.select(near & (share > 0.0), largest_of(most, share * share), most)
        return most

    # --- rounds ---

    def update_pairs(self, rod, due, found):
        """New forces between edges in the lanes that are ``due``: their largest change to ``found``."""
        zero, radius = 0.0 * rod.total, rod.contacts.radius
        for j in range(2, rod.edges):
            for i in range(j - 1):
                at = self.pair(rod, i, j)
                gap = self.pair_clearance(rod, i, j, at.distance) - 2.0 * radius
                old = at.force
                if self.some((gap < radius) | (old > 0.0), zero):
                    gap = ti.min(gap, 4.0 * radius)
                    new = self.updated_force(rod, old, gap)
                    self.note_change(found, old, new)
                    at.force = ti.select(due, new, old)
                    if ti.static(self.rub):
                        self.update_pair_friction(rod, i, j, at, due, found)

    def update_pair_friction(self, rod, i, j, at, due, found):
        """New friction of two edges under the new force."""
        self.keep_friction(at.of("friction"), self.rubbed_pair(rod, i, j, at), due, found)
        clearance = self.pair_clearance(rod, i, j, at.distance)
        due = due & (clearance < layout.REACH * rod.contacts.radius)
        # Friction acts across a unit vector; the gradient of the distance is a little shorter.
        unit = scaled(at.normal, 1.0 / ti.sqrt(dot(at.normal, at.normal) + 1e-30))
        choose(at, due, rubbed_normal=unit, rubbed_places=at.places)

    # --- from one instant to the next, into scratch and out of it ---

    def pair_work(self, rod):
        """The work of the rod's friction on itself since the instant before."""
        work = 0.0 * rod.total
        if ti.static(self.rub):
            for j in range(2, rod.edges):
                for i in range(j - 1):
                    at = self.pair(rod, i, j)
                    acting = at.force > 0.0
                    if self.some(acting, work):
                        work = work + ti.select(acting, dot(at.friction, self.moved_pair(rod, i, j, at)), 0.0 * work)
        return work

    def forget_pairs(self, rod, once):
        """Forget the forces between edges in the lanes where ``once``."""
        for number in range(rod.edges * (rod.edges - 1) // 2):
            at = self.numbered_pair(rod, number)
            choose(at, once, remembered=scaled(at.remembered, 0.0))

    def load_pairs(self, tables, slot, row):
        """Begin lane ``slot`` without forces between edges."""
        one = self.of_lane(tables, slot)
        self.own(one).coefficient = tables.self_friction[ti.min(row, tables.self_friction.shape[0] - 1)]
        for number in range(one.edges * (one.edges - 1) // 2):
            at = self.numbered_pair(one, number)
            for k in ti.static(range(layout.PAIR_REMEMBERED)):
                at[k] = 0.0
            at.distance, at.distance_standing = 1e30, 1e30

    def carry_pairs(self, tables, slot, row, loads: ti.template()):
        """What a launch needs of edges from the one before: into lane ``slot`` if it ``loads``, else from there."""
        one, pairs = self.of_lane(tables, slot), tables.pair_memory.shape[1]
        for number in range(ti.select(pairs > 1, pairs, 0)):
            pair = self.numbered_pair(one, number)
            for k in ti.static(range(layout.PAIR_CARRIED)):
                if ti.static(loads):
                    pair[k] = tables.pair_memory[row, number, k]
                else:
                    tables.pair_memory[row, number, k] = pair[k]

    def pair_touch(self, tables, slot, vertex):
        """The :class:`.Touch` of the edge that ends at a vertex of lane ``slot`` with other edges."""
        one, edge = self.of_lane(tables, slot), vertex - 1
        touch = ti.cast(NONE, ti.i32)
        for other in range(one.edges):
            if edge >= 0 and ti.abs(other - edge) > 1:
                at = self.pair(one, ti.min(edge, other), ti.max(edge, other))
                touch = ti.max(touch, self.touch_of(at.force, at.friction, self.own(one).coefficient))
        return touch
