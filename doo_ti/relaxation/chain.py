"""A chain of frames in scratch memory: its layout, the step, closure and the energy (§III-B to §III-D).

Scratch holds, for every pack of rods, the parameters of its rods, and then for each edge the items named below; ``number`` says
how many rods a value holds and ``stride`` how far apart the items of an edge lie. :mod:`doo_ti.relaxation.elimination` and
:mod:`doo_ti.relaxation.loaded_elimination` solve the Newton system of this chain.
"""

import taichi as ti

from doo_ti.physics import pair
from doo_ti.physics.algebra import absolute, solve_symmetric
from doo_ti.physics.angle import twist_angle_function
from doo_ti.physics.closure import closing_rotation, linear_gradient, normal_matrix
from doo_ti.physics.quaternion import first_director, second_director, tangent, turned_in_body, turned_in_world
from doo_ti.physics.tuples import chosen, dot, minus, negated, on_diagonal, plus, record, repeated, scaled, variable

# Items of an edge in scratch. Those of a vertex (1/l̄, β, ω̄) lie with the edge that leaves it.
FRAME = 0
STANDING = 4  # the frame before the step, restored where the step is rejected
LENGTH = 8
INVERSE_LENGTH = 9
ROTATION = 10  # the right-hand side while eliminating, the step after back-substitution
ELIMINATED_NEXT = 13
ELIMINATED_BORDER = 22
BENT = 22  # before eliminating: curvature and twist at the vertex where the edge ends
PIVOTS = 31
ISOTROPIC_ITEMS = 37
BEND = 37
TWIST = 40
REST = 41
SHIFT_SHARES = 43  # of a spin and of a tilt
GENERAL_ITEMS = 45

EASILY_TWISTED = 1e-2
"""β over α, below which twisting is much easier than bending."""

# Parameters of the rods of a pack, before the items of their edges (see :class:`Chain`).
OF_TARGET, OF_CLOSED, OF_FREE, OF_RELEASED, OF_TOTAL, OF_LONGEST = 0, 3, 4, 9, 10, 11
OF_ENERGY_UNIT, OF_STIFFNESS, OF_GRAVITY, OF_ANCHOR, OF_SCALE, OF_LENGTH_UNIT = 12, 13, 15, 18, 21, 22
OF_SOFTEST, OF_SHIFT_SHARES, PARAMETERS = 23, 24, 26
# And those of rods whose vertex 0 may move: the flag, how far it has moved, its place before the step, its step, and what
# the substitution needs of its elimination.
OF_LOOSE, OF_DRIFT, OF_DRIFT_STANDING, OF_DRIFT_STEP, OF_DRIFT_FACTORS, LOADED_PARAMETERS = 26, 27, 30, 33, 36, 51


def item_count(isotropic: bool) -> int:
    """Items of an edge."""
    return ISOTROPIC_ITEMS if isotropic else GENERAL_ITEMS


@ti.data_oriented
class Chain:
    """The sweeps that all rods share, for one kind of number and of material.

    Its functions take a record ``rod`` (:meth:`rods`) of the rods in one pack:

    scratch, head, origin   the array, and the places of the parameters and of the first edge in it
    edges                   number of edges
    target, closed          the far point from vertex 0, and one where it is held there, else zero
    free                    (spin_start, tilt_start, spin_end, tilt_end, tilt_inner): one where that rotation of the first edge,
                            of the last or of those between is unknown, zero where it is held
    released                one where vertex 0 is free and the far end holds the rod
    loose                   one where vertex 0 is free to move (:class:`.LooseStart`)
    total, longest          length of the rod and of its longest edge
    stiffness               (α, β) of isotropic rods, unused otherwise
    softest                 the smallest eigenvalue of B anywhere along the rod, or β where that is less
    shift_shares            (spin, tilt) of isotropic rods, of others those of their softest part: see :meth:`shifts`
    gravity                 μ times the unit vector up
    anchor                  the point that the chain hangs from
    length_unit             of all these lengths, mm; energies have a unit of their own (:meth:`.Loading.load`)
    numbers, field, coarse  of an external energy (see :class:`doo_ti.relaxation.external.ExternalFunctions`)
    contacts, kinds, obstacles  where the items of contacts begin, the kinds of the obstacles and how many these are
                            (:class:`.Contacts`)

    extra: items of an edge that belong to an external energy.
    """

    def __init__(self, number, isotropic: bool, stride: int, extra: int = 0):
        self.number = number
        self.isotropic = isotropic
        self.stride = stride
        self.items = item_count(isotropic) + extra
        self.edge_stride = self.items * stride
        self.parameters = PARAMETERS
        self.moves_start = False
        self.touches = False
        self.largest = number.lanes().largest
        self.twist_angle = twist_angle_function(number)
        # What makes AᵀA regular: a share of its trace, and where that is zero a number whose cube is not.
        # Without closure the edges of a straight rod are parallel; with it they never quite are, and λ has to be exact.
        self.regular, self.regular_open, self.least = (1e-6, 0.0, 1e-12) if number.bits == 32 else (1e-16, 1e-13, 1e-30)
        self.tiny = 1e-30 if number.bits == 32 else 1e-100  # see :func:`.factor`

    # --- access to scratch ---

    @ti.func
    def load3(self, scratch: ti.template(), at):
        return (scratch[at], scratch[at + self.stride], scratch[at + 2 * self.stride])

    @ti.func
    def load4(self, scratch: ti.template(), at):
        return self.load3(scratch, at) + (scratch[at + 3 * self.stride],)

    @ti.func
    def load6(self, scratch: ti.template(), at):
        return self.load3(scratch, at) + self.load3(scratch, at + 3 * self.stride)

    @ti.func
    def load9(self, scratch: ti.template(), at):
        return self.load6(scratch, at) + self.load3(scratch, at + 6 * self.stride)

    @ti.func
    def store(self, scratch: ti.template(), at, values):
        for k in ti.static(range(len(values))):
            scratch[at + k * self.stride] = values[k]

    @ti.func
    def behind(self, threads, thread, edges, numbers):
        """Where ``numbers`` more of a thread begin in scratch: behind the chains of all threads."""
        first = threads * (self.parameters + self.items * edges) + thread
        if ti.static(self.stride == 1):
            first += thread * (numbers - 1)
        return first

    @ti.func
    def rods(self, tables, scratch: ti.template(), head, coarse):
        """The record of the rods whose parameters begin at ``head``, with the tables of an external energy if there is one."""
        return record(
            scratch=scratch, head=head, origin=head + self.parameters * self.stride, edges=tables.rest_length.shape[1],
            loose=self.loose(scratch, head), contacts=tables.contacts, kinds=tables.kinds, grids=tables.grids,
            obstacles=tables.kinds.shape[0],
            target=self.load3(scratch, head + OF_TARGET * self.stride),
            length_unit=scratch[head + OF_LENGTH_UNIT * self.stride],
            closed=scratch[head + OF_CLOSED * self.stride], spins_first=0.0 * scratch[head + OF_CLOSED * self.stride],
            free=self.load4(scratch, head + OF_FREE * self.stride) + (scratch[head + (OF_FREE + 4) * self.stride],),
            released=scratch[head + OF_RELEASED * self.stride],
            total=scratch[head + OF_TOTAL * self.stride],
            longest=scratch[head + OF_LONGEST * self.stride],
            stiffness=(scratch[head + OF_STIFFNESS * self.stride], scratch[head + (OF_STIFFNESS + 1) * self.stride]),
            softest=scratch[head + OF_SOFTEST * self.stride],
            shift_shares=(scratch[head + OF_SHIFT_SHARES * self.stride], scratch[head + (OF_SHIFT_SHARES + 1) * self.stride]),
            gravity=self.load3(scratch, head + OF_GRAVITY * self.stride),
            anchor=self.load3(scratch, head + OF_ANCHOR * self.stride), numbers=tables.numbers, field=tables.field,
            coarse=coarse)

    @ti.func
    def loose(self, scratch: ti.template(), head):
        """One where vertex 0 is free to move (:class:`.LooseStart`)."""
        loose = 0.0 * scratch[head + OF_CLOSED * self.stride]
        if ti.static(self.moves_start):
            loose = scratch[head + OF_LOOSE * self.stride]
        return loose

    @ti.func
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

    @ti.func
    def second_derivatives(self, rod, h, g):
        """H of an edge by w as a step turns it, from ``h`` with spins made first and the gradient ``g``: with rotation vectors
        the second derivative by spin and tilt is the mean of both orders."""
        half = 0.5 * (1.0 - rod.spins_first)
        return (h[0], h[1] + half * g[2], h[2] - half * g[1], h[3], h[4], h[5])

    @ti.func
    def shifts(self, rod, at, shift):
        """``shift`` of a spin and of a tilt of the edge ``at``: at most a large multiple of what is stiff there, so that the
        soft parts of a rod with a stiff one still move."""
        if ti.static(self.isotropic):
            return (shift * rod.shift_shares[0], shift * rod.shift_shares[1])
        else:
            shares = at + SHIFT_SHARES * self.stride
            return (shift * rod.scratch[shares], shift * rod.scratch[shares + self.stride])

    @ti.func
    def stiffness(self, scratch: ti.template(), left, right, material):
        """Stiffness tuple of :mod:`doo_ti.physics.pair` for the vertex between two neighbouring edges."""
        inverse = scratch[right + INVERSE_LENGTH * self.stride]
        if ti.static(self.isotropic):
            return (material[0] * inverse, material[1] * inverse)
        else:
            return (
                self.load3(scratch, left + BEND * self.stride),
                self.load3(scratch, right + BEND * self.stride),
                inverse,
                scratch[right + TWIST * self.stride] * inverse,
            ) + self.rest(scratch, right)

    @ti.func
    def rest(self, scratch: ti.template(), at):
        """What stiffness ends with, of the vertex where an edge begins: u̅, the same for both frames."""
        return ((scratch[at + REST * self.stride], scratch[at + (REST + 1) * self.stride]),)

    @ti.func
    def bent(self, scratch: ti.template(), at):
        """(X, Y, 1/s, m, e^{im}) at the end of an edge: see :mod:`doo_ti.physics.pair`."""
        b = self.load6(scratch, at + BENT * self.stride)
        turn = (scratch[at + (BENT + 6) * self.stride], scratch[at + (BENT + 7) * self.stride])
        return ((b[0], b[1]), (b[2], b[3]), b[4], b[5], turn)

    # --- the energy of a pair of edges ---

    @ti.func
    def energy_of(self, bent, s):
        if ti.static(self.isotropic):
            return pair.isotropic_energy(bent[0], bent[3], s)
        else:
            return pair.general_energy(bent[0], bent[1], bent[3], s)

    @ti.func
    def gradient_of(self, bent, s):
        x, y, inverse, m, turn = bent
        if ti.static(self.isotropic):
            return pair.isotropic_gradient(x, y, inverse, m, s)
        else:
            return pair.general_gradient(x, y, inverse, turn, m, s)

    @ti.func
    def derivatives(self, bent, s):
        """(g_left, g_right, H_left, H_right, H_across) of a pair."""
        x, y, inverse, m, turn = bent
        if ti.static(self.isotropic):
            return self.gradient_of(bent, s) + pair.isotropic_hessian(x, y, inverse, turn, m, s)
        else:
            return self.gradient_of(bent, s) + pair.general_hessian(x, y, inverse, turn, m, s)

    # --- free rotations and weight ---

    @ti.func
    def freedom(self, rod, edge):
        """(spin, tilt, tilt) of an edge: one where it may turn about its tangent, and about m1 and m2."""
        one = 0.0 * rod.total + 1.0
        free = variable((one, rod.free[4], rod.free[4]))
        if edge == 0:
            free = (rod.free[0], rod.free[1], rod.free[1])
        if edge == rod.edges - 1:
            free = (rod.free[2], rod.free[3], rod.free[3])
        return free

    @ti.func
    def hanging_weight(self, rod, length, remaining):
        """Coefficient of gravity on an edge: Σ_{i>j} l̄_i, less Σ_i l̄_i where the rod hangs from its far end."""
        return length + 2.0 * remaining - 2.0 * rod.total * rod.released

    @ti.func
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

    @ti.func
    def step(self, rod, scale, moving, before):
        """Frames turned by scale ω (:meth:`spinning_first`), and x of the projection that puts them back on closure, both only
        where ``moving``; and AᵀA over the edges that may tilt. Where rods may touch something, a step that is not taken whole
        leaves its share of what they missed ``before``."""
        zero = 0.0 * scale
        stepping = (scale > 0.0) | (scale < 0.0)
        reached, lost = variable(repeated(zero, 3)), variable(repeated(zero, 3))
        normal = variable(repeated(zero, 6))
        if ti.static(self.touches):
            self.contacts.stand_pairs(rod)
        at = rod.origin
        for e in range(rod.edges):
            # In a lane that does not step the rotation is undefined and may be NaN.
            rotation = self.load3(rod.scratch, at + ROTATION * self.stride)
            w = chosen(stepping, scaled(rotation, scale), repeated(zero, 3))
            standing = self.load4(rod.scratch, at)
            self.store(rod.scratch, at + STANDING * self.stride, standing)
            q = turned_in_body(standing, w, rod.spins_first)
            self.store(rod.scratch, at, q)
            length = rod.scratch[at + LENGTH * self.stride]
            t = tangent(q)
            reached, lost = self.summed(reached, lost, scaled(t, length))
            normal = plus(normal, scaled(normal_matrix(length, t), self.freedom(rod, e)[1]))
            at += self.edge_stride
        goal = variable(rod.target)
        if ti.static(self.touches):
            goal = plus(goal, scaled(before, ti.select(stepping, 1.0 - scale, zero)))
        if ti.static(self.moves_start):
            moving = self.step_start(rod, scale, moving, reached, goal)
            reached = self.displaced(rod, reached)
        miss = scaled(minus(reached, goal), rod.closed)
        normal = self._regular(rod, normal)
        x, minors = solve_symmetric(normal, miss)
        # x·miss is the sum of the squared rotations: keep their root mean square below 0.15 rad in one projection.
        size = ti.sqrt(ti.max(dot(x, miss), zero) / ti.cast(rod.edges, self.number.scalar)) + 1e-30
        shrink = moving * ti.min(0.0 * size + 1.0, 0.15 / size)
        return scaled(x, shrink), normal

    @ti.func
    def _regular(self, rod, n):
        """AᵀA made regular where all free edges are parallel, or none may tilt."""
        share = self.regular + self.regular_open * (1.0 - rod.closed)
        return on_diagonal(n, share * (n[0] + n[3] + n[5]) + self.least)

    @ti.func
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
        at = rod.origin
        for e in range(rod.edges):
            raw = self.load4(rod.scratch, at)
            length = rod.scratch[at + LENGTH * self.stride]
            raw_tangent = tangent(raw)
            rotation = variable(closing_rotation(length, raw_tangent, x))
            levers = length
            if e == 0 or e == rod.edges - 1 or some_taut:
                tilt = self.freedom(rod, e)[1]
                rotation = scaled(rotation, tilt)
                levers = length * tilt
            q = turned_in_world(raw, rotation)
            self.store(rod.scratch, at, q)
            right1, right2 = (zero, zero)
            if e > 0:
                bent, s = self._bend(rod, at, before, q)
                energy = energy + self.energy_of(bent, s)
                left, right = self.gradient_of(bent, s)
                moment = minus(plus(moment, scaled(lever1, carry2 + left[2])), scaled(lever2, carry1 + left[1]))
                right1, right2 = (right[1], right[2])
            t, m1, m2 = tangent(q), first_director(q), second_director(q)
            lever1, lever2 = scaled(m1, levers), scaled(m2, levers)
            remaining = remaining - length
            pull = scaled(rod.gravity, self.hanging_weight(rod, length, remaining))
            height = length * dot(pull, t)
            potential = potential + height
            magnitude = magnitude + absolute(height)
            # Where the edge may not tilt these are zero, and so is its share of Aᵀg.
            l1, l2 = linear_gradient(pull, levers, m1, m2)
            carry1, carry2 = (right1 + l1, right2 + l2)
            reached, lost = self.summed(reached, lost, scaled(t, length))
            unclosed = ti.min(unclosed, dot(raw_tangent, rod.target))
            closed = ti.min(closed, dot(t, rod.target))
            before = q
            at += self.edge_stride
        moment = minus(plus(moment, scaled(lever1, carry2)), scaled(lever2, carry1))
        if ti.static(self.moves_start):
            reached = self.displaced(rod, reached)
            potential = potential + self.lifted_start(rod)
        miss = scaled(minus(reached, rod.target), rod.closed)
        fit, minors = solve_symmetric(normal, moment)
        return energy + potential, energy + magnitude, miss, negated(scaled(fit, rod.closed)), (unclosed, closed)

    @ti.func
    def _bend(self, rod, at, before, q):
        """Curvature and twist between the frame before and the frame q of the edge ``at``, kept for the elimination, and the
        stiffness there."""
        previous = at - self.edge_stride
        px, py, inverse, turn, r = pair.curvature(before, q)
        m = self.twist_angle(r)
        self.store(rod.scratch, previous + BENT * self.stride, px + py + (inverse, m) + turn)
        return (px, py, inverse, m, turn), self.stiffness(rod.scratch, previous, at, rod.stiffness)

    @ti.func
    def restore(self, rod, lost):
        """Restore the frames from before the step in the lanes that reject it."""
        at = rod.origin
        for _ in range(rod.edges):
            standing = self.load4(rod.scratch, at + STANDING * self.stride)
            self.store(rod.scratch, at, chosen(lost > 0.5, standing, self.load4(rod.scratch, at)))
            at += self.edge_stride
        if ti.static(self.moves_start):
            self.restore_start(rod, lost)
        if ti.static(self.touches):
            self.contacts.restore(rod, lost)
