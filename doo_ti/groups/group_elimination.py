"""The Newton system of a group: that of a rod that may touch itself, for a chain with breaks between its rods, and a border of
what ties and welds hold, with their multipliers as unknowns (docs/groups.md).

With the misses d of all ties, their derivatives A, and their forces λ, a step is that of

    | H + κ AᵀA   Aᵀ | | ω  |     | −g − Aᵀ(λ + κ d) |
    | A           −ε | | δλ |  =  | −d               |

so that forces are exact as soon as shapes are. ε makes ties that say the same thing twice determinate; the κ terms, which do
not change the step, are those of the energy by which it is judged. Of as many pivots as there are rows of A, and of no others,
the sign is negative where H is positive along all motions that keep the ties, also where it is zero along one that moves
others against their forces, as a loop turns about a nail.

A weld keeps the rotation that its two edges had to each other. With r = conj(q) p conj(p₀), where q and p are the frames of
both edges and p₀ is what conj(q) p is to be, of the sign that makes its scalar positive, u = 2 vec r is zero where the weld
holds, and the turn by which it misses where that is small. As for a tie the energy is μ·u + κ |u|²/2, with the moment μ.
"""

import taichi as ti

from doo_ti.groups.group_contacts import GroupContacts
from doo_ti.groups.ties import JointRest
from doo_ti.physics import algebra
from doo_ti.physics.algebra import absolute, column_scaled, full, on_diagonal, scaled_both
from doo_ti.physics.number import device_functions
from doo_ti.physics.quaternion import directors, product, relative_rotation, tangent, turned_in_body
from doo_ti.physics.tuples import add, chosen, cross, dot, extended, minus, negated, plus, products, repeated, scaled, variable
from doo_ti.relaxation.chain import Chain
from doo_ti.relaxation.elimination import held_pivot
from doo_ti.relaxation.newton import DenseLoadedElimination


@device_functions
class GroupElimination(DenseLoadedElimination):
    """The chain of a group. No rod is closed: ties hold their far ends.

    ``rod.borders`` are, of every three rows of A, the tie, and one where they are its weld's: rotations instead of places. Ties
    that are welds have two edges besides their vertices, the later first; the others -1.
    """

    breaks = True

    def __init__(self, number, stride: int, contacts: GroupContacts):
        super().__init__(number, False, stride, JointRest, True, contacts)

    def begins(self, rod, e):
        return rod.begins[e]

    def rest(self, edge):
        """u̅ of the left frame and of the right one, and m̅."""
        own = edge.external
        return (plus(edge.rest, own.left), plus(edge.rest, own.right), own.twist)

    def rods(self, tables, head, coarse):
        """As of one rod, with what :class:`.GroupContacts` reads."""
        rod = Chain.rods(self, tables, head, coarse)
        return extended(rod, begins=tables.begins, ties=tables.ties, borders=tables.borders, rods=tables.places.shape[1])

    def freedom(self, rod, edge):
        own = self.contacts.edge(rod, edge)
        return (own.spin, own.tilt, own.tilt)

    # --- the step ---

    def step(self, rod, scale, moving, before):
        """Frames turned by scale ω, and the rods' begins; nothing has to be closed."""
        zero = 0.0 * scale
        none = repeated(zero, 3)
        stepping = (scale > 0.0) | (scale < 0.0)
        self.contacts.stand(rod)
        self.contacts.step_forces(rod, scale, stepping)
        for e in range(rod.edges):
            edge = self.edge(rod.head, e)
            # In a lane that does not step the rotation is undefined and may be NaN.
            w = chosen(stepping, scaled(edge.rotation, scale), none)
            edge.standing = edge.frame
            edge.frame = turned_in_body(edge.standing, w, rod.spins_first)
        for g in range(1, rod.rods):
            member = self.contacts.member(rod, g)
            member.begin = plus(member.begin, chosen(stepping, scaled(member.begin_step, scale), none))
        self.step_start(rod, scale, moving, variable(none), variable(none))
        return none, repeated(zero, 6)

    def close(self, rod, x, normal):
        """The energy of bending and twisting, and that once more for its magnitude; no closure is left."""
        zero = 0.0 * rod.total
        energy = zero
        before = variable(repeated(zero, 4))  # the frame of the edge before
        for e in range(rod.edges):
            q = self.edge(rod.head, e).frame
            if e > 0:
                if rod.begins[e] + rod.begins[e - 1] == 0:
                    bent, s = self._bend(rod, e, before, q)
                    energy = energy + self.energy_of(bent, s)
            before = q
        return energy, energy, repeated(zero, 3), repeated(zero, 3), (zero, zero)

    # --- the energies of places ---

    def collect(self, rod, found):
        DenseLoadedElimination.collect(self, rod, found)
        self.contacts.hang(rod)
        self.contacts.bind(rod)
        self.weld(rod)

    def tip(self, rod):
        """The far end of the last rod, where contacts begin. Keeps where all rods end."""
        x = variable(plus(rod.anchor, rod.head.drift))
        for e in range(rod.edges):
            edge = self.edge(rod.head, e)
            following = rod.begins[e]
            if following > 0:
                self.contacts.member(rod, following - 1).tip = x
                x = self.contacts.member(rod, following).begin
            else:
                x = plus(x, scaled(tangent(edge.frame), edge.length))
        self.contacts.begin(rod)
        self.contacts.look(rod, rod.edges, x)
        return x

    def cross_break(self, rod, e):
        self.touch_begin(rod, e + 1)
        end = variable(self.contacts.member(rod, rod.begins[e] - 1).tip)
        self.contacts.look(rod, e, end)
        return end

    # --- H ---

    def assemble(self, rod, shift, search, multiplier, found):
        DenseLoadedElimination.assemble(self, rod, shift, search, multiplier, found)
        self.add_welds(rod)
        self.add_border(rod, search, found)

    def assemble_begin(self, rod, line, free, shift, force, found):
        slope = products(free, force)
        self.observe_moment(found, scaled(slope, rod.total))
        tilt = self.shifts(rod, self.edge(rod.head, line), shift)[1]  # of the rod's first edge
        shifted = on_diagonal(self.load_diagonal(rod, line), tilt / (rod.total * rod.total))
        self.store_diagonal(rod, line, held_pivot(shifted, free))
        self.store_side(rod, line, negated(slope), repeated(0.0 * rod.total, 9))

    def substitute(self, rod, found):
        largest, size, decrement = DenseLoadedElimination.substitute(self, rod, found)
        return largest, size, decrement + self.keep_forces(rod)

    # --- the border ---

    def lines(self, rod):
        return rod.edges + 1 + rod.borders.shape[0]

    def add_border(self, rod, search, found):
        """Store A, ε and the right-hand side. Inverse iterations, the ``search`` off a saddle, leave forces as they are."""
        zero = 0.0 * rod.total
        head = self.contacts.group(rod)
        self.contacts.begin_ties(rod)
        head.stepping = ti.select(search[0] + search[1] > 0.0, zero, zero + 1.0)
        for b in range(rod.borders.shape[0]):
            k, line = rod.borders[b, 0], rod.edges + 1 + b
            at = self.contacts.tie(rod, k)
            active = at.active
            give = head.give / at.scale
            if rod.borders[b, 1] == 0:
                self.add_way(rod, line, rod.ties[k, 0], active)
                if rod.ties[k, 1] >= 0:
                    self.add_way(rod, line, rod.ties[k, 1], 0.0 - active)
            else:
                give = give / (rod.total * rod.total)
                self.add_turns(rod, line, rod.ties[k, 2], rod.ties[k, 3], at, active)
            diagonal = 0.0 - active * give - (1.0 - active)
            self.store_diagonal(rod, line, (diagonal, zero, zero, diagonal, zero, diagonal))
            self.store_side(rod, line, scaled(self.contacts.bordered_miss(rod, b), 0.0 - active), repeated(zero, 9))
            found.negative = found.negative - 3.0

    def add_way(self, rod, line, vertex, sign):
        """Add the derivatives of a vertex's place, times ``sign``, by all that moves it."""
        q, begin = vertex, 0
        while q >= begin:
            a, b, c = self.levers(rod, q)
            self.contacts.add_block(rod, line, q, scaled((a[0], b[0], c[0], a[1], b[1], c[1], a[2], b[2], c[2]), sign))
            if q > 0:
                if rod.begins[q - 1] > 0:
                    begin = q
            q -= 1

    def add_turns(self, rod, line, late, early, at, sign):
        """The same of a weld's rotation u = 2 v by those of both edges: −(s − [v]×) and (s + [v]×) R, with s² = 1 − |v|² and
        the rest rotation R."""
        v = scaled(at.turned, 0.5)
        s = ti.sqrt(ti.max(1.0 - dot(v, v), 0.0 * sign))
        rest = at.rest
        after = (s, 0.0 - v[2], v[1], v[2], s, 0.0 - v[0], 0.0 - v[1], v[0], s)
        before = (0.0 - s, 0.0 - v[2], v[1], v[2], 0.0 - s, 0.0 - v[0], 0.0 - v[1], v[0], 0.0 - s)
        turned = algebra.against_columns(after, directors(rest))
        self.contacts.add_block(rod, line, late + 1, scaled(column_scaled(before, self.freedom(rod, late)), sign))
        self.contacts.add_block(rod, line, early + 1, scaled(column_scaled(turned, self.freedom(rod, early)), sign))

    def keep_forces(self, rod):
        """Keep δλ for the next step. Returns d · δλ, what the border takes from the Newton decrement of H alone."""
        taken = 0.0 * rod.total
        for b in range(rod.borders.shape[0]):
            stepping = self.contacts.group(rod).stepping
            change = self.solution(rod, rod.edges + 1 + b)
            active = self.contacts.tie(rod, rod.borders[b, 0]).active
            taken = taken + active * dot(self.contacts.bordered_miss(rod, b), change)
            self.contacts.bordered_force(rod, b).step = scaled(change, stepping)
        return taken

    # --- welds ---

    def weld(self, rod):
        """Add the energy of all welds, and keep their derivatives."""
        zero = 0.0 * rod.total
        for e in range(rod.edges):
            self.contacts.edge(rod, e).moment = repeated(zero, 3)
        stiffness = self.contacts.group(rod).stiffness * rod.total * rod.total
        for k in range(rod.ties.shape[0]):
            if rod.ties[k, 2] >= 0:
                self.weld_edges(rod, self.contacts.tie(rod, k), rod.ties[k, 2], rod.ties[k, 3], stiffness)

    def weld_edges(self, rod, at, late, early, whole):
        """The same of one weld, whose view is ``at``."""
        stiffness = whole * at.active * at.scale
        rest = at.rest
        turn = relative_rotation(self.edge(rod.head, late).frame, self.edge(rod.head, early).frame)
        r = variable(product(turn, (rest[0], 0.0 - rest[1], 0.0 - rest[2], 0.0 - rest[3])))
        sign = ti.select(r[0] < 0.0, 0.0 * r[0] - 1.0, 0.0 * r[0] + 1.0)
        s, v = sign * r[0], scaled((r[1], r[2], r[3]), sign)
        u = scaled(v, 2.0)
        moment = scaled(at.moment.now, at.active)
        p = plus(moment, scaled(u, stiffness))
        at.turned = u
        work, stretch = dot(moment, u), 0.5 * stiffness * dot(u, u)
        self.contacts.add_penalty(rod, work + stretch, absolute(work) + stretch)
        columns = directors(rest)
        before, after = plus(scaled(p, s), cross(v, p)), minus(scaled(p, s), cross(v, p))
        add(self.contacts.edge(rod, late), moment=negated(before))
        add(self.contacts.edge(rod, early), moment=(dot(columns[0], after), dot(columns[1], after), dot(columns[2], after)))
        own = algebra.own_block(v, stiffness, 0.0 - 0.25 * dot(p, u))
        at.of_late = own
        at.of_early = algebra.seen_from(columns, own)
        at.mixed = algebra.against_columns(algebra.mixed_block(s, v, p, stiffness), columns)

    def add_welds(self, rod):
        """Add the second derivatives of all welds to H."""
        for k in range(rod.ties.shape[0]):
            late, early = rod.ties[k, 2], rod.ties[k, 3]
            if late >= 0:
                at = self.contacts.tie(rod, k)
                free, other = self.freedom(rod, late), self.freedom(rod, early)
                self.contacts.add_diagonal(rod, late + 1, scaled_both(free, full(at.of_late), free))
                self.contacts.add_diagonal(rod, early + 1, scaled_both(other, full(at.of_early), other))
                self.contacts.add_block(rod, late + 1, early + 1, scaled_both(free, at.mixed, other))
