"""Steps that cross nothing, and the rounds of contact forces (docs/contact.md)."""

import taichi as ti

from doo_ti.contact.obstacles import DEPTH, OBSTACLE_COLUMNS, SIZES
from doo_ti.physics.algebra import absolute, largest_of
from doo_ti.physics.tuples import chosen, dot, minus, plus, repeated, scaled
from doo_ti.relaxation import tables as of
from doo_ti.relaxation.contact_energy import ContactEnergy
from doo_ti.relaxation.contact_layout import (
    ACTIVE,
    APPROACH,
    BARRIER,
    BARRIER_SHARE,
    BENDING_LOADS,
    CHANGE,
    CLOSE,
    CLOSEST,
    CONTACT_ITEMS,
    FINE,
    FIRST_STIFFNESS,
    FORCE,
    FORCE_BETWEEN,
    FORCE_END,
    FORCE_START,
    FRICTION,
    FRICTION_BETWEEN,
    HEAD,
    INERT,
    LEAST_OFFSET,
    LOADED,
    NEAR_ENOUGH,
    NORMAL,
    NORMAL_BETWEEN,
    OFFSET,
    PHASE,
    PLACE,
    PLACE_BETWEEN,
    PREVIOUS,
    RADIUS,
    ROOM,
    ROOM_STANDING,
    ROUGH,
    ROUGHER,
    ROUGHEST,
    SAGGING,
    SECANT,
    SLACK,
    SLOW,
    SOFT,
    STAGE,
    STAGES,
    STANDING,
    STIFFER,
    STIFFNESS,
    STRENGTH,
    TOLERANCE,
    VALUE,
    VALUE_BETWEEN,
    VERTEX_ITEMS,
    WEAKER,
    WEIGHT,
    WORK,
)


@ti.data_oriented
class Contacts(ContactEnergy):
    """The contacts with their steps, their rounds and their way into scratch and out of it."""

    # --- steps ---

    @ti.func
    def stand(self, rod):
        """Keep the places before a step."""
        for v in range(rod.edges + 1):
            at = self.vertex(rod, v)
            self.store(rod.scratch, at + STANDING * self.stride, self.load3(rod.scratch, at + PLACE * self.stride))
            rod.scratch[at + ROOM_STANDING * self.stride] = rod.scratch[at + ROOM * self.stride]

    @ti.func
    def restore(self, rod, lost):
        """Restore them in the lanes that reject the step."""
        for v in range(rod.edges + 1):
            at = self.vertex(rod, v)
            standing = self.load3(rod.scratch, at + STANDING * self.stride)
            place = self.load3(rod.scratch, at + PLACE * self.stride)
            self.store(rod.scratch, at + PLACE * self.stride, chosen(lost > 0.5, standing, place))
            kept, room = rod.scratch[at + ROOM_STANDING * self.stride], rod.scratch[at + ROOM * self.stride]
            rod.scratch[at + ROOM * self.stride] = ti.select(lost > 0.5, kept, room)

    @ti.func
    def approach(self, rod, index, before, move):
        """By how much a step is too large for one that may be taken whole: the square of its share of a vertex's way to the
        middle of an obstacle, or of the gap there and on the edge that ends there, whose start makes the step ``before``."""
        zero = 0.0 * move[0]
        at = self.vertex(rod, index)
        behind = self.item(rod, PHASE) > ti.static(0.5 * (BARRIER + ROUGH))
        radius = self.item(rod, RADIUS)
        slack = ti.select(behind, self.item(rod, OFFSET), SLACK * radius)
        floor = ti.select(behind, zero - 1e30, zero)
        most = zero
        for o in range(rod.obstacles):
            contact = self.contact(at, o)
            value = rod.scratch[contact + VALUE * self.stride]
            if self.is_close(rod, value):
                gap = ti.max(value - radius, floor) + slack
                normal = self.load3(rod.scratch, contact + NORMAL * self.stride)
                most = ti.max(most, (0.0 - APPROACH) * dot(normal, move) / ti.max(gap, 1e-6 * radius))
            weight = rod.scratch[contact + WEIGHT * self.stride]
            if self.largest(weight) > 0.0:
                s = rod.scratch[contact + PLACE_BETWEEN * self.stride]
                between = plus(before, scaled(minus(move, before), s))
                gap = ti.max(rod.scratch[contact + VALUE_BETWEEN * self.stride] - radius, floor) + slack
                away = self.load3(rod.scratch, contact + NORMAL_BETWEEN * self.stride)
                share = (0.0 - APPROACH) * dot(away, between) / ti.max(gap, 1e-6 * radius)
                most = ti.select(weight > 0.0, ti.max(most, share), most)
        return ti.max(dot(move, move) * self.nearness(rod, index, at, ROOM), most * most)

    # --- rounds ---

    @ti.func
    def tolerance(self, rod, given):
        """The residual that a rod is to reach where ``given`` is that of one without contact: more while its rounds are rough,
        and at least what rounding of places makes of the forces."""
        phase = self.item(rod, PHASE)
        factor = ti.select(phase > ti.static(0.5 * (BARRIER + ROUGH)), 0.0 * given + ROUGHEST, 0.0 * given + ROUGHER)
        noise = self.rounding * self.item(rod, STIFFNESS) * rod.longest * rod.total * rod.total
        return ti.select(phase > ti.static(0.5 * (ROUGH + FINE)), factor * given, given) + noise

    @ti.func
    def enter(self, rod, fresh):
        """Begin with the barrier where a rod has just been loaded, its gaps larger by so much that its start is within."""
        loaded = fresh & (self.item(rod, PHASE) > ti.static(0.5 * (LOADED + BARRIER)))
        radius = self.item(rod, RADIUS)
        self.set_item(rod, OFFSET, loaded, ti.max(LEAST_OFFSET * radius - self.item(rod, CLOSEST), 0.0 * radius))
        self.set_item(rod, PHASE, loaded, 0.0 * radius + BARRIER)
        return loaded

    @ti.func
    def settle(self, rod, due):
        """End a round in the lanes that are ``due`` with new forces, or the barrier with those it exerts. Returns the largest
        change of a gap that they mean."""
        zero = 0.0 * rod.total
        radius, stiffness, phase = self.item(rod, RADIUS), self.item(rod, STIFFNESS), self.item(rod, PHASE)
        behind = phase > ti.static(0.5 * (BARRIER + ROUGH))
        change, secant, rubbed = zero, zero, zero  # friction settles no sooner with a larger κ
        for v in range(rod.edges + 1):
            at = self.vertex(rod, v)
            for o in range(rod.obstacles):
                contact = self.contact(at, o)
                for k in ti.static(range(2)):
                    old = rod.scratch[contact + (FORCE + k) * self.stride]
                    gap = rod.scratch[contact + (VALUE_BETWEEN if k else VALUE) * self.stride] - radius
                    pushed = self.barrier(rod, gap).push
                    new = ti.select(behind, pushed, ti.max(old - stiffness * gap, zero))
                    if ti.static(k == 1):
                        new, late = self.settle_between(rod, v, o, due, gap, new)
                        change = largest_of(change, ti.select(behind, zero, late))
                    secant = largest_of(secant, new / ti.max(gap + self.item(rod, OFFSET), 1e-3 * radius))
                    change = largest_of(change, absolute(new - old))
                    rod.scratch[contact + (FORCE + k) * self.stride] = ti.select(due, new, old)
                if ti.static(self.rub):
                    rubbed = largest_of(rubbed, self.settle_friction(rod, v, o, due))
        change = ti.select(due & ~behind, change / stiffness, zero)
        slow = due & ~behind & (change > SLOW * self.item(rod, CHANGE)) & (change > self.item(rod, TOLERANCE))
        self.set_item(rod, STIFFNESS, slow, STIFFER * stiffness)
        self.set_item(rod, CHANGE, due & ~behind, change)
        nearest = self.item(rod, CLOSEST) + self.item(rod, OFFSET)
        last = due & behind & ((self.item(rod, STAGE) > STAGES - 1.5) | (nearest < NEAR_ENOUGH * radius))
        for item in ti.static((STIFFNESS, FIRST_STIFFNESS)):
            self.set_item(rod, item, last & (secant > 0.0), ti.max(SECANT * secant, self.item(rod, FIRST_STIFFNESS)))
        self.set_item(rod, PHASE, last, zero + ROUGH)
        self.set_item(rod, STRENGTH, due & behind & ~last, WEAKER * self.item(rod, STRENGTH))
        self.set_item(rod, STAGE, due & behind, 1.0 + self.item(rod, STAGE))
        return largest_of(change, ti.select(due & ~behind, rubbed / stiffness, zero))

    @ti.func
    def settle_between(self, rod, index, o, due, gap, force):
        """Whether the rounds that follow have the nearest point of an edge: as long as it is nearer than the ends. Returns its
        force, which otherwise goes to the nearer end, and what it should have been where they did not have it so far."""
        zero = 0.0 * gap
        contact = self.contact(self.vertex(rod, index), o)
        active = rod.scratch[contact + ACTIVE * self.stride]
        sags = (rod.scratch[contact + SAGGING * self.stride] > 0.5 * self.item(rod, TOLERANCE)) & (index > 0)
        lost = due & (active > 0.5) & ~sags
        if self.largest(ti.select(lost, zero + 1.0, zero)) > 0.5:
            later = rod.scratch[contact + PLACE_BETWEEN * self.stride] > 0.5
            given = ti.select(lost, force, zero)
            end = contact + FORCE * self.stride
            rod.scratch[end] = rod.scratch[end] + ti.select(later, given, zero)
            start = self.contact(self.vertex(rod, index - 1), o) + FORCE * self.stride
            rod.scratch[start] = rod.scratch[start] + ti.select(later, zero, given)
        late = ti.select(sags & (active < 0.5), ti.max(self.item(rod, STIFFNESS) * (0.0 - gap), zero), zero)
        rod.scratch[contact + ACTIVE * self.stride] = ti.select(due, ti.select(sags, zero + 1.0, zero), active)
        return ti.select(sags, force, zero), late

    @ti.func
    def settle_friction(self, rod, index, o, due):
        """New friction on a vertex and on the edge that ends there, under the new forces: by how much it changes."""
        zero = 0.0 * rod.total
        at = self.vertex(rod, index)
        contact = self.contact(at, o)
        change = zero
        if self.is_close(rod, rod.scratch[contact + VALUE * self.stride]):
            normal = self.load3(rod.scratch, contact + NORMAL * self.stride)
            rubbed = self.rubbed(rod, o, contact, FORCE, FRICTION, normal, self.moved(rod, at))
            change = self.keep_friction(rod, contact + FRICTION * self.stride, rubbed.pull, due)
        active = rod.scratch[contact + ACTIVE * self.stride] > 0.5
        if index > 0 and self.largest(ti.select(active, zero + 1.0, zero)) > 0.5:
            s = rod.scratch[contact + PLACE_BETWEEN * self.stride]
            u = plus(scaled(self.moved(rod, self.vertex(rod, index - 1)), 1.0 - s), scaled(self.moved(rod, at), s))
            away = self.load3(rod.scratch, contact + NORMAL_BETWEEN * self.stride)
            between = self.rubbed(rod, o, contact, FORCE_BETWEEN, FRICTION_BETWEEN, away, u)
            pull = chosen(active, between.pull, repeated(zero, 3))
            change = largest_of(change, self.keep_friction(rod, contact + FRICTION_BETWEEN * self.stride, pull, due))
        return change

    @ti.func
    def keep_friction(self, rod, at, pull, due):
        """Store a friction in the lanes that are ``due``: by how much it changes."""
        old = self.load3(rod.scratch, at)
        change = minus(pull, old)
        self.store(rod.scratch, at, chosen(due, pull, old))
        return ti.sqrt(dot(change, change))

    # --- from one instant to the next ---

    @ti.func
    def renew(self, rod, done):
        """Begin another step from where the rods are, in the lanes that are ``done``."""
        zero = 0.0 * rod.total
        work = zero
        for v in range(rod.edges + 1):
            at = self.vertex(rod, v)
            if ti.static(self.rub):
                for o in range(rod.obstacles):
                    contact = self.contact(at, o)
                    work = work + dot(self.load3(rod.scratch, contact + FRICTION * self.stride), self.moved(rod, at))
                    if v > 0:
                        s = rod.scratch[contact + PLACE_BETWEEN * self.stride]
                        active = rod.scratch[contact + ACTIVE * self.stride] > 0.5
                        u = plus(scaled(self.moved(rod, self.vertex(rod, v - 1)), 1.0 - s), scaled(self.moved(rod, at), s))
                        between = dot(self.load3(rod.scratch, contact + FRICTION_BETWEEN * self.stride), u)
                        work = work + ti.select(active, between, zero)
        self.set_item(rod, WORK, done, self.item(rod, WORK) + work)
        self.set_item(rod, PHASE, done, zero + ROUGH)
        self.set_item(rod, CHANGE, done, zero + 1e30)
        self.set_item(rod, STIFFNESS, done, self.item(rod, FIRST_STIFFNESS))

    @ti.func
    def remember(self, rod, index, place, done):
        """Make ``place`` that of vertex ``index`` at the instant before, in the lanes that are ``done``."""
        at = self.vertex(rod, index) + PREVIOUS * self.stride
        self.store(rod.scratch, at, chosen(done, place, self.load3(rod.scratch, at)))

    @ti.func
    def load_motion(self, tables, scratch: ti.template(), slot, row, unit, inertia):
        """Of a rod in motion, into lane ``slot``: its places at the last instant, and κ for that inertia of a vertex."""
        first = tables.contacts + (HEAD + tables.kinds.shape[0] * OBSTACLE_COLUMNS) * self.stride
        size = (VERTEX_ITEMS + tables.kinds.shape[0] * CONTACT_ITEMS) * self.stride
        for v in range(tables.rest_length.shape[1] + 1):
            for k in ti.static(range(3)):
                self.put(scratch, first + v * size + (PREVIOUS + k) * self.stride, slot, tables.places[row, v, k] / unit)
        # The first step of a motion begins with the barrier, which also finds κ.
        stiffness = ti.cast(self.get(scratch, tables.contacts + STIFFNESS * self.stride, slot), ti.f64) + INERT * inertia
        phase = ti.cast(LOADED, ti.f64)
        if tables.memory[row, 0, 0, FORCE_BETWEEN] > 0.0:
            stiffness, phase = tables.memory[row, 0, 0, FORCE_BETWEEN], ROUGH
        for item in ti.static((STIFFNESS, FIRST_STIFFNESS)):
            self.put(scratch, tables.contacts + item * self.stride, slot, stiffness)
        self.put(scratch, tables.contacts + PHASE * self.stride, slot, phase)
        self.put(scratch, tables.contacts + WORK * self.stride, slot, 0.0)

    # --- a rod into a lane and out of it ---

    @ti.func
    def load(self, tables, scratch: ti.template(), slot, rod, unit, scale):
        """Rod ``rod``'s obstacles and contacts into lane ``slot``, lengths over ``unit``; ``scale``: the largest stiffness, the
        weight per length, the lengths of an edge, of the longest and of the rod, in the units of the chain."""
        base = tables.contacts
        row = tables.rods[rod, of.RESULT_ROW]
        own = ti.min(row, tables.obstacles.shape[0] - 1)
        count, vertices = tables.kinds.shape[0], tables.rest_length.shape[1] + 1
        radius = tables.radius[ti.min(row, tables.radius.shape[0] - 1)] / unit
        force = BENDING_LOADS * scale.bend / (scale.total * scale.total) + scale.weight * scale.length
        tolerance = ti.max(tables.tolerance * radius, 10.0 * self.rounding * scale.total)
        head = (radius, force / (SOFT * radius), tolerance, 1e30, LOADED, 0.0, BARRIER_SHARE * force * radius, 0.0,
                CLOSE * radius + 0.5 * scale.longest, 0.0)
        for k in ti.static(range(len(head))):
            self.put(scratch, base + k * self.stride, slot, head[k])
        for o in range(count):
            at = base + (HEAD + o * OBSTACLE_COLUMNS) * self.stride
            for k in range(OBSTACLE_COLUMNS):
                is_length = (k < 3) | ((k >= SIZES) & (k <= DEPTH))
                factor = ti.select(is_length, 1.0 / unit, ti.cast(1.0, ti.f64))
                self.put(scratch, at + k * self.stride, slot, tables.obstacles[own, o, k] * factor)
        first = base + (HEAD + count * OBSTACLE_COLUMNS) * self.stride
        for v in range(vertices):
            at = first + v * (VERTEX_ITEMS + count * CONTACT_ITEMS) * self.stride
            self.put(scratch, at + ROOM * self.stride, slot, 1e30)
            for o in range(count):
                contact = at + (VERTEX_ITEMS + o * CONTACT_ITEMS) * self.stride
                self.put(scratch, contact + WEIGHT * self.stride, slot, 0.0)
                self.put(scratch, contact + ACTIVE * self.stride, slot, 0.0)
                for k in range(tables.memory.shape[3]):
                    self.put(scratch, contact + k * self.stride, slot, tables.memory[row, v, o, k])

    @ti.func
    def unload_forces(self, tables, scratch: ti.template(), slot, place, force_unit):
        """The forces on the lane's vertices into row ``place``."""
        first = tables.contacts + (HEAD + tables.kinds.shape[0] * OBSTACLE_COLUMNS) * self.stride
        size = (VERTEX_ITEMS + tables.kinds.shape[0] * CONTACT_ITEMS) * self.stride
        vertices = tables.rest_length.shape[1] + 1
        for v in range(vertices):
            at = first + v * size
            for k in ti.static(range(3)):
                force = ti.cast(self.get(scratch, at + (FORCE_END + k) * self.stride, slot), ti.f64)
                if v < vertices - 1:
                    force += self.get(scratch, at + size + (FORCE_START + k) * self.stride, slot)
                tables.forces[place, v, k] = force * force_unit

    @ti.func
    def unload(self, tables, scratch: ti.template(), slot, row):
        """The lane's contacts into row ``row`` of the memory, in the units of the chain; in the place of the edge before vertex
        0, which there is not, κ."""
        first = tables.contacts + (HEAD + tables.kinds.shape[0] * OBSTACLE_COLUMNS) * self.stride
        for v in range(tables.rest_length.shape[1] + 1):
            at = first + v * (VERTEX_ITEMS + tables.kinds.shape[0] * CONTACT_ITEMS) * self.stride
            for o in range(tables.kinds.shape[0]):
                contact = at + (VERTEX_ITEMS + o * CONTACT_ITEMS) * self.stride
                for k in range(tables.memory.shape[3]):
                    tables.memory[row, v, o, k] = self.get(scratch, contact + k * self.stride, slot)
        tables.memory[row, 0, 0, FORCE_BETWEEN] = self.get(scratch, tables.contacts + FIRST_STIFFNESS * self.stride, slot)
