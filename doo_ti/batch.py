"""The one door between host and device: tables of starts, clamps and materials in, results per rod out.

A rod is a pair (configuration, material) of rows in two tables, so a sweep of D observations over G cells sends D starts
and G materials, not D·G of each. Device scratch is allocated once per thread and reused, whatever the number of rods.
"""

from dataclasses import dataclass

import numpy as np

from doo_ti import chain, newton, runtime
from doo_ti.errors import InputError
from doo_ti.frames import matrix_from_quaternion, quaternion_from_matrix, quaternion_product, smallest_rotation
from doo_ti.physics.number import Number
from doo_ti.types import Clamp, Clamps, Configuration, Material, Status

_scratch: dict = {}


@dataclass(frozen=True)
class Tables:
    """What the kernels read, all float64 and C-contiguous but ``rods``.

    start (S, E, 4) frames with the clamps imposed; rest_length (1 or S, E); clamp (S, CLAMP_COLUMNS);
    bend (G, 1 or E, 3) as (11, 22, 12); twist (G, 1 or E−1); rest (G, 1 or E−1, 2); weight (G,);
    rods (R, 3) int32: configuration, material and row of the results; feasible (S,) bool; anchor (S, 3) mm, the point the
    chain hangs from: vertex 0, or the far end where vertex 0 is free.
    """

    start: np.ndarray
    rest_length: np.ndarray
    clamp: np.ndarray
    bend: np.ndarray
    twist: np.ndarray
    rest: np.ndarray
    weight: np.ndarray
    rods: np.ndarray
    feasible: np.ndarray
    anchor: np.ndarray
    isotropic: bool

    @property
    def edges(self) -> int:
        return self.start.shape[1]


def tables(configuration: Configuration, material: Material, clamps: Clamps, configuration_index, material_index) -> Tables:
    """Check what goes into F and lay it out for the kernels.

    Raises InputError where shapes do not match, an index is out of range, or both ends of a rod with weight are free.
    """
    count, edges = configuration.count, configuration.edges
    if edges < 2:
        raise InputError("configuration", "quaternions", f"{edges} edges", "give rods of at least two edges")
    lengths = np.atleast_2d(np.asarray(configuration.rest_length, dtype=np.float64))
    if lengths.shape not in ((1, edges), (count, edges)):
        raise InputError("configuration", "rest_length", f"shape {lengths.shape}", f"give ({edges},) or ({count}, {edges})")
    if not (np.isfinite(lengths).all() and (lengths > 0).all()):
        raise InputError("configuration", "rest_length", f"{lengths.min():g}", "give positive lengths in mm")
    index_c, index_m = _pairs(count, material.count, configuration_index, material_index)
    start_kind = np.broadcast_to(np.asarray(clamps.start, dtype=np.int64), count)
    end_kind = np.broadcast_to(np.asarray(clamps.end, dtype=np.int64), count)
    adrift = (start_kind == Clamp.FREE) & (end_kind == Clamp.FREE)
    if adrift.any() and (material.weight > 0).any():
        raise InputError("clamps", "start, end", "both ends are free and the rod has weight", "hold one end, or set weight 0")
    for name, array, length in (("twist", material.twist, edges - 1), ("bend", material.bend, edges)):
        if array.shape[1] not in (1, length):
            raise InputError("material", name, f"{array.shape[1]} entries along the rod", f"give one or {length}")
    rest = material.rest_curvature
    if rest is not None and rest.shape[1] not in (1, edges - 1):
        raise InputError("material", "rest_curvature", f"{rest.shape[1]} joints", f"give one or {edges - 1}")

    quaternions = _impose(configuration.quaternions, start_kind, end_kind, clamps)
    clamp, feasible, anchor = _clamp_table(configuration.start, quaternions, lengths, start_kind, end_kind, clamps)
    bend = np.stack([material.bend[..., 0, 0], material.bend[..., 1, 1], material.bend[..., 0, 1]], axis=-1)
    good = np.flatnonzero(feasible[index_c])
    rods = np.stack([index_c[good], index_m[good], good], axis=-1).astype(np.int32)
    return Tables(
        start=np.ascontiguousarray(quaternions),
        rest_length=np.ascontiguousarray(lengths),
        clamp=clamp,
        bend=np.ascontiguousarray(bend),
        twist=np.ascontiguousarray(material.twist),
        rest=np.ascontiguousarray(np.zeros((material.count, 1, 2)) if rest is None else rest),
        weight=np.ascontiguousarray(material.weight),
        rods=np.ascontiguousarray(rods),
        feasible=feasible,
        anchor=anchor,
        isotropic=material.is_isotropic,
    ), index_c, index_m


def _pairs(configurations: int, materials: int, configuration_index, material_index) -> tuple[np.ndarray, np.ndarray]:
    """The two index vectors, (R,) each; without them tables are paired one to one, a single row with every row."""
    if configuration_index is None and material_index is None:
        if configurations != materials and 1 not in (configurations, materials):
            raise InputError("relax", "material", f"{materials} rows for {configurations} rods", "give one, or one per rod")
        count = max(configurations, materials)
        return np.arange(count) % configurations, np.arange(count) % materials
    first = np.asarray(0 if configuration_index is None else configuration_index)
    second = np.asarray(0 if material_index is None else material_index)
    first, second = (np.ascontiguousarray(a, dtype=np.int64) for a in np.broadcast_arrays(first, second))
    for name, index, size in (("configuration_index", first, configurations), ("material_index", second, materials)):
        if index.ndim != 1 or (index.size and (index.min() < 0 or index.max() >= size)):
            raise InputError("relax", name, f"not a vector of rows below {size}", "give (R,) row numbers")
    return first, second


def _impose(quaternions: np.ndarray, start_kind: np.ndarray, end_kind: np.ndarray, clamps: Clamps) -> np.ndarray:
    """The start with its clamped frames in place; a tangent clamp turns the edge by parallel transport, keeping its spin."""
    result = np.array(quaternions, dtype=np.float64)
    for edge, kind, frame in ((0, start_kind, clamps.start_frame), (-1, end_kind, clamps.end_frame)):
        whole = kind == Clamp.FRAME
        if whole.any():
            result[whole, edge] = quaternion_from_matrix(frame[whole])
        tangent = kind == Clamp.TANGENT
        if tangent.any():
            old = result[tangent, edge]
            turn = smallest_rotation(matrix_from_quaternion(old)[..., 0], frame[tangent][..., 0])
            result[tangent, edge] = quaternion_product(turn, old)
    return result / np.linalg.norm(result, axis=-1, keepdims=True)


def _clamp_table(start, quaternions, lengths, start_kind, end_kind, clamps):
    """(clamp table, feasible (S,), anchor (S, 3)): see :class:`Tables`. Infeasible: what is left of the span, clamped edges
    taken off, exceeds the sum of the free rest lengths."""
    count, edges = len(quaternions), quaternions.shape[1]
    held_start, held_end = start_kind >= Clamp.POSITION, end_kind >= Clamp.POSITION
    first = np.where(held_start[:, None], clamps.start_position, start)
    last = np.where(held_end[:, None], clamps.end_position, 0.0)
    closed = held_start & held_end
    span = np.where(closed[:, None], last - first, 0.0)
    table = np.zeros((count, newton.CLAMP_COLUMNS))
    table[:, newton.TARGET : newton.TARGET + 3] = span
    table[:, newton.CLOSED] = closed
    table[:, newton.SPIN_START] = start_kind < Clamp.FRAME
    table[:, newton.TILT_START] = start_kind < Clamp.TANGENT
    table[:, newton.SPIN_END] = end_kind < Clamp.FRAME
    table[:, newton.TILT_END] = end_kind < Clamp.TANGENT
    table[:, newton.RELEASED] = ~held_start & held_end
    tilting = np.ones((count, edges), dtype=bool)
    tilting[:, 0], tilting[:, -1] = start_kind < Clamp.TANGENT, end_kind < Clamp.TANGENT
    tangents = matrix_from_quaternion(quaternions[:, [0, -1]])[..., 0]
    fixed = (lengths[:, [0, -1]] * ~tilting[:, [0, -1]])[..., None] * tangents
    reach = np.where(tilting, lengths, 0.0).sum(axis=1)
    needed = np.linalg.norm(span - fixed.sum(axis=1), axis=-1)
    # Two free edges at least leave the far point three ways to go.
    feasible = ~closed | ((needed <= reach * (1 + 1e-12)) & (tilting.sum(axis=1) >= 2))
    anchor = np.where(table[:, newton.RELEASED, None] > 0, last, first)
    return table, feasible, anchor


def run_newton(table: Tables, up: np.ndarray, options: newton.Newton, bits: int) -> tuple[np.ndarray, np.ndarray]:
    """Relax every feasible rod: (R, E, 4) frames and (R, RESULTS); infeasible rows hold NaN."""
    import taichi as ti

    count = len(table.rods)
    on_cpu = runtime.start() == "cpu"
    number = Number((16 if bits == 32 else 8) if on_cpu else 1, bits)
    threads = runtime.thread_count() if on_cpu else min(max(count, 1), 1 << 16)
    items = chain.ISOTROPIC_ITEMS if table.isotropic else chain.GENERAL_ITEMS
    kernel = newton.newton_kernel(number, table.isotropic, 1 if on_cpu else threads, 1 if on_cpu else 64)
    scratch, lane_rod, queue = _buffers(number, threads, items * table.edges)
    total = int(table.rods[:, 2].max(initial=-1)) + 1
    frames = np.full((total, table.edges, 4), np.nan, dtype=np.float32 if bits == 32 else np.float64)
    results = np.full((total, newton.RESULTS), np.nan)
    queue.fill(0)
    tolerance = options.tolerance or (1e-6 if bits == 32 else 1e-9)
    kernel(
        table.start, table.rest_length, table.clamp, table.bend, table.twist, table.rest, table.weight, table.rods,
        ti.math.vec3(*up), tolerance, options.max_iterations, options.first_shift, options.max_rotation,
        options.max_escapes, threads, items * table.edges if on_cpu else 1, scratch, lane_rod, queue, frames, results,
    )
    return frames, results


def _buffers(number: Number, threads: int, items: int):
    """Scratch for every thread, grown when needed and never shrunk."""
    import taichi as ti

    key = (number, threads)
    if key not in _scratch or _scratch[key][0].shape[0] < threads * items:
        _scratch[key] = (
            ti.ndarray(number.type, threads * items),
            ti.ndarray(ti.i32, threads * number.width),
            ti.ndarray(ti.i32, 1),
        )
    return _scratch[key]
