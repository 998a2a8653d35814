"""How the balance of a rod at rest changes with a parameter, ∂(g + Aλ)/∂θ and ∂c/∂θ, edge by edge (§III-E).

g is the gradient of the energy by the rotations of the frames, c closure, A its Jacobian. The derivatives are those at the
frames and the multiplier λ of the equilibrium. Edges that a clamp holds may turn with it: then what their turn does to
themselves and to their neighbours is part of the derivative.

Where a clamp holds the frame of an end edge, what is left of g + Aλ on that edge is the moment of the clamp on the rod about
the clamped vertex: the energy grows by it times the angle by which the clamp turns. What a clamp does not hold is in balance.
"""

import taichi as ti

from doo_ti.physics import pair
from doo_ti.physics.algebra import applied, full, transposed
from doo_ti.physics.number import Layout, device_functions, read
from doo_ti.physics.pair import linear_gradient, linear_hessian, moment, shift_of_end, strain
from doo_ti.physics.quaternion import first_director, rotated, second_director, tangent
from doo_ti.physics.tuples import dot, minus, plus, record, scaled, variable
from doo_ti.relaxation import chain

# What changes along a direction, of the table of directions.
BEND, TWIST, MODE, PULL, TIMES_WEIGHT, STRETCH = 0, 3, 4, 5, 8, 9
SHIFT, TURN_START, TURN_END, MOVE, STIFFENS, DIRECTION_COLUMNS = 10, 13, 16, 19, 22, 23
"""BEND, TWIST         B as (11, 22, 12), and β
MODE                ω̄ along the rod, by that row of the table of modes (NO_MODE: not at all)
STIFFENS            one where that row is of ln B instead, of the two edges at each joint, and of ln β there
PULL, TIMES_WEIGHT  gravity, multiplied by μ where TIMES_WEIGHT is one
STRETCH             all lengths, by the factor 1 + STRETCH
SHIFT, MOVE         the far point, as seen from vertex 0, and vertex 0, in the world
TURN_START, TURN_END  the frames that the clamps hold, by these rotations in the world"""
NO_MODE = -1
FIRST, LAST = 0, 1

PAIR = Layout(left=3, right=3, h_left=6, h_right=6, across=9)
KEPT = Layout(kept=8, beyond=3, pair=PAIR)
"""Of an edge, besides what chain has of it.

kept    curvature and twist where it ends, since eliminating writes over the place where chain has them
beyond  the sum of the forces of obstacles and of point loads on all vertices after its first, with the sign of a gradient
pair    the derivatives of the pair there, of the first pair and of the last"""


@device_functions
class ParameterGradient(chain.Chain):
    """The chain with its derivatives by parameters, and with the moments at its ends, in f64.

    Its functions take a record ``column`` (:meth:`column`) of what changes along one direction:

    bends                    whether pairs change by more than their rest curvature
    bend, twist              of B = (11, 22, 12) and of β, in the unit of the rod's energies
    mode, modes              row of the table of changes along the rod, or NO_MODE, and that table
    stiffens                 whether that row is of ln B and ln β, not of ω̄
    pull, whole              of gravity, and of the force 2 μ L up that holds the rod's weight
    stretches, stretch       whether lengths change, and of the logarithm of all lengths
    shift, move              of the far point as seen from vertex 0, and of vertex 0
    local                    whether only the last two edges and closure are changed
    turned                   whether edges that clamps hold turn
    turn_start, turn_end     rotations of the first edge and the last, in their own axes
    multiplier               λ of the equilibrium
    """

    def bend_pairs(self, rod):
        """Curvature and twist at every vertex, to where they are eliminated from and to where they are kept."""
        for e in range(rod.edges - 1):
            edge = self.edge(rod.head, e)
            x, y, inverse, turn, r = pair.curvature(edge.frame, self.edge(rod.head, e + 1).frame)
            bent = x + y + (inverse, self.twist_angle(r)) + turn
            edge.bent, edge.external.kept = bent, bent

    def kept_pair(self, rod, e):
        """Curvature and twist, and the stiffness, at the vertex where edge ``e`` ends."""
        edge = self.edge(rod.head, e)
        return self.bent(edge.external.kept), self.stiffness(edge, self.edge(rod.head, e + 1), rod.stiffness)

    def keep_pair(self, rod, joint, derivatives):
        """Keep the derivatives of the first pair and of the last, whose edges clamps hold."""
        if joint == 0 or joint == rod.edges - 2:
            kept = self.edge(rod.head, joint).external.pair
            kept.left, kept.right, kept.h_left, kept.h_right, kept.across = derivatives

    def column(self, tables, rod, p, known):
        """The record of direction ``p`` for rods of which the multiplier, the weight and what clamps hold are ``known``."""
        one = 0.0 * rod.total + 1.0
        unit = one / rod.head.energy_unit
        factor = unit
        if tables.directions[p, TIMES_WEIGHT] == 1.0:
            factor = known.weight * unit
        stretch = tables.directions[p, STRETCH]
        change = stretch * stretch
        for k in ti.static(range(BEND, TWIST + 1)):
            change += tables.directions[p, k] * tables.directions[p, k]
        start, end = read(tables.directions, p, TURN_START), read(tables.directions, p, TURN_END)
        pull, mode = read(tables.directions, p, PULL), ti.cast(tables.directions[p, MODE], ti.i32)
        along = change + dot(pull, pull) + dot(start, start)
        turned = dot(start, start) + dot(end, end) > 0.0
        first, last = self.edge(rod.head, 0), self.edge(rod.head, rod.edges - 1)
        turn_start = self.held_turn(first, scaled(start, one), (known.holds[0], known.holds[2]))
        turn_end = self.held_turn(last, scaled(end, one), (known.holds[1], known.holds[3]))
        return record(
            local=(along == 0.0) & (mode == NO_MODE), bends=change > 0.0, bend=scaled(read(tables.directions, p, BEND), unit),
            twist=tables.directions[p, TWIST] * unit, mode=mode, modes=tables.modes, pull=scaled(pull, factor),
            stiffens=tables.directions[p, STIFFENS] > 0.0, stretches=stretch != 0.0, stretch=stretch * one,
            whole=scaled(plus(scaled(pull, factor), scaled(rod.gravity, stretch)), 2.0 * rod.total),
            shift=scaled(read(tables.directions, p, SHIFT), one), move=scaled(read(tables.directions, p, MOVE), one),
            turned=turned, turn_start=turn_start, turn_end=turn_end, multiplier=known.multiplier)

    def held_turn(self, edge, w, holds):
        """The part that a clamp holds, (spin, tilt) = ``holds``, of its edge's rotation ``w`` in the world: in its axes."""
        q = edge.frame
        return (holds[0] * dot(w, tangent(q)), holds[1] * dot(w, first_director(q)), holds[1] * dot(w, second_director(q)))

    def pair_change(self, rod, joint, column):
        """∂g/∂θ of the pair at ``joint``, where the edge of that number ends: (left, right)."""
        bent, s = self.kept_pair(rod, joint)
        x, y, inverse, m, turn = bent
        none = 0.0 * s[2]
        added, stiffer = variable((none, none)), variable((none, none, none))  # to u̅ = ω̄ l̄/2, and to ln B and ln β
        if column.mode != NO_MODE:
            along = read(column.modes, column.mode, joint, 0)
            if column.stiffens:
                stiffer = scaled(along, none + 1.0)
            else:
                added = scaled((along[0], along[1]), 0.5 / s[2])
        # μ = 2i B (ω − u̅)/l̄. Where the lengths grow, u̅ grows with them: d((ω − u̅)/l̄) = −ω/l̄.
        grown_x = minus(scaled(strain(x, (none, none)), 0.0 - column.stretch), added)
        grown_y = minus(scaled(strain(y, (none, none)), 0.0 - column.stretch), added)
        of_x = plus(grown_x, scaled(strain(x, s[4]), stiffer[0]))
        of_y = plus(grown_y, scaled(strain(y, s[4]), stiffer[1]))
        mu = plus(moment(column.bend, strain(x, s[4]), s[2]), moment(s[0], of_x, s[2]))
        nu = plus(moment(column.bend, strain(y, s[4]), s[2]), moment(s[1], of_y, s[2]))
        twist = 2.0 * m * (column.twist * s[2] + (stiffer[2] - column.stretch) * s[3])
        return pair.gradient_of_moments(mu, nu, twist, x, y, inverse, turn)

    def seen(self, rod, edge, remaining):
        """The record of an edge: length, frame, the coefficient of gravity on it, where ``remaining`` is the length of the
        edges after it, and the forces of obstacles ``beyond`` its first vertex."""
        q = edge.frame
        length = edge.length
        return record(length=length, hang=self.hanging_weight(rod, length, remaining), t=tangent(q), m1=first_director(q),
                      m2=second_director(q), beyond=edge.external.beyond)

    def pull_on(self, rod, edge, multiplier):
        """The linear potential of an edge: of gravity, of obstacles and of λ."""
        return plus(plus(scaled(rod.gravity, edge.hang), edge.beyond), multiplier)

    def linear_change(self, rod, edge, column):
        """∂g/∂θ of the linear potentials of an edge: its last two numbers. With the lengths gravity's term grows by their
        square, those of obstacles and of λ by the first power."""
        grown = plus(plus(scaled(rod.gravity, 2.0 * edge.hang), edge.beyond), column.multiplier)
        change = plus(scaled(column.pull, edge.hang), scaled(grown, column.stretch))
        return linear_gradient(change, edge.length, edge.m1, edge.m2)

    def turn_neighbours(self, rod, e, column, change):
        """Add what the turns of the first edge and the last do through their pairs to ``change``, a record:

        pair, own, after     of ∂g/∂θ: what pairs add to this edge, its own potentials, what pairs add to the edge after
        closure              ∂c/∂θ, summed

        An edge's own potentials and its tilt leave its spin in balance, where the clamp leaves that free.
        """
        if e < rod.edges - 1 and (e == 0 or e == rod.edges - 2):
            kept = self.edge(rod.head, e).external.pair
            if e == 0:
                w, h = column.turn_start, kept.h_left
                change.after = plus(change.after, applied(transposed(kept.across), w))
                change.own = (change.own[0] + h[1] * w[1] + h[2] * w[2], change.own[1], change.own[2])
            if e == rod.edges - 2:
                w, h = column.turn_end, kept.h_right
                change.pair = plus(change.pair, applied(kept.across, w))
                change.after = (change.after[0] + h[1] * w[1] + h[2] * w[2], change.after[1], change.after[2])

    def turn_end(self, rod, edge, e, column, change):
        """Add what the turn of the first edge or the last does to closure to ``change`` (:meth:`turn_neighbours`)."""
        if e == 0 or e == rod.edges - 1:
            w = variable(column.turn_start)
            if e == rod.edges - 1:
                w = column.turn_end
            change.closure = plus(change.closure, shift_of_end(edge.length, edge.m1, edge.m2, w))

    # --- the moments at the ends: ``end`` is FIRST or LAST ---

    def end_places(self, rod, end):
        """The number of the end's edge, that of its pair's joint, and the length after the end's edge."""
        remaining = 0.0 * rod.total
        if end == FIRST:
            remaining = rod.total - self.edge(rod.head, 0).length
        return end * (rod.edges - 1), end * (rod.edges - 2), remaining

    def own_part(self, end, left, right):
        """Of what a pair does to its two edges, the part of the end's own edge."""
        part = variable(left)
        if end == LAST:
            part = right
        return part

    def body_moment(self, rod, edge, own, multiplier):
        """g + Aλ of the end's ``edge`` in its own axes, ``own`` what its pair adds to g."""
        l1, l2 = linear_gradient(self.pull_on(rod, edge, multiplier), edge.length, edge.m1, edge.m2)
        return plus(own, (0.0 * l1, l1, l2))

    def end_moment(self, rod, end, multiplier):
        """The moment at an end, in the world."""
        e, joint, remaining = self.end_places(rod, end)
        pair = self.edge(rod.head, joint).external.pair
        edge = self.seen(rod, self.edge(rod.head, e), remaining)
        moment = self.body_moment(rod, edge, self.own_part(end, pair.left, pair.right), multiplier)
        return rotated(self.edge(rod.head, e).frame, moment)

    def moment_change(self, rod, end, column, change):
        """The derivative of an end's moment, in the world, by a column whose rotations lie in the place of the step and by
        which λ, with the forces of obstacles beyond the edge, changes by ``change``.

        H has the second derivatives by spins that are made before tilts: with the edge's own rotation w and G = g + Aλ the
        moment changes by H w + (G2 w1 − G1 w2, ½ G0 w2, −½ G0 w1), seen from the edge's axes as they were.
        """
        e, joint, remaining = self.end_places(rod, end)
        pair = self.edge(rod.head, joint).external.pair
        w0, w1 = self.edge(rod.head, joint).rotation, self.edge(rod.head, joint + 1).rotation
        of_left = plus(applied(full(pair.h_left), w0), applied(pair.across, w1))
        of_right = plus(applied(full(pair.h_right), w1), applied(transposed(pair.across), w0))
        found = self.own_part(end, of_left, of_right)
        if column.bends or column.mode != NO_MODE:
            explicit_left, explicit_right = self.pair_change(rod, joint, column)
            found = plus(found, self.own_part(end, explicit_left, explicit_right))
        edge = self.seen(rod, self.edge(rod.head, e), remaining)
        w = self.own_part(end, w0, w1)
        straighten = linear_hessian(self.pull_on(rod, edge, column.multiplier), edge.length, edge.t)
        l1, l2 = self.linear_change(rod, edge, column)
        c1, c2 = linear_gradient(change, edge.length, edge.m1, edge.m2)
        found = plus(found, (0.0 * l1, l1 + c1 + straighten * w[1], l2 + c2 + straighten * w[2]))
        g = self.body_moment(rod, edge, self.own_part(end, pair.left, pair.right), column.multiplier)
        turned = (g[2] * w[1] - g[1] * w[2], 0.5 * g[0] * w[2], 0.0 - 0.5 * g[0] * w[1])
        return rotated(self.edge(rod.head, e).frame, plus(found, turned))
