"""Steps in which a rod does not pass through itself, and the rounds of its forces on itself (docs/contact.md)."""

import taichi as ti

from doo_ti.physics.algebra import largest_of
from doo_ti.physics.number import device_functions, in_f64
from doo_ti.physics.tuples import choose, dot, minus, plus, scaled
from doo_ti.relaxation.contact_table import PAIR_CARRIED, PAIR_REMEMBERED, PRESSED_IN, REACH
from doo_ti.relaxation.contacts import NONE
from doo_ti.relaxation.pair_distance import pair_weights
from doo_ti.relaxation.self_contact_energy import SelfContactEnergy


@device_functions
class SelfContacts(SelfContactEnergy):
    """The contacts with obstacles and those of the rod with itself."""

    itself = True

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
                near = clearance < REACH * radius
                most = largest_of(most, largest / (distance * distance + 1e-20))
                if self.some(near, zero):
                    weights = pair_weights(at.places[0], at.places[1])
                    first, second = self.own_vertex(rod, i), self.own_vertex(rod, i + 1)
                    third, fourth = self.own_vertex(rod, j), self.own_vertex(rod, j + 1)
                    change = plus(plus(scaled(first.move, weights[0]), scaled(second.move, weights[1])),
                                  plus(scaled(third.move, weights[2]), scaled(fourth.move, weights[3])))
                    gap = ti.max(clearance - 2.0 * radius, zero) + PRESSED_IN * radius
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
                        found.rubbed = largest_of(found.rubbed, self.update_pair_friction(rod, i, j, at, due))

    def update_pair_friction(self, rod, i, j, at, due):
        """New friction of two edges under the new force: by how much it changes."""
        change = self.keep_friction(at.of("friction"), self.rubbed_pair(rod, i, j, at).pull, due)
        clearance = self.pair_clearance(rod, i, j, at.distance)
        due = due & (clearance < REACH * rod.contacts.radius)
        # Friction acts across a unit vector; the gradient of the distance is a little shorter.
        unit = scaled(at.normal, 1.0 / ti.sqrt(dot(at.normal, at.normal) + 1e-30))
        choose(at, due, rubbed_normal=unit, rubbed_places=at.places)
        return change

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
            for k in ti.static(range(PAIR_REMEMBERED)):
                at[k] = 0.0
            at.distance, at.distance_standing = 1e30, 1e30

    def carry_pairs(self, tables, slot, row, loads: ti.template()):
        """What a launch needs of edges from the one before: into lane ``slot`` if it ``loads``, else from there."""
        one, pairs = self.of_lane(tables, slot), tables.pair_memory.shape[1]
        for number in range(ti.select(pairs > 1, pairs, 0)):
            pair = self.numbered_pair(one, number)
            for k in ti.static(range(PAIR_CARRIED)):
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

    def pair_force(self, tables, slot, vertex, k: ti.template()):
        """Component ``k`` of the rod's own force on a vertex of lane ``slot``."""
        return 0.0 - in_f64(self.own_vertex(self.of_lane(tables, slot), vertex).pull[k])
