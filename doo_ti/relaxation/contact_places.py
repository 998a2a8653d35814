"""Where a chain is, seen from obstacles: distances of its vertices, nearest points of its edges, friction (docs/contact.md).

Friction is an augmented Lagrangian of how far contacts have slid. At a contact of force λ whose friction was q in the round
before, and which has moved by u since the instant before, it is z = q + κ u along the surface where |z| ≤ μ λ, else of that
size along z. It is the derivative of |z|²/2κ, or of μ λ (|z| − μ λ/2)/κ.
"""

import taichi as ti

from doo_ti.contact.distance import Distance, outer
from doo_ti.contact.obstacles import PLANE
from doo_ti.physics.algebra import absolute, applied, full, largest_of, row
from doo_ti.physics.number import device_functions
from doo_ti.physics.tuples import add, choose, chosen, dot, minus, picked, plus, record, repeated, scaled, variable
from doo_ti.relaxation.contact_table import CONTACT, CONTACTS, EVEN, OBSTACLE, SEARCHES, VERTEX, contact_items


@device_functions
class ContactPlaces:
    """Where the rods in a pack are, seen from obstacles. Of the record ``rod`` it reads ``contacts``, the view of
    its numbers in scratch, ``kinds``, ``grids``, and ``obstacles``, how many there are. ``moves``: obstacles may move during
    a motion. ``itself``: rods may touch themselves, or each other (:class:`.SelfContacts`).
    """

    itself = False

    def __init__(self, number, has_grid: bool, moves: bool = False):
        self.largest, self.moves, self.bits = number.largest, moves, number.bits
        self.distance = Distance(number, has_grid)
        # What the places of vertices are wrong by, as a share of the rod's length.
        self.rounding = 2e-7 if number.bits == 32 else 1e-13
        # And of the place on an edge, of its length: φ there is wrong by its square.
        self.place_rounding = 3e-4 if number.bits == 32 else 1e-7

    def some(self, condition, zero):
        """Whether a condition holds in some lane."""
        return self.largest(ti.select(condition, zero + 1.0, zero)) > 0.5

    # --- views of scratch ---

    @picked
    def obstacle(self, rod, index):
        return rod.contacts.part(OBSTACLE, len(CONTACTS) + index * len(OBSTACLE))

    @picked
    def vertex(self, rod, index):
        size = len(VERTEX) + rod.obstacles * len(CONTACT)
        return rod.contacts.part(VERTEX, len(CONTACTS) + rod.obstacles * len(OBSTACLE) + index * size)

    @picked
    def contact(self, vertex, index):
        return vertex.part(CONTACT, len(VERTEX) + index * len(CONTACT))

    @picked
    def items(self, tables):
        """How many numbers of a rod's contacts scratch holds."""
        return contact_items(tables.rest_length.shape[1], tables.kinds.shape[0])

    @picked
    def of_lane(self, tables, slot):
        """The record of what the functions above read, for the rod in one lane of scratch."""
        return record(contacts=tables.contacts.lane(slot), edges=tables.rest_length.shape[1], obstacles=tables.kinds.shape[0])

    # --- sums ---

    def begin(self, rod):
        """Begin the sums over all vertices, and compute what they all need."""
        zero = 0.0 * rod.total
        most = zero + 1e30
        rod.contacts.sums = (zero, zero, zero, zero, most, most, zero)
        rod.contacts.compliance = 1.0 / rod.contacts.stiffness
        rod.contacts.has_met = zero
        common = rod.contacts.lane(0)  # one number for all rods of the pack, the largest of theirs
        common.some_refused = self.largest(rod.contacts.refused)
        common.longest_edge = self.largest(rod.longest)

    def add_penalty(self, rod, energy, magnitude):
        """Add to the energy of all contacts a part that only makes gaps close, and is no energy of the rod."""
        add(rod.contacts, energy=energy, magnitude=magnitude, penalty=energy)

    # --- what a rod is near to ---

    def look(self, rod, index, place):
        """Measure how far vertex ``index``, at ``place``, is from all obstacles."""
        at = self.vertex(rod, index)
        standing = variable(at.place)
        at.standing, at.place = standing, place
        away = minus(place, standing)
        rod.contacts.crossing = largest_of(rod.contacts.crossing, dot(away, away) * self.nearness(rod, index, at))
        longest = rod.contacts.lane(0).longest_edge
        least, nearest_of_all = 0.0 * rod.total + 1e30, 0.0 * longest + 1e30
        for o in range(rod.obstacles):
            contact = self.contact(at, o)
            seen = self.distance.measure(self.obstacle(rod, o), rod.grids, rod.kinds[o], place)
            value = self.clearance(rod, index, seen.value)
            contact.value = value
            # Where a vertex is close, the normals at both ends of its edges count.
            nearest = 0.0 - self.largest(rod.contacts.reach - value)
            contact.lane(0).nearest = nearest
            least, nearest_of_all = ti.min(least, value), ti.min(nearest_of_all, nearest)
            if nearest < longest:
                contact.normal = seen.normal
                if self.is_curved(rod, o):
                    contact.curvature = seen.curvature
                gap, held = value - rod.contacts.radius, self.held(rod, index) > 0.5
                rod.contacts.least_phi = ti.min(rod.contacts.least_phi, seen.value)
                rod.contacts.least_gap = ti.min(rod.contacts.least_gap, ti.select(held, 0.0 * gap + 1e30, gap))
        at.least = least
        at.lane(0).nearest_of_all = nearest_of_all

    def clearance(self, rod, index, distance):
        """The ``distance`` of vertex ``index``, or of the edge that ends there, less by how much the rod is thicker there than
        ``rod.contacts.radius``: not at all for one rod; of a group that radius is the thinnest rod's."""
        return distance

    def close_lanes(self, rod, value):
        """The lanes in which a vertex is close to an obstacle, ``value`` being its φ."""
        return value < rod.contacts.reach

    def is_close(self, rod, contact):
        """Whether there are any. What is computed because of one of them must leave the others as they are."""
        return contact.lane(0).nearest < 0.0

    def is_edge_close(self, rod, index, o):
        """Whether an end of the edge to vertex ``index`` is close to obstacle ``o`` in some lane; no edge ends at vertex 0."""
        at, before = self.vertex(rod, index), self.vertex(rod, index - 1)
        return index > 0 and (self.is_close(rod, self.contact(at, o)) or self.is_close(rod, self.contact(before, o)))

    def is_curved(self, rod, o):
        """Whether obstacle ``o`` is no plane: an edge can then be nearer to it between its ends than at both."""
        return rod.kinds[o] != ti.static(PLANE)

    def is_any_close(self, rod, at):
        """Whether the vertex at ``at`` in scratch is close to any obstacle in some lane."""
        return at.lane(0).nearest_of_all < 0.0

    def nearness(self, rod, index, at):
        """1/ρ² of the vertex, ρ the least room of the two edges that meet there."""
        room = at.room
        if index < rod.edges:
            room = ti.min(room, self.vertex(rod, index + 1).room)
        return 1.0 / (room * room + 1e-20)

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

    def blocked(self, rod, fresh, miss):
        """The ``fresh`` lanes in which the rod's centreline is inside an obstacle, or a clamp (:meth:`pinched`)."""
        zero = 0.0 * rod.total
        inside = variable((fresh & (rod.contacts.least_phi < 0.0),))
        if self.some(fresh, zero):
            inside = (inside[0] | (fresh & self.pinched(rod, miss)),)
        return inside[0]

    def pinched(self, rod, miss):
        """Whether a clamp holds a vertex of an end edge in an obstacle, or the edge between them; a far end is taken where it
        is held, not where it still misses that place by ``miss``."""
        least = 0.0 * rod.total
        for end in range(2):
            index = ti.select(end == 0, 1, rod.edges)
            start = variable(self.vertex(rod, index - 1).place)
            stop = variable(self.vertex(rod, index).place)
            if end == 1:
                start, stop = minus(start, miss), minus(stop, miss)
            least = self.sunk_edge(rod, index, start, stop, least)
        pinched = least < 0.0 - rod.contacts.tolerance
        if ti.static(self.itself):
            pinched = pinched | self.pinched_pairs(rod)
        return pinched

    def sunk_edge(self, rod, index, start, stop, least):
        """``least``, or the least gap of the edge from ``start`` to ``stop``, where vertex ``index`` is: of the ends that are
        held and, where both are, between them."""
        zero, edge, found = 0.0 * rod.total, minus(stop, start), variable((least,))
        held_start, held_stop = self.held(rod, index - 1) > 0.5, self.held(rod, index) > 0.5
        for o in range(rod.obstacles):
            obstacle, kind = self.obstacle(rod, o), rod.kinds[o]
            first = self.distance.measure(obstacle, rod.grids, kind, start)
            last = self.distance.measure(obstacle, rod.grids, kind, stop)
            value = ti.min(ti.select(held_start, first.value, zero + 1e30), ti.select(held_stop, last.value, zero + 1e30))
            value = self.clearance(rod, index, value)
            ends = (dot(first.normal, edge), dot(last.normal, edge))
            bridging = held_start & held_stop & (ends[0] < 0.0) & (ends[1] > 0.0)
            if self.some(bridging, zero):
                between = self.nearest(rod, o, index, start, edge, ends, bridging)
                value = ti.min(value, ti.select(bridging, between.value, value))
            found = (ti.min(found[0], value - rod.contacts.radius),)
        return found[0]

    def nearest(self, rod, o, index, start, edge, ends, wanted):
        """The point of the edge to vertex ``index`` that is nearest to an obstacle in the lanes where it is ``wanted``, by
        Newton's method between bounds, which halves them where a step is not half as long as the one before, from ``ends``, φ_s
        at both: a record of ``s``, of φ there with its derivatives, and of φ_ss, or a very large number where an end is the
        nearest."""
        zero = 0.0 * rod.total
        low, high = zero, zero + 1.0
        bridging = (ends[0] < 0.0) & (ends[1] > 0.0)
        s = variable((self.first_guess(edge, ends, bridging),))
        found = record(s=zero, value=zero, normal=repeated(zero, 3), curvature=repeated(zero, 6), bend=zero + 1.0)
        going, longest, even = (ti.select(wanted, zero + 1.0, zero), zero + 2.0, EVEN * rod.contacts.radius)
        searches = 0
        while searches < SEARCHES and self.largest(going) > 0.5:
            searches += 1
            seen = self.distance.measure(self.obstacle(rod, o), rod.grids, rod.kinds[o], plus(start, scaled(edge, s[0])))
            here = going > 0.5
            aside = s[0] - 0.5
            slope = dot(seen.normal, edge) + 2.0 * even * aside
            bend = ti.max(dot(edge, applied(full(seen.curvature), edge)), zero) + 2.0 * even
            choose(found, here, s=s[0], value=self.clearance(rod, index, seen.value) + even * aside * aside, bend=bend,
                   normal=seen.normal, curvature=seen.curvature)
            low, high = ti.select(slope < 0.0, s[0], low), ti.select(slope < 0.0, high, s[0])
            step = s[0] - slope / bend
            converges = (step >= low) & (step <= high) & (absolute(step - s[0]) <= 0.5 * longest)
            step = ti.select(converges, step, 0.5 * (low + high))
            longest = absolute(step - s[0])
            # A lane that has found its point keeps it while others go on.
            going = ti.select(here & bridging & (absolute(step - s[0]) > self.place_rounding), zero + 1.0, zero)
            s = (step,)
        found.bend = ti.select(bridging, found.bend, zero + 1e30)
        return found

    def first_guess(self, edge, ends, bridging):
        """Where the nearest point of an edge is, exactly where the obstacle's section along the edge is round: φ_s is then the
        sine of an angle whose tangent is linear."""
        zero = 0.0 * ends[0]
        square = dot(edge, edge) + 1e-30  # an edge may have no length
        before = 0.0 - ends[0] / ti.sqrt(ti.max(square - ends[0] * ends[0], 1e-12 * square))
        beyond = ends[1] / ti.sqrt(ti.max(square - ends[1] * ends[1], 1e-12 * square))
        end = ti.select(ends[0] < 0.0, zero + 1.0, zero)
        return ti.select(bridging, before / ti.max(before + beyond, zero + 1e-20), end)

    def moved(self, rod, vertex):
        """How far a vertex has moved since the instant before."""
        return minus(vertex.place, vertex.previous)

    def slid(self, rod, vertex, o):
        """How far a vertex has moved since then against obstacle ``o``, which may have carried the place where it was."""
        away = variable(self.moved(rod, vertex))
        if ti.static(self.moves):
            at, before = self.obstacle(rod, o), vertex.previous
            carried = variable(at.carried)
            for k in ti.static(range(3)):
                carried = plus(carried, scaled(row(at.carry, k), before[k]))
            away = plus(away, minus(before, carried))
        return away

    def slid_between(self, rod, index, contact, o):
        """The same of the place on the edge to vertex ``index`` at which friction acts."""
        s = contact.rubbed_place
        before, after = self.slid(rod, self.vertex(rod, index - 1), o), self.slid(rod, self.vertex(rod, index), o)
        return plus(scaled(before, 1.0 - s), scaled(after, s))

    # --- friction ---

    def rub_vertex(self, rod, o, at, contact):
        """Add the friction of the vertex."""
        rubbed = self.rubbed_vertex(rod, o, at, contact)
        self.add_penalty(rod, rubbed.energy, dot(rubbed.pull, rubbed.pull) / rod.contacts.stiffness)
        add(rod.contacts, end_gradient=rubbed.pull, end_curvatures=rubbed.stiffness)

    def rub_between(self, rod, o, index, contact, counts):
        """Add the friction at the nearest point of an edge in the lanes where it ``counts``."""
        zero = 0.0 * rod.total
        s, rubbed = contact.rubbed_place, self.rubbed_between(rod, o, index, contact)
        pull, bent = chosen(counts, rubbed.pull, repeated(zero, 3)), chosen(counts, rubbed.stiffness, repeated(zero, 6))
        self.add_penalty(rod, ti.select(counts, rubbed.energy, zero), dot(pull, pull) / rod.contacts.stiffness)
        add(rod.contacts, gradient=pull, gradient_s=scaled(pull, s), curvatures=bent, curvatures_s=scaled(full(bent), s),
            curvatures_ss=scaled(bent, s * s))

    def rubbed_vertex(self, rod, o, at, contact):
        """:meth:`rubbed` of the contact of the vertex ``at`` with obstacle ``o``."""
        limit, u = self.obstacle(rod, o).friction * contact.force, self.slid(rod, at, o)
        return self.rubbed(rod, limit, contact.friction, contact.rubbed_normal, u, rod.contacts.stiffness)

    def rubbed_between(self, rod, o, index, contact):
        """The same at the nearest point of the edge to vertex ``index``."""
        limit, u = self.obstacle(rod, o).friction * contact.force_between, self.slid_between(rod, index, contact, o)
        return self.rubbed(rod, limit, contact.friction_between, contact.rubbed_normal_between, u, rod.contacts.stiffness)

    def rubbed(self, rod, limit, friction, gradient, u, stiffness):
        """Friction of a contact that has moved by ``u``, at most ``limit`` = μ λ, with that penalty ``stiffness``: its energy,
        its derivative and its stiffness, and the limit where it slips."""
        normal = self.distance.unit(gradient)
        whole = plus(friction, scaled(u, stiffness))
        z = minus(whole, scaled(normal, dot(normal, whole)))
        size = ti.sqrt(dot(z, z) + 1e-30)
        slips = size > limit
        share = ti.select(slips, limit / size, 0.0 * limit + 1.0)
        energy = ti.select(slips, limit * (size - 0.5 * limit), 0.5 * size * size) / stiffness
        across = scaled(plus(outer(normal), scaled(outer(z), ti.select(slips, 1.0 / (size * size), 0.0 * size))), 0.0 - 1.0)
        flat = (1.0 + across[0], across[1], across[2], 1.0 + across[3], across[4], 1.0 + across[5])
        return record(energy=energy, pull=scaled(z, share), stiffness=scaled(flat, stiffness * share),
                      slips=ti.select(slips, limit, 0.0 * limit))
