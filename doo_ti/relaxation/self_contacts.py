"""Steps in which a rod does not pass through itself, and the rounds of its forces on itself (docs/contact.md)."""

import taichi as ti

from doo_ti.physics.algebra import largest_of
from doo_ti.physics.tuples import chosen, dot, minus, plus, scaled
from doo_ti.relaxation.contact_layout import APPROACH, OFFSET, RADIUS, SLACK, STIFFNESS, contact_items
from doo_ti.relaxation.contacts import NONE
from doo_ti.relaxation.pair_distance import pair_weights
from doo_ti.relaxation.pair_layout import (
    CARRIED,
    COEFFICIENT,
    DISTANCE,
    DISTANCE_STANDING,
    FORCE,
    FRICTION,
    MOVE,
    NORMAL,
    PAIR_ITEMS,
    PLACES,
    PULL,
    REACH,
    REMEMBERED,
    ROD_ITEMS,
    RUBBED_NORMAL,
    RUBBED_PLACES,
    VERTEX_ITEMS,
)
from doo_ti.relaxation.self_contact_energy import SelfContactEnergy


@ti.data_oriented
class SelfContacts(SelfContactEnergy):
    """The contacts with obstacles and those of the rod with itself."""

    itself = True

    # --- steps ---

    @ti.func
    def stand_pairs(self, rod):
        """Keep the distances of edges from each other before a step."""
        self.copy_distances(rod, DISTANCE, DISTANCE_STANDING, 0.0 * rod.total + 1.0)

    @ti.func
    def restore_pairs(self, rod, lost):
        """Restore them in the lanes that reject the step."""
        self.copy_distances(rod, DISTANCE_STANDING, DISTANCE, lost)

    @ti.func
    def copy_distances(self, rod, source: ti.template(), target: ti.template(), where):
        for number in range(rod.edges * (rod.edges - 1) // 2):
            at = self.pair(rod, 0, 1) + number * PAIR_ITEMS * self.stride
            kept = rod.scratch[at + target * self.stride]
            rod.scratch[at + target * self.stride] = ti.select(where > 0.5, rod.scratch[at + source * self.stride], kept)

    @ti.func
    def approach_itself(self, rod):
        """By how much the next step, the moves of all vertices, is too large for one that may be taken whole: the square of its
        share of the distance or of the gap of two edges."""
        zero, radius = 0.0 * rod.total, self.item(rod, RADIUS)
        behind = self.behind(rod)
        slack = ti.select(behind, self.item(rod, OFFSET), SLACK * radius)
        floor = ti.select(behind, zero - 1e30, zero)
        most = zero
        for j in range(2, rod.edges):
            for i in range(j - 1):
                at = self.pair(rod, i, j)
                distance = rod.scratch[at + DISTANCE * self.stride]
                largest = zero
                for a in ti.static(range(2)):
                    for b in ti.static(range(2)):
                        change = minus(self.move(rod, j + b), self.move(rod, i + a))
                        largest = largest_of(largest, dot(change, change))
                clearance = self.pair_clearance(rod, i, j, distance)
                near = clearance < REACH * radius
                most = largest_of(most, largest / (distance * distance + 1e-20))
                if self.some(near, zero):
                    weights = pair_weights(rod.scratch[at + PLACES * self.stride], rod.scratch[at + (PLACES + 1) * self.stride])
                    change = plus(
                        plus(scaled(self.move(rod, i), weights[0]), scaled(self.move(rod, i + 1), weights[1])),
                        plus(scaled(self.move(rod, j), weights[2]), scaled(self.move(rod, j + 1), weights[3])))
                    normal = self.load3(rod.scratch, at + NORMAL * self.stride)
                    gap = ti.max(clearance - 2.0 * radius, floor) + slack
                    share = (0.0 - APPROACH) * dot(normal, change) / ti.max(gap, 1e-6 * radius)
                    most = ti.select(near & (share > 0.0), largest_of(most, share * share), most)
        return most

    @ti.func
    def move(self, rod, index):
        """The displacement of a vertex that the next step means."""
        return self.load3(rod.scratch, self.own_vertex(rod, index) + MOVE * self.stride)

    # --- rounds ---

    @ti.func
    def settle_pairs(self, rod, due, found):
        """New forces between edges in the lanes that are ``due``: their largest change to ``found``."""
        zero, radius = 0.0 * rod.total, self.item(rod, RADIUS)
        stiffness, behind = self.item(rod, STIFFNESS), self.behind(rod)
        for j in range(2, rod.edges):
            for i in range(j - 1):
                at = self.pair(rod, i, j)
                gap = self.pair_clearance(rod, i, j, rod.scratch[at + DISTANCE * self.stride]) - 2.0 * radius
                old = rod.scratch[at + FORCE * self.stride]
                if self.some((gap < radius) | (old > 0.0), zero):
                    gap = ti.min(gap, 4.0 * radius)
                    new = ti.select(behind, self.barrier(rod, gap).push, ti.max(old - stiffness * gap, zero))
                    self.note_force(rod, found, gap, old, new)
                    rod.scratch[at + FORCE * self.stride] = ti.select(due, new, old)
                    if ti.static(self.rub):
                        found.rubbed = largest_of(found.rubbed, self.settle_pair_friction(rod, i, j, at, due))

    @ti.func
    def settle_pair_friction(self, rod, i, j, at, due):
        """New friction of two edges under the new force: by how much it changes."""
        change = self.keep_friction(rod, at + FRICTION * self.stride, self.rubbed_pair(rod, i, j, at).pull, due)
        clearance = self.pair_clearance(rod, i, j, rod.scratch[at + DISTANCE * self.stride])
        due = due & (clearance < REACH * self.item(rod, RADIUS))
        normal = self.load3(rod.scratch, at + NORMAL * self.stride)
        # Friction acts across a unit vector; the gradient of the distance is a little shorter.
        unit = scaled(normal, 1.0 / ti.sqrt(dot(normal, normal) + 1e-30))
        places = (rod.scratch[at + PLACES * self.stride], rod.scratch[at + (PLACES + 1) * self.stride])
        before = self.load3(rod.scratch, at + RUBBED_NORMAL * self.stride)
        self.store(rod.scratch, at + RUBBED_NORMAL * self.stride, chosen(due, unit, before))
        for k in ti.static(range(2)):
            item = at + (RUBBED_PLACES + k) * self.stride
            rod.scratch[item] = ti.select(due, places[k], rod.scratch[item])
        return change

    # --- from one instant to the next, into scratch and out of it ---

    @ti.func
    def pair_work(self, rod):
        """The work of the rod's friction on itself since the instant before."""
        work = 0.0 * rod.total
        if ti.static(self.rub):
            for j in range(2, rod.edges):
                for i in range(j - 1):
                    at = self.pair(rod, i, j)
                    acting = rod.scratch[at + FORCE * self.stride] > 0.0
                    if self.some(acting, work):
                        friction = self.load3(rod.scratch, at + FRICTION * self.stride)
                        work = work + ti.select(acting, dot(friction, self.moved_pair(rod, i, j, at)), 0.0 * work)
        return work

    @ti.func
    def forget_pairs(self, rod, once):
        """Forget the forces between edges in the lanes where ``once``."""
        for number in range(rod.edges * (rod.edges - 1) // 2):
            at = self.pair(rod, 0, 1) + number * PAIR_ITEMS * self.stride
            for k in ti.static(range(REMEMBERED)):
                item = at + k * self.stride
                rod.scratch[item] = ti.select(once, 0.0 * rod.scratch[item], rod.scratch[item])

    @ti.func
    def first_pair(self, tables):
        """Where the items of the first pair of edges begin."""
        edges = tables.rest_length.shape[1]
        own = tables.contacts + contact_items(edges, tables.kinds.shape[0]) * self.stride
        return own + (ROD_ITEMS + (edges + 1) * VERTEX_ITEMS) * self.stride

    @ti.func
    def load_pairs(self, tables, scratch: ti.template(), slot, row):
        """Begin lane ``slot`` without forces between edges."""
        edges = tables.rest_length.shape[1]
        own = tables.contacts + contact_items(edges, tables.kinds.shape[0]) * self.stride
        friction = tables.self_friction[ti.min(row, tables.self_friction.shape[0] - 1)]
        self.put(scratch, own + COEFFICIENT * self.stride, slot, friction)
        first = self.first_pair(tables)
        for number in range(edges * (edges - 1) // 2):
            at = first + number * PAIR_ITEMS * self.stride
            for k in ti.static(range(REMEMBERED)):
                self.put(scratch, at + k * self.stride, slot, 0.0)
            self.put(scratch, at + DISTANCE * self.stride, slot, 1e30)
            self.put(scratch, at + DISTANCE_STANDING * self.stride, slot, 1e30)

    @ti.func
    def load_carried_pairs(self, tables, scratch: ti.template(), slot, row):
        """What the launch before has left of edges, into lane ``slot``."""
        first, pairs = self.first_pair(tables), tables.pair_memory.shape[1]
        for number in range(ti.select(pairs > 1, pairs, 0)):
            for k in ti.static(range(CARRIED)):
                self.put(scratch, first + (number * PAIR_ITEMS + k) * self.stride, slot, tables.pair_memory[row, number, k])

    @ti.func
    def carry_pairs(self, tables, scratch: ti.template(), slot, row):
        """What the next launch needs of edges, from lane ``slot``."""
        first, pairs = self.first_pair(tables), tables.pair_memory.shape[1]
        for number in range(ti.select(pairs > 1, pairs, 0)):
            for k in ti.static(range(CARRIED)):
                value = self.get(scratch, first + (number * PAIR_ITEMS + k) * self.stride, slot)
                tables.pair_memory[row, number, k] = value

    @ti.func
    def pair_touch(self, tables, scratch: ti.template(), slot, vertex):
        """The :class:`.Touch` of the edge that ends at a vertex of lane ``slot`` with other edges."""
        edges = tables.rest_length.shape[1]
        own = tables.contacts + contact_items(edges, tables.kinds.shape[0]) * self.stride
        coefficient = self.get(scratch, own + COEFFICIENT * self.stride, slot)
        first, edge = self.first_pair(tables), vertex - 1
        touch = ti.cast(NONE, ti.i32)
        for other in range(edges):
            if edge >= 0 and ti.abs(other - edge) > 1:
                i, j = ti.min(edge, other), ti.max(edge, other)
                at = first + (j * (j - 1) // 2 + i) * PAIR_ITEMS * self.stride
                found = self.touch_of(scratch, slot, at + FORCE * self.stride, at + FRICTION * self.stride, coefficient)
                touch = ti.max(touch, found)
        return touch

    @ti.func
    def pair_force(self, tables, scratch: ti.template(), slot, vertex, k: ti.template()):
        """Component ``k`` of the rod's own force on a vertex of lane ``slot``."""
        own = tables.contacts + contact_items(tables.rest_length.shape[1], tables.kinds.shape[0]) * self.stride
        at = own + (ROD_ITEMS + vertex * VERTEX_ITEMS + PULL + k) * self.stride
        return 0.0 - ti.cast(self.get(scratch, at, slot), ti.f64)
