"""Contact of a chain with obstacles: an augmented Lagrangian of the gaps (docs/contact.md).

The gap at a place x of the rod is g = φ(x) − r ≥ 0. With forces λ ≥ 0 that are known from the round before, Newton minimises

    E + Σ max(0, λ − κ g)² / 2κ,

and a round ends with λ ← max(0, λ − κ g). Rounds change nothing any more where every gap is closed or bears no force: there the
force is exact for any κ, and no rod is inside an obstacle by more than the tolerance.

Where a step was refused, most often because it met contacts that its derivatives did not have, the derivatives of the next one
have these contacts, (λ − κ g)²/2κ, though they do not push yet. Energy and residual have not.

A rod touches an obstacle at its vertices and, where an edge bridges it, at the point of the edge that is nearest to it. That
point moves along the edge with the step: φ* = min_s φ(x + s p) has the derivatives n and s n by x and by p, and second
derivatives lower than those at a fixed s by v vᵀ/φ_ss, v = (H p, n + s H p), φ_ss = pᵀH p, H = ∇∇φ.
"""

import taichi as ti

from doo_ti.contact.distance import outer
from doo_ti.physics.algebra import absolute, applied, full, largest_of
from doo_ti.physics.number import device_functions
from doo_ti.physics.tuples import add, choose, dot, minus, negated, plus, record, repeated, scaled, traced, variable
from doo_ti.relaxation.contact_places import ContactPlaces
from doo_ti.relaxation.contact_table import EVEN


@traced
def outer_product(a, b) -> tuple:
    """a bᵀ."""
    return tuple(x * y for x in a for y in b)


@device_functions
class ContactEnergy(ContactPlaces):
    """The energy of the contacts of the rods in a pack, in a motion with friction if they ``rub``.

    takes_met: a refused step is tried again with the contacts that it has met.
    """

    def __init__(self, number, has_grid: bool, rub: bool = False, moves: bool = False, takes_met: bool = False):
        super().__init__(number, has_grid, moves)
        self.rub, self.updates_in_steps, self.takes_met = rub, not rub, takes_met

    def touched(self, rod, index, start, end):
        """Sum up the derivatives of the energy of the contacts of vertex ``index``, at ``end``, and of the edge from ``start``
        to there. Returns two where the edge has some between its ends, one where only the vertex has some, else zero. Measures
        from ``start``; that from ``end`` must have been done before."""
        self.look(rod, index - 1, start)
        at, before = self.vertex(rod, index), self.vertex(rod, index - 1)
        at.room_standing = at.room
        least = ti.min(at.least, before.least)
        at.room = self.far_room(rod, least)
        some = 0
        if ti.static(self.rub):
            some = self.touched_by_all(rod, index, start, end)
        else:
            if self.is_any_close(rod, at) or self.is_any_close(rod, before):
                some = self.touched_by_all(rod, index, start, end)
        self.note_forces(rod, at, some)
        return some

    def far_room(self, rod, least):
        """The room of an edge that is not close to an obstacle, of whose ends the nearer is ``least`` from it: of the edge some
        place may be half its length nearer."""
        return least - ti.max(rod.contacts.radius, 0.5 * rod.longest)

    def touched_by_all(self, rod, index, start, end):
        """What :meth:`touched` sums up, obstacle by obstacle."""
        zero, some = 0.0 * end[0], 0
        at, before, edge = self.vertex(rod, index), self.vertex(rod, index - 1), minus(end, start)
        room = zero + 1e30
        rod.contacts.end = repeated(zero, 12)
        for o in range(rod.obstacles):
            contact, previous = self.contact(at, o), self.contact(before, o)
            if self.is_edge_close(rod, index, o):
                some = ti.max(some, 1)
                if self.is_close(rod, contact):
                    self.add_vertex(rod, o, contact)
                if self.is_curved(rod, o):
                    between, low = self.touched_between(rod, o, index, start, edge, some)
                    room = ti.min(room, low)
                    if between:
                        some = 2
                else:
                    # It is nowhere nearer to the obstacle than at its ends.
                    least = ti.min(previous.value, contact.value)
                    deep = least + self.obstacle(rod, o).depth
                    room = ti.min(room, ti.select(self.close_lanes(rod, least), deep, self.far_room(rod, least)))
            else:
                room = ti.min(room, self.far_room(rod, ti.min(previous.value, contact.value)))
            if ti.static(self.rub):
                # Friction stays as long as its round, however far the rod moves: without it the energy would jump.
                active = contact.kept_between > 0.5
                if self.some((contact.force > 0.0) | active, zero):
                    if some < 2:
                        self.clear_between(rod, zero)
                    some = 2
                    self.rub_vertex(rod, o, at, contact)
                    self.rub_between(rod, o, index, contact, active)
        at.room = room
        return some

    def touched_start(self, rod, index):
        """What :meth:`touched` sums up, of vertex ``index`` alone, where a rod begins."""
        at, zero, some = self.vertex(rod, index), 0.0 * rod.total, 0
        at.room_standing = at.room
        at.room = zero + 1e30
        rod.contacts.end = repeated(zero, 12)
        for o in range(rod.obstacles):
            contact = self.contact(at, o)
            value = contact.value
            if self.is_close(rod, contact):
                some = 1
                self.add_vertex(rod, o, contact)
            if ti.static(self.rub):
                if self.some(contact.force > 0.0, zero):
                    some = 1
                    self.rub_vertex(rod, o, at, contact)
            at.room = ti.min(at.room, value + self.obstacle(rod, o).depth)
        self.note_forces(rod, at, some)
        return some

    def clear_between(self, rod, zero):
        """Begin the sums over the contacts of an edge between its ends."""
        rod.contacts.between = repeated(zero, 27)
        if ti.static(self.updates_in_steps):
            rod.contacts.excesses = repeated(zero, 6)

    def known(self, whole, excess):
        """Of a gradient that sums up all pushes λ − κ g of an edge, the part of the forces λ that are known: the ``whole`` less
        the ``excess``, −κ g, of steps that update forces."""
        if ti.static(self.updates_in_steps):
            return minus(whole, excess)
        else:
            return whole

    def note_forces(self, rod, at, some):
        """Keep the forces on the ends of an edge, as :meth:`touched` found ``some``."""
        zero, own = 0.0 * rod.total, rod.contacts
        if some > 0 or at.lane(0).pushed > 0.5:
            on_end, on_start = variable(repeated(zero, 3)), variable(repeated(zero, 3))
            if some > 0:
                on_end = self.known(own.end_gradient, own.end_excess)
            if some > 1:
                between = self.known(own.gradient_s, own.excess_s)
                on_end, on_start = plus(on_end, between), minus(between, self.known(own.gradient, own.excess))
            at.force_end, at.force_start = negated(on_end), on_start
            at.lane(0).pushed = ti.select(some > 0, 1.0, 0.0)

    def take(self, rod, load, some):
        """Add the sums over the contacts of a vertex, and of the edge that ends there, to the derivatives of that edge's
        energy, as :meth:`touched` found ``some``."""
        own = rod.contacts
        if some > 0:
            whole, bent, known = own.end_gradient, own.end_curvatures, self.known(own.end_gradient, own.end_excess)
            add(load, known=known, known_s=known, gradient=whole, gradient_s=whole, curvature=bent, curvature_ss=bent,
                curvature_s=full(bent))
        if some > 1:
            add(load, known=self.known(own.gradient, own.excess), known_s=self.known(own.gradient_s, own.excess_s),
                gradient=own.gradient, gradient_s=own.gradient_s, curvature=own.curvatures, curvature_s=own.curvatures_s,
                curvature_ss=own.curvatures_ss)

    def touched_between(self, rod, o, index, start, edge, some):
        """The same of the edge between its ends, of which one is close to obstacle ``o`` in some lane: whether it has contacts
        there, and its room. ``some``: what was found so far."""
        zero, radius = 0.0 * start[0], rod.contacts.radius
        contact, previous = self.contact(self.vertex(rod, index), o), self.contact(self.vertex(rod, index - 1), o)
        value_start, value_end = previous.value, contact.value
        slope_start, slope_end = dot(previous.normal, edge) - EVEN * radius, dot(contact.normal, edge) + EVEN * radius
        # φ along an edge lies above its tangents at both ends, which meet here.
        meet = (value_end - value_start - slope_end) / ti.min(slope_start - slope_end, zero - 1e-20)
        bridging = (slope_start < 0.0) & (slope_end > 0.0)
        least = ti.min(value_start, value_end)
        low = ti.select(bridging, value_start + slope_start * meet, least)
        low = ti.max(low, 0.5 * (value_start + value_end - rod.longest))  # φ changes no faster than the place
        close = self.close_lanes(rod, least)
        depth = self.obstacle(rod, o).depth
        near = close & bridging & (low < 2.0 * radius)
        active = close & (contact.kept_between > 0.5)
        contact.acts_between, contact.sagging = zero, zero
        between = self.some(near | active, zero)
        if between:
            if some < 2:
                self.clear_between(rod, zero)
            seen = self.nearest(rod, o, index, start, edge, (slope_start, slope_end), near | active)
            sagging = ti.select(near, least - seen.value, zero)
            contact.sagging = sagging
            # Where rounds find an edge inside an obstacle between its ends, its nearest point counts from then on.
            active = active | ((sagging > zero) & (seen.value < radius))
            contact.kept_between = ti.select(active, zero + 1.0, contact.kept_between)
            self.add_between(rod, contact, edge, seen, active)
        return between, ti.select(close, low + depth, self.far_room(rod, least))

    def push(self, rod, force, gap):
        """(force, stiffness) of a contact whose λ is ``force``, and its energy."""
        stiffness = rod.contacts.stiffness
        push = ti.max(force - stiffness * gap, 0.0 * gap)
        acting = ti.select(push > 0.0, stiffness, 0.0 * gap)
        return record(push=push, stiffness=acting, energy=0.5 * push * push * rod.contacts.compliance)

    def add_vertex(self, rod, o, contact):
        """Add a contact of the vertex where the edge ends."""
        normal = contact.normal
        zero, close = 0.0 * rod.total, self.close_lanes(rod, contact.value)
        gap = contact.value - rod.contacts.radius
        self.update_now(rod, contact.of("force"), gap, close)
        pushed = self.push(rod, ti.select(close, contact.force, zero), gap)
        self.add_penalty(rod, pushed.energy, pushed.push * rod.total)
        self.take_met(rod, contact.of("pushes"), contact.force, gap, close, pushed)
        pull = scaled(normal, 0.0 - pushed.push)
        known = self.known_force(rod, contact.force, pushed.push)
        if ti.static(self.updates_in_steps):
            add(rod.contacts, end_excess=scaled(normal, known - pushed.push))
        add(rod.contacts, end_gradient=pull, end_curvatures=scaled(outer(normal), pushed.stiffness))
        if self.is_curved(rod, o):
            add(rod.contacts, end_curvatures=scaled(contact.curvature, 0.0 - known))

    def update_now(self, rod, force, gap, counts):
        """Where the contact ``counts`` and the step updates forces, its ``force`` λ becomes max(0, λ − κ g), κ that before."""
        if ti.static(self.updates_in_steps):
            stiffness, old = rod.contacts.update_stiffness, force.value
            updates = counts & (stiffness > 0.0)
            new = ti.select(updates, ti.max(old - stiffness * gap, 0.0 * gap), old)
            force.value = new
            rod.contacts.force_change = largest_of(rod.contacts.force_change, absolute(new - old))

    def gap_change(self, rod):
        """By how much the step changed a gap by updating forces, in the lanes where it did."""
        return rod.contacts.force_change / rod.contacts.update_stiffness

    def known_force(self, rod, updated, push):
        """The force of a contact in the residual and in the second derivatives of φ: in a step that updates forces the
        ``updated`` λ where the contact pushes at all; otherwise its whole ``push``, or none where it was only met. The
        difference, −κ g, only closes the gap."""
        known = variable((push,))
        if ti.static(self.updates_in_steps):
            known = (ti.select((rod.contacts.update_stiffness > 0.0) & (push > 0.0), updated, push),)
        if ti.static(self.takes_met):
            known = (ti.max(known[0], 0.0 * push),)
        return known[0]

    def take_met(self, rod, kept, force, gap, counts, pushed):
        """After a refused step, add to the derivatives a contact that pushed where the step ended and does not push now.
        ``kept``: where scratch notes whether it pushes, renewed here; ``pushed``: the result of :meth:`push`, changed here."""
        if ti.static(self.takes_met):
            zero, before = 0.0 * gap, kept.value
            pushes = counts & (pushed.push > 0.0)
            kept.value = ti.select(pushes, zero + 1.0, zero)
            if rod.contacts.lane(0).some_refused > 0.5:
                stiffness = rod.contacts.stiffness
                met = counts & ~pushes & (before > 0.5) & (rod.contacts.refused > 0.5)
                choose(pushed, met, push=force - stiffness * gap, stiffness=stiffness)
                choose(rod.contacts, met, has_met=zero + 1.0)

    def add_between(self, rod, contact, edge, seen, acts):
        """Add the contact at the nearest point of the edge in the lanes where it ``acts``; in others it may hold any number."""
        s, normal, zero = seen.s, seen.normal, 0.0 * seen.s
        contact.nearest_point = (s, seen.value) + normal + (ti.select(acts, zero + 1.0, zero),)
        gap = seen.value - rod.contacts.radius
        self.update_now(rod, contact.of("force_between"), gap, acts)
        pushed = self.push(rod, contact.force_between, gap)
        rod.contacts.least_gap = ti.min(rod.contacts.least_gap, ti.select(acts, gap, zero + 1e30))
        own = ti.select(acts, pushed.energy, zero)
        self.take_met(rod, contact.of("pushes_between"), contact.force_between, gap, acts, pushed)
        force, stiffness = ti.select(acts, pushed.push, zero), ti.select(acts, pushed.stiffness, zero)
        known = self.known_force(rod, contact.force_between, force)
        if ti.static(self.updates_in_steps):
            excess = scaled(normal, known - force)
            add(rod.contacts, excess=excess, excess_s=scaled(excess, s))
        self.add_penalty(rod, own, ti.max(force, zero) * rod.total)
        turned = applied(full(seen.curvature), edge)
        across = plus(normal, scaled(turned, s))
        slide = known / seen.bend
        fixed = minus(scaled(outer(normal), stiffness), scaled(seen.curvature, known))
        pull = scaled(normal, 0.0 - force)
        add(rod.contacts, gradient=pull, gradient_s=scaled(pull, s),
            curvatures=plus(fixed, scaled(outer(turned), slide)),
            curvatures_s=plus(scaled(full(fixed), s), scaled(outer_product(turned, across), slide)),
            curvatures_ss=plus(scaled(fixed, s * s), scaled(outer(across), slide)))
