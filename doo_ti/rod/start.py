"""From an observation to the input of F: its clamps C, the start Γ, and the whole turns it may hold (§III-B, §III-D)."""

from dataclasses import replace
from typing import Annotated

import numpy as np

from doo_ti.rod.frames import (
    FRAME_TOLERANCE,
    angle_about,
    bishop_frames,
    is_rotation,
    matrix_from_quaternion,
    quaternion_about,
    quaternion_from_matrix,
    quaternion_product,
    smallest_rotation,
    some_frames,
    turned_about_tangent,
    unit_vectors,
)
from doo_ti.rod.observations import Observations
from doo_ti.rod.types import Clamp, Clamps, Configuration
from doo_ti.system.arguments import typed
from doo_ti.system.errors import MOST_EDGES, InputError, require_whole

MOST_LENGTHS = 2.0  # largest distance of a mark from the first, over the rod's length: a label is never that wrong
LEAST_LENGTHS = 0.1  # smallest sum of the distances between neighbouring marks, over the rod's length between them
LEAST_EDGE = 1e-6  # shortest edge, over the mean edge
MOST_LENGTHS_OFF = 1e9  # largest coordinate, over the rod's length
TWICE_PER_RAD = 2.0 ** (0.5 / np.pi)  # for each rad of twist: twice for a whole turn


@typed
def observation_clamps(observations: Observations, start: Clamp | None = None, end: Clamp | None = None) -> Clamps:
    """The clamps of D observations; by default the whole frame where it is given, else the tangent.

    Positions are the observed vertices 0 and E, tangents those of the given frame, else of the observed edge; they do not
    depend on the rest lengths, unless an outer mark is missing: then it is taken to be on the line through the two marks next
    to it. A FRAME clamp may also use the measured ``frames``.

    Raises InputError for a FRAME clamp without a frame.
    """
    kinds, frames, vertices = [], [], fill_missing(observations)
    for name, edge, kind, frame in (("start", 0, start, observations.start_frame), ("end", -1, end, observations.end_frame)):
        kind = (Clamp.TANGENT if frame is None else Clamp.FRAME) if kind is None else Clamp(kind)
        if kind == Clamp.FRAME and frame is None:
            if observations.frames is None:
                raise InputError(observations.source, f"{name}_frame", f"missing, but `clamp_{name}` frame needs it",
                                 f"add {name}_frame (D, 3, 3), or clamp that end's tangent or position")
            frame = observations.frames[:, edge]
        kinds.append(kind)
        frames.append(some_frames(directions(observations)[:, edge]) if frame is None else
                      matrix_from_quaternion(quaternion_from_matrix(frame)))  # exactly orthonormal
    return Clamps(*kinds, vertices[:, 0], vertices[:, -1], *frames)


def check_experiment(observations: Observations, clamps: Clamps, weight: float, frame_weight: float,
                     whole_edges: bool = True) -> None:
    """Raise InputError for an observation that cannot be relaxed: clamps that :func:`check_feasible` refuses, a rod with weight
    and two free ends, fewer than two free edges, marks that no rod of that length reaches, and a frame weight w_m without
    measured frames. ``whole_edges`` as in :func:`reachable`."""
    free = (np.asarray(clamps.start) == Clamp.FREE) & (np.asarray(clamps.end) == Clamp.FREE)
    if weight > 0 and free.any():
        raise InputError(observations.source, "clamps", "both ends are free and the rod has weight", "hold one end")
    observations.require_frames(frame_weight)
    clamped = sum(np.asarray(kind) >= Clamp.TANGENT for kind in (clamps.start, clamps.end))
    if (observations.edges - clamped < 2).any():
        raise InputError(observations.source, "vertices_mm", f"{observations.edges} edges, too few of them free to relax",
                         "give more marks, or clamp only positions")
    _check_reach(observations)
    check_feasible(observations, clamps if whole_edges else _by_position(clamps))


def _check_reach(observations: Observations) -> None:
    """Raise InputError for marks too far apart (:data:`MOST_LENGTHS`) or too close together (:data:`LEAST_LENGTHS`), which are
    in another unit or of another rod, for marks so far from the origin that rounding hides them, and for edges far shorter than
    the others."""
    edges, length = observations.rest_length, observations.length
    if edges.min() < LEAST_EDGE * edges.mean():
        raise InputError(observations.source, "rest_length_mm", f"{edges.min():.4g} mm at edge {int(np.argmin(edges))}, and "
                         f"{edges.mean():.4g} mm on average", "leave one of its two marks out")
    first = observations.vertices[np.arange(observations.count), observations.valid.argmax(axis=1)][:, None]
    away = np.linalg.norm(np.where(observations.valid[..., None], observations.vertices, first) - first, axis=-1)
    if np.abs(first).max() > MOST_LENGTHS_OFF * length:
        raise InputError(observations.source, "vertices_mm", f"{np.abs(first).max():.4g} mm from the origin, and the rod "
                         f"{length:.4g} mm long", "choose an origin nearby")
    if (away > MOST_LENGTHS * length).any():
        d, v = np.unravel_index(np.argmax(away), away.shape)
        raise InputError(observations.source, "vertices_mm", f"vertex {v} of observation {observations.labels[d]} is "
                         f"{away[d, v]:.4g} mm away from the first one, and the rod {length:.4g} mm long",
                         "correct it, or rest_length_mm, or mark it false in valid")
    both = observations.valid[:, 1:] & observations.valid[:, :-1]
    steps = np.linalg.norm(np.diff(np.where(observations.valid[..., None], observations.vertices, first), axis=1), axis=-1)
    if both.any() and (np.where(both, steps, 0.0).sum(axis=1) < LEAST_LENGTHS * both @ observations.rest_length).all():
        raise InputError(observations.source, "rest_length_mm", f"{length:.4g} mm in all, but the marks are "
                         f"{steps[both].mean():.4g} mm apart on average", "give lengths in mm of the edges between marks")


def reachable(observations: Observations, clamps: Clamps, whole_edges: bool = True) -> np.ndarray:
    """(D,) bool: where clamps are no further apart than the rod is long.

    whole_edges  whether clamps hold the whole outer edges, along their frames, as those of a rod whose vertices are the marks
    """
    # A taut rod has no slack: rounding must not make it infeasible.
    clamps = clamps if whole_edges else _by_position(clamps)
    return span_excess(clamps, observations.rest_length) <= 1e-9 * observations.length


def _by_position(clamps: Clamps) -> Clamps:
    """The same ends, whose directions are not held."""
    return replace(clamps, start=np.minimum(clamps.start, Clamp.POSITION), end=np.minimum(clamps.end, Clamp.POSITION))


def require_frames(source: str, name: str, kind, frames: np.ndarray) -> None:
    """Raise InputError, naming the argument ``name`` of ``source``, where ``frames`` (R, …, 3, 3) that ``kind``, one Clamp or
    (R,) of them, holds are no rotations, or tangents that it holds no unit vectors. Those that are not finite pass."""
    kind = np.broadcast_to(np.asarray(kind), (len(frames),))
    whole, tangents = frames[kind == Clamp.FRAME], frames[kind == Clamp.TANGENT][..., 0]
    whole, tangents = whole[np.isfinite(whole).all(axis=(-2, -1))], tangents[np.isfinite(tangents).all(axis=-1)]
    if not is_rotation(whole).all() or (np.abs(np.linalg.norm(tangents, axis=-1) - 1) > FRAME_TOLERANCE).any():
        raise InputError(source, name, "no frame that can be held",
                         "give unit, orthogonal columns t, m1, m2 with m2 = t x m1; of a tangent t at least")


def check_feasible(observations: Observations, clamps: Clamps) -> None:
    """Raise InputError where clamps are further apart than the rod is long, naming the observation and by how much."""
    excess = span_excess(clamps, observations.rest_length)
    bad = np.flatnonzero(~reachable(observations, clamps))
    if len(bad):
        worst = bad[np.argmax(excess[bad])]
        others = f" (and {len(bad) - 1} more observations)" if len(bad) > 1 else ""
        raise InputError(observations.source, "vertices_mm", f"the clamps of observation {observations.labels[worst]} are "
                         f"{excess[worst]:.4g} mm further apart than the rod between them reaches{others}",
                         _remedy(observations, clamps))


def _remedy(observations: Observations, clamps: Clamps) -> str:
    """What to do about clamps that are too far apart."""
    if reachable(observations, clamps, whole_edges=False).all():
        first, last = observations.rest_length[[0, -1]]
        return (f"here frames hold the whole outer edges, {first:.4g} and {last:.4g} mm: place marks next to the clips, or "
                "start refine from the file with --bend and --twist, which learns how much the clips hold")
    return "correct the end vertices or frames, or rest_length_mm"


def span_excess(clamps: Clamps, rest_length: np.ndarray) -> np.ndarray:
    """(R,) mm by which the span, clamped edges taken off, exceeds the sum of the free rest lengths; −inf at a free end.

    rest_length is (E,) or (R, E).
    """
    near, near_length = _free_tip(clamps.start, clamps.start_position, clamps.start_frame, rest_length[..., 0], 1.0)
    far, far_length = _free_tip(clamps.end, clamps.end_position, clamps.end_frame, rest_length[..., -1], -1.0)
    free = np.sum(rest_length, axis=-1) - near_length - far_length
    loose = (np.asarray(clamps.start) == Clamp.FREE) | (np.asarray(clamps.end) == Clamp.FREE)
    return np.where(loose, -np.inf, np.linalg.norm(far - near, axis=-1) - free)


@typed
def turn_hypotheses(observations: Annotated[Observations, "D"], clamps: Annotated[Clamps, "D"]
                    ) -> tuple[np.ndarray, np.ndarray]:
    """(N,) observation_index and (N,) whole turns: the rods to start for D observations.

    The turns are added to the angle in (−π, π] that the clamped frames leave. Between two whole frames without a hint
    they may be −1, 0 or +1, one rod each; a hint (``total_twist``) gives the one turn nearest to it; measured
    ``frames`` contain their own turns and an end that rolls freely has none, so there it is 0.
    """
    both = np.broadcast_to(_holds_spin(clamps.start) & _holds_spin(clamps.end), observations.count)
    turns = np.zeros(observations.count, dtype=np.int64)
    if observations.frames is not None:
        return np.arange(observations.count), turns
    if observations.total_twist is not None:
        angle = _closing_angle(_bishop(observations, clamps), clamps)
        nearest = np.round((observations.total_twist - angle) / (2 * np.pi)).astype(np.int64)
        return np.arange(observations.count), np.where(both, nearest, turns)
    index, rank = np.nonzero(both[:, None] | [False, True, False])
    return index, rank - 1


def held_spins(observations: Observations, clamps: Clamps, spin: np.ndarray) -> Clamps:
    """Clamps on whole frames where the tangent alone was known: ends that leave the angle ``spin`` (D,), rad, between the
    parallel-transported m1 of the first edge and the last edge's.

    Of two such ends the last one takes the angle: a common turn of both changes nothing in a round rod.
    """
    count = observations.count
    unknown_end = np.broadcast_to(np.asarray(clamps.end) == Clamp.TANGENT, count)
    whole = replace(clamps, start=Clamp.FRAME, end=Clamp.FRAME)
    bishop = _bishop(observations, whole)
    lacking = spin - _closing_angle(bishop, whole)
    end_frame = turned_about_tangent(whole.end_frame, np.where(unknown_end, lacking, 0.0))
    start_frame = turned_about_tangent(whole.start_frame, np.where(unknown_end, 0.0, -lacking))
    return replace(whole, start_frame=start_frame, end_frame=end_frame)


@typed
def choose_hypothesis(observation_index: Annotated[np.ndarray, "N"], score: Annotated[np.ndarray, "N"],
                      sound: Annotated[np.ndarray, "N"], twist: Annotated[np.ndarray | None, "N"] = None) -> np.ndarray:
    """(D,) rows of the (N,) hypotheses with the smallest score of each observation, among those that are ``sound`` (N,)
    where there are any: a rod that did not converge is still near its start, so that its score means little. NaN counts as the
    largest.

    twist  (N,) rad, total twists of the rods: one that is twisted by a whole turn more must be twice as near. Under another
           stiffness than that of the observed rod all are off, and a little less or more says nothing about turns

    Equal scores go to the first row.
    """
    score = score if twist is None else score * TWICE_PER_RAD ** np.abs(twist)
    order = np.lexsort((np.where(np.isnan(score), np.inf, score), ~sound.astype(bool), observation_index))
    first = np.concatenate([[True], np.diff(observation_index[order]) != 0])[: len(order)]
    return order[first]


@typed
def start_configuration(
    observations: Annotated[Observations, "D"], clamps: Annotated[Clamps, "D"], turns: Annotated[np.ndarray | None, "D"] = None
) -> Configuration:
    """The start Γ of D rods: observed edge directions, rest lengths, and frames that meet the clamped ones.

    Between two whole frames the total twist is the angle that the parallel-transported m1 of the first edge lacks to
    the last edge's, plus ``turns`` (D,) whole turns, spread in proportion to l̄_i; an end that rolls freely leaves no twist.
    Without ``turns`` the turn is the one nearest to the hint, and 0 without one. Measured ``frames`` are started from
    as they are. Missing marks are interpolated along the rod. The chain keeps the rest lengths, so its far end need
    not meet the clamp: F closes it. For several hypotheses per observation take the rows first:

        index, turns = turn_hypotheses(observations, clamps)
        start_configuration(observations.take(index), clamps.take(index), turns)
    """
    if observations.frames is not None:
        quaternions = quaternion_from_matrix(observations.frames)
        ends = ((0, clamps.start, clamps.start_frame), (-1, clamps.end, clamps.end_frame))
        for edge, kind, frame in ends:
            quaternions[:, edge] = _clamped(quaternions[:, edge], kind, frame)
    else:
        bishop = _bishop(observations, clamps)
        if turns is None:
            turns = np.zeros(observations.count)
            if observations.total_twist is not None:
                turns = turn_hypotheses(observations, clamps)[1]
        closing, both = _closing_angle(bishop, clamps), _holds_spin(clamps.start) & _holds_spin(clamps.end)
        # Where the start rolls freely the whole rod turns to meet the end's frame, without twist.
        offset, total = np.where(both, 0.0, closing), np.where(both, closing + 2 * np.pi * np.asarray(turns), 0.0)
        angle = offset[:, None] + total[:, None] * twist_shares(observations.rest_length)
        quaternions = quaternion_product(quaternion_about(bishop[..., 0], angle), quaternion_from_matrix(bishop))
    return Configuration(_anchor(observations, clamps, quaternions), quaternions, observations.rest_length)


def fill_missing(observations: Observations) -> np.ndarray:
    """(D, V, 3) vertices in mm, those without a valid mark on the line, by arc length, through the two nearest ones
    around them, or beyond the outermost two."""
    valid = observations.valid
    if valid.all():
        return observations.vertices
    place = observations.place
    ranks = np.argsort(~valid, axis=1, kind="stable")
    # The valid mark at or before each vertex, by its rank among the valid ones; the last of them has no next one.
    rank = np.clip(np.cumsum(valid, axis=1) - 1, 0, valid.sum(axis=1, keepdims=True) - 2)
    before, after = np.take_along_axis(ranks, rank, axis=1), np.take_along_axis(ranks, rank + 1, axis=1)
    share = ((place - place[before]) / (place[after] - place[before]))[..., None]
    low = np.take_along_axis(observations.vertices, before[..., None], axis=1)
    high = np.take_along_axis(observations.vertices, after[..., None], axis=1)
    return np.where(valid[..., None], observations.vertices, low + share * (high - low))


def on_equal_edges(observations: Observations, edges: int) -> Observations:
    """The observed curves as marks of ``edges`` equal edges: on cubic splines through the marks that were seen, over the arc
    lengths that the observations state. Measured frames of inner edges and label uncertainties are left out.

    Raises InputError for fewer than two edges.
    """
    from scipy.interpolate import CubicSpline

    require_whole("observations", "edges", edges, 2, MOST_EDGES)
    place = observations.place
    vertices = CubicSpline(place, fill_missing(observations), axis=1)(np.linspace(0.0, place[-1], edges + 1))
    frames = observations.frames
    start, end = (own if own is not None or frames is None else frames[:, edge] for own, edge in (
        (observations.start_frame, 0), (observations.end_frame, -1)))
    return replace(observations, vertices=vertices, valid=None, rest_length=np.full(edges, place[-1] / edges),
                   start_frame=start, end_frame=end, frames=None, sigma=None)


def directions(observations: Observations) -> np.ndarray:
    """(D, E, 3) unit directions of the observed edges."""
    return unit_vectors(np.diff(fill_missing(observations), axis=1))


def _holds_spin(kind) -> np.ndarray:
    return np.asarray(kind) == Clamp.FRAME


def _bishop(observations: Observations, clamps: Clamps) -> np.ndarray:
    """(D, E, 3, 3) twist-free frames: clamped tangents at the ends, observed ones between, m1 from the start clamp."""
    tangents = directions(observations)
    for edge, kind, frame in ((0, clamps.start, clamps.start_frame), (-1, clamps.end, clamps.end_frame)):
        held = np.broadcast_to(np.asarray(kind) >= Clamp.TANGENT, observations.count)[:, None]
        tangents[:, edge] = np.where(held, frame[..., 0], tangents[:, edge])
    # Where the first tangent is not held, the given m1 need not be across it: transport it there.
    transport = matrix_from_quaternion(smallest_rotation(clamps.start_frame[..., 0], tangents[:, 0]))
    return bishop_frames(tangents, np.einsum("dij,dj->di", transport, clamps.start_frame[..., 1]))


def _closing_angle(bishop: np.ndarray, clamps: Clamps) -> np.ndarray:
    """(D,) angle in (−π, π] from the last twist-free m1 to the last clamped m1; 0 where it rolls freely."""
    angle = angle_about(bishop[:, -1, :, 0], bishop[:, -1, :, 1], clamps.end_frame[..., 1])
    return np.where(_holds_spin(clamps.end), angle, 0.0)


def twist_shares(rest_length: np.ndarray) -> np.ndarray:
    """(E,) shares of the total twist up to each edge, in proportion to l̄_i of the joints."""
    spread = rest_length[:-1] + rest_length[1:]
    return np.concatenate([[0.0], np.cumsum(spread) / spread.sum()])


def _clamped(quaternions: np.ndarray, kind, frame: np.ndarray) -> np.ndarray:
    """(D, 4) with the whole frame, or the tangent by the smallest rotation, put in where the clamp holds it."""
    kind = np.broadcast_to(kind, len(quaternions))[:, None]
    tangent = matrix_from_quaternion(quaternions)[..., 0]
    turned = quaternion_product(smallest_rotation(tangent, frame[..., 0]), quaternions)
    quaternions = np.where(kind == Clamp.TANGENT, turned, quaternions)
    return np.where(kind == Clamp.FRAME, quaternion_from_matrix(frame), quaternions)


def _anchor(observations: Observations, clamps: Clamps, quaternions: np.ndarray) -> np.ndarray:
    """(D, 3) vertex 0: on its clamp, else where the last vertex meets its clamp, else where it was observed."""
    count = observations.count
    loose = np.broadcast_to(np.asarray(clamps.start) == Clamp.FREE, count)
    held_end = np.broadcast_to(np.asarray(clamps.end) != Clamp.FREE, count)
    if not loose.any():
        return clamps.start_position.copy()
    reach = Configuration(np.zeros((count, 3)), quaternions, observations.rest_length).vertices[:, -1]
    return np.where((loose & held_end)[:, None], clamps.end_position - reach, clamps.start_position)


def _free_tip(kind, position, frame, length, sign):
    """Where the free part begins, seen from a clamp, and the length (R,) of the edge that the clamp holds."""
    held = np.asarray(kind) >= Clamp.TANGENT
    taken = np.where(held, length, 0.0) * np.ones(len(position))
    return position + sign * taken[:, None] * frame[..., 0], taken
