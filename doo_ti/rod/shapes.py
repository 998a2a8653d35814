"""Rods without observations, as starts of relaxations and motions: straight ones, ropes between two points, rods along given
curves and knotted ones (docs/contact.md); and clamps at the ends of a rod.

    rope, clamps = hanging(1000.0, 40, start=(0, 0, 0), end=(600, 0, 0))
    solution = relax(rope, Material.from_physical(EI=1e-3, GJ=1e-3, weight_per_length=0.5), clamps)

    rod = straight_rod(300.0, 30)
    solution = relax(rod, material, end_clamps(rod, Clamp.FRAME, Clamp.FREE))      # a cantilever

    rod = overhand_knot(300.0, 150, radius=1.0, loop=12.0)
    solution = relax(rod, material, end_clamps(rod, Clamp.TANGENT, Clamp.TANGENT), obstacles=[Itself()], radius=1.0)

Axes: R rods, E edges. Lengths are in mm.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from doo_ti.rod.frames import (
    across,
    arc_lengths,
    bishop_frames,
    conjugate,
    curve_length,
    placed,
    quaternion_from_matrix,
    quaternion_product,
    tangent_from_quaternion,
    unit_direction,
    unit_vectors,
)
from doo_ti.rod.material import doubt_length
from doo_ti.rod.types import LARGEST, Clamp, Clamps, Configuration, Material, unit_up
from doo_ti.system.arguments import typed
from doo_ti.system.errors import MOST_EDGES, InputError, real_array, require_whole

HALVINGS = 60  # of the interval that holds an arc's angle
LEAST_ACROSS = 1e-6  # of the direction against gravity, across a chord: below, the chord is vertical and any plane does


@typed
def straight_rod(length: float, edges: int, start: ArrayLike = (0.0, 0.0, 0.0),
                 direction: ArrayLike = (1.0, 0.0, 0.0), *, vertex_clamps: bool = False) -> Configuration:
    """One straight rod without twist, ``length`` mm long, from ``start`` (3,) mm in ``direction`` (3,) of any length. m1 is the
    coordinate axis least along the rod, made orthogonal (y of a rod along x, x of one along z), and m2 = t × m1.

    vertex_clamps  with an edge of length zero before the first of the ``edges`` and after the last: clamps of both ends then
                   act at the end vertices, not half an edge further in (:class:`~doo_ti.rod.types.Clamps`)

    Raises InputError for a length that is not positive, fewer than two edges or no direction.
    """
    length = _lengths("straight_rod", length, edges)
    begin, along = _points("straight_rod", "start", start)[0], unit_direction("straight_rod", "direction", direction)
    rod = Configuration.straight(begin, along, float(length[0]), edges)
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
    return rope, replace(end_clamps(rope, clamp, clamp), end_position=end.copy())


@typed
def end_clamps(configuration: Configuration, start: Clamp = Clamp.FRAME, end: Clamp = Clamp.FREE) -> Clamps:
    """The clamps that hold R rods by their ends where those are."""
    vertices, frames = configuration.vertices, configuration.frames
    ends = (vertices[:, 0], vertices[:, -1], frames[:, 0], frames[:, -1])
    return Clamps(Clamp(start), Clamp(end), *(values.copy() for values in ends))


def with_end_edges(rods: Configuration, held: tuple[bool, bool] = (True, True)) -> Configuration:
    """The rods with an edge of length zero at each end that is ``held``, in the direction of the curve there: the outer edge,
    turned on by half the angle of the joint that it has with the next."""
    frames, lengths = rods.quaternions, rods.rest_length
    none = np.zeros_like(lengths[..., :1])
    outer, inner = frames[:, [0, -1]], frames[:, [1, -2]]
    turn = quaternion_product(outer, conjugate(inner))
    turn = np.where(turn[..., :1] < 0, -turn, turn) + np.array([1.0, 0.0, 0.0, 0.0])  # half of it, once it has length one
    ends = quaternion_product(unit_vectors(turn), outer)
    kept = slice(1 - held[0], rods.edges + 1 + held[1])
    return Configuration(rods.start, np.concatenate([ends[:, :1], frames, ends[:, 1:]], axis=1)[:, kept],
                         np.concatenate([none, lengths, none], axis=-1)[..., kept])


def with_half_edges(rods: Configuration, held: tuple[bool, bool] = (True, True)) -> Configuration:
    """The rods, of rest lengths (E,), with edges half as long, from a quarter of the first edge to a quarter of the last one:
    held by their outer edges they begin to bend where ``rods`` do. At an end that is not ``held`` so the quarter is an edge."""
    frames, lengths = rods.quaternions, rods.rest_length
    after = np.where(np.sum(frames[:, :-1] * frames[:, 1:], axis=-1, keepdims=True) < 0, -frames[:, 1:], frames[:, 1:])
    fine, halves = np.empty((rods.count, 2 * rods.edges - 1, 4)), np.empty(2 * rods.edges - 1)
    fine[:, ::2], fine[:, 1::2] = frames, unit_vectors(frames[:, :-1] + after)
    halves[::2], halves[1::2] = lengths / 2, (lengths[:-1] + lengths[1:]) / 4
    more = (int(not held[0]), int(not held[1]))
    start = rods.start + held[0] * lengths[0] / 4 * tangent_from_quaternion(frames[:, 0])
    halves = np.concatenate([lengths[:1] / 4, halves, lengths[-1:] / 4])[1 - more[0] : len(halves) + 1 + more[1]]
    return Configuration(start, np.pad(fine, ((0, 0), more, (0, 0)), mode="edge"), halves)


def vertices_before_halving(fine: Configuration, lengths: np.ndarray, held: tuple[bool, bool] = (True, True)) -> np.ndarray:
    """(R, E + 1, 3) where the vertices of rods with rest ``lengths`` (E,) are on those :func:`with_half_edges`: to third order
    beside the middles of every other edge."""
    first, last = int(not held[0]), fine.edges - int(not held[1])
    x, t = fine.vertices[:, first : last + 1], tangent_from_quaternion(fine.quaternions[:, first:last])
    share, halves = (lengths[:-1] / (lengths[:-1] + lengths[1:]))[:, None], fine.rest_length[first:last][1::2, None]
    inner = x[:, 1:-1:2] + share * (x[:, 2::2] - x[:, 1:-1:2]) - halves / 16 * (t[:, 2::2] - t[:, :-1:2])
    start = x[:, :1] - lengths[0] / 4 * t[:, :1] if held[0] else fine.vertices[:, :1]
    end = x[:, -1:] + lengths[-1] / 4 * t[:, -1:] if held[1] else fine.vertices[:, -1:]
    return np.concatenate([start, inner, end], axis=1)


def material_of_half_edges(material: Material, held: tuple[bool, bool]) -> Material:
    """``material`` for rods :func:`with_half_edges`, where it differs along them."""
    def halved(values: np.ndarray | None) -> np.ndarray | None:
        return values if values is None or values.shape[1] == 1 else np.repeat(values, 2, axis=1)

    bend = material.bend
    if bend.shape[1] > 1:
        bend = np.stack([bend, 0.5 * (bend + np.roll(bend, -1, axis=1))], axis=2).reshape(len(bend), -1, 2, 2)[:, :-1]
    halves = replace(material, bend=bend, twist=halved(material.twist), rest_curvature=halved(material.rest_curvature))
    return material_of_end_edges(halves, (not held[0], not held[1]))


def material_of_end_edges(material: Material, held: tuple[bool, bool]) -> Material:
    """``material`` for rods :func:`with_end_edges`, where it differs along them: there as next to them."""
    def padded(values: np.ndarray | None) -> np.ndarray | None:
        if values is None or values.shape[1] == 1:
            return values
        return np.pad(values, ((0, 0), tuple(map(int, held)), *((0, 0),) * (values.ndim - 2)), mode="edge")

    return replace(material, bend=padded(material.bend), twist=padded(material.twist),
                   rest_curvature=padded(material.rest_curvature))


def material_curvature(rods: Configuration) -> np.ndarray:
    """(R, E−1, 2) curvature at the inner vertices, 1/mm, about m2 and −m1 half-way between the frames there, as materials state
    the curvature at rest."""
    binormal, middle = rods.curvature_binormal, 0.5 * (rods.frames[:, :-1] + rods.frames[:, 1:])
    return np.stack([np.sum(binormal * middle[..., 2], axis=-1), -np.sum(binormal * middle[..., 1], axis=-1)], axis=-1)


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


# --- along curves --------------------------------------------------------------------------------------------------------

EQUALISATIONS = 60  # rounds in which the vertices along a curve are moved until all edges have their lengths
APART = 1.25  # radii from the middle to the two strands that are laid around each other
BRAID, WIDE_BRAID = 8.0, 2.0  # radii, and √(radius · loop): half the length over which they are, the larger of the two
SAMPLES = 400  # points of each part of a knot's curve
LONGEST_EDGE, SHORT_EDGE = 0.5, 0.35
"""Of half the length of the strands, which make three half turns: the longest edges there with which a rod has the knot of its
curve; and the edges there where ``finer`` is not given."""
LOOP_EDGE = 0.5  # of the loop's radius: the longest edges elsewhere


@typed
def rod_along(points: ArrayLike, edges: int | ArrayLike, *, vertex_clamps: bool = False) -> Configuration:
    """One rod along the curve through ``points`` (N, 3) mm, from the first to the last and without twist. Its vertices are on
    the curve, so that it is a little shorter.

    edges          how many, all of one length, or (E,) how long they are compared with each other
    vertex_clamps  as in :func:`straight_rod`: the outer edges of length zero have the directions of the curve's ends, so that
                   two of them can be welded to each other without a joint

    Raises InputError for fewer than two points, points that are not finite or all the same, fewer than two edges, and lengths
    that are not positive.
    """
    points = real_array("rod_along", "points", points, "give points (N, 3) in mm").astype(np.float64)
    if points.ndim != 2 or points.shape[-1:] != (3,) or len(points) < 2 or not (np.abs(points) <= LARGEST).all():
        raise InputError("rod_along", "points", f"shape {points.shape}, or not finite", "give at least two points (N, 3) in mm")
    if np.ndim(edges) == 0:
        require_whole("rod_along", "edges", edges, 2, MOST_EDGES)
        edges = np.ones(edges)
    shares = real_array("rod_along", "edges", edges, "give a number, or the lengths of at least two").astype(np.float64)
    if shares.ndim != 1 or len(shares) < 2 or not ((shares > 0) & (shares <= LARGEST)).all():
        raise InputError("rod_along", "edges", f"shape {shares.shape}, or not positive", "give the lengths of at least two")
    arc = arc_lengths(points)
    if not arc[-1] > 0:
        raise InputError("rod_along", "points", "all the same", "give points along a curve")
    ends = np.concatenate([[0.0], np.cumsum(shares)]) / shares.sum()
    place = ends * arc[-1]
    for _ in range(EQUALISATIONS):
        vertices = placed(place, arc, points)
        reached = arc_lengths(vertices)
        place = np.interp(ends * reached[-1], reached, place)
    chord = np.linalg.norm(np.diff(vertices, axis=0), axis=-1)
    tangents = np.diff(vertices, axis=0) / chord[:, None]
    frames = bishop_frames(tangents[None], across(tangents[:1]))
    rod = Configuration(vertices[:1].copy(), quaternion_from_matrix(frames), chord)
    return with_end_edges(rod) if vertex_clamps else rod


@typed
def overhand_knot(length: float, edges: int, *, radius: float, loop: float, finer: float | None = None) -> Configuration:
    """One rod of that ``radius`` with an open overhand knot in its middle, both ends along x, its middle above the origin.

    The loop, of radius ``loop``, ends in two strands that are laid around each other with three half turns, and go on as the
    two ends of the rod. Where they are, edges are ``finer`` times shorter than elsewhere; unless given, as much as they
    have to be. ``length`` is that of the curve along which the rod is laid: edges are chords of it, and the rod itself is
    some 0.5 % shorter.

    Raises InputError for lengths that are not positive, edges that are too few for the strands, and a rod that is too short for
    its knot.
    """
    for name, value in (("length", length), ("radius", radius), ("loop", loop), ("finer", 1.0 if finer is None else finer)):
        if not 0 < value <= LARGEST:
            raise InputError("overhand_knot", name, f"{value!r}", "give a positive number")
    require_whole("overhand_knot", "edges", edges, 2, MOST_EDGES)
    doubt_length("overhand_knot", length)
    half, offset = max(BRAID * radius, WIDE_BRAID * np.sqrt(radius * loop)), APART * radius
    strand = np.linspace(-half, half, SAMPLES)
    angle = 0.5 * np.pi + 1.5 * np.pi * (strand / half + 1.0)
    braid = np.stack([strand, offset * np.sin(angle), offset * np.cos(angle)], axis=-1)
    other = braid * [1.0, -1.0, -1.0]
    turn = np.linspace(0.0, np.pi, SAMPLES)[1:-1]
    right = np.stack([half + loop * np.sin(turn), -offset - loop + loop * np.cos(turn), 0.0 * turn], axis=-1)
    knot = np.concatenate([braid, right, right[::-1] * [-1.0, 1.0, 1.0], other])
    tail = 0.5 * (length - curve_length(knot))
    if not tail > 0:
        raise InputError("overhand_knot", "length", f"{length:g} mm", f"give more than {length - 2 * tail:.4g} mm")
    ends = np.array([[tail, 0.0, 0.0]])
    points = np.concatenate([knot[:1] - ends, knot, knot[-1:] + ends])
    step = np.linalg.norm(np.diff(points, axis=0), axis=-1)
    number = np.arange(len(step))
    braided = (number > 0) & (number < SAMPLES) | (number >= len(step) - SAMPLES) & (number < len(step) - 1)
    if finer is None:
        outside, within = step[~braided].sum(), step[braided].sum()
        needed = outside / max(SHORT_EDGE * half * edges - within, 1e-9 * half)
        finer = max(1.0, min(needed, LOOP_EDGE * loop / (LONGEST_EDGE * half)))
    arc, fineness = (np.concatenate([[0.0], np.cumsum(step * weight)]) for weight in (1.0, np.where(braided, finer, 1.0)))
    fewest = int(np.ceil(fineness[-1] / min(LONGEST_EDGE * half * finer, LOOP_EDGE * loop)))
    if edges < fewest:
        raise InputError("overhand_knot", "edges", f"{edges} edges are too long for such a knot",
                         f"give at least {fewest}, or another `finer`")
    return rod_along(points, np.diff(np.interp(np.linspace(0.0, fineness[-1], edges + 1), fineness, arc)))
