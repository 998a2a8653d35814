"""The moments with which the clamps hold a rod's ends at rest, and their derivatives by parameters.

Where a clamp holds the frame of an end edge, what is left of g + Aλ on that edge is the moment of the clamp on the rod about
the clamped vertex: the energy grows by it times the angle by which the clamp turns. What a clamp does not hold is in balance.
"""

import taichi as ti

from doo_ti.physics.closure import linear_gradient, linear_hessian
from doo_ti.physics.tuples import applied, full, plus, scaled, transposed, variable
from doo_ti.relaxation.parameter_gradient import NO_MODE, ParameterGradient

FIRST, LAST = 0, 1


@ti.data_oriented
class EndMoments(ParameterGradient):
    """The chain with the moments at its ends; ``end`` is FIRST or LAST."""

    @ti.func
    def end_places(self, rod, end):
        """The number of the end's edge, that of its pair's joint, and the length after the end's edge."""
        remaining = 0.0 * rod.total
        if end == FIRST:
            remaining = rod.total - self.edge(rod.head, 0).length
        return end * (rod.edges - 1), end * (rod.edges - 2), remaining

    @ti.func
    def own_part(self, end, left, right):
        """Of what a pair does to its two edges, the part of the end's own edge."""
        part = variable(left)
        if end == LAST:
            part = right
        return part

    @ti.func
    def in_world(self, edge, v):
        """A vector in the edge's axes as one in the world."""
        return plus(plus(scaled(edge.t, v[0]), scaled(edge.m1, v[1])), scaled(edge.m2, v[2]))

    @ti.func
    def body_moment(self, rod, edge, own, multiplier):
        """g + Aλ of the end's ``edge`` in its own axes, ``own`` what its pair adds to g."""
        l1, l2 = linear_gradient(self.pull_on(rod, edge, multiplier), edge.length, edge.m1, edge.m2)
        return plus(own, (0.0 * l1, l1, l2))

    @ti.func
    def end_moment(self, rod, end, multiplier):
        """The moment at an end, in the world."""
        e, joint, remaining = self.end_places(rod, end)
        pair = self.edge(rod.head, joint).outer.pair
        edge = self.seen(rod, self.edge(rod.head, e), remaining)
        return self.in_world(edge, self.body_moment(rod, edge, self.own_part(end, pair.left, pair.right), multiplier))

    @ti.func
    def moment_change(self, rod, end, column, change):
        """The derivative of an end's moment, in the world, by a column whose rotations lie in the place of the step and by
        which λ, with the forces of obstacles beyond the edge, changes by ``change``.

        H has the second derivatives by spins that are made before tilts: with the edge's own rotation w and G = g + Aλ the
        moment changes by H w + (G2 w1 − G1 w2, ½ G0 w2, −½ G0 w1), seen from the edge's axes as they were.
        """
        e, joint, remaining = self.end_places(rod, end)
        pair = self.edge(rod.head, joint).outer.pair
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
        return self.in_world(edge, plus(found, turned))
