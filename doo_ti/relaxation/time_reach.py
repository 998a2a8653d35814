"""How far apart the clamps hold a rod at an instant of its motion: beyond its reach, taut, or slack (docs/dynamics.md)."""

import taichi as ti

from doo_ti.physics.quaternion import product, second_director, tangent, transported, turned_in_world
from doo_ti.physics.tuples import cross, dot, minus, plus, repeated, scaled, variable
from doo_ti.relaxation import chain
from doo_ti.relaxation import tables as of
from doo_ti.relaxation.clamp_table import INFEASIBLE, ROUNDING, SOUND, STRAIGHT, TAUT, TAUT_SLACK
from doo_ti.relaxation.contact_layout import RETRIED
from doo_ti.relaxation.obstacle_motion import ObstacleLoading
from doo_ti.relaxation.time_sweep import FRAME_1, OF_REACH, TimeSweep

BOWED = 4
"""Of a step: its rod was straight and is bowed (after the findings of :mod:`.clamp_table`)."""
STEEPEST = 2.2
"""rad: the slope of a bow at its ends; steeper ones cross themselves."""
ALIKE = 1e-4
"""The square of the difference of two tangents, below which a rod may be straight."""
UPRIGHT = 1e-3
"""The sine of the angle between a rod and the vertical, below which a bow goes along a director."""


@ti.data_oriented
class ReachLoading(ObstacleLoading):
    """Judges the clamps of every instant. A rod that is taut there is made the one straight line it can be, with nothing left
    to relax but its spins. A straight one that gets slack is bowed: its edges have no first-order way to bring the far end
    closer. Lengths are in mm."""

    def __init__(self, sweep: TimeSweep):
        super().__init__(sweep)
        self.motion, self.time_parameters = sweep.motion, sweep.time_parameters
        # Slack below which frames cannot be told from those of a taut rod.
        self.straightness = 1e-6 if sweep.number.bits == 32 else TAUT_SLACK

    @ti.func
    def load_reach(self, tables, scratch: ti.template(), head, slot, s, line, first, last):
        """Load what the clamps s make of the rod in lane ``slot`` where they hold its ends ``line`` apart, the first edge along
        ``first`` and the last along ``last``, zero where they hold none. Returns SOUND, STRAIGHT, TAUT or
        INFEASIBLE."""
        found = SOUND
        if tables.clamp[s, of.CLOSED] > 0.0 and tables.clamp[s, of.LOOSE] == 0.0:
            edges, row = tables.rest_length.shape[1], ti.min(s, tables.rest_length.shape[0] - 1)
            length_first, length_last = tables.rest_length[row, 0], tables.rest_length[row, edges - 1]
            free = minus(minus(line, scaled(first, length_first)), scaled(last, length_last))
            reach = tables.clamp[s, of.TOTAL]
            reach -= (1.0 - tables.clamp[s, of.TILT_START]) * length_first
            reach -= (1.0 - tables.clamp[s, of.TILT_END]) * length_last
            span = ti.sqrt(dot(free, free))
            slack = 1.0 - span / reach
            if slack < self.straightness:
                found = STRAIGHT
            if slack < TAUT_SLACK:
                found = TAUT
            if not slack >= ti.static(0.0 - ROUNDING):
                found = INFEASIBLE
            at = head + (self.time_parameters + OF_REACH) * self.stride
            before = self.get(scratch, at, slot)
            if before != found:
                self.put(scratch, at, slot, found)
                self.load_freedom(tables, scratch, head, slot, s, ti.select(found == TAUT, 0.0, 1.0))
            origin = head + self.parameters * self.stride
            if found == TAUT:
                self.stretch(tables, scratch, origin, slot, s, scaled(free, 1.0 / span))
            elif found != INFEASIBLE and before != SOUND and self.is_straight(tables, scratch, origin, slot, s):
                self.bow(tables, scratch, origin, slot, s, slack)
                self.put(scratch, at, slot, BOWED)
        return found

    @ti.func
    def load_last_reach(self, tables, scratch: ti.template(), head, slot, s):
        """Load how the rod in lane ``slot`` was at the last instant: SOUND, or STRAIGHT as its frames say."""
        found = SOUND
        frames = head + (self.parameters + self.motion + FRAME_1) * self.stride
        if tables.clamp[s, of.CLOSED] > 0.0 and self.is_straight(tables, scratch, frames, slot, s):
            found = STRAIGHT
        self.put(scratch, head + (self.time_parameters + OF_REACH) * self.stride, slot, found)

    @ti.func
    def load_freedom(self, tables, scratch: ti.template(), head, slot, s, slack):
        """Load which edges may tilt, and that closure holds, where ``slack`` is one; where it is zero, none and not."""
        self.put(scratch, head + chain.OF_CLOSED * self.stride, slot, slack * tables.clamp[s, of.CLOSED])
        for pair in ti.static(((1, of.TILT_START), (3, of.TILT_END), (4, of.TILT_INNER))):
            self.put(scratch, head + (chain.OF_FREE + pair[0]) * self.stride, slot, slack * tables.clamp[s, pair[1]])

    @ti.func
    def tilts(self, tables, s, e):
        """One where clamps s let edge ``e`` tilt, else zero."""
        free = ti.cast(1.0, ti.f64)
        if e == 0:
            free = tables.clamp[s, of.TILT_START]
        if e == tables.rest_length.shape[1] - 1:
            free = tables.clamp[s, of.TILT_END]
        return free

    @ti.func
    def stretch(self, tables, scratch: ti.template(), at, slot, s, along):
        """Turn the edges that may tilt to the unit vector ``along``; their spins are kept by parallel transport."""
        for e in range(tables.rest_length.shape[1]):
            if self.tilts(tables, s, e) > 0.0:
                q = self.lane_frame(scratch, at, slot)
                old = tangent(q)
                straight = variable(product(q, (0.0, 0.0, 0.0, 1.0)))  # half a turn
                if 1.0 + dot(old, along) > 1e-14:
                    straight = transported(q, old, along)
                self.put_items(scratch, at, slot, straight)
            at += self.edge_stride

    @ti.func
    def is_straight(self, tables, scratch: ti.template(), origin, slot, s):
        """Whether the edges that may tilt are in one straight line, of frames the first of which is at ``origin``."""
        edges, row = tables.rest_length.shape[1], ti.min(s, tables.rest_length.shape[0] - 1)
        inner = tangent(self.lane_frame(scratch, origin + ti.min(1, edges - 1) * self.edge_stride, slot))
        apart = minus(inner, tangent(self.lane_frame(scratch, origin + (edges // 2) * self.edge_stride, slot)))
        straight = False
        if dot(apart, apart) < ALIKE:  # most rods that are not straight are seen not to be by two of their edges
            chord = variable(repeated(ti.cast(0.0, ti.f64), 3))
            reach = ti.cast(0.0, ti.f64)
            at = origin
            for e in range(edges):
                length = self.tilts(tables, s, e) * tables.rest_length[row, e]
                chord = plus(chord, scaled(tangent(self.lane_frame(scratch, at, slot)), length))
                reach += length
                at += self.edge_stride
            straight = dot(chord, chord) > (reach * (1.0 - self.straightness)) ** 2
        return straight

    @ti.func
    def bow(self, tables, scratch: ti.template(), at, slot, s, slack):
        """Bow the edges that may tilt as far as that ``slack``, a share of their length, lets them: downwards, or where the
        step of a rod that may touch something has failed so, aside."""
        edges = tables.rest_length.shape[1]
        middle = self.lane_frame(scratch, at + (edges // 2) * self.edge_stride, slot)
        t, m2 = tangent(middle), second_director(middle)
        axis = variable(cross((tables.up[0], tables.up[1], tables.up[2]), t))
        if dot(axis, axis) < ti.static(UPRIGHT**2):
            axis = (0.0 - m2[0], 0.0 - m2[1], 0.0 - m2[2])
        # The chord of a rod of slope a cos(π s/L) is L J0(a), J0(2 √u) = 1 − u + u²/4 − …
        slope = ti.min(2.0 * ti.sqrt(slack * (1.0 + slack * (0.25 + 0.1 * slack))), STEEPEST)
        if ti.static(self.touches):
            if self.get(scratch, tables.contacts + RETRIED * self.stride, slot) > 0.5:
                axis = cross(t, axis)
        axis = scaled(axis, slope / ti.sqrt(dot(axis, axis)))
        bent = ti.cast(0.0, ti.f64)
        count = edges - 2.0 + tables.clamp[s, of.TILT_START] + tables.clamp[s, of.TILT_END]
        for e in range(edges):
            if self.tilts(tables, s, e) > 0.0:
                share = ti.cos(ti.math.pi * (bent + 0.5) / count)
                bent += 1.0
                self.put_items(scratch, at, slot, turned_in_world(self.lane_frame(scratch, at, slot), scaled(axis, share)))
            at += self.edge_stride
