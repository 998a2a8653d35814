"""Contact of a chain with obstacles: a barrier first, then an augmented Lagrangian of the gaps (docs/contact.md).

The gap at a place x of the rod is g = φ(x) − r ≥ 0. With forces λ ≥ 0 that are known from the round before, Newton minimises

    E + Σ max(0, λ − κ g)² / 2κ,

and a round ends with λ ← max(0, λ − κ g). Rounds change nothing any more where every gap is closed or bears no force: there the
force is exact for any κ, and no rod is inside an obstacle by more than the tolerance.

A rod touches an obstacle at its vertices and, where an edge bridges it, at the point of the edge that is nearest to it. That
point moves along the edge with the step: φ* = min_s φ(x + s p) has the derivatives n and s n by x and by p, and second
derivatives lower than those at a fixed s by v vᵀ/φ_ss, v = (H p, n + s H p), φ_ss = pᵀH p, H = ∇∇φ.
"""

import taichi as ti

from doo_ti.contact.distance import Distance, outer
from doo_ti.contact.obstacles import DEPTH, OBSTACLE_COLUMNS, SIZES
from doo_ti.physics.algebra import absolute, largest_of
from doo_ti.physics.tuples import (
    applied,
    chosen,
    dot,
    full,
    minus,
    negated,
    picked,
    plus,
    record,
    repeated,
    scaled,
    traced,
)
from doo_ti.relaxation import tables as of

# Items of a rod: its radius, κ, the tolerance of its gaps, by how much the last round changed a gap, its phase, and what the
# barrier adds to its gaps, its strength μ and how many strengths it has had. The obstacles follow.
RADIUS, STIFFNESS, TOLERANCE, CHANGE, PHASE, OFFSET, STRENGTH, STAGE, HEAD = 0, 1, 2, 3, 4, 5, 6, 7, 8
# Phases of a rod: it has just been loaded; a barrier keeps it away from obstacles, which finds out where it will touch them;
# rounds to a rough tolerance of its moments; rounds to the final one.
LOADED, BARRIER, ROUGH, FINE = 3.0, 2.0, 1.0, 0.0
# Items of a vertex: its place; the least room of the edge that ends there, which is how far it is from the middle of an
# obstacle; both also from before the step; and the forces on that edge's end and on its start. Its contacts follow.
PLACE, STANDING, ROOM, ROOM_STANDING, FORCE_END, FORCE_START, VERTEX_ITEMS = 0, 3, 6, 7, 8, 11, 14
# Items of the contact of a vertex and the edge that ends there with an obstacle: λ of both; of the vertex φ, its normal and
# ∇∇φ; of the edge the nearest point s, φ* and its normal, and the weight of its contact; by how much it is nearer there than at
# its ends; and one where rounds have that contact.
FORCE, FORCE_BETWEEN, VALUE, NORMAL, CURVATURE, PLACE_BETWEEN, VALUE_BETWEEN, NORMAL_BETWEEN, WEIGHT, SAGGING, ACTIVE = (
    0, 1, 2, 3, 6, 12, 13, 14, 17, 18, 19)
CONTACT_ITEMS = 20
REMEMBERED = 2
"""Items of a contact that last from one relaxation to the next."""

SEARCHES = 5
"""Evaluations to find the point of an edge that is nearest to an obstacle."""
SAG = 0.1
"""Of a radius: where an edge is nearer to an obstacle than its ends by so much, its nearest point has half its weight."""
BENDING_LOADS = 20.0
"""The forces to expect are the weight of an edge and so many B/L²."""
SOFT = 0.05
"""Of a radius: at first κ gives way by that under such a force."""
STIFFER, SLOW = 5.0, 0.3
"""κ grows by so much where a round leaves more than that share of the change of the round before."""
SECANT = 0.3
"""After the barrier κ is that share of the barrier's largest force over its gap."""
BARRIER_SHARE = 1 / 16
"""The barrier at a quarter of a radius pushes at first like such a force."""
WEAKER, STAGES = 1 / 30, 2
"""The barrier becomes weaker by that, until it has had so many stages."""
LEAST_OFFSET = 0.05
"""Of a radius: the smallest gap of a rod's start, as the barrier sees it."""
APPROACH = 0.75
"""A whole step may take 0.6 over that of a gap."""
SLACK = 0.1
"""Of a radius: by so much more it may in rounds."""
ROUGHEST, ROUGHER = 1e5, 1e3
"""By so much the tolerance of a rod's moments is larger under the barrier, and until the forces of contacts have settled."""


@picked
def contact_items(edges, obstacles):
    """Numbers of a rod's contacts in scratch."""
    return HEAD + obstacles * OBSTACLE_COLUMNS + (edges + 1) * (VERTEX_ITEMS + obstacles * CONTACT_ITEMS)


@traced
def outer_product(a, b) -> tuple:
    """a bᵀ."""
    return tuple(x * y for x in a for y in b)


@ti.data_oriented
class Contacts:
    """Contacts of the rods in a pack with obstacles of some ``kinds``. Of the record ``rod`` it reads ``contacts``, where its
    items begin in scratch, ``kinds``, and ``obstacles``, how many there are."""

    def __init__(self, number, stride: int, kinds: frozenset[int]):
        lanes = number.lanes()
        self.put, self.get, self.largest = lanes.put, lanes.get, lanes.largest
        self.stride = stride
        self.distance = Distance(number, stride, kinds)
        self.load3 = self.distance.load3
        # What the places of vertices are wrong by, as a share of the rod's length.
        self.rounding = 2e-7 if number.bits == 32 else 1e-16

    # --- places in scratch ---

    @ti.func
    def item(self, rod, item: ti.template()):
        """A number of the rod."""
        return rod.scratch[rod.contacts + item * self.stride]

    @ti.func
    def set_item(self, rod, item: ti.template(), condition, value):
        """Set it where the condition holds."""
        at = rod.contacts + item * self.stride
        rod.scratch[at] = ti.select(condition, value, rod.scratch[at])

    @ti.func
    def obstacle(self, rod, index):
        return rod.contacts + (HEAD + index * OBSTACLE_COLUMNS) * self.stride

    @ti.func
    def vertex(self, rod, index):
        first = HEAD + rod.obstacles * OBSTACLE_COLUMNS
        return rod.contacts + (first + index * (VERTEX_ITEMS + rod.obstacles * CONTACT_ITEMS)) * self.stride

    @ti.func
    def contact(self, vertex, index):
        return vertex + (VERTEX_ITEMS + index * CONTACT_ITEMS) * self.stride

    @ti.func
    def store(self, scratch: ti.template(), at, values):
        for k in ti.static(range(len(values))):
            scratch[at + k * self.stride] = values[k]

    # --- what a rod is near to ---

    @ti.func
    def look(self, rod, index, place, found):
        """Measure how far vertex ``index``, at ``place``, is from all obstacles."""
        at = self.vertex(rod, index)
        away = minus(place, self.load3(rod.scratch, at + STANDING * self.stride))
        self.store(rod.scratch, at + PLACE * self.stride, place)
        found.crossing = largest_of(found.crossing, dot(away, away) * self.nearness(rod, index, at, ROOM_STANDING))
        radius, held = self.item(rod, RADIUS), self.held(rod, index) > 0.5
        for o in range(rod.obstacles):
            contact = self.contact(at, o)
            seen = self.distance.measure(rod.scratch, self.obstacle(rod, o), rod.kinds[o], place)
            self.store(rod.scratch, contact + NORMAL * self.stride, seen.normal)
            self.store(rod.scratch, contact + CURVATURE * self.stride, seen.curvature)
            rod.scratch[contact + VALUE * self.stride] = seen.value
            gap = seen.value - radius
            found.deepest = ti.min(found.deepest, seen.value)
            found.pinched = ti.min(found.pinched, ti.select(held, gap, 0.0 * gap))
            found.closest = ti.min(found.closest, ti.select(held, found.closest, gap))

    @ti.func
    def nearness(self, rod, index, at, item: ti.template()):
        """1/ρ² of the vertex, ρ the least room of the two edges that meet there."""
        room = rod.scratch[at + item * self.stride]
        if index < rod.edges:
            room = ti.min(room, rod.scratch[self.vertex(rod, index + 1) + item * self.stride])
        return 1.0 / (room * room + 1e-20)

    @ti.func
    def held(self, rod, index):
        """One where clamps hold the vertex: at the ends, and where they hold an end edge too at the vertex after."""
        held = 0.0 * rod.closed
        if index < 2:
            held = 1.0 - rod.loose
            if index == 1:
                held = held * (1.0 - rod.free[1])
        if index > rod.edges - 2:
            far = rod.closed + held
            if index == rod.edges - 1:
                far = rod.closed * (1.0 - rod.free[3])
            held = ti.max(held, ti.min(far, 0.0 * far + 1.0))
        return held

    @ti.func
    def blocked(self, rod, found):
        """Whether the rod's centreline is inside an obstacle, or a clamp holds the rod where it is in one."""
        return (found.deepest < 0.0) | (found.pinched < 0.0 - self.item(rod, TOLERANCE))

    # --- energy ---

    @ti.func
    def nothing(self, zero):
        """The record of an edge's derivatives, as :meth:`.LoadedElimination.load` returns it, and its room."""
        return record(
            gradient=repeated(zero, 3), gradient_s=repeated(zero, 3), curvature=repeated(zero, 6),
            curvature_s=repeated(zero, 9), curvature_ss=repeated(zero, 6), room=zero + 1e30)

    @ti.func
    def touched(self, rod, index, start, end, found):
        """The energy of the contacts of vertex ``index``, at ``end``, and of the edge from ``start`` to there. Looks at
        ``start``; somebody has looked at ``end`` before."""
        zero = 0.0 * end[0]
        self.look(rod, index - 1, start, found)
        at, before = self.vertex(rod, index), self.vertex(rod, index - 1)
        total, edge = self.nothing(zero), minus(end, start)
        radius = self.item(rod, RADIUS)
        for o in range(rod.obstacles):
            contact, previous = self.contact(at, o), self.contact(before, o)
            self.add_vertex(rod, contact, total, found)
            slope_start = dot(self.load3(rod.scratch, previous + NORMAL * self.stride), edge)
            slope_end = dot(self.load3(rod.scratch, contact + NORMAL * self.stride), edge)
            value_start = rod.scratch[previous + VALUE * self.stride]
            value_end = rod.scratch[contact + VALUE * self.stride]
            # φ along an edge lies above its tangents at both ends, which meet here.
            meet = (value_end - value_start - slope_end) / ti.min(slope_start - slope_end, zero - 1e-20)
            bridging = (slope_start < 0.0) & (slope_end > 0.0)
            least = ti.min(value_start, value_end)
            low = ti.select(bridging, value_start + slope_start * meet, least)
            total.room = ti.min(total.room, low + rod.scratch[self.obstacle(rod, o) + DEPTH * self.stride])
            near = bridging & (low < 2.0 * radius)
            active = rod.scratch[contact + ACTIVE * self.stride] > 0.5
            rod.scratch[contact + WEIGHT * self.stride] = zero
            rod.scratch[contact + SAGGING * self.stride] = zero
            if self.largest(ti.select(near | active, zero + 1.0, zero)) > 0.5:
                seen = self.nearest(rod, o, start, edge, slope_start, slope_end)
                lower = value_start < value_end
                sagging = ti.select(near, least - seen.value, zero)
                rod.scratch[contact + SAGGING * self.stride] = sagging
                sag = ti.max(sagging / (SAG * radius), zero)
                behind = self.item(rod, PHASE) > ti.static(0.5 * (BARRIER + ROUGH))
                fading = ti.select(behind & near, 2.0 * sag / ((1.0 + sag * sag) * (1.0 + sag * sag) * SAG * radius), zero)
                share = record(
                    weight=ti.select(behind, sag * sag / (1.0 + sag * sag), ti.select(active, zero + 1.0, zero)),
                    slope=fading, s=ti.select(lower, zero, zero + 1.0),
                    normal=chosen(lower, self.load3(rod.scratch, previous + NORMAL * self.stride),
                                  self.load3(rod.scratch, contact + NORMAL * self.stride)))
                self.add_between(rod, contact, edge, seen, share, total, found)
        self.store(rod.scratch, at + FORCE_END * self.stride, negated(total.gradient_s))
        self.store(rod.scratch, at + FORCE_START * self.stride, minus(total.gradient_s, total.gradient))
        rod.scratch[at + ROOM * self.stride] = total.room
        return total

    @ti.func
    def touched_start(self, rod, found):
        """The same of vertex 0."""
        at, zero = self.vertex(rod, 0), 0.0 * rod.total
        total = self.nothing(zero)
        for o in range(rod.obstacles):
            contact = self.contact(at, o)
            self.add_vertex(rod, contact, total, found)
            total.room = ti.min(total.room, rod.scratch[contact + VALUE * self.stride]
                                + rod.scratch[self.obstacle(rod, o) + DEPTH * self.stride])
        self.store(rod.scratch, at + FORCE_END * self.stride, negated(total.gradient_s))
        rod.scratch[at + ROOM * self.stride] = total.room
        return total

    @ti.func
    def nearest(self, rod, o, start, edge, slope_start, slope_end):
        """The point of an edge that is nearest to an obstacle, by Newton's method between bounds: a record of ``s``, of φ there
        with its derivatives, and of φ_ss, or a very large number where an end is the nearest."""
        zero = 0.0 * slope_start
        low, high = zero, zero + 1.0
        bridging = (slope_start < 0.0) & (slope_end > 0.0)
        end = ti.select(slope_start < 0.0, zero + 1.0, zero)
        # Exact where the obstacle's section along the edge is round: φ_s is then the sine of an angle whose tangent is linear.
        square = dot(edge, edge)
        before = 0.0 - slope_start / ti.sqrt(ti.max(square - slope_start * slope_start, 1e-12 * square))
        beyond = slope_end / ti.sqrt(ti.max(square - slope_end * slope_end, 1e-12 * square))
        s = ti.select(bridging, before / ti.max(before + beyond, zero + 1e-20), end)
        found = record(s=zero, value=zero, normal=repeated(zero, 3), curvature=repeated(zero, 6), bend=zero)
        for _ in range(SEARCHES):
            seen = self.distance.measure(rod.scratch, self.obstacle(rod, o), rod.kinds[o], plus(start, scaled(edge, s)))
            slope = dot(seen.normal, edge)
            found.s, found.value = s, seen.value
            found.normal, found.curvature = seen.normal, seen.curvature
            found.bend = ti.max(dot(edge, applied(full(seen.curvature), edge)), zero + 1e-20)
            low, high = ti.select(slope < 0.0, s, low), ti.select(slope < 0.0, high, s)
            step = s - slope / found.bend
            s = ti.select(bridging, ti.select((step >= low) & (step <= high), step, 0.5 * (low + high)), end)
        found.bend = ti.select(bridging, found.bend, zero + 1e30)
        return found

    @ti.func
    def push(self, rod, force, gap):
        """(force, stiffness) of a contact whose λ is ``force``, and its energy."""
        stiffness = self.item(rod, STIFFNESS)
        push = ti.max(force - stiffness * gap, 0.0 * gap)
        acting = ti.select(push > 0.0, stiffness, 0.0 * gap)
        energy = 0.5 * push * push / stiffness
        phase = self.item(rod, PHASE)
        behind = phase > ti.static(0.5 * (BARRIER + ROUGH))
        if self.largest(phase) > ti.static(0.5 * (BARRIER + ROUGH)):
            wall = self.barrier(rod, gap)
            push, acting = ti.select(behind, wall.push, push), ti.select(behind, wall.stiffness, acting)
            energy = ti.select(behind, wall.energy, energy)
        return record(push=push, stiffness=acting, energy=energy)

    @ti.func
    def barrier(self, rod, gap):
        """A barrier μ (1 − x)³/x in x, the gap over the radius, where that is below one: its energy, force and stiffness. Rods
        that have just been loaded feel none."""
        zero = 0.0 * gap
        radius = self.item(rod, RADIUS)
        x = (gap + self.item(rod, OFFSET)) / radius
        inside = (x < 1.0) & (self.item(rod, PHASE) < ti.static(0.5 * (LOADED + BARRIER)))
        strength = ti.select(inside, self.item(rod, STRENGTH), zero)
        inverse, rest = 1.0 / ti.max(x, zero + 1e-3), 1.0 - x
        first = rest * rest * inverse
        second = first * rest * inverse
        stiffness = 6.0 * rest * inverse + 6.0 * first * inverse + 2.0 * second * inverse
        return record(energy=ti.select(inside & (x <= 1e-3), zero + 1e30, strength * first * rest),
                      push=strength * (3.0 * first + second) / radius, stiffness=strength * stiffness / (radius * radius))

    @ti.func
    def add_vertex(self, rod, contact, total, found):
        """Add a contact of the vertex where the edge ends."""
        normal = self.load3(rod.scratch, contact + NORMAL * self.stride)
        bent = (self.load3(rod.scratch, contact + CURVATURE * self.stride)
                + self.load3(rod.scratch, contact + (CURVATURE + 3) * self.stride))
        pushed = self.push(rod, rod.scratch[contact + FORCE * self.stride],
                           rod.scratch[contact + VALUE * self.stride] - self.item(rod, RADIUS))
        found.energy = found.energy + pushed.energy
        found.magnitude = found.magnitude + pushed.push * rod.total
        pull = scaled(normal, 0.0 - pushed.push)
        k = minus(scaled(outer(normal), pushed.stiffness), scaled(bent, pushed.push))
        total.gradient, total.gradient_s = plus(total.gradient, pull), plus(total.gradient_s, pull)
        total.curvature, total.curvature_ss = plus(total.curvature, k), plus(total.curvature_ss, k)
        total.curvature_s = plus(total.curvature_s, full(k))

    @ti.func
    def add_between(self, rod, contact, edge, seen, share, total, found):
        """Add the contact at the nearest point of the edge, the energy of which counts by a weight. ``share``: that weight, its
        derivative by the sag of φ from the nearer end, s there and the normal."""
        s, normal, zero = seen.s, seen.normal, 0.0 * seen.s
        weight = share.weight
        counts = weight > 0.0  # a lane where it does not may hold any number
        self.store(rod.scratch, contact + PLACE_BETWEEN * self.stride, (s, seen.value) + normal + (weight,))
        gap = seen.value - self.item(rod, RADIUS)
        pushed = self.push(rod, rod.scratch[contact + FORCE_BETWEEN * self.stride], gap)
        found.closest = ti.min(found.closest, ti.select(counts, gap, found.closest))
        force, stiffness = ti.select(counts, weight * pushed.push, zero), ti.select(counts, weight * pushed.stiffness, zero)
        own = ti.select(counts, pushed.energy, zero)
        found.energy = found.energy + weight * own
        found.magnitude = found.magnitude + force * rod.total
        turned = applied(full(seen.curvature), edge)
        across = plus(normal, scaled(turned, s))
        slide = force / seen.bend
        fixed = minus(scaled(outer(normal), stiffness), scaled(seen.curvature, force))
        fading = share.slope * own
        pull = scaled(normal, 0.0 - force - fading)
        lift = scaled(share.normal, fading)
        total.gradient = plus(total.gradient, plus(pull, lift))
        total.gradient_s = plus(total.gradient_s, plus(scaled(pull, s), scaled(lift, share.s)))
        total.curvature = plus(total.curvature, plus(fixed, scaled(outer(turned), slide)))
        total.curvature_s = plus(total.curvature_s, plus(scaled(full(fixed), s), scaled(outer_product(turned, across), slide)))
        total.curvature_ss = plus(total.curvature_ss, plus(scaled(fixed, s * s), scaled(outer(across), slide)))

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
            gap = ti.max(rod.scratch[contact + VALUE * self.stride] - radius, floor) + slack
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
    def enter(self, rod, found, fresh):
        """Begin with the barrier where a rod has just been loaded, its gaps larger by so much that its start is within."""
        loaded = fresh & (self.item(rod, PHASE) > ti.static(0.5 * (LOADED + BARRIER)))
        radius = self.item(rod, RADIUS)
        self.set_item(rod, OFFSET, loaded, ti.max(LEAST_OFFSET * radius - found.closest, 0.0 * radius))
        self.set_item(rod, PHASE, loaded, 0.0 * radius + BARRIER)
        return loaded

    @ti.func
    def settle(self, rod, due):
        """End a round in the lanes that are ``due`` with new forces, or the barrier with those it exerts. Returns the largest
        change of a gap that they mean."""
        zero = 0.0 * rod.total
        radius, stiffness, phase = self.item(rod, RADIUS), self.item(rod, STIFFNESS), self.item(rod, PHASE)
        behind = phase > ti.static(0.5 * (BARRIER + ROUGH))
        tolerance = self.item(rod, TOLERANCE)
        change, secant = zero, zero
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
        change = ti.select(due & ~behind, change / stiffness, zero)
        slow = due & ~behind & (change > SLOW * self.item(rod, CHANGE)) & (change > self.item(rod, TOLERANCE))
        self.set_item(rod, STIFFNESS, slow, STIFFER * stiffness)
        self.set_item(rod, CHANGE, due & ~behind, change)
        last = due & behind & (self.item(rod, STAGE) > STAGES - 1.5)
        self.set_item(rod, STIFFNESS, last & (secant > 0.0), SECANT * secant)
        self.set_item(rod, PHASE, last, zero + ROUGH)
        self.set_item(rod, STRENGTH, due & behind & ~last, WEAKER * self.item(rod, STRENGTH))
        self.set_item(rod, STAGE, due & behind, 1.0 + self.item(rod, STAGE))
        return change

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

    # --- a rod into a lane and out of it ---

    @ti.func
    def load(self, tables, scratch: ti.template(), slot, rod, force_unit, unit, scale):
        """Rod ``rod``'s obstacles and contacts into lane ``slot``, forces over ``force_unit``, lengths over ``unit``; ``scale``:
        the largest stiffness, the weight per length, the mean length of an edge and the rod's, in the units of the chain."""
        base = tables.contacts
        row = tables.rods[rod, of.RESULT_ROW]
        own = ti.min(row, tables.obstacles.shape[0] - 1)
        count, vertices = tables.kinds.shape[0], tables.rest_length.shape[1] + 1
        radius = tables.radius[ti.min(row, tables.radius.shape[0] - 1)] / unit
        force = BENDING_LOADS * scale.bend / (scale.total * scale.total) + scale.weight * scale.length
        tolerance = ti.max(tables.tolerance * radius, 10.0 * self.rounding * scale.total)
        head = (radius, force / (SOFT * radius), tolerance, 1e30, LOADED, 0.0, BARRIER_SHARE * force * radius, 0.0)
        for k in ti.static(range(HEAD)):
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
                for k in ti.static(range(REMEMBERED)):
                    self.put(scratch, contact + k * self.stride, slot, tables.memory[row, v, o, k] / force_unit)

    @ti.func
    def unload(self, tables, scratch: ti.template(), slot, row, place, force_unit):
        """The lane's contacts into row ``row`` of the memory, and the forces on its vertices into row ``place``."""
        count, vertices = tables.kinds.shape[0], tables.rest_length.shape[1] + 1
        first = tables.contacts + (HEAD + count * OBSTACLE_COLUMNS) * self.stride
        size = (VERTEX_ITEMS + count * CONTACT_ITEMS) * self.stride
        for v in range(vertices):
            at = first + v * size
            for k in ti.static(range(3)):
                force = ti.cast(self.get(scratch, at + (FORCE_END + k) * self.stride, slot), ti.f64)
                if v < vertices - 1:
                    force += self.get(scratch, at + size + (FORCE_START + k) * self.stride, slot)
                tables.forces[place, v, k] = force * force_unit
            for o in range(count):
                contact = at + (VERTEX_ITEMS + o * CONTACT_ITEMS) * self.stride
                for k in ti.static(range(REMEMBERED)):
                    value = ti.cast(self.get(scratch, contact + k * self.stride, slot), ti.f64)
                    tables.memory[row, v, o, k] = value * force_unit
