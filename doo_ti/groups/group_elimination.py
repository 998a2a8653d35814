"""The Newton system of a group: that of a rod that may touch itself, for a chain with breaks between its rods (docs/groups.md).

Ties and welds are a border of it (:mod:`doo_ti.groups.border`).
"""

import taichi as ti

from doo_ti.groups.border import Border
from doo_ti.groups.group_contacts import GroupContacts
from doo_ti.groups.layout import JointRest
from doo_ti.physics.closure import closure_rows, linear_gradient, linear_hessian
from doo_ti.physics.quaternion import first_director, second_director, tangent, turned_in_body
from doo_ti.physics.tuples import chosen, extended, minus, negated, on_diagonal, plus, products, repeated, scaled, variable
from doo_ti.relaxation.chain import Chain
from doo_ti.relaxation.elimination import held_pivot
from doo_ti.relaxation.newton import DenseLoadedElimination


@ti.data_oriented
class GroupElimination(Border, DenseLoadedElimination):
    """The chain of a group. No rod is closed: ties hold their far ends."""

    breaks = True

    def __init__(self, number, stride: int, contacts: GroupContacts):
        super().__init__(number, False, stride, JointRest, True, contacts)

    @ti.func
    def begins(self, rod, e):
        return rod.begins[e]

    @ti.func
    def rest(self, edge):
        """u̅ of the left frame and of the right one, and m̅."""
        own = edge.external
        return (plus(edge.rest, own.left), plus(edge.rest, own.right), own.twist)

    @ti.func
    def rods(self, tables, head, coarse):
        """As of one rod, with what :class:`.GroupContacts` reads."""
        rod = Chain.rods(self, tables, head, coarse)
        return extended(rod, begins=tables.begins, ties=tables.ties, borders=tables.borders, rods=tables.places.shape[1])

    @ti.func
    def freedom(self, rod, edge):
        own = self.contacts.edge(rod, edge)
        return (own.spin, own.tilt, own.tilt)

    # --- the step ---

    @ti.func
    def step(self, rod, scale, moving, before):
        """Frames turned by scale ω, and the rods' begins; nothing has to be closed."""
        zero = 0.0 * scale
        none = repeated(zero, 3)
        stepping = (scale > 0.0) | (scale < 0.0)
        self.contacts.stand_pairs(rod)
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

    @ti.func
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

    @ti.func
    def collect(self, rod, found):
        self.contacts.begin(rod)
        self.find_tips(rod)
        end = variable(self.tip_of(rod, rod.rods - 1))
        self.contacts.look(rod, rod.edges, end)
        for back in range(rod.edges):
            e = rod.edges - 1 - back
            edge = self.edge(rod.head, e)
            following = rod.begins[e]
            if following == 0:
                t = tangent(edge.frame)
                start = minus(end, scaled(t, edge.length))
                self.add_edge(rod, e, self.load(rod, edge, e, start, end, found))
                end = start
            else:
                self.touch_begin(rod, e + 1)
                end = self.tip_of(rod, following - 1)
                self.contacts.look(rod, e, end)
        self.touch_begin(rod, 0)
        self.contacts.hang(rod)
        self.contacts.bind(rod)
        self.weld(rod)

    @ti.func
    def find_tips(self, rod):
        """Where all rods end."""
        x = variable(plus(rod.anchor, rod.head.drift))
        for e in range(rod.edges):
            edge = self.edge(rod.head, e)
            following = rod.begins[e]
            if following > 0:
                self.contacts.member(rod, following - 1).tip = x
                x = self.contacts.member(rod, following).begin
            else:
                x = plus(x, scaled(tangent(edge.frame), edge.length))
        self.contacts.member(rod, rod.rods - 1).tip = x

    @ti.func
    def tip_of(self, rod, index):
        return self.contacts.member(rod, index).tip

    # --- H ---

    @ti.func
    def assemble(self, rod, shift, search, multiplier, found):
        DenseLoadedElimination.assemble(self, rod, shift, search, multiplier, found)
        self.add_welds(rod)
        self.add_border(rod, search, found)

    @ti.func
    def pulled_edge(self, rod, e, edge, slope, bent, force, beyond):
        """As of one rod, with what the welds of the edge add; weight is a force on vertices (:meth:`.GroupContacts.hang`)."""
        q = edge.frame
        t, m1, m2 = tangent(q), first_director(q), second_director(q)
        length = edge.length
        l1, l2 = linear_gradient(force, length, m1, m2)
        straighten = linear_hessian(force, length, t)
        welded = self.contacts.edge(rod, e).moment
        g = plus((slope[0], slope[1] + l1, slope[2] + l2), welded)
        # The second derivatives of welds are by rotation vectors: what spinning before tilting makes of them is added here.
        h = (bent[0], bent[1] - 0.5 * welded[2], bent[2] + 0.5 * welded[1], bent[3] + straighten, bent[4], bent[5] + straighten)
        return g, self.second_derivatives(rod, h, g), closure_rows(length, m1, m2)

    @ti.func
    def assemble_begin(self, rod, line, free, shift, force, found):
        slope = products(free, force)
        self.observe_moment(found, scaled(slope, rod.total))
        tilt = self.shifts(rod, self.edge(rod.head, line), shift)[1]  # of the rod's first edge
        shifted = on_diagonal(self.load_diagonal(rod, line), tilt / (rod.total * rod.total))
        self.store_diagonal(rod, line, held_pivot(shifted, free))
        self.store_side(rod, line, negated(slope), repeated(0.0 * rod.total, 9))

    @ti.func
    def begin_at(self, rod, e, step):
        """Keep the ``step`` of the place behind the break ``e``."""
        self.contacts.member(rod, rod.begins[e]).begin_step = step

    @ti.func
    def substitute(self, rod, found):
        longest, size, decrement = DenseLoadedElimination.substitute(self, rod, found)
        return longest, size, decrement + self.keep_forces(rod)
