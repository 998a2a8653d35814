"""The one door between host and device: tables in, results per rod out.

Device scratch is allocated once per thread and reused, whatever the number of rods.
"""

import numpy as np

from doo_ti import chain, descent, newton, runtime
from doo_ti.frames import matrix_from_quaternion, quaternion_from_matrix, vertices_from_quaternions
from doo_ti.physics.number import Number
from doo_ti.tables import ITERATIONS, RESULTS, STATUS, Tables, divisors
from doo_ti.types import Status
from doo_ti.vertex_chain import ITEMS

PROJECTIONS = 100
"""Rounds in which Descent's starts are brought onto closure."""

_scratch: dict = {}


def run_newton(table: Tables, up: np.ndarray, options: newton.Newton, bits: int, moving: bool = True):
    """Relax every feasible rod: (R, E, 4) frames and (R, RESULTS), NaN in infeasible rows.

    With ``moving`` false only the projection runs, which brings a start onto closure.
    """
    import taichi as ti

    number, threads, stride, block = _machine(len(table.rods), bits)
    items = chain.ISOTROPIC_ITEMS if table.isotropic else chain.GENERAL_ITEMS
    kernel = newton.newton_kernel(number, table.isotropic, stride, block)
    scratch, lane_rod, queue = _buffers(number, threads, items * table.edges)
    frames = np.full((table.count, table.edges, 4), np.nan)
    results = np.full((table.count, RESULTS), np.nan)
    kernel(
        table.start, table.rest_length, table.clamp, table.bend, table.twist, table.rest, table.weight, table.rods,
        divisors(table), ti.Vector(list(up), dt=ti.f64), options.tolerance or (1e-6 if bits == 32 else 1e-9),
        options.max_iterations, options.first_shift, options.max_rotation, options.max_escapes,
        newton.CLOSING_DISTANCE if moving else -1.0,
        threads, items * table.edges if stride == 1 else 1, scratch, lane_rod, queue, frames, results,
    )
    return frames, results


def run_descent(table: Tables, up: np.ndarray, options: descent.Descent, bits: int):
    """Relax every feasible rod by the paper's scheme, from its start projected onto closure; as :func:`run_newton`.

    The residual, the status and the certificate are those of the chain of frames, so that they mean the same for both
    solvers: a rod has converged if its moments say so there.
    """
    import taichi as ti

    projection = newton.Newton(max_iterations=PROJECTIONS)
    closed, _ = run_newton(table, up, projection, 64, moving=False)
    table = table.restarted(closed, np.isfinite(closed[:, 0, 0]))
    vertices, directors = _vertex_form(table)
    number, threads, stride, block = _machine(len(table.rods), bits)
    items = ITEMS * (table.edges + 1)
    scratch, lane_rod, queue = _buffers(number, threads, items)
    positions = np.full((table.count, table.edges + 1, 3), np.nan)
    axes = np.full((table.count, table.edges, 3), np.nan)
    results = np.full((table.count, RESULTS), np.nan)
    descent.descent_kernel(number, stride, block)(
        vertices, directors, table.rest_length, table.clamp, table.bend, table.twist, table.rest, table.weight,
        table.rods, divisors(table), ti.Vector(list(up), dt=ti.f64), options.tolerance, options.max_iterations,
        options.largest_move, threads, items if stride == 1 else 1, scratch, lane_rod, queue, positions, axes, results,
    )
    frames = _chain_form(positions, axes)
    certificate = newton.Newton(tolerance=options.tolerance, max_iterations=1, first_shift=0.0, max_escapes=0)
    frames, certified = run_newton(table.restarted(frames, np.isfinite(frames[:, 0, 0])), up, certificate, 64)
    good = certified[:, STATUS] == Status.CONVERGED
    # What came to rest by its own account but not by that of the chain (its clamp not reached, say) has stalled.
    own = np.where(results[:, STATUS] == Status.CONVERGED, Status.STALLED, results[:, STATUS])
    certified[:, STATUS] = np.where(good, Status.CONVERGED, own)
    certified[:, ITERATIONS] = results[:, ITERATIONS]
    return frames, certified


def _vertex_form(table: Tables) -> tuple[np.ndarray, np.ndarray]:
    """Starts as vertices from the anchor (S, V, 3) and m1 (S, E, 3)."""
    vertices = vertices_from_quaternions(np.zeros((len(table.start), 3)), table.start, table.rest_length)
    vertices = np.where(table.released[:, None, None], vertices - vertices[:, -1:], vertices)
    return np.ascontiguousarray(vertices), np.ascontiguousarray(matrix_from_quaternion(table.start)[..., 1])


def _chain_form(vertices: np.ndarray, first_directors: np.ndarray) -> np.ndarray:
    """(R, E, 4) frames from vertices and m1."""
    edges = np.diff(vertices, axis=1)
    tangents = edges / np.linalg.norm(edges, axis=-1, keepdims=True)
    m1 = first_directors - np.sum(first_directors * tangents, axis=-1, keepdims=True) * tangents
    m1 /= np.linalg.norm(m1, axis=-1, keepdims=True)
    return quaternion_from_matrix(np.stack([tangents, m1, np.cross(tangents, m1)], axis=-1))


def _machine(rods: int, bits: int) -> tuple[Number, int, int, int]:
    """(kind of number, threads, item stride, block) that suit the architecture Taichi runs on."""
    if runtime.start() == "cpu":
        return Number(16 if bits == 32 else 8, bits), runtime.thread_count(), 1, 1
    threads = min(max(rods, 1), 1 << 16)
    return Number(1, bits), threads, threads, 64


def _buffers(number: Number, threads: int, items: int):
    """(scratch for every thread, rod of every lane, queue set to zero); scratch grows when needed and never shrinks."""
    import taichi as ti

    key = (number, threads)
    if key not in _scratch or _scratch[key][0].shape[0] < threads * items:
        _scratch[key] = (
            ti.ndarray(number.type, threads * items),
            ti.ndarray(ti.i32, threads * number.width),
            ti.ndarray(ti.i32, 1),
        )
    _scratch[key][2].fill(0)
    return _scratch[key]
