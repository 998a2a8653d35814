"""Steps that cross nothing, and the rounds of contact forces (docs/contact.md)."""

import taichi as ti

from doo_ti.physics.algebra import absolute, largest_of
from doo_ti.physics.tuples import choose, chosen, dot, minus, plus, record, repeated, scaled, variable
from doo_ti.relaxation.contact_energy import ContactEnergy
from doo_ti.relaxation.contact_layout import (
    ACTIVE,
    ALMOST,
    ALMOST_STIFFER,
    APPROACH,
    BARRIER,
    CHANGE,
    CLOSEST,
    DEEP,
    EARLY,
    EARLY_STIFFER,
    EXPECTED,
    EXPECTING,
    FINE,
    FIRST_STIFFNESS,
    FOLLOWED,
    FORCE,
    FORCE_BETWEEN,
    FRICTION,
    FRICTION_BETWEEN,
    HOPELESS,
    HOPELESS_32,
    LARGEST,
    LEAST_OFFSET,
    LOADED,
    MOST_EARLY,
    NEAR_ENOUGH,
    NORMAL,
    NORMAL_BETWEEN,
    OFFSET,
    OPEN,
    PHASE,
    PLACE,
    PLACE_BETWEEN,
    RADIUS,
    ROOM,
    ROOM_STANDING,
    ROUGH,
    ROUGHER,
    ROUGHEST,
    RUBBED_NORMAL,
    RUBBED_NORMAL_BETWEEN,
    RUBBED_PLACE,
    SAGGING,
    SECANT,
    SETTLING,
    SLACK,
    SLACK_OF_SHARP,
    SLOW,
    SOFTEST,
    STAGE,
    STAGES,
    STANDING,
    STIFFER,
    STIFFEST,
    STIFFNESS,
    STRENGTH,
    TIGHT,
    TOLERANCE,
    VALUE,
    VALUE_BETWEEN,
    WEAKER,
    WEIGHT,
)


@ti.data_oriented
class ContactRounds(ContactEnergy):
    """The contacts with their steps and their rounds."""

    # --- steps ---

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
        self.restore_pairs(rod, lost)

    @ti.func
    def approach(self, rod, index, before, move):
        """By how much a step is too large for one that may be taken whole: the square of its share of a vertex's way to the
        middle of an obstacle, or of the gap there and on the edge that ends there, whose start makes the step ``before``."""
        zero = 0.0 * move[0]
        at = self.vertex(rod, index)
        behind = self.behind(rod)
        radius = self.item(rod, RADIUS)
        floor = ti.select(behind, zero - 1e30, zero)
        most = zero
        if self.is_any_close(rod, at) or (index > 0 and self.is_any_close(rod, self.vertex(rod, index - 1))):
            for o in range(rod.obstacles):
                contact = self.contact(at, o)
                value = rod.scratch[contact + VALUE * self.stride]
                slack = ti.select(self.is_sharp(rod, o), SLACK_OF_SHARP, SLACK) * radius
                slack = ti.select(behind, self.item(rod, OFFSET), slack)
                if self.is_close(rod, contact):
                    gap = ti.max(value - radius, floor) + slack
                    normal = self.load3(rod.scratch, contact + NORMAL * self.stride)
                    share = (0.0 - APPROACH) * dot(normal, move) / ti.max(gap, 1e-6 * radius)
                    most = ti.select(self.close_lanes(rod, value), ti.max(most, share), most)
                if self.is_curved(rod, o) and self.is_edge_close(rod, index, o):
                    weight = rod.scratch[contact + WEIGHT * self.stride]
                    s = rod.scratch[contact + PLACE_BETWEEN * self.stride]
                    between = plus(before, scaled(minus(move, before), s))
                    gap = ti.max(rod.scratch[contact + VALUE_BETWEEN * self.stride] - radius, floor) + slack
                    away = self.load3(rod.scratch, contact + NORMAL_BETWEEN * self.stride)
                    share = (0.0 - APPROACH) * dot(away, between) / ti.max(gap, 1e-6 * radius)
                    most = ti.select(weight > 0.0, ti.max(most, share), most)
        return ti.max(dot(move, move) * self.nearness(rod, index, at), most * most)

    # --- rounds ---

    @ti.func
    def tolerance(self, rod, given):
        """The residual that a rod is to reach where ``given`` is that of one without contact: more while its rounds are rough,
        and at least what rounding of places makes of the forces."""
        rough = ti.select(self.behind(rod), 0.0 * given + ROUGHEST, 0.0 * given + ROUGHER)
        return self.final_tolerance(rod, ti.select(self.settled(rod), given, ti.max(given, rough)))

    @ti.func
    def final_tolerance(self, rod, given):
        """That of a rod in its final rounds."""
        return given + self.rounding * self.item(rod, STIFFNESS) * rod.longest * rod.total * rod.total

    @ti.func
    def settled(self, rod):
        """The lanes whose rods are in their final rounds."""
        return self.item(rod, PHASE) < ti.static(0.5 * (ROUGH + FINE))

    @ti.func
    def shows_saddles(self, rod):
        """The lanes in which a wrong inertia at rest means a saddle: in the final rounds, and wherever the last round has left
        a gap open. A straight rod that is pushed end-on against a wall never closes its gap before it bends."""
        change = self.item(rod, CHANGE)
        return self.settled(rod) | ((change > OPEN * self.item(rod, RADIUS)) & (change < 1e29))

    @ti.func
    def enter(self, rod, fresh, pushed):
        """Begin with the barrier where a rod has just been loaded, or was ``pushed`` into it by a step that nothing judged, its
        gaps larger by so much that it is within; returns the lanes where they are."""
        radius = self.item(rod, RADIUS)
        needed = LEAST_OFFSET * radius - self.item(rod, CLOSEST)
        loaded = fresh & (self.item(rod, PHASE) > ti.static(0.5 * (LOADED + BARRIER)))
        further = pushed & self.behind(rod) & (needed > self.item(rod, OFFSET))
        self.set_item(rod, OFFSET, loaded | further, ti.max(needed, 0.0 * radius))
        self.set_item(rod, PHASE, loaded, 0.0 * radius + BARRIER)
        return loaded | further

    @ti.func
    def end_round(self, rod, lane, calm, rests, entered):
        """End a round where a lane's rod ``rests`` under the forces of its contacts or, while these still change, is ``calm``
        to a rougher tolerance; returns the lanes in which another round follows, those that have ``entered`` one included."""
        zero = 0.0 * rod.total
        settled = self.settled(rod)
        due = (rests | (calm & ~settled)) & (lane.active > 0.5)
        again = due | entered
        behind = self.behind(rod)
        if self.some(due, zero):
            close = self.settle(rod, due) <= self.item(rod, TOLERANCE)
            self.set_item(rod, PHASE, due & close & ~behind, zero + FINE)
            again = entered | (due & ~(close & settled))
        # The next trip evaluates the rod where it is, under the new forces.
        choose(lane, again, trying=zero, closing=zero, escaping=zero, step_scale=zero, best=zero + 1e30, idle_trips=zero,
               aimless=zero, returned=zero)
        return again

    @ti.func
    def settle_early(self, rod, lane, ready, rests):
        """Let the next step settle forces in the lanes that are ``ready`` and whose rounds are rough: forces then change as
        soon as the step has moved the rod, so that no trip only evaluates the rod under new forces. Where the forces that this
        step settled changed by no more than the tolerance, the rod is done if it ``rests`` under them, else the final rounds
        begin. Returns the lanes of both kinds in which the rod needs another trip, and those in which it is done."""
        zero = 0.0 * rod.total
        early, done = variable((zero > 1.0,)), variable((zero > 1.0,))
        if ti.static(self.settles_early):
            stiffness, change, radius = self.item(rod, STIFFNESS), self.settled_gap(rod), self.item(rod, RADIUS)
            settled = self.item(rod, SETTLING) > 0.0
            # The rod has not followed its forces, and might never if they changed again at once.
            lagging = settled & (lane.residual * rod.total > ROUGHER) & (change > FOLLOWED * self.item(rod, CHANGE))
            self.set_item(rod, CHANGE, settled, change)
            within = settled & (change <= self.item(rod, TOLERANCE))
            if ti.static(self.bits == 32):  # in f64 another step makes forces far more exact
                done = (within & rests,)
            last = within & ~done[0]
            self.set_item(rod, PHASE, last, zero + FINE)
            choose(lane, settled, best=zero + 1e30, idle_trips=zero, aimless=zero)
            rough = ~self.behind(rod) & ~self.settled(rod)
            settles = ready & rough & ~done[0] & ~lagging & (self.item(rod, EARLY) < MOST_EARLY)
            rod.scratch[rod.contacts + SETTLING * self.stride] = ti.select(settles, stiffness, zero)
            self.set_item(rod, EARLY, settles, self.item(rod, EARLY) + 1.0)
            stiffer = zero + EARLY_STIFFER
            if ti.static(self.bits == 64):  # in f32 so large a κ would make rounding large
                stiffer = ti.select(settled & (change < ALMOST * radius), zero + ALMOST_STIFFER, stiffer)
            # Deep in an obstacle a much larger κ would throw the rod out of it.
            depth = ti.max(0.0 - self.item(rod, CLOSEST), 1e-3 * radius)
            larger = ti.min(stiffer * self.item(rod, FIRST_STIFFNESS), DEEP * radius / depth * stiffness)
            self.set_item(rod, STIFFNESS, settles, ti.max(stiffness, larger))
            early = (settles | last,)
        return early[0], done[0]

    @ti.func
    def settle(self, rod, due):
        """End a round in the lanes that are ``due`` with new forces, or the barrier with those it exerts. Returns the largest
        change of a gap that they mean."""
        zero = 0.0 * rod.total
        radius, stiffness, behind = self.item(rod, RADIUS), self.item(rod, STIFFNESS), self.behind(rod)
        # Friction settles no sooner with a larger κ.
        found = record(change=zero, secant=zero, largest=zero, rubbed=zero)
        for v in range(rod.edges + 1):
            at = self.vertex(rod, v)
            for o in range(rod.obstacles):
                contact = self.contact(at, o)
                if self.is_close(rod, contact) or self.is_edge_close(rod, v, o):
                    self.settle_vertex(rod, contact, due, found)
                    if self.is_curved(rod, o):
                        self.settle_edge(rod, v, o, contact, due, found)
                else:
                    self.settle_far(rod, contact, due, found)
                if ti.static(self.rub):
                    found.rubbed = largest_of(found.rubbed, self.settle_friction(rod, v, o, due))
        self.settle_pairs(rod, due, found)
        change = ti.select(due & ~behind, found.change / stiffness, zero)
        slow = due & ~behind & (change > SLOW * self.item(rod, CHANGE)) & (change > self.item(rod, TOLERANCE))
        slow = slow & (stiffness < STIFFEST * self.item(rod, FIRST_STIFFNESS))
        self.set_item(rod, LARGEST, due, found.largest)
        self.set_item(rod, STIFFNESS, slow, STIFFER * stiffness)
        self.tighten(rod, due & ~behind)
        self.set_item(rod, CHANGE, due & ~behind, change)
        nearest = self.item(rod, CLOSEST) + self.item(rod, OFFSET)
        last = due & behind & ((self.item(rod, STAGE) > STAGES - 1.5) | (nearest < NEAR_ENOUGH * radius))
        stiffer = ti.max(SECANT * found.secant, self.item(rod, FIRST_STIFFNESS))
        for item in ti.static((STIFFNESS, FIRST_STIFFNESS)):
            self.set_item(rod, item, last & (found.secant > 0.0), stiffer)
        self.set_item(rod, PHASE, last, zero + ROUGH)
        self.set_item(rod, STRENGTH, due & behind & ~last, WEAKER * self.item(rod, STRENGTH))
        self.set_item(rod, STAGE, due & behind, 1.0 + self.item(rod, STAGE))
        return largest_of(change, ti.select(due & ~behind, found.rubbed / stiffness, zero))

    @ti.func
    def expected(self, rod):
        """The lanes in which the derivatives have a contact that does not push (:meth:`.ContactEnergy.expect`)."""
        return self.item(rod, EXPECTED) > 0.5

    @ti.func
    def note_refused(self, rod, where):
        """Have the next trip expect contacts in the lanes ``where`` a step was refused, and no others."""
        zero = 0.0 * rod.total
        rod.scratch[rod.contacts + EXPECTING * self.stride] = ti.select(where & ~self.behind(rod), zero + 1.0, zero)

    @ti.func
    def jammed(self, rod):
        """The lanes in which forces have grown beyond all bounds: no place that the rod can get to is outside the obstacles."""
        most = ti.static(HOPELESS_32 if self.bits == 32 else HOPELESS)
        return self.item(rod, LARGEST) > most * self.item(rod, FIRST_STIFFNESS) * self.item(rod, RADIUS)

    @ti.func
    def soften(self, rod, where):
        """Make κ smaller, down to the first or to what bears the forces, in the lanes ``where`` a step was refused; returns
        those in which it had grown."""
        stiffness = self.item(rod, STIFFNESS)
        least = ti.max(self.item(rod, FIRST_STIFFNESS), self.bearing(rod, SOFTEST))
        softer = where & ~self.behind(rod) & (stiffness > least)
        self.set_item(rod, STIFFNESS, softer, ti.max(stiffness / STIFFER, least))
        return softer

    @ti.func
    def settle_vertex(self, rod, contact, due, found):
        """The new force of the contact of a vertex."""
        old = rod.scratch[contact + FORCE * self.stride]
        gap = rod.scratch[contact + VALUE * self.stride] - self.item(rod, RADIUS)
        new = self.settled_force(rod, old, gap)
        self.note_force(rod, found, gap, old, new)
        rod.scratch[contact + FORCE * self.stride] = ti.select(due, new, old)

    @ti.func
    def settle_edge(self, rod, index, o, contact, due, found):
        """That of the edge to vertex ``index``; none ends at vertex 0."""
        zero = 0.0 * rod.total
        old = rod.scratch[contact + FORCE_BETWEEN * self.stride]
        # Where the edge does not bridge the obstacle its nearest point is not known.
        sagging, weight = rod.scratch[contact + SAGGING * self.stride], rod.scratch[contact + WEIGHT * self.stride]
        known = ((weight > 0.0) | (sagging > 0.0)) & (index > 0)
        gap = ti.select(known, rod.scratch[contact + VALUE_BETWEEN * self.stride] - self.item(rod, RADIUS), zero + 1e6)
        new, late = self.settle_between(rod, index, o, due, gap, self.settled_force(rod, old, gap))
        found.change = largest_of(found.change, ti.select(self.behind(rod), zero, late))
        self.note_force(rod, found, gap, old, new)
        rod.scratch[contact + FORCE_BETWEEN * self.stride] = ti.select(due, new, old)

    @ti.func
    def settled_force(self, rod, old, gap):
        """max(0, λ − κ g), or what the barrier exerts."""
        new = ti.max(old - self.item(rod, STIFFNESS) * gap, 0.0 * gap)
        if self.some_behind(rod):
            new = ti.select(self.behind(rod), self.barrier(rod, gap).push, new)
        return new

    @ti.func
    def settle_far(self, rod, contact, due, found):
        """New forces where neither a vertex nor the edge that ends there is close to the obstacle in any lane."""
        zero = 0.0 * rod.total
        ends, between = contact + FORCE * self.stride, contact + FORCE_BETWEEN * self.stride
        old, active = rod.scratch[ends], rod.scratch[contact + ACTIVE * self.stride]
        gap = rod.scratch[contact + VALUE * self.stride] - self.item(rod, RADIUS)
        new = ti.select(self.behind(rod), zero, ti.max(old - self.item(rod, STIFFNESS) * gap, zero))
        self.note_change(found, old, new)
        self.note_change(found, rod.scratch[between], zero)
        rod.scratch[ends] = ti.select(due, new, old)
        rod.scratch[between] = ti.select(due, zero, rod.scratch[between])
        rod.scratch[contact + ACTIVE * self.stride] = ti.select(due, zero, active)
        rod.scratch[contact + SAGGING * self.stride] = zero

    @ti.func
    def note_force(self, rod, found, gap, old, new):
        """Take the change of a contact's force, and what the barrier says about κ, into ``found``."""
        if self.some_behind(rod):
            least = 1e-3 * self.item(rod, RADIUS)
            found.secant = largest_of(found.secant, new / ti.max(gap + self.item(rod, OFFSET), least))
        self.note_change(found, old, new)

    @ti.func
    def note_change(self, found, old, new):
        """Take the change of a contact's force into ``found``."""
        found.change = largest_of(found.change, absolute(new - old))
        found.largest = largest_of(found.largest, new)

    @ti.func
    def tighten(self, rod, where):
        """Make κ so large that it gives way by no more than a part of the radius under the largest force."""
        self.set_item(rod, STIFFNESS, where, ti.max(self.item(rod, STIFFNESS), self.bearing(rod, TIGHT)))

    @ti.func
    def bearing(self, rod, share: ti.template()):
        """The κ that gives way by that share of the radius under the largest force."""
        return self.item(rod, LARGEST) / (share * self.item(rod, RADIUS))

    @ti.func
    def settle_between(self, rod, index, o, due, gap, force):
        """Whether the rounds that follow have the nearest point of an edge: as long as it is nearer than the ends. Returns its
        force, which otherwise goes to the nearer end, and what it should have been where they did not have it so far."""
        zero = 0.0 * gap
        contact = self.contact(self.vertex(rod, index), o)
        active = rod.scratch[contact + ACTIVE * self.stride]
        # Fewer changes than one threshold for both: rounds could take it in and leave it out by turns.
        least = ti.select(active > 0.5, zero, 0.5 * self.item(rod, TOLERANCE))
        sags = (rod.scratch[contact + SAGGING * self.stride] > least) & (index > 0)
        lost = due & (active > 0.5) & ~sags
        if self.some(lost, zero):
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
        close = self.close_lanes(rod, rod.scratch[contact + VALUE * self.stride])
        if self.some(close | (rod.scratch[contact + FORCE * self.stride] > 0.0), zero):
            across = self.load3(rod.scratch, contact + RUBBED_NORMAL * self.stride)
            friction = self.load3(rod.scratch, contact + FRICTION * self.stride)
            rubbed = self.rubbed(rod, self.limit(rod, o, contact, FORCE), friction, across, self.slid(rod, at, o))
            change = self.keep_friction(rod, contact + FRICTION * self.stride, rubbed.pull, due)
            now = self.load3(rod.scratch, contact + NORMAL * self.stride)
            self.store(rod.scratch, contact + RUBBED_NORMAL * self.stride, chosen(due & close, now, across))
        else:
            change = self.keep_friction(rod, contact + FRICTION * self.stride, repeated(zero, 3), due)
        active = rod.scratch[contact + ACTIVE * self.stride] > 0.5
        if index > 0 and self.some(active, zero):
            s, u = rod.scratch[contact + RUBBED_PLACE * self.stride], self.slid_between(rod, index, contact, o)
            away = self.load3(rod.scratch, contact + RUBBED_NORMAL_BETWEEN * self.stride)
            friction = self.load3(rod.scratch, contact + FRICTION_BETWEEN * self.stride)
            between = self.rubbed(rod, self.limit(rod, o, contact, FORCE_BETWEEN), friction, away, u)
            pull = chosen(active, between.pull, repeated(zero, 3))
            change = largest_of(change, self.keep_friction(rod, contact + FRICTION_BETWEEN * self.stride, pull, due))
            later = self.load3(rod.scratch, contact + NORMAL_BETWEEN * self.stride)
            place = rod.scratch[contact + PLACE_BETWEEN * self.stride]
            self.store(rod.scratch, contact + RUBBED_NORMAL_BETWEEN * self.stride, chosen(due & active, later, away))
            rod.scratch[contact + RUBBED_PLACE * self.stride] = ti.select(due & active, place, s)
        else:
            self.keep_friction(rod, contact + FRICTION_BETWEEN * self.stride, repeated(zero, 3), due)
        return change

    @ti.func
    def keep_friction(self, rod, at, pull, due):
        """Store a friction in the lanes that are ``due``: by how much it changes."""
        old = self.load3(rod.scratch, at)
        change = minus(pull, old)
        self.store(rod.scratch, at, chosen(due, pull, old))
        return ti.sqrt(dot(change, change))

    # --- of a rod that may also touch itself, :class:`doo_ti.relaxation.self_contacts.SelfContacts` ---

    @ti.func
    def stand_pairs(self, rod):
        """Keep the distances of edges from each other before a step."""

    @ti.func
    def restore_pairs(self, rod, lost):
        """Restore them in the lanes that reject the step."""

    @ti.func
    def settle_pairs(self, rod, due, found):
        """New forces between edges in the lanes that are ``due``: their largest change to ``found``."""
