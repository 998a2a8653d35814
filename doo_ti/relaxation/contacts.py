"""Contacts from one instant to the next, into scratch and out of it (docs/contact.md)."""

import taichi as ti

from doo_ti.contact.obstacles import DEPTH, OBSTACLE_COLUMNS, SIZES
from doo_ti.contact.obstacles import FRICTION as COEFFICIENT
from doo_ti.contact.touch import Touch
from doo_ti.physics.tuples import chosen, dot
from doo_ti.relaxation import tables as of
from doo_ti.relaxation.contact_layout import (
    ACTIVE,
    BARRIER_SHARE,
    BENDING_LOADS,
    CHANGE,
    CLOSE,
    CONTACT_ITEMS,
    EARLY,
    EASED,
    EXPECTING,
    FIRST_STIFFNESS,
    FIRST_STRENGTH,
    FIRST_VISCOSITY,
    FORCE,
    FORCE_BETWEEN,
    FORCE_END,
    FORCE_START,
    FRICTION,
    FRICTION_BETWEEN,
    HEAD,
    HELD,
    INERT,
    LARGEST,
    LEAST_BLOCKED,
    LEAST_VISCOSITY,
    LOADED,
    MOST_EASED,
    MOST_VISCOSITY,
    MULTIPLIER,
    OBSTACLE_ITEMS,
    OFFSET,
    PHASE,
    PREVIOUS,
    PUSHED,
    PUSHES,
    PUSHES_BETWEEN,
    REMEMBERED,
    REMEMBERED_IN_MOTION,
    RETRIED,
    ROOM,
    ROUGH,
    RUBBED_PLACE,
    SETTLING,
    SOFT,
    STAGE,
    STIFFNESS,
    STRENGTH,
    THICKER,
    THINNER,
    THROUGH,
    TIGHT,
    TURN,
    TURN_BEFORE,
    VERTEX_ITEMS,
    VISCOSITY,
    VISCOUS,
    WAY,
    WAY_MADE,
    WORK,
)
from doo_ti.relaxation.contact_rounds import ContactRounds

NONE, STICKS, SLIPS = map(int, Touch)
CARRIED_ON = ((FORCE_BETWEEN, FIRST_STIFFNESS), (FRICTION_BETWEEN, STIFFNESS), (FRICTION_BETWEEN + 1, LARGEST),
              (FRICTION_BETWEEN + 2, WAY), (RUBBED_PLACE, WORK))
"""No edge ends at vertex 0. Where memory would have these items of it, it has these items of the rod."""


@ti.data_oriented
class Contacts(ContactRounds):
    """The contacts from one instant to the next, and on their way into scratch and out of it. ``itself``: rods may touch
    themselves, or each other."""

    itself = False

    # --- from one instant to the next ---

    @ti.func
    def renew(self, rod, done, least, multiplier):
        """Begin another step from where the rods are, in the lanes that are ``done``; returns those in which the clamps have
        not made all their way to the next instant, of which they make ``least`` at once or more."""
        zero = 0.0 * rod.total
        one = zero + 1.0
        made = self.item(rod, WAY_MADE) + self.item(rod, WAY)
        midway = done & (made < 1.0 - 1e-3 * self.item(rod, WAY))
        eased = done & (self.item(rod, VISCOSITY) > 0.0)
        midway = midway | eased
        made = ti.select(midway, made, zero)
        self.set_item(rod, WAY_MADE, done, made)
        # The clamps wait until the rod has come to rest without viscosity.
        further = ti.max(2.0 * self.item(rod, WAY), least)
        self.set_item(rod, WAY, done, ti.select(eased, zero, ti.min(further, one - made)))
        thinner = THINNER * self.item(rod, VISCOSITY)
        enough = thinner > LEAST_VISCOSITY * self.item(rod, FIRST_VISCOSITY)
        self.set_item(rod, VISCOSITY, done, ti.select(enough, thinner, zero))
        self.set_item(rod, EASED, done & ~midway, zero)
        for k in ti.static(range(3)):
            self.set_item(rod, MULTIPLIER + k, done, multiplier[k])
        if ti.static(self.rub):
            self.set_item(rod, WORK, done, self.item(rod, WORK) + self.friction_work(rod))
        if ti.static(self.moves):
            self.remember_poses(rod, done)
        self.begin_rounds(rod, done)
        return midway

    @ti.func
    def begin_rounds(self, rod, where):
        """Begin with the rounds of a step, from the forces that there are, in the lanes ``where``."""
        zero = 0.0 * rod.total
        self.set_item(rod, PHASE, where, zero + ROUGH)
        self.set_item(rod, CHANGE, where, zero + 1e30)
        self.set_item(rod, STIFFNESS, where, self.item(rod, FIRST_STIFFNESS))
        self.tighten(rod, where)
        for item in ti.static((RETRIED, SETTLING, EARLY)):
            self.set_item(rod, item, where, zero)

    @ti.func
    def friction_work(self, rod):
        """The work of friction since the instant before."""
        zero = 0.0 * rod.total
        work = zero
        for v in range(rod.edges + 1):
            at = self.vertex(rod, v)
            for o in range(rod.obstacles):
                contact = self.contact(at, o)
                work = work + dot(self.load3(rod.scratch, contact + FRICTION * self.stride), self.slid(rod, at, o))
                if v > 0:
                    friction = self.load3(rod.scratch, contact + FRICTION_BETWEEN * self.stride)
                    active = rod.scratch[contact + ACTIVE * self.stride] > 0.5
                    work = work + ti.select(active, dot(friction, self.slid_between(rod, v, contact, o)), zero)
        return work + self.pair_work(rod)

    @ti.func
    def retry(self, rod, failed, blocked, bowed, least):
        """Prepare a step that has failed for another try, which knows no forces and begins with the barrier; returns the lanes
        in which there is one. A second try, and a first one that would begin inside an obstacle (``blocked``), though not one
        in which a straight rod was ``bowed``, makes half the way, down to ``least`` of that to the next instant. Where that
        fails too there is no equilibrium near, and the rod goes to another one against viscosity."""
        zero = 0.0 * rod.total
        viscosity = self.item(rod, VISCOSITY)
        again = failed & (self.item(rod, RETRIED) < 0.5) & (bowed | ~blocked) & (viscosity <= 0.0)
        quasi_static = least < 0.9
        shortest = ti.select(blocked, LEAST_BLOCKED * least, least)
        shorter = failed & ~again & (self.item(rod, WAY) > 1.5 * shortest) & quasi_static & ((viscosity <= 0.0) | blocked)
        eased = failed & ~again & ~blocked & ~shorter & quasi_static & (self.item(rod, EASED) < MOST_EASED) & (
            viscosity < MOST_VISCOSITY * self.item(rod, FIRST_VISCOSITY))
        once = again | shorter | eased
        if self.some(once, zero):
            self.set_item(rod, WAY, shorter, 0.5 * self.item(rod, WAY))
            self.set_item(rod, VISCOSITY, eased, ti.max(THICKER * viscosity, self.item(rod, FIRST_VISCOSITY)))
            self.set_item(rod, EASED, eased, 1.0 + self.item(rod, EASED))
            for v in range(rod.edges + 1):
                at = self.vertex(rod, v)
                for o in range(rod.obstacles):
                    contact = self.contact(at, o)
                    for k in ti.static(range(REMEMBERED_IN_MOTION)):
                        item = contact + k * self.stride
                        rod.scratch[item] = ti.select(once, zero, rod.scratch[item])
            self.forget_pairs(rod, once)
            self.set_item(rod, PHASE, once, zero + LOADED)
            for item in ti.static((OFFSET, STAGE, SETTLING, EARLY)):
                self.set_item(rod, item, once, zero)
            self.set_item(rod, STRENGTH, once, self.item(rod, FIRST_STRENGTH))
            self.set_item(rod, CHANGE, once, zero + 1e30)
            self.set_item(rod, STIFFNESS, once, self.item(rod, FIRST_STIFFNESS))
            self.set_item(rod, RETRIED, once, zero + 1.0)
        return once

    @ti.func
    def remember(self, rod, index, place, done):
        """Make ``place`` that of vertex ``index`` at the instant before, in the lanes that are ``done``."""
        at = self.vertex(rod, index) + PREVIOUS * self.stride
        self.store(rod.scratch, at, chosen(done, place, self.load3(rod.scratch, at)))

    @ti.func
    def remember_poses(self, rod, done):
        """Make the pose of every obstacle that of the instant before, in the lanes that are ``done``."""
        for o in range(rod.obstacles):
            at = self.obstacle(rod, o)
            for k in ti.static(range(TURN_BEFORE - TURN)):
                before = at + (TURN_BEFORE + k) * self.stride
                rod.scratch[before] = ti.select(done, rod.scratch[at + (TURN + k) * self.stride], rod.scratch[before])

    @ti.func
    def load_motion(self, tables, scratch: ti.template(), slot, row, unit, inertia):
        """Of a rod in motion, into lane ``slot``: its places at the last instant, and κ for that inertia of a vertex."""
        first = tables.contacts + (HEAD + tables.kinds.shape[0] * OBSTACLE_ITEMS) * self.stride
        size = (VERTEX_ITEMS + tables.kinds.shape[0] * CONTACT_ITEMS) * self.stride
        for v in range(tables.rest_length.shape[1] + 1):
            for k in ti.static(range(3)):
                self.put(scratch, first + v * size + (PREVIOUS + k) * self.stride, slot, tables.places[row, v, k] / unit)
        # The first step of a motion knows no forces. All others continue as if no launch had ended before them.
        stiffness = ti.cast(self.get(scratch, tables.contacts + STIFFNESS * self.stride, slot), ti.f64) + INERT * inertia
        for item in ti.static((STIFFNESS, FIRST_STIFFNESS)):
            self.put(scratch, tables.contacts + item * self.stride, slot, stiffness)
        self.put(scratch, tables.contacts + PHASE * self.stride, slot, self.first_phase)
        self.put(scratch, tables.contacts + WAY * self.stride, slot, 1.0)
        for item in ti.static((WORK, LARGEST, VISCOSITY, EASED, WAY_MADE)):
            self.put(scratch, tables.contacts + item * self.stride, slot, 0.0)
        if tables.memory[row, 0, 0, FORCE_BETWEEN] > 0.0:
            self.put(scratch, tables.contacts + PHASE * self.stride, slot, ROUGH)
            for pair in ti.static(CARRIED_ON):
                self.put(scratch, tables.contacts + pair[1] * self.stride, slot, tables.memory[row, 0, 0, pair[0]])
            self.load_carried_pairs(tables, scratch, slot, row)
        for k in ti.static(range(3)):
            self.put(scratch, tables.contacts + (MULTIPLIER + k) * self.stride, slot, tables.results[row, of.FORCE + k])

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
        bending = BENDING_LOADS * scale.bend / (scale.total * scale.total)
        force, whole = bending + scale.weight * scale.length, bending + scale.weight * scale.total
        thinnest = ti.cast(1e30, ti.f64)
        for o in range(count):
            thinnest = ti.min(thinnest, tables.obstacles[own, o, DEPTH] / unit)
        stiffness = ti.max(force / (SOFT * radius), whole / (THROUGH * (radius + thinnest)))
        strength = BARRIER_SHARE * force * radius
        viscosity = VISCOUS * whole / (scale.total * vertices * unit * unit)
        tolerance = ti.max(tables.tolerance * radius, 10.0 * self.rounding * scale.total)
        head = (radius, stiffness, tolerance, 1e30, self.first_phase, 0.0, strength, 0.0,
                CLOSE * radius + 0.5 * scale.longest, stiffness, 0.0, 0.0, strength)
        for k in ti.static(range(len(head))):
            self.put(scratch, base + k * self.stride, slot, head[k])
        self.put(scratch, base + FIRST_VISCOSITY * self.stride, slot, viscosity)
        for item in ti.static((SETTLING, EARLY, EXPECTING)):
            self.put(scratch, base + item * self.stride, slot, 0.0)
        for o in range(count):
            at = base + (HEAD + o * OBSTACLE_ITEMS) * self.stride
            for k in range(OBSTACLE_COLUMNS):
                is_length = (k < 3) | ((k >= SIZES) & (k <= DEPTH))
                factor = ti.select(is_length, 1.0 / unit, ti.cast(1.0, ti.f64))
                self.put(scratch, at + k * self.stride, slot, tables.obstacles[own, o, k] * factor)
        first = base + (HEAD + count * OBSTACLE_ITEMS) * self.stride
        largest = ti.cast(0.0, ti.f64)
        for v in range(vertices):
            at = first + v * (VERTEX_ITEMS + count * CONTACT_ITEMS) * self.stride
            self.put(scratch, at + ROOM * self.stride, slot, 1e30)
            self.put(scratch, at + PUSHED * self.stride, 0, 1.0)
            for o in range(count):
                contact = at + (VERTEX_ITEMS + o * CONTACT_ITEMS) * self.stride
                for item in ti.static((PUSHES, PUSHES_BETWEEN) if self.expects else ()):
                    self.put(scratch, contact + item * self.stride, slot, 0.0)
                for k in ti.static(range(REMEMBERED, REMEMBERED_IN_MOTION) if self.rub else (ACTIVE,)):
                    self.put(scratch, contact + k * self.stride, slot, 0.0)
                # No edge ends at vertex 0: memory has other numbers there.
                force, between = tables.memory[row, v, o, FORCE], ti.select(v > 0, tables.memory[row, v, o, FORCE_BETWEEN], 0.0)
                largest = ti.max(largest, ti.max(force, between))
                self.put(scratch, contact + FORCE * self.stride, slot, force)
                self.put(scratch, contact + FORCE_BETWEEN * self.stride, slot, between)
                for k in range(REMEMBERED, tables.memory.shape[3]):
                    self.put(scratch, contact + k * self.stride, slot, tables.memory[row, v, o, k])
                if v == 0:
                    for pair in ti.static(CARRIED_ON[1:]):
                        self.put(scratch, contact + pair[0] * self.stride, slot, 0.0)
        # A rod that begins with large forces would slip into the obstacle if κ gave way as if it had none.
        self.put(scratch, base + LARGEST * self.stride, slot, largest)
        self.put(scratch, base + STIFFNESS * self.stride, slot, ti.max(stiffness, largest / (TIGHT * radius)))
        self.load_pairs(tables, scratch, slot, row)

    @ti.func
    def unload_forces(self, tables, scratch: ti.template(), slot, place, force_unit):
        """The forces on the lane's vertices into row ``place``."""
        first = tables.contacts + (HEAD + tables.kinds.shape[0] * OBSTACLE_ITEMS) * self.stride
        size = (VERTEX_ITEMS + tables.kinds.shape[0] * CONTACT_ITEMS) * self.stride
        vertices = tables.rest_length.shape[1] + 1
        for v in range(vertices):
            at = first + v * size
            for k in ti.static(range(3)):
                force = ti.cast(self.get(scratch, at + (FORCE_END + k) * self.stride, slot), ti.f64)
                if v < vertices - 1:
                    force += self.get(scratch, at + size + (FORCE_START + k) * self.stride, slot)
                force += self.pair_force(tables, scratch, slot, v, k)
                tables.forces[place, v, k] = force * force_unit

    @ti.func
    def unload_touch(self, tables, scratch: ti.template(), slot, place):
        """The :class:`.Touch` of each vertex of the lane, with the edge that ends there, into row ``place``."""
        first = tables.contacts + (HEAD + tables.kinds.shape[0] * OBSTACLE_ITEMS) * self.stride
        for v in range(tables.rest_length.shape[1] + 1):
            at = first + v * (VERTEX_ITEMS + tables.kinds.shape[0] * CONTACT_ITEMS) * self.stride
            touch = self.pair_touch(tables, scratch, slot, v)
            for o in range(tables.kinds.shape[0]):
                contact = at + (VERTEX_ITEMS + o * CONTACT_ITEMS) * self.stride
                obstacle = tables.contacts + (HEAD + o * OBSTACLE_ITEMS) * self.stride
                coefficient = self.get(scratch, obstacle + COEFFICIENT * self.stride, slot)
                for items in ti.static(((FORCE, FRICTION), (FORCE_BETWEEN, FRICTION_BETWEEN))):
                    force, friction = contact + items[0] * self.stride, contact + items[1] * self.stride
                    touch = ti.max(touch, self.touch_of(scratch, slot, force, friction, coefficient))
            tables.touches[place, v] = touch

    @ti.func
    def touch_of(self, scratch: ti.template(), slot, force, friction, coefficient):
        """The :class:`.Touch` of a contact whose force and friction begin at those places in scratch."""
        found = ti.cast(NONE, ti.i32)
        limit = coefficient * self.get(scratch, force, slot)
        if self.get(scratch, force, slot) > 0.0:
            square = 0.0 * limit
            for k in ti.static(range(3)):
                square += self.get(scratch, friction + k * self.stride, slot) ** 2
            found = ti.select(square < (HELD * limit) ** 2, STICKS, SLIPS)
        return found

    @ti.func
    def unload(self, tables, scratch: ti.template(), slot, row):
        """The lane's contacts into row ``row`` of the memory, in the units of the chain; in the place of the edge before vertex
        0, which there is not, κ."""
        first = tables.contacts + (HEAD + tables.kinds.shape[0] * OBSTACLE_ITEMS) * self.stride
        for v in range(tables.rest_length.shape[1] + 1):
            at = first + v * (VERTEX_ITEMS + tables.kinds.shape[0] * CONTACT_ITEMS) * self.stride
            for o in range(tables.kinds.shape[0]):
                contact = at + (VERTEX_ITEMS + o * CONTACT_ITEMS) * self.stride
                for k in ti.static((FORCE, FORCE_BETWEEN)):
                    tables.memory[row, v, o, k] = self.get(scratch, contact + k * self.stride, slot)
                for k in range(REMEMBERED, tables.memory.shape[3]):
                    tables.memory[row, v, o, k] = self.get(scratch, contact + k * self.stride, slot)
        self.carry_on(tables, scratch, slot, row, CARRIED_ON[:1])

    @ti.func
    def unload_motion(self, tables, scratch: ti.template(), slot, row):
        """The same of a rod in motion, with what its next step begins with."""
        self.unload(tables, scratch, slot, row)
        self.carry_on(tables, scratch, slot, row, CARRIED_ON[1:])
        self.carry_pairs(tables, scratch, slot, row)

    @ti.func
    def carry_on(self, tables, scratch: ti.template(), slot, row, pairs: ti.template()):
        """Those items of the lane's rod into row ``row`` of the memory."""
        for pair in ti.static(pairs):
            tables.memory[row, 0, 0, pair[0]] = self.get(scratch, tables.contacts + pair[1] * self.stride, slot)

    # --- of a rod that may also touch itself, :class:`doo_ti.relaxation.self_contacts.SelfContacts` ---

    @ti.func
    def pair_work(self, rod):
        """The work of the rod's friction on itself since the instant before."""
        return 0.0 * rod.total

    @ti.func
    def forget_pairs(self, rod, once):
        """Forget the forces between edges in the lanes where ``once``."""

    @ti.func
    def load_pairs(self, tables, scratch: ti.template(), slot, row):
        """Begin lane ``slot`` without forces between edges."""

    @ti.func
    def load_carried_pairs(self, tables, scratch: ti.template(), slot, row):
        """What the launch before has left of edges, into lane ``slot``."""

    @ti.func
    def carry_pairs(self, tables, scratch: ti.template(), slot, row):
        """What the next launch needs of edges, from lane ``slot``."""

    @ti.func
    def pair_touch(self, tables, scratch: ti.template(), slot, vertex):
        """The :class:`.Touch` of the edge that ends at a vertex of lane ``slot`` with other edges."""
        return ti.cast(NONE, ti.i32)

    @ti.func
    def pair_force(self, tables, scratch: ti.template(), slot, vertex, k: ti.template()):
        """Component ``k`` of the rod's own force on a vertex of lane ``slot``."""
        return ti.cast(0.0, ti.f64)
