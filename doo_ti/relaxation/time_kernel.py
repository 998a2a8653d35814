"""The kernel that carries all rods through time steps, each a relaxation (docs/dynamics.md)."""

from functools import cache

import taichi as ti

from doo_ti.physics.number import Number
from doo_ti.physics.tuples import record
from doo_ti.relaxation.newton_loop import UP
from doo_ti.relaxation.time_loop import TimeLoop
from doo_ti.relaxation.time_sweep import TimeSweep


@cache
def time_kernel(number: Number, isotropic: bool, stride: int, block: int):
    """(compiled-on-first-use kernel for one kind of number, items of an edge in scratch, parameters of a rod there).

    isotropic: round rods, straight at rest and undamped.

    stride, block: as of :func:`.newton_kernel`.
    """
    sweep = TimeSweep(number, isotropic, stride)
    loop = TimeLoop(sweep)
    table1, table2, table3 = (ti.types.ndarray(dtype=ti.f64, ndim=size) for size in (1, 2, 3))
    index1, index2 = (ti.types.ndarray(dtype=ti.i32, ndim=size) for size in (1, 2))

    @ti.kernel
    def make_steps(
        rest_length: table2,  # [1 or configuration, edge] mm
        clamp: table2,  # [configuration, CLAMP_COLUMNS]
        path: table3,  # [configuration, step, PATH_COLUMNS]
        material: table2,  # [material, STIFFNESS + 1 or edge · STIFFNESS_COLUMNS]
        numbers: table3,  # [numbers, vertex, VERTEX_ITEMS − INERTIA]
        shares: table2,  # [numbers, 2] of rest curvature and of rest twist that damping makes
        rods: index2,  # [rod, ROD_COLUMNS]
        policy: table1,  # [POLICY_COLUMNS] of :mod:`doo_ti.relaxation.newton`
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
                outcome=outcome)
            loop.work(tables, scratch, threads, thread)

    return make_steps, sweep.items, sweep.parameters
