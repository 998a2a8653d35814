"""Rods without observations: straight ones, ropes between two points, and clamps at the ends of a rod.

    rope, clamps = hanging(1000.0, 40, start=(0, 0, 0), end=(600, 0, 0))
    solution = relax(rope, Material.from_physical(EI=1e-3, GJ=1e-3, weight_per_length=0.5), clamps)

    rod = straight_rod(300.0, 30)
    solution = relax(rod, material, end_clamps(rod, Clamp.FRAME, Clamp.FREE))      # a cantilever

Axes: R rods, E edges. Lengths are in mm.
"""

import numpy as np
from numpy.typing import ArrayLike

from doo_ti.rod.frames import across, bishop_frames, conjugate, quaternion_from_matrix, quaternion_product
from doo_ti.rod.physical_units import doubt_length
from doo_ti.rod.types import LARGEST, Clamp, Clamps, Configuration, unit_up
from doo_ti.system.arguments import typed
from doo_ti.system.errors import MOST_EDGES, InputError, real_array, require_whole

HALVINGS = 60
"""Of the interval that holds an arc's angle."""
LEAST_ACROSS = 1e-6
"""Of the direction against gravity, across a chord: below, the chord is vertical and any plane does."""


@typed
def straight_rod(length: float, edges: int, start: ArrayLike = (0.0, 0.0, 0.0),
                 direction: ArrayLike = (1.0, 0.0, 0.0), *, vertex_clamps: bool = False) -> Configuration:
    """One straight rod without twist, ``length`` mm long, from ``start`` (3,) mm in ``direction`` (3,) of any length.

    vertex_clamps  with an edge of length zero before the first of the ``edges`` and after the last: clamps of both ends then
                   act at the end vertices, not half an edge further in (:class:`~doo_ti.rod.types.Clamps`)

    Raises InputError for a length that is not positive, fewer than two edges or no direction.
    """
    length = _lengths("straight_rod", length, edges)
    rod = Configuration.straight(_points("straight_rod", "start", start)[0], _direction("straight_rod", direction),
                                 float(length[0]), edges)
    return with_end_edges(rod) if vertex_clamps else rod


@typed
def hanging(length: ArrayLike, edges: int, start: ArrayLike, end: ArrayLike, *, clamp: Clamp = Clamp.POSITION,
            up: ArrayLike = (0.0, 0.0, 1.0), vertex_clamps: bool = False) -> tuple[Configuration, Clamps]:
    """R ropes that hang between two points, ready for ``relax``: the start Γ, an arc that sags, and the clamps C.

    length      mm; one number, or (R,)
    start, end  (R, 3) or (3,) mm; one row serves all
    clamp       how both ends are held: POSITION, as by knots; TANGENT or FRAME: also in the directions that the arc has there
    up          (3,) direction against gravity; give ``relax`` the same
    vertex_clamps  as in :func:`straight_rod`

    Points further apart than the rope is long are no error: ``relax`` reports such a rope as infeasible. Raises InputError for
    lengths and points that are not finite numbers.
    """
    length = _lengths("hanging", length, edges)
    points = [_points("hanging", name, value) for name, value in (("start", start), ("end", end))]
    counts = {len(values) for values in (*points, length) if len(values) > 1}
    if len(counts) > 1:
        raise InputError("hanging", "length, start, end", f"{', '.join(map(str, sorted(counts)))} rows",
                         "give one row, or as many as there are ropes")
    start, end = (np.broadcast_to(values, (max(counts, default=1), 3)) for values in points)
    up = unit_up(up, "hanging")
    chord = end - start
    span = np.linalg.norm(chord, axis=-1)
    level = across(up[None])[0]
    along = np.where(span[:, None] > 0, chord / np.where(span > 0, span, 1.0)[:, None], level)
    down = -(up - (along @ up)[:, None] * along)
    size = np.linalg.norm(down, axis=-1, keepdims=True)
    down = np.where(size > LEAST_ACROSS, down / np.maximum(size, LEAST_ACROSS), across(along))
    angle = _arc_angle(np.minimum(span / length, 1.0), edges)[:, None] * (1 - (2 * np.arange(edges) + 1) / edges)
    tangents = np.cos(angle)[..., None] * along[:, None] + np.sin(angle)[..., None] * down[:, None]
    frames = bishop_frames(tangents, across(tangents[:, 0]))
    rest_length = np.repeat(length[:, None] / edges, edges, axis=1)
    rope = Configuration(start.copy(), quaternion_from_matrix(frames), rest_length if len(length) > 1 else rest_length[0])
    rope = with_end_edges(rope) if vertex_clamps else rope
    held = end_clamps(rope, clamp, clamp)
    return rope, Clamps(held.start, held.end, held.start_position, end.copy(), held.start_frame, held.end_frame)


@typed
def end_clamps(configuration: Configuration, start: Clamp = Clamp.FRAME, end: Clamp = Clamp.FREE) -> Clamps:
    """The clamps that hold R rods by their ends where those are."""
    vertices, frames = configuration.vertices, configuration.frames
    ends = (vertices[:, 0], vertices[:, -1], frames[:, 0], frames[:, -1])
    return Clamps(Clamp(start), Clamp(end), *(values.copy() for values in ends))


def with_end_edges(rods: Configuration) -> Configuration:
    """The rods with an edge of length zero at each end, in the direction of the curve there: the outer edge, turned on by half
    the angle of the joint that it has with the next."""
    frames, lengths = rods.quaternions, rods.rest_length
    none = np.zeros_like(lengths[..., :1])
    ends = [_turned_on(frames[:, second], frames[:, first])[:, None] for first, second in ((0, 1), (-1, -2))]
    return Configuration(rods.start, np.concatenate([ends[0], frames, ends[1]], axis=1),
                         np.concatenate([none, lengths, none], axis=-1))


def _turned_on(before: np.ndarray, last: np.ndarray) -> np.ndarray:
    """(R, 4) the frames ``last``, turned on by half the rotation from ``before`` to them."""
    turn = quaternion_product(last, conjugate(before))
    turn = np.where(turn[:, :1] < 0, -turn, turn) + np.array([1.0, 0.0, 0.0, 0.0])
    return quaternion_product(turn / np.linalg.norm(turn, axis=-1, keepdims=True), last)


def _arc_angle(share: np.ndarray, edges: int) -> np.ndarray:
    """(R,) the angle a in [0, π] from the chord to the end tangents of a regular chain of ``edges`` whose span is that
    ``share`` (R,) of its length: sin a = share E sin(a/E)."""
    low, high = np.zeros(len(share)), np.full(len(share), np.pi)
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        longer = np.sin(middle) > share * edges * np.sin(middle / edges)
        low, high = np.where(longer, middle, low), np.where(longer, high, middle)
    return 0.5 * (low + high)


def _lengths(function: str, length: ArrayLike, edges: int) -> np.ndarray:
    """(1,) or (R,) f64: lengths, checked together with ``edges``."""
    values = real_array(function, "length", length, "give numbers of mm").astype(np.float64)
    wrong = ~((values > 0) & (values <= LARGEST))
    if values.ndim > 1 or not values.size or wrong.any():
        problem = f"{values[wrong].flat[0]:g}" if wrong.any() else f"shape {values.shape}"
        raise InputError(function, "length", problem, "give a positive number of mm, or (R,) of them")
    require_whole(function, "edges", edges, 2, MOST_EDGES)
    doubt_length(function, values)
    return np.atleast_1d(values)


def _points(function: str, name: str, value: ArrayLike) -> np.ndarray:
    """(R, 3) f64."""
    points = real_array(function, name, value, "give points (R, 3) in mm").astype(np.float64)
    points = points[None] if points.ndim == 1 else points
    if points.ndim != 2 or points.shape[-1] != 3 or not len(points) or not (np.abs(points) <= LARGEST).all():
        raise InputError(function, name, f"shape {points.shape}, or not finite", "give points (3,) or (R, 3) in mm")
    return points


def _direction(function: str, direction: ArrayLike) -> np.ndarray:
    value = _points(function, "direction", direction)[0]
    if not (size := np.linalg.norm(value)) > 0:
        raise InputError(function, "direction", f"{value.tolist()}", "give three numbers, not all zero")
    return value / size
