"""A rod in motion into one lane of a pack in scratch, with its clamps at an instant, and out of it (docs/dynamics.md)."""

import taichi as ti

from doo_ti.contact.obstacles import AXES, POINT
from doo_ti.physics.number import device_functions, in_f64, read, write
from doo_ti.physics.quaternion import directors, partway, product, rotated, second_director, tangent, turned_in_world, turned_to
from doo_ti.physics.tuples import cross, dot, minus, plus, record, repeated, scaled, variable
from doo_ti.relaxation import tables as of
from doo_ti.relaxation.bows import STEEP, STEEPEST
from doo_ti.relaxation.clamp_table import ALIKE, INFEASIBLE, ROUNDING, SOUND, STRAIGHT, TAUT, TAUT_SLACK
from doo_ti.relaxation.loading import Loading
from doo_ti.relaxation.time_sweep import INERTIA, SPRING_POINT, VERTEX_ITEMS, TimeSweep

# Columns of an obstacle's pose at an instant: first its turn, a quaternion, then its shift, mm. They take a place x of it from
# where it is in the table of obstacles to R x + shift.
POSE_SHIFT, POSE_COLUMNS = 4, 7
# Columns of the clamps at an instant: the point the chain hangs from, the far point from there, mm, the first and last frame,
# and one where all that is as it was at the instant before.
PATH_ANCHOR, PATH_TARGET, PATH_ENDS, PATH_STILL, PATH_COLUMNS = 0, 3, 6, 14, 15
BOWED = 4  # of a step: its rod was straight and is bowed (after the findings of :mod:`.clamp_table`)


@device_functions
class MotionLoading(Loading):
    """Loading and storing of a rod's state at its last two instants, in addition to what :class:`.Loading` does for any rod,
    and of its clamps and the poses of obstacles at an instant. Lengths are in mm.

    ``tables`` holds what the kernels of :mod:`.time_steps` are given.

    A rod whose clamps make it taut is made the one straight line it can be, with nothing left to relax but its spins. A
    straight one that gets slack is bowed: its edges have no first-order way to bring the far end closer.
    """

    def __init__(self, sweep: TimeSweep):
        super().__init__(sweep)
        self.loaded = False  # the sweep sets its own springs and forces
        self.moves = self.touches and self.contacts.moves
        self.joints_rest, self.moving_vertex = sweep.joints_rest, sweep.moving_vertex
        # Slack below which frames cannot be told from those of a taut rod.
        self.straightness = 1e-6 if sweep.number.bits == 32 else TAUT_SLACK

    # --- the poses of obstacles ---

    def next_poses(self, tables, slot, row, step, share, unit):
        """Load the poses of lane ``slot`` after that ``share`` of the way to the end of step ``step``, where that puts the
        obstacles, and by how much it carries their places."""
        own = ti.min(row, tables.obstacles.shape[0] - 1)
        for o in range(tables.kinds.shape[0]):
            at = self.contacts.obstacle(self.contacts.of_lane(tables, slot), o)
            pose = self.pose_from(tables, row, step + 1, o, unit)
            turn, shift = variable(pose.turn), variable(pose.shift)
            old = in_f64(at.turn_before)
            before = in_f64(at.shift_before)
            if share < 1.0:
                turn = partway(old, turn, share)
                shift = plus(scaled(before, 1.0 - share), scaled(shift, share))
            carry = product(turn, (old[0], 0.0 - old[1], 0.0 - old[2], 0.0 - old[3]))
            point = scaled(read(tables.obstacles, own, o, POINT), 1.0 / unit)
            at.point = plus(rotated(turn, point), shift)
            at.axis_1 = rotated(turn, read(tables.obstacles, own, o, AXES))
            at.axis_2 = rotated(turn, read(tables.obstacles, own, o, AXES + 3))
            at.axis_3 = rotated(turn, read(tables.obstacles, own, o, AXES + 6))
            at.pose = turn + shift
            t, m1, m2 = directors(carry)
            at.carry = t + m1 + m2
            at.carried = minus(shift, rotated(carry, before))

    def rest_of_poses(self, tables, row, step):
        """One where no obstacle moves in step ``step``, else zero."""
        i, still = ti.min(row, tables.poses.shape[0] - 1), ti.cast(1.0, ti.f64)
        for o, k in ti.ndrange(tables.kinds.shape[0], POSE_COLUMNS):
            if tables.poses[i, step, o, k] != tables.poses[i, step + 1, o, k]:
                still = 0.0
        return still

    def pose_from(self, tables, row, instant, o, unit):
        """The record of ``turn`` and ``shift`` of an obstacle at an instant, lengths over ``unit``."""
        i = ti.min(row, tables.poses.shape[0] - 1)
        return record(turn=read(tables.poses, i, instant, o, 0, count=4),
                      shift=scaled(read(tables.poses, i, instant, o, POSE_SHIFT), 1.0 / unit))

    # --- how far apart clamps hold a rod: beyond its reach, taut, or slack ---

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
                some = ti.select(found == TAUT, 0.0, 1.0)  # of a taut rod no edge may tilt, and closure does not hold
                own.closed = some * tables.clamp[s, of.CLOSED]
                for pair in ti.static(((1, of.TILT_START), (3, of.TILT_END), (4, of.TILT_INNER))):
                    own.free[pair[0]] = some * tables.clamp[s, pair[1]]
            if found == TAUT:
                self.stretch(tables, own, s, scaled(free, 1.0 / span))
            elif found != INFEASIBLE and before != SOUND and self.is_straight(tables, own, s):
                self.bow(tables, own, slot, s, slack)
                own.reach = BOWED
        return found

    def tilts(self, tables, s, e):
        """One where clamps s let edge ``e`` tilt, else zero."""
        free = ti.cast(1.0, ti.f64)
        if e == 0:
            free = tables.clamp[s, of.TILT_START]
        if e == tables.rest_length.shape[1] - 1:
            free = tables.clamp[s, of.TILT_END]
        return free

    def stretch(self, tables, own, s, along):
        """Turn the edges that may tilt to the unit vector ``along``; their spins are kept by parallel transport."""
        for e in range(tables.rest_length.shape[1]):
            if self.tilts(tables, s, e) > 0.0:
                self.edge(own, e).frame = turned_to(in_f64(self.edge(own, e).frame), along)

    def is_straight(self, tables, own, s):
        """Whether the edges that may tilt are in one straight line."""
        edges, row = tables.rest_length.shape[1], ti.min(s, tables.rest_length.shape[0] - 1)
        apart = minus(self.direction(own, ti.min(1, edges - 1)), self.direction(own, edges // 2))
        straight = False
        if dot(apart, apart) < ALIKE:  # most rods that are not straight are seen not to be by two of their edges
            chord = variable(repeated(ti.cast(0.0, ti.f64), 3))
            reach = ti.cast(0.0, ti.f64)
            for e in range(edges):
                length = self.tilts(tables, s, e) * tables.rest_length[row, e]
                chord = plus(chord, scaled(self.direction(own, e), length))
                reach += length
            straight = dot(chord, chord) > (reach * (1.0 - self.straightness)) ** 2
        return straight

    def direction(self, own, e):
        """The tangent of an edge in a lane."""
        return tangent(in_f64(self.edge(own, e).frame))

    def bow(self, tables, own, slot, s, slack):
        """Bow the edges that may tilt as far as that ``slack``, a share of their length, lets them: downwards, or where the
        step of a rod that may touch something has failed so, aside."""
        edges = tables.rest_length.shape[1]
        middle = in_f64(self.edge(own, edges // 2).frame)
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
                self.edge(own, e).frame = turned_in_world(in_f64(self.edge(own, e).frame), scaled(axis, share))

    # --- the rod and its clamps ---

    def load_motion(self, tables, head, slot, rod):
        """Load the state of rod ``rod`` at its last two instants, its mass, drag and springs into lane ``slot``."""
        row, numbers = tables.rods[rod, of.RESULT_ROW], tables.rods[rod, of.EXTERNAL_ROW]
        own = head.lane(slot)
        if ti.static(self.joints_rest):
            own.bend_share, own.twist_share = tables.shares[numbers, 0], tables.shares[numbers, 1]
        unit = in_f64(own.energy_unit)
        inertia = ti.cast(0.0, ti.f64)
        for v in range(tables.rest_length.shape[1] + 1):
            vertex = self.moving_vertex(own, v)
            for k in range(INERTIA):
                vertex[k] = tables.places[row, v, k]
            for k in range(VERTEX_ITEMS - INERTIA):
                factor = ti.select(k < SPRING_POINT - INERTIA, 1.0 / unit, 1.0)  # energies, but a place in mm
                vertex[INERTIA + k] = tables.numbers[numbers, v, k] * factor
            inertia += tables.numbers[numbers, v, 0] / unit
        own.inertia = inertia
        if ti.static(self.touches):
            length_unit = in_f64(own.length_unit)
            share = inertia * length_unit * length_unit / (tables.rest_length.shape[1] + 1)
            self.contacts.load_motion(tables, slot, row, length_unit, share)
            if ti.static(self.moves):
                for o in range(tables.kinds.shape[0]):
                    pose = self.pose_from(tables, row, 0, o, length_unit)
                    at = self.contacts.obstacle(self.contacts.of_lane(tables, slot), o)
                    at.pose = pose.turn + pose.shift
                    at.pose_before = pose.turn + pose.shift
        edges = tables.rest_length.shape[1]
        for e in range(edges):
            motion, place = self.edge(own, e).motion, (row * edges + e) * 4
            self.edge(own, e).frame = read(tables.frames, place, count=4)
            motion.frame_1 = read(tables.frames, place, count=4)
            motion.frame_2 = read(tables.frames_before, place, count=4)
        if ti.static(self.touches):
            own.euler = 0.0
        # How it was at the last instant: SOUND, or STRAIGHT as its frames say.
        s, found = tables.rods[rod, of.CLAMP_ROW], SOUND
        if tables.clamp[s, of.CLOSED] > 0.0 and self.is_straight(tables, own, s):
            found = STRAIGHT
        own.reach = found

    def load_path(self, tables, head, slot, rod, step):
        """Load the clamps of step ``step``, and the obstacles that move, into lane ``slot``; of the end frames what they hold.
        Returns how they reach (:meth:`load_reach`)."""
        s = tables.rods[rod, of.CLAMP_ROW]
        own, edges = head.lane(slot), tables.rest_length.shape[1]
        unit = in_f64(own.length_unit)
        share = ti.cast(1.0, ti.f64)  # of the clamps' way that is left to the next instant, what the rod makes at once
        if ti.static(self.touches):
            contacts = tables.contacts.lane(slot)
            share = ti.min(share, contacts.way / ti.max(1.0 - in_f64(contacts.way_made), 1e-9))
        anchor = variable(read(tables.path, s, step, PATH_ANCHOR))
        line = variable(read(tables.path, s, step, PATH_TARGET))
        if share < 1.0:
            # From where the clamps were at the last instant; a free vertex 0 is measured from a fixed place.
            start = in_f64(own.vertex.place_1)
            end = variable(in_f64(self.edge(own, edges - 1).motion.place_1))
            end = plus(end, scaled(minus(plus(anchor, line), end), share))
            anchor = plus(anchor, scaled(minus(start, anchor), (1.0 - share) * (1.0 - tables.clamp[s, of.LOOSE])))
            line = minus(end, anchor)
        own.anchor = scaled(anchor, 1.0 / unit)
        own.target = scaled(line, 1.0 / unit)
        first = self.load_path_end(tables, s, step, share, 0, self.edge(own, 0))
        last = self.load_path_end(tables, s, step, share, 1, self.edge(own, edges - 1))
        if ti.static(self.touches):
            still = tables.path[s, step, PATH_STILL]
            if ti.static(self.moves):
                row = tables.rods[rod, of.RESULT_ROW]
                self.next_poses(tables, slot, row, step, share, unit)
                still *= self.rest_of_poses(tables, row, step)
            own.unmoved = still
        return self.load_reach(tables, own, slot, s, line, first, last)

    def load_path_end(self, tables, s, step, share, end: ti.template(), edge):
        """The frame of an end ``edge`` after that share of its way; returns its tangent, zero where it is not held."""
        along = variable(repeated(ti.cast(0.0, ti.f64), 3))
        if tables.clamp[s, of.TILT_START + end] == 0.0:
            held = variable(read(tables.path, s, step, PATH_ENDS + 4 * end, count=4))
            along = tangent(held)
            last = in_f64(edge.motion.frame_1)
            if tables.clamp[s, of.SPIN_START + end] > 0.0:
                held = turned_to(last, along)  # a tangent alone
            if share < 1.0:
                held = partway(last, held, share)
                along = tangent(held)
            edge.frame = held
        return along

    def store_motion(self, tables, head, slot, row):
        """Store the state of the lane's rod at its last two instants in row ``row``."""
        own, edges = head.lane(slot), tables.rest_length.shape[1]
        self.store_vertices(tables.places, row, INERTIA, own, edges)
        for e in range(edges):
            motion, place = self.edge(own, e).motion, (row * edges + e) * 4
            write(tables.frames, place, values=motion.frame_1)
            write(tables.frames_before, place, values=motion.frame_2)
        if ti.static(self.has_border):
            write(tables.results, row, of.DRIFT, values=scaled(in_f64(own.drift), in_f64(own.length_unit)))

    def store_vertices(self, target: ti.template(), row, count: ti.template(), own, edges):
        """The first ``count`` items of every vertex into row ``row`` of ``target`` (-, V, count)."""
        for v in range(edges + 1):
            vertex = self.moving_vertex(own, v)
            for k in ti.static(range(count)):
                target[row, v, k] = vertex[k]
