"""The Newton system of a chain of frames under an external energy at its vertices, in Riccati form (§III-D, docs/chain.md).

Where a vertex is depends on every edge before it, so an energy at vertices fills the Hessian of the frames. It stays a chain
in the displacement ξ of an edge's first vertex and the rotation ω of the edge before: eliminating from the last edge, the
energy of all that follows is a quadratic form in the two,

    ½ ξᵀC ξ + ξᵀZ ω + ½ ωᵀF ω + c·ξ + f·ω,

and an edge passes it on to the one before by minimising over its own rotation. Forward, ξ grows by Aᵀω, A = l (0; −m2ᵀ; m1ᵀ).
Where the far end is held, c begins at the multiplier λ, and three columns c_λ, which begin at I, go along with c and give the
border of closure.
"""

import taichi as ti

from doo_ti.physics import algebra, tuples
from doo_ti.physics.algebra import absolute, applied, column_scaled, full, largest_of, quadratic, row, transposed
from doo_ti.physics.number import Layout, device_functions
from doo_ti.physics.pair import closure_rows, linear_gradient, linear_hessian, shift_of_end
from doo_ti.physics.quaternion import directors, first_director, second_director, tangent
from doo_ti.physics.tuples import dot, minus, negated, picked, plus, products, record, repeated, scaled, traced, variable
from doo_ti.relaxation.chain import edge_layout, rod_layout
from doo_ti.relaxation.contact_table import CONTACTS
from doo_ti.relaxation.contacts import RodContacts
from doo_ti.relaxation.elimination import LooseStart, held_pivot
from doo_ti.relaxation.newton_policy import INERTIA_OF_A_MINIMUM


@traced
def pulled(h, straighten, k, a1, a2) -> tuple:
    """H of an edge with the second derivatives of the forces on it, ``straighten`` of both tilts, and of the energy whose
    curvature is ``k`` at its end; a1 and a2: rows of A."""
    return (h[0], h[1], h[2], h[3] + straighten + quadratic(k, a1, a1), h[4] + quadratic(k, a1, a2),
            h[5] + straighten + quadratic(k, a2, a2))


@device_functions
class LoadedElimination(LooseStart):
    """The chain under an external energy of class ``external``, whose functions on the device are ``functions``.

    any_ends: some rods have their far end held or vertex 0 free; otherwise λ with its columns and the place of vertex 0 are
    left out. ``contacts`` with obstacles, if rods may touch any, come on top.
    """

    def __init__(self, number, isotropic: bool, stride: int, external: type, any_ends: bool,
                 contacts: RodContacts | None = None):
        start = external.layout if external.at_vertices else Layout()
        super().__init__(number, isotropic, stride, edge_layout(isotropic, external.layout, any_ends),
                         rod_layout(start if any_ends else None))
        self.functions, self.has_coarse, self.has_border = external.functions(number), external.has_coarse, any_ends
        self.is_loaded = self.functions.evaluate is not None
        self.pulls_start = external.at_vertices
        self.contacts, self.touches = contacts, contacts is not None

    @picked
    def completed(self, given, thread):
        tables = LooseStart.completed(self, given, thread)
        if not self.touches:
            return tables
        edges, numbers = given.rest_length.shape[1], self.contacts.items(given)
        return tuples.extended(tables, contacts=self.behind(given.scratch, given.threads, thread, edges, numbers, CONTACTS))

    @picked
    def items(self, given):
        own = LooseStart.items(self, given)
        return own + self.contacts.items(given) if self.touches else own

    def tip(self, rod):
        """The far end, found from the anchor on, where contacts begin."""
        x = variable(rod.anchor)
        if ti.static(self.has_border):
            x = plus(x, rod.head.drift)
        for e in range(rod.edges):
            edge = self.edge(rod.head, e)
            x = plus(x, scaled(tangent(edge.frame), edge.length))
        if ti.static(self.touches):
            self.contacts.begin(rod)
            self.contacts.look(rod, rod.edges, x)
        return x

    def eliminate(self, rod, shift, search, multiplier, miss):
        """Assemble H + shift and eliminate it from the far end to the start, as :meth:`.Elimination.eliminate`. The force p,
        the sum of all known gradients further out, enters the geometric part of H and the residual; the force c, which
        elimination changes, enters the right-hand side."""
        zero, found = 0.0 * rod.total, self.nothing_found(rod)
        beyond, border = self.at_the_end(rod, multiplier)
        h, g = variable(repeated(zero, 6)), variable(repeated(zero, 3))  # H and gradient of the pair with the edge after
        end = self.tip(rod)
        searching = self.largest(search[0] + search[1]) > 0.0
        some_taut = self.largest(1.0 - rod.free[4]) > 0.5
        for back in range(rod.edges):
            e = rod.edges - 1 - back
            edge = self.edge(rod.head, e)
            q, length = edge.frame, edge.length
            t, m1, m2 = directors(q)
            start = minus(end, scaled(t, length))
            load = self.load(rod, edge, e, start, end, found)
            end = start
            weight = scaled(rod.gravity, self.hanging_weight(rod, length, beyond.length))
            beyond.length = beyond.length + length
            own, force = plus(weight, load.gradient_s), plus(plus(weight, load.known_s), beyond.force)
            l1, l2 = linear_gradient(force, length, m1, m2)
            r1, r2 = linear_gradient(plus(own, beyond.c), length, m1, m2)
            straighten = linear_hessian(force, length, t)
            # The pair with the edge before: its right block is this edge's, its left one is for the edge before.
            u, h_before, g_before = variable(repeated(zero, 9)), variable(repeated(zero, 6)), variable(repeated(zero, 3))
            if e > 0:
                previous = self.edge(rod.head, e - 1)
                stiffness = self.stiffness(previous, edge, rod.stiffness)
                derivatives = self.derivatives(self.bent(previous.bent), stiffness)
                self.keep_pair(rod, e - 1, derivatives)
                left, right, h_left, h_right, across = derivatives
                g, h = plus(g, right), plus(h, h_right)
                h_before, g_before, u = h_left, left, across
            rows = closure_rows(length, m1, m2)
            a1, a2 = row(rows, 1), row(rows, 2)
            h = self.second_derivatives(rod, pulled(h, straighten, load.curvature_ss, a1, a2), (g[0], g[1] + l1, g[2] + l2))
            d = variable(self.condensed(h, self.shifts(rod, edge, shift), beyond, a1, a2))
            zz = variable(self.coupled(beyond, load, a1, a2))
            b = variable((0.0 - g[0] - beyond.f[0], 0.0 - g[1] - r1 - beyond.f[1], 0.0 - g[2] - r2 - beyond.f[2]))
            g = (g[0], g[1] + l1, g[2] + l2)
            if searching:
                b, along = self.stirred(edge, e, b, g, search)
                found.slope = found.slope + along
            if e == 0 or e == rod.edges - 1 or some_taut:
                free = self.freedom(rod, e)
                g, b, d = products(free, g), products(free, b), held_pivot(d, free)
                h = (free[0] * h[0], h[1], h[2], free[1] * h[3], h[4], free[2] * h[5])
                zz, u = column_scaled(zz, free), column_scaled(u, free)
            self.observe(found, g, h)
            f = algebra.factor(d, self.tiny)
            found.negative = found.negative + f[6]
            wr, wz, wu = algebra.forward(f, b), algebra.forward_rows(f, zz), algebra.forward_rows(f, u)
            self.store_eliminated(edge, f, wr, wu, wz)
            self.pass_on(beyond, load, f, wr, wz, wu)
            if ti.static(self.has_border):
                self.eliminate_border(edge, self.freedom(rod, e), border, rows, f, wr, wz, wu)
            h, g = h_before, g_before
        return self.finish(rod, shift, miss, beyond, border, found)

    def finish(self, rod, shift, miss, beyond, border, found):
        """The result of :meth:`eliminate`, from what edge 0 passes on: vertex 0 and closure are eliminated here."""
        zero = 0.0 * rod.total
        change = variable(repeated(zero, 3))
        positive = zero + INERTIA_OF_A_MINIMUM  # without closure all of it is counted
        if ti.static(self.has_border):
            self.eliminate_start(rod, shift, beyond, border, found)
            change, positive = self.bordered(rod, border.schur, plus(border.right, miss))
        return self.result(found, change, positive)

    def at_the_end(self, rod, multiplier):
        """The records of what lies beyond the far end, nothing but λ, and of the border, as the last edge is given them."""
        zero = 0.0 * rod.total
        beyond = record(
            force=repeated(zero, 3), c=repeated(zero, 3), f=repeated(zero, 3), cc=repeated(zero, 6), ff=repeated(zero, 6),
            z=repeated(zero, 9), length=zero)
        if ti.static(self.has_border):
            beyond.force, beyond.c = multiplier, multiplier
        return beyond, record(c=scaled(algebra.identity(zero), rod.closed), f=repeated(zero, 9), schur=repeated(zero, 6),
                              right=repeated(zero, 3))

    def load(self, rod, edge, e, start, end, found):
        """The external energy of an edge (:class:`doo_ti.relaxation.external.ExternalFunctions`) and that of its contacts: the
        value goes to ``found``, and the record of the derivatives is returned; ``known`` and ``known_s`` are the gradients
        without what only closes gaps (:meth:`.ContactEnergy.known_force`)."""
        none = repeated(0.0 * rod.total, 9)
        load = record(gradient=none[:3], gradient_s=none[:3], curvature=none[:6], curvature_s=none, curvature_ss=none[:6],
                      known=none[:3], known_s=none[:3])
        if ti.static(self.is_loaded):
            unit = rod.length_unit  # the energy is a function of places in mm
            value, gradient, gradient_s, curvature, curvature_s, curvature_ss = self.functions.evaluate(
                edge.external, rod.numbers, rod.field, scaled(start, unit), scaled(end, unit), rod.coarse)
            found.energy = found.energy + value
            found.magnitude = found.magnitude + absolute(value)
            square = unit * unit
            load.gradient, load.gradient_s = scaled(gradient, unit), scaled(gradient_s, unit)
            load.known, load.known_s = load.gradient, load.gradient_s
            load.curvature, load.curvature_s = scaled(curvature, square), scaled(curvature_s, square)
            load.curvature_ss = scaled(curvature_ss, square)
        if ti.static(self.touches):
            self.contacts.take(rod, load, self.contacts.touched(rod, e + 1, start, end))
        return load

    def condensed(self, h, shifts, beyond, a1, a2):
        """The edge's diagonal block with what lies beyond: H + shifts + F + A Z + Zᵀ Aᵀ + A C Aᵀ."""
        turned = transposed(beyond.z)
        row1, row2 = applied(turned, a1), applied(turned, a2)
        o, c = beyond.ff, beyond.cc
        return (h[0] + shifts[0] + o[0], h[1] + o[1] + row1[0], h[2] + o[2] + row2[0],
                h[3] + shifts[1] + o[3] + 2.0 * row1[1] + quadratic(c, a1, a1),
                h[4] + o[4] + row1[2] + row2[1] + quadratic(c, a1, a2),
                h[5] + shifts[1] + o[5] + 2.0 * row2[2] + quadratic(c, a2, a2))

    def coupled(self, beyond, load, a1, a2):
        """Z with what the edge adds, (C + K_s) Aᵀ: a row for each direction of ξ, a column for each rotation of the edge."""
        stretched = plus(full(beyond.cc), load.curvature_s)
        w1, w2 = applied(stretched, a1), applied(stretched, a2)
        z = beyond.z
        return (z[0], z[1] + w1[0], z[2] + w2[0], z[3], z[4] + w1[1], z[5] + w2[1], z[6], z[7] + w1[2], z[8] + w2[2])

    def eliminate_border(self, edge, free, border, rows, f, wr, wz, wu):
        """The edge's part in closure: of each component of λ the columns c_λ and f_λ that the edge before is given, and the
        Schur complement."""
        wa = algebra.forward_rows(f, column_scaled(plus(border.f, algebra.times_transposed(border.c, rows)), free))
        edge.force_border = wa
        border.c = minus(border.c, algebra.gram(f, wa, wz))
        border.f = negated(algebra.gram(f, wa, wu))
        border.schur = plus(border.schur, algebra.symmetric_gram(f, wa))
        border.right = plus(border.right, algebra.against(f, wa, wr))

    def pass_on(self, beyond, load, f, wr, wz, wu):
        """The quadratic form that the edge before is given: C, c, p, Z, F and f with the edge's rotation minimised over."""
        beyond.cc = minus(plus(beyond.cc, load.curvature), algebra.symmetric_gram(f, wz))
        beyond.c = plus(plus(beyond.c, load.gradient), algebra.against(f, wz, wr))
        beyond.force = plus(beyond.force, load.known)
        beyond.z = negated(algebra.gram(f, wz, wu))
        beyond.ff = negated(algebra.symmetric_gram(f, wu))
        beyond.f = algebra.against(f, wu, wr)

    def substitute(self, rod, found):
        """ω = L⁻ᵀ D⁻¹ (W_r − W_λ δλ − W_Z ξ − W_U ω_before) from the start on, as :meth:`.Elimination.substitute`. The size of
        the step is the largest rotation or the share of the rod's length by which vertex 0 moves, if that is more; for one that
        may be taken whole it is as large as the largest share of the way to the middle of an obstacle, if that is more."""
        zero = 0.0 * rod.total
        w, x = variable(repeated(zero, 3)), variable(repeated(zero, 3))
        largest, size, decrement = (zero, zero, zero)
        if ti.static(self.has_border):
            start, decrement = self.solved_start(rod, found.change)
            x = start
            size = dot(x, x) / (rod.total * rod.total)
            if ti.static(self.touches):
                largest = self.contacts.approach(rod, 0, x, x)
        for e in range(rod.edges):
            edge = self.edge(rod.head, e)
            right = variable(self.without_multiplier(edge, found.change))
            decrement = decrement + algebra.squared(edge.pivots, right)
            w = self.solved_edge(edge, algebra.minus_combination(right, edge.border, x), w)
            q = edge.frame
            change = shift_of_end(edge.length, first_director(q), second_director(q), w)
            if ti.static(self.touches):
                largest = largest_of(largest, self.contacts.approach(rod, e + 1, x, plus(x, change)))
            x = plus(x, change)
            size = self.longer(size, w)
        return ti.sqrt(largest_of(largest, size)), ti.sqrt(size), decrement

    def without_multiplier(self, edge, change):
        """W_r − W_λ δλ of an edge."""
        if ti.static(self.has_border):
            return algebra.minus_combination(edge.rotation, edge.force_border, change)
        else:
            return edge.rotation
