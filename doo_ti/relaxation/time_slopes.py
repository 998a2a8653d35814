"""Derivatives of a motion by parameters, carried from step to step with it (docs/dynamics.md).

At a step's minimum z the gradient g(z, p) is zero, and so K dz/dp = −∂g/∂p. The last elimination of a step that has converged
was made at its minimum without shift: its factors are those of K, and a parameter costs one right-hand side. ∂g/∂p is that of
springs and joints by their stiffness and by where they pull, which depends on p through the instants before as well. Rotations
that a clamp holds do not depend on p. The lanes of a pack make their steps together.
"""

import taichi as ti

from doo_ti.physics import pair
from doo_ti.physics.algebra import against, backward, forward, minus_combination
from doo_ti.physics.number import Layout, device_functions, in_f64
from doo_ti.physics.quaternion import first_director, second_director, tangent
from doo_ti.physics.tuples import choose, dot, extended, minus, negated, picked, plus, products, repeated, scaled, variable
from doo_ti.relaxation import tables as of
from doo_ti.relaxation.loading import load_stiffness
from doo_ti.relaxation.time_loop import TimeLoop
from doo_ti.relaxation.time_sweep import TimeSweep

# A block belongs to a vertex, to the edge that ends there and to the joint where that edge begins.
SHARED = Layout(lag=3, slip=3, speed=1, heading=3, seen=("lag", 10), lever_1=3, lever_2=3, curved=8, strain=5, ahead=5)
"""What all parameters share.

lag, slip       x − x̂ and x − y, mm
speed, heading  the extrapolated speed and its direction
lever           l m1 and l m2
curved, strain  of the joint X, Y, 1/s, m and e^{im}; the strains of its left and right frame and of its twist
ahead           :meth:`.TimeSweep.extrapolated_curvature`"""
OWN = Layout(place_1=3, place_2=3, velocity_1=3, velocity_2=3, curvature_1=5, curvature_2=5, of_numbers=4, bend=3,
             of_rod=("bend", 3), twist=1, rest=2, right=3)
"""Derivatives by one parameter.

place, velocity, curvature  what it remembers: at the last two instants, with X, Y and m
of_numbers                  of the inertia, drags and load of the vertex
bend, twist, rest           of B, β and ω̄ l̄/2
of_rod                      in the block of vertex 0, where no edge ends: of the shares of damping and of the weight
right                       W_r of the elimination"""
CURVATURE_1, CURVATURE_2, REMEMBERED = map(OWN.at, ("curvature_1", "curvature_2", "of_numbers"))
NUMBERS = OWN.at("bend") - OWN.at("of_numbers")


@picked
def slope_items(edges, parameters):
    """Numbers of a rod's derivatives in scratch."""
    return (edges + 1) * (len(SHARED) + parameters * len(OWN))


@device_functions
class TimeSlopes(TimeSweep):
    """The chain of :class:`.TimeSweep` with the derivatives of its steps. ``blocks`` is the view of the first in scratch: the
    shared ones of all vertices, then those of each parameter."""

    def __init__(self, number, stride: int):
        super().__init__(number, False, stride)

    @picked
    def completed(self, given, thread):
        edges = given.rest_length.shape[1]
        numbers = slope_items(edges, given.number_slopes.shape[0])
        return extended(TimeSweep.completed(self, given, thread),
                        blocks=self.behind(given.scratch, given.threads, thread, edges, numbers, SHARED))

    @picked
    def items(self, given):
        return TimeSweep.items(self, given) + slope_items(given.rest_length.shape[1], given.number_slopes.shape[0])

    @picked
    def shared(self, blocks, vertex):
        """The view of the shared block of a vertex."""
        return blocks.part(SHARED, vertex * len(SHARED))

    @picked
    def block(self, blocks, edges, parameter, vertex):
        """The view of the block of a vertex for a parameter, of rods with so many edges."""
        vertices = edges + 1
        return blocks.part(OWN, vertices * len(SHARED) + (parameter * vertices + vertex) * len(OWN))

    def differentiate(self, rod, blocks, count, time, up):
        """The derivatives of the step that has converged, by ``count`` parameters."""
        self.share(rod, blocks, time)
        schur = self.schur_complement(rod)
        for parameter in range(count):
            right = self.eliminate_slope(rod, blocks, parameter, time, up)
            change, positive = self.bordered(rod, schur, right)
            self.substitute_slope(rod, blocks, parameter, change, time)

    # --- what all parameters share ---

    def share(self, rod, blocks, time):
        """Fill the shared blocks."""
        place = variable(plus(rod.anchor, rod.head.drift))
        self.share_vertex(rod, self.shared(blocks, 0), rod.head.vertex, place, time)
        for e in range(rod.edges):
            edge, block = self.edge(rod.head, e), self.shared(blocks, e + 1)
            q = edge.frame
            length = edge.length
            place = plus(place, scaled(tangent(q), length))
            self.share_vertex(rod, block, edge.motion, place, time)
            block.lever_1, block.lever_2 = scaled(first_director(q), length), scaled(second_director(q), length)
            if e > 0:
                previous = self.edge(rod.head, e - 1)
                x, y, inverse, turn, r = pair.curvature(previous.frame, q)
                m = self.twist_angle(r)
                rest_left, rest_right, rest_twist = self.rest(edge)
                block.curved = x + y + (inverse, m) + turn
                block.strain = pair.strain(x, rest_left) + pair.strain(y, rest_right) + (m - rest_twist,)
                block.ahead = self.extrapolated_curvature(previous.motion, edge.motion, time)

    def share_vertex(self, rod, block, vertex, place, time):
        """Fill the vertex part of the shared block for a ``vertex`` at ``place``."""
        y, ahead, fast = self.extrapolated(vertex, time)
        x = scaled(place, rod.length_unit)
        speed = ti.sqrt(dot(fast, fast))
        block.seen = minus(x, ahead) + minus(x, y) + (speed,) + scaled(fast, 1.0 / (speed + 1e-30))

    # --- the right-hand side of a parameter ---

    def eliminate_slope(self, rod, blocks, parameter, time, up):
        """W_r of −∂g/∂p for every edge and vertex 0, as :meth:`.LoadedElimination.eliminate` has it; returns Σ W_λᵀ D⁻¹ W_r."""
        zero = 0.0 * rod.total
        first = self.block(blocks, rod.edges, parameter, 0)
        unit = rod.length_unit
        weight = scaled(up, first.of_rod[2] * unit * unit / rod.head.energy_unit)
        c, f = variable(repeated(zero, 3)), variable(repeated(zero, 3))
        right, g = variable(repeated(zero, 3)), variable(repeated(zero, 3))
        beyond = zero
        for back in range(rod.edges):
            e = rod.edges - 1 - back
            edge, shared = self.edge(rod.head, e), self.shared(blocks, e + 1)
            own = self.block(blocks, rod.edges, parameter, e + 1)
            length = edge.length
            hang = self.hanging_weight(rod, length, beyond)
            beyond = beyond + length
            pull = variable(self.pull_slope(rod, edge.motion, shared, own, time, up))
            before = variable(repeated(zero, 3))
            if e > 0:
                own_before = self.block(blocks, rod.edges, parameter, e)
                left, joint = self.joint_slope(rod, e, shared, own, own_before, first, time)
                before = left
                g = plus(g, joint)
            force = plus(plus(c, pull), scaled(weight, hang))
            lever1, lever2 = shared.lever_1, shared.lever_2
            moment = (g[0], g[1] - dot(lever2, force), g[2] + dot(lever1, force))
            b = products(self.freedom(rod, e), negated(plus(moment, f)))
            d = edge.pivots
            wr = forward(d, b)
            own.right = wr
            c = plus(plus(c, pull), against(d, edge.border, wr))
            f = against(d, edge.neighbour, wr)
            right = plus(right, against(d, edge.force_border, wr))
            g = before
        start = self.pull_slope(rod, rod.head.vertex, self.shared(blocks, 0), first, time, up)
        c = plus(plus(c, start), scaled(weight, 2.0 * rod.total))
        pivots = rod.head.drift_pivots
        w = forward(pivots, scaled(c, 0.0 - rod.loose))
        first.right = w
        return plus(right, against(pivots, rod.head.drift_border, w))

    def pull_slope(self, rod, vertex, shared, own, time, up):
        """∂γ/∂p of the springs κ (x − x̂) + d (x − y) + load at a ``vertex``."""
        dy, ahead, fast = self.extrapolated(own, time)
        change = own.of_numbers
        by_speed, speed = vertex.drag_by_speed, shared.speed
        drag = vertex.drag + by_speed * speed
        heading = shared.heading
        drag_change = change[1] + change[2] * speed + by_speed * dot(heading, fast)
        stiffer = plus(scaled(shared.lag, change[0]), scaled(shared.slip, drag_change))
        moved = plus(scaled(ahead, vertex.inertia), scaled(dy, drag))
        return scaled(minus(plus(stiffer, scaled(up, change[3])), moved), rod.length_unit)

    def joint_slope(self, rod, e, shared, own, own_before, first, time):
        """(left, right) ∂g/∂p of the joint where edge ``e`` begins."""
        previous, edge = self.edge(rod.head, e - 1), self.edge(rod.head, e)
        inverse_length = edge.inverse_length
        u = shared.strain
        rest = self.rest_slope(rod, shared, own, first, time)
        left = minus(pair.moment(own_before.bend, (u[0], u[1]), inverse_length),
                     pair.moment(previous.bend, (rest[0], rest[1]), inverse_length))
        right = minus(pair.moment(own.bend, (u[2], u[3]), inverse_length),
                      pair.moment(edge.bend, (rest[2], rest[3]), inverse_length))
        twist = own.twist * u[4] - edge.twist * rest[4]
        x, y, inverse, _, turn = self.bent(shared.curved)
        return pair.gradient_of_moments(left, right, 2.0 * inverse_length * twist, x, y, inverse, turn)

    def rest_slope(self, rod, shared, own, first, time):
        """Derivatives of u̅ of the left frame and of the right one, and of m̅."""
        last, before = own.curvature_1, own.curvature_2
        y = plus(last, scaled(minus(last, before), time.extrapolation))
        ahead = shared.ahead
        bend, twist = rod.head.bend_share, rod.head.twist_share
        bend_change, twist_change = first.of_rod[0], first.of_rod[1]
        rest1, rest2 = own.rest[0], own.rest[1]
        return (rest1 + bend_change * ahead[0] + 2.0 * bend * y[1], rest2 + bend_change * ahead[1] - 2.0 * bend * y[0],
                rest1 + bend_change * ahead[2] + 2.0 * bend * y[3], rest2 + bend_change * ahead[3] - 2.0 * bend * y[2],
                twist_change * ahead[4] + twist * y[4])

    # --- the derivatives of a parameter ---

    def substitute_slope(self, rod, blocks, parameter, change, time):
        """The derivatives of the step from W_r, which become those at the last instant."""
        first, every = self.block(blocks, rod.edges, parameter, 0), rod.total > 0.0
        x = variable(backward(rod.head.drift_pivots, minus_combination(first.right, rod.head.drift_border, change)))
        self.remember_vertex(rod, first, x, time, every)
        w = variable(repeated(0.0 * rod.total, 3))
        for e in range(rod.edges):
            edge, shared = self.edge(rod.head, e), self.shared(blocks, e + 1)
            own = self.block(blocks, rod.edges, parameter, e + 1)
            right = minus_combination(own.right, edge.force_border, change)
            moved = minus_combination(right, edge.border, x)
            y = minus_combination(moved, edge.neighbour, w)
            turned = backward(edge.pivots, y)
            if e > 0:
                cx, cy, inverse, _, turn = self.bent(shared.curved)
                own.curvature_2 = own.curvature_1
                own.curvature_1 = pair.curvature_variation(cx, cy, inverse, turn, w, turned)
            w = turned
            lever1, lever2 = shared.lever_1, shared.lever_2
            x = plus(x, minus(scaled(lever1, w[2]), scaled(lever2, w[1])))
            self.remember_vertex(rod, own, x, time, every)


@device_functions
class TimeSlopeLoop(TimeLoop):
    """The loop with derivatives by parameters. ``tables`` holds, besides, blocks, the view of this thread's in scratch, and the
    derivatives of what a rod is given, of what it remembers, ``slopes``, and of its positions.

    A parameter costs the same for one lane as for all: lanes that have converged wait for the others of their pack.
    """

    differentiates = True

    def exchanges(self, lane):
        """Once all lanes with a rod have finished."""
        return self.largest(lane.active * (1.0 - lane.finished)) < 0.25

    def advance(self, tables, head, lane):
        """A trip, in which lanes that wait keep their frames and repeat the elimination. Each does so once at least, so that
        its factors do not depend on how long it waits for others: the first one at its final frames may be of a refused step,
        or beside a smaller trace. Until then ``finished`` is a half."""
        zero, one = self.constant(0.0), self.constant(1.0)
        waits = lane.finished > 0.25
        choose(lane, waits, trying=zero, closing=zero, escaping=zero, step_scale=zero)
        status, trips = lane.status + zero, lane.trips + zero
        self.trip(tables, head, lane)
        self.refuse(head, lane)
        choose(lane, ~waits & (lane.finished > 0.5), finished=0.5 * one)
        choose(lane, waits, status=status, trips=trips, finished=one)

    def differentiate(self, tables, rod, time, up, done):
        """The derivatives of the steps that have converged, in the lanes where ``done`` is one."""
        if self.largest(done) > 0.5:
            self.sweep.differentiate(rod, tables.blocks, tables.number_slopes.shape[0], time, up)

    def own_block(self, tables, slot, parameter, vertex):
        """The view of the block of a vertex for a parameter, in a lane."""
        return self.sweep.block(tables.blocks.lane(slot), tables.rest_length.shape[1], parameter, vertex)

    def load_slopes(self, tables, head, slot, rod):
        """The derivatives that rod ``rod`` remembers, and its parameters, into lane ``slot``."""
        row, g, numbers = tables.rods[rod, of.RESULT_ROW], tables.rods[rod, of.MATERIAL_ROW], tables.rods[rod, of.EXTERNAL_ROW]
        own = head.lane(slot)
        unit, length_unit = in_f64(own.energy_unit), in_f64(own.length_unit)
        lengths = ti.min(tables.rods[rod, of.CLAMP_ROW], tables.rest_length.shape[0] - 1)
        for p in range(tables.number_slopes.shape[0]):
            material = p * tables.material.shape[0] + g
            for v in range(tables.rest_length.shape[1] + 1):
                block = self.own_block(tables, slot, p, v)
                for k in range(REMEMBERED):
                    block[k] = tables.slopes[row, p, v, k]
                for k in range(NUMBERS):
                    block[REMEMBERED + k] = tables.number_slopes[p, numbers, v, k] / unit
                if v > 0:
                    load_stiffness(block, tables.material_slopes, material, tables.rest_length, lengths, v - 1,
                                   1.0 / (unit * length_unit))
            first = self.own_block(tables, slot, p, 0)
            for k in ti.static(range(2)):
                first.of_rod[k] = tables.share_slopes[p, numbers, k]
            first.of_rod[2] = tables.material_slopes[material, of.WEIGHT]

    def store_slopes(self, tables, array: ti.template(), slot, row):
        """The first derivatives that the lane's rod remembers, those of positions, or all, into a row of an ``array``."""
        for p in range(tables.number_slopes.shape[0]):
            for v in range(tables.rest_length.shape[1] + 1):
                block = self.own_block(tables, slot, p, v)
                for k in range(array.shape[3]):
                    array[row, p, v, k] = block[k]
