"""The kernel that carries all rods through time steps, each a relaxation (docs/dynamics.md)."""

from functools import cache

import taichi as ti

from doo_ti.physics.number import Number
from doo_ti.relaxation.contacts import Contacts
from doo_ti.relaxation.dense_elimination import DenseElimination
from doo_ti.relaxation.kernel_factory import INDEX1, INDEX2, SCRATCH, TABLE1, TABLE2, TABLE3, TABLE4, loop_kernel
from doo_ti.relaxation.newton import OBSTACLES
from doo_ti.relaxation.self_contacts import SelfContacts
from doo_ti.relaxation.time_impact import TimeImpact
from doo_ti.relaxation.time_loop import TimeLoop
from doo_ti.relaxation.time_slope_loop import TimeSlopeLoop
from doo_ti.relaxation.time_slopes import TimeSlopes
from doo_ti.relaxation.time_sweep import TimeSweep


class DenseTimeSweep(DenseElimination, TimeImpact):
    """The time step of rods that may touch themselves."""


# What kernels are given, in this order.
STEPS = {
    "rest_length": TABLE2,  # [1 or configuration, edge] mm
    "clamp": TABLE2,  # [configuration, CLAMP_COLUMNS]
    "path": TABLE3,  # [configuration, step, PATH_COLUMNS]
    "material": TABLE2,  # [material, STIFFNESS + 1 or edge · STIFFNESS_COLUMNS]
    "numbers": TABLE3,  # [numbers, vertex, VERTEX_ITEMS − INERTIA]
    "shares": TABLE2,  # [numbers, 2] of rest curvature and of rest twist that damping makes
    "rods": INDEX2,  # [rod, ROD_COLUMNS]
    "policy": TABLE1,  # [POLICY_COLUMNS] of :mod:`doo_ti.relaxation.newton_policy`
    "time": TABLE1,  # [TIME_COLUMNS] of :mod:`doo_ti.relaxation.time_sweep`
    "steps": ti.i32,
    "every": ti.i32,
    "threads": ti.i32,
    "scratch": SCRATCH,
    "queue": INDEX1,  # [NEXT, TRIPS, LANES + twice thread · lane] zero
    "frames": TABLE1,  # [row · edge · 4] at the last instant, in and out
    "frames_before": TABLE1,  # and at the one before
    "places": TABLE3,  # [row, vertex, INERTIA] positions and velocities at both, in and out
    "results": TABLE2,  # [row, LOADED_RESULTS], of which DRIFT is in and out
    "positions": TABLE3,  # [row · frame, vertex, 3] out
    "outcome": TABLE3,  # [row, frame, OUTCOMES] zero
}
MOTIONS = {  # among obstacles, whose forces (OBSTACLES) are those of [row · frame, vertex, 3]
    "touches": INDEX2,  # [row · frame, vertex] out
    "poses": TABLE4,  # [1 or row, 1 + step, obstacle, POSE_COLUMNS] of obstacles that move, else anything
    "pair_memory": TABLE3,  # [row, pair of edges, CARRIED] in and out, or one number
    "rod_memory": TABLE2,  # [row, CARRIED_ON] in and out
}
SLOPES = {
    "material_slopes": TABLE2,  # [parameter · material, -]
    "number_slopes": TABLE4,  # [parameter, numbers, vertex, NUMBERS]
    "share_slopes": TABLE3,  # [parameter, numbers, 2]
    "slopes": TABLE4,  # [row, parameter, vertex, REMEMBERED] in and out
    "position_slopes": TABLE4,  # [row · frame, parameter, vertex, 3] out
}


@cache
def time_kernel(number: Number, stride: int, block: int, isotropic: bool):
    """(compiled-on-first-use kernel for one kind of number, :meth:`.Chain.items`).

    isotropic: round rods, straight at rest and undamped.

    stride, block: as of :func:`.newton_kernel`.
    """
    sweep = TimeSweep(number, isotropic, stride)
    return loop_kernel("make_steps", number, STEPS, TimeLoop(sweep).work, block), sweep.items


@cache
def time_contact_kernel(number: Number, stride: int, block: int, isotropic: bool, kinds: frozenset[int], rub: bool,
                        itself: bool, moves: bool):
    """The same for rods that may touch obstacles of some ``kinds``, or ``itself``, with friction if they ``rub``, and for
    obstacles that move if ``moves``."""
    if itself:
        sweep = DenseTimeSweep(number, isotropic, stride, SelfContacts(number, kinds, rub, moves))
    else:
        sweep = TimeImpact(number, isotropic, stride, Contacts(number, kinds, rub, moves))
    given = STEPS | OBSTACLES | MOTIONS
    return loop_kernel("make_steps_in_contact", number, given, TimeLoop(sweep).work, block, brief=True), sweep.items


@cache
def time_slope_kernel(number: Number, stride: int, block: int):
    """The same for steps with their derivatives, in f64 and for any rods."""
    sweep = TimeSlopes(number, stride)
    return loop_kernel("make_steps_with_slopes", number, STEPS | SLOPES, TimeSlopeLoop(sweep).work, block), sweep.items
