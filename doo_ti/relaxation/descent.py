"""The paper's own relaxation scheme (§III-D), for many rods at once: the reference for Newton's basins.

    x ← x − h (g + Jᵀ λ)        g = ∂E/∂x with the twist angles held, λ = −(J Jᵀ)⁻¹ J g the constraints' multipliers
    x ← x − Jᵀ (J Jᵀ)⁻¹ c(x)    fast projection onto fixed edge lengths, twice (:meth:`.VertexChain.eliminate_lengths`)
    Q ← P(Q)                    material frames follow their tangents by parallel transport
    θ ← argmin_θ E              one Newton step, exact for isotropic rods (:meth:`.VertexChain.minimise_twist`)

The step length h is spectral (Barzilai–Borwein), limited to a small fraction of an edge so that the path stays close to
steepest descent, and a step is accepted if the energy does not exceed a running mean of the energies before.
"""

from dataclasses import dataclass
from functools import cache

import taichi as ti

from doo_ti.physics.number import Number, Scratch, device_functions, write
from doo_ti.physics.tuples import choose, picked, put_lane, record, repeated
from doo_ti.relaxation import tables as of
from doo_ti.relaxation.kernel_factory import INDEX1, RODS, TABLE1, TABLE2, TABLE3, loop_kernel
from doo_ti.relaxation.loading import stiffness_scale
from doo_ti.relaxation.newton import QueueLoop
from doo_ti.relaxation.vertex_chain import VERTEX, VertexChain
from doo_ti.rod.types import Status
from doo_ti.system.arguments import typed
from doo_ti.system.errors import InputError, require_whole


@typed
@dataclass(frozen=True)
class Descent:
    """Options of the descent solver.

    tolerance       residual to reach: moment times length over stiffness, without a unit
    max_iterations  gradient steps allowed per rod
    largest_move    largest move of a vertex in one step, over its edge length: smaller follows the path more closely
    """

    tolerance: float = 1e-4
    max_iterations: int = 100_000
    largest_move: float = 0.05

    def __post_init__(self) -> None:
        require_whole("Descent", "max_iterations", self.max_iterations, 1)
        if not self.tolerance > 0:
            raise InputError("Descent", "tolerance", f"{self.tolerance} is not positive", "give a positive number")
        if not 0 < self.largest_move <= 0.2:
            raise InputError("Descent", "largest_move", f"{self.largest_move}", "give a fraction above 0, at most 0.2")


LONG_STEP_EVERY = 12.0
MEMORY = 0.9  # weight of the past in the running mean of the energy
PATIENCE = 20_000  # iterations in which neither energy nor residual came down noticeably


@device_functions
class DescentLoop(QueueLoop):
    """The loop of descent.

    Its functions share three records: ``tables``, the arrays and options that host and kernel share; ``rod``
    (:class:`.VertexChain`); and ``lane``, the state of each lane's rod:

    held, spin, gravity              of ``rod``, for the lane's rod
    length, scale, limit_move        its longest edge, the divisor of its residual, and the largest move of a vertex in one step
    energy, residual                 of the accepted vertices
    mean, count                      running mean of the energy, and the sum of its weights
    lowest, best, still              the lowest energy and residual so far, and iterations without progress
    step, short                      length of the next step, and the last three short steps s·y/y·y
    fresh, trips, active, finished   flags, and iterations made
    """

    def __init__(self, number: Number, stride: int):
        self.sweep, self.memory = VertexChain(number), Scratch(number, stride)
        self.largest, self.lane, self.with_lane, self.constant = number.largest, number.lane, number.with_lane, number.constant
        self.width, self.scalar = number.width, number.scalar
        self.rounding = 2e-6 if number.bits == 32 else 1e-13
        self.converged, self.limit = int(Status.CONVERGED), int(Status.ITERATION_LIMIT)
        self.stalled, self.not_finite = int(Status.STALLED), int(Status.NOT_FINITE)

    @picked
    def items(self, given):
        """As :meth:`.Chain.items`."""
        return given.vertices.shape[1] * VERTEX.size

    def work(self, tables, thread):
        """A thread's work with the arrays of its kernel."""
        self.serve(tables, self.memory.of_thread(tables.scratch, thread, VERTEX, self.items(tables)), thread)

    def idle_lanes(self):
        """The record of lanes that have no rod yet."""
        zero, one = self.constant(0.0), self.constant(1.0)
        return record(
            held=repeated(zero, 5), spin=repeated(zero, 2), gravity=repeated(zero, 3), length=one, scale=one, limit_move=one,
            energy=zero, lowest=zero, mean=zero, count=zero, step=zero, residual=zero, best=one, fresh=zero, trips=zero,
            still=zero, status=zero, short=repeated(one, 3), active=zero, finished=one)

    def begin(self, tables, origin, lane):
        lane.finished = self.constant(0.0)

    def store(self, tables, origin, slot, lane, rod):
        """Results of the rod in lane ``slot``, row ``rod`` of the rods."""
        place = tables.rods[rod, of.RESULT_ROW]
        for e in range(tables.start.shape[1]):
            write(tables.frames, place, e, 0, values=self.sweep.vertex(origin.lane(slot), e).frame)
        tables.results[place, of.ENERGY] = self.lane(lane.energy, slot)
        tables.results[place, of.RESIDUAL] = self.lane(lane.residual, slot)
        tables.results[place, of.CLOSURE] = 0.0
        tables.results[place, of.ITERATIONS] = self.lane(lane.trips, slot)
        tables.results[place, of.STATUS] = self.lane(lane.status, slot)
        tables.results[place, of.STABLE] = 0.0

    def take(self, tables, origin, slot, lane, index):
        """Row ``index`` of the rods into lane ``slot``."""
        s, g = tables.rods[index, of.CLAMP_ROW], tables.rods[index, of.MATERIAL_ROW]
        longest, shortest = self.sweep.load_rod(tables, origin.lane(slot), tables.rods[index, of.RESULT_ROW], s, g)
        start_held = ti.max(tables.clamp[s, of.CLOSED], 1.0 - tables.clamp[s, of.RELEASED])
        end_held = ti.max(tables.clamp[s, of.CLOSED], tables.clamp[s, of.RELEASED])
        held = (
            start_held, start_held * (1.0 - tables.clamp[s, of.TILT_START]), end_held * (1.0 - tables.clamp[s, of.TILT_END]),
            end_held, 1.0 - tables.clamp[s, of.TILT_INNER])
        weight = tables.material[g, of.WEIGHT]
        scale = stiffness_scale(tables.material, tables.clamp, g, s) / tables.clamp[s, of.TOTAL]
        put_lane(
            lane, self.with_lane, slot, held=held, spin=(tables.clamp[s, of.SPIN_START], tables.clamp[s, of.SPIN_END]),
            gravity=(weight * tables.up[0], weight * tables.up[1], weight * tables.up[2]), length=longest, scale=scale,
            limit_move=tables.largest_move * shortest, count=0.0, step=0.0, residual=1e30, best=1e30, lowest=1e30,
            short=(1e30, 1e30, 1e30), fresh=1.0, trips=0.0, still=0.0)

    def advance(self, tables, origin, lane):
        """One step of every lane's rod, and its judgement."""
        rod = record(origin=origin, edges=tables.start.shape[1], held=lane.held, spin=lane.spin, gravity=lane.gravity)
        self.sweep.move(rod, lane.step)
        self.sweep.minimise_twist(rod)
        found = self.sweep.evaluate(rod)
        self.sweep.eliminate_lengths(rod, True)
        force = self.sweep.apply_lengths(rod, True)
        downhill = (lane.fresh > 0.5) | (found.energy <= lane.mean + self.rounding * found.magnitude)
        finite = found.energy == found.energy
        accepted = ti.select(finite & downhill, self.constant(1.0), self.constant(0.0))
        change = self.sweep.adopt(rod, accepted)
        # The largest moment is at most the longest edge times the sum of forces: an upper bound, no estimate.
        bound = (lane.length * force + found.spin) / lane.scale
        taken = accepted > 0.5
        heavier = MEMORY * lane.count + 1.0
        mean = (MEMORY * lane.count * lane.mean + found.energy) / heavier
        choose(lane, taken, residual=bound, energy=found.energy, mean=mean, count=heavier)
        self.plan(lane, change, taken)
        self.end(tables, lane, found.magnitude, accepted)

    def plan(self, lane, change, taken):
        """Length of the next step, by Barzilai and Borwein: the long step s·s/s·y, or where the gradient is mostly stiff
        directions the shortest of the last four short ones s·y/y·y; but every twelfth step is a long one, for narrow
        valleys."""
        short = change.sy / change.yy
        curved = change.sy > 0.0
        shortest = ti.min(ti.min(short, lane.short[0]), ti.min(lane.short[1], lane.short[2]))
        phase = lane.trips - LONG_STEP_EVERY * ti.floor(lane.trips / LONG_STEP_EVERY)
        stiff = change.sy * change.sy < 0.5 * change.ss * change.yy
        spectral = ti.select(stiff & (phase > 0.5), shortest, change.ss / change.sy)
        choose(lane, curved & taken, short=(short, lane.short[0], lane.short[1]))
        longer = ti.select(curved, spectral, 2.0 * lane.step)
        first = 0.05 * lane.limit_move / (change.top + 1e-30)
        wanted = ti.select(lane.fresh > 0.5, first, longer)
        lane.step = ti.select(taken, ti.min(wanted, lane.limit_move / (change.top + 1e-30)), 0.25 * lane.step)

    def end(self, tables, lane, magnitude, accepted):
        """Which lanes are finished, and with which status."""
        zero, one = self.constant(0.0), self.constant(1.0)
        lost = ((lane.fresh > 0.5) & (accepted < 0.5)) | ~(lane.residual == lane.residual)
        progress = (lane.residual < 0.9 * lane.best) | (lane.energy < lane.lowest - 1e-7 * magnitude)
        choose(lane, progress, lowest=lane.energy, best=ti.min(lane.best, lane.residual))
        lane.still = ti.select(progress, zero, lane.still + 1.0)
        lane.fresh = zero
        lane.trips = lane.trips + lane.active
        ended = lane.residual <= ti.cast(tables.tolerance, self.scalar)
        out_of_trips = lane.trips >= ti.cast(tables.max_iterations, self.scalar)
        stuck = lane.still > PATIENCE
        lane.status = ti.select(stuck, self.constant(self.stalled), self.constant(self.limit))
        lane.status = ti.select(lost, self.constant(self.not_finite), lane.status)
        lane.status = ti.select(ended, self.constant(self.converged), lane.status)
        lane.finished = ti.select((ended | out_of_trips | stuck | lost) & (lane.active > 0.5), one, zero)


ARGUMENTS = RODS | {
    "vertices": TABLE3,  # [row, vertex, 3] mm from the anchor
    "start": TABLE3,  # [row, edge, 4] frames
    "up": TABLE1,  # [3] unit vector against gravity
    "tolerance": ti.f64, "max_iterations": ti.i32, "largest_move": ti.f64,
    "queue": INDEX1,  # [NEXT, TRIPS, LANES + thread · lane] zero
    "frames": TABLE3,  # [rod, edge, 4] out
    "results": TABLE2,  # [rod, RESULTS] out
}


@cache
def descent_kernel(number: Number, stride: int, block: int):
    """As :func:`.newton.newton_kernel`, for materials of any kind."""
    return loop_kernel("descent", number, ARGUMENTS, DescentLoop(number, stride), block)
