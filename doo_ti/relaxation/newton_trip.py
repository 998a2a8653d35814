"""A trip of the Newton loop: a step of every lane's rod, its judgement and the plan of the next (§III-D, docs/chain.md)."""

import taichi as ti

from doo_ti.physics.algebra import absolute
from doo_ti.physics.number import device_functions
from doo_ti.physics.tuples import choose, chosen, dot, plus, record, scaled, variable
from doo_ti.relaxation import newton_policy as fixed
from doo_ti.relaxation.contact_table import EARLY_ROTATION, PART, SHIFT_GROWTH, SHORTENED
from doo_ti.relaxation.elimination import Elimination
from doo_ti.rod.types import Status


@device_functions
class NewtonTrip:
    """A trip through the loop of :class:`.NewtonLoop`.

    Its functions share three records: ``tables``, the arrays that host and kernel share; ``rod``, the parameters of the rods
    in the lanes (:class:`.Chain`); and ``lane``, the state of each lane's rod and its next step:

    energy, magnitude, miss, multiplier  of the accepted frames, magnitude being the sum of the energy's absolute terms, the
                                         scale of its rounding; ``residual`` their largest moment
    begun, arrived, along                the smallest t·target of an edge at the start, in the accepted frames, in all of them
    change, largest_move                 δλ, and the largest turn of an edge in the step, rad, or if that is more the largest
                                         share of a gap or of the way to the middle of an obstacle (ContactRounds.approach)
    shift, scale                         added to the diagonal of H, and H's largest diagonal entry
    sufficient                           the last shift under which the inertia was right
    step_scale                           share of the step that is taken
    fresh, trying, closing, escaping     flags: the rod has just been loaded; the step is judged by its energy; it only closes;
                                         it leaves a saddle
    coarse                               one where an external energy gives its coarse curvature
    rejects, returned                    steps refused since the last accepted one; one where the trip before ended so
    troubled                             one once a step was refused or the inertia was wrong: the shift then decays more slowly
    rounds, heading, escapes             of leaving a saddle: inverse iterations made, the way taken, saddles left so far
    strays                               how often the rod has left a saddle without having come to rest there
    spins_first                          one where the step is in spins that are made before tilts
    best, idle_trips, aimless            the smallest residual so far, trips without progress and without notable progress
    trips, status, stable                iterations made, and the rod's :class:`.Status` and certificate when it is finished
    active, finished, lengths_known      flags of the lane: it has a rod; that is to be exchanged; edge lengths have been loaded
    """

    def __init__(self, sweep: Elimination):
        number = sweep.number
        self.sweep, self.has_coarse, self.touches = sweep, sweep.has_coarse, sweep.touches
        self.largest, self.lane, self.with_lane, self.constant = number.largest, number.lane, number.with_lane, number.constant
        self.scalar = number.scalar
        single = number.bits == 32
        self.rounding = 2e-6 if single else 1e-10
        self.closure_rounding = 0.0 if single else 1e-15  # of a rod's length
        self.rounded_step = 0.0 if single else fixed.ROUNDED_STEP
        self.shape_tolerance = fixed.SHAPE_TOLERANCE_32 if single else 1e30
        self.closure_tolerance = 1e-7 if single else 1e-12
        # Neutral motions, a weightless bow about its chord, have an eigenvalue that is rounding of either sign: a small part of
        # H's scale on the diagonal makes it positive, among obstacles and in groups a larger one, since κ makes rounding
        # larger; rods that touch themselves have that at rest only. f32 cannot distinguish them from soft saddles and leaves
        # them to f64.
        self.itself = self.touches and sweep.contacts.itself
        self.among_obstacles = self.touches and not self.itself
        self.takes_met = self.touches and sweep.contacts.takes_met
        self.patience = fixed.PATIENCE_32 if single else fixed.PATIENCE
        self.trace = 0.0 if single else fixed.LARGE_TRACE if self.among_obstacles else fixed.TRACE
        self.trace_at_rest = 0.0 if single else fixed.LARGE_TRACE
        self.by_decrement = not single
        self.converged, self.limit = int(Status.CONVERGED), int(Status.ITERATION_LIMIT)
        self.growth = SHIFT_GROWTH if self.touches else fixed.GROWTH
        self.stalled, self.not_finite, self.infeasible = map(int, (Status.STALLED, Status.NOT_FINITE, Status.INFEASIBLE))

    def trip(self, tables, head, lane):
        """One step of every lane's rod, and its judgement."""
        zero, one = self.constant(0.0), self.constant(1.0)
        if ti.static(self.has_coarse):
            lane.coarse = ti.max(lane.coarse, lane.fresh)
        rod = self.sweep.rods(tables, head, lane.coarse)
        rod.spins_first = lane.spins_first
        # Take the step, and judge it afterwards. The factorisation at its end has the shift that follows a good step.
        moving = lane.trying
        if ti.static(not self.touches):  # a rod that may touch something is looked at before it moves
            moving = ti.max(lane.trying, ti.max(lane.fresh, lane.closing))
        x, normal = self.sweep.step(rod, lane.step_scale, moving, lane.miss)
        far = (lane.fresh > 0.5) | (lane.residual * rod.total > fixed.FAR_FROM_REST)
        lane.spins_first = self.sweep.spinning_first(rod, ti.select(far, one, zero))
        rod.spins_first = lane.spins_first
        decay = ti.select(lane.troubled > 0.5, self.constant(fixed.DECAY_TROUBLED), self.constant(fixed.DECAY))
        # A smaller shift makes a step larger, which is of no use where it could not be taken whole.
        shortened = ti.static(SHORTENED if self.touches else fixed.CUT)
        decay = ti.select(lane.step_scale < shortened, self.constant(1.0), decay)
        least = ti.select(lane.troubled > 0.5, self.constant(fixed.NEGLIGIBLE_TROUBLED), self.constant(fixed.NEGLIGIBLE))
        negligible = least * lane.scale
        smaller = ti.select(decay * lane.shift > negligible, decay * lane.shift, zero)
        next_shift = ti.select(lane.trying > 0.5, smaller, lane.shift)
        # To leave a saddle: inverse iteration finds the softest direction. It begins from noise, which has a part of it.
        searching = (lane.escaping > 0.5) & (lane.trying < 0.5)
        noise = ti.select(searching & (lane.rounds < 0.5), 1e-3 * lane.scale, zero)
        echo = ti.select(searching & (lane.rounds > 0.5), lane.scale / (lane.largest_move + 1e-30), zero)
        energy, magnitude, miss, fitted, lowest = self.sweep.close(rod, x, normal)
        multiplier = self.multiplier(lane, fitted)
        was_at_rest = (lane.fresh < 0.5) & (lane.residual * rod.total <= self.tolerance(tables, rod))
        trace = self.constant(self.trace)
        if ti.static(self.trace_at_rest > self.trace):
            trace = ti.select(was_at_rest, self.constant(self.trace_at_rest), trace)
        diagonal = ti.select(next_shift > 0.0, next_shift, trace * rod.evenness * lane.scale)
        found = self.sweep.eliminate(rod, diagonal, (noise, echo), multiplier, miss)
        found.energy += energy
        found.magnitude += magnitude
        judged = self.judge_step(rod, lane, found, miss)
        if self.largest(ti.select(judged.uphill, one, zero)) > 0.5:
            self.sweep.restore(rod, ti.select(judged.uphill, one, zero))
        lane.largest_move, size, decrement = self.sweep.substitute(rod, found)
        self.keep(rod, lane, found, miss, lowest, multiplier, judged, next_shift)
        place = self.judge_place(tables, rod, lane, found.inertia, (size, decrement, was_at_rest), judged)
        self.plan(tables, rod, lane, judged, place, searching, found.slope)
        self.end(tables, rod, lane, judged, place)

    def multiplier(self, lane, fitted):
        """λ at the new frames: the least-squares one of closure, or under an external energy the one of the Newton step."""
        value = variable(fitted)
        if ti.static(self.sweep.has_border):
            share = ti.select(lane.escaping < 0.5, lane.step_scale, self.constant(0.0))
            # Where no step is taken the change may be NaN.
            stepped = chosen(share > 0.0, plus(lane.multiplier, scaled(lane.change, share)), lane.multiplier)
            value = chosen(lane.fresh > 0.5, fitted, stepped)
        return value

    def judge_step(self, rod, lane, found, miss):
        """Judge the step by the Lagrangian: a record of flags."""
        multiplier = plus(lane.multiplier, lane.change)
        before = lane.energy + dot(multiplier, lane.miss)
        after = found.energy + dot(multiplier, miss)
        noise_level = self.rounding * lane.magnitude
        if ti.static(self.closure_rounding > 0.0):
            # The force on a rod that is almost taut is so large that its product with what rounding leaves of c counts.
            noise_level = noise_level + self.closure_rounding * rod.total * ti.sqrt(dot(multiplier, multiplier))
        finite = found.energy == found.energy
        downhill = (lane.trying > 0.5) & (after <= before + noise_level)
        moved = lane.trying > 0.5
        if ti.static(self.touches):
            # No step may carry a vertex past the middle of an obstacle. The Lagrangian says nothing across a change of forces.
            passable = rod.contacts.crossing < 1.0
            downhill = (downhill | (moved & (rod.contacts.update_stiffness > 0.0) & finite)) & passable
        taken = ti.select(((lane.trying < 0.5) & finite) | downhill, self.constant(1.0), self.constant(0.0))
        stands = taken > 0.5
        return record(
            stands=stands, downhill=downhill, uphill=moved & (taken < 0.5),
            gained=(after < before - noise_level) & downhill, broken=(lane.fresh > 0.5) & ~stands,
            notable=(after < before - fixed.NOTABLE * lane.magnitude) & downhill)

    def keep(self, rod, lane, found, miss, lowest, multiplier, judged, next_shift):
        """Update the lane after its step: from the new frames where it is accepted, else from the old ones.

        A step is refused where it led uphill. In contact the next one is then, the first time, the same with the contacts that
        it has met, or a part of it (:meth:`plan`); from the second time on one under a smaller κ, or if that cannot shrink, as
        without contact, with a larger shift. A rod deep inside an obstacle gets a larger κ each time.
        """
        zero, one = self.constant(0.0), self.constant(1.0)
        choose(lane, judged.stands, energy=found.energy, magnitude=found.magnitude, miss=miss, multiplier=multiplier,
               arrived=lowest[1], along=ti.min(lane.along, lowest[1]), scale=found.scale, residual=found.moment,
               shift=next_shift)
        choose(lane, lane.fresh > 0.5, begun=lowest[0])
        lane.change = found.change
        if ti.static(self.touches):
            choose(rod.contacts, judged.stands, penalty_kept=rod.contacts.penalty)
        stiffer = judged.uphill & (lane.escaping < 0.5)
        if ti.static(self.touches):
            # Not the first time: where contacts begin and end, the energy is not quadratic.
            stiffer = stiffer & (lane.rejects > 0.5)
            self.sweep.contacts.stiffen(rod, judged.uphill)
        if ti.static(self.among_obstacles):
            # Along curved obstacles a large κ leaves room for short steps only.
            stiffer = stiffer & ~self.sweep.contacts.soften(rod, stiffer)
        lane.shift = ti.select(stiffer, ti.max(self.growth * lane.shift, fixed.SHIFT_REJECTED * lane.scale), lane.shift)
        lane.rejects = ti.select(judged.downhill, zero, lane.rejects + ti.select(judged.uphill, one, zero))
        lane.escaping = ti.select(judged.downhill, zero, lane.escaping)
        lane.trips = lane.trips + lane.active

    def tolerance(self, tables, rod, final: ti.template() = False):
        """The largest residual of a rod that has converged, in contact in the round that it is in, or in a ``final`` one."""
        given = self.constant(0.0) + ti.cast(tables.policy[fixed.TOLERANCE], self.scalar)
        if ti.static(self.touches):
            given = self.sweep.contacts.tolerance(rod, given, final)
        return given

    def judge_place(self, tables, rod, lane, inertia, step, judged):
        """Judge where the rod is: a record of flags. ``at_rest``: residual, closure and decrement are small; ``calm``: at rest,
        at accepted frames, and not leaving a saddle. Where frames were restored, the elimination belongs to the refused step.

        step: of the next one its size and its Newton decrement, and whether the rod had come to rest before this one.
        """
        size, decrement, was_at_rest = step
        gap = ti.sqrt(dot(lane.miss, lane.miss))
        tolerance = self.tolerance(tables, rod)
        balanced = lane.residual * rod.total <= tolerance
        if ti.static(self.touches):
            # Large forces on a limp rod: rounding limits the residual, and the next step bounds the error of the shape.
            still = (size <= self.rounded_step) & (lane.shift <= 0.0)
            balanced = balanced | (still & (lane.residual * rod.total <= fixed.BY_ROUNDING * tolerance))
        if ti.static(self.by_decrement):
            # The residual is measured by the stiffest part of a rod: what the next step would gain bounds the error of others.
            turn = fixed.TURN_LEFT * tolerance
            enough = (turn * turn + fixed.NEUTRAL * size * size) * rod.softest / rod.total
            enough = enough + fixed.DECREMENT_ROUNDING * lane.magnitude
            balanced = balanced & (absolute(decrement) <= enough)
        at_rest = balanced & (gap <= self.closure_tolerance * rod.total) & ~judged.broken
        if ti.static(self.touches):
            # The residual of a step that updates forces does not say how far gaps are open.
            contacts = self.sweep.contacts
            open_gaps = contacts.gap_change(rod) > rod.contacts.tolerance
            at_rest = at_rest & ~((rod.contacts.update_stiffness > 0.0) & open_gaps)
        least, most = ti.static(fixed.INERTIA_OF_A_MINIMUM - 0.5, fixed.INERTIA_OF_A_MINIMUM + 0.5)
        wrong = ((inertia < least) | (inertia > most)) & judged.stands
        right = (inertia > least) & (inertia < most) & judged.stands
        calm = at_rest & (lane.escaping < 0.5) & judged.stands
        altered = (lane.shift > 0.0) | (lane.coarse > 0.5)
        if ti.static(self.takes_met):
            altered = altered | (rod.contacts.has_met > 0.5)
        # Where rounding limits the residual, the size of the next step bounds the error of the shape.
        resolved = size <= self.shape_tolerance
        doubtful = self.constant(0.0) > 0.5
        if ti.static(self.trace_at_rest > self.trace):
            doubtful = calm & ~altered & wrong & ~was_at_rest
            wrong = wrong & ~doubtful
        at_saddle = calm & ~altered & wrong
        # Beside a saddle a rod may make no progress though its residual is not yet small.
        aimless = wrong & (lane.aimless > fixed.PATIENCE_AT_SADDLE) & (lane.escaping < 0.5) & (lane.closing < 0.5)
        limit = ti.cast(tables.policy[fixed.ESCAPES], self.scalar)
        leaving = (at_saddle & (lane.escapes < limit)) | (aimless & (limit > 0.0) & (lane.strays < fixed.MOST_STRAYS))
        # After a refused step a shifted one comes first: from the same frames the same step would be refused again.
        certify = calm & altered & (lane.rejects < 0.5)
        return record(
            gap=gap, at_rest=at_rest, calm=calm, resolved=resolved, right=right, wrong=wrong, doubtful=doubtful,
            at_minimum=calm & ~altered & right & resolved, at_saddle=at_saddle, leaving=leaving,
            stays=at_saddle & (lane.escapes >= limit), certify=certify)

    def plan(self, tables, rod, lane, judged, place, searching, slope):
        """The next step: whether to take one, how much of it, and under which shift."""
        zero, one = self.constant(0.0), self.constant(1.0)
        choose(lane, place.leaving, escaping=one, shift=zero)
        choose(lane, place.leaving & place.at_saddle, escapes=lane.escapes + 1.0)
        choose(lane, place.leaving & ~place.at_saddle, strays=lane.strays + 1.0)
        if ti.static(not self.touches):  # a step that only closes does not know obstacles: it would carry the rod into them
            far = place.gap > ti.cast(tables.policy[fixed.CLOSING], self.scalar) * rod.longest
            lane.closing = ti.select(far, one, zero)
        lane.rounds = ti.select((lane.escaping > 0.5) & place.right & ~place.leaving, lane.rounds + 1.0, lane.rounds)
        lane.rounds = ti.select(place.leaving, zero, lane.rounds)
        unready = (lane.escaping > 0.5) & (lane.rounds <= fixed.ESCAPE_ROUNDS)
        waits = place.certify | place.leaving | place.wrong | place.doubtful | unready | (lane.closing > 0.5) | judged.uphill
        lane.trying = ti.select(waits, zero, one)
        lane.troubled = ti.select(judged.uphill | (place.wrong & (lane.closing < 0.5)), one, lane.troubled)
        floor = ti.select(lane.escaping > 0.5, fixed.NEGLIGIBLE_TROUBLED * lane.scale, fixed.SHIFT_WRONG_INERTIA * lane.scale)
        if ti.static(not self.itself):  # there long steps cross ties and strands
            # Where the inertia is wrong again and again, as along a soft mode beside a saddle, a shift that is just large
            # enough makes long steps.
            lane.sufficient = ti.select(place.right & (lane.shift > 0.0), lane.shift, lane.sufficient)
            floor = ti.select(lane.sufficient > 0.0, ti.min(floor, fixed.SUFFICIENT * lane.sufficient), floor)
        lane.shift = ti.select(place.wrong & (lane.closing < 0.5), ti.max(fixed.GROWTH * lane.shift, floor), lane.shift)
        lane.shift = ti.select(place.certify, zero, lane.shift)
        if ti.static(self.has_coarse):
            far = (lane.largest_move > fixed.COARSE_ROTATION) & ~place.at_rest & (lane.escaping < 0.5)
            lane.coarse = ti.select(far, one, zero)
        cap = ti.min(one, ti.cast(tables.policy[fixed.ROTATION_LIMIT], self.scalar) / (lane.largest_move + 1e-30))
        if ti.static(self.touches):
            part = (lane.rejects > 0.5) & (lane.rejects < 1.5)
            if ti.static(self.takes_met):
                # With the contacts that the refused step has met, the step is another one.
                part = part & ~(rod.contacts.has_met > 0.5)
                rod.contacts.refused = ti.select(judged.uphill, one, zero)
            cap = ti.select(part, PART * cap, cap)
            if ti.static(self.itself):
                # To and fro across a kink of friction, with like residuals on both sides: ever shorter steps end on it.
                stays = (rod.contacts.largest > 0.0) & (lane.residual < fixed.ALIKE * lane.best)
                across = ti.select(stays, lane.idle_trips - fixed.PATIENCE_AT_KINK, zero)
                cap = cap / (1.0 + ti.max(across, zero))
        lane.heading = ti.select(searching, ti.select(slope > 0.0, 0.0 - one, one), lane.heading)
        tries = 1.0 + lane.rejects
        leap = lane.heading * fixed.ESCAPE_ROTATION / (tries * tries * (lane.largest_move + 1e-30))
        lane.step_scale = ti.select(lane.trying > 0.5, ti.select(lane.escaping > 0.5, leap, cap), zero)

    def end(self, tables, rod, lane, judged, place):
        """Which lanes are finished, and with which status."""
        zero, one = self.constant(0.0), self.constant(1.0)
        better = place.leaving | (lane.closing > 0.5) | ((lane.residual < fixed.BETTER * lane.best) & judged.stands)
        # A trip that only repeats the elimination after a rejected step does not count.
        waited = ti.select(lane.returned > 0.5, zero, one)
        lane.aimless = ti.select(better | judged.notable, zero, lane.aimless + waited)
        lane.idle_trips = ti.select(judged.gained | better, zero, lane.idle_trips + waited)
        lane.best = ti.select(better & judged.stands, ti.min(lane.best, lane.residual), lane.best)
        lane.returned = ti.select(judged.uphill, one, zero)
        fresh = lane.fresh > 0.5
        lane.fresh = zero
        ended = place.at_minimum | place.stays
        out_of_trips = lane.trips >= ti.cast(tables.policy[fixed.ITERATION_LIMIT], self.scalar)
        stuck = lane.idle_trips > self.patience
        lost = judged.broken | ~(lane.residual == lane.residual)
        if ti.static(self.touches):
            stuck = stuck | self.sweep.contacts.jammed(rod)
        lane.status = ti.select(stuck, self.constant(self.stalled), self.constant(self.limit))
        lane.status = ti.select(lost, self.constant(self.not_finite), lane.status)
        # A neutral motion leaves the certificate undecided: converged, not certified.
        undecided = place.at_rest & place.resolved & (out_of_trips | stuck)
        if ti.static(self.touches):
            ready = (lane.trying > 0.5) & (lane.escaping < 0.5) & (lane.largest_move < EARLY_ROTATION) & ~lost
            final = lane.residual * rod.total <= self.tolerance(tables, rod, True)
            updating, done = self.sweep.contacts.plan_update(rod, lane, ready, place.at_minimum & final)
            calm = place.calm & ~place.leaving & ~updating & ~done
            ended, undecided, stuck = ended & ~updating, undecided & ~updating, stuck & ~updating
            goes_on = self.sweep.contacts.end_round(rod, lane, calm, (ended | undecided) & ~done, judged.downhill)
            ended, undecided, stuck = ended & ~goes_on, undecided & ~goes_on, stuck & ~goes_on
            blocked = self.sweep.contacts.blocked(rod, fresh, lane.miss)
            lane.status = ti.select(blocked, self.constant(self.infeasible), lane.status)
            ended, undecided, lost = ended & ~blocked, undecided & ~blocked, lost | blocked
        lane.status = ti.select(ended | undecided, self.constant(self.converged), lane.status)
        # Under forces of contacts that still change, a minimum says nothing.
        lane.stable = ti.select(place.at_minimum & (ended | undecided), one, zero)
        lane.finished = ti.select((ended | out_of_trips | stuck | lost) & (lane.active > 0.5), one, zero)
