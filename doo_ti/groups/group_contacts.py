"""The contacts of a group: of its rods with obstacles, with each other and with themselves (docs/groups.md)."""

import taichi as ti

from doo_ti.groups.layout import (
    ACTIVE,
    BEGIN,
    BEGIN_STANDING,
    GIVE,
    GROUP_EDGE_ITEMS,
    GROUP_HEAD,
    GROUP_ROD_ITEMS,
    GROUP_VERTEX_ITEMS,
    HELD,
    MOST_GROWTH,
    NO_BORDER,
    NOTABLE_MISS,
    REST,
    SPIN,
    SPRING,
    SPRING_POINT,
    STIFFNESS_OF_TIES,
    TARGET,
    THICKER,
    TIE_BOUND,
    TIE_FORCE,
    TIE_GIVE,
    TIE_ITEMS,
    TIE_MOMENT,
    TIE_SCALE,
    TIE_STIFFNESS,
    TIE_TOLERANCE,
    TIE_WORK,
    UNIT,
    WEIGHT,
)
from doo_ti.groups.ties import Ties
from doo_ti.physics.algebra import absolute, largest_of
from doo_ti.physics.tuples import chosen, dot, identity, minus, plus, scaled, variable
from doo_ti.relaxation import tables as of
from doo_ti.relaxation.contact_layout import (
    CONTACT_ITEMS,
    ENERGY,
    FINE,
    HEAD,
    OBSTACLE_ITEMS,
    PHASE,
    PLACE,
    PREVIOUS,
    RADIUS,
    ROUGHEST,
    SAGGING,
    STIFFNESS,
    TOLERANCE,
    VERTEX_ITEMS,
    WORK,
    contact_items,
)
from doo_ti.relaxation.loading import stiffness_scale
from doo_ti.relaxation.pair_layout import APART, PAIR_ITEMS, pair_items
from doo_ti.relaxation.self_contacts import SelfContacts


@ti.data_oriented
class GroupContacts(Ties, SelfContacts):
    """The contacts and ties of a group.

    Of the record ``rod`` its functions read ``begins``, of every edge zero or, of a break, the number of the rod after it;
    ``ties``, the two vertices of each, the second -1 for a place, and the two edges of a weld or -1; and ``rods``, how many
    there are.
    """

    # --- items in scratch ---

    @ti.func
    def group(self, rod):
        """Where the items of the group begin."""
        return self.own(rod) + pair_items(rod.edges) * self.stride

    @ti.func
    def edge(self, rod, index):
        return self.group(rod) + (GROUP_HEAD + index * GROUP_EDGE_ITEMS) * self.stride

    @ti.func
    def group_vertex(self, rod, index):
        return self.edge(rod, rod.edges) + index * GROUP_VERTEX_ITEMS * self.stride

    @ti.func
    def member(self, rod, index):
        """Of the rod ``index``."""
        return self.group_vertex(rod, rod.edges + 1) + index * GROUP_ROD_ITEMS * self.stride

    @ti.func
    def tie(self, rod, index):
        return self.member(rod, rod.rods) + index * TIE_ITEMS * self.stride

    @ti.func
    def matrix_at(self, rod):
        return self.tie(rod, rod.ties.shape[0])

    # --- what a rod that touches itself has otherwise ---

    @ti.func
    def apart(self, rod, i, at, arc):
        """Whether two edges may touch is known from the start."""
        return rod.scratch[at + APART * self.stride] > 0.5

    @ti.func
    def held(self, rod, index):
        return rod.scratch[self.group_vertex(rod, index) + HELD * self.stride]

    @ti.func
    def clearance(self, rod, index, distance):
        return distance - rod.scratch[self.group_vertex(rod, index) + THICKER * self.stride]

    @ti.func
    def pinched(self, rod, miss):
        """Whether clamps hold a vertex inside an obstacle or two edges in each other; of the ends, which ties hold, their
        places count."""
        least = 0.0 * rod.total
        for index in range(rod.edges + 1):
            place = self.load3(rod.scratch, self.vertex(rod, index) + PLACE * self.stride)
            least = self.sunk(rod, index, place, self.held(rod, index), least)
        for k in range(rod.ties.shape[0]):
            at = self.tie(rod, k)
            if rod.ties[k, 1] < 0:
                place = self.load3(rod.scratch, at + TARGET * self.stride)
                least = self.sunk(rod, rod.ties[k, 0], place, rod.scratch[at + ACTIVE * self.stride], least)
        return (least < 0.0 - self.item(rod, TOLERANCE)) | self.pinched_pairs(rod)

    @ti.func
    def sunk(self, rod, index, place, held, least):
        """``least``, or the least gap of vertex ``index`` at a ``place`` where it is ``held``."""
        found = variable((least,))
        for o in range(rod.obstacles):
            seen = self.distance.measure(rod.scratch, rod.grids, self.obstacle(rod, o), rod.kinds[o], place)
            gap = self.clearance(rod, index, seen.value) - self.item(rod, RADIUS)
            found = (ti.select(held > 0.5, ti.min(found[0], gap), found[0]),)
        return found[0]

    @ti.func
    def stand_pairs(self, rod):
        SelfContacts.stand_pairs(self, rod)
        for g in range(rod.rods):
            at = self.member(rod, g)
            self.store(rod.scratch, at + BEGIN_STANDING * self.stride, self.load3(rod.scratch, at + BEGIN * self.stride))
        self.stand_forces(rod)

    @ti.func
    def restore_pairs(self, rod, lost):
        SelfContacts.restore_pairs(self, rod, lost)
        for g in range(rod.rods):
            at = self.member(rod, g)
            standing = self.load3(rod.scratch, at + BEGIN_STANDING * self.stride)
            place = self.load3(rod.scratch, at + BEGIN * self.stride)
            self.store(rod.scratch, at + BEGIN * self.stride, chosen(lost > 0.5, standing, place))
        self.restore_forces(rod, lost)

    # --- weight and springs ---

    @ti.func
    def hang(self, rod):
        """Add the weight of all vertices and their springs to the energy, the gradient and the second derivatives."""
        for v in range(rod.edges + 1):
            at, place = self.group_vertex(rod, v), self.place(rod, v)
            weight = scaled(rod.gravity, rod.scratch[at + WEIGHT * self.stride])
            height, stiffness = dot(weight, minus(place, rod.anchor)), rod.scratch[at + SPRING * self.stride]
            stretch = minus(place, self.load3(rod.scratch, at + SPRING_POINT * self.stride))
            stored = 0.5 * stiffness * dot(stretch, stretch)
            self.add(rod, ENERGY, (height + stored, absolute(height) + stored))
            self.add_load(rod, v, plus(weight, scaled(stretch, stiffness)))
            self.add_diagonal(rod, v, scaled(identity(0.0 * stiffness), stiffness))

    # --- rounds ---

    @ti.func
    def tolerance(self, rod, given):
        """As of one rod, but without the rougher rounds: with these, ties would change their forces before the rods have
        followed the last change. It is at least what rounding of places makes of the forces."""
        stiffness = self.item(rod, STIFFNESS) + rod.scratch[self.group(rod) + TIE_STIFFNESS * self.stride]
        noise = self.rounding * stiffness * rod.longest * rod.total * rod.total
        return ti.select(self.behind(rod), ti.max(given, 0.0 * given + ROUGHEST), given) + noise

    @ti.func
    def end_round(self, rod, lane, calm, rests, entered):
        """As of one rod; but where ties still miss that the next step closes, it is taken first."""
        missing = ~self.draws(rod) & (self.miss(rod) > TIE_TOLERANCE)
        return SelfContacts.end_round(self, rod, lane, calm & ~missing, rests & ~missing, entered) | (rests & missing)

    @ti.func
    def settle(self, rod, due):
        """End a round with new forces of contacts and, a first one, of ties. Returns the largest change of a gap that they
        mean, or what a tie misses times the ratio of their tolerances."""
        change, zero = SelfContacts.settle(self, rod, due), 0.0 * rod.total
        self.settle_ties(rod, due)
        self.set_item(rod, WORK, due, self.friction_work(rod))
        return largest_of(change, ti.select(due, self.miss(rod) / TIE_TOLERANCE * self.item(rod, TOLERANCE), zero))

    # --- into scratch and out of it ---

    @ti.func
    def load(self, tables, scratch: ti.template(), slot, rod, unit, scale):
        """As the obstacles and contacts of one rod, and the group's own numbers."""
        SelfContacts.load(self, tables, scratch, slot, rod, unit, scale)
        row = tables.rods[rod, of.RESULT_ROW]
        edges, rods, ties = tables.rest_length.shape[1], tables.places.shape[1], tables.ties.shape[0]
        base = tables.contacts
        if tables.barrier == 0:
            self.put(scratch, base + PHASE * self.stride, slot, FINE)
        self.load_apart(tables, scratch, slot, row)
        self.load_previous(tables, scratch, slot, row, unit)
        head = base + (contact_items(edges, tables.kinds.shape[0]) + pair_items(edges)) * self.stride
        stiffness = STIFFNESS_OF_TIES / (scale.total * scale.total * scale.total)
        self.put(scratch, head + TIE_STIFFNESS * self.stride, slot, stiffness)
        self.put(scratch, head + TIE_WORK * self.stride, slot, 0.0)
        self.put(scratch, head + UNIT * self.stride, slot, unit)
        divisor = stiffness_scale(tables.material, tables.clamp, tables.rods[rod, of.MATERIAL_ROW],
                                  tables.rods[rod, of.CLAMP_ROW])
        force_unit = divisor / (unit * unit)
        at = head + GROUP_HEAD * self.stride
        for e in range(edges):
            for k in ti.static(range(2)):
                self.put(scratch, at + (e * GROUP_EDGE_ITEMS + SPIN + k) * self.stride, slot, tables.free[row, e, k])
        at += edges * GROUP_EDGE_ITEMS * self.stride
        for v in range(edges + 1):
            vertex = at + v * GROUP_VERTEX_ITEMS * self.stride
            self.put(scratch, vertex + WEIGHT * self.stride, slot, tables.burden[row, v, 0] / unit)
            self.put(scratch, vertex + HELD * self.stride, slot, tables.burden[row, v, 1])
            self.put(scratch, vertex + THICKER * self.stride, slot, tables.burden[row, v, 2] / unit)
            for k in ti.static(range(3)):
                self.put(scratch, vertex + (SPRING_POINT + k) * self.stride, slot, tables.burden[row, v, 3 + k] / unit)
            self.put(scratch, vertex + SPRING * self.stride, slot, tables.burden[row, v, 6] * unit / force_unit)
        at += (edges + 1) * GROUP_VERTEX_ITEMS * self.stride
        for g in range(rods):
            for k in ti.static(range(3)):
                item = at + (g * GROUP_ROD_ITEMS + BEGIN + k) * self.stride
                self.put(scratch, item, slot, tables.places[row, g, k] / unit)
        at += rods * GROUP_ROD_ITEMS * self.stride
        for t in range(ties):
            tie = at + t * TIE_ITEMS * self.stride
            for k in ti.static(range(3)):
                self.put(scratch, tie + (TARGET + k) * self.stride, slot, tables.targets[row, t, k] / unit)
                self.put(scratch, tie + (TIE_FORCE + k) * self.stride, slot, tables.tie_forces[row, t, k] / force_unit)
                self.put(scratch, tie + (TIE_MOMENT + k) * self.stride, slot,
                         tables.tie_forces[row, t, 3 + k] / (force_unit * unit))
            for k in ti.static(range(4)):
                self.put(scratch, tie + (REST + k) * self.stride, slot, tables.targets[row, t, 4 + k])
            self.put(scratch, tie + ACTIVE * self.stride, slot, tables.targets[row, t, 3])
            self.put(scratch, tie + TIE_SCALE * self.stride, slot, tables.targets[row, t, 8] / divisor)
        most = ti.cast(0.0, ti.f64)
        for t in range(ties):
            for k in ti.static(range(3)):
                moment = tables.tie_forces[row, t, 3 + k] / tables.clamp[tables.rods[rod, of.CLAMP_ROW], of.TOTAL]
                largest = ti.max(ti.abs(tables.tie_forces[row, t, k]), ti.abs(moment))
                most = ti.max(most, largest * (unit * unit) / tables.targets[row, t, 8])
        bound = MOST_GROWTH * (most + NOTABLE_MISS * scale.total * stiffness)
        self.put(scratch, head + TIE_BOUND * self.stride, slot, ti.select(most > 0.0, bound, 0.0 * bound))
        self.put(scratch, head + TIE_GIVE * self.stride, slot, ti.select(most > 0.0, GIVE, NO_BORDER) / stiffness)

    @ti.func
    def load_apart(self, tables, scratch: ti.template(), slot, row):
        """Which edges may touch; and no edge ends where a rod begins, so that none sags there."""
        edges, count = tables.rest_length.shape[1], tables.kinds.shape[0]
        first = tables.contacts + (HEAD + count * OBSTACLE_ITEMS) * self.stride
        for v in range(edges + 1):
            for o in range(count):
                contact = first + (v * (VERTEX_ITEMS + count * CONTACT_ITEMS) + VERTEX_ITEMS + o * CONTACT_ITEMS) * self.stride
                self.put(scratch, contact + SAGGING * self.stride, slot, 0.0)
        own = ti.min(row, tables.apart.shape[0] - 1)
        for number in range(tables.apart.shape[1]):
            self.put(scratch, self.first_pair(tables) + (number * PAIR_ITEMS + APART) * self.stride, slot,
                     ti.cast(tables.apart[own, number], ti.f64))

    @ti.func
    def load_previous(self, tables, scratch: ti.template(), slot, row, unit):
        """Where the vertices were at the moment before."""
        count = tables.kinds.shape[0]
        first = tables.contacts + (HEAD + count * OBSTACLE_ITEMS) * self.stride
        for v in range(tables.rest_length.shape[1] + 1):
            at = first + v * (VERTEX_ITEMS + count * CONTACT_ITEMS) * self.stride
            for k in ti.static(range(3)):
                self.put(scratch, at + (PREVIOUS + k) * self.stride, slot, tables.previous[row, v, k] / unit)

    @ti.func
    def unload_forces(self, tables, scratch: ti.template(), slot, place, force_unit):
        """The forces on vertices and those of ties, what sticks and slips, the work of friction, and where the rods begin, into
        row ``place``."""
        SelfContacts.unload_forces(self, tables, scratch, slot, place, force_unit)
        self.unload_touch(tables, scratch, slot, place)
        edges, rods = tables.rest_length.shape[1], tables.places.shape[1]
        head = tables.contacts + (contact_items(edges, tables.kinds.shape[0]) + pair_items(edges)) * self.stride
        unit = ti.cast(self.get(scratch, head + UNIT * self.stride, slot), ti.f64)
        tables.works[place] = self.get(scratch, tables.contacts + WORK * self.stride, slot) * force_unit * unit
        first = head + (GROUP_HEAD + edges * GROUP_EDGE_ITEMS + (edges + 1) * GROUP_VERTEX_ITEMS) * self.stride
        for g in range(rods):
            for k in ti.static(range(3)):
                item = first + (g * GROUP_ROD_ITEMS + BEGIN + k) * self.stride
                tables.places[place, g, k] = ti.cast(self.get(scratch, item, slot), ti.f64) * unit
        first += rods * GROUP_ROD_ITEMS * self.stride
        for t in range(tables.ties.shape[0]):
            for k in ti.static(range(3)):
                item = first + (t * TIE_ITEMS + TIE_FORCE + k) * self.stride
                tables.tie_forces[place, t, k] = ti.cast(self.get(scratch, item, slot), ti.f64) * force_unit
                turn = item + (TIE_MOMENT - TIE_FORCE) * self.stride
                tables.tie_forces[place, t, 3 + k] = ti.cast(self.get(scratch, turn, slot), ti.f64) * force_unit * unit
