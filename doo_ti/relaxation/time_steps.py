"""Many rods through many implicit time steps in one launch (docs/dynamics.md)."""

from collections.abc import Callable
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np

from doo_ti.relaxation import newton
from doo_ti.relaxation import tables as of
from doo_ti.relaxation.batch import Launch, laid_out, layout_for, policy_row
from doo_ti.relaxation.tables import Tables, room
from doo_ti.relaxation.time_kernel import time_contact_kernel, time_kernel, time_slope_kernel
from doo_ti.relaxation.time_layout import PLACE_2
from doo_ti.relaxation.time_loop import OUTCOMES, STATE
from doo_ti.relaxation.time_slopes import CURVATURE_1, CURVATURE_2, REMEMBERED
from doo_ti.rod.frames import quaternion_product
from doo_ti.rod.types import Status
from doo_ti.system import runtime


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


@dataclass
class Slopes:
    """Derivatives by P parameters of what R rods are given, and of what they remember; the latter change as they move.

    material  (P, G, -) of the table of materials
    numbers   (P, N, V, 4) of inertia, drag, its growth with speed and load
    shares    (P, N, 2)
    memory    (R, P, V, REMEMBERED) see :mod:`doo_ti.relaxation.time_slopes`; zero where the start depends on no parameter
    """

    material: np.ndarray
    numbers: np.ndarray
    shares: np.ndarray
    memory: np.ndarray

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
    q = quaternion_product(frames[:, :-1] * [1.0, -1.0, -1.0, -1.0], frames[:, 1:])
    z, bent = q[..., 0] + 1j * q[..., 1], q[..., 2] + 1j * q[..., 3]
    x, y = bent / z.conj(), bent / z
    return np.stack([x.real, x.imag, y.real, y.imag, 2.0 * np.arctan(q[..., 1] / q[..., 0])], axis=-1)


@runtime.exclusive
def make_steps(table: Tables, memory: Memory, path: np.ndarray, numbers: np.ndarray, shares: np.ndarray, time: np.ndarray,
               every: int, options: newton.Newton, bits: int, slopes: Slopes | None = None, poses: np.ndarray | None = None):
    """Carry the rods of ``table`` through the steps of ``path`` (S, steps, PATH_COLUMNS), from ``memory``, which is updated.

    numbers  (N, V, VERTEX_ITEMS − INERTIA), shares (N, 2): rows as the rods' ``external_index`` says
    time     (TIME_COLUMNS,), see :mod:`doo_ti.relaxation.time_sweep`
    every    steps between the frames that are returned
    slopes   what to differentiate by, in f64
    poses    (1 or R, 1 + steps, M, POSE_COLUMNS) of the obstacles, see :mod:`doo_ti.relaxation.obstacle_motion`; None where
             none moves

    Returns positions (R, frames, V, 3) mm, NaN from where a rod failed, outcomes (R, frames, OUTCOMES), and the derivatives of
    positions (R, frames, P, V, 3) or None, the forces of contacts on vertices (R, frames, V, 3), energy per mm, or None, and
    their :class:`.Touch` (R, frames, V) or None.
    """
    rods = np.ascontiguousarray(table.rods[memory.status[table.rods[:, of.RESULT_ROW]] == Status.CONVERGED])
    rods[:, of.START_ROW] = of.FROM_RESULTS
    rods[:, of.EXTERNAL_ROW] = table.external_index[rods[:, of.RESULT_ROW]]
    steps = path.shape[1]
    frames = steps // every
    positions = room(table.count * frames, table.edges + 1, 3)
    positions[...] = np.nan
    outcome = np.zeros((table.count, frames, OUTCOMES))
    contact = table.contact
    forces = touches = None
    if contact is not None:
        forces = room(table.count * frames, table.edges + 1, 3)
        forces[...] = 0.0
        touches = np.zeros((table.count * frames, table.edges + 1), dtype=np.int32)
    outcome[:, :, STATE] = memory.status[:, None]
    position_slopes = None
    if slopes is not None:
        position_slopes = room(table.count * frames, slopes.count, table.edges + 1, 3)
        position_slopes[...] = np.nan
    moves = poses is not None
    poses = poses if moves else np.zeros((1, 1, 1, 1))
    results = np.zeros((table.count, of.LOADED_RESULTS))
    results[:, of.FORCE : of.FORCE + 3], results[:, of.DRIFT:] = memory.multiplier, memory.drift
    for isotropic, part in table.by_material(rods):
        kernel, threads, scratch, queue = _laid_out(table, isotropic, len(part), bits, slopes, moves)
        more = ()
        if contact is not None:
            more = (*contact.arguments(forces, options.gap_tolerance, in_motion=True), touches, poses, contact.pair_memory,
                    contact.rod_memory)
        elif slopes is not None:
            material = slopes.material.reshape(-1, slopes.material.shape[-1])
            more = material, slopes.numbers, slopes.shares, slopes.memory, position_slopes
        kernel(table.rest_length, table.clamp, path, table.material, numbers, shares, part,
               policy_row(table.up, options, bits), time, steps, every, threads, scratch, queue, memory.frames.reshape(-1),
               memory.frames_before.reshape(-1), memory.places, results, positions, outcome, *more)
    if len(rods):
        memory.multiplier[:], memory.drift[:] = results[:, of.FORCE : of.FORCE + 3], results[:, of.DRIFT:]
        memory.status[:] = outcome[:, -1, STATE].astype(memory.status.dtype)
    if slopes is not None:
        position_slopes = position_slopes.reshape(table.count, frames, slopes.count, table.edges + 1, 3)
    if contact is not None:
        forces = forces.reshape(table.count, frames, table.edges + 1, 3)
        touches = touches.reshape(table.count, frames, table.edges + 1).astype(np.int8)
    return positions.reshape(table.count, frames, table.edges + 1, 3), outcome, position_slopes, forces, touches


def _laid_out(table: Tables, isotropic: bool, rods: int, bits: int, slopes: Slopes | None, moves: bool) -> Launch:
    """The launch of so many rods of one kind, with obstacles that move if ``moves``."""
    contact, given = table.contact, SimpleNamespace(rest_length=table.rest_length)
    layout = layout_for(rods, bits, contact is not None and contact.itself)
    if contact is not None:
        given.kinds, known = contact.kinds, (contact.known, contact.rubs, contact.itself, moves)
        return laid_out(layout, lambda *layout: time_contact_kernel(*layout, isotropic, *known), given)
    if slopes is not None:
        given.number_slopes = slopes.numbers
        return laid_out(layout, time_slope_kernel, given)
    return laid_out(layout, lambda *layout: time_kernel(*layout, isotropic), given)
