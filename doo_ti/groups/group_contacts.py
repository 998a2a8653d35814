"""The contacts of a group: of its rods with obstacles, with each other and with themselves (docs/groups.md)."""

import taichi as ti

from doo_ti.groups import ties
from doo_ti.physics.algebra import absolute, identity, largest_of
from doo_ti.physics.number import NUMBERS, device_functions, in_f64, read, write
from doo_ti.physics.tuples import add, choose, dot, extended, minus, picked, plus, scaled
from doo_ti.relaxation import tables as of
from doo_ti.relaxation.contact_table import FINE, FORCES, PAIR_FORCES, contact_items, pair_items
from doo_ti.relaxation.loading import stiffness_scale
from doo_ti.relaxation.self_contacts import SelfContacts


@device_functions
class GroupContacts(ties.Ties, SelfContacts):
    """The contacts and ties of a group.

    Of the record ``rod`` its functions read ``begins``, of every edge zero or, of a break, the number of the rod after it;
    ``ties``, the two vertices of each, the second -1 for a place, and the two edges of a weld or -1; and ``rods``, how many
    there are.
    """

    # --- views of scratch ---

    @picked
    def items(self, tables):
        edges = tables.rest_length.shape[1]
        group = ties.group_items(edges, tables.places.shape[1], tables.ties.shape[0], tables.borders.shape[0])
        return contact_items(edges, tables.kinds.shape[0]) + pair_items(edges) + group

    @picked
    def group(self, rod):
        return self.own(rod).part(ties.GROUP, pair_items(rod.edges))

    @picked
    def edge(self, rod, index):
        return self.group(rod).part(ties.EDGE, len(ties.GROUP) + index * len(ties.EDGE))

    @picked
    def group_vertex(self, rod, index):
        return self.edge(rod, rod.edges).part(ties.VERTEX, index * len(ties.VERTEX))

    @picked
    def member(self, rod, index):
        return self.group_vertex(rod, rod.edges + 1).part(ties.MEMBER, index * len(ties.MEMBER))

    @picked
    def tie(self, rod, index):
        return self.member(rod, rod.rods).part(ties.TIE, index * len(ties.TIE))

    @picked
    def matrix(self, rod):
        return self.tie(rod, rod.ties.shape[0]).part(NUMBERS, 0)

    @picked
    def of_lane(self, tables, slot):
        return extended(SelfContacts.of_lane(self, tables, slot), rods=tables.places.shape[1], ties=tables.ties)

    # --- what a rod that touches itself has otherwise ---

    def may_touch(self, rod, i, at, arc):
        """Whether two edges may touch is known from the start."""
        return at.may_touch > 0.5

    def held(self, rod, index):
        return self.group_vertex(rod, index).held

    def clearance(self, rod, index, distance):
        return distance - self.group_vertex(rod, index).thicker

    def pinched(self, rod, miss):
        """Whether clamps hold a vertex in an obstacle, or the edge between two, or two edges in each other; of ends, which ties
        hold, places count."""
        least = 0.0 * rod.total
        for index in range(1, rod.edges + 1):
            if rod.begins[index - 1] == 0:
                least = self.sunk_edge(rod, index, self.vertex(rod, index - 1).place, self.vertex(rod, index).place, least)
        for k in range(rod.ties.shape[0]):
            at = self.tie(rod, k)
            if rod.ties[k, 1] < 0:
                for o in range(rod.obstacles):
                    seen = self.distance.measure(self.obstacle(rod, o), rod.grids, rod.kinds[o], at.target)
                    gap = self.clearance(rod, rod.ties[k, 0], seen.value) - rod.contacts.radius
                    least = ti.select(at.active > 0.5, ti.min(least, gap), least)
        return (least < 0.0 - rod.contacts.tolerance) | self.pinched_pairs(rod)

    def stand(self, rod):
        """Keep where rods begin, and the forces of ties, before a step."""
        for g in range(rod.rods):
            at = self.member(rod, g)
            at.begin_standing = at.begin
        head = self.group(rod)
        head.work_standing = head.work
        for b in range(rod.borders.shape[0]):
            force = self.bordered_force(rod, b)
            force.standing = force.now

    def restore_pairs(self, rod, lost):
        SelfContacts.restore_pairs(self, rod, lost)
        for g in range(rod.rods):
            at = self.member(rod, g)
            choose(at, lost > 0.5, begin=at.begin_standing)
        head = self.group(rod)
        choose(head, lost > 0.5, work=head.work_standing)
        for b in range(rod.borders.shape[0]):
            force = self.bordered_force(rod, b)
            choose(force, lost > 0.5, now=force.standing)

    # --- weight and springs ---

    def hang(self, rod):
        """Add the weight of all vertices and their springs to the energy, the gradient and the second derivatives."""
        for v in range(rod.edges + 1):
            at, place = self.group_vertex(rod, v), self.vertex(rod, v).place
            weight = scaled(rod.gravity, at.weight)
            height, stiffness = dot(weight, minus(place, rod.anchor)), at.spring
            stretch = minus(place, at.spring_point)
            stored = 0.5 * stiffness * dot(stretch, stretch)
            add(rod.contacts, energy=height + stored, magnitude=absolute(height) + stored)
            self.add_load(rod, v, plus(weight, scaled(stretch, stiffness)))
            self.add_diagonal(rod, v, scaled(identity(0.0 * stiffness), stiffness))

    # --- rounds ---

    def tolerance(self, rod, given, final: ti.template()):
        """As of one rod, but without the rougher rounds: with these, ties would change their forces before the rods have
        followed the last change. It is at least what rounding of places makes of the forces."""
        stiffness = rod.contacts.stiffness + self.group(rod).stiffness
        noise = self.rounding * stiffness * rod.longest * rod.total * rod.total
        return given + noise

    def end_round(self, rod, lane, calm, rests, moved):
        """As of one rod; but where ties still miss that the next step closes, it is taken first. Rods that ties draw together
        may be deep inside each other until then."""
        drawing = self.draws(rod)
        missing = ~drawing & (self.miss(rod) > ties.TIE_TOLERANCE)
        ended = SelfContacts.end_round(self, rod, lane, calm & ~missing, rests & ~missing, moved & ~drawing)
        return ended | (rests & missing)

    def update_forces(self, rod, due):
        """End a round with new forces of contacts and, a first one, of ties. Returns the largest change of a gap that they
        mean, or what a tie misses times the ratio of their tolerances."""
        change, zero = SelfContacts.update_forces(self, rod, due), 0.0 * rod.total
        self.update_ties(rod, due)
        choose(rod.contacts, due, work=self.friction_work(rod))
        return largest_of(change, ti.select(due, self.miss(rod) / ties.TIE_TOLERANCE * rod.contacts.tolerance, zero))

    # --- into scratch and out of it ---

    def load(self, tables, slot, rod, unit, scale):
        """As the obstacles and contacts of one rod, of the softest of the group, and the group's own numbers."""
        one, row, material = self.of_lane(tables, slot), tables.rods[rod, of.RESULT_ROW], tables.rods[rod, of.MATERIAL_ROW]
        divisor = stiffness_scale(tables.material, tables.clamp, material, tables.rods[rod, of.CLAMP_ROW])
        # No contact bears more than what the softer of its rods does.
        softest = extended(scale, bend=tables.material[material, of.SOFTEST] / divisor)
        force_unit = divisor / (unit * unit)
        self.scale_memory(tables, row, 1.0 / force_unit)
        SelfContacts.load(self, tables, slot, rod, unit, softest)
        self.carry_pairs(tables, slot, row, True)
        base, own = one.contacts, ti.min(row, tables.apart.shape[0] - 1)
        for number in range(tables.apart.shape[1]):
            at = self.numbered_pair(one, number)
            at.distance, at.distance_standing, at.may_touch = 1e30, 1e30, ti.cast(tables.apart[own, number], ti.f64)
            base.largest = ti.max(base.largest, at.force)
        self.tighten(one, base.radius > 0.0)
        head = self.group(one)
        if tables.touching == 0:
            one.contacts.phase = FINE
        for v in range(one.edges + 1):  # no edge ends where a rod begins, so that none sags there
            for o in range(one.obstacles):
                self.contact(self.vertex(one, v), o).sagging = 0.0
        stiffness = ties.STIFFNESS_OF_TIES / (scale.total * scale.total * scale.total)
        head.stiffness, head.work, head.unit = stiffness, 0.0, unit
        for e in range(one.edges):
            edge = self.edge(one, e)
            edge.spin, edge.tilt = tables.free[row, e, 0], tables.free[row, e, 1]
        for v in range(one.edges + 1):
            vertex = self.group_vertex(one, v)
            vertex.weight = tables.burden[row, v, 0] / unit
            vertex.held = tables.burden[row, v, 1]
            vertex.thicker = tables.burden[row, v, 2] / unit
            vertex.spring_point = scaled(read(tables.burden, row, v, 3), 1.0 / unit)
            self.vertex(one, v).previous = scaled(read(tables.previous, row, v, 0), 1.0 / unit)
            vertex.spring = tables.burden[row, v, 6] * unit / force_unit
        for g in range(one.rods):
            self.member(one, g).begin = scaled(read(tables.places, row, g, 0), 1.0 / unit)
        most, total = ti.cast(0.0, ti.f64), tables.clamp[tables.rods[rod, of.CLAMP_ROW], of.TOTAL]
        for t in range(tables.ties.shape[0]):
            tie, stiffness_of_tie = self.tie(one, t), tables.targets[row, t, 8]
            tie.target = scaled(read(tables.targets, row, t, 0), 1.0 / unit)
            tie.rest = read(tables.targets, row, t, 4, count=4)
            tie.active = tables.targets[row, t, 3]
            tie.scale = stiffness_of_tie / divisor
            for k in ti.static(range(3)):
                force, moment = tables.tie_forces[row, t, k], tables.tie_forces[row, t, 3 + k]
                tie.force.now[k] = force / force_unit
                tie.moment.now[k] = moment / (force_unit * unit)
                most = ti.max(most, ti.max(ti.abs(force), ti.abs(moment / total)) * (unit * unit) / stiffness_of_tie)
        bound = ties.MOST_GROWTH * (most + ties.NOTABLE_MISS * scale.total * stiffness)
        head.bound = ti.select(most > 0.0, bound, 0.0 * bound)
        head.give = ti.select(most > 0.0, ties.GIVE, ties.NO_BORDER) / stiffness

    def scale_memory(self, tables, row, factor):
        """Multiply the forces in memory, which are energy per mm between launches: damping changes the unit of a group."""
        for v, o, k in ti.ndrange(tables.memory.shape[1], tables.memory.shape[2], FORCES):
            tables.memory[row, v, o, k] *= factor
        pairs = tables.pair_memory.shape[1]
        for number, k in ti.ndrange(ti.select(pairs > 1, pairs, 0), PAIR_FORCES):
            tables.pair_memory[row, number, k] *= factor

    def unload_forces(self, tables, slot, place, force_unit):
        """Forces on vertices and of ties, what sticks and slips, friction's work and where rods begin, into row ``place``."""
        SelfContacts.unload_forces(self, tables, slot, place, force_unit)
        self.carry_pairs(tables, slot, place, False)
        self.scale_memory(tables, place, force_unit)
        self.unload_touch(tables, slot, place)
        one = self.of_lane(tables, slot)
        unit = in_f64(self.group(one).unit)
        tables.works[place] = one.contacts.work * force_unit * unit
        for g in range(one.rods):
            write(tables.places, place, g, 0, values=scaled(in_f64(self.member(one, g).begin), unit))
        for t in range(tables.ties.shape[0]):
            tie = self.tie(one, t)
            for k in ti.static(range(3)):
                tables.tie_forces[place, t, k] = in_f64(tie.force.now[k]) * force_unit
                tables.tie_forces[place, t, 3 + k] = in_f64(tie.moment.now[k]) * force_unit * unit
