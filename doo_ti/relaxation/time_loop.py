"""Time steps inside the kernel: a lane whose step has converged starts the next, with its clamps moved (docs/dynamics.md)."""

import taichi as ti

from doo_ti.physics.quaternion import partway, tangent, transported
from doo_ti.physics.tuples import chosen, dot, plus, put_lane, record, scaled, variable
from doo_ti.relaxation import chain
from doo_ti.relaxation import tables as of
from doo_ti.relaxation.contact_layout import MULTIPLIER, WAY, WAY_MADE, WORK
from doo_ti.relaxation.loading import LANES
from doo_ti.relaxation.newton_loop import NewtonLoop
from doo_ti.relaxation.newton_policy import TOLERANCE
from doo_ti.relaxation.obstacle_motion import ObstacleLoading
from doo_ti.relaxation.time_sweep import (
    EXTRAPOLATION,
    FRAME_1,
    FRAME_2,
    INERTIA,
    LEAST_WAY,
    OF_BEND_SHARE,
    OF_INERTIA,
    OF_RELINKED,
    OF_VERTEX,
    PLACE_1,
    RATE,
    SPRING_POINT,
    STEP,
    VERTEX_ITEMS,
    WATCHED,
    TimeSweep,
)

# Columns of the clamps at an instant: the point the chain hangs from, the far point from there, mm, the first and last frame.
PATH_ANCHOR, PATH_TARGET, PATH_ENDS, PATH_COLUMNS = 0, 3, 6, 14
# Columns of the outcome of a frame: the status, iterations of all its steps and the largest residual, and the force of the far
# clamp at its end; the work that friction has done since the motion began; and where that is noted one if the rod's link has
# changed in a step.
STATE, TRIPS, MOMENT, END_FORCE, FRICTION_WORK, RELINKED, OUTCOMES = 0, 1, 2, 3, 6, 7, 8

POSITION_ROUNDING = 1e-6
"""Of the rod's length, in f32: what a step may be wrong by in every position."""


@ti.data_oriented
class MotionLoading(ObstacleLoading):
    """Loading and storing of a rod's state at its last two instants, in addition to what :class:`.Loading` does for any rod.

    ``tables`` holds, besides, places (rod, V, INERTIA): positions and velocities at the last two instants; frames and
    frames_before [rod · edge · 4]; numbers (row, V, VERTEX_ITEMS − INERTIA); shares (row, 2); path (clamps, step,
    PATH_COLUMNS).
    """

    def __init__(self, sweep: TimeSweep):
        super().__init__(sweep)
        self.motion, self.time_parameters, self.damped = sweep.motion, sweep.time_parameters, sweep.damped

    @ti.func
    def load_motion(self, tables, scratch: ti.template(), head, slot, rod):
        """Load the state of rod ``rod`` at its last two instants, its mass, drag and springs into lane ``slot``."""
        row, numbers = tables.rods[rod, of.RESULT_ROW], tables.rods[rod, of.EXTERNAL_ROW]
        own = head + self.time_parameters * self.stride
        if ti.static(self.damped):
            for k in ti.static(range(2)):
                self.put(scratch, own + (OF_BEND_SHARE + k) * self.stride, slot, tables.shares[numbers, k])
        unit = ti.cast(self.get(scratch, head + chain.OF_ENERGY_UNIT * self.stride, slot), ti.f64)
        self.load_vertex(tables, scratch, own + OF_VERTEX * self.stride, slot, row, numbers, 0, 1.0 / unit)
        inertia = ti.cast(0.0, ti.f64)
        for vertex in range(tables.rest_length.shape[1] + 1):
            inertia += tables.numbers[numbers, vertex, 0] / unit
        self.put(scratch, own + OF_INERTIA * self.stride, slot, inertia)
        if ti.static(self.touches):
            length_unit = ti.cast(self.get(scratch, head + chain.OF_LENGTH_UNIT * self.stride, slot), ti.f64)
            share = inertia * length_unit * length_unit / (tables.rest_length.shape[1] + 1)
            self.contacts.load_motion(tables, scratch, slot, row, length_unit, share)
            if ti.static(self.moves):
                self.first_poses(tables, scratch, slot, row, length_unit)
        at = head + (self.parameters + self.motion) * self.stride
        edges = tables.rest_length.shape[1]
        for e in range(edges):
            self.load_vertex(tables, scratch, at, slot, row, numbers, e + 1, 1.0 / unit)
            place = (row * edges + e) * 4
            self.put_items(scratch, at + FRAME_1 * self.stride, slot, self.frame_from(tables.frames, place))
            self.put_items(scratch, at + FRAME_2 * self.stride, slot, self.frame_from(tables.frames_before, place))
            at += self.edge_stride

    @ti.func
    def load_vertex(self, tables, scratch: ti.template(), at, slot, row, numbers, vertex, scale):
        """A vertex's items, energies times ``scale``."""
        for k in range(INERTIA):
            self.put(scratch, at + k * self.stride, slot, tables.places[row, vertex, k])
        for k in range(VERTEX_ITEMS - INERTIA):
            factor = ti.select(k < SPRING_POINT - INERTIA, scale, 1.0)
            self.put(scratch, at + (INERTIA + k) * self.stride, slot, tables.numbers[numbers, vertex, k] * factor)

    @ti.func
    def load_path(self, tables, scratch: ti.template(), head, slot, rod, step):
        """Load the clamps of step ``step``, and the obstacles that move, into lane ``slot``; of the end frames what they hold.
        """
        s = tables.rods[rod, of.CLAMP_ROW]
        unit = ti.cast(self.get(scratch, head + chain.OF_LENGTH_UNIT * self.stride, slot), ti.f64)
        origin, edges = head + self.parameters * self.stride, tables.rest_length.shape[1]
        share = self.share_of_way(tables, scratch, slot)
        first = head + (self.time_parameters + OF_VERTEX + PLACE_1) * self.stride
        last = origin + (edges - 1) * self.edge_stride + (self.motion + PLACE_1) * self.stride
        for k in ti.static(range(3)):
            anchor, target = tables.path[s, step, PATH_ANCHOR + k], tables.path[s, step, PATH_TARGET + k]
            if share < 1.0:
                # From where the clamps were at the last instant; a free vertex 0 is measured from a fixed place.
                start = ti.cast(self.get(scratch, first + k * self.stride, slot), ti.f64)
                end = ti.cast(self.get(scratch, last + k * self.stride, slot), ti.f64)
                end += share * (anchor + target - end)
                anchor += (1.0 - share) * (start - anchor) * (1.0 - tables.clamp[s, of.LOOSE])
                target = end - anchor
            self.put(scratch, head + (chain.OF_ANCHOR + k) * self.stride, slot, anchor / unit)
            self.put(scratch, head + (chain.OF_TARGET + k) * self.stride, slot, target / unit)
        self.load_path_end(tables, s, step, share, 0, scratch, origin, slot)
        self.load_path_end(tables, s, step, share, 1, scratch, origin + (edges - 1) * self.edge_stride, slot)
        if ti.static(self.moves):
            self.next_poses(tables, scratch, slot, tables.rods[rod, of.RESULT_ROW], step, share, unit)

    @ti.func
    def share_of_way(self, tables, scratch: ti.template(), slot):
        """Of the clamps' way that is left to the next instant, the share that the rod in lane ``slot`` makes at once."""
        share = ti.cast(1.0, ti.f64)
        if ti.static(self.touches):
            made = ti.cast(self.get(scratch, tables.contacts + WAY_MADE * self.stride, slot), ti.f64)
            share = ti.min(share, self.get(scratch, tables.contacts + WAY * self.stride, slot) / ti.max(1.0 - made, 1e-9))
        return share

    @ti.func
    def load_path_end(self, tables, s, step, share, end: ti.template(), scratch: ti.template(), at, slot):
        """The frame of an end edge, whose items begin at ``at``, after that share of its way."""
        if tables.clamp[s, of.TILT_START + end] == 0.0:
            column = ti.static(PATH_ENDS + 4 * end)
            held = variable((tables.path[s, step, column], tables.path[s, step, column + 1],
                             tables.path[s, step, column + 2], tables.path[s, step, column + 3]))
            last = self.lane_frame(scratch, at + (self.motion + FRAME_1) * self.stride, slot)
            if tables.clamp[s, of.SPIN_START + end] > 0.0:
                # A tangent alone: the frame goes with it, by parallel transport from where it was.
                old, new = tangent(last), tangent(held)
                if 1.0 + dot(old, new) > 1e-14:
                    held = transported(last, old, new)
                else:
                    held = last
            if share < 1.0:
                held = partway(last, held, share)
            self.put_items(scratch, at, slot, held)

    @ti.func
    def store_motion(self, tables, scratch: ti.template(), head, slot, row):
        """Store the state of the lane's rod at its last two instants in row ``row``."""
        edges = tables.rest_length.shape[1]
        self.store_vertices(tables.places, row, INERTIA, scratch, head, slot, edges)
        at = head + (self.parameters + self.motion) * self.stride
        for e in range(edges):
            for k in ti.static(range(4)):
                place = (row * edges + e) * 4 + k
                tables.frames[place] = self.get(scratch, at + (FRAME_1 + k) * self.stride, slot)
                tables.frames_before[place] = self.get(scratch, at + (FRAME_2 + k) * self.stride, slot)
            at += self.edge_stride
        if ti.static(self.moves_start):
            unit = ti.cast(self.get(scratch, head + chain.OF_LENGTH_UNIT * self.stride, slot), ti.f64)
            for k in ti.static(range(3)):
                tables.results[row, of.DRIFT + k] = unit * self.get(scratch, head + (chain.OF_DRIFT + k) * self.stride, slot)

    @ti.func
    def store_vertices(self, target: ti.template(), row, count: ti.template(), scratch: ti.template(), head, slot, edges):
        """The first ``count`` items of every vertex into row ``row`` of ``target`` (-, V, count)."""
        own = head + (self.time_parameters + OF_VERTEX) * self.stride
        for k in ti.static(range(count)):
            target[row, 0, k] = self.get(scratch, own + k * self.stride, slot)
        at = head + (self.parameters + self.motion) * self.stride
        for e in range(edges):
            for k in ti.static(range(count)):
                target[row, e + 1, k] = self.get(scratch, at + k * self.stride, slot)
            at += self.edge_stride


@ti.data_oriented
class TimeLoop(NewtonLoop):
    """Newton's loop over the steps of every rod. ``tables`` holds, besides what :class:`MotionLoading` reads, what it writes:
    positions (rod · frame, V, 3) mm, and outcome (rod, frame, OUTCOMES); and steps, and every: a frame is stored after so many.
    """

    def __init__(self, sweep: TimeSweep):
        super().__init__(sweep)
        self.loading = MotionLoading(sweep)
        self.number_bits = sweep.number.bits

    @ti.func
    def exchange(self, tables, scratch: ti.template(), head, lane, supply):
        """Give every finished lane the next step of its rod; where that step was the last, or failed, another rod."""
        zero, one = self.constant(0.0), self.constant(1.0)
        done = (lane.finished > 0.5) & (lane.active > 0.5)
        time = record(step=zero + ti.cast(tables.time[STEP], self.scalar), rate=zero + ti.cast(tables.time[RATE], self.scalar),
                      extrapolation=zero + ti.cast(tables.time[EXTRAPOLATION], self.scalar))
        up = (ti.cast(tables.up[0], self.scalar), ti.cast(tables.up[1], self.scalar), ti.cast(tables.up[2], self.scalar))
        rod = self.sweep.rods(tables, scratch, head, lane.coarse)
        once_more, least = done & (lane.active < 0.5), zero + ti.cast(tables.time[LEAST_WAY], self.scalar)
        if ti.static(self.touches):
            blocked = lane.status > self.infeasible - 0.5
            failed = done & (lane.status > 0.5) & ~(blocked & self.sweep.contacts.pinched(rod, lane.miss))
            once_more = self.sweep.contacts.retry(rod, failed, blocked, least)
            known = self.sweep.load3(scratch, tables.contacts + MULTIPLIER * self.stride)
            lane.multiplier = chosen(once_more, known, lane.multiplier)
            done = done & ~once_more
        self.differentiate(tables, rod, time, up, ti.select(done, one, zero))
        if ti.static(self.touches):
            once_more = once_more | self.sweep.contacts.renew(rod, done & (lane.status < 0.5), least, lane.multiplier)
        repeats, made = ti.select(once_more, one, zero), ti.select(done, one, zero)
        if tables.time[WATCHED] > 0.0:
            self.sweep.watch(rod)
        self.sweep.remember(rod, time, done)
        steps_made = supply.places + (tables.queue.shape[0] - LANES) // 2
        for slot in range(self.width):
            if self.lane(lane.finished, slot) > 0.5:
                again = 0
                if self.lane(lane.active, slot) > 0.5 and self.lane(repeats, slot) > 0.5:
                    again = 1
                    row = tables.rods[tables.queue[supply.places + slot], of.RESULT_ROW]
                    frame = tables.queue[steps_made + slot] // tables.every
                    tables.outcome[row, frame, TRIPS] += self.lane(lane.trips, slot)
                    if self.lane(made, slot) > 0.5:  # a part of its step
                        self.note_link(tables, scratch, head, slot, row, frame)
                elif self.lane(lane.active, slot) > 0.5:
                    step = tables.queue[steps_made + slot]
                    again = self.conclude(tables, scratch, head, slot, lane, tables.queue[supply.places + slot], step)
                    tables.queue[steps_made + slot] = step + 1
                if again == 0:
                    self.refill(tables, scratch, head, slot, lane, supply)
                    tables.queue[steps_made + slot] = 0
                    if self.lane(lane.active, slot) > 0.5:
                        row = tables.rods[tables.queue[supply.places + slot], of.RESULT_ROW]
                        last = [tables.results[row, of.FORCE + k] for k in ti.static(range(3))]
                        put_lane(lane, self.with_lane, slot, multiplier=last)
                        self.loading.load_motion(tables, scratch, head, slot, tables.queue[supply.places + slot])
                        self.load_slopes(tables, scratch, head, slot, tables.queue[supply.places + slot])
        going = (lane.finished > 0.5) & (lane.active > 0.5)
        if self.largest(ti.select(going, one, zero)) > 0.5:
            next_rod = self.sweep.rods(tables, scratch, head, lane.coarse)
            self.sweep.prepare(next_rod, time, up, going)
            for slot in range(self.width):
                if self.lane(lane.finished, slot) > 0.5 and self.lane(lane.active, slot) > 0.5:
                    self.loading.load_path(tables, scratch, head, slot, tables.queue[supply.places + slot],
                                           tables.queue[steps_made + slot])

    @ti.func
    def note_link(self, tables, scratch: ti.template(), head, slot, row, frame):
        """Note where the link of the rod in lane ``slot`` has changed in what it has just made."""
        if tables.time[WATCHED] > 0.0:
            change = self.get(scratch, head + (self.sweep.time_parameters + OF_RELINKED) * self.stride, slot)
            if not ti.abs(change) < 0.5:
                tables.outcome[row, frame, RELINKED] = 1.0

    @ti.func
    def conclude(self, tables, scratch: ti.template(), head, slot, lane, rod, step):
        """Report the step that the rod in lane ``slot`` has made; returns one where it is to make another."""
        row, edges = tables.rods[rod, of.RESULT_ROW], tables.rest_length.shape[1]
        frames = tables.outcome.shape[1]
        frame = step // tables.every
        status = self.lane(lane.status, slot)
        total = self.get(scratch, head + chain.OF_TOTAL * self.stride, slot)
        moment = ti.cast(self.lane(lane.residual, slot) * total, ti.f64)
        tables.outcome[row, frame, TRIPS] += self.lane(lane.trips, slot)
        tables.outcome[row, frame, MOMENT] = ti.max(tables.outcome[row, frame, MOMENT], moment)
        self.note_link(tables, scratch, head, slot, row, frame)
        again = 0
        if status == self.converged:
            if (step + 1) % tables.every == 0:
                tables.outcome[row, frame, STATE] = status
                unit = ti.cast(self.get(scratch, head + chain.OF_ENERGY_UNIT * self.stride, slot), ti.f64)
                unit /= ti.cast(self.get(scratch, head + chain.OF_LENGTH_UNIT * self.stride, slot), ti.f64)
                for k in ti.static(range(3)):
                    force = ti.cast(self.lane(lane.multiplier[k], slot), ti.f64)
                    tables.outcome[row, frame, END_FORCE + k] = 0.0 - unit * force
                self.loading.store_vertices(tables.positions, row * frames + frame, 3, scratch, head, slot, edges)
                self.write_slopes(tables, scratch, slot, row * frames + frame)
                if ti.static(self.touches):
                    self.sweep.contacts.unload_forces(tables, scratch, slot, row * frames + frame, unit)
                    self.sweep.contacts.unload_touch(tables, scratch, slot, row * frames + frame)
                    work = ti.cast(self.get(scratch, tables.contacts + WORK * self.stride, slot), ti.f64)
                    tables.outcome[row, frame, FRICTION_WORK] = work * ti.cast(
                        self.get(scratch, head + chain.OF_ENERGY_UNIT * self.stride, slot), ti.f64)
            if step + 1 < tables.steps:
                again = 1
            else:
                self.loading.store_motion(tables, scratch, head, slot, row)
                if ti.static(self.touches):
                    self.sweep.contacts.unload_motion(tables, scratch, slot, row)
                for k in ti.static(range(3)):
                    tables.results[row, of.FORCE + k] = self.lane(lane.multiplier[k], slot)
                self.store_slopes(tables, scratch, slot, row)
        else:
            for later in range(frame, frames):
                tables.outcome[row, later, STATE] = status
        return again

    # --- of a loop that differentiates the steps, :class:`doo_ti.relaxation.time_slope_loop.TimeSlopeLoop` ---

    @ti.func
    def differentiate(self, tables, rod, time, up, done):
        """The derivatives of the steps that have converged, in the lanes where ``done`` is one."""

    @ti.func
    def load_slopes(self, tables, scratch: ti.template(), head, slot, rod):
        """The derivatives that rod ``rod`` remembers, and its parameters, into lane ``slot``."""

    @ti.func
    def store_slopes(self, tables, scratch: ti.template(), slot, row):
        """The derivatives that the lane's rod remembers into row ``row``."""

    @ti.func
    def write_slopes(self, tables, scratch: ti.template(), slot, place):
        """The derivatives of the lane's positions, for row ``place`` of the positions."""

    @ti.func
    def tolerance(self, tables, rod):
        """The largest residual of a step: in f32 at least what rounding of positions makes of the inertia of the whole rod."""
        given = self.constant(0.0) + ti.cast(tables.policy[TOLERANCE], self.scalar)
        inertia = rod.scratch[rod.head + (self.sweep.time_parameters + OF_INERTIA) * self.stride]
        length = rod.total * rod.length_unit
        if ti.static(self.touches):
            given = self.sweep.contacts.tolerance(rod, given)
        return given + ti.static(POSITION_ROUNDING if self.number_bits == 32 else 0.0) * inertia * length * length * rod.total

    @ti.func
    def multiplier(self, lane, fitted):
        """λ of the Newton step; a time step begins with that of the step before."""
        share = ti.select((lane.escaping < 0.5) & (lane.fresh < 0.5), lane.step_scale, self.constant(0.0))
        return chosen(share > 0.0, plus(lane.multiplier, scaled(lane.change, share)), lane.multiplier)
