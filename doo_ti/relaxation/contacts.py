"""The contacts of rods from one instant to the next, into scratch and out of it (docs/contact.md)."""

import taichi as ti

from doo_ti.contact.obstacles import DEPTH, OBSTACLE_COLUMNS, SIZES
from doo_ti.contact.touch import HELD, Touch
from doo_ti.physics.number import device_functions, in_f64, read
from doo_ti.physics.tuples import choose, dot, repeated, scaled
from doo_ti.relaxation import contact_table as layout
from doo_ti.relaxation import tables as of
from doo_ti.relaxation.contact_rounds import ContactRounds

NONE, STICKS, SLIPS = map(int, Touch)


@device_functions
class RodContacts(ContactRounds):
    """The contacts from one instant to the next, and on their way into scratch and out of it."""

    # --- from one instant to the next ---

    def renew(self, rod, done, least, multiplier):
        """Begin another step from where the rods are, in the lanes that are ``done``. Returns those in which the step ends
        before the next instant: the clamps have made a part of their way to it only, or the step had viscosity. The next part
        of the way is twice as long, and at least ``least`` of the whole."""
        zero = 0.0 * rod.total
        one = zero + 1.0
        made = rod.contacts.way_made + rod.contacts.way
        midway = done & (made < 1.0 - 1e-3 * rod.contacts.way)
        eased = done & (rod.contacts.viscosity > 0.0)
        midway = midway | eased
        made = ti.select(midway, made, zero)
        further = ti.max(2.0 * rod.contacts.way, least)
        way = ti.select(eased, zero, ti.min(further, one - made))  # clamps wait for a rod at rest without viscosity
        thinner = rod.contacts.viscosity / layout.STIFFER
        enough = thinner >= 0.5 * rod.contacts.first_viscosity  # rounding apart, the first one
        viscosity = ti.select(enough, thinner, zero)
        choose(rod.contacts, done, way_made=made, way=way, viscosity=viscosity, multiplier=multiplier)
        choose(rod.contacts, done & ~midway, eased=zero)
        if ti.static(self.rub):
            choose(rod.contacts, done, work=rod.contacts.work + self.friction_work(rod))
        if ti.static(self.moves):
            for o in range(rod.obstacles):
                at = self.obstacle(rod, o)
                choose(at, done, pose_before=at.pose)
        self.begin_rounds(rod, done)
        return midway

    def begin_rounds(self, rod, where):
        """Begin with the rounds of a step, from the forces that there are, in the lanes ``where``."""
        zero = 0.0 * rod.total
        choose(rod.contacts, where, phase=zero + layout.ROUGH, change=zero + 1e30, stiffness=rod.contacts.first_stiffness,
               retried=zero, update_stiffness=zero, updates=zero, slipped=zero)
        self.tighten(rod, where)

    def friction_work(self, rod):
        """The work of friction since the instant before."""
        zero = 0.0 * rod.total
        work = zero
        for v in range(rod.edges + 1):
            at = self.vertex(rod, v)
            for o in range(rod.obstacles):
                contact = self.contact(at, o)
                work = work + dot(contact.friction, self.slid(rod, at, o))
                if v > 0:
                    friction = contact.friction_between
                    active = contact.kept_between > 0.5
                    work = work + ti.select(active, dot(friction, self.slid_between(rod, v, contact, o)), zero)
        if ti.static(self.itself):
            work = work + self.pair_work(rod)
        return work

    def retry(self, rod, failed, blocked, bowed, least):
        """Prepare another try of a step that has ``failed``, without the forces of its contacts; returns the lanes in which
        there is one. The first is the same step, unless that began inside an obstacle (``blocked``) and the rod was not
        ``bowed``. Others make half the way, down to ``least`` of the way to the next instant. Where these fail there is no
        equilibrium near, and viscosity carries the rod to another one."""
        zero = 0.0 * rod.total
        viscosity = rod.contacts.viscosity
        again = failed & (rod.contacts.retried < 0.5) & (bowed | ~blocked) & (viscosity <= 0.0)
        quasi_static = least < 0.9
        shorter = failed & ~again & (rod.contacts.way > 1.5 * least) & quasi_static & ((viscosity <= 0.0) | blocked)
        eased = failed & ~again & ~blocked & ~shorter & quasi_static & (rod.contacts.eased < layout.MOST_TRIES)
        once = again | shorter | eased
        if self.some(once, zero):
            choose(rod.contacts, shorter, way=0.5 * rod.contacts.way)
            choose(rod.contacts, eased, viscosity=ti.max(layout.STIFFER * viscosity, rod.contacts.first_viscosity),
                   eased=1.0 + rod.contacts.eased)
            for v in range(rod.edges + 1):
                at = self.vertex(rod, v)
                for o in range(rod.obstacles):
                    choose(self.contact(at, o), once, remembered=repeated(zero, layout.REMEMBERED_IN_MOTION))
            if ti.static(self.itself):
                self.forget_pairs(rod, once)
            choose(rod.contacts, once, largest=zero)  # one that jammed would be jammed again
            self.begin_rounds(rod, once)
            choose(rod.contacts, once, retried=zero + 1.0)
        return once

    def load_motion(self, tables, slot, row, unit, inertia):
        """Of a rod in motion, into lane ``slot``: its places at the last instant, and κ for that inertia of a vertex."""
        one = self.of_lane(tables, slot)
        own = one.contacts
        for v in range(one.edges + 1):
            self.vertex(one, v).previous = scaled(read(tables.places, row, v, 0), 1.0 / unit)
        # A contact has to stop a vertex with its inertia, too.
        stiffness = in_f64(own.stiffness) + inertia
        own.stiffness, own.first_stiffness, own.phase, own.way = stiffness, stiffness, layout.ROUGH, 1.0
        own.work, own.largest, own.viscosity, own.eased, own.way_made = 0.0, 0.0, 0.0, 0.0, 0.0
        if tables.rod_memory[row, 0] > 0.0:  # not the first launch: as if none had ended before
            for k in ti.static(range(len(layout.CARRIED_ON))):
                own[layout.CARRIED_ON[k]] = tables.rod_memory[row, k]
            if ti.static(self.itself):
                self.carry_pairs(tables, slot, row, True)
        own.multiplier = read(tables.results, row, of.FORCE)

    # --- a rod into a lane and out of it ---

    def load(self, tables, slot, rod, unit, scale):
        """Rod ``rod``'s obstacles and contacts into lane ``slot``, lengths over ``unit``; ``scale``: the largest stiffness, the
        weight per length, the lengths of an edge, of the longest and of the rod, in the units of the chain."""
        one = self.of_lane(tables, slot)
        base, count = one.contacts, one.obstacles
        row = tables.rods[rod, of.RESULT_ROW]
        own = ti.min(row, tables.obstacles.shape[0] - 1)
        vertices = one.edges + 1
        radius = tables.radius[ti.min(row, tables.radius.shape[0] - 1)] / unit
        loads = ti.static(layout.LOOP_LOADS if self.itself else layout.BENDING_LOADS)
        bending = loads * scale.bend / (scale.total * scale.total)
        force, whole = bending + scale.weight * scale.length, bending + scale.weight * scale.total
        thinnest = ti.cast(1e30, ti.f64)
        for o in range(count):
            thinnest = ti.min(thinnest, tables.obstacles[own, o, DEPTH] / unit)
        stiffness = ti.max(force / (layout.SOFT * radius), whole / (layout.PRESSED_IN * (radius + thinnest)))
        viscosity = whole / (scale.total * vertices * unit * unit)
        tolerance = ti.max(tables.tolerance * radius, 10.0 * self.rounding * scale.total)
        reach = layout.CLOSE * radius + 0.5 * scale.longest
        base.radius, base.tolerance, base.reach, base.first_stiffness = radius, tolerance, reach, stiffness
        base.change, base.phase, base.work, base.retried = 1e30, layout.ROUGH, 0.0, 0.0
        base.first_viscosity, base.update_stiffness, base.updates, base.refused, base.gap_kept = viscosity, 0.0, 0.0, 0.0, 1e30
        base.slipped = 0.0
        for o in range(count):
            at = self.obstacle(one, o)
            for k in range(OBSTACLE_COLUMNS):
                is_length = (k < 3) | ((k >= SIZES) & (k <= DEPTH))
                factor = ti.select(is_length, 1.0 / unit, ti.cast(1.0, ti.f64))
                at[k] = tables.obstacles[own, o, k] * factor
        largest = ti.cast(0.0, ti.f64)
        for v in range(vertices):
            at = self.vertex(one, v)
            at.room = 1e30
            at.lane(0).pushed = 1.0
            for o in range(count):
                largest = ti.max(largest, self.load_contact(tables, self.contact(at, o), row, v, o))
        # A rod that begins with large forces would slip into the obstacle if κ gave way as if it had none.
        base.largest = largest
        base.stiffness = ti.max(stiffness, largest / (layout.PRESSED_IN * radius))
        if ti.static(self.itself):
            self.load_pairs(tables, slot, row)

    def load_contact(self, tables, contact, row, v, o):
        """What memory has of a contact into a lane; returns the larger of its forces."""
        if ti.static(self.takes_met):
            contact.pushes, contact.pushes_between = 0.0, 0.0
        kept = layout.CONTACT.at("kept_between")
        fresh = ti.static(range(layout.REMEMBERED, layout.REMEMBERED_IN_MOTION) if self.rub else (kept,))
        for k in ti.static(fresh):
            contact[k] = 0.0
        for k in range(tables.memory.shape[3]):
            contact[k] = tables.memory[row, v, o, k]
        return ti.max(tables.memory[row, v, o, 0], tables.memory[row, v, o, 1])

    def unload_forces(self, tables, slot, place, force_unit):
        """The forces on the lane's vertices into row ``place``."""
        one = self.of_lane(tables, slot)
        for v in range(one.edges + 1):
            for k in ti.static(range(3)):
                force = in_f64(self.vertex(one, v).force_end[k])
                if v < one.edges:
                    force += self.vertex(one, v + 1).force_start[k]
                if ti.static(self.itself):
                    force -= in_f64(self.own_vertex(one, v).pull[k])
                tables.forces[place, v, k] = force * force_unit

    def unload_touch(self, tables, slot, place):
        """The :class:`.Touch` of each vertex of the lane, with the edge that ends there, into row ``place``."""
        one = self.of_lane(tables, slot)
        for v in range(one.edges + 1):
            touch = ti.cast(NONE, ti.i32)
            if ti.static(self.itself):
                touch = self.pair_touch(tables, slot, v)
            for o in range(one.obstacles):
                contact, coefficient = self.contact(self.vertex(one, v), o), self.obstacle(one, o).friction
                touch = ti.max(touch, self.touch_of(contact.force, contact.friction, coefficient))
                touch = ti.max(touch, self.touch_of(contact.force_between, contact.friction_between, coefficient))
            tables.touches[place, v] = touch

    def touch_of(self, force, friction, coefficient):
        """The :class:`.Touch` of a contact with that force and friction."""
        found = ti.cast(NONE, ti.i32)
        limit = coefficient * force
        if force > 0.0:
            square = 0.0 * limit
            for k in ti.static(range(3)):
                square += friction[k] ** 2
            found = ti.select(square < (HELD * limit) ** 2, STICKS, SLIPS)
        return found

    def unload(self, tables, slot, row):
        """The lane's contacts into row ``row`` of the memory, in the units of the chain."""
        one = self.of_lane(tables, slot)
        for v in range(one.edges + 1):
            for o in range(one.obstacles):
                contact = self.contact(self.vertex(one, v), o)
                for k in range(tables.memory.shape[3]):
                    tables.memory[row, v, o, k] = contact[k]

    def unload_motion(self, tables, slot, row):
        """The same of a rod in motion, with what its next step begins with."""
        self.unload(tables, slot, row)
        own = tables.contacts.lane(slot)
        for k in ti.static(range(len(layout.CARRIED_ON))):
            tables.rod_memory[row, k] = own[layout.CARRIED_ON[k]]
        if ti.static(self.itself):
            self.carry_pairs(tables, slot, row, False)
