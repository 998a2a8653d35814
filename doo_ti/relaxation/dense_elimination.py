"""The Newton system of a rod that may touch itself: a dense matrix, factored as L D Lᵀ (§III-D, docs/contact.md).

A contact of the rod with itself couples two edges that are far from each other along it. The second derivatives K(v, w) of all
energies of places, by those of the vertices v and w, therefore fill a matrix of 3×3 blocks. Vertex v moves with the place of
vertex 0 and with the rotation of every edge before it, δx_v = ξ + Σ_{e<v} A_eᵀ ω_e, so that

    H(e, f) = A_e [Σ_{v>e} Σ_{w>f} K(v, w)] A_fᵀ

besides the terms of bending and twisting and, on the diagonal, those of a force on a curved path. Block 0 belongs to ξ, block
e + 1 to ω_e. The pivots and the Schur complement of closure certify a minimum, as those of a band do.

The chain of a group (:mod:`doo_ti.groups.group_elimination`) has breaks between its rods. A break stands where an edge would;
its unknown is the place ξ of the vertex behind it, where sums over vertices begin anew.
"""

import taichi as ti

from doo_ti.physics.algebra import applied, full, identity, largest_of, on_diagonal, row, scaled_both, shifted, transposed
from doo_ti.physics.number import device_functions
from doo_ti.physics.pair import closure_rows, linear_gradient, linear_hessian, shift_of_end
from doo_ti.physics.quaternion import directors, first_director, second_director, tangent
from doo_ti.physics.tuples import dot, minus, negated, plus, products, repeated, scaled, traced, variable
from doo_ti.relaxation.dense_factors import DenseFactors
from doo_ti.relaxation.elimination import held_pivot


@traced
def symmetric_sum(m) -> tuple:
    """M + Mᵀ, six numbers."""
    return (2.0 * m[0], m[1] + m[3], m[2] + m[6], 2.0 * m[4], m[5] + m[7], 2.0 * m[8])


@traced
def turned_block(left, m, right) -> tuple:
    """A_e M A_fᵀ, of the rows of both A."""
    rows = [tuple(dot(m[c::3], a) for c in range(3)) for a in left]
    return tuple(dot(r, b) for r in rows for b in right)


@device_functions
class DenseElimination(DenseFactors):
    """The part of a :class:`.LoadedElimination` that solves the Newton system, for rods whose contacts are
    :class:`.SelfContacts`: a class to derive from before the other. ``breaks``: the chain is that of a group."""

    breaks = False

    def begins(self, rod, e):
        """Of a break the number of the rod behind it, else zero."""
        return 0

    def cross_break(self, rod, e):
        """From the rod behind a break to the one before: where that ends."""
        return rod.target

    def eliminate(self, rod, shift, search, multiplier, miss):
        """Assemble H + shift and factor it; as :meth:`.LoadedElimination.eliminate`."""
        found = self.nothing_found(rod)
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
        return self.result(found, change, positive)

    # --- the energies of places ---

    def clear(self, rod):
        """Begin the sums of the gradient and of K."""
        zero = 0.0 * rod.total
        size = self.unknowns(rod)
        first = self.contacts.matrix(rod)
        for k in range(size * (size + 1) // 2):
            first[k] = zero
        for v in range(rod.edges + 1):
            self.contacts.own_vertex(rod, v).load = repeated(zero, 3)

    def collect(self, rod, found):
        """Add the external energy and the contacts with obstacles, edge by edge, to the gradient and to K."""
        end = variable(self.tip(rod))
        for back in range(rod.edges):
            e = rod.edges - 1 - back
            edge = self.edge(rod.head, e)
            if self.begins(rod, e) == 0:
                start = minus(end, scaled(tangent(edge.frame), edge.length))
                self.add_edge(rod, e, self.load(rod, edge, e, start, end, found))
                end = start
            else:
                end = self.cross_break(rod, e)
        if ti.static(self.pulls_start):
            gradient, curvature = self.load_start(rod, found)
            self.contacts.add_load(rod, 0, gradient)
            self.contacts.add_diagonal(rod, 0, full(curvature))
        self.touch_begin(rod, 0)

    def add_edge(self, rod, e, load):
        """Add the derivatives of an edge's energy: a function of the start and of the edge, the end less the start."""
        self.contacts.add_load(rod, e, minus(load.gradient, load.gradient_s))
        self.contacts.add_load(rod, e + 1, load.gradient_s)
        of_end, mixed = full(load.curvature_ss), load.curvature_s
        self.contacts.add_diagonal(rod, e + 1, of_end)
        self.contacts.add_block(rod, e + 1, e, minus(transposed(mixed), of_end))
        of_start = minus(plus(load.curvature, load.curvature_ss), symmetric_sum(mixed))
        self.contacts.add_diagonal(rod, e, full(of_start))

    def touch_begin(self, rod, index):
        """Add the contacts of vertex ``index``, where a rod begins, with obstacles."""
        if self.contacts.touched_start(rod, index) == 1:
            self.contacts.add_load(rod, index, rod.contacts.end_gradient)
            self.contacts.add_diagonal(rod, index, full(rod.contacts.end_curvatures))

    # --- H ---

    def sum_columns(self, rod):
        """From K the sums Σ_{v≥p} K(v, q) off the diagonal and Σ_{v≥p} Σ_{w≥p} K(v, w) on it, in its place."""
        for q in range(rod.edges):
            for back in range(rod.edges - 1 - q):
                p = rod.edges - 1 - back
                if self.begins(rod, p) == 0:
                    self.contacts.add_block(rod, p, q, self.load_block(rod, p + 1, q))
        for back in range(rod.edges):
            p = rod.edges - 1 - back
            if self.begins(rod, p) == 0:
                both = plus(self.load_diagonal(rod, p + 1), symmetric_sum(self.load_block(rod, p + 1, p)))
                self.contacts.add_diagonal(rod, p, full(both))

    def levers(self, rod, index):
        """The rows of A of block ``index``, with zeros for what is held: the identity where a rod begins."""
        a, free = variable(identity(0.0 * rod.total)), variable(repeated(rod.loose, 3))
        if index > 0:
            free = self.freedom(rod, index - 1)
            if self.begins(rod, index - 1) == 0:
                edge = self.edge(rod.head, index - 1)
                q = edge.frame
                a = closure_rows(edge.length, first_director(q), second_director(q))
        return scaled(row(a, 0), free[1]), scaled(row(a, 1), free[1]), scaled(row(a, 2), free[2])

    def assemble(self, rod, shift, search, multiplier, found):
        """H + shift in the place of the sums, and the right-hand sides."""
        zero = 0.0 * rod.total
        force = variable(multiplier)
        beyond = zero
        h, g = variable(repeated(zero, 6)), variable(repeated(zero, 3))  # of the pair with the edge after
        for back in range(rod.edges):
            e = rod.edges - 1 - back
            edge = self.edge(rod.head, e)
            force = plus(force, self.contacts.own_vertex(rod, e + 1).load)
            u = variable(repeated(zero, 9))
            h_before, g_before = variable(repeated(zero, 6)), variable(repeated(zero, 3))
            if self.begins(rod, e) > 0:
                self.assemble_row(rod, e + 1, self.freedom(rod, e), u)
                self.assemble_begin(rod, e + 1, self.freedom(rod, e), shift, force, found)
                force = repeated(zero, 3)
            else:
                if e > 0:
                    if self.begins(rod, e - 1) == 0:
                        previous = self.edge(rod.head, e - 1)
                        left, right, h_left, h_right, across = self.derivatives(
                            self.bent(previous.bent), self.stiffness(previous, edge, rod.stiffness))
                        g, h = plus(g, right), plus(h, h_right)
                        h_before, g_before, u = h_left, left, across
                slope, whole, rows = self.pulled_edge(rod, e, edge, g, h, force, beyond)
                self.assemble_edge(rod, e, edge, slope, whole, u, rows, (shift, search), found)
            beyond = beyond + edge.length
            h, g = h_before, g_before
        self.assemble_begin(rod, 0, repeated(rod.loose, 3), shift, plus(force, self.contacts.own_vertex(rod, 0).load), found)

    def pulled_edge(self, rod, e, edge, slope, bent, force, beyond):
        """Of an edge whose bending and twisting has the gradient ``slope`` and second derivative ``bent``: these with what the
        ``force`` on it and the weight of the length ``beyond`` it add, and the rows of A. Of a group weight is a force on
        vertices (:meth:`.GroupContacts.hang`), and the welds of the edge add to both."""
        q, length = edge.frame, edge.length
        t, m1, m2 = directors(q)
        pull = variable(force)
        if ti.static(not self.breaks):
            pull = plus(scaled(rod.gravity, self.hanging_weight(rod, length, beyond)), force)
        l1, l2 = linear_gradient(pull, length, m1, m2)
        straighten = linear_hessian(pull, length, t)
        g = variable((slope[0], slope[1] + l1, slope[2] + l2))
        h = variable((bent[0], bent[1], bent[2], bent[3] + straighten, bent[4], bent[5] + straighten))
        if ti.static(self.breaks):
            welded = self.contacts.edge(rod, e).moment
            g = plus(g, welded)
            # Their second derivatives are by rotation vectors: this is what spinning before tilting makes of them.
            h = (h[0], h[1] - 0.5 * welded[2], h[2] + 0.5 * welded[1], h[3], h[4], h[5])
        return g, self.second_derivatives(rod, h, g), closure_rows(length, m1, m2)

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

    def assemble_row(self, rod, line, free, across):
        """The blocks of row ``line`` before the diagonal, from the last: H(p, q) for all q < p; ``across`` couples the edge by
        bending and twisting with the edge before."""
        own = self.levers(rod, line)
        sums = variable(full(self.load_diagonal(rod, line)))
        for back in range(line):
            q = line - 1 - back
            if self.begins(rod, q) > 0:
                sums = repeated(0.0 * rod.total, 9)
            sums = plus(sums, self.load_block(rod, line, q))
            block = variable(turned_block(own, sums, self.levers(rod, q)))
            if back == 0 and q > 0:
                block = plus(block, scaled_both(free, transposed(across), self.freedom(rod, q - 1)))
            self.store_block(rod, line, q, block)

    def assemble_begin(self, rod, line, free, shift, force, found):
        """The row of the place where a rod begins, all of which bears ``force``."""
        slope = products(free, plus(force, scaled(rod.gravity, 2.0 * rod.total)))
        self.observe_moment(found, scaled(slope, rod.total))
        diagonal = on_diagonal(self.load_diagonal(rod, line), self.shift_of_start(rod, shift))
        self.store_diagonal(rod, line, held_pivot(diagonal, free))
        self.store_side(rod, line, negated(slope), scaled(identity(0.0 * rod.loose), rod.loose * rod.closed))

    def store_side(self, rod, line, right, border):
        """Three rows of the right-hand side: that of the step and those of closure."""
        for r in ti.static(range(3)):
            values = (right[r], border[3 * r], border[3 * r + 1], border[3 * r + 2])
            self.side(rod, 3 * line + r).four = values

    def substitute(self, rod, found):
        """ω = L⁻ᵀ D⁻¹ L⁻¹ (b − A δλ), as :meth:`.LoadedElimination.substitute`, with the way to other parts of the rod too."""
        decrement = self.solve_backward(rod, found.change)
        x = variable(self.solution(rod, 0))
        rod.head.drift_step = x
        self.contacts.own_vertex(rod, 0).move = x
        size = dot(x, x) / (rod.total * rod.total)
        largest = self.contacts.approach(rod, 0, x, x)
        for e in range(rod.edges):
            edge = self.edge(rod.head, e)
            w = variable(self.solution(rod, e + 1))
            q = edge.frame
            change = shift_of_end(edge.length, first_director(q), second_director(q), w)
            before, after = variable(x), variable(plus(x, change))
            if ti.static(self.breaks):
                if self.begins(rod, e) > 0:
                    before, after = w, w
                    self.contacts.member(rod, self.begins(rod, e)).begin_step = w
                    size = largest_of(size, dot(w, w) / (rod.total * rod.total))
                    w = repeated(0.0 * size, 3)
            edge.rotation = w
            largest = largest_of(largest, self.contacts.approach(rod, e + 1, before, after))
            x = after
            self.contacts.own_vertex(rod, e + 1).move = x
            size = self.longer(size, w)
        largest = largest_of(largest_of(largest, size), self.contacts.approach_itself(rod))
        return ti.sqrt(largest), ti.sqrt(size), decrement
