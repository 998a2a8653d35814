"""The Newton system of a rod that may touch itself: a dense matrix, factored as L D Lᵀ (§III-D, docs/contact.md).

A contact of the rod with itself couples two edges that are far from each other along it. The second derivatives K(v, w) of all
energies of places, by those of the vertices v and w, therefore fill a matrix of 3×3 blocks. Vertex v moves with the place of
vertex 0 and with the rotation of every edge before it, δx_v = ξ + Σ_{e<v} A_eᵀ ω_e, so that

    H(e, f) = A_e [Σ_{v>e} Σ_{w>f} K(v, w)] A_fᵀ

besides the terms of bending and twisting and, on the diagonal, those of a force on a curved path. Block 0 belongs to ξ, block
e + 1 to ω_e. The pivots and the Schur complement of closure certify a minimum, as those of a band do.
"""

import taichi as ti

from doo_ti.physics.algebra import largest_of
from doo_ti.physics.closure import closure_rows, linear_gradient, linear_hessian
from doo_ti.physics.quaternion import first_director, second_director, tangent
from doo_ti.physics.tuples import (
    applied,
    column_scaled,
    dot,
    full,
    identity,
    minus,
    negated,
    on_diagonal,
    plus,
    products,
    record,
    repeated,
    row,
    row_scaled,
    scaled,
    shifted,
    traced,
    transposed,
    variable,
)
from doo_ti.relaxation.dense_factors import DenseFactors
from doo_ti.relaxation.elimination import held_pivot


@traced
def symmetric_sum(m) -> tuple:
    """M + Mᵀ, six numbers."""
    return (2.0 * m[0], m[1] + m[3], m[2] + m[6], 2.0 * m[4], m[5] + m[7], 2.0 * m[8])


@traced
def turned_block(left, m, right) -> tuple:
    """A_e M A_fᵀ, where A is 0 in its first row: ``left`` and ``right`` are the other two of both, or three where it is I."""
    rows = [tuple(sum_of(m[3 * k + c] * a[k] for k in range(3)) for c in range(3)) for a in left]
    block = [[sum_of(r[c] * b[c] for c in range(3)) for b in right] for r in rows]
    zero = 0.0 * m[0]
    whole = [[zero] * 3 for _ in range(3)]
    for r, line in enumerate(block):
        for c, value in enumerate(line):
            whole[r + 3 - len(left)][c + 3 - len(right)] = value
    return tuple(value for line in whole for value in line)


def sum_of(values):
    """The sum of some numbers of a kernel."""
    total = None
    for value in values:
        total = value if total is None else total + value
    return total


@ti.data_oriented
class DenseElimination(DenseFactors):
    """The part of a :class:`.LoadedElimination` that solves the Newton system, for rods whose contacts are
    :class:`.SelfContacts`: a class to derive from before the other."""

    @ti.func
    def eliminate(self, rod, shift, search, multiplier, miss):
        """Assemble H + shift and factor it; as :meth:`.LoadedElimination.eliminate`."""
        zero = 0.0 * rod.total
        found = record(squared=zero, scale=zero, negative=zero, slope=zero, energy=zero, magnitude=zero)
        self.clear(rod)
        self.collect(rod, found)
        self.contacts.touch_itself(rod)
        found.energy = found.energy + rod.contacts.energy
        found.magnitude = found.magnitude + rod.contacts.magnitude
        self.sum_columns(rod)
        self.assemble(rod, shift, search, multiplier, found)
        self.factor_rows(rod, found)
        schur, right = self.solve_forward(rod)
        change, positive = self.bordered(rod, schur, plus(right, miss))
        return record(moment=ti.sqrt(found.squared), scale=found.scale, change=change, inertia=found.negative + positive,
                      slope=found.slope, energy=found.energy, magnitude=found.magnitude)

    # --- the energies of places ---

    @ti.func
    def clear(self, rod):
        """Begin the sums of the gradient and of K."""
        zero = 0.0 * rod.total
        size = self.unknowns(rod)
        first = self.contacts.matrix(rod)
        for k in range(size * (size + 1) // 2):
            first[k] = zero
        for v in range(rod.edges + 1):
            self.contacts.own_vertex(rod, v).load = repeated(zero, 3)

    @ti.func
    def collect(self, rod, found):
        """Add the external energy and the contacts with obstacles, edge by edge, to the gradient and to K."""
        end = self.tip(rod)
        for back in range(rod.edges):
            e = rod.edges - 1 - back
            edge = self.edge(rod.head, e)
            t = tangent(edge.frame)
            start = minus(end, scaled(t, edge.length))
            self.add_edge(rod, e, self.load(rod, edge, e, start, end, found))
            end = start
        if ti.static(self.pulls_start):
            energy, gradient, curvature = self.functions.evaluate_start(
                rod.head.outer, scaled(plus(rod.anchor, self.drift(rod)), rod.length_unit))
            found.energy = found.energy + rod.loose * energy
            found.magnitude = found.magnitude + rod.loose * energy
            self.contacts.add_load(rod, 0, scaled(gradient, rod.length_unit))
            self.contacts.add_diagonal(rod, 0, full(scaled(curvature, rod.length_unit * rod.length_unit)))
        self.touch_begin(rod, 0)

    @ti.func
    def add_edge(self, rod, e, load):
        """Add the derivatives of an edge's energy: a function of the start and of the edge, the end less the start."""
        self.contacts.add_load(rod, e, minus(load.gradient, load.gradient_s))
        self.contacts.add_load(rod, e + 1, load.gradient_s)
        late, mixed = full(load.curvature_ss), load.curvature_s
        self.contacts.add_diagonal(rod, e + 1, late)
        self.contacts.add_block(rod, e + 1, e, minus(transposed(mixed), late))
        early = minus(plus(load.curvature, load.curvature_ss), symmetric_sum(mixed))
        self.contacts.add_diagonal(rod, e, full(early))

    @ti.func
    def touch_begin(self, rod, index):
        """Add the contacts of vertex ``index``, where a rod begins, with obstacles."""
        if self.contacts.touched_start(rod, index) == 1:
            self.contacts.add_load(rod, index, rod.contacts.end_gradient)
            self.contacts.add_diagonal(rod, index, full(rod.contacts.end_curvatures))

    # --- H ---

    @ti.func
    def sum_columns(self, rod):
        """From K the sums Σ_{v≥p} K(v, q) off the diagonal and Σ_{v≥p} Σ_{w≥p} K(v, w) on it, in its place."""
        for q in range(rod.edges):
            for back in range(rod.edges - 1 - q):
                p = rod.edges - 1 - back
                self.contacts.add_block(rod, p, q, self.load_block(rod, p + 1, q))
        for back in range(rod.edges):
            p = rod.edges - 1 - back
            both = plus(self.load_diagonal(rod, p + 1), symmetric_sum(self.load_block(rod, p + 1, p)))
            self.contacts.add_diagonal(rod, p, full(both))

    @ti.func
    def levers(self, rod, index):
        """The rows of A of block ``index`` > 0, rotations that are held left out."""
        edge = self.edge(rod.head, index - 1)
        q = edge.frame
        rows = closure_rows(edge.length, first_director(q), second_director(q))
        tilt = self.freedom(rod, index - 1)[1]
        return scaled(row(rows, 1), tilt), scaled(row(rows, 2), tilt)

    @ti.func
    def assemble(self, rod, shift, search, multiplier, found):
        """H + shift in the place of the sums, and the right-hand sides."""
        zero = 0.0 * rod.total
        force = variable(multiplier)
        beyond = zero
        h, g = variable(repeated(zero, 6)), variable(repeated(zero, 3))  # of the pair with the edge after
        for back in range(rod.edges):
            e = rod.edges - 1 - back
            edge = self.edge(rod.head, e)
            q = edge.frame
            t, m1, m2 = tangent(q), first_director(q), second_director(q)
            length = edge.length
            force = plus(force, self.contacts.own_vertex(rod, e + 1).load)
            pull = plus(scaled(rod.gravity, self.hanging_weight(rod, length, beyond)), force)
            beyond = beyond + length
            l1, l2 = linear_gradient(pull, length, m1, m2)
            straighten = linear_hessian(pull, length, t)
            u = variable(repeated(zero, 9))
            h_before, g_before = variable(repeated(zero, 6)), variable(repeated(zero, 3))
            if e > 0:
                previous = self.edge(rod.head, e - 1)
                left, right, h_left, h_right, across = self.derivatives(
                    self.bent(previous.bent), self.stiffness(previous, edge, rod.stiffness))
                g, h = plus(g, right), plus(h, h_right)
                h_before, g_before, u = h_left, left, across
            g = (g[0], g[1] + l1, g[2] + l2)
            h = self.second_derivatives(rod, (h[0], h[1], h[2], h[3] + straighten, h[4], h[5] + straighten), g)
            self.assemble_edge(rod, e, edge, g, h, u, closure_rows(length, m1, m2), (shift, search), found)
            h, g = h_before, g_before
        self.assemble_start(rod, shift, force, found)

    @ti.func
    def assemble_edge(self, rod, e, edge, slope, bent, across, rows, given, found):
        """The row of an edge. ``slope``, ``bent``: the gradient and second derivative by its rotation, without the sums of K;
        ``across``: what couples it with the edge before; ``rows``: those of A; ``given``: the shift and the search."""
        shift, search = given
        free = self.freedom(rod, e)
        g, h = products(free, slope), bent
        # Shifts are measured by bending, not by what contacts far away make of it.
        self.observe(found, g, (free[0] * h[0], h[1], h[2], free[1] * h[3], h[4], free[2] * h[5]))
        self.assemble_row(rod, e + 1, free, across)
        sums = full(self.load_diagonal(rod, e + 1))
        a1, a2 = row(rows, 1), row(rows, 2)
        w1, w2 = applied(sums, a1), applied(sums, a2)
        whole = (h[0], h[1], h[2], h[3] + dot(a1, w1), h[4] + dot(a1, w2), h[5] + dot(a2, w2))
        b, along = self.stirred(edge, e, negated(g), g, search)
        found.slope = found.slope + along
        spin, tilt = self.shifts(rod, edge, shift)
        self.store_diagonal(rod, e + 1, held_pivot(shifted(whole, spin, tilt), free))
        self.store_side(rod, e + 1, products(free, b), scaled(rows, free[1] * rod.closed))

    @ti.func
    def assemble_row(self, rod, line, free, across):
        """The blocks of row ``line`` before the diagonal, from the last: H(p, q) for all q < p; ``across`` couples the edge by
        bending and twisting with the edge before."""
        own = self.levers(rod, line)
        sums = variable(full(self.load_diagonal(rod, line)))
        for back in range(line):
            q = line - 1 - back
            sums = plus(sums, self.load_block(rod, line, q))
            block = variable(repeated(0.0 * rod.total, 9))
            if q > 0:
                block = turned_block(own, sums, self.levers(rod, q))
                if back == 0:
                    bent = column_scaled(row_scaled(transposed(across), free), self.freedom(rod, q - 1))
                    block = plus(block, bent)
            else:
                loose = rod.loose
                start = identity(0.0 * loose)
                block = scaled(turned_block(own, sums, (row(start, 0), row(start, 1), row(start, 2))), loose)
            self.store_block(rod, line, q, block)

    @ti.func
    def assemble_start(self, rod, shift, force, found):
        """Block 0: that of the place of vertex 0."""
        loose = rod.loose
        whole = plus(force, self.contacts.own_vertex(rod, 0).load)
        slope = scaled(plus(whole, scaled(rod.gravity, 2.0 * rod.total)), loose)
        self.observe_moment(found, scaled(slope, rod.total))
        d = self.load_diagonal(rod, 0)
        shifted_start = on_diagonal(d, self.shift_of_start(rod, shift))
        self.store_diagonal(rod, 0, held_pivot(shifted_start, (loose, loose, loose)))
        self.store_side(rod, 0, negated(slope), scaled(identity(0.0 * loose), loose * rod.closed))

    @ti.func
    def store_side(self, rod, line, right, border):
        """Three rows of the right-hand side: that of the step and those of closure."""
        for r in ti.static(range(3)):
            values = (right[r], border[3 * r], border[3 * r + 1], border[3 * r + 2])
            self.side(rod, 3 * line + r).four = values

    @ti.func
    def substitute(self, rod, found):
        """ω = L⁻ᵀ D⁻¹ L⁻¹ (b − A δλ), as :meth:`.LoadedElimination.substitute`, with the way to other parts of the rod too."""
        decrement = self.solve_backward(rod, found.change)
        x = variable(self.solution(rod, 0))
        rod.head.drift_step = x
        self.contacts.own_vertex(rod, 0).move = x
        size = dot(x, x) / (rod.total * rod.total)
        longest = 0.0 * size
        for e in range(rod.edges):
            edge = self.edge(rod.head, e)
            w = self.solution(rod, e + 1)
            edge.rotation = w
            q = edge.frame
            length = edge.length
            change = scaled(minus(scaled(first_director(q), w[2]), scaled(second_director(q), w[1])), length)
            longest = largest_of(longest, self.contacts.approach(rod, e + 1, x, plus(x, change)))
            x = plus(x, change)
            self.contacts.own_vertex(rod, e + 1).move = x
            size = self.longer(size, w)
        longest = largest_of(largest_of(longest, size), self.contacts.approach_itself(rod))
        return ti.sqrt(longest), ti.sqrt(size), decrement
