"""Newton's method on the chain of frames: the policy, and the kernel that relaxes all rods (§III-D).

A trip through the kernel's loop gives every lane one trial step and one factorisation. A lane whose rod is done stores it
and takes the next from a queue, so that all lanes stay busy whatever the rods need. What a rod does depends on nothing but
itself: the result is the same alone and in any batch, in any place.
"""

from dataclasses import dataclass
from functools import cache

import taichi as ti

from doo_ti import chain
from doo_ti.errors import InputError
from doo_ti.physics.algebra import dot
from doo_ti.physics.number import Number
from doo_ti.tables import (
    CLOSED,
    CLOSURE,
    ENERGY,
    ITERATIONS,
    RELEASED,
    RESIDUAL,
    SPIN_END,
    SPIN_START,
    STABLE,
    STATUS,
    TARGET,
    TILT_END,
    TILT_INNER,
    TILT_START,
)
from doo_ti.types import Status


@dataclass(frozen=True)
class Newton:
    """Options of the Newton solver.

    tolerance       scaled residual to reach, 1/mm; None: 1e-9 in f64, 1e-6 in f32
    max_iterations  factorisations allowed per rod
    first_shift     shift δ of the first factorisation over the largest diagonal entry of H. Zero follows the path of
                    descent more closely and takes more iterations (``careful``).
    max_rotation    largest turn of any edge in one step, rad
    max_escapes     how often a rod may leave a saddle it has converged to
    """

    tolerance: float | None = None
    max_iterations: int = 300
    first_shift: float = 0.01
    max_rotation: float = 0.6
    max_escapes: int = 3

    def __post_init__(self):
        if self.tolerance is not None and not self.tolerance > 0:
            raise InputError("Newton", "tolerance", f"{self.tolerance} is not positive", "give a positive number")
        if not isinstance(self.max_iterations, int) or self.max_iterations < 1:
            raise InputError("Newton", "max_iterations", f"{self.max_iterations}", "give a whole number from one up")
        if not 0 < self.max_rotation <= 1:
            raise InputError("Newton", "max_rotation", f"{self.max_rotation}", "give radians above 0, at most 1")
        if not 0 <= self.first_shift < float("inf"):
            raise InputError("Newton", "first_shift", f"{self.first_shift} is negative", "give zero or more")

    @classmethod
    def careful(cls, **options) -> "Newton":
        """The policy that keeps closest to descent: use it where basins matter (ribbons)."""
        return cls(first_shift=0.0, **options)


# The policy's fixed numbers (shifts are over the largest diagonal entry of H).
SHIFT_WRONG_INERTIA = 0.01
SHIFT_REJECTED = 1e-5
SHIFT_NEGLIGIBLE = 1e-6
CLOSING_DISTANCE = 0.1  # edge lengths: above it a step only projects
ESCAPE_ROTATION = 0.1  # rad
ESCAPE_ROUNDS = 3.0  # inverse iterations before the first leap off a saddle
PATIENCE = 25  # trips without progress
PATIENCE_AT_SADDLE = 8  # trips without noteworthy progress where the inertia is wrong


@cache
def newton_kernel(number: Number, isotropic: bool, stride: int, block: int):
    """The compiled-on-first-use kernel for one kind of number and of material.

    stride: distance between the items of an edge in scratch, 1 on a CPU, the number of threads on a GPU.
    block: threads in a block, 1 on a CPU.
    """
    sweep = chain.chain_sweeps(number, isotropic, stride)
    items = chain.ISOTROPIC_ITEMS if isotropic else chain.GENERAL_ITEMS
    largest, lane, with_lane, constant, put = number.lanes()
    width = number.width
    scalar = number.scalar
    rounding = 2e-6 if number.bits == 32 else 1e-10
    closure_tolerance = 1e-7 if number.bits == 32 else 1e-12
    # Neutral motions, a weightless bow about its chord, have an eigenvalue that is rounding of either sign: a trace of H's
    # scale on the diagonal lets them pass, always. f32 cannot tell them from soft saddles and leaves them to f64.
    trace = 0.0 if number.bits == 32 else 1e-13
    converged, limit = int(Status.CONVERGED), int(Status.ITERATION_LIMIT)
    stalled, not_finite = int(Status.STALLED), int(Status.NOT_FINITE)
    table1 = ti.types.ndarray(dtype=ti.f64, ndim=1)
    table2 = ti.types.ndarray(dtype=ti.f64, ndim=2)
    table3 = ti.types.ndarray(dtype=ti.f64, ndim=3)

    @ti.func
    def load_edges(scratch: ti.template(), origin, edges, slot, s, g, start: ti.template(), rest_length: ti.template(),
                   bend: ti.template(), twist: ti.template(), rest: ti.template()):
        """One rod's frames, lengths and stiffness into lane ``slot``."""
        ls = ti.min(s, rest_length.shape[0] - 1)
        at = origin
        for e in range(edges):
            for k in ti.static(range(4)):
                put(scratch, at + (chain.FRAME + k) * stride, slot, start[s, e, k])
            for k in ti.static(range(3)):
                put(scratch, at + (chain.ROTATION + k) * stride, slot, 0.0)
            put(scratch, at + chain.LENGTH * stride, slot, rest_length[ls, e])
            if e > 0:
                both = rest_length[ls, e - 1] + rest_length[ls, e]
                put(scratch, at + chain.INVERSE_LENGTH * stride, slot, 1.0 / both)
                if ti.static(not isotropic):
                    put(scratch, at + chain.TWIST * stride, slot, twist[g, ti.min(e, twist.shape[1]) - 1])
                    for k in ti.static(range(2)):
                        put(scratch, at + (chain.REST + k) * stride, slot,
                            0.5 * both * rest[g, ti.min(e, rest.shape[1]) - 1, k])
            if ti.static(not isotropic):
                for k in ti.static(range(3)):
                    put(scratch, at + (chain.BEND + k) * stride, slot, bend[g, ti.min(e, bend.shape[1] - 1), k])
            at += ti.static(items * stride)

    @ti.func
    def scales(edges, s, g, rest_length: ti.template(), bend: ti.template(), twist: ti.template(),
               rest: ti.template()):
        """(length of the rod, a first guess of H's largest diagonal entry, longest edge, and one where the rod looks the same
        from all sides, so that it may spin about itself at no cost)."""
        ls = ti.min(s, rest_length.shape[0] - 1)
        diagonal = ti.cast(0.0, ti.f64)
        total = ti.cast(0.0, ti.f64)
        longest = ti.cast(0.0, ti.f64)
        round_section = ti.cast(1.0, ti.f64)
        for e in range(edges):
            b = ti.min(e, bend.shape[1] - 1)
            half = 0.5 * (bend[g, b, 0] + bend[g, b, 1])
            apart = 0.5 * (bend[g, b, 0] - bend[g, b, 1])
            eigenvalue = half + ti.sqrt(apart * apart + bend[g, b, 2] * bend[g, b, 2])
            if apart != 0.0 or bend[g, b, 2] != 0.0:
                round_section = 0.0
            total += rest_length[ls, e]
            longest = ti.max(longest, rest_length[ls, e])
            if e > 0:
                joint = ti.min(e, rest.shape[1]) - 1
                if rest[g, joint, 0] != 0.0 or rest[g, joint, 1] != 0.0:
                    round_section = 0.0
                both = rest_length[ls, e - 1] + rest_length[ls, e]
                diagonal = ti.max(diagonal, 4.0 * ti.max(eigenvalue, twist[g, ti.min(e, twist.shape[1]) - 1]) / both)
        return total, diagonal, longest, round_section

    @ti.kernel
    def newton(
        start: table3,  # [configuration, edge, 4]
        rest_length: table2,  # [1 or configuration, edge] mm
        clamp: table2,  # [configuration, CLAMP_COLUMNS]
        bend: table3,  # [material, 1 or edge, (11, 22, 12)] mm³
        twist: table2,  # [material, 1 or inner vertex] mm³
        rest: table3,  # [material, 1 or inner vertex, 2] 1/mm
        weight: table1,  # [material]
        rods: ti.types.ndarray(dtype=ti.i32, ndim=2),  # [rod, (configuration, material, row of the results)]
        divisors: table1,  # [row of the results] of the scaled residual
        up: ti.types.vector(3, ti.f64),
        tolerance: ti.f64,
        max_iterations: ti.i32,
        first_shift: ti.f64,
        max_rotation: ti.f64,
        max_escapes: ti.i32,
        closing_distance: ti.f64,
        threads: ti.i32,
        origin_stride: ti.i32,
        scratch: ti.types.ndarray(dtype=number.type, ndim=1),
        lane_rod: ti.types.ndarray(dtype=ti.i32, ndim=1),  # [thread · lane]
        queue: ti.types.ndarray(dtype=ti.i32, ndim=1),  # [1] the next rod
        frames: table3,  # [rod, edge, 4] out
        results: table2,  # [rod, RESULTS] out
    ):
        edges = start.shape[1]
        ti.loop_config(block_dim=block)
        for thread in range(threads):
            origin = thread * origin_stride
            zero = constant(0.0)
            one = constant(1.0)
            # What is asked of the lane's rod.
            target0, target1, target2, closed = (zero, zero, zero, zero)
            spin_start, tilt_start, spin_end, tilt_end, tilt_inner = (zero, zero, zero, zero, zero)
            released, total, edge, divisor = (zero, one, one, one)
            alpha, beta = (one, one)
            gravity0, gravity1, gravity2 = (zero, zero, zero)
            # Where the lane's rod is.
            energy, magnitude = (zero, zero)
            miss0, miss1, miss2 = (zero, zero, zero)
            lambda0, lambda1, lambda2 = (zero, zero, zero)
            change0, change1, change2 = (zero, zero, zero)
            shift, scale, step_scale = (zero, one, zero)
            residual, longest, best, idle_trips, aimless, trips, rejects = (zero, one, zero, zero, zero, zero, zero)
            fresh, trying, closing, escaping, escapes, rounds = (zero, zero, zero, zero, zero, zero)
            status, stable = (zero, zero)
            active, finished = (zero, one)
            running = 1
            while running == 1:
                if largest(finished) > 0.5:
                    for slot in range(width):
                        if lane(finished, slot) > 0.5:
                            finished = with_lane(finished, slot, 0.0)
                            if lane(active, slot) > 0.5:
                                row = rods[lane_rod[thread * width + slot], 2]
                                at = origin
                                for e in range(edges):
                                    for k in ti.static(range(4)):
                                        frames[row, e, k] = lane(scratch[at + k * stride], slot)
                                    at += ti.static(items * stride)
                                if lane(status, slot) != not_finite:  # else these are NaN already
                                    results[row, ENERGY] = lane(energy, slot)
                                    results[row, RESIDUAL] = lane(residual, slot)
                                    squares = lane(miss0, slot) ** 2 + lane(miss1, slot) ** 2 + lane(miss2, slot) ** 2
                                    results[row, CLOSURE] = ti.sqrt(squares) / lane(total, slot)
                                results[row, ITERATIONS] = lane(trips, slot)
                                results[row, STATUS] = lane(status, slot)
                                results[row, STABLE] = lane(stable, slot)
                            active = with_lane(active, slot, 0.0)
                            rod = ti.atomic_add(queue[0], 1)
                            if rod < rods.shape[0]:
                                lane_rod[thread * width + slot] = rod
                                s = rods[rod, 0]
                                g = rods[rod, 1]
                                load_edges(scratch, origin, edges, slot, s, g, start, rest_length, bend, twist, rest)
                                sizes = scales(edges, s, g, rest_length, bend, twist, rest)
                                total = with_lane(total, slot, sizes[0])
                                divisor = with_lane(divisor, slot, divisors[rods[rod, 2]])
                                scale = with_lane(scale, slot, sizes[1])
                                edge = with_lane(edge, slot, sizes[2])
                                shift = with_lane(shift, slot, first_shift * sizes[1])
                                target0 = with_lane(target0, slot, clamp[s, TARGET])
                                target1 = with_lane(target1, slot, clamp[s, TARGET + 1])
                                target2 = with_lane(target2, slot, clamp[s, TARGET + 2])
                                closed = with_lane(closed, slot, clamp[s, CLOSED])
                                # A round rod with both spins free turns about itself at no cost: hold its first spin.
                                turning = sizes[3] * clamp[s, SPIN_END]
                                spin_start = with_lane(spin_start, slot, clamp[s, SPIN_START] * (1.0 - turning))
                                tilt_start = with_lane(tilt_start, slot, clamp[s, TILT_START])
                                spin_end = with_lane(spin_end, slot, clamp[s, SPIN_END])
                                tilt_end = with_lane(tilt_end, slot, clamp[s, TILT_END])
                                tilt_inner = with_lane(tilt_inner, slot, clamp[s, TILT_INNER])
                                released = with_lane(released, slot, clamp[s, RELEASED])
                                alpha = with_lane(alpha, slot, bend[g, 0, 0])
                                beta = with_lane(beta, slot, twist[g, 0])
                                gravity0 = with_lane(gravity0, slot, weight[g] * up[0])
                                gravity1 = with_lane(gravity1, slot, weight[g] * up[1])
                                gravity2 = with_lane(gravity2, slot, weight[g] * up[2])
                                step_scale = with_lane(step_scale, slot, 0.0)
                                best = with_lane(best, slot, 1e30)
                                idle_trips = with_lane(idle_trips, slot, 0.0)
                                aimless = with_lane(aimless, slot, 0.0)
                                trips = with_lane(trips, slot, 0.0)
                                rejects = with_lane(rejects, slot, 0.0)
                                fresh = with_lane(fresh, slot, 1.0)
                                trying = with_lane(trying, slot, 0.0)
                                closing = with_lane(closing, slot, 0.0)
                                escaping = with_lane(escaping, slot, 0.0)
                                escapes = with_lane(escapes, slot, 0.0)
                                active = with_lane(active, slot, 1.0)
                if largest(active) < 0.5:
                    running = 0
                else:
                    free = (spin_start, tilt_start, spin_end, tilt_end, tilt_inner)
                    target = (target0, target1, target2)
                    gravity = (gravity0, gravity1, gravity2)
                    material = (alpha, beta)
                    # Try the step, project it, judge it by the Lagrangian.
                    x = sweep.step(scratch, origin, edges, step_scale, target, closed, free)
                    new_energy, new_magnitude, new_miss, new_multiplier = sweep.project(
                        scratch, origin, edges, x, material, gravity, target, closed, free, total, released)
                    multiplier = (lambda0 + change0, lambda1 + change1, lambda2 + change2)
                    before = energy + dot(multiplier, (miss0, miss1, miss2))
                    after = new_energy + dot(multiplier, new_miss)
                    noise_level = rounding * magnitude
                    forced = (fresh + closing > 0.5) & (new_energy == new_energy)
                    downhill = (trying > 0.5) & (after <= before + noise_level)
                    accepted = ti.select(forced | downhill, one, zero)
                    uphill = ti.select((trying > 0.5) & (accepted < 0.5), one, zero)
                    gained = (after < before - noise_level) & (accepted > 0.5)
                    notable = (after < before - 1e-6 * magnitude) & (accepted > 0.5)
                    energy = ti.select(accepted > 0.5, new_energy, energy)
                    magnitude = ti.select(accepted > 0.5, new_magnitude, magnitude)
                    miss0 = ti.select(accepted > 0.5, new_miss[0], miss0)
                    miss1 = ti.select(accepted > 0.5, new_miss[1], miss1)
                    miss2 = ti.select(accepted > 0.5, new_miss[2], miss2)
                    lambda0 = ti.select(accepted > 0.5, new_multiplier[0], lambda0)
                    lambda1 = ti.select(accepted > 0.5, new_multiplier[1], lambda1)
                    lambda2 = ti.select(accepted > 0.5, new_multiplier[2], lambda2)
                    smaller = ti.select(0.25 * shift > SHIFT_NEGLIGIBLE * scale, 0.25 * shift, zero)
                    shift = ti.select(downhill, smaller, shift)
                    stiffer = (uphill > 0.5) & (escaping < 0.5)
                    shift = ti.select(stiffer, ti.max(4.0 * shift, SHIFT_REJECTED * scale), shift)
                    rejects = ti.select(downhill, zero, rejects + uphill)
                    escaping = ti.select(downhill, zero, escaping)
                    broken = ti.select((fresh > 0.5) & (accepted < 0.5), one, zero)
                    # Factorise at the frames that stand. Off a saddle: once with noise, then on what came of it.
                    noise = ti.select((escaping > 0.5) & (rounds < 0.5), 1e-3 * scale, zero)
                    echo = ti.select((escaping > 0.5) & (rounds > 0.5), scale / (longest + 1e-30), zero)
                    diagonal = ti.select(shift > 0.0, shift, trace * scale)
                    moment, scale, change, inertia = sweep.eliminate(
                        scratch, origin, edges, accepted, diagonal, noise, echo, (lambda0, lambda1, lambda2),
                        (miss0, miss1, miss2), material, gravity, closed, free, total, released)
                    longest = sweep.substitute(scratch, origin, edges, change)
                    change0, change1, change2 = change
                    residual = moment / divisor
                    trips = trips + active
                    # Judge where the rod is.
                    gap = ti.sqrt(dot((miss0, miss1, miss2), (miss0, miss1, miss2)))
                    small = (residual <= ti.cast(tolerance, scalar)) & (gap <= closure_tolerance * total)
                    right = (inertia > 2.5) & (inertia < 3.5)
                    wrong = (inertia < 2.5) | (inertia > 3.5)
                    calm = small & (escaping < 0.5)
                    bare = shift <= 0.0
                    at_minimum = calm & bare & right
                    at_saddle = calm & bare & wrong
                    # Beside a saddle a rod may get nowhere though its residual is not yet small.
                    adrift = wrong & (aimless > PATIENCE_AT_SADDLE) & (escaping < 0.5) & (closing < 0.5)
                    leaving = (at_saddle & (escapes < ti.cast(max_escapes, scalar))) | (adrift & (max_escapes > 0))
                    resting = at_saddle & (escapes >= ti.cast(max_escapes, scalar))
                    certify = calm & (shift > 0.0)
                    escaping = ti.select(leaving, one, escaping)
                    shift = ti.select(leaving, zero, shift)
                    escapes = ti.select(leaving & at_saddle, escapes + 1.0, escapes)
                    closing = ti.select(gap > ti.cast(closing_distance, scalar) * edge, one, zero)
                    rounds = ti.select((escaping > 0.5) & right & ~leaving, rounds + 1.0, rounds)
                    rounds = ti.select(leaving, zero, rounds)
                    searching = (escaping > 0.5) & (rounds <= ESCAPE_ROUNDS)
                    held = ti.select(certify | leaving | wrong | searching | (closing > 0.5), one, zero)
                    trying = 1.0 - held
                    floor = ti.select(escaping > 0.5, SHIFT_NEGLIGIBLE * scale, SHIFT_WRONG_INERTIA * scale)
                    shift = ti.select(wrong & (closing < 0.5), ti.max(4.0 * shift, floor), shift)
                    shift = ti.select(certify, zero, shift)
                    cap = ti.min(one, ti.cast(max_rotation, scalar) / (longest + 1e-30))
                    leap = ESCAPE_ROTATION / ((1.0 + rejects) * (1.0 + rejects) * (longest + 1e-30))
                    step_scale = ti.select(trying > 0.5, ti.select(escaping > 0.5, leap, cap), zero)
                    better = leaving | (closing > 0.5) | (residual < 0.7 * best)
                    progress = gained | better
                    aimless = ti.select(better | notable, zero, aimless + 1.0)
                    idle_trips = ti.select(progress, zero, idle_trips + 1.0)
                    best = ti.min(best, residual)
                    fresh = zero
                    # Who is done, and how.
                    ended = at_minimum | resting
                    late = trips >= ti.cast(max_iterations, scalar)
                    stuck = idle_trips > PATIENCE
                    lost = (broken > 0.5) | ~(residual == residual)
                    status = ti.select(stuck, constant(stalled), constant(limit))
                    status = ti.select(lost, constant(not_finite), status)
                    # At rest, though a neutral motion leaves the certificate undecided: converged, not certified.
                    at_rest = small & (late | stuck)
                    status = ti.select(ended | at_rest, constant(converged), status)
                    stable = ti.select(at_minimum, one, zero)
                    finished = ti.select((ended | late | stuck | lost) & (active > 0.5), one, zero)

    return newton
