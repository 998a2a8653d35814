"""Many rods through many implicit time steps in one launch (docs/dynamics.md)."""

from dataclasses import dataclass

import numpy as np

from doo_ti import runtime
from doo_ti.relaxation import newton
from doo_ti.relaxation import tables as of
from doo_ti.relaxation.batch import _buffers, _machine
from doo_ti.relaxation.loading import LANES
from doo_ti.relaxation.newton_loop import CLOSING_DISTANCE
from doo_ti.relaxation.tables import Tables
from doo_ti.relaxation.time_kernel import time_kernel
from doo_ti.relaxation.time_loop import OUTCOMES, STATE
from doo_ti.types import Status


@dataclass
class Memory:
    """What R rods remember of their last two instants; changed in place as they move.

    frames, frames_before  (R, E, 4) unit quaternions at the last instant and at the one before
    places                 (R, V, 12): positions at both, mm, and velocities at both, mm/s
    drift                  (R, 3) mm from the anchor to vertex 0 where that is free, else zero
    status                 (R,) Status: a rod whose step failed moves no further
    """

    frames: np.ndarray
    frames_before: np.ndarray
    places: np.ndarray
    drift: np.ndarray
    status: np.ndarray


@runtime.exclusive
def make_steps(table: Tables, memory: Memory, path: np.ndarray, numbers: np.ndarray, shares: np.ndarray, time: np.ndarray,
               every: int, options: newton.Newton, bits: int) -> tuple[np.ndarray, np.ndarray]:
    """Carry the rods of ``table`` through the steps of ``path`` (S, steps, PATH_COLUMNS), from ``memory``, which is updated.

    numbers  (N, V, VERTEX_ITEMS − INERTIA), shares (N, 2): rows as the rods' ``external_index`` says
    time     (TIME_COLUMNS,), see :mod:`doo_ti.relaxation.time_sweep`
    every    steps between the frames that are returned

    Returns positions (R, frames, V, 3) mm, NaN from where a rod failed, and outcomes (R, frames, OUTCOMES).
    """
    rods = table.rods[memory.status[table.rods[:, of.RESULT_ROW]] == Status.CONVERGED]
    rods = np.ascontiguousarray(rods)
    rods[:, of.START_ROW] = of.FROM_RESULTS
    rods[:, of.EXTERNAL_ROW] = table.external_index[rods[:, of.RESULT_ROW]]
    steps = path.shape[1]
    frames = steps // every
    positions = np.full((table.count * frames, table.edges + 1, 3), np.nan)
    outcome = np.zeros((table.count, frames, OUTCOMES))
    outcome[:, :, STATE] = memory.status[:, None]
    if len(rods):
        number, threads, stride, block = _machine(len(rods), bits)
        kernel, items, parameters = time_kernel(number, table.isotropic, stride, block)
        scratch, _ = _buffers(number, threads, parameters + items * table.edges)
        queue = np.zeros(LANES + 2 * threads * number.width, dtype=np.int32)
        results = np.zeros((table.count, of.LOADED_RESULTS))
        results[:, of.DRIFT:] = memory.drift
        policy = np.array([
            *table.up, options.tolerance or newton.TOLERANCES[bits], options.max_iterations, options.first_shift,
            options.max_rotation, options.max_escapes, CLOSING_DISTANCE])
        kernel(table.rest_length, table.clamp, path, table.material, numbers, shares, rods, policy, time, steps, every, threads,
               scratch, queue, memory.frames.reshape(-1), memory.frames_before.reshape(-1), memory.places, results, positions,
               outcome)
        memory.drift[:] = results[:, of.DRIFT:]
        memory.status[:] = outcome[:, -1, STATE].astype(memory.status.dtype)
    return positions.reshape(table.count, frames, table.edges + 1, 3), outcome
