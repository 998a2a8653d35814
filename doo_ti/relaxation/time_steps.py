"""Many rods through many implicit time steps in one launch (docs/dynamics.md)."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial

import numpy as np
import taichi as ti

from doo_ti.physics.number import Number
from doo_ti.relaxation import tables as of
from doo_ti.relaxation.batch import launch, layout_for, policy_row
from doo_ti.relaxation.contacts import RodContacts
from doo_ti.relaxation.dense_elimination import DenseElimination
from doo_ti.relaxation.kernel_factory import INDEX1, INDEX2, RODS, TABLE1, TABLE2, TABLE3, TABLE4, loop_kernel
from doo_ti.relaxation.newton import OBSTACLES, Newton
from doo_ti.relaxation.self_contacts import SelfContacts
from doo_ti.relaxation.tables import Tables, room
from doo_ti.relaxation.time_impact import TimeImpact
from doo_ti.relaxation.time_loop import OUTCOMES, STATE, TimeLoop
from doo_ti.relaxation.time_slopes import CURVATURE_1, CURVATURE_2, REMEMBERED, TimeSlopeLoop, TimeSlopes
from doo_ti.relaxation.time_sweep import PLACE_2, TimeSweep
from doo_ti.rod.frames import conjugate, quaternion_product
from doo_ti.rod.types import Status
from doo_ti.system import runtime


class DenseTimeSweep(DenseElimination, TimeImpact):
    """The time step of rods that may touch themselves."""


# What kernels are given.
STEPS = RODS | {
    "path": TABLE3,  # [configuration, step, PATH_COLUMNS]
    "numbers": TABLE3,  # [numbers, vertex, VERTEX_ITEMS − INERTIA]
    "shares": TABLE2,  # [numbers, 2] of rest curvature and of rest twist that damping makes
    "policy": TABLE1,  # [POLICY_COLUMNS] of :mod:`doo_ti.relaxation.newton_policy`
    "time": TABLE1,  # [TIME_COLUMNS] of :mod:`doo_ti.relaxation.time_sweep`
    "steps": ti.i32, "every": ti.i32,  # and after how many of them a frame is stored
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
    "poses": TABLE4,  # [1 or row, 1 + step, obstacle, POSE_COLUMNS] of obstacles that move, from before the first step on
    "pair_memory": TABLE3,  # [row, pair of edges, PAIR_CARRIED] in and out, or one number
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
def time_kernel(number: Number, stride: int, block: int, isotropic: bool, slopes: bool, contact: tuple[bool, ...] | None):
    """As :func:`.newton_kernel`, of steps; ``isotropic``: of round rods, straight at rest and undamped.

    slopes: with derivatives, in f64 and for any rods.
    contact: of rods that may touch something, whether there are grids, they rub, obstacles move, and they may touch themselves.
    """
    if contact is not None:
        *kind, itself = contact
        contacts = (SelfContacts if itself else RodContacts)(number, *kind)
        sweep = (DenseTimeSweep if itself else TimeImpact)(number, isotropic, stride, contacts)
        return loop_kernel("make_steps_in_contact", number, STEPS | OBSTACLES | MOTIONS, TimeLoop(sweep), block, brief=True)
    if slopes:
        return loop_kernel("make_steps_with_slopes", number, STEPS | SLOPES, TimeSlopeLoop(TimeSlopes(number, stride)), block)
    return loop_kernel("make_steps", number, STEPS, TimeLoop(TimeSweep(number, isotropic, stride)), block)


@dataclass
class Memory:
    """The state of R rods at their last two instants; changed in place as they move.

    frames, frames_before  (R, E, 4) unit quaternions at the last instant and at the one before
    places                 (R, V, 12): positions at both, mm, and velocities at both, mm/s. After a step of backward Euler among
                           others both velocities are that at its end, and both frames
    drift                  (R, 3) mm from the anchor to vertex 0 where that is free, else zero
    multiplier             (R, 3) λ of closure, in the kernel's units
    status                 (R,) Status: a rod whose step failed stays there
    """

    frames: np.ndarray
    frames_before: np.ndarray
    places: np.ndarray
    drift: np.ndarray
    multiplier: np.ndarray
    status: np.ndarray


@dataclass(frozen=True)
class Steps:
    """The steps of a launch.

    path   (S, steps, PATH_COLUMNS) of the clamps
    time   (TIME_COLUMNS,), see :mod:`doo_ti.relaxation.time_sweep`
    every  steps between the frames that are returned
    poses  (1 or R, 1 + steps, M, POSE_COLUMNS) of the obstacles, see :mod:`doo_ti.relaxation.time_loading`; None where none
           moves
    """

    path: np.ndarray
    time: np.ndarray
    every: int
    poses: np.ndarray | None = None


@dataclass
class Slopes:
    """Derivatives by P parameters of what R rods are given, and of what they remember; the latter change as they move."""

    material: np.ndarray  # (P, G, -) of the table of materials
    numbers: np.ndarray  # (P, N, V, 4) of inertia, drag, its growth with speed and load
    shares: np.ndarray  # (P, N, 2)
    memory: np.ndarray  # (R, P, V, REMEMBERED) see :mod:`.time_slopes`; zero where the start depends on no parameter

    @property
    def count(self) -> int:
        """P."""
        return len(self.material)


def slope_memory(memory_of: Callable[[np.ndarray], Memory], changes: np.ndarray) -> np.ndarray:
    """(R, P, V, REMEMBERED) derivatives of a memory along ``changes`` (R, P, V, 3), where its places are linear in a change and
    its frames depend smoothly on one: the latter by central differences."""
    slopes = np.zeros((*changes.shape[:3], REMEMBERED))
    if not changes.size:
        return slopes
    still = memory_of(np.zeros_like(changes[:, 0]))
    for p in range(changes.shape[1]):
        slopes[:, p, :, :CURVATURE_1] = memory_of(changes[:, p]).places - still.places
        small = 1e-4 * np.linalg.norm(still.places[:, -1, :3] - still.places[:, 0, :3], axis=-1).max()
        share = small / max(np.abs(slopes[:, p, :, PLACE_2 : PLACE_2 + 3]).max(), 1e-300)
        ahead, behind = (curvatures(memory_of(sign * share * changes[:, p]).frames_before) for sign in (1.0, -1.0))
        slopes[:, p, 2:, CURVATURE_2:] = (ahead - behind) / (2.0 * share)
    return slopes


def curvatures(frames: np.ndarray) -> np.ndarray:
    """(R, E − 1, 5) X, Y and m (:mod:`doo_ti.physics.pair`) at the joints of (R, E, 4) frames."""
    q = quaternion_product(conjugate(frames[:, :-1]), frames[:, 1:])
    z, bent = q[..., 0] + 1j * q[..., 1], q[..., 2] + 1j * q[..., 3]
    x, y = bent / z.conj(), bent / z
    return np.stack([x.real, x.imag, y.real, y.imag, 2.0 * np.arctan(q[..., 1] / q[..., 0])], axis=-1)


@runtime.exclusive
def make_steps(table: Tables, memory: Memory, steps: Steps, numbers: np.ndarray, shares: np.ndarray, options: Newton, bits: int,
               slopes: Slopes | None = None):
    """Carry the rods of ``table`` through ``steps``, from ``memory``, which is updated.

    numbers  (N, V, VERTEX_ITEMS − INERTIA), shares (N, 2): rows as the rods' ``external_index`` says
    slopes   what to differentiate by, in f64

    Returns positions (R, frames, V, 3) mm, NaN from where a rod failed, outcomes (R, frames, OUTCOMES), and the derivatives of
    positions (R, frames, P, V, 3) or None, the forces of contacts on vertices (R, frames, V, 3), energy per mm, or None, and
    their :class:`.Touch` (R, frames, V) or None.
    """
    rods = np.ascontiguousarray(table.rods[memory.status[table.rods[:, of.RESULT_ROW]] == Status.CONVERGED])
    rods[:, of.START_ROW] = of.FROM_RESULTS
    rods[:, of.EXTERNAL_ROW] = table.external_index[rods[:, of.RESULT_ROW]]
    count = steps.path.shape[1]
    frames = count // steps.every
    vertices = table.edges + 1
    positions, outcome = room(table.count, frames, vertices, 3), np.zeros((table.count, frames, OUTCOMES))
    positions[...], outcome[:, :, STATE] = np.nan, memory.status[:, None]
    results = np.zeros((table.count, of.LOADED_RESULTS))
    results[:, of.FORCE : of.FORCE + 3], results[:, of.DRIFT:] = memory.multiplier, memory.drift
    contact, more, kind = table.contact, {}, None
    forces = touches = position_slopes = None
    if contact is not None:
        kind = contact.has_grid, contact.rubs, steps.poses is not None, contact.itself
        forces, touches = room(table.count, frames, vertices, 3), np.zeros((table.count, frames, vertices), dtype=np.int32)
        forces[...] = 0.0
        more = contact.arguments(forces.reshape(-1, vertices, 3), options.gap_tolerance, in_motion=True) | {
            "touches": touches.reshape(-1, vertices), "pair_memory": contact.pair_memory, "rod_memory": contact.rod_memory,
            "poses": np.zeros((1, 1, 1, 1)) if steps.poses is None else steps.poses}
    if slopes is not None:
        position_slopes = room(table.count, frames, slopes.count, vertices, 3)
        position_slopes[...] = np.nan
        more = {"material_slopes": slopes.material.reshape(-1, slopes.material.shape[-1]), "number_slopes": slopes.numbers,
                "share_slopes": slopes.shares, "slopes": slopes.memory,
                "position_slopes": position_slopes.reshape(-1, slopes.count, vertices, 3)}
    for isotropic, part in table.by_material(rods):
        launch(layout_for(len(part), bits, contact is not None and contact.itself),
               partial(time_kernel, isotropic=isotropic and slopes is None, slopes=slopes is not None, contact=kind),
               rest_length=table.rest_length, clamp=table.clamp, path=steps.path, material=table.material, numbers=numbers,
               shares=shares, rods=part, policy=policy_row(table.up, options, bits), time=steps.time, steps=count,
               every=steps.every, frames=memory.frames.reshape(-1), frames_before=memory.frames_before.reshape(-1),
               places=memory.places, results=results, positions=positions.reshape(-1, vertices, 3), outcome=outcome, **more)
    if len(rods):
        memory.multiplier[:], memory.drift[:] = results[:, of.FORCE : of.FORCE + 3], results[:, of.DRIFT:]
        memory.status[:] = outcome[:, -1, STATE].astype(memory.status.dtype)
    return positions, outcome, position_slopes, forces, None if touches is None else touches.astype(np.int8)
