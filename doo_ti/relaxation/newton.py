"""Newton's method on the chain of frames for all rods at once: its loop, its options and its kernels (§III-D, docs/chain.md).

A trip through the kernel's loop gives every lane one step and one factorisation. A lane whose rod is finished stores it and
takes the next from a queue, so that all lanes stay busy. The result of a rod does not depend on the others: it is the same
alone and in any batch, in any place.
"""

from dataclasses import dataclass
from functools import cache

import taichi as ti

from doo_ti.contact.touch import require_gap_tolerance
from doo_ti.physics.number import Number, device_functions, in_f64, write
from doo_ti.physics.tuples import choose, dot, record, repeated, scaled
from doo_ti.relaxation import newton_policy as fixed
from doo_ti.relaxation import tables as of
from doo_ti.relaxation.contacts import RodContacts
from doo_ti.relaxation.dense_elimination import DenseElimination
from doo_ti.relaxation.elimination import Elimination
from doo_ti.relaxation.kernel_factory import FIELD, INDEX1, RODS, TABLE1, TABLE2, TABLE3, TABLE4, loop_kernel
from doo_ti.relaxation.loaded_elimination import LoadedElimination
from doo_ti.relaxation.loading import LANES, NEXT, TRIPS, Loading
from doo_ti.relaxation.newton_trip import NewtonTrip
from doo_ti.relaxation.self_contacts import SelfContacts
from doo_ti.system.arguments import typed
from doo_ti.system.errors import InputError, require_whole


@device_functions
class QueueLoop:
    """The work of a thread with a pack of rods, until the queue is empty. A class that derives from it has ``idle_lanes``,
    ``store``, ``take``, which loads a rod, ``begin``, which clears ``finished``, and ``advance``."""

    def serve(self, tables, head, thread):
        """All rods that the thread gets."""
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

    def exchanges(self, lane):
        """Whether finished lanes are to be exchanged now."""
        return self.largest(lane.finished) > 0.5

    def exchange(self, tables, head, lane, supply):
        """Store the rods of the finished lanes and load others."""
        for slot in range(self.width):
            if self.lane(lane.finished, slot) > 0.5:
                if self.lane(lane.active, slot) > 0.5:
                    self.store(tables, head, slot, lane, tables.queue[supply.places + slot])
                self.refill(tables, head, slot, lane, supply)

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
            self.take(tables, head, slot, lane, rod)
            lane.active = self.with_lane(lane.active, slot, 1.0)


@device_functions
class NewtonLoop(QueueLoop, NewtonTrip):
    """The loop of Newton's method."""

    def __init__(self, sweep: Elimination):
        NewtonTrip.__init__(self, sweep)
        self.width, self.items = sweep.number.width, sweep.items
        self.loading = Loading(sweep)

    def work(self, given, thread):
        """A thread's work with the arrays of its kernel."""
        tables = self.sweep.completed(given, thread)
        self.serve(tables, self.sweep.head(tables.scratch, thread, tables.rest_length.shape[1]), thread)

    def idle_lanes(self):
        """The record of lanes that have no rod yet."""
        zero, one = self.constant(0.0), self.constant(1.0)
        return record(
            energy=zero, magnitude=zero, miss=repeated(zero, 3), multiplier=repeated(zero, 3), residual=zero,
            change=repeated(zero, 3), largest_move=one, shift=zero, scale=one, step_scale=zero, coarse=zero, fresh=zero,
            trying=zero, closing=zero, returned=zero, troubled=zero, escaping=zero, escapes=zero, rounds=zero,
            heading=one, best=zero, sufficient=zero, idle_trips=zero, aimless=zero, rejects=zero, trips=zero, status=zero,
            stable=zero, lengths_known=zero, along=zero, begun=zero, arrived=zero, spins_first=zero, strays=zero, active=zero,
            finished=one)

    def store(self, tables, head, slot, lane, rod):
        """Results of the rod in lane ``slot``, row ``rod`` of the rods."""
        row, own, edges = tables.rods[rod, of.RESULT_ROW], head.lane(slot), tables.rest_length.shape[1]
        for e in range(edges):
            write(tables.frames, (row * edges + e) * 4, values=self.sweep.edge(own, e).frame)
        if ti.static(self.touches):
            self.sweep.contacts.unload(tables, slot, row)
            self.sweep.contacts.unload_forces(tables, slot, row, self.loading.force_unit(own))
        status = self.lane(lane.status, slot)
        if status == self.not_finite or status == self.infeasible:
            write(tables.results, row, 0, values=repeated(ti.math.nan, of.RESULTS))
            if ti.static(self.touches):
                for v, k in ti.ndrange(tables.forces.shape[1], 3):
                    tables.forces[row, v, k] = 0.0
        else:
            unit = in_f64(own.energy_unit)
            length_unit = in_f64(own.length_unit)
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
            tables.results[row, of.CLOSURE] = ti.sqrt(dot(miss, miss)) / total
            target = in_f64(own.target)
            along = self.lane(lane.along, slot)
            if along > 0.0:
                along = ti.min(self.lane(lane.begun, slot), self.lane(lane.arrived, slot))
            along *= own.closed
            tables.results[row, of.ALONG] = along / (ti.sqrt(dot(target, target)) + 1e-30)
        if ti.static(self.sweep.has_border):
            write(tables.results, row, of.DRIFT, values=scaled(in_f64(own.drift), in_f64(own.length_unit)))
        tables.results[row, of.ITERATIONS] = self.lane(lane.trips, slot)
        tables.results[row, of.STATUS] = status
        tables.results[row, of.STABLE] = self.lane(lane.stable, slot)

    def take(self, tables, head, slot, lane, rod):
        """Row ``rod`` of the rods into lane ``slot``."""
        self.loading.load(tables, head, slot, rod, self.lane(lane.lengths_known, slot))
        lane.lengths_known = self.with_lane(lane.lengths_known, slot, 1.0)

    def begin(self, tables, head, lane):
        """Initialise the lanes that were refilled."""
        zero, one = self.constant(0.0), self.constant(1.0)
        begun = lane.finished > 0.5
        lane.scale = ti.select(begun, head.scale, lane.scale)
        shift = ti.cast(tables.policy[fixed.FIRST_SHIFT], self.scalar) * lane.scale
        choose(
            lane, begun, shift=shift, fresh=one, best=self.constant(1e30), step_scale=zero, trips=zero, sufficient=zero,
            idle_trips=zero, aimless=zero, rejects=zero, trying=zero, closing=zero, returned=zero, troubled=zero, escaping=zero,
            escapes=zero, strays=zero, along=self.constant(1e30))
        lane.finished = zero

    def advance(self, tables, head, lane):
        """The work between two exchanges of rods: a trip."""
        self.trip(tables, head, lane)


MOST_IN_CONTACT = 1000
"""Iterations allowed per rod where no solver is given and rods may touch something: on a slope they slide far."""


@typed
@dataclass(frozen=True)
class Newton:
    """Options of the Newton solver.

    tolerance       residual to reach: moment times length over stiffness, without a unit; None: TOLERANCES
    max_iterations  factorisations allowed per rod
    first_shift     shift δ of the first factorisation over the largest diagonal entry of H. Zero follows the path of
                    descent more closely and takes more iterations (``careful``).
    max_rotation    largest turn of any edge in one step, rad; in contact also the largest share of a gap, and of the way to the
                    middle of an obstacle, that a step may take
    max_escapes     how often a rod may leave a saddle it has converged to; then it has converged there, not stable
    gap_tolerance   of a rod's radius: how far the gap at a contact may be off; in f32 at least 2e-6 of the length. A smaller
                    value makes the forces of single contacts more exact, above all those of stiff rods with short edges.
                    None: 1e-5, and 2e-4 for rods that may touch themselves or each other
    """

    tolerance: float | None = None
    max_iterations: int = 300
    first_shift: float = 0.05
    max_rotation: float = 0.6
    max_escapes: int = 3
    gap_tolerance: float | None = None

    def __post_init__(self) -> None:
        if self.tolerance is not None and not self.tolerance > 0:
            raise InputError("Newton", "tolerance", f"{self.tolerance} is not positive", "give a positive number")
        for name, least in (("max_iterations", 1), ("max_escapes", 0)):
            require_whole("Newton", name, getattr(self, name), least)
        if not 0 < self.max_rotation <= 1:
            raise InputError("Newton", "max_rotation", f"{self.max_rotation}", "give radians above 0, at most 1")
        if self.gap_tolerance is not None:
            require_gap_tolerance("Newton", self.gap_tolerance)
        if not 0 <= self.first_shift < float("inf"):
            raise InputError("Newton", "first_shift", f"{self.first_shift}", "give a finite number from zero up")

    @classmethod
    def careful(cls, tolerance: float | None = None, max_iterations: int = 300) -> "Newton":
        """The options that stay closest to descent: use them where the basin matters (ribbons)."""
        return cls(tolerance, max_iterations, first_shift=0.0)


class DenseLoadedElimination(DenseElimination, LoadedElimination):
    """The Newton system of rods that may touch themselves."""


TOLERANCES = {32: 9.9e-5, 64: 9.9e-8}
"""The residual that counts as converged, by bits: of a rod of 99 mm a moment over stiffness of 1e-6 and 1e-9 1/mm."""


# What kernels are given.
NEWTON = RODS | {
    "start": TABLE1,  # [start · edge · 4]
    "policy": TABLE1,  # [POLICY_COLUMNS] of :mod:`doo_ti.relaxation.newton_policy`
    "queue": INDEX1,  # [NEXT, TRIPS, LANES + thread · lane] zero
    "frames": TABLE1,  # [row · edge · 4] in where a rod starts from there, and out
    "results": TABLE2,  # [row, RESULTS] out
}
EXTERNAL = {
    "numbers": TABLE3,  # of the external energy
    "field": FIELD,  # what it looks up in space
}
OBSTACLES = {
    "obstacles": TABLE3,  # [1 or row, obstacle, OBSTACLE_COLUMNS]
    "kinds": INDEX1,  # [obstacle] and, of a grid, its number
    "grids": TABLE1,  # of the grids, see :func:`doo_ti.contact.distance_grid.grid_table`
    "radius": TABLE1,  # [1 or row] mm
    "tolerance": ti.f64,  # of gaps, over the radius
    "memory": TABLE4,  # [row, vertex, obstacle, REMEMBERED] in and out
    "forces": TABLE3,  # [row, vertex, 3] out
    "self_friction": TABLE1,  # [1 or row] coefficient of the rod on itself
}


@cache
def newton_kernel(number: Number, stride: int, block: int, isotropic: bool, external: type | None, any_ends: bool,
                  contact: tuple[bool, bool] | None):
    """The kernel, compiled on first use, for one kind of number, of material and of external energy.

    stride: distance between the numbers of a thread in scratch, 1 on a CPU, at least the number of threads on a GPU.
    block: see :func:`.loop_kernel`.
    external: the class of the external energy, whose numbers and field the kernel then takes as two more arrays.
    any_ends: some rods under the external energy have vertex 0 free or the far end held. Without these the kernel is smaller
        and faster.
    contact: of rods that may touch something, under an external energy and with any ends, whether there are grids and whether
        they may touch themselves.
    """
    if contact is not None:
        has_grid, itself = contact
        contacts = SelfContacts(number, has_grid) if itself else RodContacts(number, has_grid, takes_met=True)
        sweep = (DenseLoadedElimination if itself else LoadedElimination)(number, isotropic, stride, external, True, contacts)
        return loop_kernel("newton_in_contact", number, NEWTON | EXTERNAL | OBSTACLES, NewtonLoop(sweep), block, brief=True)
    if external is None:
        return loop_kernel("newton", number, NEWTON, NewtonLoop(Elimination(number, isotropic, stride)), block)
    sweep = LoadedElimination(number, isotropic, stride, external, any_ends)
    return loop_kernel("newton_under_load", number, NEWTON | EXTERNAL, NewtonLoop(sweep), block)
