"""The loop of a thread of the Newton kernel: trips through its lanes' rods, each a step, its judgement and the plan of the next
(§III-D, docs/chain.md)."""

import taichi as ti

from doo_ti.physics.tuples import choose, chosen, dot, plus, record, repeated, scaled, variable
from doo_ti.relaxation import chain
from doo_ti.relaxation import newton_policy as fixed
from doo_ti.relaxation import tables as of
from doo_ti.relaxation.contact_layout import CROSSING, WALL
from doo_ti.relaxation.elimination import Elimination
from doo_ti.relaxation.loading import LANES, NEXT, TRIPS, Loading
from doo_ti.types import Status


@ti.data_oriented
class NewtonLoop:
    """The work of a thread, until the queue is empty.

    Its functions share three records: ``tables``, the arrays that host and kernel share; ``rod``, the parameters of the rods
    in the lanes (:class:`.Chain`); and ``lane``, the state of each lane's rod and its next step:

    energy, magnitude, miss, multiplier  of the accepted frames; ``residual`` their largest moment
    change, longest                      δλ and the largest rotation of the step, rad
    shift, scale                         added to the diagonal of H, and H's largest diagonal entry
    step_scale                           share of the step that is taken
    trying, closing, escaping            flags: the step is judged by its energy; it only closes; it leaves a saddle
    rounds, heading, escapes             of leaving a saddle: inverse iterations made, the way taken, saddles left so far
    share                                of a step that only closes: less where it would carry the rod through an obstacle
    best, idle_trips, aimless            the smallest residual so far, trips without progress and without notable progress
    """

    def __init__(self, sweep: Elimination, functions=None, has_coarse: bool = False):
        number = sweep.number
        self.sweep, self.stride, self.has_coarse, self.touches = sweep, sweep.stride, has_coarse, sweep.touches
        self.loading = Loading(sweep, functions)
        self.largest, self.lane, self.with_lane, self.constant, _, self.get = number.lanes()
        self.width, self.scalar = number.width, number.scalar
        single = number.bits == 32
        self.rounding = 2e-6 if single else 1e-10
        self.patience = fixed.PATIENCE_32 if single else fixed.PATIENCE
        self.shape_tolerance = fixed.SHAPE_TOLERANCE_32 if single else 1e30
        self.closure_tolerance = 1e-7 if single else 1e-12
        # Neutral motions, a weightless bow about its chord, have an eigenvalue that is rounding of either sign: a small part of
        # H's scale on the diagonal makes it positive. f32 cannot distinguish them from soft saddles and leaves them to f64.
        self.trace = 0.0 if single else 1e-12
        self.converged, self.limit = int(Status.CONVERGED), int(Status.ITERATION_LIMIT)
        self.stalled, self.not_finite, self.infeasible = map(int, (Status.STALLED, Status.NOT_FINITE, Status.INFEASIBLE))
        self.growth, self.first_shift = (  # of the shift, where a step is rejected
            (fixed.GROWTH_IN_CONTACT, fixed.SHIFT_REJECTED_IN_CONTACT) if self.touches else (4.0, fixed.SHIFT_REJECTED))

    @ti.func
    def work(self, tables, scratch: ti.template(), threads, thread):
        """A thread's work, until the queue is empty."""
        edges = tables.rest_length.shape[1]
        head = thread
        if ti.static(self.stride == 1):
            head = thread * (self.sweep.parameters + self.sweep.items * edges)
        # Rods taken from the queue at a time: with fewer, threads wait for each other at the queue; with more, some end early.
        batch = ti.max(1, ti.min(16, tables.rods.shape[0] // (16 * threads * self.width)))
        lane = self.idle_lanes()
        supply = record(next=0, end=0, batch=batch, places=LANES + thread * self.width)
        pack_trips = 0
        running = 1
        while running == 1:
            if self.exchanges(lane):
                self.exchange(tables, scratch, head, lane, supply)
                self.begin(tables, scratch, head, lane)
            if self.largest(lane.active) < 0.5:
                running = 0
            else:
                self.advance(tables, scratch, head, lane)
                pack_trips += 1
        ti.atomic_add(tables.queue[TRIPS], pack_trips)

    @ti.func
    def exchanges(self, lane):
        """Whether finished lanes are to be exchanged now."""
        return self.largest(lane.finished) > 0.5

    @ti.func
    def exchange(self, tables, scratch: ti.template(), head, lane, supply):
        """Store the rods of the finished lanes and load others."""
        for slot in range(self.width):
            if self.lane(lane.finished, slot) > 0.5:
                if self.lane(lane.active, slot) > 0.5:
                    self.store(tables, scratch, head, slot, lane, tables.queue[supply.places + slot])
                self.refill(tables, scratch, head, slot, lane, supply)

    @ti.func
    def idle_lanes(self):
        """The record of lanes that have no rod yet."""
        zero, one = self.constant(0.0), self.constant(1.0)
        return record(
            energy=zero, magnitude=zero, miss=repeated(zero, 3), multiplier=repeated(zero, 3), residual=zero,
            change=repeated(zero, 3), longest=one, shift=zero, scale=one, step_scale=zero, coarse=zero, fresh=zero,
            trying=zero, closing=zero, share=one, returned=zero, troubled=zero, escaping=zero, escapes=zero, rounds=zero,
            heading=one, best=zero, idle_trips=zero, aimless=zero, rejects=zero, trips=zero, status=zero, stable=zero,
            lengths_known=zero, active=zero, finished=one)

    @ti.func
    def store(self, tables, scratch: ti.template(), head, slot, lane, rod):
        """Results of the rod in lane ``slot``, row ``rod`` of the rods."""
        row = tables.rods[rod, of.RESULT_ROW]
        origin = head + self.sweep.parameters * self.stride
        self.loading.store_frames(tables, row, scratch, origin, slot)
        if ti.static(self.touches):
            self.sweep.contacts.unload(tables, scratch, slot, row)
            self.sweep.contacts.unload_forces(tables, scratch, slot, row, self.loading.force_unit(scratch, head, slot))
        status = self.lane(lane.status, slot)
        if status == self.not_finite or status == self.infeasible:
            for k in ti.static(range(of.RESULTS)):
                tables.results[row, k] = ti.math.nan
        else:
            unit = ti.cast(self.get(scratch, head + chain.OF_ENERGY_UNIT * self.stride, slot), ti.f64)
            length_unit = ti.cast(self.get(scratch, head + chain.OF_LENGTH_UNIT * self.stride, slot), ti.f64)
            total = self.get(scratch, head + chain.OF_TOTAL * self.stride, slot)
            tables.results[row, of.ENERGY] = ti.cast(self.lane(lane.energy, slot), ti.f64) * unit
            tables.results[row, of.RESIDUAL] = self.lane(lane.residual, slot) * total
            for k in ti.static(range(3)):
                force = 0.0 - ti.cast(self.lane(lane.multiplier[k], slot), ti.f64)
                tables.results[row, of.FORCE + k] = force * unit / length_unit
            miss = (self.lane(lane.miss[0], slot), self.lane(lane.miss[1], slot), self.lane(lane.miss[2], slot))
            squares = miss[0] ** 2 + miss[1] ** 2 + miss[2] ** 2
            tables.results[row, of.CLOSURE] = ti.sqrt(squares) / total
        if ti.static(self.sweep.moves_start):
            for k in ti.static(range(3)):
                drift = ti.cast(self.get(scratch, head + (chain.OF_DRIFT + k) * self.stride, slot), ti.f64)
                tables.results[row, of.DRIFT + k] = drift * self.get(scratch, head + chain.OF_LENGTH_UNIT * self.stride, slot)
        tables.results[row, of.ITERATIONS] = self.lane(lane.trips, slot)
        tables.results[row, of.STATUS] = status
        tables.results[row, of.STABLE] = self.lane(lane.stable, slot)

    @ti.func
    def refill(self, tables, scratch: ti.template(), head, slot, lane, supply):
        """The next rod of the queue into lane ``slot``, if there is one; ``supply`` are the rods taken from it already."""
        lane.active = self.with_lane(lane.active, slot, 0.0)
        if supply.next == supply.end:
            supply.next = ti.atomic_add(tables.queue[NEXT], supply.batch)
            supply.end = ti.min(supply.next + supply.batch, tables.rods.shape[0])
        if supply.next < supply.end:
            rod = supply.next
            supply.next += 1
            tables.queue[supply.places + slot] = rod
            self.loading.load(tables, scratch, head, slot, rod, self.lane(lane.lengths_known, slot))
            lane.lengths_known = self.with_lane(lane.lengths_known, slot, 1.0)
            lane.active = self.with_lane(lane.active, slot, 1.0)

    @ti.func
    def begin(self, tables, scratch: ti.template(), head, lane):
        """Initialise the lanes that were refilled."""
        zero, one = self.constant(0.0), self.constant(1.0)
        begun = lane.finished > 0.5
        lane.scale = ti.select(begun, scratch[head + chain.OF_SCALE * self.stride], lane.scale)
        shift = ti.cast(tables.policy[fixed.FIRST_SHIFT], self.scalar) * lane.scale
        choose(
            lane, begun, shift=shift, fresh=one, best=self.constant(1e30), step_scale=zero, trips=zero, idle_trips=zero,
            aimless=zero, rejects=zero, trying=zero, closing=zero, share=one, returned=zero, troubled=zero, escaping=zero,
            escapes=zero)
        lane.finished = zero

    @ti.func
    def advance(self, tables, scratch: ti.template(), head, lane):
        """The work between two exchanges of rods: a trip."""
        self.trip(tables, scratch, head, lane)

    @ti.func
    def trip(self, tables, scratch: ti.template(), head, lane):
        """One step of every lane's rod, and its judgement."""
        zero, one = self.constant(0.0), self.constant(1.0)
        if ti.static(self.has_coarse):
            lane.coarse = ti.max(lane.coarse, lane.fresh)
        rod = self.sweep.rods(tables, scratch, head, lane.coarse)
        # Take the step, and judge it afterwards. The factorisation at its end has the shift that follows a good step.
        moving = ti.max(lane.trying, ti.max(lane.fresh, lane.closing))
        if ti.static(self.touches):
            # Where the rod may touch something, its start is looked at before it moves.
            moving = ti.max(lane.trying, lane.closing * lane.share)
        x, normal = self.sweep.step(rod, lane.step_scale, moving, lane.miss)
        decay = ti.select(lane.troubled > 0.5, self.constant(fixed.DECAY_TROUBLED), self.constant(fixed.DECAY))
        least = ti.select(lane.troubled > 0.5, self.constant(fixed.NEGLIGIBLE_TROUBLED), self.constant(fixed.NEGLIGIBLE))
        negligible = least * lane.scale
        smaller = ti.select(decay * lane.shift > negligible, decay * lane.shift, zero)
        next_shift = ti.select(lane.trying > 0.5, smaller, lane.shift)
        # To leave a saddle: inverse iteration, first from noise, then from its last result.
        searching = (lane.escaping > 0.5) & (lane.trying < 0.5)
        noise = ti.select(searching & (lane.rounds < 0.5), 1e-3 * lane.scale, zero)
        echo = ti.select(searching & (lane.rounds > 0.5), lane.scale / (lane.longest + 1e-30), zero)
        energy, magnitude, miss, fitted = self.sweep.close(rod, x, normal)
        multiplier = self.multiplier(lane, fitted)
        diagonal = ti.select(next_shift > 0.0, next_shift, self.trace * lane.scale)
        found = self.sweep.eliminate(rod, diagonal, (noise, echo), multiplier, miss)
        found.energy += energy
        found.magnitude += magnitude
        judged = self.judge_step(rod, lane, found, miss)
        if self.largest(ti.select(judged.uphill, one, zero)) > 0.5:
            self.sweep.restore(rod, ti.select(judged.uphill, one, zero))
        lane.longest = self.sweep.substitute(rod, found)
        self.keep(lane, found, miss, multiplier, judged, next_shift)
        place = self.judge_place(tables, rod, lane, found.inertia, judged)
        self.plan(tables, rod, lane, judged, place, searching, found.slope)
        self.end(tables, rod, lane, judged, place)

    @ti.func
    def multiplier(self, lane, fitted):
        """λ at the new frames: the least-squares one of closure or, under an external energy, which that leaves out, the one of
        the Newton step."""
        value = variable(fitted)
        if ti.static(self.sweep.moves_start):
            share = ti.select(lane.escaping < 0.5, lane.step_scale, self.constant(0.0))
            # Where no step is taken the change may be NaN.
            stepped = chosen(share > 0.0, plus(lane.multiplier, scaled(lane.change, share)), lane.multiplier)
            value = chosen(lane.fresh > 0.5, fitted, stepped)
        return value

    @ti.func
    def judge_step(self, rod, lane, found, miss):
        """Judge the step by the Lagrangian: a record of flags."""
        multiplier = plus(lane.multiplier, lane.change)
        before = lane.energy + dot(multiplier, lane.miss)
        after = found.energy + dot(multiplier, miss)
        noise_level = self.rounding * lane.magnitude
        finite = found.energy == found.energy
        downhill = (lane.trying > 0.5) & (after <= before + noise_level)
        moved = lane.trying > 0.5
        if ti.static(self.touches):
            # No step, not even one that only closes, may carry a vertex past the middle of an obstacle.
            moved = moved | ((lane.closing > 0.5) & (lane.fresh < 0.5))
            passable = self.sweep.contacts.item(rod, CROSSING) < 1.0
            downhill = downhill & passable
            finite = finite & (passable | ~moved)
        taken = ti.select(((lane.trying < 0.5) & finite) | downhill, self.constant(1.0), self.constant(0.0))
        stands = taken > 0.5
        return record(
            stands=stands, downhill=downhill, uphill=moved & (taken < 0.5),
            gained=(after < before - noise_level) & downhill, broken=(lane.fresh > 0.5) & ~stands,
            notable=(after < before - fixed.NOTABLE * lane.magnitude) & downhill)

    @ti.func
    def keep(self, lane, found, miss, multiplier, judged, next_shift):
        """Update the lane after its step: from the new frames where it is accepted, with a larger shift where it led uphill."""
        zero, one = self.constant(0.0), self.constant(1.0)
        lane.energy = ti.select(judged.stands, found.energy, lane.energy)
        lane.magnitude = ti.select(judged.stands, found.magnitude, lane.magnitude)
        lane.miss = chosen(judged.stands, miss, lane.miss)
        lane.multiplier = chosen(judged.stands, multiplier, lane.multiplier)
        lane.scale = ti.select(judged.stands, found.scale, lane.scale)
        lane.residual = ti.select(judged.stands, found.moment, lane.residual)
        lane.change = found.change
        lane.shift = ti.select(judged.stands, next_shift, lane.shift)
        stiffer = judged.uphill & (lane.escaping < 0.5)
        lane.shift = ti.select(stiffer, ti.max(self.growth * lane.shift, self.first_shift * lane.scale), lane.shift)
        lane.rejects = ti.select(judged.downhill, zero, lane.rejects + ti.select(judged.uphill, one, zero))
        lane.escaping = ti.select(judged.downhill, zero, lane.escaping)
        lane.share = ti.select(judged.uphill, 0.5 * lane.share, ti.min(2.0 * lane.share, one))
        lane.trips = lane.trips + lane.active

    @ti.func
    def tolerance(self, tables, rod):
        """The largest residual of a rod that has converged."""
        given = ti.cast(tables.policy[fixed.TOLERANCE], self.scalar)
        if ti.static(self.touches):
            return self.sweep.contacts.tolerance(rod, self.constant(0.0) + given)
        else:
            return given

    @ti.func
    def judge_place(self, tables, rod, lane, inertia, judged):
        """Judge where the rod is: a record of flags. The elimination, at the new frames, says nothing about restored ones."""
        gap = ti.sqrt(dot(lane.miss, lane.miss))
        at_rest = lane.residual * rod.total <= self.tolerance(tables, rod)
        small = at_rest & (gap <= self.closure_tolerance * rod.total) & ~judged.broken
        wrong = ((inertia < 2.5) | (inertia > 3.5)) & judged.stands
        right = (inertia > 2.5) & (inertia < 3.5) & judged.stands
        calm = small & (lane.escaping < 0.5) & judged.stands
        bare = (lane.shift <= 0.0) & (lane.coarse < 0.5)
        # Where rounding limits the residual, the size of the next step bounds the error of the shape.
        settled = lane.longest <= self.shape_tolerance
        at_saddle = calm & bare & wrong
        # Beside a saddle a rod may make no progress though its residual is not yet small.
        aimless = wrong & (lane.aimless > fixed.PATIENCE_AT_SADDLE) & (lane.escaping < 0.5) & (lane.closing < 0.5)
        limit = ti.cast(tables.policy[fixed.ESCAPES], self.scalar)
        leaving = (at_saddle & (lane.escapes < limit)) | (aimless & (limit > 0.0))
        return record(
            gap=gap, small=small, calm=calm, settled=settled, right=right, wrong=wrong,
            at_minimum=calm & bare & right & settled, at_saddle=at_saddle, leaving=leaving,
            resting=at_saddle & (lane.escapes >= limit), certify=calm & ((lane.shift > 0.0) | (lane.coarse > 0.5)))

    @ti.func
    def plan(self, tables, rod, lane, judged, place, searching, slope):
        """The next step: whether to take one, how much of it, and under which shift."""
        zero, one = self.constant(0.0), self.constant(1.0)
        lane.escaping = ti.select(place.leaving, one, lane.escaping)
        lane.shift = ti.select(place.leaving, zero, lane.shift)
        lane.escapes = ti.select(place.leaving & place.at_saddle, lane.escapes + 1.0, lane.escapes)
        lane.closing = ti.select(place.gap > ti.cast(tables.policy[fixed.CLOSING], self.scalar) * rod.longest, one, zero)
        if ti.static(self.touches):
            # A step that also closes may be refused because closing leads behind the barrier, which then has to give way.
            refused = judged.uphill & (place.gap > 1e3 * self.closure_tolerance * rod.total)
            lane.closing = ti.select(refused & self.sweep.contacts.behind(rod), one, lane.closing)
        lane.rounds = ti.select((lane.escaping > 0.5) & place.right & ~place.leaving, lane.rounds + 1.0, lane.rounds)
        lane.rounds = ti.select(place.leaving, zero, lane.rounds)
        unready = (lane.escaping > 0.5) & (lane.rounds <= fixed.ESCAPE_ROUNDS)
        held = place.certify | place.leaving | place.wrong | unready | (lane.closing > 0.5) | judged.uphill
        lane.trying = ti.select(held, zero, one)
        lane.troubled = ti.select(judged.uphill | (place.wrong & (lane.closing < 0.5)), one, lane.troubled)
        floor = ti.select(lane.escaping > 0.5, fixed.NEGLIGIBLE_TROUBLED * lane.scale, fixed.SHIFT_WRONG_INERTIA * lane.scale)
        lane.shift = ti.select(place.wrong & (lane.closing < 0.5), ti.max(4.0 * lane.shift, floor), lane.shift)
        lane.shift = ti.select(place.certify, zero, lane.shift)
        if ti.static(self.has_coarse):
            far = (lane.longest > fixed.COARSE_ROTATION) & ~place.small & (lane.escaping < 0.5)
            lane.coarse = ti.select(far, one, zero)
        cap = ti.min(one, ti.cast(tables.policy[fixed.ROTATION_LIMIT], self.scalar) / (lane.longest + 1e-30))
        lane.heading = ti.select(searching, ti.select(slope > 0.0, 0.0 - one, one), lane.heading)
        leap = lane.heading * fixed.ESCAPE_ROTATION / ((1.0 + lane.rejects) * (1.0 + lane.rejects) * (lane.longest + 1e-30))
        lane.step_scale = ti.select(lane.trying > 0.5, ti.select(lane.escaping > 0.5, leap, cap), zero)

    @ti.func
    def end(self, tables, rod, lane, judged, place):
        """Which lanes are finished, and with which status."""
        zero, one = self.constant(0.0), self.constant(1.0)
        better = place.leaving | (lane.closing > 0.5) | ((lane.residual < 0.7 * lane.best) & judged.stands)
        # A trip that only repeats the elimination after a rejected step does not count.
        waited = ti.select(lane.returned > 0.5, zero, one)
        lane.aimless = ti.select(better | judged.notable, zero, lane.aimless + waited)
        lane.idle_trips = ti.select(judged.gained | better, zero, lane.idle_trips + waited)
        lane.best = ti.select(better & judged.stands, ti.min(lane.best, lane.residual), lane.best)
        lane.returned = ti.select(judged.uphill, one, zero)
        fresh = lane.fresh > 0.5
        lane.fresh = zero
        ended = place.at_minimum | place.resting
        late = lane.trips >= ti.cast(tables.policy[fixed.ITERATION_LIMIT], self.scalar)
        stuck = lane.idle_trips > self.patience
        lost = judged.broken | ~(lane.residual == lane.residual)
        lane.status = ti.select(stuck, self.constant(self.stalled), self.constant(self.limit))
        lane.status = ti.select(lost, self.constant(self.not_finite), lane.status)
        # At rest, though a neutral motion leaves the certificate undecided: converged, not certified.
        at_rest = place.small & place.settled & (late | stuck)
        if ti.static(self.touches):
            entered = self.sweep.contacts.enter(rod, fresh, judged.stands & (lane.energy > WALL))
            calm = place.calm & ~entered & ~place.leaving
            goes_on = self.sweep.contacts.end_round(rod, lane, calm, (ended | at_rest) & ~entered, entered)
            ended, at_rest, stuck = ended & ~goes_on, at_rest & ~goes_on, stuck & ~goes_on
            blocked = self.sweep.contacts.blocked(rod, fresh, lane.miss)
            lane.status = ti.select(blocked, self.constant(self.infeasible), lane.status)
            ended, at_rest, lost = ended & ~blocked, at_rest & ~blocked, lost | blocked
        lane.status = ti.select(ended | at_rest, self.constant(self.converged), lane.status)
        lane.stable = ti.select(place.at_minimum, one, zero)
        lane.finished = ti.select((ended | late | stuck | lost) & (lane.active > 0.5), one, zero)
