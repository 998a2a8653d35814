"""The derivatives of rods at rest that touch obstacles (docs/contact.md).

A contact that bears a force stays closed, and one without stays open. So H includes the contacts that bear a force: their λ
in the second derivatives of φ, and a large stiffness κ in place of the constraint g = 0. With κ :data:`STIFF` times the
stiffness of an edge the derivatives are off by about one part in so many. Where a contact is about to begin or end, they hold
to one side only.

With the displacements ξ of vertices that a column prescribes, the derivative of the energy of an edge's contacts is K ξ; its
blocks are kept while H is eliminated.
"""

import taichi as ti

from doo_ti.contact.touch import GAP_TOLERANCE
from doo_ti.physics.algebra import against, applied, forward, full, minus_combination, transposed
from doo_ti.physics.number import Layout, Number, device_functions
from doo_ti.physics.pair import linear_gradient
from doo_ti.physics.quaternion import first_director, second_director
from doo_ti.physics.tuples import add, extended, minus, negated, picked, plus, products, record, repeated, scaled, variable
from doo_ti.relaxation import tables as of
from doo_ti.relaxation.contact_table import SOFT
from doo_ti.relaxation.contacts import RodContacts
from doo_ti.relaxation.external import Nothing
from doo_ti.relaxation.loaded_elimination import LoadedElimination
from doo_ti.relaxation.loading import Loading, length_unit
from doo_ti.relaxation.parameter_gradient import KEPT
from doo_ti.relaxation.sensitivity_columns import SensitivityColumns

STIFF = 1e6  # κ over the stiffness B/l³ of the shortest edge
LEAST_FORCE = 1e-6  # of the force to expect of a contact: one that bears less does not count


class Kept(Nothing):
    """No energy, with room for what is kept of an edge: besides what all rods have there the blocks of K, by the displacement
    of the edge's start, by both, and by that of its end beyond its start; and the displacement of its start that a column
    prescribes; and the point load on its end."""

    layout = KEPT + Layout(curvature=6, curvature_s=9, curvature_ss=6, moved=3, load=3)


@device_functions
class ContactsAtRest(RodContacts):
    """The contacts of rods at rest, which push with their forces λ whatever their gaps."""

    def push(self, rod, force, gap):
        """(force, stiffness) of a contact whose λ is ``force``; without energy."""
        least = LEAST_FORCE * SOFT * rod.contacts.radius * rod.contacts.first_stiffness
        acting = force > least
        none = 0.0 * gap
        return record(push=ti.select(acting, force, none), stiffness=ti.select(acting, rod.contacts.stiffness, none),
                      energy=none)


@device_functions
class ContactSensitivity(SensitivityColumns, LoadedElimination):
    """The columns of rods that touch obstacles, or whose vertex 0 is free among them."""

    def __init__(self, stride: int, has_grid: bool):
        number = Number(1, 64)
        super().__init__(number, False, stride, Kept, True, ContactsAtRest(number, has_grid))
        self.loading = Loading(self, in_millimetres=True)

    @picked
    def completed(self, given, thread):
        return extended(LoadedElimination.completed(self, given, thread), tolerance=GAP_TOLERANCE)

    def load_contacts(self, tables, rod, index):
        """Forces from the unit of length in which the rod was relaxed, and κ, of contacts at rest."""
        s, g = tables.rods[index, of.CLAMP_ROW], tables.rods[index, of.MATERIAL_ROW]
        unit = length_unit(tables.clamp[s, of.TOTAL])
        edge = 0.5 * tables.clamp[s, of.SHORTEST_PAIR]
        bend = tables.material[g, of.LARGEST_BEND] / rod.head.energy_unit
        contacts = self.contacts
        rod.contacts.stiffness = STIFF * bend / (edge * edge * edge)
        for v in range(rod.edges + 1):
            for o in range(rod.obstacles):
                contact = contacts.contact(contacts.vertex(rod, v), o)
                contact.force = contact.force / (unit * unit)
                contact.force_between = contact.force_between / (unit * unit)
                contact.kept_between = ti.select(contact.force_between > 0.0, 1.0, 0.0)
        row = ti.min(tables.rods[index, of.RESULT_ROW], tables.point_loads.shape[0] - 1)
        for e in range(rod.edges):
            vertex = ti.min(e + 1, tables.point_loads.shape[1] - 1)
            for k in ti.static(range(3)):
                self.edge(rod.head, e).external.load[k] = tables.point_loads[row, vertex, k] / rod.head.energy_unit

    def load(self, rod, edge, e, start, end, found):
        """With the point load on the edge's end; keeps the blocks of K of the edge."""
        load = LoadedElimination.load(self, rod, edge, e, start, end, found)
        force = negated(edge.external.load)
        add(load, gradient=force, gradient_s=force, known=force, known_s=force)
        own = edge.external
        own.curvature, own.curvature_s, own.curvature_ss = load.curvature, load.curvature_s, load.curvature_ss
        return load

    def hold_start(self, rod, column):
        """Where vertex 0 is free no clamp moves it, and it is the far point that ``shift`` moves."""
        column.shift = plus(column.shift, scaled(column.move, rod.loose))
        column.move = scaled(column.move, 1.0 - rod.loose)

    def pushes(self, edge, before, after):
        """K ξ of an edge whose ends move so: by the displacement of its start, and by that of its end beyond its start."""
        k, mixed, kss = edge.external.curvature, edge.external.curvature_s, edge.external.curvature_ss
        along = minus(after, before)
        return (plus(applied(full(k), before), applied(mixed, along)),
                plus(applied(transposed(mixed), before), applied(full(kss), along)))

    def solve_column(self, rod, column, schur, closure):
        """dω into the place of the step and ξ of a free vertex 0 into that of its own; returns dλ."""
        zero = 0.0 * rod.total
        right = variable(closure)
        c, f = variable(repeated(zero, 3)), variable(repeated(zero, 3))
        after = variable(column.move)
        for e in range(rod.edges):  # keep the displacements that the column prescribes, of clamps and of lengths
            edge = self.edge(rod.head, e)
            edge.external.moved = after
            after = self.end_of_turned(edge, after, self.held_turn_of(rod, e, column), column.stretch)
        for back in range(rod.edges):
            e = rod.edges - 1 - back
            edge = self.edge(rod.head, e)
            q = edge.frame
            before = edge.external.moved
            pushed, own = self.pushes(edge, before, after)
            m1, m2 = first_director(q), second_director(q)
            r1, r2 = linear_gradient(plus(own, c), edge.length, m1, m2)
            d = edge.pivots
            wb = forward(d, self.right_of(rod, edge, e, column, plus(f, (zero, r1, r2))))
            edge.rotation = wb
            right = plus(right, against(d, edge.force_border, wb))
            c = plus(plus(c, pushed), against(d, edge.border, wb))
            f = against(d, edge.neighbour, wb)
            after = before
        d = rod.head.drift_pivots  # of a free vertex 0, which the rest of the rod pulls by c
        wb = forward(d, scaled(negated(plus(c, column.whole)), rod.loose))
        rod.head.drift_step = wb
        right = plus(right, against(d, rod.head.drift_border, wb))
        change, positive = self.bordered(rod, schur, right)
        # Back-substitution from vertex 0 on. The turns of held edges are prescribed: they do not count as displacements.
        w = variable(repeated(zero, 3))
        start, decrement = self.solved_start(rod, change)
        x = variable(start)
        for e in range(rod.edges):
            edge = self.edge(rod.head, e)
            without = minus_combination(self.without_multiplier(edge, change), edge.border, x)
            w = products(self.freedom(rod, e), self.solved_edge(edge, without, w))
            x = self.end_of_turned(edge, x, w, zero)
        return change

    def started(self, rod, column):
        """What vertex 0 moves by."""
        return plus(column.move, scaled(rod.head.drift_step, rod.loose))

    def pushed(self, tables, rod, index, p):
        """By how much the forces of obstacles change with column ``p``, with the sign of a gradient."""
        zero, row = 0.0 * rod.total, tables.rods[index, of.RESULT_ROW]
        after = variable(self.stored_move(tables, row, rod.edges, p))
        every, first, last = variable(repeated(zero, 3)), variable(repeated(zero, 3)), variable(repeated(zero, 3))
        for back in range(rod.edges):
            e = rod.edges - 1 - back
            before = self.stored_move(tables, row, e, p)
            whole, own = self.pushes(self.edge(rod.head, e), before, after)
            first = plus(every, own)
            if back == 0:
                last = first
            every = plus(every, whole)
            after = before
        return record(all=every, first=first, last=last)

    def stored_move(self, tables, row, vertex, p):
        """What a vertex moves by with column ``p``, from the results."""
        return (tables.vertices[row, vertex, 0, p], tables.vertices[row, vertex, 1, p], tables.vertices[row, vertex, 2, p])
