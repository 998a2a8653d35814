"""Time steps inside the kernel: a lane whose step has converged starts the next, with its clamps moved (docs/dynamics.md)."""

import taichi as ti

from doo_ti.physics.number import device_functions, in_f64, read
from doo_ti.physics.tuples import choose, chosen, plus, put_lane, repeated, scaled
from doo_ti.relaxation import tables as of
from doo_ti.relaxation.clamp_table import INFEASIBLE, TAUT
from doo_ti.relaxation.loading import LANES
from doo_ti.relaxation.newton import NewtonLoop
from doo_ti.relaxation.newton_policy import TOLERANCE
from doo_ti.relaxation.time_loading import BOWED, MotionLoading
from doo_ti.relaxation.time_sweep import LEAST_WAY, RATE, STEP, WATCHED, TimeSweep
from doo_ti.rod.material import STANDARD_GRAVITY

# Columns of the outcome of a frame: the status, iterations of all its steps and the largest residual, and the force of the far
# clamp at its end; the work that friction has done since the motion began; and where that is noted one if the rod's link has
# changed in a step.
STATE, TRIPS, MOMENT, END_FORCE, FRICTION_WORK, RELINKED, OUTCOMES = 0, 1, 2, 3, 6, 7, 8

ROUNDING = {32: 2.5e-7, 64: 1e-15}
"""By bits: of the rod's length in every position, and of one in every curvature times length, what a step may be wrong by."""
RESOLVED = 3e-3
"""Of the force of the acceleration of gravity, whatever the rod weighs: a step that rounds more than that is not resolved."""


@device_functions
class TimeLoop(NewtonLoop):
    """Newton's loop over the steps of every rod; ``tables`` as of :class:`MotionLoading`. ``differentiates``: with derivatives
    (:class:`.TimeSlopeLoop`).
    """

    differentiates = False

    def __init__(self, sweep: TimeSweep):
        super().__init__(sweep)
        # A step begins near its end, and inertia bears the soft parts of a rod.
        self.by_decrement, self.trace_at_rest = False, self.trace
        self.loading = MotionLoading(sweep)
        self.number_bits = sweep.number.bits

    def exchange(self, tables, head, lane, supply):
        """Give every finished lane the next step of its rod; where that step was the last, or failed, another rod."""
        zero, one = self.constant(0.0), self.constant(1.0)
        done = (lane.finished > 0.5) & (lane.active > 0.5)
        time = self.sweep.steps_of(tables, head)
        up = (ti.cast(tables.up[0], self.scalar), ti.cast(tables.up[1], self.scalar), ti.cast(tables.up[2], self.scalar))
        rod = self.sweep.rods(tables, head, lane.coarse)
        once_more, least = done & (lane.active < 0.5), zero + ti.cast(tables.time[LEAST_WAY], self.scalar)
        if ti.static(self.touches):
            blocked = lane.status > self.infeasible - 0.5
            failed = done & (lane.status > 0.5) & ~(blocked & self.sweep.contacts.pinched(rod, lane.miss))
            reach = head.reach
            once_more = self.sweep.contacts.retry(rod, failed, blocked, reach > BOWED - 0.5, least)
            impact = self.sweep.impact(rod, time, up)
            bounced = done & (lane.status < 0.5) & impact.bounces
            choose(rod.head, bounced, euler=one)
            self.sweep.contacts.begin_rounds(rod, bounced)
            time.kept, once_more = impact.kept, once_more | bounced
            choose(lane, once_more, multiplier=tables.contacts.multiplier)
            done = done & ~once_more
        if ti.static(self.differentiates):
            self.differentiate(tables, rod, time, up, ti.select(done, one, zero))
        if ti.static(self.touches):
            once_more = once_more | self.sweep.contacts.renew(rod, done & (lane.status < 0.5), least, lane.multiplier)
        repeats, made = ti.select(once_more, one, zero), ti.select(done, one, zero)
        if tables.time[WATCHED] > 0.0:
            self.sweep.watch(rod)
        self.sweep.remember(rod, time, done)
        if ti.static(self.touches):
            choose(rod.head, done, euler=zero)  # the next step is one like others
        steps_made = supply.places + (tables.queue.shape[0] - LANES) // 2
        for slot in range(self.width):
            if self.lane(lane.finished, slot) > 0.5:
                self.exchange_lane(tables, head, slot, lane, supply, self.lane(repeats, slot), self.lane(made, slot))
        going = (lane.finished > 0.5) & (lane.active > 0.5)
        if self.largest(ti.select(going, one, zero)) > 0.5:
            next_rod = self.sweep.rods(tables, head, lane.coarse)
            self.sweep.prepare(next_rod, self.sweep.steps_of(tables, head), up, going)
            for slot in range(self.width):
                if self.lane(lane.finished, slot) > 0.5 and self.lane(lane.active, slot) > 0.5:
                    reach = self.loading.load_path(tables, head, slot, tables.queue[supply.places + slot],
                                                   tables.queue[steps_made + slot])
                    if reach == TAUT:
                        put_lane(lane, self.with_lane, slot, multiplier=repeated(0.0, 3))

    def exchange_lane(self, tables, head, slot, lane, supply, repeats, made):
        """The next step of the rod in a finished lane or, where that is over, another rod. ``repeats``: one where the step is
        not over; ``made``: one where a part of it is."""
        steps_made = supply.places + (tables.queue.shape[0] - LANES) // 2
        again = 0
        if self.lane(lane.active, slot) > 0.5 and repeats > 0.5:
            again = 1
            row = tables.rods[tables.queue[supply.places + slot], of.RESULT_ROW]
            frame = tables.queue[steps_made + slot] // tables.every
            tables.outcome[row, frame, TRIPS] += self.lane(lane.trips, slot)
            if made > 0.5:
                self.note_link(tables, head, slot, row, frame)
        elif self.lane(lane.active, slot) > 0.5:
            step = tables.queue[steps_made + slot]
            again = self.conclude(tables, head, slot, lane, tables.queue[supply.places + slot], step)
            tables.queue[steps_made + slot] = step + 1
        if again == 0:
            self.refill(tables, head, slot, lane, supply)
            tables.queue[steps_made + slot] = 0
            if self.lane(lane.active, slot) > 0.5:
                row = tables.rods[tables.queue[supply.places + slot], of.RESULT_ROW]
                put_lane(lane, self.with_lane, slot, multiplier=read(tables.results, row, of.FORCE))
                self.loading.load_motion(tables, head, slot, tables.queue[supply.places + slot])
                if ti.static(self.differentiates):
                    self.load_slopes(tables, head, slot, tables.queue[supply.places + slot])

    def advance(self, tables, head, lane):
        self.trip(tables, head, lane)
        self.refuse(head, lane)

    def refuse(self, head, lane):
        """End the steps whose clamps are out of their rods' reach."""
        reach = head.reach
        out = (reach > INFEASIBLE - 0.5) & (reach < INFEASIBLE + 0.5)
        choose(lane, out, status=self.constant(self.infeasible), finished=lane.active)

    def note_link(self, tables, head, slot, row, frame):
        """Note where the link of the rod in lane ``slot`` has changed in what it has just made."""
        if tables.time[WATCHED] > 0.0:
            if not ti.abs(head.lane(slot).relinked) < 0.5:
                tables.outcome[row, frame, RELINKED] = 1.0

    def conclude(self, tables, head, slot, lane, rod, step):
        """Report the step that the rod in lane ``slot`` has made; returns one where it is to make another."""
        row, edges = tables.rods[rod, of.RESULT_ROW], tables.rest_length.shape[1]
        frames = tables.outcome.shape[1]
        frame = step // tables.every
        status = self.lane(lane.status, slot)
        own = head.lane(slot)
        moment = in_f64(self.lane(lane.residual, slot) * own.total)
        tables.outcome[row, frame, TRIPS] += self.lane(lane.trips, slot)
        tables.outcome[row, frame, MOMENT] = ti.max(tables.outcome[row, frame, MOMENT], moment)
        self.note_link(tables, head, slot, row, frame)
        again = 0
        if status == self.converged:
            if (step + 1) % tables.every == 0:
                tables.outcome[row, frame, STATE] = status
                unit = self.loading.force_unit(own)
                taut = own.reach == TAUT
                for k in ti.static(range(3)):
                    force = 0.0 - unit * ti.cast(self.lane(lane.multiplier[k], slot), ti.f64)
                    # The tension of a taut rod is not determined.
                    tables.outcome[row, frame, END_FORCE + k] = ti.select(taut, ti.math.nan, force)
                self.loading.store_vertices(tables.positions, row * frames + frame, 3, own, edges)
                if ti.static(self.differentiates):
                    self.store_slopes(tables, tables.position_slopes, slot, row * frames + frame)
                if ti.static(self.touches):
                    self.sweep.contacts.unload_forces(tables, slot, row * frames + frame, unit)
                    self.sweep.contacts.unload_touch(tables, slot, row * frames + frame)
                    work = in_f64(tables.contacts.lane(slot).work)
                    tables.outcome[row, frame, FRICTION_WORK] = work * in_f64(own.energy_unit)
            if step + 1 < tables.steps:
                again = 1
            else:
                self.loading.store_motion(tables, head, slot, row)
                if ti.static(self.touches):
                    self.sweep.contacts.unload_motion(tables, slot, row)
                for k in ti.static(range(3)):
                    tables.results[row, of.FORCE + k] = self.lane(lane.multiplier[k], slot)
                if ti.static(self.differentiates):
                    self.store_slopes(tables, tables.slopes, slot, row)
        else:
            for later in range(frame, frames):
                tables.outcome[row, later, STATE] = status
        return again

    def tolerance(self, tables, rod, final: ti.template() = False):
        """The largest residual of a step: that of a rod at rest or, where its mass times the acceleration of gravity means
        smaller moments, that share of these; and what rounding makes of its stiffness and inertia. Negative, so that the step
        stalls, where that is too much."""
        zero = self.constant(0.0)
        given = zero + ti.cast(tables.policy[TOLERANCE], self.scalar)
        inertia = rod.head.inertia
        # Without a unit, like the residual: a force κ d, κ the sum of the inertia of all vertices over the square of the step,
        # has the moment ``moment`` times d, mm, over a lever of 1; ``weight`` is that of gravity, g h² of way, on an edge.
        moment = inertia * rod.length_unit * rod.total
        interval = tables.time[STEP] / tables.time[RATE]
        weight = ti.cast(ti.static(1e3 * STANDARD_GRAVITY) * interval * interval, self.scalar) * moment * rod.longest
        weight = ti.select(inertia > 0.0, weight, zero + 1.0)
        lever = ti.select(rod.loose > 0.5, rod.total, rod.longest)  # of the forces on a vertex 0 that is free, the rod's length
        rounding = ti.static(ROUNDING[self.number_bits]) * (rod.edges + moment * lever * rod.total * rod.length_unit)
        given = given * ti.min(weight, zero + 1.0)
        if ti.static(self.touches):
            given = self.sweep.contacts.tolerance(rod, given, final)
        return ti.select(rounding * rod.longest > ti.static(RESOLVED) * weight * lever, zero - 1.0, given + rounding)

    def multiplier(self, lane, fitted):
        """λ of the Newton step; a time step begins with that of the step before."""
        share = ti.select((lane.escaping < 0.5) & (lane.fresh < 0.5), lane.step_scale, self.constant(0.0))
        return chosen(share > 0.0, plus(lane.multiplier, scaled(lane.change, share)), lane.multiplier)
