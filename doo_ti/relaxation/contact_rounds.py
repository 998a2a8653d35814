"""Steps that cross nothing, and the rounds of contact forces (docs/contact.md)."""

import taichi as ti

from doo_ti.physics.algebra import absolute, largest_of
from doo_ti.physics.number import device_functions
from doo_ti.physics.tuples import add, choose, dot, minus, plus, record, repeated, scaled, variable
from doo_ti.relaxation.contact_energy import ContactEnergy
from doo_ti.relaxation.contact_table import FAINT, FINE, MOST_TRIES, PRESSED_IN, ROUGH, ROUGHER, SLOW, SOFT, STIFFER, STIFFEST


@device_functions
class ContactRounds(ContactEnergy):
    """The contacts with their steps and their rounds."""

    # --- steps ---

    def restore(self, rod, lost):
        """Put vertices back to where they were before the step, in the lanes that are ``lost``. Forces that it updated stay."""
        for v in range(rod.edges + 1):
            at = self.vertex(rod, v)
            choose(at, lost > 0.5, place=at.standing, room=at.room_standing)
        if ti.static(self.itself):
            self.restore_pairs(rod, lost)

    def approach(self, rod, index, before, move):
        """The square of the largest share that a ``move`` takes of a vertex's way to the middle of an obstacle, or of the gap,
        PRESSED_IN added, there and on the edge that ends there, whose start moves by ``before``. Only so much of a step is
        taken that this share is at most max_rotation (:meth:`.NewtonTrip.plan`)."""
        zero = 0.0 * move[0]
        at = self.vertex(rod, index)
        radius = rod.contacts.radius
        slack = PRESSED_IN * radius
        most = zero
        if self.is_any_close(rod, at) or (index > 0 and self.is_any_close(rod, self.vertex(rod, index - 1))):
            for o in range(rod.obstacles):
                contact = self.contact(at, o)
                value = contact.value
                if self.is_close(rod, contact):
                    gap = ti.max(value - radius, zero) + slack
                    normal = contact.normal
                    share = 0.0 - dot(normal, move) / ti.max(gap, 1e-6 * radius)
                    most = ti.select(self.close_lanes(rod, value), ti.max(most, share), most)
                if self.is_curved(rod, o) and self.is_edge_close(rod, index, o):
                    s = contact.place_between
                    between = plus(before, scaled(minus(move, before), s))
                    gap = ti.max(contact.value_between - radius, zero) + slack
                    away = contact.normal_between
                    share = 0.0 - dot(away, between) / ti.max(gap, 1e-6 * radius)
                    most = ti.select(contact.acts_between > 0.0, ti.max(most, share), most)
        return ti.max(dot(move, move) * self.nearness(rod, index, at), most * most)

    # --- rounds ---

    def tolerance(self, rod, given, final: ti.template()):
        """The residual that a rod is to reach where ``given`` is that of one without contact: more while its rounds are rough,
        unless the ``final`` one is meant, and where a contact pushes at least what rounding of places makes of its force."""
        least = variable((given,))
        if ti.static(not final):
            least = (ti.select(self.is_fine(rod), given, ti.max(given, 0.0 * given + ROUGHER)),)
        pushing = ti.select(rod.contacts.penalty > 0.0, rod.contacts.stiffness, 0.0 * given)
        return least[0] + self.rounding * pushing * rod.longest * rod.total * rod.total

    def is_fine(self, rod):
        """The lanes whose rods are in their final rounds."""
        return rod.contacts.phase < ti.static(0.5 * (ROUGH + FINE))

    def end_round(self, rod, lane, calm, rests, moved):
        """End a round where a lane's rod ``rests`` under the forces of its contacts or, while these still change, is ``calm``
        to a rougher tolerance, or where a step has ``moved`` it deeper into itself, by more than its radius: strands that have
        come to each other's middle do not find out again. Returns the lanes in which another round follows."""
        zero = 0.0 * rod.total
        fine = self.is_fine(rod)
        due = rests | (calm & ~fine)
        if ti.static(self.itself):
            gap = rod.contacts.least_gap
            due = due | (moved & ~fine & (gap < 0.0 - rod.contacts.radius) & (gap < rod.contacts.gap_kept))
            choose(rod.contacts, moved, gap_kept=gap)
        due = due & (lane.active > 0.5)
        again = variable((due,))
        if self.some(due, zero):
            before = rod.contacts.change
            close = self.update_forces(rod, due) <= rod.contacts.tolerance
            # Of two rough rounds alike the second has not moved the rod: forces would grow until it leaps.
            alike = absolute(rod.contacts.change - before) <= ROUGHER * before
            choose(rod.contacts, due & (close | alike), phase=zero + FINE)
            again = (due & ~(close & fine),)
        # The next trip evaluates the rod where it is: the step at hand was computed under the old forces.
        choose(lane, again[0], trying=zero, escaping=zero, step_scale=zero, best=zero + 1e30, idle_trips=zero, aimless=zero,
               returned=zero)
        return again[0]

    def plan_update(self, rod, lane, ready, rests):
        """Let the next step update forces in the lanes that are ``ready`` and whose rounds are rough: forces then change as
        soon as the step has moved the rod, so that no trip only evaluates the rod under new forces. Where the forces that this
        step updated changed by no more than the tolerance, the rod is done if it ``rests`` under them, else the final rounds
        begin. Returns the lanes of both kinds in which the rod needs another trip, and those in which it is done."""
        zero = 0.0 * rod.total
        updating, done = variable((zero > 1.0,)), variable((zero > 1.0,))
        if ti.static(self.updates_in_steps):
            stiffness, change = rod.contacts.stiffness, self.gap_change(rod)
            updated = rod.contacts.update_stiffness > 0.0
            choose(rod.contacts, updated, change=change)
            within = updated & (change <= rod.contacts.tolerance)
            if ti.static(self.bits == 32):  # in f64 another step makes forces far more exact
                done = (within & rests,)
            last = within & ~done[0]
            choose(rod.contacts, last, phase=zero + FINE)
            choose(lane, updated, best=zero + 1e30, idle_trips=zero, aimless=zero)
            updates = ready & ~self.is_fine(rod) & ~done[0] & (rod.contacts.updates < MOST_TRIES)
            rod.contacts.update_stiffness = ti.select(updates, stiffness, zero)
            choose(rod.contacts, updates, updates=rod.contacts.updates + 1.0)
            stiffer = ti.max(stiffness, STIFFER * rod.contacts.first_stiffness)
            choose(rod.contacts, updates, stiffness=stiffer)
            updating = (updates | last,)
        return updating[0], done[0]

    def update_forces(self, rod, due):
        """End a round in the lanes that are ``due`` with new forces. Returns the largest change of a gap that they mean."""
        zero = 0.0 * rod.total
        stiffness = rod.contacts.stiffness
        found = record(change=zero, largest=zero, rubbed=zero, slipping=zero, slipped=zero)
        for v in range(rod.edges + 1):
            at = self.vertex(rod, v)
            for o in range(rod.obstacles):
                contact = self.contact(at, o)
                self.update_vertex(rod, contact, due, found)
                if self.is_close(rod, contact) or self.is_edge_close(rod, v, o):
                    if self.is_curved(rod, o):
                        self.update_edge(rod, v, o, contact, due, found)
                else:  # in no lane a vertex, or the edge that ends there, is close
                    self.note_change(found, contact.force_between, zero)
                    choose(contact, due, force_between=zero, kept_between=zero)
                    contact.sagging = zero
                if ti.static(self.rub):
                    self.update_friction(rod, v, o, due, found)
        if ti.static(self.itself):
            self.update_pairs(rod, due, found)
        change = ti.select(due, found.change / stiffness, zero)
        # Friction, which settles no sooner with a larger κ, does not count.
        slow = due & (change > SLOW * rod.contacts.change) & (change > rod.contacts.tolerance)
        slow = slow & (stiffness < STIFFEST * rod.contacts.first_stiffness)
        choose(rod.contacts, due, largest=found.largest, change=change)
        choose(rod.contacts, slow, stiffness=STIFFER * stiffness)
        self.tighten(rod, due)
        # Forces along a capstan change one after the other: in the final rounds, all that slips together may hardly do so,
        # but for turns to and fro, which further rounds need not end.
        within = ti.max(found.slipping / (SOFT * rod.contacts.radius), FAINT * rod.contacts.first_stiffness)
        turns = found.slipped * rod.contacts.slipped < 0.0 - SLOW * rod.contacts.slipped ** 2
        slipped = ti.select(self.is_fine(rod) & ~turns, absolute(found.slipped) / within, zero)
        choose(rod.contacts, due, slipped=found.slipped)
        return largest_of(change, ti.select(due, ti.max(found.rubbed / stiffness, slipped), zero))

    def jammed(self, rod):
        """The lanes in which forces have grown beyond all bounds: no place that the rod can get to is outside the obstacles."""
        return rod.contacts.largest > STIFFEST * rod.contacts.first_stiffness * rod.contacts.radius

    def soften(self, rod, where):
        """Make κ smaller, down to the first or to what gives way by a radius under the largest force, in the lanes ``where`` a
        step was refused, unless the rod is deep (:meth:`stiffen`); returns those in which it had grown."""
        stiffness, radius = rod.contacts.stiffness, rod.contacts.radius
        least = ti.max(rod.contacts.first_stiffness, rod.contacts.largest / radius)
        softer = where & (stiffness > least) & (rod.contacts.least_gap >= 0.0 - radius)
        choose(rod.contacts, softer, stiffness=ti.max(stiffness / STIFFER, least))
        return softer

    def stiffen(self, rod, where):
        """A larger κ in the lanes ``where`` a step was refused and the rod is deeper than its radius inside an obstacle: forces
        that draw it through are larger than those that κ was chosen for."""
        stiffness, radius = rod.contacts.stiffness, rod.contacts.radius
        deep = where & (rod.contacts.least_gap < 0.0 - radius) & (stiffness < STIFFEST * rod.contacts.first_stiffness)
        choose(rod.contacts, deep, stiffness=STIFFER * stiffness)

    def update_vertex(self, rod, contact, due, found):
        """The new force of the contact of a vertex."""
        old = contact.force
        new = self.updated_force(rod, old, contact.value - rod.contacts.radius)
        self.note_change(found, old, new)
        contact.force = ti.select(due, new, old)

    def update_edge(self, rod, index, o, contact, due, found):
        """The new force of the contact of the edge to vertex ``index``; none ends at vertex 0."""
        zero = 0.0 * rod.total
        old = contact.force_between
        # Where the edge does not bridge the obstacle its nearest point is not known.
        known = ((contact.acts_between > 0.0) | (contact.sagging > 0.0)) & (index > 0)
        gap = ti.select(known, contact.value_between - rod.contacts.radius, zero + 1e6)  # far off: no force
        new, begun = self.update_between(rod, index, o, due, gap, self.updated_force(rod, old, gap))
        found.change = largest_of(found.change, begun)
        self.note_change(found, old, new)
        contact.force_between = ti.select(due, new, old)

    def updated_force(self, rod, old, gap):
        """max(0, λ − κ g)."""
        return ti.max(old - rod.contacts.stiffness * gap, 0.0 * gap)

    def note_change(self, found, old, new):
        """Take the change of a contact's force into ``found``."""
        found.change = largest_of(found.change, absolute(new - old))
        found.largest = largest_of(found.largest, new)

    def tighten(self, rod, where):
        """Make κ so large that it gives way by no more than a part of the radius under the largest force."""
        least = rod.contacts.largest / (PRESSED_IN * rod.contacts.radius)
        choose(rod.contacts, where, stiffness=ti.max(rod.contacts.stiffness, least))

    def update_between(self, rod, index, o, due, gap, force):
        """Decide whether the nearest point of an edge is a contact in the next round: as long as it is nearer than both ends.
        Where it no longer is one its force goes to the nearer end. Returns its force, and κ times its depth where it has just
        become one."""
        zero = 0.0 * gap
        contact = self.contact(self.vertex(rod, index), o)
        kept = contact.kept_between
        # A larger threshold to begin than to end: with one for both, rounds could take it in and leave it out by turns.
        least = ti.select(kept > 0.5, zero, 0.5 * rod.contacts.tolerance)
        sags = (contact.sagging > least) & (index > 0)
        lost = due & (kept > 0.5) & ~sags
        if self.some(lost, zero):
            later = contact.place_between > 0.5
            given = ti.select(lost, force, zero)
            add(contact, force=ti.select(later, given, zero))
            add(self.contact(self.vertex(rod, index - 1), o), force=ti.select(later, zero, given))
        begun = ti.select(sags & (kept < 0.5), ti.max(rod.contacts.stiffness * (0.0 - gap), zero), zero)
        contact.kept_between = ti.select(due, ti.select(sags, zero + 1.0, zero), kept)
        return ti.select(sags, force, zero), begun

    def update_friction(self, rod, index, o, due, found):
        """New friction on a vertex and on the edge that ends there, under the new forces."""
        zero = 0.0 * rod.total
        at = self.vertex(rod, index)
        contact = self.contact(at, o)
        close = self.close_lanes(rod, contact.value)
        if self.some(close | (contact.force > 0.0), zero):
            self.keep_friction(contact.of("friction"), self.rubbed_vertex(rod, o, at, contact), due, found)
            choose(contact, due & close, rubbed_normal=contact.normal)
        else:
            choose(contact, due, friction=repeated(zero, 3))
        kept = contact.kept_between > 0.5
        if index > 0 and self.some(kept, zero):
            rubbed = self.rubbed_between(rod, o, index, contact)
            choose(rubbed, ~kept, pull=repeated(zero, 3), slips=zero)
            self.keep_friction(contact.of("friction_between"), rubbed, due, found)
            choose(contact, due & kept, rubbed_normal_between=contact.normal_between, rubbed_place=contact.place_between)
        else:
            choose(contact, due, friction_between=repeated(zero, 3))

    def keep_friction(self, friction, rubbed, due, found):
        """Store a ``friction`` in the lanes that are ``due``: its change to ``found`` and, where it ``slips``, its size."""
        old = friction.value
        change = minus(rubbed.pull, old)
        found.rubbed = largest_of(found.rubbed, ti.sqrt(dot(change, change)))
        found.slipping = found.slipping + rubbed.slips
        found.slipped = found.slipped + ti.select(rubbed.slips > 0.0, rubbed.slips - ti.sqrt(dot(old, old)), 0.0 * rubbed.slips)
        choose(friction, due, value=rubbed.pull)
