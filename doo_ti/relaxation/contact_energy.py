"""Contact of a chain with obstacles: an augmented Lagrangian of the gaps, and a barrier (docs/contact.md).

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
from doo_ti.contact.obstacles import DEPTH
from doo_ti.contact.obstacles import FRICTION as COEFFICIENT
from doo_ti.physics.algebra import absolute, largest_of
from doo_ti.physics.tuples import applied, chosen, dot, full, minus, negated, plus, record, repeated, scaled, traced, variable
from doo_ti.relaxation.contact_layout import (
    ACTIVE,
    BARRIER,
    CLOSEST,
    COMPLIANCE,
    CURVATURE,
    CURVATURES,
    CURVATURES_S,
    CURVATURES_SS,
    END_CURVATURES,
    END_EXCESS,
    END_GRADIENT,
    EXCESS,
    EXCESS_S,
    EXPECTED,
    EXPECTING,
    FORCE,
    FORCE_BETWEEN,
    FORCE_END,
    FORCE_START,
    FRICTION,
    FRICTION_BETWEEN,
    GRADIENT,
    GRADIENT_S,
    HEAD,
    LEAST,
    LOADED,
    NORMAL,
    OFFSET,
    PHASE,
    PLACE_BETWEEN,
    PUSHED,
    PUSHES,
    PUSHES_BETWEEN,
    RADIUS,
    ROOM,
    ROOM_STANDING,
    ROUGH,
    RUBBED_NORMAL,
    RUBBED_NORMAL_BETWEEN,
    RUBBED_PLACE,
    SAG,
    SAGGING,
    SETTLED,
    SETTLING,
    SOME_EXPECTING,
    STIFFNESS,
    STRENGTH,
    VALUE,
    WALL,
    WEIGHT,
)
from doo_ti.relaxation.contact_places import ContactPlaces


@traced
def outer_product(a, b) -> tuple:
    """a bᵀ."""
    return tuple(x * y for x in a for y in b)


@ti.data_oriented
class ContactEnergy(ContactPlaces):
    """The energy of the contacts of the rods in a pack, in a motion with friction if they ``rub``. ``expects``: steps that are
    refused are tried again with the contacts they have met."""

    def __init__(self, number, stride: int, kinds: frozenset[int], rub: bool = False, moves: bool = False,
                 expects: bool = False):
        super().__init__(number, stride, kinds, moves)
        self.rub, self.first_phase, self.settles_early, self.expects = rub, ROUGH, not rub, expects

    @ti.func
    def touched(self, rod, index, start, end):
        """Sum up the derivatives of the energy of the contacts of vertex ``index``, at ``end``, and of the edge from ``start``
        to there. Returns two where the edge has some between its ends, one where only the vertex has some, else zero. Measures
        from ``start``; that from ``end`` must have been done before."""
        self.look(rod, index - 1, start)
        at, before = self.vertex(rod, index), self.vertex(rod, index - 1)
        rod.scratch[at + ROOM_STANDING * self.stride] = rod.scratch[at + ROOM * self.stride]
        least = ti.min(rod.scratch[at + LEAST * self.stride], rod.scratch[before + LEAST * self.stride])
        rod.scratch[at + ROOM * self.stride] = least - self.item(rod, RADIUS)
        some = 0
        if ti.static(self.rub):
            some = self.touched_by_all(rod, index, start, end)
        else:
            if self.is_any_close(rod, at) or self.is_any_close(rod, before):
                some = self.touched_by_all(rod, index, start, end)
        self.note_forces(rod, at, some)
        return some

    @ti.func
    def touched_by_all(self, rod, index, start, end):
        """The same, obstacle by obstacle."""
        zero, some = 0.0 * end[0], 0
        at, before, edge = self.vertex(rod, index), self.vertex(rod, index - 1), minus(end, start)
        room = zero + 1e30
        for o in range(rod.obstacles):
            contact, previous = self.contact(at, o), self.contact(before, o)
            if self.is_edge_close(rod, index, o):
                if some == 0:
                    self.clear(rod, zero)
                    some = 1
                if self.is_close(rod, contact):
                    self.add_vertex(rod, o, at, contact)
                if self.is_curved(rod, o):
                    between, low = self.touched_between(rod, o, index, start, edge, some)
                    room = ti.min(room, low)
                    if between:
                        some = 2
                else:
                    room = ti.min(room, self.room_beside(rod, o, contact, previous))
            else:
                value = ti.min(rod.scratch[previous + VALUE * self.stride], rod.scratch[contact + VALUE * self.stride])
                room = ti.min(room, value - self.item(rod, RADIUS))
            if ti.static(self.rub):
                # Friction stays as long as its round, however far the rod moves: without it the energy would jump.
                active = rod.scratch[contact + ACTIVE * self.stride] > 0.5
                if self.some((rod.scratch[contact + FORCE * self.stride] > 0.0) | active, zero):
                    if some == 0:
                        self.clear(rod, zero)
                    if some < 2:
                        self.clear_between(rod, zero)
                    some = 2
                    self.rub_vertex(rod, o, at, contact)
                    self.rub_between(rod, o, index, contact, active)
        rod.scratch[at + ROOM * self.stride] = room
        return some

    @ti.func
    def room_beside(self, rod, o, contact, previous):
        """The room of an edge that is nowhere nearer to obstacle ``o`` than at its ends."""
        least = ti.min(rod.scratch[previous + VALUE * self.stride], rod.scratch[contact + VALUE * self.stride])
        depth = rod.scratch[self.obstacle(rod, o) + DEPTH * self.stride]
        return ti.select(self.close_lanes(rod, least), least + depth, least - self.item(rod, RADIUS))

    @ti.func
    def touched_start(self, rod, index):
        """The same of vertex ``index`` alone, where a rod begins."""
        at, zero, some = self.vertex(rod, index), 0.0 * rod.total, 0
        rod.scratch[at + ROOM_STANDING * self.stride] = rod.scratch[at + ROOM * self.stride]
        rod.scratch[at + ROOM * self.stride] = zero + 1e30
        for o in range(rod.obstacles):
            contact = self.contact(at, o)
            value = rod.scratch[contact + VALUE * self.stride]
            if self.is_close(rod, contact):
                if some == 0:
                    self.clear(rod, zero)
                    some = 1
                self.add_vertex(rod, o, at, contact)
            if ti.static(self.rub):
                if self.some(rod.scratch[contact + FORCE * self.stride] > 0.0, zero):
                    if some == 0:
                        self.clear(rod, zero)
                        some = 1
                    self.rub_vertex(rod, o, at, contact)
            self.lower(rod.scratch, at + ROOM * self.stride, value + rod.scratch[self.obstacle(rod, o) + DEPTH * self.stride])
        self.note_forces(rod, at, some)
        return some

    @ti.func
    def clear(self, rod, zero):
        """Begin the sums over the contacts of a vertex."""
        for k in ti.static(range(HEAD - END_GRADIENT)):
            rod.scratch[rod.contacts + (END_GRADIENT + k) * self.stride] = zero

    @ti.func
    def clear_between(self, rod, zero):
        """Begin the sums over the contacts of an edge between its ends."""
        for k in ti.static(range(EXCESS - GRADIENT)):
            rod.scratch[rod.contacts + (GRADIENT + k) * self.stride] = zero
        if ti.static(self.settles_early):
            self.store(rod.scratch, rod.contacts + EXCESS * self.stride, repeated(zero, 6))

    @ti.func
    def vector(self, rod, item: ti.template()):
        """Three sums of an edge."""
        return self.load3(rod.scratch, rod.contacts + item * self.stride)

    @ti.func
    def known(self, rod, item: ti.template(), excess: ti.template()):
        """Three sums of an edge, of the forces that are known."""
        whole = self.vector(rod, item)
        if ti.static(self.settles_early):
            return minus(whole, self.vector(rod, excess))
        else:
            return whole

    @ti.func
    def symmetric(self, rod, item: ti.template()):
        """Six of them."""
        return self.vector(rod, item) + self.vector(rod, item + 3)

    @ti.func
    def matrix(self, rod, item: ti.template()):
        """Nine of them."""
        return self.symmetric(rod, item) + self.vector(rod, item + 6)

    @ti.func
    def note_forces(self, rod, at, some):
        """Keep the forces on the ends of an edge, as :meth:`touched` found ``some``."""
        zero = 0.0 * rod.total
        if some > 0 or self.get(rod.scratch, at + PUSHED * self.stride, 0) > 0.5:
            late, early = variable(repeated(zero, 3)), variable(repeated(zero, 3))
            if some > 0:
                late = self.known(rod, END_GRADIENT, END_EXCESS)
            if some > 1:
                between = self.known(rod, GRADIENT_S, EXCESS_S)
                late, early = plus(late, between), minus(between, self.known(rod, GRADIENT, EXCESS))
            self.store(rod.scratch, at + FORCE_END * self.stride, negated(late))
            self.store(rod.scratch, at + FORCE_START * self.stride, early)
            self.put(rod.scratch, at + PUSHED * self.stride, 0, ti.select(some > 0, 1.0, 0.0))

    @ti.func
    def take_vertex(self, rod, load):
        """Add the sums over the contacts of a vertex to the derivatives of an edge's energy."""
        whole, known = self.vector(rod, END_GRADIENT), self.known(rod, END_GRADIENT, END_EXCESS)
        bent = self.symmetric(rod, END_CURVATURES)
        load.known = plus(load.known, known)
        load.known_s = plus(load.known_s, known)
        load.gradient = plus(load.gradient, whole)
        load.gradient_s = plus(load.gradient_s, whole)
        load.curvature = plus(load.curvature, bent)
        load.curvature_ss = plus(load.curvature_ss, bent)
        load.curvature_s = plus(load.curvature_s, full(bent))

    @ti.func
    def take_between(self, rod, load):
        """Add those of the edge between its ends."""
        load.known = plus(load.known, self.known(rod, GRADIENT, EXCESS))
        load.known_s = plus(load.known_s, self.known(rod, GRADIENT_S, EXCESS_S))
        load.gradient = plus(load.gradient, self.vector(rod, GRADIENT))
        load.gradient_s = plus(load.gradient_s, self.vector(rod, GRADIENT_S))
        load.curvature = plus(load.curvature, self.symmetric(rod, CURVATURES))
        load.curvature_s = plus(load.curvature_s, self.matrix(rod, CURVATURES_S))
        load.curvature_ss = plus(load.curvature_ss, self.symmetric(rod, CURVATURES_SS))

    @ti.func
    def touched_between(self, rod, o, index, start, edge, some):
        """The same of the edge between its ends, of which one is close to obstacle ``o`` in some lane: whether it has contacts
        there, and its room. ``some``: what was found so far."""
        zero, radius = 0.0 * start[0], self.item(rod, RADIUS)
        contact, previous = self.contact(self.vertex(rod, index), o), self.contact(self.vertex(rod, index - 1), o)
        normal_start = self.load3(rod.scratch, previous + NORMAL * self.stride)
        normal_end = self.load3(rod.scratch, contact + NORMAL * self.stride)
        value_start, value_end = rod.scratch[previous + VALUE * self.stride], rod.scratch[contact + VALUE * self.stride]
        slope_start, slope_end = dot(normal_start, edge), dot(normal_end, edge)
        # φ along an edge lies above its tangents at both ends, which meet here.
        meet = (value_end - value_start - slope_end) / ti.min(slope_start - slope_end, zero - 1e-20)
        bridging = (slope_start < 0.0) & (slope_end > 0.0)
        least = ti.min(value_start, value_end)
        low = ti.select(bridging, value_start + slope_start * meet, least)
        low = ti.max(low, 0.5 * (value_start + value_end - rod.longest))  # φ changes no faster than the place
        close = self.close_lanes(rod, least)
        depth = rod.scratch[self.obstacle(rod, o) + DEPTH * self.stride]
        near = close & bridging & (low < 2.0 * radius)
        active = close & (rod.scratch[contact + ACTIVE * self.stride] > 0.5)
        rod.scratch[contact + WEIGHT * self.stride] = zero
        rod.scratch[contact + SAGGING * self.stride] = zero
        between = self.some(near | active, zero)
        if between:
            if some < 2:
                self.clear_between(rod, zero)
            seen = self.nearest(rod, o, index, start, edge, (slope_start, slope_end), near | active)
            lower = value_start < value_end
            sagging = ti.select(near, least - seen.value, zero)
            rod.scratch[contact + SAGGING * self.stride] = sagging
            sag = ti.max(sagging / (SAG * radius), zero)
            behind = self.behind(rod)
            # Where rounds find an edge inside an obstacle between its ends, its nearest point counts from then on.
            active = active | ((sagging > zero) & (seen.value < radius) & ~behind)
            known = rod.scratch[contact + ACTIVE * self.stride]
            rod.scratch[contact + ACTIVE * self.stride] = ti.select(active, zero + 1.0, known)
            fading = ti.select(behind & near, 2.0 * sag / ((1.0 + sag * sag) * (1.0 + sag * sag) * SAG * radius), zero)
            share = record(
                weight=ti.select(behind, sag * sag / (1.0 + sag * sag), ti.select(active, zero + 1.0, zero)),
                slope=fading, s=ti.select(lower, zero, zero + 1.0), normal=chosen(lower, normal_start, normal_end))
            self.add_between(rod, contact, edge, seen, share)
        return between, ti.select(close, low + depth, least - radius)

    @ti.func
    def push(self, rod, force, gap):
        """(force, stiffness) of a contact whose λ is ``force``, and its energy."""
        stiffness = self.item(rod, STIFFNESS)
        push = ti.max(force - stiffness * gap, 0.0 * gap)
        acting = ti.select(push > 0.0, stiffness, 0.0 * gap)
        energy = 0.5 * push * push * self.item(rod, COMPLIANCE)
        if self.some_behind(rod):
            behind = self.behind(rod)
            wall = self.barrier(rod, gap)
            push, acting = ti.select(behind, wall.push, push), ti.select(behind, wall.stiffness, acting)
            energy = ti.select(behind, wall.energy, energy)
        return record(push=push, stiffness=acting, energy=energy)

    @ti.func
    def barrier(self, rod, gap):
        """A barrier μ (1 − x)³/x in x, the gap over the radius, where that is below one: its energy, force and stiffness. It
        does not act on rods that have just been loaded."""
        zero = 0.0 * gap
        radius = self.item(rod, RADIUS)
        x = (gap + self.item(rod, OFFSET)) / radius
        inside = (x < 1.0) & (self.item(rod, PHASE) < ti.static(0.5 * (LOADED + BARRIER)))
        strength = ti.select(inside, self.item(rod, STRENGTH), zero)
        inverse, rest = 1.0 / ti.max(x, zero + 1e-3), 1.0 - x
        first = rest * rest * inverse
        second = first * rest * inverse
        stiffness = 6.0 * rest * inverse + 6.0 * first * inverse + 2.0 * second * inverse
        return record(energy=ti.select(inside & (x <= 1e-3), zero + 2.0 * WALL, strength * first * rest),
                      push=strength * (3.0 * first + second) / radius, stiffness=strength * stiffness / (radius * radius))

    @ti.func
    def add_vertex(self, rod, o, at, contact):
        """Add a contact of the vertex where the edge ends."""
        normal = self.load3(rod.scratch, contact + NORMAL * self.stride)
        value, zero = rod.scratch[contact + VALUE * self.stride], 0.0 * rod.total
        close = self.close_lanes(rod, value)
        self.settle_now(rod, contact + FORCE * self.stride, value - self.item(rod, RADIUS), close)
        pushed = self.push(rod, ti.select(close, rod.scratch[contact + FORCE * self.stride], zero),
                           value - self.item(rod, RADIUS))
        self.add_penalty(rod, pushed.energy, pushed.push * rod.total)
        self.expect(rod, contact + PUSHES * self.stride, rod.scratch[contact + FORCE * self.stride],
                    value - self.item(rod, RADIUS), close, pushed)
        pull = scaled(normal, 0.0 - pushed.push)
        known = self.known_force(rod, contact + FORCE * self.stride, pushed.push)
        if ti.static(self.settles_early):
            self.add(rod, END_EXCESS, scaled(normal, known - pushed.push))
        self.add(rod, END_GRADIENT, pull)
        self.add(rod, END_CURVATURES, scaled(outer(normal), pushed.stiffness))
        if self.is_curved(rod, o):
            bent = (self.load3(rod.scratch, contact + CURVATURE * self.stride)
                    + self.load3(rod.scratch, contact + (CURVATURE + 3) * self.stride))
            self.add(rod, END_CURVATURES, scaled(bent, 0.0 - known))

    @ti.func
    def settle_now(self, rod, at, gap, counts):
        """Where the contact ``counts`` and the step settles forces, set its force λ, at ``at`` in scratch, to max(0, λ − κ g)
        with the κ before the step."""
        if ti.static(self.settles_early):
            stiffness, old = self.item(rod, SETTLING), rod.scratch[at]
            settles = counts & (stiffness > 0.0)
            new = ti.select(settles, ti.max(old - stiffness * gap, 0.0 * gap), old)
            rod.scratch[at] = new
            settled = rod.contacts + SETTLED * self.stride
            rod.scratch[settled] = largest_of(rod.scratch[settled], absolute(new - old))

    @ti.func
    def settled_gap(self, rod):
        """By how much the step changed a gap by settling forces, in the lanes where it did."""
        return self.item(rod, SETTLED) / self.item(rod, SETTLING)

    @ti.func
    def known_force(self, rod, at, push):
        """The force of a contact in the residual and in the second derivatives of φ: in a step that settles forces the settled
        λ, at ``at`` in scratch, where the contact pushes at all; otherwise its whole ``push``, or none where it is only
        expected. The difference, −κ g, only closes the gap."""
        known = variable((push,))
        if ti.static(self.settles_early):
            known = (ti.select((self.item(rod, SETTLING) > 0.0) & (push > 0.0), rod.scratch[at], push),)
        if ti.static(self.expects):
            known = (ti.max(known[0], 0.0 * push),)
        return known[0]

    @ti.func
    def expect(self, rod, at, force, gap, counts, pushed):
        """After a refused step, add to the derivatives a contact that pushed where the step ended and does not push now.
        ``at``: where scratch notes whether it pushes, renewed here; ``pushed``: the result of :meth:`push`, changed here."""
        if ti.static(self.expects):
            zero, before = 0.0 * gap, rod.scratch[at]
            pushes = counts & (pushed.push > 0.0)
            rod.scratch[at] = ti.select(pushes, zero + 1.0, zero)
            if self.common(rod, SOME_EXPECTING) > 0.5:
                stiffness, some = self.item(rod, STIFFNESS), rod.contacts + EXPECTED * self.stride
                expected = counts & ~pushes & (before > 0.5) & (self.item(rod, EXPECTING) > 0.5)
                pushed.push = ti.select(expected, force - stiffness * gap, pushed.push)
                pushed.stiffness = ti.select(expected, stiffness, pushed.stiffness)
                rod.scratch[some] = ti.select(expected, zero + 1.0, rod.scratch[some])

    @ti.func
    def rub_vertex(self, rod, o, at, contact):
        """Add the friction of the vertex."""
        across = self.load3(rod.scratch, contact + RUBBED_NORMAL * self.stride)
        friction = self.load3(rod.scratch, contact + FRICTION * self.stride)
        rubbed = self.rubbed(rod, self.limit(rod, o, contact, FORCE), friction, across, self.slid(rod, at, o))
        self.add_penalty(rod, rubbed.energy, dot(rubbed.pull, rubbed.pull) / self.item(rod, STIFFNESS))
        self.add(rod, END_GRADIENT, rubbed.pull)
        self.add(rod, END_CURVATURES, rubbed.stiffness)

    @ti.func
    def rub_between(self, rod, o, index, contact, counts):
        """Add the friction at the nearest point of an edge in the lanes where it ``counts``."""
        zero = 0.0 * rod.total
        s, u = rod.scratch[contact + RUBBED_PLACE * self.stride], self.slid_between(rod, index, contact, o)
        away = self.load3(rod.scratch, contact + RUBBED_NORMAL_BETWEEN * self.stride)
        friction = self.load3(rod.scratch, contact + FRICTION_BETWEEN * self.stride)
        rubbed = self.rubbed(rod, self.limit(rod, o, contact, FORCE_BETWEEN), friction, away, u)
        pull, bent = chosen(counts, rubbed.pull, repeated(zero, 3)), chosen(counts, rubbed.stiffness, repeated(zero, 6))
        self.add_penalty(rod, ti.select(counts, rubbed.energy, zero), dot(pull, pull) / self.item(rod, STIFFNESS))
        self.add(rod, GRADIENT, pull + scaled(pull, s))
        self.add(rod, CURVATURES, bent + scaled(full(bent), s) + scaled(bent, s * s))

    @ti.func
    def limit(self, rod, o, contact, force: ti.template()):
        """μ λ, the largest friction of a contact with obstacle ``o``."""
        return rod.scratch[self.obstacle(rod, o) + COEFFICIENT * self.stride] * rod.scratch[contact + force * self.stride]

    @ti.func
    def rubbed(self, rod, limit, friction, gradient, u):
        """Friction of a contact that has moved by ``u``: its energy, its derivative and its stiffness.

        With the friction q of the round before and z = q + κ u along the surface it is z where |z| ≤ μ λ, and else of that size
        along z: the derivative of |z|²/2κ, or of μ λ (|z| − μ λ/2)/κ.
        """
        stiffness = self.item(rod, STIFFNESS)
        normal = self.distance.unit(gradient)
        whole = plus(friction, scaled(u, stiffness))
        z = minus(whole, scaled(normal, dot(normal, whole)))
        size = ti.sqrt(dot(z, z) + 1e-30)
        slips = size > limit
        share = ti.select(slips, limit / size, 0.0 * limit + 1.0)
        energy = ti.select(slips, limit * (size - 0.5 * limit), 0.5 * size * size) / stiffness
        across = scaled(plus(outer(normal), scaled(outer(z), ti.select(slips, 1.0 / (size * size), 0.0 * size))), 0.0 - 1.0)
        flat = (1.0 + across[0], across[1], across[2], 1.0 + across[3], across[4], 1.0 + across[5])
        return record(energy=energy, pull=scaled(z, share), stiffness=scaled(flat, stiffness * share))

    @ti.func
    def add_between(self, rod, contact, edge, seen, share):
        """Add the contact at the nearest point of the edge, the energy of which counts by a weight. ``share``: that weight, its
        derivative by the sag of φ from the nearer end, s there and the normal."""
        s, normal, zero = seen.s, seen.normal, 0.0 * seen.s
        weight = share.weight
        counts = weight > 0.0  # a lane where it does not may hold any number
        self.store(rod.scratch, contact + PLACE_BETWEEN * self.stride, (s, seen.value) + normal + (weight,))
        gap = seen.value - self.item(rod, RADIUS)
        self.settle_now(rod, contact + FORCE_BETWEEN * self.stride, gap, counts)
        pushed = self.push(rod, rod.scratch[contact + FORCE_BETWEEN * self.stride], gap)
        self.lower(rod.scratch, rod.contacts + CLOSEST * self.stride, ti.select(counts, gap, zero + 1e30))
        own = ti.select(counts, pushed.energy, zero)
        self.expect(rod, contact + PUSHES_BETWEEN * self.stride, rod.scratch[contact + FORCE_BETWEEN * self.stride], gap,
                    counts, pushed)
        force, stiffness = ti.select(counts, weight * pushed.push, zero), ti.select(counts, weight * pushed.stiffness, zero)
        known = self.known_force(rod, contact + FORCE_BETWEEN * self.stride, force)
        if ti.static(self.settles_early):
            excess = scaled(normal, known - force)
            self.add(rod, EXCESS, excess + scaled(excess, s))
        self.add_penalty(rod, weight * own, ti.max(force, zero) * rod.total)
        turned = applied(full(seen.curvature), edge)
        across = plus(normal, scaled(turned, s))
        slide = known / seen.bend
        fixed = minus(scaled(outer(normal), stiffness), scaled(seen.curvature, known))
        fading = share.slope * own
        pull = scaled(normal, 0.0 - force - fading)
        lift = scaled(share.normal, fading)
        self.add(rod, GRADIENT, plus(pull, lift))
        self.add(rod, GRADIENT_S, plus(scaled(pull, s), scaled(lift, share.s)))
        self.add(rod, CURVATURES, plus(fixed, scaled(outer(turned), slide)))
        self.add(rod, CURVATURES_S, plus(scaled(full(fixed), s), scaled(outer_product(turned, across), slide)))
        self.add(rod, CURVATURES_SS, plus(scaled(fixed, s * s), scaled(outer(across), slide)))
