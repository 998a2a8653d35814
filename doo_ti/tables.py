"""What the kernels read: starts, clamps, materials and rods as plain tables, checked and laid out (§III-B).

A rod is a pair (configuration, material) of rows in two tables, so a sweep of D observations over G cells sends D starts
and G materials, not D·G of each.
"""

from dataclasses import dataclass, replace

import numpy as np

from doo_ti.errors import InputError
from doo_ti.frames import (
    FRAME_TOLERANCE,
    matrix_from_quaternion,
    orthonormality_error,
    quaternion_about,
    quaternion_from_matrix,
    quaternion_product,
    smallest_rotation,
)
from doo_ti.types import Clamp, Clamps, Configuration, Material

# Columns of a clamp: the far point from vertex 0, and flags that are one or zero (see doo_ti.chain); then what the rod between
# its clamps measures in mm: its length, its longest edge, its shortest two neighbours, and the largest moment arm of gravity
# on an edge (a length times a length).
TARGET, CLOSED, SPIN_START, TILT_START, SPIN_END, TILT_END, TILT_INNER, RELEASED = 0, 3, 4, 5, 6, 7, 8, 9
TOTAL, LONGEST, SHORTEST_PAIR, HANGING, CLAMP_COLUMNS = 10, 11, 12, 13, 14

# Columns of a material's section: weight μ, the largest eigenvalue of B, that or β where it is more, and one where the rod
# looks the same from all sides, so that it may spin about itself at no cost.
WEIGHT, LARGEST_BEND, STIFFEST, ROUND, SECTION_COLUMNS = 0, 1, 2, 3, 4

# Columns of a rod's results; the multiplier λ of closure has three.
ENERGY, RESIDUAL, CLOSURE, ITERATIONS, STATUS, STABLE, MULTIPLIER, RESULTS = 0, 1, 2, 3, 4, 5, 6, 9


TAUT = 1e-9
"""A rod whose slack is less than this share of its length is straight."""


@dataclass(frozen=True)
class Tables:
    """What the kernels read, all float64 and C-contiguous but ``rods``.

    start (S, E, 4) frames with the clamps imposed; rest_length (1 or S, E); clamp (S, CLAMP_COLUMNS);
    bend (G, 1 or E, 3) as (11, 22, 12); twist (G, 1 or E−1); rest (G, 1 or E−1, 2); section (G, SECTION_COLUMNS);
    rods (feasible ones, 4) int32: configuration, material, row of the results, and one where the rod starts from the frames in
    that row instead; feasible (S,) bool; anchor (S, 3) mm, the point the chain hangs from: vertex 0, or the far end where
    vertex 0 is free (released, (S,) bool); configuration_index and material_index (R,), infeasible rods included.
    """

    start: np.ndarray
    rest_length: np.ndarray
    clamp: np.ndarray
    bend: np.ndarray
    twist: np.ndarray
    rest: np.ndarray
    section: np.ndarray
    rods: np.ndarray
    feasible: np.ndarray
    anchor: np.ndarray
    isotropic: bool
    configuration_index: np.ndarray
    material_index: np.ndarray

    @property
    def edges(self) -> int:
        return self.start.shape[1]

    @property
    def count(self) -> int:
        """R."""
        return len(self.configuration_index)

    @property
    def released(self) -> np.ndarray:
        return self.clamp[:, RELEASED] > 0

    @property
    def weight(self) -> np.ndarray:
        """(G,) μ."""
        return self.section[:, WEIGHT]

    def hold_tangents(self, frames: np.ndarray, rows: np.ndarray) -> None:
        """Turn the end frames of the rods ``rows`` in ``frames`` (R, E, 4) back exactly to clamped tangents, in place."""
        for edge, spin, tilt in ((0, SPIN_START, TILT_START), (-1, SPIN_END, TILT_END)):
            turning = (self.clamp[:, spin] > 0) & (self.clamp[:, tilt] == 0)
            if not turning.any():
                continue
            held = rows[turning[self.configuration_index[rows]]]
            here, old = frames[held, edge], self.start[self.configuration_index[held], edge]
            here /= np.linalg.norm(here, axis=-1, keepdims=True)
            turn = smallest_rotation(matrix_from_quaternion(here)[..., 0], matrix_from_quaternion(old)[..., 0])
            frames[held, edge] = quaternion_product(turn, here)

    def continued(self, usable: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """``rods`` for another launch over the feasible ones of ``rows``: from their frames where ``usable`` (R,), else from
        their starts."""
        good = rows[self.feasible[self.configuration_index[rows]]]
        index = (self.configuration_index[good], self.material_index[good], good, usable[good])
        return np.ascontiguousarray(np.stack(index, axis=-1).astype(np.int32))

    def restarted(self, frames: np.ndarray) -> "Tables":
        """The same rods with a start each, ``frames`` (R, E, 4); infeasible ones keep what they had."""
        of_start = self.configuration_index
        feasible = self.feasible[of_start]
        rows = np.arange(self.count)
        lengths = self.rest_length
        return replace(
            self,
            start=np.ascontiguousarray(np.where(feasible[:, None, None], frames, self.start[of_start])),
            rest_length=lengths if len(lengths) == 1 else np.ascontiguousarray(lengths[of_start]),
            clamp=np.ascontiguousarray(self.clamp[of_start]),
            rods=_rods(rows, self.material_index, feasible),
            feasible=feasible,
            anchor=self.anchor[of_start],
            configuration_index=rows,
        )


def _rods(of_start: np.ndarray, of_material: np.ndarray, feasible: np.ndarray) -> np.ndarray:
    """``Tables.rods`` of the rods that are ``feasible`` (R,), each from its start."""
    rows = np.flatnonzero(feasible)
    rods = np.zeros((len(rows), 4), dtype=np.int32)
    rods[:, 0], rods[:, 1], rods[:, 2] = of_start[rows], of_material[rows], rows
    return rods


def tables(
    configuration: Configuration, material: Material, clamps: Clamps, up: np.ndarray,
    configuration_index=None, material_index=None,
) -> Tables:
    """Check what goes into F and lay it out for the kernels.

    Raises InputError where shapes do not match, an index is out of range, or both ends of a rod with weight are free.
    """
    _check_shapes(configuration, clamps)
    count, edges = configuration.count, configuration.edges
    lengths = np.ascontiguousarray(np.atleast_2d(configuration.rest_length), dtype=np.float64)
    if lengths.shape not in ((1, edges), (count, edges)):
        raise InputError("configuration", "rest_length", f"shape {lengths.shape}", f"give ({edges},) or ({count}, {edges})")
    if not (np.isfinite(lengths).all() and (lengths > 0).all()):
        raise InputError("configuration", "rest_length", f"{lengths.min():g}", "give positive lengths in mm")
    index_c, index_m = _pairs(count, material.count, configuration_index, material_index)
    start_kind, end_kind = (_kinds(name, getattr(clamps, name), count) for name in ("start", "end"))
    _check_frames("start_frame", clamps.start_frame, start_kind)
    _check_frames("end_frame", clamps.end_frame, end_kind)
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
    clamp, anchor = _clamp_table(configuration.start, lengths, start_kind, end_kind, clamps)
    free = _free_part(quaternions, lengths, clamp)
    closed = clamp[:, CLOSED] > 0
    # Two free edges at least leave the far point three ways to go.
    feasible = ~closed | ((free.span <= free.reach * (1 + 1e-12)) & (free.tilting.sum(axis=1) >= 2))
    quaternions = _bowed(quaternions, lengths, free, feasible & closed, up)
    quaternions = _stretched(quaternions, clamp, free, feasible & closed)
    bend = np.stack([material.bend[..., 0, 0], material.bend[..., 1, 1], material.bend[..., 0, 1]], axis=-1)
    return Tables(
        start=np.ascontiguousarray(quaternions),
        rest_length=np.ascontiguousarray(lengths),
        clamp=clamp,
        bend=np.ascontiguousarray(bend),
        twist=np.ascontiguousarray(material.twist),
        rest=np.ascontiguousarray(np.zeros((material.count, 1, 2)) if rest is None else rest),
        section=_section_table(bend, material),
        rods=_rods(index_c, index_m, feasible[index_c]),
        feasible=feasible,
        anchor=anchor,
        isotropic=material.is_isotropic,
        configuration_index=index_c,
        material_index=index_m,
    )


def _check_shapes(configuration: Configuration, clamps: Clamps) -> None:
    """Raise InputError unless starts and clamps are tables of the same rods."""
    shape = np.shape(configuration.quaternions)
    if not isinstance(configuration.quaternions, np.ndarray) or len(shape) != 3 or shape[2] != 4 or shape[1] < 2:
        raise InputError("configuration", "quaternions", f"shape {shape}", "give an array (R, E, 4) with at least two edges")
    needed = {"start_position": (shape[0], 3), "end_position": (shape[0], 3),
              "start_frame": (shape[0], 3, 3), "end_frame": (shape[0], 3, 3)}
    for source, field, array, wanted in (
        ("configuration", "start", configuration.start, (shape[0], 3)),
        *(("clamps", name, getattr(clamps, name), size) for name, size in needed.items()),
    ):
        if not isinstance(array, np.ndarray) or array.shape != wanted:
            raise InputError(source, field, f"shape {np.shape(array)}", f"give an array {wanted}, a row for each start")


def _check_frames(name: str, frames: np.ndarray, kind: np.ndarray) -> None:
    """Raise InputError where a frame that a clamp holds is finite but no rotation."""
    held = frames[kind == Clamp.FRAME]
    held = held[np.isfinite(held).all(axis=(1, 2)) & (np.abs(held).max(axis=(1, 2), initial=0) > 0)]
    bad = np.flatnonzero((orthonormality_error(held) > FRAME_TOLERANCE) | (np.linalg.det(held) < 0))
    if len(bad):
        raise InputError("clamps", name, f"{np.round(held[bad[0]], 4).tolist()} is no rotation",
                         "give unit, orthogonal columns t, m1, m2 with m2 = t x m1")


def _kinds(name: str, kind, count: int) -> np.ndarray:
    """(S,) Clamp numbers. Raises InputError for anything that is not one Clamp, or one for each start."""
    kind = np.asarray(kind)
    if kind.shape not in ((), (1,), (count,)) or not np.isin(kind, [int(known) for known in Clamp]).all():
        raise InputError("clamps", name, f"{kind.tolist()!r}", "give a Clamp, or one for each start")
    return np.broadcast_to(kind.astype(np.int64), count)


def _pairs(configurations: int, materials: int, configuration_index, material_index) -> tuple[np.ndarray, np.ndarray]:
    """The two index vectors, (R,) each; without them tables are paired one to one, a single row with every row."""
    if configuration_index is None and material_index is None:
        if configurations != materials and 1 not in (configurations, materials):
            raise InputError("relax", "material", f"{materials} rows for {configurations} rods", "give one, or one per rod")
        count = max(configurations, materials)
        return np.arange(count) % configurations, np.arange(count) % materials
    first = np.asarray(0 if configuration_index is None else configuration_index)
    second = np.asarray(0 if material_index is None else material_index)
    for name, index in (("configuration_index", first), ("material_index", second)):
        if index.size and index.dtype.kind not in "iu":
            raise InputError("relax", name, f"dtype {index.dtype}", "give whole row numbers")
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


@dataclass(frozen=True)
class _FreePart:
    """What the clamps leave of each rod: which edges may tilt (S, E), the line (S, 3) and its length, the span (S,), that
    they have to bridge, and how far they reach (S,), mm."""

    tilting: np.ndarray
    line: np.ndarray
    span: np.ndarray
    reach: np.ndarray


def _free_part(quaternions: np.ndarray, lengths: np.ndarray, clamp: np.ndarray) -> _FreePart:
    tilting = np.ones(quaternions.shape[:2])
    tilting[:, 0], tilting[:, -1] = clamp[:, TILT_START], clamp[:, TILT_END]
    tangents = matrix_from_quaternion(quaternions[:, [0, -1]])[..., 0]
    fixed = (lengths * (1 - tilting))[:, [0, -1], None] * tangents
    line = clamp[:, TARGET : TARGET + 3] - fixed.sum(axis=1)
    return _FreePart(tilting, line, np.linalg.norm(line, axis=-1), (lengths * tilting).sum(axis=1))


def _bowed(quaternions, lengths, free: _FreePart, closed, up) -> np.ndarray:
    """Starts that can be projected: free edges in one straight line have no first-order way to bring the far end closer.

    Where they are and must, they are bowed to the needed chord, downwards, or towards m1 where the line is upright.
    """
    edges = quaternions.shape[1]
    matrix = matrix_from_quaternion(quaternions)
    chord = np.linalg.norm(((lengths * free.tilting)[..., None] * matrix[..., 0]).sum(axis=1), axis=-1)
    share = free.span / free.reach
    rows = np.flatnonzero(closed & (chord > free.reach * (1 - 1e-8)) & (share < 1 - 1e-8))
    if not len(rows):
        return quaternions
    tilting = free.tilting[rows]
    middle = matrix[rows, edges // 2]
    axis = np.cross(-up, middle[..., 0])
    upright = np.linalg.norm(axis, axis=-1, keepdims=True) < 1e-3
    axis = np.where(upright, middle[..., 2], axis)
    axis /= np.linalg.norm(axis, axis=-1, keepdims=True)
    # A sine arch of slope a cos(π s/L) has the chord L (1 − a²/4).
    place = (np.cumsum(tilting, axis=1) - 0.5) / tilting.sum(axis=1, keepdims=True)
    slope = np.minimum(2 * np.sqrt(1 - share[rows]), 1.0)[:, None] * np.cos(np.pi * place) * tilting
    result = quaternions.copy()
    result[rows] = quaternion_product(quaternion_about(-axis[:, None] * np.ones((1, edges, 1)), slope), quaternions[rows])
    return result


def _stretched(quaternions, clamp, free: _FreePart, closed) -> np.ndarray:
    """Rods as long as their span: the one straight line they can be, with nothing left to relax but the spins.

    Their clamps are changed to say so; the turns of their frames are kept by parallel transport.
    """
    rows = np.flatnonzero(closed & (free.span > free.reach * (1 - TAUT)))
    if not len(rows):
        return quaternions
    tangents = matrix_from_quaternion(quaternions[rows])[..., 0]
    turn = smallest_rotation(tangents, (free.line[rows] / free.span[rows, None])[:, None])
    result = quaternions.copy()
    straight = quaternion_product(turn, quaternions[rows])
    result[rows] = np.where(free.tilting[rows, :, None] > 0, straight, quaternions[rows])
    clamp[rows[:, None], [CLOSED, TILT_START, TILT_END, TILT_INNER]] = 0.0
    return result


def _clamp_table(start, lengths, start_kind, end_kind, clamps):
    """(clamp table, anchor (S, 3)): see :class:`Tables`."""
    held_start, held_end = start_kind >= Clamp.POSITION, end_kind >= Clamp.POSITION
    first = np.where(held_start[:, None], clamps.start_position, start)
    last = np.where(held_end[:, None], clamps.end_position, 0.0)
    closed = held_start & held_end
    table = np.zeros((len(start), CLAMP_COLUMNS))
    table[:, TARGET : TARGET + 3] = np.where(closed[:, None], last - first, 0.0)
    table[:, CLOSED] = closed
    table[:, SPIN_START] = start_kind < Clamp.FRAME
    table[:, TILT_START] = start_kind < Clamp.TANGENT
    table[:, SPIN_END] = end_kind < Clamp.FRAME
    table[:, TILT_END] = end_kind < Clamp.TANGENT
    table[:, TILT_INNER] = 1.0
    released = ~held_start & held_end
    table[:, RELEASED] = released
    total = lengths.sum(axis=1)
    table[:, TOTAL] = total
    table[:, LONGEST] = lengths.max(axis=1)
    table[:, SHORTEST_PAIR] = (lengths[:, 1:] + lengths[:, :-1]).min(axis=1)
    beyond = total[:, None] - np.cumsum(lengths, axis=1)
    from_start, from_end = lengths + 2 * beyond, lengths + 2 * beyond - 2 * total[:, None]
    arms = (np.abs(lengths * arm).max(axis=1) for arm in (from_end, from_start))
    table[:, HANGING] = np.where(released, *arms)
    return table, np.where(released[:, None], last, first)


def _section_table(bend: np.ndarray, material: Material) -> np.ndarray:
    """(G, SECTION_COLUMNS): see the columns' names."""
    table = np.empty((material.count, SECTION_COLUMNS))
    table[:, WEIGHT] = material.weight
    table[:, ROUND] = 1.0
    largest = bend[..., 0]
    if not material.is_isotropic:
        half, apart = 0.5 * (bend[..., 0] + bend[..., 1]), 0.5 * (bend[..., 0] - bend[..., 1])
        largest = half + np.hypot(apart, bend[..., 2])
        table[:, ROUND] = ((apart == 0) & (bend[..., 2] == 0)).all(axis=1)
    if material.rest_curvature is not None:
        table[:, ROUND] *= (material.rest_curvature == 0).all(axis=(1, 2))
    table[:, LARGEST_BEND] = largest.max(axis=1)
    table[:, STIFFEST] = np.maximum(table[:, LARGEST_BEND], material.twist.max(axis=1))
    return table
