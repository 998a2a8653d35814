"""How far apart the clamps hold a rod at an instant of its motion: beyond its reach, taut, or slack (docs/dynamics.md)."""

import taichi as ti

from doo_ti.physics.quaternion import product, second_director, tangent, transported, turned_in_world
from doo_ti.physics.tuples import cross, dot, minus, plus, repeated, scaled, variable
from doo_ti.physics.view import exact
from doo_ti.relaxation import tables as of
from doo_ti.relaxation.bows import STEEP, STEEPEST
from doo_ti.relaxation.clamp_table import ALIKE, INFEASIBLE, ROUNDING, SOUND, STRAIGHT, TAUT, TAUT_SLACK
from doo_ti.relaxation.obstacle_motion import ObstacleLoading
from doo_ti.relaxation.time_sweep import TimeSweep

BOWED = 4
"""Of a step: its rod was straight and is bowed (after the findings of :mod:`.clamp_table`)."""


@ti.data_oriented
class ReachLoading(ObstacleLoading):
    """Judges the clamps of every instant. A rod that is taut there is made the one straight line it can be, with nothing left
    to relax but its spins. A straight one that gets slack is bowed: its edges have no first-order way to bring the far end
    closer. Lengths are in mm."""

    def __init__(self, sweep: TimeSweep):
        super().__init__(sweep)
        # Slack below which frames cannot be told from those of a taut rod.
        self.straightness = 1e-6 if sweep.number.bits == 32 else TAUT_SLACK

    @ti.func
    def load_reach(self, tables, own, slot, s, line, first, last):
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
            before = own.reach
            if before != found:
                own.reach = found
                self.load_freedom(tables, own, s, ti.select(found == TAUT, 0.0, 1.0))
            if found == TAUT:
                self.stretch(tables, own, s, scaled(free, 1.0 / span))
            elif found != INFEASIBLE and before != SOUND and self.is_straight(tables, own, s, False):
                self.bow(tables, own, slot, s, slack)
                own.reach = BOWED
        return found

    @ti.func
    def load_last_reach(self, tables, own, s):
        """Load how the rod in a lane was at the last instant: SOUND, or STRAIGHT as its frames say."""
        found = SOUND
        if tables.clamp[s, of.CLOSED] > 0.0 and self.is_straight(tables, own, s, True):
            found = STRAIGHT
        own.reach = found

    @ti.func
    def load_freedom(self, tables, own, s, slack):
        """Load which edges may tilt, and that closure holds, where ``slack`` is one; where it is zero, none and not."""
        own.closed = slack * tables.clamp[s, of.CLOSED]
        for pair in ti.static(((1, of.TILT_START), (3, of.TILT_END), (4, of.TILT_INNER))):
            own.free[pair[0]] = slack * tables.clamp[s, pair[1]]

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
    def stretch(self, tables, own, s, along):
        """Turn the edges that may tilt to the unit vector ``along``; their spins are kept by parallel transport."""
        for e in range(tables.rest_length.shape[1]):
            if self.tilts(tables, s, e) > 0.0:
                q = exact(self.edge(own, e).frame)
                old = tangent(q)
                straight = variable(product(q, (0.0, 0.0, 0.0, 1.0)))  # half a turn
                if 1.0 + dot(old, along) > 1e-14:
                    straight = transported(q, old, along)
                self.edge(own, e).frame = straight

    @ti.func
    def is_straight(self, tables, own, s, last: ti.template()):
        """Whether the edges that may tilt are in one straight line, at the last instant with ``last``."""
        edges, row = tables.rest_length.shape[1], ti.min(s, tables.rest_length.shape[0] - 1)
        inner = self.direction(own, ti.min(1, edges - 1), last)
        apart = minus(inner, self.direction(own, edges // 2, last))
        straight = False
        if dot(apart, apart) < ALIKE:  # most rods that are not straight are seen not to be by two of their edges
            chord = variable(repeated(ti.cast(0.0, ti.f64), 3))
            reach = ti.cast(0.0, ti.f64)
            for e in range(edges):
                length = self.tilts(tables, s, e) * tables.rest_length[row, e]
                chord = plus(chord, scaled(self.direction(own, e, last), length))
                reach += length
            straight = dot(chord, chord) > (reach * (1.0 - self.straightness)) ** 2
        return straight

    @ti.func
    def direction(self, own, e, last: ti.template()):
        """The tangent of an edge in a lane, at the last instant with ``last``."""
        if ti.static(last):
            return tangent(exact(self.edge(own, e).motion.frame_1))
        else:
            return tangent(exact(self.edge(own, e).frame))

    @ti.func
    def bow(self, tables, own, slot, s, slack):
        """Bow the edges that may tilt as far as that ``slack``, a share of their length, lets them: downwards, or where the
        step of a rod that may touch something has failed so, aside."""
        edges = tables.rest_length.shape[1]
        middle = exact(self.edge(own, edges // 2).frame)
        t, m2 = tangent(middle), second_director(middle)
        axis = variable(cross((tables.up[0], tables.up[1], tables.up[2]), t))
        if dot(axis, axis) < ti.static(STEEP**2):
            axis = (0.0 - m2[0], 0.0 - m2[1], 0.0 - m2[2])
        # The chord of a rod of slope a cos(π s/L) is L J0(a), J0(2 √u) = 1 − u + u²/4 − …
        slope = ti.min(2.0 * ti.sqrt(slack * (1.0 + slack * (0.25 + 0.1 * slack))), STEEPEST)
        if ti.static(self.touches):
            if tables.contacts.lane(slot).retried > 0.5:
                axis = cross(t, axis)
        axis = scaled(axis, slope / ti.sqrt(dot(axis, axis)))
        bent = ti.cast(0.0, ti.f64)
        count = edges - 2.0 + tables.clamp[s, of.TILT_START] + tables.clamp[s, of.TILT_END]
        for e in range(edges):
            if self.tilts(tables, s, e) > 0.0:
                share = ti.cos(ti.math.pi * (bent + 0.5) / count)
                bent += 1.0
                self.edge(own, e).frame = turned_in_world(exact(self.edge(own, e).frame), scaled(axis, share))
