"""The derivatives of rods at rest that touch obstacles (docs/contact.md).

A contact that bears a force stays closed, and one without stays open. So H includes the contacts that bear a force: their λ
in the second derivatives of φ, and a large stiffness κ in place of the constraint g = 0. With κ :data:`STIFF` times the
stiffness of an edge the derivatives are off by about one part in so many. Where a contact is about to begin or end, they hold
to one side only.

With the displacements ξ of vertices that a column prescribes, the derivative of the energy of an edge's contacts is K ξ; its
blocks are kept while H is eliminated.
"""

import taichi as ti

from doo_ti.physics.closure import linear_gradient
from doo_ti.physics.number import Number
from doo_ti.physics.quaternion import first_director, second_director
from doo_ti.physics.tuples import (
    against,
    applied,
    forward,
    full,
    minus,
    negated,
    plus,
    products,
    record,
    repeated,
    scaled,
    symmetric_gram,
    transposed,
    variable,
)
from doo_ti.relaxation import chain
from doo_ti.relaxation import tables as of
from doo_ti.relaxation.contact_layout import ACTIVE, FIRST_STIFFNESS, FORCE, FORCE_BETWEEN, RADIUS, SOFT, STIFFNESS
from doo_ti.relaxation.contacts import Contacts
from doo_ti.relaxation.external import Nothing
from doo_ti.relaxation.loaded_elimination import LoadedElimination
from doo_ti.relaxation.loading import Loading, length_unit
from doo_ti.relaxation.parameter_gradient import FIRST_FREE_ITEM, KEPT
from doo_ti.relaxation.sensitivity_columns import SensitivityColumns

STIFF = 1e6
"""κ over the stiffness B/l³ of the shortest edge."""
LEAST_FORCE = 1e-6
"""Of the force to expect of a contact: one that bears less does not count."""

# Items of an edge: the blocks of K, by the displacement of the edge's start, by both, and by that of its end beyond its start;
# and the displacement of its start that a column prescribes.
CURVATURE, CURVATURE_S, CURVATURE_SS, MOVED, LAST_ITEM = (FIRST_FREE_ITEM + k for k in (0, 6, 15, 21, 24))


class Kept(Nothing):
    """No energy, with room for what is kept of an edge."""

    items = LAST_ITEM - KEPT


@ti.data_oriented
class ContactsAtRest(Contacts):
    """The contacts of rods at rest, which push with their forces λ whatever their gaps."""

    @ti.func
    def push(self, rod, force, gap):
        """(force, stiffness) of a contact whose λ is ``force``; without energy."""
        least = LEAST_FORCE * SOFT * self.item(rod, RADIUS) * self.item(rod, FIRST_STIFFNESS)
        acting = force > least
        none = 0.0 * gap
        return record(push=ti.select(acting, force, none), stiffness=ti.select(acting, self.item(rod, STIFFNESS), none),
                      energy=none)


@ti.data_oriented
class ContactSensitivity(SensitivityColumns, LoadedElimination):
    """The columns of rods that touch obstacles of those ``kinds``, or whose vertex 0 is free among them."""

    def __init__(self, stride: int, kinds: frozenset[int]):
        number = Number(1, 64)
        super().__init__(number, False, stride, Kept, True, ContactsAtRest(number, stride, kinds))
        self.loading = Loading(self, self.functions, in_millimetres=True)

    @ti.func
    def load_contacts(self, tables, rod, index):
        """Forces from the unit of length in which the rod was relaxed, and κ, of contacts at rest."""
        s, g = tables.rods[index, of.CLAMP_ROW], tables.rods[index, of.MATERIAL_ROW]
        unit = length_unit(tables.clamp[s, of.TOTAL])
        edge = 0.5 * tables.clamp[s, of.SHORTEST_PAIR]
        bend = tables.material[g, of.LARGEST_BEND] / rod.scratch[rod.head + chain.OF_ENERGY_UNIT * self.stride]
        contacts = self.contacts
        contacts.set_item(rod, STIFFNESS, rod.total > 0.0, STIFF * bend / (edge * edge * edge))
        for v in range(rod.edges + 1):
            for o in range(rod.obstacles):
                contact = contacts.contact(contacts.vertex(rod, v), o)
                for item in ti.static((FORCE, FORCE_BETWEEN)):
                    at = contact + item * self.stride
                    rod.scratch[at] = rod.scratch[at] / (unit * unit)
                between = rod.scratch[contact + FORCE_BETWEEN * self.stride] > 0.0
                rod.scratch[contact + ACTIVE * self.stride] = ti.select(between, 1.0, 0.0)

    @ti.func
    def keep_load(self, rod, at, load):
        """Keep the blocks of K of an edge."""
        self.store(rod.scratch, at + CURVATURE * self.stride, load.curvature + load.curvature_s + load.curvature_ss)

    @ti.func
    def hold_start(self, rod, column):
        """Where vertex 0 is free no clamp moves it, and it is the far point that ``shift`` moves."""
        column.shift = plus(column.shift, scaled(column.move, rod.loose))
        column.move = scaled(column.move, 1.0 - rod.loose)

    @ti.func
    def schur_complement(self, rod):
        """S = Σ W_λᵀ D⁻¹ W_λ, vertex 0 included where it is free."""
        kept = rod.head + chain.OF_DRIFT_FACTORS * self.stride
        s = variable(symmetric_gram(self.load6(rod.scratch, kept + 9 * self.stride), self.load9(rod.scratch, kept)))
        at = rod.origin
        for _ in range(rod.edges):
            f, wu, wz = self.factors(rod, at)
            s = plus(s, symmetric_gram(f, self.load9(rod.scratch, at + self.force_columns * self.stride)))
            at += self.edge_stride
        return s

    @ti.func
    def pushes(self, rod, at, before, after):
        """K ξ of an edge whose ends move so: by the displacement of its start, and by that of its end beyond its start."""
        k = self.load6(rod.scratch, at + CURVATURE * self.stride)
        mixed = self.load9(rod.scratch, at + CURVATURE_S * self.stride)
        kss = self.load6(rod.scratch, at + CURVATURE_SS * self.stride)
        along = minus(after, before)
        return (plus(applied(full(k), before), applied(mixed, along)),
                plus(applied(transposed(mixed), before), applied(full(kss), along)))

    @ti.func
    def prescribe(self, rod, column):
        """Keep the displacements that the column prescribes, of clamps and of lengths; returns that of the far end."""
        moved = variable(column.move)
        at = rod.origin
        for e in range(rod.edges):
            self.store(rod.scratch, at + MOVED * self.stride, moved)
            moved = self.end_of_turned(rod, at, moved, self.held_turn_of(rod, e, column), column.stretch)
            at += self.edge_stride
        return moved

    @ti.func
    def solve_column(self, rod, column, schur, closure):
        """dω into the place of the step and ξ of a free vertex 0 into that of its own; returns dλ."""
        zero = 0.0 * rod.total
        right = variable(closure)
        c, f = variable(repeated(zero, 3)), variable(repeated(zero, 3))
        after = variable(self.prescribe(rod, column))
        at = rod.origin + (rod.edges - 1) * self.edge_stride
        for back in range(rod.edges):
            e = rod.edges - 1 - back
            q = self.load4(rod.scratch, at)
            before = self.load3(rod.scratch, at + MOVED * self.stride)
            pushed, own = self.pushes(rod, at, before, after)
            m1, m2 = first_director(q), second_director(q)
            r1, r2 = linear_gradient(plus(own, c), self.length_at(rod, at), m1, m2)
            d, wu, wz = self.factors(rod, at)
            wb = forward(d, self.right_of(rod, at, e, column, plus(f, (zero, r1, r2))))
            self.store(rod.scratch, at + chain.ROTATION * self.stride, wb)
            right = plus(right, against(d, self.load9(rod.scratch, at + self.force_columns * self.stride), wb))
            c = plus(plus(c, pushed), against(d, wz, wb))
            f = against(d, wu, wb)
            after = before
            at -= self.edge_stride
        right = plus(right, self.solve_start(rod, column, c))
        change, positive = self.bordered(rod, schur, right)
        self.substitute_column(rod, change)
        return change

    @ti.func
    def solve_start(self, rod, column, c):
        """W_b of a free vertex 0 into its place, where the rest of the rod pulls it by ``c``; returns W_λᵀ D⁻¹ W_b."""
        kept = rod.head + chain.OF_DRIFT_FACTORS * self.stride
        d = self.load6(rod.scratch, kept + 9 * self.stride)
        wb = forward(d, scaled(negated(plus(c, self.weight_change(rod, column))), rod.loose))
        self.store(rod.scratch, rod.head + chain.OF_DRIFT_STEP * self.stride, wb)
        return against(d, self.load9(rod.scratch, kept), wb)

    @ti.func
    def substitute_column(self, rod, change):
        """Back-substitution from vertex 0 on. The turns of held edges are prescribed: they do not count as displacements."""
        w = variable(repeated(0.0 * rod.total, 3))
        start, decrement = self.solved_start(rod, change)
        x = variable(start)
        at = rod.origin
        for e in range(rod.edges):
            right = self.less_displaced(rod, at, self.without_multiplier(rod, at, change), x)
            w = products(self.freedom(rod, e), self.solved_edge(rod, at, right, w))
            x = self.end_of_turned(rod, at, x, w, 0.0 * rod.total)
            at += self.edge_stride

    @ti.func
    def started(self, rod, column):
        """What vertex 0 moves by."""
        drift = self.load3(rod.scratch, rod.head + chain.OF_DRIFT_STEP * self.stride)
        return plus(column.move, scaled(drift, rod.loose))

    @ti.func
    def pushed(self, tables, rod, row, p):
        """By how much the forces of obstacles change with column ``p``, with the sign of a gradient."""
        zero = 0.0 * rod.total
        after = variable(self.stored_move(tables, row, rod.edges, p))
        every, first, last = variable(repeated(zero, 3)), variable(repeated(zero, 3)), variable(repeated(zero, 3))
        at = rod.origin + (rod.edges - 1) * self.edge_stride
        for back in range(rod.edges):
            before = self.stored_move(tables, row, rod.edges - 1 - back, p)
            whole, own = self.pushes(rod, at, before, after)
            first = plus(every, own)
            if back == 0:
                last = first
            every = plus(every, whole)
            after = before
            at -= self.edge_stride
        return record(all=every, first=first, last=last)

    @ti.func
    def stored_move(self, tables, row, vertex, p):
        """What a vertex moves by with column ``p``, from the results."""
        return (tables.vertices[row, vertex, 0, p], tables.vertices[row, vertex, 1, p], tables.vertices[row, vertex, 2, p])
