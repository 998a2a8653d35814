"""A chain whose vertex 0 is not held: its place is three more unknowns, which only an external energy determines.

The chain hangs from the anchor, displaced by the drift. Where the far end is held the drift alone closes the chain, so that no
rotation has to.
"""

import taichi as ti

from doo_ti.physics.algebra import absolute, factor_in_turn
from doo_ti.physics.tuples import (
    against,
    backward,
    chosen,
    forward,
    forward_rows,
    minus,
    minus_combination,
    negated,
    on_diagonal,
    plus,
    scaled,
    squared,
    symmetric_gram,
    variable,
)
from doo_ti.relaxation.elimination import Elimination, held_pivot

LEAST_HOLD = 1e-6
"""Over the cube of the rod's length, B being about one: the least stiffness with which a free vertex 0 is held in its place."""


@ti.data_oriented
class LooseStart(Elimination):
    """The part of :class:`.LoadedElimination` for vertex 0. Lanes whose rods hold it are not changed."""

    @ti.func
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

    @ti.func
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
        f = factor_in_turn(held_pivot(stiff, free))
        found.negative = found.negative + f[6]
        wr = forward(f, scaled(negated(c), loose))
        wa = forward_rows(f, scaled(border.c, loose))
        border.schur = plus(border.schur, symmetric_gram(f, wa))
        border.right = plus(border.right, against(f, wa, wr))
        rod.head.drift_step, rod.head.drift_border = wr, wa
        rod.head.drift_pivots = (f[0], f[1], f[2], f[3], f[4], f[5])

    @ti.func
    def load_start(self, rod, found):
        """The external energy at vertex 0: its value goes to ``found``; returns its first and second derivative."""
        energy, gradient, curvature = self.functions.evaluate_start(
            rod.head.external, scaled(plus(rod.anchor, rod.head.drift), rod.length_unit))
        found.energy = found.energy + rod.loose * energy
        found.magnitude = found.magnitude + rod.loose * energy
        return scaled(gradient, rod.length_unit), scaled(curvature, rod.length_unit * rod.length_unit)

    @ti.func
    def shift_of_start(self, rod, shift):
        """``shift`` of the place of vertex 0."""
        return shift * rod.shift_shares[1] / (rod.total * rod.total)

    @ti.func
    def at_least_held(self, rod, stiffness):
        """The stiffness that holds vertex 0 in some direction, or a small one where nothing does: along a table, for
        example."""
        least = LEAST_HOLD * rod.shift_shares[1] / (rod.total * rod.total * rod.total)
        return ti.select(absolute(stiffness) < least, least, stiffness)

    @ti.func
    def solved_start(self, rod, change):
        """(ξ = L⁻ᵀ D⁻¹ (W_c − W_λ δλ) of vertex 0, also into its place; its part in the Newton decrement)."""
        y = minus_combination(rod.head.drift_step, rod.head.drift_border, change)
        f = rod.head.drift_pivots
        shift = backward(f, y)
        rod.head.drift_step = shift
        return shift, squared(f, y)
