"""The Newton system of a group: that of a rod that may touch itself, for a chain with breaks between its rods (docs/groups.md).

In the chain a break stands where an edge would. The vertex behind it moves by the unknown ξ of the break, all others
with the begin of their own rod and the rotations of the edges between, so that the sums of second derivatives over all
vertices behind an edge end with its rod.
"""

import taichi as ti

from doo_ti.groups.border import Border
from doo_ti.groups.group_contacts import GroupContacts
from doo_ti.groups.joint_rest import JointRest
from doo_ti.groups.welds import Welds
from doo_ti.physics.algebra import largest_of
from doo_ti.physics.closure import closure_rows, linear_gradient, linear_hessian
from doo_ti.physics.quaternion import first_director, second_director, tangent, turned_in_body
from doo_ti.physics.tuples import (
    chosen,
    column_scaled,
    dot,
    extended,
    full,
    identity,
    minus,
    negated,
    on_diagonal,
    plus,
    products,
    repeated,
    row,
    row_scaled,
    scaled,
    transposed,
    variable,
)
from doo_ti.relaxation.chain import Chain
from doo_ti.relaxation.dense_elimination import DenseElimination, symmetric_sum, turned_block
from doo_ti.relaxation.elimination import held_pivot
from doo_ti.relaxation.loaded_elimination import LoadedElimination


@ti.data_oriented
class GroupElimination(Border, Welds, DenseElimination, LoadedElimination):
    """The chain of a group. No rod is closed: ties hold their far ends."""

    def __init__(self, number, stride: int, contacts: GroupContacts):
        super().__init__(number, False, stride, JointRest, True, contacts)

    @ti.func
    def rest(self, edge):
        """u̅ of the left frame and of the right one, and m̅."""
        own = edge.outer
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
        x = variable(plus(rod.anchor, self.drift(rod)))
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
    def sum_columns(self, rod):
        """As for one rod; the sums begin anew with every rod."""
        for q in range(rod.edges):
            for back in range(rod.edges - 1 - q):
                p = rod.edges - 1 - back
                if rod.begins[p] == 0:
                    self.contacts.add_block(rod, p, q, self.load_block(rod, p + 1, q))
        for back in range(rod.edges):
            p = rod.edges - 1 - back
            if rod.begins[p] == 0:
                both = plus(self.load_diagonal(rod, p + 1), symmetric_sum(self.load_block(rod, p + 1, p)))
                self.contacts.add_diagonal(rod, p, full(both))

    @ti.func
    def levers(self, rod, index):
        """The three rows of A of block ``index``, of a rod's begin those of the identity, with zeros for what is held."""
        zero = 0.0 * rod.total
        a, free = variable(identity(zero)), variable(repeated(rod.loose, 3))
        if index > 0:
            free = self.freedom(rod, index - 1)
            if rod.begins[index - 1] == 0:
                edge = self.edge(rod.head, index - 1)
                q = edge.frame
                a = closure_rows(edge.length, first_director(q), second_director(q))
        return scaled(row(a, 0), free[1]), scaled(row(a, 1), free[1]), scaled(row(a, 2), free[2])

    @ti.func
    def assemble(self, rod, shift, search, multiplier, found):
        """H + shift in the place of the sums, and the right-hand sides."""
        zero = 0.0 * rod.total
        force = variable(repeated(zero, 3))
        h, g = variable(repeated(zero, 6)), variable(repeated(zero, 3))  # of the pair with the edge after
        for back in range(rod.edges):
            e = rod.edges - 1 - back
            edge = self.edge(rod.head, e)
            force = plus(force, self.contacts.own_vertex(rod, e + 1).load)
            u = variable(repeated(zero, 9))
            h_before, g_before = variable(repeated(zero, 6)), variable(repeated(zero, 3))
            if rod.begins[e] > 0:
                self.assemble_row(rod, e + 1, self.freedom(rod, e), u)
                self.assemble_begin(rod, e + 1, self.freedom(rod, e), shift, force, found)
                force = repeated(zero, 3)
            else:
                if e > 0:
                    if rod.begins[e - 1] == 0:
                        previous = self.edge(rod.head, e - 1)
                        left, right, h_left, h_right, across = self.derivatives(
                            self.bent(previous.bent), self.stiffness(previous, edge, rod.stiffness))
                        g, h = plus(g, right), plus(h, h_right)
                        h_before, g_before, u = h_left, left, across
                slope, whole, rows = self.pulled(rod, e, edge, g, h, force)
                self.assemble_edge(rod, e, edge, slope, whole, u, rows, (shift, search), found)
            h, g = h_before, g_before
        force = plus(force, self.contacts.own_vertex(rod, 0).load)
        self.assemble_begin(rod, 0, repeated(rod.loose, 3), shift, force, found)
        self.add_welds(rod)
        self.add_border(rod, search, found)

    @ti.func
    def pulled(self, rod, e, edge, slope, bent, force):
        """Of an edge whose bending and twisting has the gradient ``slope`` and second derivative ``bent``: these with what the
        force on it and its welds add, and the rows of A."""
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
    def assemble_row(self, rod, line, free, across):
        own = self.levers(rod, line)
        sums = variable(full(self.load_diagonal(rod, line)))
        for back in range(line):
            q = line - 1 - back
            if rod.begins[q] > 0:
                sums = repeated(0.0 * rod.total, 9)
            sums = plus(sums, self.load_block(rod, line, q))
            block = variable(turned_block(own, sums, self.levers(rod, q)))
            if back == 0 and q > 0:
                block = plus(block, column_scaled(row_scaled(transposed(across), free), self.freedom(rod, q - 1)))
            self.store_block(rod, line, q, block)

    @ti.func
    def assemble_begin(self, rod, line, free, shift, force, found):
        """The diagonal block and the right-hand side of where a rod begins, all of which bears ``force``."""
        slope = products(free, force)
        self.observe_moment(found, scaled(slope, rod.total))
        tilt = self.shifts(rod, self.edge(rod.head, line), shift)[1]  # of the rod's first edge
        shifted = on_diagonal(self.load_diagonal(rod, line), tilt / (rod.total * rod.total))
        self.store_diagonal(rod, line, held_pivot(shifted, free))
        self.store_side(rod, line, negated(slope), repeated(0.0 * rod.total, 9))

    @ti.func
    def substitute(self, rod, found):
        decrement = self.solve_backward(rod, found.change) + self.keep_forces(rod)
        x = variable(self.solution(rod, 0))
        rod.head.drift_step = x
        self.contacts.own_vertex(rod, 0).move = x
        size = dot(x, x) / (rod.total * rod.total)
        longest = 0.0 * size
        for e in range(rod.edges):
            edge = self.edge(rod.head, e)
            w = self.solution(rod, e + 1)
            following = rod.begins[e]
            if following > 0:
                self.contacts.member(rod, following).begin_step = w
                edge.rotation = repeated(0.0 * longest, 3)
                x = w
                size = largest_of(size, dot(x, x) / (rod.total * rod.total))
                longest = largest_of(longest, self.contacts.approach(rod, e + 1, x, x))
            else:
                edge.rotation = w
                q = edge.frame
                length = edge.length
                change = scaled(minus(scaled(first_director(q), w[2]), scaled(second_director(q), w[1])), length)
                longest = largest_of(longest, self.contacts.approach(rod, e + 1, x, plus(x, change)))
                x = plus(x, change)
                size = self.longer(size, w)
            self.contacts.own_vertex(rod, e + 1).move = x
        longest = largest_of(largest_of(longest, size), self.contacts.approach_itself(rod))
        return ti.sqrt(longest), ti.sqrt(size), decrement
