"""The loop of a thread of the Newton kernel: rods into its lanes, trips, results out of them (§III-D, docs/chain.md)."""

import taichi as ti

from doo_ti.physics.tuples import choose, dot, record, repeated, scaled
from doo_ti.physics.view import exact, write
from doo_ti.relaxation import newton_policy as fixed
from doo_ti.relaxation import tables as of
from doo_ti.relaxation.elimination import Elimination
from doo_ti.relaxation.loading import LANES, NEXT, TRIPS, Loading
from doo_ti.relaxation.newton_trip import NewtonTrip


@ti.data_oriented
class NewtonLoop(NewtonTrip):
    """The work of a thread, until the queue is empty."""

    def __init__(self, sweep: Elimination, functions=None, has_coarse: bool = False):
        super().__init__(sweep, has_coarse)
        self.width = sweep.number.width
        self.loading = Loading(sweep, functions)

    @ti.func
    def work(self, given, thread):
        """A thread's work with the arrays of its kernel, until the queue is empty."""
        tables = self.sweep.completed(given, thread)
        head = self.sweep.head(tables.scratch, thread, tables.rest_length.shape[1])
        # Rods taken from the queue at a time: with fewer, threads wait for each other at the queue; with more, some end early.
        batch = ti.max(1, ti.min(16, tables.rods.shape[0] // (16 * tables.threads * self.width)))
        lane = self.idle_lanes()
        supply = record(next=0, end=0, batch=batch, places=LANES + thread * self.width)
        pack_trips = 0
        running = 1
        while running == 1:
            if self.exchanges(lane):
                self.exchange(tables, head, lane, supply)
                self.begin(tables, head, lane)
            if self.largest(lane.active) < 0.5:
                running = 0
            else:
                self.advance(tables, head, lane)
                pack_trips += 1
        ti.atomic_add(tables.queue[TRIPS], pack_trips)

    @ti.func
    def exchanges(self, lane):
        """Whether finished lanes are to be exchanged now."""
        return self.largest(lane.finished) > 0.5

    @ti.func
    def exchange(self, tables, head, lane, supply):
        """Store the rods of the finished lanes and load others."""
        for slot in range(self.width):
            if self.lane(lane.finished, slot) > 0.5:
                if self.lane(lane.active, slot) > 0.5:
                    self.store(tables, head, slot, lane, tables.queue[supply.places + slot])
                self.refill(tables, head, slot, lane, supply)

    @ti.func
    def idle_lanes(self):
        """The record of lanes that have no rod yet."""
        zero, one = self.constant(0.0), self.constant(1.0)
        return record(
            energy=zero, magnitude=zero, miss=repeated(zero, 3), multiplier=repeated(zero, 3), residual=zero,
            change=repeated(zero, 3), longest=one, shift=zero, scale=one, step_scale=zero, coarse=zero, fresh=zero,
            trying=zero, closing=zero, returned=zero, troubled=zero, escaping=zero, escapes=zero, rounds=zero,
            heading=one, best=zero, idle_trips=zero, aimless=zero, rejects=zero, trips=zero, status=zero, stable=zero,
            lengths_known=zero, along=zero, begun=zero, arrived=zero, spins_first=zero, strays=zero, active=zero, finished=one)

    @ti.func
    def store(self, tables, head, slot, lane, rod):
        """Results of the rod in lane ``slot``, row ``rod`` of the rods."""
        row, own = tables.rods[rod, of.RESULT_ROW], head.lane(slot)
        self.loading.store_frames(tables, row, own)
        if ti.static(self.touches):
            self.sweep.contacts.unload(tables, slot, row)
            self.sweep.contacts.unload_forces(tables, slot, row, self.loading.force_unit(own))
        status = self.lane(lane.status, slot)
        if status == self.not_finite or status == self.infeasible:
            for k in ti.static(range(of.RESULTS)):
                tables.results[row, k] = ti.math.nan
            if ti.static(self.touches):
                for v, k in ti.ndrange(tables.forces.shape[1], 3):
                    tables.forces[row, v, k] = 0.0
        else:
            unit = exact(own.energy_unit)
            length_unit = exact(own.length_unit)
            total = own.total
            energy = ti.cast(self.lane(lane.energy, slot), ti.f64)
            if ti.static(self.touches):
                # λ²/2κ at a contact is no energy of the rod, and depends on κ.
                energy -= tables.contacts.lane(slot).penalty_kept
            tables.results[row, of.ENERGY] = energy * unit
            tables.results[row, of.RESIDUAL] = self.lane(lane.residual, slot) * total
            for k in ti.static(range(3)):
                force = 0.0 - ti.cast(self.lane(lane.multiplier[k], slot), ti.f64)
                tables.results[row, of.FORCE + k] = force * unit / length_unit
            miss = (self.lane(lane.miss[0], slot), self.lane(lane.miss[1], slot), self.lane(lane.miss[2], slot))
            squares = miss[0] ** 2 + miss[1] ** 2 + miss[2] ** 2
            tables.results[row, of.CLOSURE] = ti.sqrt(squares) / total
            target = exact(own.target)
            along = self.lane(lane.along, slot)
            if along > 0.0:
                along = ti.min(self.lane(lane.begun, slot), self.lane(lane.arrived, slot))
            along *= own.closed
            tables.results[row, of.ALONG] = along / (ti.sqrt(dot(target, target)) + 1e-30)
        if ti.static(self.sweep.moves_start):
            write(tables.results, row, of.DRIFT, values=scaled(exact(own.drift), exact(own.length_unit)))
        tables.results[row, of.ITERATIONS] = self.lane(lane.trips, slot)
        tables.results[row, of.STATUS] = status
        tables.results[row, of.STABLE] = self.lane(lane.stable, slot)

    @ti.func
    def refill(self, tables, head, slot, lane, supply):
        """The next rod of the queue into lane ``slot``, if there is one; ``supply`` are the rods taken from it already."""
        lane.active = self.with_lane(lane.active, slot, 0.0)
        if supply.next == supply.end:
            supply.next = ti.atomic_add(tables.queue[NEXT], supply.batch)
            supply.end = ti.min(supply.next + supply.batch, tables.rods.shape[0])
        if supply.next < supply.end:
            rod = supply.next
            supply.next += 1
            tables.queue[supply.places + slot] = rod
            self.loading.load(tables, head, slot, rod, self.lane(lane.lengths_known, slot))
            lane.lengths_known = self.with_lane(lane.lengths_known, slot, 1.0)
            lane.active = self.with_lane(lane.active, slot, 1.0)

    @ti.func
    def begin(self, tables, head, lane):
        """Initialise the lanes that were refilled."""
        zero, one = self.constant(0.0), self.constant(1.0)
        begun = lane.finished > 0.5
        lane.scale = ti.select(begun, head.scale, lane.scale)
        shift = ti.cast(tables.policy[fixed.FIRST_SHIFT], self.scalar) * lane.scale
        choose(
            lane, begun, shift=shift, fresh=one, best=self.constant(1e30), step_scale=zero, trips=zero, idle_trips=zero,
            aimless=zero, rejects=zero, trying=zero, closing=zero, returned=zero, troubled=zero, escaping=zero,
            escapes=zero, strays=zero, along=self.constant(1e30))
        lane.finished = zero

    @ti.func
    def advance(self, tables, head, lane):
        """The work between two exchanges of rods: a trip."""
        self.trip(tables, head, lane)
