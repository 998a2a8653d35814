"""The kernel that relaxes all rods by Newton's method on the chain of frames (§III-D).

A trip through its loop gives every lane one step and one factorisation. A lane whose rod is done stores it and takes the next
from a queue, so that all lanes stay busy whatever the rods need. What a rod does depends on nothing but itself: the result is
the same alone and in any batch, in any place.
"""

from functools import cache

import taichi as ti

from doo_ti.physics.algebra import dot
from doo_ti.physics.number import Number
from doo_ti.relaxation import chain, loaded_chain
from doo_ti.relaxation.columns import CLOSURE, ENERGY, FORCE, ITERATIONS, OF_RESULT, RESIDUAL, RESULTS, STABLE, STATUS
from doo_ti.relaxation.loading import (
    ASKED_ANCHOR,
    ASKED_CLOSED,
    ASKED_FREE,
    ASKED_GRAVITY,
    ASKED_ITEMS,
    ASKED_LONGEST,
    ASKED_RELEASED,
    ASKED_SCALE,
    ASKED_STIFFNESS,
    ASKED_TARGET,
    ASKED_TOTAL,
    ASKED_UNIT,
    LANES,
    NEXT,
    TRIPS,
    lane_loading,
)
from doo_ti.relaxation.newton import (
    COARSE_ROTATION,
    DECAY,
    DECAY_TROUBLED,
    ESCAPE_ROTATION,
    ESCAPE_ROUNDS,
    NEGLIGIBLE,
    NEGLIGIBLE_TROUBLED,
    NOTABLE,
    PATIENCE,
    PATIENCE_32,
    PATIENCE_AT_SADDLE,
    SHIFT_REJECTED,
    SHIFT_WRONG_INERTIA,
)
from doo_ti.types import Status


@cache
def newton_kernel(number: Number, isotropic: bool, stride: int, block: int, serial: bool, external: type | None = None):
    """The compiled-on-first-use kernel for one kind of number, of material and of external energy.

    stride: distance between the items of an edge in scratch, 1 on a CPU, the number of threads on a GPU.
    block: threads in a block, 1 on a CPU.
    serial: the threads' work is done on the caller's thread, on a CPU: to wake another takes as long as to relax a few rods.
    external: the class of the external energy, whose numbers the kernel then takes as one more table.
    """
    outside = None
    if external is None:
        sweep = chain.chain_sweeps(number, isotropic, stride)
        eliminate = loaded_chain.unloaded(sweep.eliminate)
        has_coarse = False
    else:
        outside = external.functions(number, stride, chain.item_count(isotropic))
        sweep = loaded_chain.loaded_sweeps(number, isotropic, stride, external, outside)
        eliminate, has_coarse = sweep.eliminate, external.has_coarse
    loading = lane_loading(number, isotropic, stride, sweep.items, outside)
    largest, lane, with_lane, constant, put, get = number.lanes()
    width = number.width
    scalar = number.scalar
    rounding = 2e-6 if number.bits == 32 else 1e-10
    patience = PATIENCE_32 if number.bits == 32 else PATIENCE
    closure_tolerance = 1e-7 if number.bits == 32 else 1e-12
    # Neutral motions, a weightless bow about its chord, have an eigenvalue that is rounding of either sign: a trace of H's
    # scale on the diagonal lets them pass, always. f32 cannot tell them from soft saddles and leaves them to f64.
    trace = 0.0 if number.bits == 32 else 1e-12
    converged, limit = int(Status.CONVERGED), int(Status.ITERATION_LIMIT)
    stalled, not_finite = int(Status.STALLED), int(Status.NOT_FINITE)
    table1 = ti.types.ndarray(dtype=ti.f64, ndim=1)
    table2 = ti.types.ndarray(dtype=ti.f64, ndim=2)
    table3 = ti.types.ndarray(dtype=ti.f64, ndim=3)
    index1 = ti.types.ndarray(dtype=ti.i32, ndim=1)
    index2 = ti.types.ndarray(dtype=ti.i32, ndim=2)

    @ti.func
    def relax_rods(
        start: ti.template(), rest_length: ti.template(), clamp: ti.template(), material: ti.template(), up,
        rods: ti.template(), tolerance, max_iterations, first_shift, max_rotation, max_escapes, closing_distance, threads,
        thread, scratch: ti.template(), queue: ti.template(), frames: ti.template(), results: ti.template(),
        outer: ti.template(), field: ti.template(),
    ):
        """A thread's work, until the queue is empty; ``outer`` and ``field`` are the external energy's, if there is one."""
        edges = rest_length.shape[1]
        head = thread
        if ti.static(stride == 1):
            head = thread * (ASKED_ITEMS + sweep.items * edges)
        origin = head + ti.static(ASKED_ITEMS * stride)
        lane_rod = LANES + thread * width  # where the queue says which rods the lanes have
        # Rods taken at once from the queue: threads that ask for the same number wait for each other, but all are to end
        # together.
        handful = ti.max(1, ti.min(16, rods.shape[0] // (16 * threads * width)))
        zero = constant(0.0)
        one = constant(1.0)
        # Where the lane's rod is, and the step that is about to be tried.
        energy, magnitude = (zero, zero)
        miss0, miss1, miss2 = (zero, zero, zero)
        lambda0, lambda1, lambda2 = (zero, zero, zero)
        change0, change1, change2 = (zero, zero, zero)
        shift, scale, step_scale = (zero, one, zero)
        residual, longest, best, idle_trips, aimless, trips, rejects = (zero, one, zero, zero, zero, zero, zero)
        fresh, trying, closing, returned, troubled = (zero, zero, zero, zero, zero)
        escaping, escapes, rounds, heading = (zero, zero, zero, one)
        status, stable = (zero, zero)
        coarse = zero
        lengths_known, active, finished = (zero, zero, one)
        pack_trips = 0
        taken_up, claimed = (0, 0)  # rods of the queue that are this thread's
        running = 1
        while running == 1:
            if largest(finished) > 0.5:
                for slot in range(width):
                    if lane(finished, slot) > 0.5:
                        if lane(active, slot) > 0.5:
                            row = rods[queue[lane_rod + slot], OF_RESULT]
                            loading.store_frames(scratch, origin, edges, slot, frames, row)
                            if lane(status, slot) == not_finite:
                                for k in ti.static(range(RESULTS)):
                                    results[row, k] = ti.math.nan
                            else:
                                unit = ti.cast(get(scratch, head + ASKED_UNIT * stride, slot), ti.f64)
                                results[row, ENERGY] = ti.cast(lane(energy, slot), ti.f64) * unit
                                results[row, RESIDUAL] = lane(residual, slot)
                                results[row, FORCE] = 0.0 - ti.cast(lane(lambda0, slot), ti.f64) * unit
                                results[row, FORCE + 1] = 0.0 - ti.cast(lane(lambda1, slot), ti.f64) * unit
                                results[row, FORCE + 2] = 0.0 - ti.cast(lane(lambda2, slot), ti.f64) * unit
                                squares = lane(miss0, slot) ** 2 + lane(miss1, slot) ** 2 + lane(miss2, slot) ** 2
                                results[row, CLOSURE] = ti.sqrt(squares) / get(scratch, head + ASKED_TOTAL * stride, slot)
                            results[row, ITERATIONS] = lane(trips, slot)
                            results[row, STATUS] = lane(status, slot)
                            results[row, STABLE] = lane(stable, slot)
                        active = with_lane(active, slot, 0.0)
                        if taken_up == claimed:
                            taken_up = ti.atomic_add(queue[NEXT], handful)
                            claimed = ti.min(taken_up + handful, rods.shape[0])
                        if taken_up < claimed:
                            rod = taken_up
                            taken_up += 1
                            queue[lane_rod + slot] = rod
                            loading.load(
                                scratch, head, edges, slot, rod, lane(lengths_known, slot), up, rods, start, frames,
                                rest_length, clamp, material, outer)
                            lengths_known = with_lane(lengths_known, slot, 1.0)
                            active = with_lane(active, slot, 1.0)
                # The lanes that were refilled start anew.
                begun = finished > 0.5
                scale = ti.select(begun, scratch[head + ASKED_SCALE * stride], scale)
                fresh = ti.select(begun, one, fresh)
                best = ti.select(begun, constant(1e30), best)
                shift = ti.select(begun, ti.cast(first_shift, scalar) * scale, shift)
                step_scale = ti.select(begun, zero, step_scale)
                trips = ti.select(begun, zero, trips)
                idle_trips = ti.select(begun, zero, idle_trips)
                aimless = ti.select(begun, zero, aimless)
                rejects = ti.select(begun, zero, rejects)
                trying = ti.select(begun, zero, trying)
                closing = ti.select(begun, zero, closing)
                returned = ti.select(begun, zero, returned)
                troubled = ti.select(begun, zero, troubled)
                escaping = ti.select(begun, zero, escaping)
                escapes = ti.select(begun, zero, escapes)
                finished = zero
            if largest(active) < 0.5:
                running = 0
            else:
                target = sweep.load3(scratch, head + ASKED_TARGET * stride)
                closed = scratch[head + ASKED_CLOSED * stride]
                free = sweep.load4(scratch, head + ASKED_FREE * stride) + (scratch[head + (ASKED_FREE + 4) * stride],)
                released = scratch[head + ASKED_RELEASED * stride]
                total = scratch[head + ASKED_TOTAL * stride]
                stiffness = (scratch[head + ASKED_STIFFNESS * stride], scratch[head + (ASKED_STIFFNESS + 1) * stride])
                gravity = sweep.load3(scratch, head + ASKED_GRAVITY * stride)
                anchor = sweep.load3(scratch, head + ASKED_ANCHOR * stride)
                # Take the step, hopefully: the shift is that for after it.
                moving = ti.max(trying, ti.max(fresh, closing))
                x, normal = sweep.step(scratch, origin, edges, step_scale, moving, target, closed, free)
                decay = ti.select(troubled > 0.5, constant(DECAY_TROUBLED), constant(DECAY))
                negligible = ti.select(troubled > 0.5, constant(NEGLIGIBLE_TROUBLED), constant(NEGLIGIBLE)) * scale
                smaller = ti.select(decay * shift > negligible, decay * shift, zero)
                hoped = ti.select(trying > 0.5, smaller, shift)
                # Off a saddle: once with noise, then on what came of it.
                searching = (escaping > 0.5) & (trying < 0.5)
                noise = ti.select(searching & (rounds < 0.5), 1e-3 * scale, zero)
                echo = ti.select(searching & (rounds > 0.5), scale / (longest + 1e-30), zero)
                new_energy, new_magnitude, new_miss, new_lambda = sweep.close(
                    scratch, origin, edges, x, normal, target, stiffness, gravity, closed, free, total, released)
                diagonal = ti.select(hoped > 0.0, hoped, trace * scale)
                if ti.static(has_coarse):
                    coarse = ti.max(coarse, fresh)
                moment, new_scale, change, inertia, slope, outer_energy, outer_magnitude = eliminate(
                    scratch, origin, edges, diagonal, noise, echo, new_lambda, new_miss, stiffness, gravity, closed, free,
                    total, released, anchor, outer, field, coarse)
                new_energy += outer_energy
                new_magnitude += outer_magnitude
                # Judge the step by the Lagrangian, and go back where it led uphill.
                multiplier = (lambda0 + change0, lambda1 + change1, lambda2 + change2)
                before = energy + dot(multiplier, (miss0, miss1, miss2))
                after = new_energy + dot(multiplier, new_miss)
                noise_level = rounding * magnitude
                finite = new_energy == new_energy
                downhill = (trying > 0.5) & (after <= before + noise_level)
                taken = ti.select(((trying < 0.5) & finite) | downhill, one, zero)
                uphill = (trying > 0.5) & (taken < 0.5)
                gained = (after < before - noise_level) & downhill
                notable = (after < before - NOTABLE * magnitude) & downhill
                if largest(ti.select(uphill, one, zero)) > 0.5:
                    sweep.restore(scratch, origin, edges, ti.select(uphill, one, zero))
                longest = sweep.substitute(scratch, origin, edges, change)
                stands = taken > 0.5
                energy = ti.select(stands, new_energy, energy)
                magnitude = ti.select(stands, new_magnitude, magnitude)
                miss0 = ti.select(stands, new_miss[0], miss0)
                miss1 = ti.select(stands, new_miss[1], miss1)
                miss2 = ti.select(stands, new_miss[2], miss2)
                lambda0 = ti.select(stands, new_lambda[0], lambda0)
                lambda1 = ti.select(stands, new_lambda[1], lambda1)
                lambda2 = ti.select(stands, new_lambda[2], lambda2)
                scale = ti.select(stands, new_scale, scale)
                residual = ti.select(stands, moment, residual)
                change0, change1, change2 = change
                shift = ti.select(stands, hoped, shift)
                stiffer = uphill & (escaping < 0.5)
                shift = ti.select(stiffer, ti.max(4.0 * shift, SHIFT_REJECTED * scale), shift)
                rejects = ti.select(downhill, zero, rejects + ti.select(uphill, one, zero))
                escaping = ti.select(downhill, zero, escaping)
                broken = (fresh > 0.5) & ~stands
                trips = trips + active
                # Judge where the rod is; what was eliminated tells nothing of frames gone back to.
                gap = ti.sqrt(dot((miss0, miss1, miss2), (miss0, miss1, miss2)))
                small = (residual <= ti.cast(tolerance, scalar)) & (gap <= closure_tolerance * total) & ~broken
                right = (inertia > 2.5) & (inertia < 3.5) & stands
                wrong = ((inertia < 2.5) | (inertia > 3.5)) & stands
                calm = small & (escaping < 0.5) & stands
                bare = (shift <= 0.0) & (coarse < 0.5)
                at_minimum = calm & bare & right
                at_saddle = calm & bare & wrong
                # Beside a saddle a rod may get nowhere though its residual is not yet small.
                adrift = wrong & (aimless > PATIENCE_AT_SADDLE) & (escaping < 0.5) & (closing < 0.5)
                leaving = (at_saddle & (escapes < ti.cast(max_escapes, scalar))) | (adrift & (max_escapes > 0))
                resting = at_saddle & (escapes >= ti.cast(max_escapes, scalar))
                certify = calm & ((shift > 0.0) | (coarse > 0.5))
                escaping = ti.select(leaving, one, escaping)
                shift = ti.select(leaving, zero, shift)
                escapes = ti.select(leaving & at_saddle, escapes + 1.0, escapes)
                closing = ti.select(gap > ti.cast(closing_distance, scalar) * scratch[head + ASKED_LONGEST * stride], one, zero)
                rounds = ti.select((escaping > 0.5) & right & ~leaving, rounds + 1.0, rounds)
                rounds = ti.select(leaving, zero, rounds)
                unready = (escaping > 0.5) & (rounds <= ESCAPE_ROUNDS)
                held = certify | leaving | wrong | unready | (closing > 0.5) | uphill
                trying = ti.select(held, zero, one)
                troubled = ti.select(uphill | (wrong & (closing < 0.5)), one, troubled)
                floor = ti.select(escaping > 0.5, NEGLIGIBLE_TROUBLED * scale, SHIFT_WRONG_INERTIA * scale)
                shift = ti.select(wrong & (closing < 0.5), ti.max(4.0 * shift, floor), shift)
                shift = ti.select(certify, zero, shift)
                if ti.static(has_coarse):
                    far = (longest > COARSE_ROTATION) & ~small & (escaping < 0.5)
                    coarse = ti.select(far, one, zero)
                cap = ti.min(one, ti.cast(max_rotation, scalar) / (longest + 1e-30))
                heading = ti.select(searching, ti.select(slope > 0.0, 0.0 - one, one), heading)
                leap = heading * ESCAPE_ROTATION / ((1.0 + rejects) * (1.0 + rejects) * (longest + 1e-30))
                step_scale = ti.select(trying > 0.5, ti.select(escaping > 0.5, leap, cap), zero)
                better = leaving | (closing > 0.5) | ((residual < 0.7 * best) & stands)
                progress = gained | better
                # A trip that only eliminates again after going back is no sign of getting nowhere.
                waited = ti.select(returned > 0.5, zero, one)
                aimless = ti.select(better | notable, zero, aimless + waited)
                idle_trips = ti.select(progress, zero, idle_trips + waited)
                best = ti.select(better & stands, ti.min(best, residual), best)
                returned = ti.select(uphill, one, zero)
                fresh = zero
                # Who is done, and how.
                ended = at_minimum | resting
                late = trips >= ti.cast(max_iterations, scalar)
                stuck = idle_trips > patience
                lost = broken | ~(residual == residual)
                status = ti.select(stuck, constant(stalled), constant(limit))
                status = ti.select(lost, constant(not_finite), status)
                # At rest, though a neutral motion leaves the certificate undecided: converged, not certified.
                at_rest = small & (late | stuck)
                status = ti.select(ended | at_rest, constant(converged), status)
                stable = ti.select(at_minimum, one, zero)
                finished = ti.select((ended | late | stuck | lost) & (active > 0.5), one, zero)
                pack_trips += 1
        ti.atomic_add(queue[TRIPS], pack_trips)

    @ti.kernel
    def newton(
        start: table1,  # [start · edge · 4]
        rest_length: table2,  # [1 or configuration, edge] mm
        clamp: table2,  # [configuration, CLAMP_COLUMNS]
        material: table2,  # [material, STIFFNESS + 1 or edge · STIFFNESS_COLUMNS]
        up0: ti.f64,  # unit vector against gravity
        up1: ti.f64,
        up2: ti.f64,
        rods: index2,  # [rod, ROD_COLUMNS]
        tolerance: ti.f64,
        max_iterations: ti.i32,
        first_shift: ti.f64,
        max_rotation: ti.f64,
        max_escapes: ti.i32,
        closing_distance: ti.f64,
        threads: ti.i32,
        scratch: ti.types.ndarray(dtype=number.type, ndim=1),
        queue: index1,  # [NEXT, TRIPS, LANES + thread · lane] zero
        frames: table1,  # [row · edge · 4] in where a rod starts from there, and out
        results: table2,  # [row, RESULTS] out
    ):
        ti.loop_config(block_dim=block, serialize=serial)
        for thread in range(threads):
            relax_rods(
                start, rest_length, clamp, material, (up0, up1, up2), rods, tolerance, max_iterations, first_shift,
                max_rotation, max_escapes, closing_distance, threads, thread, scratch, queue, frames, results,
                material, material)

    @ti.kernel
    def newton_under_load(
        start: table1, rest_length: table2, clamp: table2, material: table2, up0: ti.f64, up1: ti.f64, up2: ti.f64,
        rods: index2, tolerance: ti.f64, max_iterations: ti.i32, first_shift: ti.f64, max_rotation: ti.f64,
        max_escapes: ti.i32, closing_distance: ti.f64, threads: ti.i32,
        scratch: ti.types.ndarray(dtype=number.type, ndim=1), queue: index1, frames: table1, results: table2,
        outer: table3,  # the numbers of the external energy
        field: ti.types.ndarray(dtype=ti.f32, ndim=1),  # and what it looks up in space
    ):
        ti.loop_config(block_dim=block, serialize=serial)
        for thread in range(threads):
            relax_rods(
                start, rest_length, clamp, material, (up0, up1, up2), rods, tolerance, max_iterations, first_shift,
                max_rotation, max_escapes, closing_distance, threads, thread, scratch, queue, frames, results, outer, field)

    return newton if external is None else newton_under_load
