"""The paper's own relaxation scheme (§III-D), for many rods at once: the reference for Newton's basins.

Per iteration: a step down the gradient of E with respect to the vertices, twist angles held; frames follow their tangents
by parallel transport; twist angles are minimised (one Newton round, exact for isotropic rods); vertices are reprojected onto
inextensibility and the clamps by fast projection, a tridiagonal system per round, with the multipliers of the last
projection in the gradient (augmented Lagrangian). The step length is spectral (Barzilai–Borwein), capped to a small
fraction of an edge so that the path stays close to steepest descent, and accepted against a running mean of the energy.
"""

from dataclasses import dataclass
from functools import cache

import taichi as ti

from doo_ti.errors import InputError, require_number, require_whole
from doo_ti.physics.number import Number
from doo_ti.relaxation.columns import (
    CLOSED,
    CLOSURE,
    ENERGY,
    ITERATIONS,
    OF_CLAMP,
    OF_MATERIAL,
    OF_RESULT,
    RELEASED,
    RESIDUAL,
    SPIN_END,
    SPIN_START,
    STABLE,
    STATUS,
    TILT_END,
    TILT_INNER,
    TILT_START,
    TOTAL,
    WEIGHT,
)
from doo_ti.relaxation.loading import LANES, NEXT, stiffness_scale
from doo_ti.relaxation.vertex_chain import DIRECTOR, ITEMS, POSITION, TRIAL_POSITION, vertex_sweeps
from doo_ti.types import Status


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

    def __post_init__(self):
        for name in ("tolerance", "largest_move"):
            require_number("Descent", name, getattr(self, name))
        require_whole("Descent", "max_iterations", self.max_iterations, 1)
        if not self.tolerance > 0:
            raise InputError("Descent", "tolerance", f"{self.tolerance} is not positive", "give a positive number")
        if not 0 < self.largest_move <= 0.2:
            raise InputError("Descent", "largest_move", f"{self.largest_move}", "give a fraction above 0, at most 0.2")


LONG_STEP_EVERY = 12.0
MEMORY = 0.9  # weight of the past in the running mean of the energy
PATIENCE = 20_000  # iterations in which neither energy nor residual came down noticeably


@cache
def descent_kernel(number: Number, stride: int, block: int):
    """The kernel for one kind of number; materials are always general. See :func:`.newton_kernel.newton_kernel`."""
    largest, lane, with_lane, constant, put, get = number.lanes()
    sweep = vertex_sweeps(number, stride)
    width, scalar = number.width, number.scalar
    rounding = 2e-6 if number.bits == 32 else 1e-13
    row = ITEMS * stride
    table2 = ti.types.ndarray(dtype=ti.f64, ndim=2)
    table3 = ti.types.ndarray(dtype=ti.f64, ndim=3)

    @ti.kernel
    def descent(
        vertices: table3,  # [configuration, vertex, 3] mm from the anchor
        directors: table3,  # [configuration, edge, 3] m1
        rest_length: table2,  # [1 or configuration, edge] mm
        clamp: table2,  # [configuration, CLAMP_COLUMNS]
        bend: table3,  # [material, 1 or edge, (11, 22, 12)] mm³
        twist: table2,  # [material, 1 or inner vertex] mm³
        rest: table3,  # [material, 1 or inner vertex, 2] 1/mm
        material: table2,  # [material, STIFFNESS and more columns]
        up0: ti.f64,  # unit vector against gravity
        up1: ti.f64,
        up2: ti.f64,
        rods: ti.types.ndarray(dtype=ti.i32, ndim=2),  # [rod, ROD_COLUMNS]
        tolerance: ti.f64,
        max_iterations: ti.i32,
        largest_move: ti.f64,
        threads: ti.i32,
        origin_stride: ti.i32,
        scratch: ti.types.ndarray(dtype=number.type, ndim=1),
        queue: ti.types.ndarray(dtype=ti.i32, ndim=1),  # [NEXT, TRIPS (unused), LANES + thread · lane] zero
        positions: table3,  # [rod, vertex, 3] out
        material_axes: table3,  # [rod, edge, 3] out: m1
        results: table2,  # [rod, RESULTS] out
    ):
        edges = directors.shape[1]
        ti.loop_config(block_dim=block)
        for thread in range(threads):
            origin = thread * origin_stride
            lane_rod = LANES + thread * width  # where the queue says which rods the lanes have
            zero = constant(0.0)
            one = constant(1.0)
            held_first, held_second, held_inner, held_last, taut = (zero, zero, zero, zero, zero)
            spin_start, spin_end, length, scale, limit_move = (zero, zero, one, one, one)
            gravity0, gravity1, gravity2 = (zero, zero, zero)
            energy, lowest, mean, count, step, residual, best = (zero, zero, zero, zero, zero, zero, one)
            fresh, trips, still, status = (zero, zero, zero, zero)
            short0, short1, short2 = (one, one, one)
            active, finished = (zero, one)
            running = 1
            while running == 1:
                if largest(finished) > 0.5:
                    for slot in range(width):
                        if lane(finished, slot) > 0.5:
                            finished = with_lane(finished, slot, 0.0)
                            if lane(active, slot) > 0.5:
                                place = rods[queue[lane_rod + slot], OF_RESULT]
                                at = origin
                                for v in range(edges + 1):
                                    for k in ti.static(range(3)):
                                        positions[place, v, k] = get(scratch, at + (POSITION + k) * stride, slot)
                                        if v < edges:
                                            material_axes[place, v, k] = get(
                                                scratch, at + (DIRECTOR + k) * stride, slot)
                                    at += row
                                results[place, ENERGY] = lane(energy, slot)
                                results[place, RESIDUAL] = lane(residual, slot)
                                results[place, CLOSURE] = 0.0
                                results[place, ITERATIONS] = lane(trips, slot)
                                results[place, STATUS] = lane(status, slot)
                                results[place, STABLE] = 0.0
                            active = with_lane(active, slot, 0.0)
                            rod = ti.atomic_add(queue[NEXT], 1)
                            if rod < rods.shape[0]:
                                queue[lane_rod + slot] = rod
                                s = rods[rod, OF_CLAMP]
                                g = rods[rod, OF_MATERIAL]
                                longest, shortest = sweep.load_rod(scratch, origin, edges, slot, s, g, vertices, directors,
                                                             rest_length, bend, twist, rest)
                                length = with_lane(length, slot, longest)
                                limit_move = with_lane(limit_move, slot, largest_move * shortest)
                                scale = with_lane(scale, slot, stiffness_scale(material, clamp, g, s) / clamp[s, TOTAL])
                                start_held = ti.max(clamp[s, CLOSED], 1.0 - clamp[s, RELEASED])
                                end_held = ti.max(clamp[s, CLOSED], clamp[s, RELEASED])
                                held_first = with_lane(held_first, slot, start_held)
                                held_second = with_lane(held_second, slot, start_held * (1.0 - clamp[s, TILT_START]))
                                held_inner = with_lane(held_inner, slot, end_held * (1.0 - clamp[s, TILT_END]))
                                held_last = with_lane(held_last, slot, end_held)
                                taut = with_lane(taut, slot, 1.0 - clamp[s, TILT_INNER])
                                spin_start = with_lane(spin_start, slot, clamp[s, SPIN_START])
                                spin_end = with_lane(spin_end, slot, clamp[s, SPIN_END])
                                gravity0 = with_lane(gravity0, slot, material[g, WEIGHT] * up0)
                                gravity1 = with_lane(gravity1, slot, material[g, WEIGHT] * up1)
                                gravity2 = with_lane(gravity2, slot, material[g, WEIGHT] * up2)
                                count = with_lane(count, slot, 0.0)
                                step = with_lane(step, slot, 0.0)
                                residual = with_lane(residual, slot, 1e30)
                                best = with_lane(best, slot, 1e30)
                                lowest = with_lane(lowest, slot, 1e30)
                                fresh = with_lane(fresh, slot, 1.0)
                                short0 = with_lane(short0, slot, 1e30)
                                short1 = with_lane(short1, slot, 1e30)
                                short2 = with_lane(short2, slot, 1e30)
                                trips = with_lane(trips, slot, 0.0)
                                still = with_lane(still, slot, 0.0)
                                active = with_lane(active, slot, 1.0)
                if largest(active) < 0.5:
                    running = 0
                else:
                    held = (held_first, held_second, held_inner, held_last, taut)
                    sweep.move(scratch, origin, edges, step, held)
                    sweep.minimise_twist(scratch, origin, edges, spin_start, spin_end)
                    new_energy, magnitude, spin = sweep.evaluate(
                        scratch, origin, edges, (gravity0, gravity1, gravity2), spin_start, spin_end)
                    sweep.eliminate_lengths(scratch, origin, edges, TRIAL_POSITION, held, True)
                    force = sweep.apply_lengths(scratch, origin, edges, held, True)
                    tolerated = mean + rounding * magnitude
                    sound = new_energy == new_energy
                    accepted = ti.select(sound & ((fresh > 0.5) | (new_energy <= tolerated)), one, zero)
                    ss, sy, yy, top = sweep.adopt(scratch, origin, edges, accepted)
                    # The largest moment is at most the longest edge times the sum of forces: an upper bound, no estimate.
                    bound = (length * force + spin) / scale
                    residual = ti.select(accepted > 0.5, bound, residual)
                    energy = ti.select(accepted > 0.5, new_energy, energy)
                    heavier = MEMORY * count + 1.0
                    mean = ti.select(accepted > 0.5, (MEMORY * count * mean + new_energy) / heavier, mean)
                    count = ti.select(accepted > 0.5, heavier, count)
                    # Barzilai–Borwein: the long step s·s/s·y, or where the gradient is mostly stiff directions the shortest of
                    # the last four short ones s·y/y·y; now and then a long one all the same, to get on in narrow valleys.
                    curved = sy > 0.0
                    shortest_step = ti.min(ti.min(sy / yy, short0), ti.min(short1, short2))
                    phase = trips - LONG_STEP_EVERY * ti.floor(trips / LONG_STEP_EVERY)
                    spectral = ti.select((sy * sy < 0.5 * ss * yy) & (phase > 0.5), shortest_step, ss / sy)
                    store_short = curved & (accepted > 0.5)
                    short2 = ti.select(store_short, short1, short2)
                    short1 = ti.select(store_short, short0, short1)
                    short0 = ti.select(store_short, sy / yy, short0)
                    longer = ti.select(curved, spectral, 2.0 * step)
                    first = 0.05 * limit_move / (top + 1e-30)
                    chosen = ti.select(fresh > 0.5, first, longer)
                    step = ti.select(accepted > 0.5, ti.min(chosen, limit_move / (top + 1e-30)), 0.25 * step)
                    lost = ((fresh > 0.5) & (accepted < 0.5)) | ~(residual == residual)
                    progress = (residual < 0.9 * best) | (energy < lowest - 1e-7 * magnitude)
                    lowest = ti.select(progress, energy, lowest)
                    best = ti.select(progress, ti.min(best, residual), best)
                    still = ti.select(progress, zero, still + 1.0)
                    fresh = zero
                    trips = trips + active
                    ended = residual <= ti.cast(tolerance, scalar)
                    late = trips >= ti.cast(max_iterations, scalar)
                    stuck = still > PATIENCE
                    status = ti.select(stuck, constant(int(Status.STALLED)), constant(int(Status.ITERATION_LIMIT)))
                    status = ti.select(lost, constant(int(Status.NOT_FINITE)), status)
                    status = ti.select(ended, constant(int(Status.CONVERGED)), status)
                    finished = ti.select((ended | late | stuck | lost) & (active > 0.5), one, zero)

    return descent
