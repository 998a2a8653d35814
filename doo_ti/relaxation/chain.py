"""A chain of frames in scratch memory: the step, closure and the energy (§III-B to §III-D).

Its Newton system is solved by :mod:`doo_ti.relaxation.elimination` and :mod:`doo_ti.relaxation.loaded_elimination`.
"""

from functools import cache

import taichi as ti
from taichi.lang.impl import expr_init, subscript

from doo_ti.physics.algebra import absolute, on_diagonal, solve_symmetric
from doo_ti.physics.number import Layout, Scratch, device_functions
from doo_ti.physics.pair import PairEnergy, closing_rotation, curvature, linear_gradient, normal_matrix
from doo_ti.physics.quaternion import directors, tangent, turned_in_body, turned_in_world, twist_angle_function
from doo_ti.physics.tuples import chosen, dot, extended, minus, negated, picked, plus, record, repeated, scaled, variable
from doo_ti.relaxation.newton_policy import UP

# What scratch holds of a rod (see :class:`Chain`), and then of each of its edges.
ROD = Layout(target=3, closed=1, free=5, released=1, total=1, longest=1, energy_unit=1, stiffness=2, gravity=3, anchor=3,
             scale=1, length_unit=1, softest=1, evenness=1, shift_shares=2)
LOOSE = Layout(loose=1, drift=3, drift_standing=3, drift_step=3, drift_border=9, drift_pivots=6)
"""Of a rod whose vertex 0 may move: the flag, how far it has moved from the anchor, now and before the step, its step, and what
the substitution needs of its elimination."""
EDGE = Layout(frame=4, standing=4, length=1, inverse_length=1, rotation=3, neighbour=9, border=9, bent=("border", 8), pivots=6)
"""frame, standing     now, and before the step, which is restored where the step is rejected
inverse_length      1/l̄ of the vertex where the edge begins
rotation            the right-hand side while eliminating, the step after back-substitution
neighbour, border   the columns W_U, and those of W_A or W_Z
bent                before eliminating, curvature and twist where the edge ends
pivots              the factors of the diagonal block"""
GENERAL = Layout(bend=3, twist=1, rest=2, shift_shares=2)
"""β and ω̄ are those of the vertex where the edge begins; shares of a spin and of a tilt."""
FORCE = Layout(force_border=9)  # of the columns of the multiplier under an external energy


@cache
def edge_layout(isotropic: bool, external: Layout | None = None, force: bool = False) -> Layout:
    """What scratch holds of an edge, with the numbers of an ``external`` energy and, with ``force``, λ's columns under it."""
    own = EDGE + (Layout() if isotropic else GENERAL)
    return own + (Layout() if external is None else Layout(external=external)) + (FORCE if force else Layout())


@cache
def rod_layout(external_start: Layout | None = None) -> Layout:
    """What scratch holds of a rod, whose vertex 0 may move if there are numbers of an external energy there."""
    return ROD if external_start is None else ROD + LOOSE + Layout(external=external_start)


STAND_INS = {"start": "frames", "numbers": "material", "field": "material", "kinds": "rods", "grids": "material"}
"""What stands in for an array that a kernel does not take: Taichi's functions must be given one, and nothing reads it."""
OF_RODS = ("target", "length_unit", "closed", "free", "released", "total", "longest", "stiffness", "softest", "evenness",
           "shift_shares", "gravity", "anchor")  # what sweeps read of a rod more than once
REGULAR_LOOSE = 1e-6  # share of AᵀA's trace that is added to it
EASILY_TWISTED = 1e-2  # β over α, below which twisting is much easier than bending


@device_functions
class Chain(PairEnergy):
    """The sweeps that all rods share, for one kind of number and of material.

    Its functions take a record ``rod`` (:meth:`rods`) of the rods in one pack:

    head                    the view of what scratch holds of the rods
    edges                   number of edges
    target, closed          the far point from vertex 0, and one where it is held there, else zero
    free                    (spin_start, tilt_start, spin_end, tilt_end, tilt_inner): one where that rotation of the first edge,
                            of the last or of those between is unknown, zero where it is held
    released                one where vertex 0 is free and the far end holds the rod
    loose                   one where vertex 0 is free to move (:class:`.LooseStart`)
    total, longest          length of the rod and of its longest edge
    stiffness               (α, β) of isotropic rods, unused otherwise
    softest                 the smallest eigenvalue of B anywhere along the rod, or β where that is less
    evenness                ``softest`` over the largest eigenvalue of B, or over β where that is more
    shift_shares            (spin, tilt) of isotropic rods, of others those of their softest part: see :meth:`shifts`
    gravity                 μ times the unit vector up
    anchor                  the point that the chain hangs from
    length_unit             of all these lengths, mm; energies have a unit of their own (:meth:`.Loading.load`)
    numbers, field, coarse  of an external energy (see :class:`doo_ti.relaxation.external.ExternalFunctions`)
    contacts, kinds, obstacles  where the items of contacts begin, the kinds of the obstacles and how many these are
                            (:class:`.RodContacts`)

    edge, rod: the layouts of both, by default what a rod without external energy needs.
    """

    def __init__(self, number, isotropic: bool, stride: int, edge: Layout | None = None, rod: Layout = ROD):
        self.number, self.width, self.isotropic = number, number.width, isotropic
        self.memory = Scratch(number, stride)
        self.rod_layout, self.edge_layout = rod, edge or edge_layout(isotropic)
        self.functions, self.has_coarse, self.pulls_start = None, False, False  # of an external energy
        self.has_border, self.touches = False, False
        self.largest, self.lane, self.with_lane, self.constant = number.largest, number.lane, number.with_lane, number.constant
        self.twist_angle = twist_angle_function(number)
        # What makes AᵀA regular: a share of its trace, and where that is zero a number whose cube, the determinant, is none
        # that rounds to zero. Without closure the edges of a straight rod are parallel; with it they are not; λ must be exact.
        self.regular, self.regular_open, self.least = (1e-6, 0.0, 1e-12) if number.bits == 32 else (1e-16, 1e-13, 1e-30)
        self.tiny = 1e-30 if number.bits == 32 else 1e-100  # see :func:`.factor`

    @picked
    def chain_items(self, edges):
        """Numbers of a rod with so many edges, without contacts."""
        return len(self.rod_layout) + len(self.edge_layout) * edges

    @picked
    def items(self, given):
        """How many numbers of a rod scratch holds for a kernel that is ``given`` a record of such arrays."""
        return self.chain_items(given.rest_length.shape[1])

    @picked
    def completed(self, given, thread):
        """The record ``given`` of a kernel's arrays with what follows from them for a ``thread``; in the place of those that
        this kernel does not take are others, which nothing reads."""
        more = {name: getattr(given, other) for name, other in STAND_INS.items() if not hasattr(given, name)}
        if not hasattr(given, "up"):
            more["up"] = tuple(subscript(None, given.policy, UP + k) for k in range(3))
        return extended(given, contacts=0, **more)

    @picked
    def behind(self, array, threads, thread, edges, numbers, layout: Layout):
        """The view of ``numbers`` more of a thread in scratch: behind the chains of all threads."""
        return self.memory.behind(array, threads, thread, self.chain_items(edges), layout, numbers)

    @picked
    def head(self, array, thread, edges):
        """The view of what a thread's scratch holds of its rods."""
        return self.memory.of_thread(array, thread, self.rod_layout, self.chain_items(edges))

    @picked
    def edge(self, head, e):
        """The view of an edge of the rods at ``head``."""
        return head.part(self.edge_layout, len(self.rod_layout) + e * len(self.edge_layout))

    @picked
    def rods(self, tables, head, coarse):
        """The record of the rods at ``head``, with the tables of an external energy if there is one."""
        zero = expr_init(0.0 * head.closed)
        return record(
            head=head, edges=tables.rest_length.shape[1], loose=head.loose if self.has_border else zero, spins_first=zero,
            contacts=tables.contacts, kinds=tables.kinds, grids=tables.grids, obstacles=tables.kinds.shape[0],
            numbers=tables.numbers, field=tables.field, coarse=coarse, **{name: getattr(head, name) for name in OF_RODS})

    def spinning_first(self, rod, far):
        """One where a step is to turn frames by spins that are made before tilts, zero where by rotation vectors; ``far``: one
        where a rod is far from rest.

        Tilts alone move vertices. With spins first this holds for large steps too, so that a step meets clamps and obstacles as
        well as its linear model says. With rotation vectors a part of the rod that turns as a whole keeps its shape, which is
        what most steps of rods with a free end do, of ribbons, where spin and tilt go together, and neutral motions near rest;
        but their second derivatives mix spins with unbalanced moments of bending, which little twist stiffness does not bear.
        """
        one = 0.0 * far
        if ti.static(self.touches):
            one = far
        elif ti.static(self.isotropic):
            easily_twisted = ti.select(rod.stiffness[1] < EASILY_TWISTED * rod.stiffness[0], 0.0 * far + 1.0, 0.0 * far)
            one = far * ti.max(rod.closed, easily_twisted)
        return one

    def second_derivatives(self, rod, h, g):
        """H of an edge by w as a step turns it, from ``h`` with spins made first and the gradient ``g``: with rotation vectors
        the second derivative by spin and tilt is the mean of both orders."""
        half = 0.5 * (1.0 - rod.spins_first)
        return (h[0], h[1] + half * g[2], h[2] - half * g[1], h[3], h[4], h[5])

    def shifts(self, rod, edge, shift):
        """``shift`` of a spin and of a tilt of an edge: at most a large multiple of what is stiff there, so that the soft parts
        of a rod with a stiff one still move."""
        if ti.static(self.isotropic):
            return (shift * rod.shift_shares[0], shift * rod.shift_shares[1])
        else:
            return (shift * edge.shift_shares[0], shift * edge.shift_shares[1])

    # --- free rotations and weight ---

    def freedom(self, rod, edge):
        """(spin, tilt, tilt) of an edge: one where it may turn about its tangent, and about m1 and m2."""
        one = 0.0 * rod.total + 1.0
        free = variable((one, rod.free[4], rod.free[4]))
        if edge == 0:
            free = (rod.free[0], rod.free[1], rod.free[1])
        if edge == rod.edges - 1:
            free = (rod.free[2], rod.free[3], rod.free[3])
        return free

    def hanging_weight(self, rod, length, remaining):
        """E_gravity = Σ_i μ l̄_i up·v_i = μ Σ_j c_j l_j up·t_j (§III-C), from vertex 0: the coefficient c_j = Σ_{i>j} l̄_i of an
        edge, less Σ_i l̄_i where the rod hangs from its far end."""
        return length + 2.0 * remaining - 2.0 * rod.total * rod.released

    def summed(self, total, lost, values):
        """Compensated summation: (``total`` + ``values``, the rounding error, which is corrected with the next values). In f32
        the far end of a chain would otherwise be off by more than 1e-7 of its length."""
        if ti.static(self.number.bits == 32):
            wanted = minus(values, lost)
            reached = plus(total, wanted)
            return reached, minus(minus(reached, total), wanted)
        else:
            return plus(total, values), lost

    # --- sweeps ---

    def step(self, rod, scale, moving, before):
        """Frames turned by scale ω (:meth:`spinning_first`), and x of the projection that puts them back on closure, both only
        where ``moving``; and AᵀA over the edges that may tilt. Where rods may touch something, a step that is not taken whole
        leaves its share of what they missed ``before``."""
        zero = 0.0 * scale
        stepping = (scale > 0.0) | (scale < 0.0)
        reached, lost = variable(repeated(zero, 3)), variable(repeated(zero, 3))
        normal = variable(repeated(zero, 6))
        for e in range(rod.edges):
            edge = self.edge(rod.head, e)
            # In a lane that does not step the rotation is undefined and may be NaN.
            w = chosen(stepping, scaled(edge.rotation, scale), repeated(zero, 3))
            standing = edge.frame
            edge.standing = standing
            q = turned_in_body(standing, w, rod.spins_first)
            edge.frame = q
            length = edge.length
            t = tangent(q)
            reached, lost = self.summed(reached, lost, scaled(t, length))
            normal = plus(normal, scaled(normal_matrix(length, t), self.freedom(rod, e)[1]))
        goal = variable(rod.target)
        if ti.static(self.touches):
            goal = plus(goal, scaled(before, ti.select(stepping, 1.0 - scale, zero)))
        if ti.static(self.has_border):
            moving = self.step_start(rod, scale, moving, reached, goal)
            reached = plus(reached, rod.head.drift)
        miss = scaled(minus(reached, goal), rod.closed)
        # Made regular where all free edges are parallel, or none may tilt. A rod with a loose start only begins with the
        # multiplier that follows.
        share = self.regular + self.regular_open * (1.0 - rod.closed) + REGULAR_LOOSE * rod.loose
        normal = on_diagonal(normal, share * (normal[0] + normal[3] + normal[5]) + self.least)
        x, minors = solve_symmetric(normal, miss)
        # x·miss is the sum of the squared rotations: keep their root mean square below 0.15 rad in one projection.
        size = ti.sqrt(ti.max(dot(x, miss), zero) / ti.cast(rod.edges, self.number.scalar)) + 1e-30
        # Where nothing moves x may be NaN: AᵀA of parallel edges is regular but for rounding.
        return chosen(moving > 0.0, scaled(x, moving * ti.min(0.0 * size + 1.0, 0.15 / size)), repeated(zero, 3)), normal

    def close(self, rod, x, normal):
        """Turn the stepped frames onto closure by the minimum-norm rotation of :meth:`step`, and evaluate them.

        Returns energy (gravity from vertex 0 or the far point), its magnitude (sum of absolute terms, the scale of its
        rounding), what closure is left, the least-squares multiplier λ = −(AᵀA)⁻¹ Aᵀ g, with AᵀA from before the closing, and
        the smallest t·target of an edge, before closing and after.
        This loop and that of :meth:`step` compute all that edges do not wait for each other for, so that the processor works on
        several at a time; in the elimination each edge waits for the one before.
        """
        zero = 0.0 * rod.total
        energy, potential, magnitude = (zero, zero, zero)
        reached, lost = variable(repeated(zero, 3)), variable(repeated(zero, 3))
        moment = variable(repeated(zero, 3))  # Aᵀg
        before = variable(repeated(zero, 4))  # the frame of the edge before
        lever1, lever2 = variable(repeated(zero, 3)), variable(repeated(zero, 3))  # its l m1 and l m2
        carry1, carry2 = (zero, zero)  # its gradient so far
        remaining = rod.total
        unclosed, closed = (zero + 1e30, zero + 1e30)
        some_taut = self.largest(1.0 - rod.free[4]) > 0.5
        for e in range(rod.edges):
            edge = self.edge(rod.head, e)
            raw = edge.frame
            length = edge.length
            raw_tangent = tangent(raw)
            rotation = variable(closing_rotation(length, raw_tangent, x))
            levers = length
            if e == 0 or e == rod.edges - 1 or some_taut:
                tilt = self.freedom(rod, e)[1]
                rotation = scaled(rotation, tilt)
                levers = length * tilt
            q = turned_in_world(raw, rotation)
            edge.frame = q
            right1, right2 = (zero, zero)
            if e > 0:
                bent, s = self._bend(rod, e, before, q)
                energy = energy + self.energy_of(bent, s)
                left, right = self.gradient_of(bent, s)
                moment = minus(plus(moment, scaled(lever1, carry2 + left[2])), scaled(lever2, carry1 + left[1]))
                right1, right2 = (right[1], right[2])
            t, m1, m2 = directors(q)
            lever1, lever2 = scaled(m1, levers), scaled(m2, levers)
            remaining = remaining - length
            pull = scaled(rod.gravity, self.hanging_weight(rod, length, remaining))
            height = length * dot(pull, t)
            potential, magnitude = (potential + height, magnitude + absolute(height))
            # Where the edge may not tilt these are zero, and so is its share of Aᵀg.
            l1, l2 = linear_gradient(pull, levers, m1, m2)
            carry1, carry2 = (right1 + l1, right2 + l2)
            reached, lost = self.summed(reached, lost, scaled(t, length))
            unclosed = ti.min(unclosed, dot(raw_tangent, rod.target))
            closed = ti.min(closed, dot(t, rod.target))
            before = q
        moment = minus(plus(moment, scaled(lever1, carry2)), scaled(lever2, carry1))
        if ti.static(self.has_border):
            reached = plus(reached, rod.head.drift)
            height = 2.0 * rod.total * dot(rod.gravity, rod.head.drift)
            potential, magnitude = (potential + height, magnitude + absolute(height))
        miss = scaled(minus(reached, rod.target), rod.closed)
        fit, minors = solve_symmetric(normal, moment)
        return energy + potential, energy + magnitude, miss, negated(scaled(fit, rod.closed)), (unclosed, closed)

    def _bend(self, rod, e, before, q):
        """Curvature and twist between the frame before and q, of edge ``e``, kept for the elimination; the stiffness there."""
        previous = self.edge(rod.head, e - 1)
        px, py, inverse, turn, r = curvature(before, q)
        m = self.twist_angle(r)
        previous.bent = px + py + (inverse, m) + turn
        return (px, py, inverse, m, turn), self.stiffness(previous, self.edge(rod.head, e), rod.stiffness)

    def restore(self, rod, lost):
        """Restore the frames from before the step in the lanes that reject it."""
        for e in range(rod.edges):
            edge = self.edge(rod.head, e)
            edge.frame = chosen(lost > 0.5, edge.standing, edge.frame)
        if ti.static(self.has_border):
            rod.head.drift = chosen(lost > 0.5, rod.head.drift_standing, rod.head.drift)
        if ti.static(self.touches):
            self.contacts.restore(rod, lost)
