"""What the kernels read: starts, clamps, materials and rods as plain tables, checked and laid out (§III-B).

A rod is a pair (configuration, material) of rows in two tables, so a sweep of D observations over G cells sends D starts
and G materials, not D·G of each.
"""

from dataclasses import dataclass, replace

import numpy as np

from doo_ti.errors import InputError
from doo_ti.external import Springs
from doo_ti.frames import (
    FRAME_TOLERANCE,
    handedness,
    matrix_from_quaternion,
    orthonormality_error,
    quaternion_about,
    quaternion_from_matrix,
    quaternion_product,
    smallest_rotation,
    tangent_from_quaternion,
)
from doo_ti.types import Clamp, Clamps, Configuration, Material

# As plain numbers, which NumPy compares ten times faster than members of an enumeration.
FREE, POSITION, TANGENT, FRAME = (int(kind) for kind in Clamp)

# Columns of a clamp: the far point from vertex 0, and flags that are one or zero (see doo_ti.chain); then what the rod between
# its clamps measures in mm: its length, its longest edge, its shortest two neighbours, and the largest moment arm of gravity
# on an edge (a length times a length); and the point the chain hangs from, vertex 0 or, where that is free, the far end.
TARGET, CLOSED, SPIN_START, TILT_START, SPIN_END, TILT_END, TILT_INNER, RELEASED = 0, 3, 4, 5, 6, 7, 8, 9
TOTAL, LONGEST, SHORTEST_PAIR, HANGING, ANCHOR, CLAMP_COLUMNS = 10, 11, 12, 13, 14, 17

# Columns of a material's section: weight μ, the largest eigenvalue of B, that or β where it is more, one where the rod looks
# the same from all sides, so that it may spin about itself at no cost, and μ times the unit vector up.
WEIGHT, LARGEST_BEND, STIFFEST, ROUND, LIFT, SECTION_COLUMNS = 0, 1, 2, 3, 4, 7

# Columns of a rod's results; the multiplier λ of closure has three.
ENERGY, RESIDUAL, CLOSURE, ITERATIONS, STATUS, STABLE, MULTIPLIER, RESULTS = 0, 1, 2, 3, 4, 5, 6, 9

MOST_NUMBERS = 2**31 - 1
"""A table has no more entries: the kernels count them with 32 bits."""
TAUT = 1e-9
"""A rod whose slack is less than this share of its length is straight."""


@dataclass(frozen=True)
class Tables:
    """What the kernels read, all float64 and C-contiguous but ``rods``.

    start (S, E, 4) frames as given, of any length; ends (S, 2, 4) the first and the last of them normalised and with the clamps
    imposed, which stand in their place; rest_length (1 or S, E); clamp (S, CLAMP_COLUMNS);
    bend (G, 1 or E, 3) as (11, 22, 12); twist (G, 1 or E−1); rest (G, 1 or E−1, 2); section (G, SECTION_COLUMNS);
    rods (feasible ones, 5) int32: configuration, material, row of the results, one where the rod starts from the frames in
    that row instead, and row of the external energy; feasible (S,) bool; released (S,) bool: vertex 0 is free, the far end
    held; configuration_index, material_index and external_index (R,), infeasible rods included; external the external energy,
    or None; up (3,); floating: some rod has both ends free.
    """

    start: np.ndarray
    ends: np.ndarray
    rest_length: np.ndarray
    clamp: np.ndarray
    bend: np.ndarray
    twist: np.ndarray
    rest: np.ndarray
    section: np.ndarray
    rods: np.ndarray
    feasible: np.ndarray
    isotropic: bool
    configuration_index: np.ndarray
    material_index: np.ndarray
    external_index: np.ndarray
    external: Springs | None
    up: np.ndarray
    floating: bool

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
    def anchor(self) -> np.ndarray:
        """(S, 3) mm."""
        return self.clamp[:, ANCHOR : ANCHOR + 3]

    @property
    def weight(self) -> np.ndarray:
        """(G,) μ."""
        return self.section[:, WEIGHT]

    @property
    def whole(self) -> np.ndarray:
        """(S, E, 4) starts, normalised and with their ends imposed."""
        return _whole(self.start, self.ends)

    def hold_tangents(self, frames: np.ndarray, rows: np.ndarray) -> None:
        """Turn the end frames of the rods ``rows`` in ``frames`` (R, E, 4) back exactly to clamped tangents, in place."""
        for end, spin, tilt in ((0, SPIN_START, TILT_START), (1, SPIN_END, TILT_END)):
            turning = (self.clamp[:, spin] > 0) & (self.clamp[:, tilt] == 0)
            if not turning.any():
                continue
            held = rows[turning[self.configuration_index[rows]]]
            here, old = frames[held, -end], self.ends[self.configuration_index[held], end]
            here /= np.linalg.norm(here, axis=-1, keepdims=True)
            turn = smallest_rotation(tangent_from_quaternion(here), tangent_from_quaternion(old))
            frames[held, -end] = quaternion_product(turn, here)

    def continued(self, usable: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """``rods`` for another launch over the feasible ones of ``rows``: from their frames where ``usable`` (R,), else from
        their starts."""
        good = rows[self.feasible[self.configuration_index[rows]]]
        index = (self.configuration_index[good], self.material_index[good], good, usable[good], self.external_index[good])
        return np.ascontiguousarray(np.stack(index, axis=-1).astype(np.int32))

    def under(self, material: Material, index=None) -> "Tables":
        """The same rods under another material, one row for each or one for all, or as ``index`` (R,) says.

        Raises InputError where they do not match.
        """
        _check_material(material, self.edges, self.floating)
        if index is None and material.count not in (1, self.count):
            raise InputError(
                "relax_again", "material", f"{material.count} rows for {self.count} rods", "give one, or one per rod")
        rows = np.arange(self.count) % material.count if index is None else np.asarray(index)
        if rows.shape != (self.count,):
            raise InputError("relax_again", "material_index", f"shape {rows.shape}", f"give ({self.count},) row numbers")
        _, rows = _pairs(len(self.start), material.count, self.configuration_index, rows)
        return replace(self, material_index=rows, **_material_tables(material, self.up))

    def restarted(self, frames: np.ndarray) -> "Tables":
        """The same rods with a start each, ``frames`` (R, E, 4); infeasible ones keep what they had."""
        of_start = self.configuration_index
        feasible = self.feasible[of_start]
        rows = np.arange(self.count)
        lengths = self.rest_length
        start = np.ascontiguousarray(np.where(feasible[:, None, None], frames, self.start[of_start]))
        return replace(
            self,
            start=start,
            ends=np.ascontiguousarray(start[:, [0, -1]]),
            rest_length=lengths if len(lengths) == 1 else np.ascontiguousarray(lengths[of_start]),
            clamp=np.ascontiguousarray(self.clamp[of_start]),
            rods=_rods(rows, self.material_index, self.external_index, feasible),
            feasible=feasible,
            configuration_index=rows,
        )


def _rods(of_start: np.ndarray, of_material: np.ndarray, of_external: np.ndarray, feasible: np.ndarray) -> np.ndarray:
    """``Tables.rods`` of the rods that are ``feasible`` (R,), each from its start."""
    rows = np.flatnonzero(feasible)
    rods = np.zeros((len(rows), 5), dtype=np.int32)
    rods[:, 0], rods[:, 1], rods[:, 2], rods[:, 4] = of_start[rows], of_material[rows], rows, of_external[rows]
    return rods


def tables(
    configuration: Configuration, material: Material, clamps: Clamps, up: np.ndarray,
    configuration_index=None, material_index=None, external: Springs | None = None, external_index=None,
) -> Tables:
    """Check what goes into F and lay it out for the kernels.

    Raises InputError where shapes do not match, an index is out of range, both ends of a rod with weight are free, or a rod
    under an external energy has another end than the far one free.
    """
    _check_shapes(configuration, clamps)
    count, edges = configuration.count, configuration.edges
    lengths = np.ascontiguousarray(np.atleast_2d(configuration.rest_length), dtype=np.float64)
    if lengths.shape not in ((1, edges), (count, edges)):
        raise InputError("configuration", "rest_length", f"shape {lengths.shape}", f"give ({edges},) or ({count}, {edges})")
    if not (np.isfinite(lengths).all() and (lengths > 0).all()):
        raise InputError("configuration", "rest_length", f"{lengths.min():g}", "give positive lengths in mm")
    index_c, index_m = _pairs(count, material.count, configuration_index, material_index)
    if max(count, len(index_c)) * edges * 4 > MOST_NUMBERS:
        raise InputError("relax", "configuration", f"{max(count, len(index_c)):,} rods of {edges} edges in one call",
                         f"give at most {MOST_NUMBERS // (4 * edges):,} at a time")
    index_e = _external_rows(external, external_index, len(index_c), edges)
    start_kind, end_kind = (_kinds(name, getattr(clamps, name), count) for name in ("start", "end"))
    kinds = np.stack([start_kind, end_kind], axis=1)
    frames = np.stack([clamps.start_frame, clamps.end_frame], axis=1)
    _check_frames(frames, kinds)
    floating = bool(((start_kind == FREE) & (end_kind == FREE)).any())
    if external is not None and ((start_kind == FREE) | (end_kind != FREE)).any():
        raise InputError("clamps", "start, end", "an external energy needs the start held and the far end free",
                         "give Clamp.FREE as the end, another as the start")
    _check_material(material, edges, floating)
    start = np.ascontiguousarray(configuration.quaternions, dtype=np.float64)
    ends = _imposed(start[:, [0, -1]], kinds, frames)
    clamp = _clamp_table(configuration.start, lengths, start_kind, end_kind, clamps)
    free = _free_part(ends, lengths, clamp)
    closed = clamp[:, CLOSED] > 0
    # Two free edges at least leave the far point three ways to go.
    feasible = ~closed | ((free.span <= free.reach * (1 + 1e-12)) & (free.tilting.sum(axis=1) + edges - 2 >= 2))
    start, ends = _bowed(start, ends, lengths, free, feasible & closed, up)
    start, ends = _stretched(start, ends, clamp, free, feasible & closed)
    return Tables(
        start=start,
        ends=ends,
        rest_length=lengths,
        clamp=clamp,
        **_material_tables(material, up),
        rods=_rods(index_c, index_m, index_e, feasible[index_c]),
        feasible=feasible,
        configuration_index=index_c,
        material_index=index_m,
        external_index=index_e,
        external=external,
        up=up,
        floating=floating,
    )


def _check_material(material: Material, edges: int, floating: bool) -> None:
    """Raise InputError where ``material`` does not go with rods of so many edges, or of which some float, held by nothing."""
    if floating and (material.weight > 0).any():
        raise InputError("clamps", "start, end", "both ends are free and the rod has weight", "hold one end, or set weight 0")
    for name, array, length in (("twist", material.twist, edges - 1), ("bend", material.bend, edges)):
        if array.shape[1] not in (1, length):
            raise InputError("material", name, f"{array.shape[1]} entries along the rod", f"give one or {length}")
    rest = material.rest_curvature
    if rest is not None and rest.shape[1] not in (1, edges - 1):
        raise InputError("material", "rest_curvature", f"{rest.shape[1]} joints", f"give one or {edges - 1}")


def _material_tables(material: Material, up: np.ndarray) -> dict:
    """The fields of :class:`Tables` that come from the material alone."""
    bend = np.stack([material.bend[..., 0, 0], material.bend[..., 1, 1], material.bend[..., 0, 1]], axis=-1)
    rest = material.rest_curvature
    return {
        "bend": np.ascontiguousarray(bend),
        "twist": np.ascontiguousarray(material.twist),
        "rest": np.ascontiguousarray(np.zeros((material.count, 1, 2)) if rest is None else rest),
        "section": _section_table(bend, material, up),
        "isotropic": material.is_isotropic,
    }


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


def _check_frames(frames: np.ndarray, kinds: np.ndarray) -> None:
    """Raise InputError where one of the frames (S, 2, 3, 3) that clamps hold is finite but no rotation."""
    wrong = (kinds == FRAME) & ((orthonormality_error(frames) > FRAME_TOLERANCE) | (handedness(frames) < 0))
    for row, end in np.argwhere(wrong):
        frame = frames[row, end]
        # A frame of zeros says that there is none.
        if np.isfinite(frame).all() and frame.any():
            raise InputError("clamps", ("start_frame", "end_frame")[end], f"{np.round(frame, 4).tolist()} is no rotation",
                             "give unit, orthogonal columns t, m1, m2 with m2 = t x m1")


def _kinds(name: str, kind, count: int) -> np.ndarray:
    """(S,) Clamp numbers. Raises InputError for anything that is not one Clamp, or one for each start."""
    if isinstance(kind, Clamp):
        return np.full(count, int(kind))
    kind = np.asarray(kind)
    known = kind.dtype.kind in "iuf" and bool(((kind >= FREE) & (kind <= FRAME) & (kind == kind.astype(int))).all())
    if kind.shape not in ((), (1,), (count,)) or not known:
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


def _external_rows(external: Springs | None, index, count: int, edges: int) -> np.ndarray:
    """(R,) rows of the external energy; without ``index`` rods and rows are paired one to one, or all have the one row."""
    if external is None:
        if index is not None:
            raise InputError("relax", "external_index", "given without an external energy", "give both, or neither")
        return np.zeros(count, dtype=np.int64)
    if external.vertices != edges + 1:
        raise InputError("external", "points", f"{external.vertices} vertices", f"give {edges + 1}, as the rods have")
    if index is None:
        if external.count not in (1, count):
            raise InputError("relax", "external", f"{external.count} rows for {count} rods", "give one, or one for each rod")
        return np.arange(count) % external.count
    rows = np.asarray(index)
    whole = rows.shape == (count,) and rows.dtype.kind in "iu"
    if not whole or (rows.size and (rows.min() < 0 or rows.max() >= external.count)):
        raise InputError("relax", "external_index", f"not {count} rows below {external.count}", "give (R,) row numbers")
    return rows.astype(np.int64)


def _imposed(ends: np.ndarray, kinds: np.ndarray, frames: np.ndarray) -> np.ndarray:
    """The two end frames (S, 2, 4) with what the clamps hold in place; a tangent clamp turns the edge by parallel transport,
    keeping its spin."""
    result = ends / np.linalg.norm(ends, axis=-1, keepdims=True)
    whole = kinds == FRAME
    if whole.any():
        result[whole] = quaternion_from_matrix(frames[whole])
    tangent = kinds == TANGENT
    if tangent.any():
        old = result[tangent]
        turned = quaternion_product(smallest_rotation(tangent_from_quaternion(old), frames[tangent][..., 0]), old)
        result[tangent] = turned / np.linalg.norm(turned, axis=-1, keepdims=True)
    return result


def _whole(start: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """(S, E, 4) ``start`` normalised, with ``ends`` in their place."""
    result = start / np.linalg.norm(start, axis=-1, keepdims=True)
    result[:, 0], result[:, -1] = ends[:, 0], ends[:, 1]
    return result


@dataclass(frozen=True)
class _FreePart:
    """What the clamps leave of each rod: which of the end edges may tilt (S, 2), as all inner ones may, the line (S, 3) and
    its length, the span (S,), that the free edges have to bridge, and how far they reach (S,), mm."""

    tilting: np.ndarray
    line: np.ndarray
    span: np.ndarray
    reach: np.ndarray


def _free_part(ends: np.ndarray, lengths: np.ndarray, clamp: np.ndarray) -> _FreePart:
    tilting = clamp[:, [TILT_START, TILT_END]]
    held = lengths[:, [0, -1]] * (1 - tilting)
    line = clamp[:, TARGET : TARGET + 3] - (held[..., None] * tangent_from_quaternion(ends)).sum(axis=1)
    return _FreePart(tilting, line, np.linalg.norm(line, axis=-1), clamp[:, TOTAL] - held.sum(axis=1))


def _bowed(start, ends, lengths, free: _FreePart, closed, up) -> tuple[np.ndarray, np.ndarray]:
    """Starts that can be projected: free edges in one straight line have no first-order way to bring the far end closer.

    Where they are and must, they are bowed to the needed chord, downwards, or towards m1 where the line is upright.
    """
    edges = start.shape[1]
    share = free.span / free.reach
    # Straight rods have their inner edges in line: two of them tell most others apart.
    rows = np.flatnonzero(closed & (share < 1 - 1e-8) & _in_line(start[:, [min(1, edges - 1), edges // 2]]))
    if not len(rows):
        return start, ends
    tilting = np.ones((len(rows), edges))
    tilting[:, 0], tilting[:, -1] = free.tilting[rows].T
    whole = _whole(start[rows], ends[rows])
    matrix = matrix_from_quaternion(whole)
    own = lengths if len(lengths) == 1 else lengths[rows]
    chord = np.linalg.norm(((own * tilting)[..., None] * matrix[..., 0]).sum(axis=1), axis=-1)
    straight = chord > free.reach[rows] * (1 - 1e-8)
    rows, tilting, whole, matrix = rows[straight], tilting[straight], whole[straight], matrix[straight]
    middle = matrix[:, edges // 2]
    axis = np.cross(-up, middle[..., 0])
    upright = np.linalg.norm(axis, axis=-1, keepdims=True) < 1e-3
    axis = np.where(upright, middle[..., 2], axis)
    axis /= np.linalg.norm(axis, axis=-1, keepdims=True)
    # A sine arch of slope a cos(π s/L) has the chord L (1 − a²/4).
    place = (np.cumsum(tilting, axis=1) - 0.5) / tilting.sum(axis=1, keepdims=True)
    slope = np.minimum(2 * np.sqrt(1 - share[rows]), 1.0)[:, None] * np.cos(np.pi * place) * tilting
    turn = quaternion_about(-axis[:, None] * np.ones((1, edges, 1)), slope)
    return _changed(start, ends, rows, quaternion_product(turn, whole))


def _in_line(frames: np.ndarray) -> np.ndarray:
    """(S,) bool: the tangents of the two frames (S, 2, 4) point the same way, about."""
    tangents = tangent_from_quaternion(frames / np.linalg.norm(frames, axis=-1, keepdims=True))
    return np.abs(tangents[:, 0] - tangents[:, 1]).max(axis=-1) < 1e-2


def _stretched(start, ends, clamp, free: _FreePart, closed) -> tuple[np.ndarray, np.ndarray]:
    """Rods as long as their span: the one straight line they can be, with nothing left to relax but the spins.

    Their clamps are changed to say so; the turns of their frames are kept by parallel transport.
    """
    rows = np.flatnonzero(closed & (free.span > free.reach * (1 - TAUT)))
    if not len(rows):
        return start, ends
    whole = _whole(start[rows], ends[rows])
    tangents = tangent_from_quaternion(whole)
    turn = smallest_rotation(tangents, (free.line[rows] / free.span[rows, None])[:, None])
    straight = quaternion_product(turn, whole)
    for edge, tilting in zip((0, -1), free.tilting[rows].T):
        straight[:, edge] = np.where(tilting[:, None] > 0, straight[:, edge], whole[:, edge])
    clamp[rows[:, None], [CLOSED, TILT_START, TILT_END, TILT_INNER]] = 0.0
    return _changed(start, ends, rows, straight)


def _changed(start, ends, rows, quaternions) -> tuple[np.ndarray, np.ndarray]:
    """``start`` and ``ends`` with other frames in some rows; what was given is left as it is."""
    start, ends = start.copy(), ends.copy()
    start[rows], ends[rows] = quaternions, quaternions[:, [0, -1]]
    return start, ends


def _clamp_table(start, lengths, start_kind, end_kind, clamps):
    """(S, CLAMP_COLUMNS): see the columns' names."""
    held_start, held_end = start_kind >= POSITION, end_kind >= POSITION
    first = np.where(held_start[:, None], clamps.start_position, start)
    last = np.where(held_end[:, None], clamps.end_position, 0.0)
    closed = held_start & held_end
    table = np.zeros((len(start), CLAMP_COLUMNS))
    table[:, TARGET : TARGET + 3] = np.where(closed[:, None], last - first, 0.0)
    table[:, CLOSED] = closed
    table[:, SPIN_START] = start_kind < FRAME
    table[:, TILT_START] = start_kind < TANGENT
    table[:, SPIN_END] = end_kind < FRAME
    table[:, TILT_END] = end_kind < TANGENT
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
    table[:, ANCHOR : ANCHOR + 3] = np.where(released[:, None], last, first)
    return table


def _section_table(bend: np.ndarray, material: Material, up: np.ndarray) -> np.ndarray:
    """(G, SECTION_COLUMNS): see the columns' names."""
    table = np.empty((material.count, SECTION_COLUMNS))
    table[:, WEIGHT] = material.weight
    table[:, LIFT : LIFT + 3] = material.weight[:, None] * up
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
