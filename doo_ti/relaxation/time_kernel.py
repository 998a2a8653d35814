"""The kernel that carries all rods through time steps, each a relaxation (docs/dynamics.md)."""

from functools import cache

import taichi as ti

from doo_ti import runtime
from doo_ti.physics.number import Number
from doo_ti.physics.tuples import picked, record
from doo_ti.relaxation.contact_layout import CONTACTS, contact_items
from doo_ti.relaxation.contacts import Contacts
from doo_ti.relaxation.dense_elimination import DenseElimination
from doo_ti.relaxation.newton_policy import UP
from doo_ti.relaxation.pair_layout import self_contact_items
from doo_ti.relaxation.self_contacts import SelfContacts
from doo_ti.relaxation.time_impact import TimeImpact
from doo_ti.relaxation.time_loop import TimeLoop
from doo_ti.relaxation.time_slope_loop import TimeSlopeLoop
from doo_ti.relaxation.time_slopes import OWN, SHARED, TimeSlopes
from doo_ti.relaxation.time_sweep import TimeSweep


class DenseTimeSweep(DenseElimination, TimeImpact):
    """The time step of rods that may touch themselves."""


@cache
def time_kernel(number: Number, isotropic: bool, stride: int, block: int):
    """(compiled-on-first-use kernel for one kind of number, numbers of a rod in scratch by its edges).

    isotropic: round rods, straight at rest and undamped.

    stride, block: as of :func:`.newton_kernel`.
    """
    sweep = TimeSweep(number, isotropic, stride)
    loop = TimeLoop(sweep)
    table1, table2, table3 = (ti.types.ndarray(dtype=ti.f64, ndim=size) for size in (1, 2, 3))
    index1, index2 = (ti.types.ndarray(dtype=ti.i32, ndim=size) for size in (1, 2))

    @runtime.kernel
    def make_steps(
        rest_length: table2,  # [1 or configuration, edge] mm
        clamp: table2,  # [configuration, CLAMP_COLUMNS]
        path: table3,  # [configuration, step, PATH_COLUMNS]
        material: table2,  # [material, STIFFNESS + 1 or edge · STIFFNESS_COLUMNS]
        numbers: table3,  # [numbers, vertex, VERTEX_ITEMS − INERTIA]
        shares: table2,  # [numbers, 2] of rest curvature and of rest twist that damping makes
        rods: index2,  # [rod, ROD_COLUMNS]
        policy: table1,  # [POLICY_COLUMNS] of :mod:`doo_ti.relaxation.newton_policy`
        time: table1,  # [TIME_COLUMNS] of :mod:`doo_ti.relaxation.time_sweep`
        steps: ti.i32,
        every: ti.i32,
        threads: ti.i32,
        scratch: ti.types.ndarray(dtype=number.type, ndim=1),
        queue: index1,  # [NEXT, TRIPS, LANES + twice thread · lane] zero
        frames: table1,  # [row · edge · 4] at the last instant, in and out
        frames_before: table1,  # and at the one before
        places: table3,  # [row, vertex, INERTIA] positions and velocities at both, in and out
        results: table2,  # [row, LOADED_RESULTS], of which DRIFT is in and out
        positions: table3,  # [row · frame, vertex, 3] out
        outcome: table3,  # [row, frame, OUTCOMES] zero
    ):
        ti.loop_config(block_dim=block)
        for thread in range(threads):
            up = (policy[UP], policy[UP + 1], policy[UP + 2])
            tables = record(
                start=frames, rest_length=rest_length, clamp=clamp, material=material, up=up, rods=rods, policy=policy,
                queue=queue, frames=frames, results=results, numbers=numbers, field=material, path=path, shares=shares,
                time=time, steps=steps, every=every, frames_before=frames_before, places=places, positions=positions,
                outcome=outcome, contacts=0, kinds=queue, grids=policy)
            loop.work(tables, scratch, threads, thread)

    return make_steps, sweep.numbers


@cache
def time_contact_kernel(number: Number, isotropic: bool, stride: int, block: int, kinds: frozenset[int], rub: bool,
                        itself: bool, moves: bool):
    """The same for rods that may touch obstacles of some ``kinds``, or ``itself``, with friction if they ``rub``, and for
    obstacles that move if ``moves``. The numbers that :func:`.contact_items` or :func:`.self_contact_items` says come on top in
    scratch."""
    if itself:
        sweep = DenseTimeSweep(number, isotropic, stride, SelfContacts(number, kinds, rub, moves))
    else:
        sweep = TimeImpact(number, isotropic, stride, Contacts(number, kinds, rub, moves))
    size = self_contact_items if itself else contact_items
    loop = TimeLoop(sweep)
    table1, table2, table3, table4 = (ti.types.ndarray(dtype=ti.f64, ndim=size) for size in (1, 2, 3, 4))
    index1, index2 = (ti.types.ndarray(dtype=ti.i32, ndim=size) for size in (1, 2))

    @runtime.kernel
    def make_steps(
        rest_length: table2, clamp: table2, path: table3, material: table2, numbers: table3, shares: table2, rods: index2,
        policy: table1, time: table1, steps: ti.i32, every: ti.i32, threads: ti.i32,
        scratch: ti.types.ndarray(dtype=number.type, ndim=1), queue: index1, frames: table1, frames_before: table1,
        places: table3, results: table2, positions: table3, outcome: table3,  # as :func:`time_kernel` has them
        obstacles: table3, obstacle_kinds: index1, grids: table1, radius: table1, gap_tolerance: ti.f64,
        memory: table4,  # as in Newton's
        forces: table3,  # [row · frame, vertex, 3] out
        self_friction: table1,
        touches: index2,  # [row · frame, vertex] out
        poses: table4,  # [1 or row, 1 + step, obstacle, POSE_COLUMNS] of obstacles that move, else anything
        pair_memory: table3,  # [row, pair of edges, CARRIED] in and out, or one number
    ):
        ti.loop_config(block_dim=block)
        for thread in range(threads):
            up = (policy[UP], policy[UP + 1], policy[UP + 2])
            edges = rest_length.shape[1]
            contacts = sweep.behind(scratch, threads, thread, edges, size(edges, obstacle_kinds.shape[0]), CONTACTS)
            tables = record(
                start=frames, rest_length=rest_length, clamp=clamp, material=material, up=up, rods=rods, policy=policy,
                queue=queue, frames=frames, results=results, numbers=numbers, field=material, path=path, shares=shares,
                time=time, steps=steps, every=every, frames_before=frames_before, places=places, positions=positions,
                outcome=outcome, contacts=contacts, obstacles=obstacles, kinds=obstacle_kinds, grids=grids, radius=radius,
                tolerance=gap_tolerance, memory=memory, forces=forces, self_friction=self_friction, touches=touches,
                poses=poses, pair_memory=pair_memory)
            loop.work(tables, scratch, threads, thread)

    return runtime.compiled_briefly(make_steps), sweep.numbers


@cache
def time_slope_kernel(stride: int, block: int, width: int):
    """The same for steps with their derivatives, in f64 and for any rods, ``width`` in a pack; the numbers that
    :func:`slope_items` says come on top in scratch."""
    number = Number(width, 64)
    sweep = TimeSlopes(number, stride)
    loop = TimeSlopeLoop(sweep)
    table1, table2, table3, table4 = (ti.types.ndarray(dtype=ti.f64, ndim=size) for size in (1, 2, 3, 4))
    index1, index2 = (ti.types.ndarray(dtype=ti.i32, ndim=size) for size in (1, 2))

    @runtime.kernel
    def make_steps(
        rest_length: table2, clamp: table2, path: table3, material: table2, numbers: table3, shares: table2, rods: index2,
        policy: table1, time: table1, steps: ti.i32, every: ti.i32, threads: ti.i32,
        scratch: ti.types.ndarray(dtype=number.type, ndim=1), queue: index1, frames: table1, frames_before: table1,
        places: table3, results: table2, positions: table3, outcome: table3,  # as :func:`time_kernel` has them
        material_slopes: table3,  # [parameter, material, -]
        number_slopes: table4,  # [parameter, numbers, vertex, NUMBERS]
        share_slopes: table3,  # [parameter, numbers, 2]
        slopes: table4,  # [row, parameter, vertex, REMEMBERED] in and out
        position_slopes: table4,  # [row · frame, parameter, vertex, 3] out
    ):
        ti.loop_config(block_dim=block)
        for thread in range(threads):
            up = (policy[UP], policy[UP + 1], policy[UP + 2])
            edges = rest_length.shape[1]
            blocks = sweep.behind(scratch, threads, thread, edges, slope_items(edges, material_slopes.shape[0]), SHARED)
            tables = record(
                start=frames, rest_length=rest_length, clamp=clamp, material=material, up=up, rods=rods, policy=policy,
                queue=queue, frames=frames, results=results, numbers=numbers, field=material, path=path, shares=shares,
                time=time, steps=steps, every=every, frames_before=frames_before, places=places, positions=positions,
                outcome=outcome, material_slopes=material_slopes, number_slopes=number_slopes, share_slopes=share_slopes,
                slopes=slopes, position_slopes=position_slopes, blocks=blocks, contacts=0, kinds=queue, grids=policy)
            loop.work(tables, scratch, threads, thread)

    return make_steps, sweep.numbers


@picked
def slope_items(edges, parameters):
    """Numbers of a rod's derivatives in scratch."""
    return (edges + 1) * (len(SHARED) + parameters * len(OWN))
