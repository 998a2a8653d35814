"""The columns of the derivatives of rods at rest, a pack of rods at a time: what
:mod:`doo_ti.relaxation.sensitivity_kernel` computes.

Everything about H is Newton's own. H is assembled and eliminated without shift; then for every column b = −∂g/∂θ runs through
the factors, S dλ = Σ W_Aᵀ D⁻¹ W_b, and back-substitution gives dω.
"""

import taichi as ti

from doo_ti.physics.number import device_functions, read
from doo_ti.physics.quaternion import first_director, second_director, tangent
from doo_ti.physics.tuples import minus, plus, products, put_lane, record, repeated, scaled, variable
from doo_ti.relaxation import tables as of
from doo_ti.relaxation.newton_policy import INERTIA_OF_A_MINIMUM, LARGE_TRACE, TRACE
from doo_ti.relaxation.parameter_gradient import NO_MODE, ParameterGradient

# The loads of a rod: force and moment at its start, force and moment at its end.
START_FORCE, START_MOMENT, END_FORCE, END_MOMENT, LOADS = 0, 1, 2, 3, 4


@device_functions
class SensitivityColumns(ParameterGradient):
    """The work of a thread. ``tables`` is the record of the kernel's arrays.

    A class that derives from this one and from an elimination adds ``schur_complement``, ``solve_column`` and ``started``, and,
    where rods touch obstacles, ``load_contacts``, ``hold_start`` and ``pushed``.
    """

    def work(self, given, thread):
        """Every rod of this thread, and all columns for it."""
        tables = self.completed(given, thread)
        head = self.head(tables.scratch, thread, tables.rest_length.shape[1])
        index, last = thread * self.width, tables.rods.shape[0] - 1
        while index <= last:
            none = self.constant(0.0)
            known = record(multiplier=repeated(none, 3), holds=repeated(none, 4), weight=none)
            for slot in range(self.width):  # the last rod also fills the lanes that have none
                self.load_lane(tables, head, slot, ti.min(index + slot, last), known)
            rod = self.rods(tables, head, 0.0)
            if ti.static(self.touches):
                self.load_contacts(tables, rod, index)
            self.differentiate(tables, rod, index, known)
            index += tables.threads * self.width

    def load_lane(self, tables, head, slot, index, known):
        """Row ``index`` of the rods into lane ``slot``; into the record ``known`` the multiplier λ of its equilibrium, which of
        (spin_start, spin_end, tilt_start, tilt_end) clamps hold, as ones, and its weight."""
        self.loading.load(tables, head, slot, index, 0.0)
        lane, row = head.lane(slot), tables.rods[index, of.RESULT_ROW]
        unit = lane.energy_unit
        for e in range(tables.rest_length.shape[1]):
            force = variable(repeated(0.0 * unit, 3))
            if tables.beyond.shape[1] == tables.rest_length.shape[1]:
                force = scaled(read(tables.beyond, row, e, 0), 1.0 / unit)
            self.edge(lane, e).external.beyond = force
        free = read(tables.clamp, tables.rods[index, of.CLAMP_ROW], of.SPIN_START, count=4)
        put_lane(known, self.with_lane, slot, multiplier=scaled(read(tables.results, row, of.FORCE), 0.0 - 1.0 / unit),
                 holds=minus(repeated(1.0, 4), free), weight=tables.material[tables.rods[index, of.MATERIAL_ROW], of.WEIGHT])

    def differentiate(self, tables, rod, index, known):
        """The moments and all columns of the rods at rest whose rows of the rods begin with ``index``."""
        sound = 0.0 * rod.total + 1.0
        if tables.columns == 0:
            self.bend_pairs(rod)
            for end in range(2):  # only the gradients of the pairs there, which need no elimination
                joint = end * (rod.edges - 2)
                bent, s = self.kept_pair(rod, joint)
                kept = self.edge(rod.head, joint).external.pair
                kept.left, kept.right = self.gradient_of(bent, s)
        else:
            sound = self.is_minimum(rod, known.multiplier)
        for slot in ti.static(range(self.width)):
            if index + slot < tables.rods.shape[0]:
                tables.sound[tables.rods[index + slot, of.RESULT_ROW]] = ti.cast(self.lane(sound, slot), ti.i32)
        for end in range(2):
            moment = scaled(self.end_moment(rod, end, known.multiplier), rod.head.energy_unit)
            self.store(tables, tables.moments, index, end, 0, moment)
        schur = self.schur_complement(rod)
        for p in range(tables.columns):
            column = self.column(tables, rod, p, known)
            if ti.static(self.touches):
                self.hold_start(rod, column)
            closure = self.assemble_column(rod, column)
            change = self.solve_column(rod, column, schur, closure)
            self.store_column(tables, rod, index, p, column)
            if tables.loads.shape[2] == 3:
                self.store_loads(tables, rod, index, p, column, change)

    def is_minimum(self, rod, multiplier):
        """Eliminate H and leave its factors in scratch; returns one where they certify a minimum, zero elsewhere.

        A neutral motion shows when H is lowered a trace. Raised by one instead, H keeps the rod from moving along it.
        """
        none = 0.0 * rod.total
        trace = (LARGE_TRACE if ti.static(self.touches) else TRACE) * rod.evenness * rod.head.scale
        shift = none - trace
        inertia = none
        for _ in range(2):
            self.bend_pairs(rod)
            inertia = self.eliminate(rod, shift, (none, none), multiplier, repeated(none, 3)).inertia
            shift = ti.select(inertia == INERTIA_OF_A_MINIMUM, none, trace)
        return ti.select(inertia == INERTIA_OF_A_MINIMUM, none + 1.0, none)

    def first_changed(self, rod, column):
        """The first edge that a column changes."""
        first = 0
        if column.local:
            first = ti.max(rod.edges - 2, 0)
        return first

    def held_turn_of(self, rod, e, column):
        """The rotation by which a clamp turns edge ``e``."""
        held = variable(repeated(0.0 * rod.total, 3))
        if e == 0:
            held = column.turn_start
        if e == rod.edges - 1:
            held = column.turn_end
        return held

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
            if column.stretches:
                change.closure = plus(change.closure, scaled(seen.t, column.stretch * seen.length))
            edge.rotation = plus(change.pair, change.own)
            change.pair = change.after
        return minus(change.closure, column.shift)

    def right_of(self, rod, edge, e, column, more):
        """b of an edge: less ∂g/∂θ and what eliminating adds to it, ``more``; where a clamp holds the edge, and the identity
        stands in H, the clamp's turn."""
        changed = plus(edge.rotation, more)
        return minus(self.held_turn_of(rod, e, column), products(self.freedom(rod, e), changed))

    def end_of_turned(self, edge, x, w, stretch):
        """x + l (w × t + stretch t): what the end of an edge moves by whose start moves by ``x`` and which turns by ``w`` in
        its own axes."""
        q = edge.frame
        turned = minus(scaled(first_director(q), w[2]), scaled(second_director(q), w[1]))
        moved = plus(turned, scaled(tangent(q), stretch))
        return plus(x, scaled(moved, edge.length))

    def store_column(self, tables, rod, index, p, column):
        """dω from the place of the step, and dx, into the results."""
        x = variable(self.started(rod, column))
        for e in range(rod.edges):
            edge = self.edge(rod.head, e)
            self.store(tables, tables.vertices, index, e, p, x)
            if tables.rotations.shape[2] == 3:
                self.store(tables, tables.rotations, index, e, p, edge.rotation)
            x = self.end_of_turned(edge, x, edge.rotation, column.stretch)
        self.store(tables, tables.vertices, index, rod.edges, p, x)

    def store(self, tables, array: ti.template(), index, place, p, v):
        """A vector of each rod from row ``index`` on into column ``p`` at ``place`` of its row."""
        for slot in ti.static(range(self.width)):
            if index + slot < tables.rods.shape[0]:
                row = tables.rods[index + slot, of.RESULT_ROW]
                for k in ti.static(range(3)):
                    array[row, place, k, p] = self.lane(v[k], slot)

    def store_loads(self, tables, rod, index, p, column, change):
        """The change of the loads into the results, where closure's multiplier changes by ``change``.

        Both forces together carry the weight 2 μ L, less what obstacles carry; one of them alone where the other end is free.
        """
        unit = rod.head.energy_unit
        pushed = self.pushed(tables, rod, index, p)
        end = minus(scaled(column.whole, rod.released), change)
        start = scaled(minus(plus(column.whole, pushed.all), end), 1.0 - rod.loose)
        self.store(tables, tables.loads, index, START_FORCE, p, scaled(start, unit))
        self.store(tables, tables.loads, index, END_FORCE, p, scaled(end, unit))
        for at in range(2):
            change_there = plus(change, self.own_part(at, pushed.first, pushed.last))
            moment = self.moment_change(rod, at, column, change_there)
            self.store(tables, tables.loads, index, START_MOMENT + at * (END_MOMENT - START_MOMENT), p, scaled(moment, unit))

    # --- where rods touch obstacles: :class:`doo_ti.relaxation.contact_sensitivity.ContactSensitivity` ---

    def pushed(self, tables, rod, index, p):
        """By how much the forces of obstacles change with column ``p``, which is in the results, with the sign of a gradient:
        on ``all`` vertices, and on those after the start of the ``first`` edge and of the ``last``."""
        none = repeated(0.0 * rod.total, 3)
        return record(all=none, first=none, last=none)
