"""The Newton system of a chain of frames without external energy: block-tridiagonal elimination, bordered by closure (§III-D).

The Hessian is block-tridiagonal with 3×3 blocks, bordered by the three columns A of closure:

    | H + δI   A | | ω  |     | −g − Aλ |
    | Aᵀ       0 | | δλ |  =  | −miss   |

One forward sweep assembles and eliminates it, H + δI = L D Lᵀ edge by edge, one backward sweep gives the step ω. The signs of D
and of the Schur complement S = Aᵀ (H + δI)⁻¹ A are the certificate that a rod rests at a minimum.

Of a chain whose vertex 0 is not held the place is three more unknowns, which only an external energy determines
(:class:`LooseStart`). It hangs from the anchor, displaced by the drift. Where the far end is held the drift alone closes the
chain, so that no rotation has to.
"""

import taichi as ti

from doo_ti.physics import algebra
from doo_ti.physics.algebra import absolute, largest_of, on_diagonal, row_scaled, scaled_both, shifted, transposed
from doo_ti.physics.number import device_functions
from doo_ti.physics.pair import closure_rows, linear_gradient, linear_hessian
from doo_ti.physics.quaternion import directors
from doo_ti.physics.tuples import chosen, dot, minus, negated, picked, plus, products, record, repeated, scaled, variable
from doo_ti.relaxation.chain import Chain


@ti.func
def held_pivot(d, free):
    """The diagonal block ``d`` with rows and columns of the identity where ``free`` (3,) is zero, so that held rotations stay
    zero and add no negative pivot."""
    return (
        free[0] * d[0] + (1.0 - free[0]), free[0] * free[1] * d[1], free[0] * free[2] * d[2],
        free[1] * d[3] + (1.0 - free[1]), free[1] * d[4], free[2] * d[5] + (1.0 - free[2]))


@device_functions
class Elimination(Chain):
    """The chain with the elimination of its Newton system."""

    def eliminate(self, rod, shift, search, multiplier, miss):
        """Assemble H + shift at the closed frames and eliminate it from the first edge to the last.

        search: (noise, echo) of :meth:`stirred`, zero except while leaving a saddle. Returns a record: ``moment``, the
        largest on a free edge |g + Aλ|; ``scale``, the largest diagonal entry of H; ``change`` δλ; ``inertia``, negative pivots
        plus positive eigenvalues of the Schur complement, three at a minimum (or saddle-free step); ``slope`` along the echo;
        and ``energy`` and ``magnitude`` of an external energy, here none.
        """
        zero = 0.0 * rod.total
        found = self.nothing_found(rod)
        h, g = variable(repeated(zero, 6)), variable(repeated(zero, 3))  # H and gradient of the pair before
        ee = variable(repeated(zero, 6))  # W_Uᵀ D⁻¹ [W_U, W_A, W_r] of the edge before
        ea, er = variable(repeated(zero, 9)), variable(repeated(zero, 3))
        s, z = variable(repeated(zero, 6)), variable(repeated(zero, 3))  # W_Aᵀ D⁻¹ [W_A, W_r], summed
        remaining = rod.total
        some_taut = self.largest(1.0 - rod.free[4]) > 0.5
        searching = self.largest(search[0] + search[1]) > 0.0
        for e in range(rod.edges):
            edge = self.edge(rod.head, e)
            q, length = edge.frame, edge.length
            t, m1, m2 = directors(q)
            remaining = remaining - length
            c = plus(self.edge_pull(rod, edge, self.hanging_weight(rod, length, remaining)), multiplier)
            l1, l2 = linear_gradient(c, length, m1, m2)
            straighten = linear_hessian(c, length, t)
            g = (g[0], g[1] + l1, g[2] + l2)
            h = (h[0], h[1], h[2], h[3] + straighten, h[4], h[5] + straighten)
            u = variable(repeated(zero, 9))
            h_next, g_next = variable(repeated(zero, 6)), variable(repeated(zero, 3))
            if e < rod.edges - 1:
                stiffness = self.stiffness(edge, self.edge(rod.head, e + 1), rod.stiffness)
                derivatives = self.derivatives(self.bent(edge.bent), stiffness)
                self.keep_pair(rod, e, derivatives)
                left, right, h_left, h_right, across = derivatives
                g, h = plus(g, left), plus(h, h_left)
                h_next, g_next, u = h_right, right, across
            h = self.second_derivatives(rod, h, g)
            a = variable(minus(closure_rows(length * rod.closed, m1, m2), ea))
            b = variable(minus(negated(g), er))
            if searching:
                b, along = self.stirred(edge, e, b, g, search)
                found.slope = found.slope + along
            spin, tilt = self.shifts(rod, edge, shift)
            d = variable(minus(shifted(h, spin, tilt), ee))
            if e == 0 or e >= rod.edges - 2 or some_taut:
                free, after = self.freedom(rod, e), self.freedom(rod, e + 1)
                g, b, a = products(free, g), products(free, b), row_scaled(a, free)
                h = (free[0] * h[0], h[1], h[2], free[1] * h[3], h[4], free[2] * h[5])
                d, u = held_pivot(d, free), scaled_both(free, u, after)
            self.observe(found, g, h)
            f = algebra.factor(d, self.tiny)
            found.negative = found.negative + f[6]
            wr, wu, wa = algebra.forward(f, b), algebra.forward_rows(f, transposed(u)), algebra.forward_rows(f, transposed(a))
            self.store_eliminated(edge, f, wr, wu, wa)
            s, z = plus(s, algebra.symmetric_gram(f, wa)), plus(z, algebra.against(f, wa, wr))
            ee, ea, er = algebra.symmetric_gram(f, wu), algebra.gram(f, wu, wa), algebra.against(f, wu, wr)
            h, g = h_next, g_next
        change, positive = self.bordered(rod, s, plus(z, miss))
        return self.result(found, change, positive)

    def edge_pull(self, rod, edge, weight):
        """The linear potential of an edge with that hanging ``weight``, without λ."""
        return scaled(rod.gravity, weight)

    def observe(self, found, g, h):
        """Take an edge's gradient and diagonal block into the largest of both."""
        found.scale = largest_of(found.scale, largest_of(h[0], largest_of(h[3], h[5])))
        self.observe_moment(found, g)

    def observe_moment(self, found, g):
        """Take a gradient into the largest square of a moment."""
        found.squared = largest_of(found.squared, largest_of(g[0] * g[0], largest_of(g[1] * g[1], g[2] * g[2])))

    def bordered(self, rod, s, z):
        """(δλ = S⁻¹ z, positive eigenvalues of S). Without closure S is the identity: λ stays zero and three are counted."""
        solved, minors = algebra.solve_symmetric(on_diagonal(s, 1.0 - rod.closed), z)
        return scaled(solved, rod.closed), algebra.positive_eigenvalues(minors)

    def substitute(self, rod, found):
        """Back-substitution ω = L⁻ᵀ D⁻¹ (W_r − W_A δλ − W_U ω_next). Returns three numbers: what is compared with the largest
        step that may be taken whole; the size of the step; and its Newton decrement ωᵀHω, twice the energy that it is expected
        to gain. Here the first two are the largest rotation, rad; in contact the first is more (:meth:`.RodContacts.approach`).
        """
        zero = 0.0 * rod.total
        w = variable(repeated(zero, 3))
        largest, decrement = (zero, zero)
        for back in range(rod.edges):
            e = rod.edges - 1 - back
            edge = self.edge(rod.head, e)
            right = algebra.minus_combination(edge.rotation, edge.border, found.change)
            decrement = decrement + algebra.squared(edge.pivots, right)
            w = self.solved_edge(edge, right, w)
            largest = self.longer(largest, w)
        size = ti.sqrt(largest)
        return size, size, decrement

    # --- shared with the elimination under an external energy ---

    def nothing_found(self, rod):
        """The record of what an elimination sums up, before it."""
        zero = 0.0 * rod.total
        return record(squared=zero, scale=zero, negative=zero, slope=zero, energy=zero, magnitude=zero)

    def schur_complement(self, rod):
        """S = Σ W_Aᵀ D⁻¹ W_A, vertex 0 included where it is free."""
        s = variable(repeated(0.0 * rod.total, 6))
        if ti.static(self.has_border):
            s = algebra.symmetric_gram(rod.head.drift_pivots, rod.head.drift_border)
        for e in range(rod.edges):
            edge = self.edge(rod.head, e)
            s = plus(s, algebra.symmetric_gram(edge.pivots, self.closure_columns(edge)))
        return s

    def result(self, found, change, positive):
        """What :meth:`eliminate` returns of what was ``found``, of δλ and of the positive eigenvalues of S."""
        return record(moment=ti.sqrt(found.squared), scale=found.scale, change=change, inertia=found.negative + positive,
                      slope=found.slope, energy=found.energy, magnitude=found.magnitude)

    def stirred(self, edge, e, right, gradient, search):
        """(right-hand side with the noise and the echo of ``search`` (noise, echo), slope along the echo).

        Inverse iterations from there lead towards the softest direction, off a saddle: the noise is a fixed perturbation, the
        echo that many times the last step. The numbers from -2.5 to 3.5 only have to be the same each time and to have no
        symmetry along the rod: remainders by the prime 7 run through all seven of them, in three orders.
        """
        noise, echo = search
        # In a lane without an echo the step is undefined and may be NaN.
        k = chosen(echo > 0.0, scaled(edge.rotation, echo), repeated(0.0 * echo, 3))
        perturbed = (right[0] + noise * ((5 * e + 2) % 7 - 2.5) + k[0], right[1] + noise * ((3 * e + 1) % 7 - 2.5) + k[1],
                     right[2] + noise * ((4 * e + 3) % 7 - 2.5) + k[2])
        return perturbed, dot(gradient, k)

    def store_eliminated(self, edge, f, right, neighbour, border):
        """Store for :meth:`solved_edge`: the factors of an edge, W_r, and the columns of W_U and of the border."""
        edge.pivots = (f[0], f[1], f[2], f[3], f[4], f[5])
        edge.rotation, edge.neighbour, edge.border = right, neighbour, border

    @picked
    def closure_columns(self, edge):
        """W_A of an edge."""
        return edge.force_border if self.has_border else edge.border

    def solved_edge(self, edge, right, w):
        """ω = L⁻ᵀ D⁻¹ (``right`` − W_U ω_neighbour) of an edge, into its place."""
        rotation = algebra.backward(edge.pivots, algebra.minus_combination(right, edge.neighbour, w))
        edge.rotation = rotation
        return rotation

    def longer(self, largest, w):
        """The larger of a square and |w|²."""
        return largest_of(largest, dot(w, w))


LEAST_HOLD = 1e-6
"""Over the cube of the rod's length, B being about one: the least stiffness with which a free vertex 0 is held in its place."""


@device_functions
class LooseStart(Elimination):
    """The part of :class:`.LoadedElimination` for vertex 0. Lanes whose rods hold it are not changed."""

    def step_start(self, rod, scale, moving, reached, goal):
        """Move vertex 0 by its share of the step, or to where the far end, ``reached`` from vertex 0, is at its ``goal``;
        returns where rotations are still to close the chain."""
        zero = 0.0 * scale
        standing = rod.head.drift
        full = rod.head.drift_step
        stepping = (scale > 0.0) | (scale < 0.0)
        drift = variable(chosen(stepping, plus(standing, scaled(full, scale)), standing))
        tied = rod.loose * rod.closed * moving
        whole = variable(minus(goal, reached))
        if ti.static(self.touches):
            whole = plus(drift, scaled(minus(whole, drift), moving))
        drift = chosen(tied > 0.0, whole, drift)
        rod.head.drift_standing = standing
        rod.head.drift = drift
        return ti.select(rod.loose > 0.5, zero, moving)

    def eliminate_start(self, rod, shift, beyond, border, found):
        """Eliminate ξ of vertex 0 from the quadratic form that edge 0 leaves, ½ ξᵀC ξ + c·ξ."""
        loose = rod.loose
        free = (loose, loose, loose)
        weight = scaled(rod.gravity, 2.0 * rod.total)
        force, c = variable(plus(beyond.force, weight)), variable(plus(beyond.c, weight))
        if ti.static(self.pulls_start):
            slope, curvature = self.load_start(rod, found)
            force, c = plus(force, slope), plus(c, slope)
            beyond.cc = plus(beyond.cc, curvature)
        if ti.static(self.touches):
            if self.contacts.touched_start(rod, 0) == 1:
                slope = rod.contacts.end_gradient
                force, c = plus(force, self.contacts.known(slope, rod.contacts.end_excess)), plus(c, slope)
                beyond.cc = plus(beyond.cc, rod.contacts.end_curvatures)
            found.energy = found.energy + rod.contacts.energy
            found.magnitude = found.magnitude + rod.contacts.magnitude
        moment = scaled(force, loose * rod.total)
        self.observe_moment(found, moment)
        d = on_diagonal(beyond.cc, self.shift_of_start(rod, shift))
        stiff = (self.at_least_held(rod, d[0]), d[1], d[2], self.at_least_held(rod, d[3]), d[4], self.at_least_held(rod, d[5]))
        f = algebra.factor_in_turn(held_pivot(stiff, free))
        found.negative = found.negative + f[6]
        wr = algebra.forward(f, scaled(negated(c), loose))
        wa = algebra.forward_rows(f, scaled(border.c, loose))
        border.schur = plus(border.schur, algebra.symmetric_gram(f, wa))
        border.right = plus(border.right, algebra.against(f, wa, wr))
        rod.head.drift_step, rod.head.drift_border = wr, wa
        rod.head.drift_pivots = (f[0], f[1], f[2], f[3], f[4], f[5])

    def load_start(self, rod, found):
        """The external energy at vertex 0: its value goes to ``found``; returns its first and second derivative."""
        place = scaled(plus(rod.anchor, rod.head.drift), rod.length_unit)
        energy, gradient, along, curvature, mixed, stretching = self.functions.evaluate(
            rod.head.external, rod.numbers, rod.field, place, place, rod.coarse)
        found.energy = found.energy + rod.loose * energy
        found.magnitude = found.magnitude + rod.loose * absolute(energy)
        return scaled(gradient, rod.length_unit), scaled(curvature, rod.length_unit * rod.length_unit)

    def shift_of_start(self, rod, shift):
        """``shift`` of the place of vertex 0."""
        return shift * rod.shift_shares[1] / (rod.total * rod.total)

    def at_least_held(self, rod, stiffness):
        """The stiffness that holds vertex 0 in some direction, or a small one where nothing does, as along a table."""
        least = LEAST_HOLD * rod.shift_shares[1] / (rod.total * rod.total * rod.total)
        return ti.select(absolute(stiffness) < least, least, stiffness)

    def solved_start(self, rod, change):
        """(ξ = L⁻ᵀ D⁻¹ (W_c − W_λ δλ) of vertex 0, also into its place; its part in the Newton decrement)."""
        y = algebra.minus_combination(rod.head.drift_step, rod.head.drift_border, change)
        f = rod.head.drift_pivots
        shift = algebra.backward(f, y)
        rod.head.drift_step = shift
        return shift, algebra.squared(f, y)
