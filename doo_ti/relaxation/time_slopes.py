"""Derivatives of a motion by parameters, carried from step to step with it (docs/dynamics.md).

At a step's minimum z the gradient g(z, p) is zero, and so K dz/dp = −∂g/∂p. The last elimination of a step that has converged
was made at its minimum without shift: its factors are those of K, and a parameter costs one right-hand side. ∂g/∂p is that of
springs and joints by their stiffness and by where they pull, which depends on p through the instants before as well. Rotations
that a clamp holds do not depend on p.
"""

import taichi as ti

from doo_ti.physics import pair
from doo_ti.physics.quaternion import first_director, second_director, tangent
from doo_ti.physics.tuples import (
    against,
    backward,
    dot,
    forward,
    minus,
    minus_combination,
    negated,
    plus,
    products,
    repeated,
    scaled,
    symmetric_gram,
    variable,
)
from doo_ti.relaxation.chain import (
    BEND,
    ELIMINATED_BORDER,
    ELIMINATED_NEXT,
    INVERSE_LENGTH,
    LENGTH,
    OF_DRIFT_FACTORS,
    OF_ENERGY_UNIT,
    PIVOTS,
    TWIST,
)
from doo_ti.relaxation.time_sweep import DRAG, DRAG_BY_SPEED, INERTIA, OF_BEND_SHARE, OF_TWIST_SHARE, OF_VERTEX, TimeSweep

# A block belongs to a vertex, to the edge that ends there and to the joint where that edge begins.
# Items of a block that all parameters share: x − x̂ and x − y, mm; the extrapolated speed and its direction; l m1 and l m2;
# X, Y, 1/s, m and e^{im} of the joint, the strains of its left and right frame and of its twist, and
# :meth:`.TimeSweep.extrapolated_curvature`.
LAG, SLIP, SPEED, HEADING, LEVER_1, LEVER_2, CURVED, STRAIN, AHEAD, SHARED = 0, 3, 6, 7, 10, 13, 16, 24, 29, 34
# Items of a block for each parameter. What it remembers: derivatives of place and velocity at the last two instants, where
# :mod:`.time_sweep` has those of a vertex, and of X, Y and m.
CURVATURE_1, CURVATURE_2, REMEMBERED = 12, 17, 22
# Derivatives of the inertia, drags and load of the vertex, of B, β and ω̄ l̄/2; and W_r of the elimination. In the block of
# vertex 0, where no edge ends, the derivatives of the shares of damping and of the weight are in the place of B.
OF_NUMBERS, OF_BEND, OF_TWIST, OF_REST, RIGHT, OWN = 22, 26, 29, 30, 32, 35
NUMBERS = OF_BEND - OF_NUMBERS
OF_SHARES, OF_WEIGHT = OF_BEND, OF_BEND + 2


@ti.data_oriented
class TimeSlopes(TimeSweep):
    """The chain of :class:`.TimeSweep` with the derivatives of its steps. ``blocks`` is where they begin in scratch: the shared
    ones of all vertices, then those of each parameter."""

    def __init__(self, number, stride: int):
        super().__init__(number, False, stride)

    @ti.func
    def block(self, rod, blocks, parameter, vertex):
        """Place of a block of a parameter."""
        vertices = rod.edges + 1
        return blocks + (vertices * SHARED + (parameter * vertices + vertex) * OWN) * self.stride

    @ti.func
    def load5(self, scratch: ti.template(), at):
        return self.load4(scratch, at) + (scratch[at + 4 * self.stride],)

    @ti.func
    def differentiate(self, rod, blocks, count, time, up):
        """The derivatives of the step that has converged, by ``count`` parameters."""
        schur = self.share(rod, blocks, time)
        for parameter in range(count):
            right = self.eliminate_slope(rod, blocks, parameter, time, up)
            change, positive = self.bordered(rod, schur, right)
            self.substitute_slope(rod, blocks, parameter, change, time)

    # --- what all parameters share ---

    @ti.func
    def share(self, rod, blocks, time):
        """Fill the shared blocks; returns the Schur complement Σ W_λᵀ D⁻¹ W_λ."""
        s = self.stride
        place = variable(plus(rod.anchor, self.drift(rod)))
        self.share_vertex(rod, blocks, rod.head + (self.time_parameters + OF_VERTEX) * s, place, time)
        f, wa = self.start_factors(rod)
        schur = variable(symmetric_gram(f, wa))
        at, block = rod.origin, blocks + SHARED * s
        for e in range(rod.edges):
            q = self.load4(rod.scratch, at)
            length = rod.scratch[at + LENGTH * s]
            place = plus(place, scaled(tangent(q), length))
            self.share_vertex(rod, block, at + self.motion * s, place, time)
            self.store(rod.scratch, block + LEVER_1 * s, scaled(first_director(q), length) + scaled(second_director(q), length))
            if e > 0:
                self.share_joint(rod, block, at, time)
            schur = plus(schur, symmetric_gram(self.load6(rod.scratch, at + PIVOTS * s),
                                               self.load9(rod.scratch, at + self.force_columns * s)))
            at += self.edge_stride
            block += SHARED * s
        return schur

    @ti.func
    def start_factors(self, rod):
        """Factors and W_λ of vertex 0."""
        kept = rod.head + OF_DRIFT_FACTORS * self.stride
        return self.load6(rod.scratch, kept + 9 * self.stride), self.load9(rod.scratch, kept)

    @ti.func
    def share_vertex(self, rod, block, at, place, time):
        """Fill the vertex part of the shared block for the vertex at ``place``, whose items begin at ``at``."""
        y, ahead, fast = self.extrapolated(rod, at, time)
        x = scaled(place, rod.length_unit)
        speed = ti.sqrt(dot(fast, fast))
        items = minus(x, ahead) + minus(x, y) + (speed,) + scaled(fast, 1.0 / (speed + 1e-30))
        self.store(rod.scratch, block + LAG * self.stride, items)

    @ti.func
    def share_joint(self, rod, block, at, time):
        """Fill the joint part of the shared block for the joint where the edge at ``at`` begins."""
        x, y, inverse, turn, r = pair.curvature(self.load4(rod.scratch, at - self.edge_stride), self.load4(rod.scratch, at))
        m = self.twist_angle(r)
        rest_left, rest_right, rest_twist = self.rest(rod.scratch, at)
        self.store(rod.scratch, block + CURVED * self.stride, x + y + (inverse, m) + turn)
        strains = pair.strain(x, rest_left) + pair.strain(y, rest_right) + (m - rest_twist,)
        self.store(rod.scratch, block + STRAIN * self.stride, strains)
        self.store(rod.scratch, block + AHEAD * self.stride, self.extrapolated_curvature(rod, at, time))

    @ti.func
    def curved(self, rod, block):
        """(X, Y, 1/s, e^{im}) of the joint of a shared block."""
        b = self.load9(rod.scratch, block + CURVED * self.stride)
        return (b[0], b[1]), (b[2], b[3]), b[4], (b[6], b[7])

    # --- the right-hand side of a parameter ---

    @ti.func
    def eliminate_slope(self, rod, blocks, parameter, time, up):
        """W_r of −∂g/∂p for every edge and for vertex 0, as :meth:`.LoadedElimination.eliminate` makes it; returns
        Σ W_λᵀ D⁻¹ W_r."""
        s, zero = self.stride, 0.0 * rod.total
        first = self.block(rod, blocks, parameter, 0)
        unit = rod.length_unit
        weight = scaled(up, rod.scratch[first + OF_WEIGHT * s] * unit * unit / rod.scratch[rod.head + OF_ENERGY_UNIT * s])
        c, f = variable(repeated(zero, 3)), variable(repeated(zero, 3))
        right, g = variable(repeated(zero, 3)), variable(repeated(zero, 3))
        beyond = zero
        at, shared = rod.origin + (rod.edges - 1) * self.edge_stride, blocks + rod.edges * SHARED * s
        own = self.block(rod, blocks, parameter, rod.edges)
        for back in range(rod.edges):
            e = rod.edges - 1 - back
            length = rod.scratch[at + LENGTH * s]
            hang = self.hanging_weight(rod, length, beyond)
            beyond = beyond + length
            pull = variable(self.pull_slope(rod, at + self.motion * s, shared, own, time, up))
            before = variable(repeated(zero, 3))
            if e > 0:
                left, joint = self.joint_slope(rod, at, shared, own, first, time)
                before = left
                g = plus(g, joint)
            force = plus(plus(c, pull), scaled(weight, hang))
            lever1, lever2 = self.load3(rod.scratch, shared + LEVER_1 * s), self.load3(rod.scratch, shared + LEVER_2 * s)
            moment = (g[0], g[1] - dot(lever2, force), g[2] + dot(lever1, force))
            b = products(self.freedom(rod, e), negated(plus(moment, f)))
            d = self.load6(rod.scratch, at + PIVOTS * s)
            wr = forward(d, b)
            self.store(rod.scratch, own + RIGHT * s, wr)
            c = plus(plus(c, pull), against(d, self.load9(rod.scratch, at + ELIMINATED_BORDER * s), wr))
            f = against(d, self.load9(rod.scratch, at + ELIMINATED_NEXT * s), wr)
            right = plus(right, against(d, self.load9(rod.scratch, at + self.force_columns * s), wr))
            g = before
            at -= self.edge_stride
            shared -= SHARED * s
            own -= OWN * s
        start = self.pull_slope(rod, rod.head + (self.time_parameters + OF_VERTEX) * s, blocks, first, time, up)
        c = plus(plus(c, start), scaled(weight, 2.0 * rod.total))
        pivots, wa = self.start_factors(rod)
        w = forward(pivots, scaled(c, 0.0 - rod.loose))
        self.store(rod.scratch, first + RIGHT * s, w)
        return plus(right, against(pivots, wa, w))

    @ti.func
    def pull_slope(self, rod, at, shared, own, time, up):
        """∂γ/∂p of the springs κ (x − x̂) + d (x − y) + load at a vertex, whose items begin at ``at``."""
        s = self.stride
        dy, ahead, fast = self.extrapolated(rod, own, time)
        change = self.load4(rod.scratch, own + OF_NUMBERS * s)
        by_speed, speed = rod.scratch[at + DRAG_BY_SPEED * s], rod.scratch[shared + SPEED * s]
        drag = rod.scratch[at + DRAG * s] + by_speed * speed
        heading = self.load3(rod.scratch, shared + HEADING * s)
        drag_change = change[1] + change[2] * speed + by_speed * dot(heading, fast)
        stiffer = plus(scaled(self.load3(rod.scratch, shared + LAG * s), change[0]),
                       scaled(self.load3(rod.scratch, shared + SLIP * s), drag_change))
        moved = plus(scaled(ahead, rod.scratch[at + INERTIA * s]), scaled(dy, drag))
        return scaled(minus(plus(stiffer, scaled(up, change[3])), moved), rod.length_unit)

    @ti.func
    def joint_slope(self, rod, at, shared, own, first, time):
        """(left, right) ∂g/∂p of the joint where the edge at ``at`` begins."""
        s = self.stride
        previous = at - self.edge_stride
        inverse_length = rod.scratch[at + INVERSE_LENGTH * s]
        u = self.load5(rod.scratch, shared + STRAIN * s)
        rest = self.rest_slope(rod, shared, own, first, time)
        left = minus(pair.moment(self.load3(rod.scratch, own - OWN * s + OF_BEND * s), (u[0], u[1]), inverse_length),
                     pair.moment(self.load3(rod.scratch, previous + BEND * s), (rest[0], rest[1]), inverse_length))
        right = minus(pair.moment(self.load3(rod.scratch, own + OF_BEND * s), (u[2], u[3]), inverse_length),
                      pair.moment(self.load3(rod.scratch, at + BEND * s), (rest[2], rest[3]), inverse_length))
        twist = rod.scratch[own + OF_TWIST * s] * u[4] - rod.scratch[at + TWIST * s] * rest[4]
        x, y, inverse, turn = self.curved(rod, shared)
        return pair.gradient_of_moments(left, right, 2.0 * inverse_length * twist, x, y, inverse, turn)

    @ti.func
    def rest_slope(self, rod, shared, own, first, time):
        """Derivatives of u̅ of the left frame and of the right one, and of m̅."""
        s = self.stride
        last, before = self.load5(rod.scratch, own + CURVATURE_1 * s), self.load5(rod.scratch, own + CURVATURE_2 * s)
        y = plus(last, scaled(minus(last, before), time.extrapolation))
        ahead = self.load5(rod.scratch, shared + AHEAD * s)
        bend = rod.scratch[rod.head + (self.time_parameters + OF_BEND_SHARE) * s]
        twist = rod.scratch[rod.head + (self.time_parameters + OF_TWIST_SHARE) * s]
        bend_change, twist_change = rod.scratch[first + OF_SHARES * s], rod.scratch[first + (OF_SHARES + 1) * s]
        rest1, rest2 = rod.scratch[own + OF_REST * s], rod.scratch[own + (OF_REST + 1) * s]
        return (rest1 + bend_change * ahead[0] + 2.0 * bend * y[1], rest2 + bend_change * ahead[1] - 2.0 * bend * y[0],
                rest1 + bend_change * ahead[2] + 2.0 * bend * y[3], rest2 + bend_change * ahead[3] - 2.0 * bend * y[2],
                twist_change * ahead[4] + twist * y[4])

    # --- the derivatives of a parameter ---

    @ti.func
    def substitute_slope(self, rod, blocks, parameter, change, time):
        """The derivatives of the step from W_r, which become those at the last instant."""
        s, zero = self.stride, 0.0 * rod.total
        own = self.block(rod, blocks, parameter, 0)
        d, wa = self.start_factors(rod)
        x = variable(backward(d, minus_combination(self.load3(rod.scratch, own + RIGHT * s), wa, change)))
        self.remember_place(rod, own, x, time)
        w = variable(repeated(zero, 3))
        at, shared = rod.origin, blocks + SHARED * s
        own += OWN * s
        for e in range(rod.edges):
            held = minus_combination(self.load3(rod.scratch, own + RIGHT * s),
                                     self.load9(rod.scratch, at + self.force_columns * s), change)
            moved = minus_combination(held, self.load9(rod.scratch, at + ELIMINATED_BORDER * s), x)
            y = minus_combination(moved, self.load9(rod.scratch, at + ELIMINATED_NEXT * s), w)
            turned = backward(self.load6(rod.scratch, at + PIVOTS * s), y)
            if e > 0:
                cx, cy, inverse, turn = self.curved(rod, shared)
                last = self.load5(rod.scratch, own + CURVATURE_1 * s)
                self.store(rod.scratch, own + CURVATURE_2 * s, last)
                self.store(rod.scratch, own + CURVATURE_1 * s, pair.curvature_variation(cx, cy, inverse, turn, w, turned))
            w = turned
            lever1, lever2 = self.load3(rod.scratch, shared + LEVER_1 * s), self.load3(rod.scratch, shared + LEVER_2 * s)
            x = plus(x, minus(scaled(lever1, w[2]), scaled(lever2, w[1])))
            self.remember_place(rod, own, x, time)
            at += self.edge_stride
            shared += SHARED * s
            own += OWN * s

    @ti.func
    def remember_place(self, rod, own, x, time):
        """As :meth:`remember_vertex`, of the derivative ``x`` of a place in the rod's unit of length."""
        self.remember_vertex(rod, own, x, time, rod.total > 0.0)
