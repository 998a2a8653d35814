"""Rods along given curves, and knotted ones, as starts of relaxations and motions (docs/contact.md).

    rod = overhand_knot(300.0, 150, radius=1.0, loop=12.0)
    solution = relax(rod, material, end_clamps(rod, Clamp.TANGENT, Clamp.TANGENT), obstacles=[Itself()], radius=1.0)

Lengths are in mm.
"""

import numpy as np
from numpy.typing import ArrayLike

from doo_ti.rod.frames import across, bishop_frames, quaternion_from_matrix
from doo_ti.rod.physical_units import doubt_length
from doo_ti.rod.straight import with_end_edges
from doo_ti.rod.types import LARGEST, Configuration
from doo_ti.system.arguments import typed
from doo_ti.system.errors import MOST_EDGES, InputError, real_array, require_whole

EQUALISATIONS = 60
"""Rounds in which the vertices along a curve are moved until all edges have their lengths."""
APART = 1.25
"""Radii from the middle to the two strands that are laid around each other."""
BRAID, WIDE_BRAID = 8.0, 2.0
"""Radii, and √(radius · loop): half the length over which they are, the larger of the two."""
SAMPLES = 400
"""Points of each part of a knot's curve."""
LONGEST_EDGE, SHORT_EDGE = 0.5, 0.35
"""Of half the length of the strands, which make three half turns: the longest edges there with which a rod has the knot of its
curve; and the edges there where ``finer`` is not given."""
LOOP_EDGE = 0.5
"""Of the loop's radius: the longest edges elsewhere."""


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
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=-1))])
    if not arc[-1] > 0:
        raise InputError("rod_along", "points", "all the same", "give points along a curve")
    ends = np.concatenate([[0.0], np.cumsum(shares)]) / shares.sum()
    place = ends * arc[-1]
    for _ in range(EQUALISATIONS):
        vertices = np.stack([np.interp(place, arc, column) for column in points.T], axis=-1)
        chord = np.linalg.norm(np.diff(vertices, axis=0), axis=-1)
        reached = np.concatenate([[0.0], np.cumsum(chord)])
        place = np.interp(ends * reached[-1], reached, place)
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
    tail = 0.5 * (length - np.linalg.norm(np.diff(knot, axis=0), axis=-1).sum())
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
