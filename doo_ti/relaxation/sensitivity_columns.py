"""The columns of the derivatives of rods at rest, one rod at a time: what :mod:`doo_ti.relaxation.sensitivity_kernel` computes.

Everything about H is Newton's own. H is assembled and eliminated without shift; then for every column b = −∂g/∂θ runs through
the factors, S dλ = Σ W_Aᵀ D⁻¹ W_b, and back-substitution gives dω.
"""

import taichi as ti

from doo_ti.physics.quaternion import first_director, second_director, tangent
from doo_ti.physics.tuples import minus, plus, products, record, repeated, scaled, variable
from doo_ti.physics.view import read, write
from doo_ti.relaxation import tables as of
from doo_ti.relaxation.end_moments import EndMoments
from doo_ti.relaxation.newton_policy import INERTIA_OF_A_MINIMUM, LARGE_TRACE, TRACE
from doo_ti.relaxation.parameter_gradient import NO_MODE

# The loads of a rod: force and moment at its start, force and moment at its end.
START_FORCE, START_MOMENT, END_FORCE, END_MOMENT, LOADS = 0, 3, 6, 9, 12


@ti.data_oriented
class SensitivityColumns(EndMoments):
    """The work of a thread. ``tables`` is the record of the kernel's arrays.

    A class that derives from this one and from an elimination adds ``schur_complement``, ``solve_column`` and ``started``, and,
    where rods touch obstacles, ``load_contacts``, ``hold_start`` and ``pushed``.
    """

    @ti.func
    def work(self, given, thread):
        """Every rod of this thread, and all columns for it."""
        tables = self.completed(given, thread)
        head = self.head(tables.scratch, thread, tables.rest_length.shape[1])
        index = thread
        while index < tables.rods.shape[0]:
            row = tables.rods[index, of.RESULT_ROW]
            self.loading.load(tables, head, 0, index, 0.0)
            rod = self.rods(tables, head, 0.0)
            if ti.static(self.touches):
                self.load_contacts(tables, rod, index)
            unit = head.energy_unit
            self.load_forces(tables, rod, row, unit)
            force = read(tables.results, row, of.FORCE)
            multiplier = (0.0 - force[0] / unit, 0.0 - force[1] / unit, 0.0 - force[2] / unit)
            self.differentiate(tables, rod, index, row, multiplier)
            index += tables.threads

    @ti.func
    def differentiate(self, tables, rod, index, row, multiplier):
        """The moments and all columns of a rod at rest under ``multiplier``, in row ``index`` of the rods and ``row`` of the
        results."""
        unit = rod.head.energy_unit
        if tables.columns == 0:
            self.bend_pairs(rod)
            tables.sound[row] = 1
        else:
            tables.sound[row] = self.is_minimum(rod, multiplier)
        for end in range(2):
            write(tables.moments, row, 3 * end, values=scaled(self.end_moment(rod, end, multiplier), unit))
        schur = self.schur_complement(rod)
        for p in range(tables.columns):
            column = self.column(tables, rod, index, p, multiplier)
            if ti.static(self.touches):
                self.hold_start(rod, column)
            closure = self.assemble_column(rod, column)
            change = self.solve_column(rod, column, schur, closure)
            self.store_column(tables, rod, row, p, column)
            self.store_loads(tables, rod, row, p, column, change)

    @ti.func
    def load_forces(self, tables, rod, row, unit):
        """The forces of obstacles and of point loads beyond every edge, those of row ``row`` of their table if it has any."""
        for e in range(rod.edges):
            edge = self.edge(rod.head, e)
            for k in ti.static(range(3)):
                force = 0.0 * unit
                if tables.beyond.shape[1] == rod.edges:
                    force = tables.beyond[row, e, k] / unit
                edge.outer.beyond[k] = force

    @ti.func
    def is_minimum(self, rod, multiplier):
        """Eliminate H and leave its factors in scratch; returns one where they certify a minimum, else zero.

        A neutral motion shows when H is lowered a trace. Raised by one instead, H keeps the rod from moving along it.
        """
        none = 0.0 * rod.total
        trace = (LARGE_TRACE if ti.static(self.touches) else TRACE) * rod.head.scale
        shift = none - trace
        inertia = none
        for _ in range(2):
            self.bend_pairs(rod)
            inertia = self.eliminate(rod, shift, (none, none), multiplier, repeated(none, 3)).inertia
            shift = ti.select(inertia == INERTIA_OF_A_MINIMUM, none, trace)
        return ti.cast(inertia == INERTIA_OF_A_MINIMUM, ti.i32)

    @ti.func
    def first_changed(self, rod, column):
        """The first edge that a column changes."""
        first = 0
        if column.local:
            first = ti.max(rod.edges - 2, 0)
        return first

    @ti.func
    def held_turn_of(self, rod, e, column):
        """The rotation by which a clamp turns edge ``e``."""
        held = variable(repeated(0.0 * rod.total, 3))
        if e == 0:
            held = column.turn_start
        if e == rod.edges - 1:
            held = column.turn_end
        return held

    @ti.func
    def assemble_column(self, rod, column):
        """∂g/∂θ of every edge, into the place of the step; returns ∂c/∂θ.

        The turns of the edges that clamps hold are part of what changes.
        """
        zero = 0.0 * rod.total
        change = record(pair=repeated(zero, 3), own=repeated(zero, 3), after=repeated(zero, 3), closure=repeated(zero, 3))
        remaining = rod.total
        first = self.first_changed(rod, column)
        for e in range(first):
            edge = self.edge(rod.head, e)
            remaining = remaining - edge.length
            edge.rotation = repeated(zero, 3)
        for e in range(first, rod.edges):
            edge = self.edge(rod.head, e)
            remaining = remaining - edge.length
            seen = self.seen(rod, edge, remaining)
            l1, l2 = self.linear_change(rod, seen, column)
            change.own = (zero, l1, l2)
            change.after = repeated(zero, 3)
            if e < rod.edges - 1 and (column.bends or column.mode != NO_MODE):
                left, right = self.pair_change(rod, e, column)
                change.pair = plus(change.pair, left)
                change.after = right
            if column.turned and (e == 0 or e >= rod.edges - 2):
                self.turn_neighbours(rod, e, column, change)
                self.turn_end(rod, seen, e, column, change)
            if column.stretch != 0.0:
                change.closure = plus(change.closure, scaled(seen.t, column.stretch * seen.length))
            edge.rotation = plus(change.pair, change.own)
            change.pair = change.after
        return minus(change.closure, column.shift)

    @ti.func
    def right_of(self, rod, edge, e, column, more):
        """b of an edge: less ∂g/∂θ and what eliminating adds to it, ``more``; where a clamp holds the edge, and the identity
        stands in H, the clamp's turn."""
        changed = plus(edge.rotation, more)
        return minus(self.held_turn_of(rod, e, column), products(self.freedom(rod, e), changed))

    @ti.func
    def moved_end(self, edge, x, stretch):
        """What the end of an edge moves by, where its start moves by ``x`` and the edge turns by its part of the step."""
        return self.end_of_turned(edge, x, edge.rotation, stretch)

    @ti.func
    def end_of_turned(self, edge, x, w, stretch):
        """x + l (w × t + stretch t), of an edge that turns by ``w`` in its own axes."""
        q = edge.frame
        turned = minus(scaled(first_director(q), w[2]), scaled(second_director(q), w[1]))
        moved = plus(turned, scaled(tangent(q), stretch))
        return plus(x, scaled(moved, edge.length))

    @ti.func
    def store_column(self, tables, rod, row, p, column):
        """dω from the place of the step, and dx, into row ``row`` of the results."""
        stretch = column.stretch
        x = variable(self.started(rod, column))
        for e in range(rod.edges):
            edge = self.edge(rod.head, e)
            for k in ti.static(range(3)):
                tables.vertices[row, e, k, p] = x[k]
                tables.rotations[row, e, k, p] = edge.rotation[k]
            x = self.moved_end(edge, x, stretch)
        for k in ti.static(range(3)):
            tables.vertices[row, rod.edges, k, p] = x[k]

    @ti.func
    def store_loads(self, tables, rod, row, p, column, change):
        """The change of the loads into row ``row`` of the results, where closure's multiplier changes by ``change``.

        Both forces together carry the weight 2 μ L, less what obstacles carry; one of them alone where the other end is free.
        """
        unit = rod.head.energy_unit
        pushed = self.pushed(tables, rod, row, p)
        end = minus(scaled(column.whole, rod.released), change)
        start = scaled(minus(plus(column.whole, pushed.all), end), 1.0 - rod.loose)
        self.put_load(tables, row, p, START_FORCE, start, unit)
        self.put_load(tables, row, p, END_FORCE, end, unit)
        for at in range(2):
            change_there = plus(change, self.own_part(at, pushed.first, pushed.last))
            moment = self.moment_change(rod, at, column, change_there)
            self.put_load(tables, row, p, START_MOMENT + at * (END_MOMENT - START_MOMENT), moment, unit)

    @ti.func
    def put_load(self, tables, row, p, place, v, unit):
        """A force or a moment, in the rod's unit of energy, into column ``p`` of the loads."""
        for k in ti.static(range(3)):
            tables.loads[row, place + k, p] = v[k] * unit

    # --- where rods touch obstacles: :class:`doo_ti.relaxation.contact_sensitivity.ContactSensitivity` ---

    @ti.func
    def pushed(self, tables, rod, row, p):
        """By how much the forces of obstacles change with column ``p``, which is in the results, with the sign of a gradient:
        on ``all`` vertices, and on those after the start of the ``first`` edge and of the ``last``."""
        none = repeated(0.0 * rod.total, 3)
        return record(all=none, first=none, last=none)
