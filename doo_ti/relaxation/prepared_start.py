"""Starts that can be projected onto closure (§III-B): what becomes of straight ones."""

from dataclasses import dataclass

import numpy as np

from doo_ti.frames import (
    matrix_from_quaternion,
    quaternion_about,
    quaternion_product,
    smallest_rotation,
    tangent_from_quaternion,
)
from doo_ti.relaxation.clamp_kernel import STRAIGHT, TAUT, TAUT_SLACK
from doo_ti.relaxation.clamp_table import outer_edges, whole_start
from doo_ti.relaxation.columns import CLOSED, ENDS, TARGET, TILT_END, TILT_INNER, TILT_START, TOTAL


def prepared(start: np.ndarray, lengths: np.ndarray, clamp: np.ndarray, found: np.ndarray, up: np.ndarray) -> np.ndarray:
    """Starts that can be projected: those ``found`` (S,) STRAIGHT are bowed, those found TAUT made straight. Where starts are
    changed ``clamp`` is, too, in place."""
    slack, taut = np.flatnonzero(found == STRAIGHT), np.flatnonzero(found == TAUT)
    if len(slack):
        start = _bowed(start, lengths, clamp, slack, up)
    if len(taut):
        start = _stretched(start, lengths, clamp, taut)
    return start


@dataclass(frozen=True)
class _FreePart:
    """What the clamps leave of some rods N: which of the end edges may tilt (N, 2), as all inner ones may, the line (N, 3) and
    its length, the span (N,), that the free edges have to bridge, and how far they reach (N,), mm."""

    tilting: np.ndarray
    line: np.ndarray
    span: np.ndarray
    reach: np.ndarray


def _free_part(lengths: np.ndarray, clamp: np.ndarray) -> _FreePart:
    """The free part of rods with these lengths (N, E) and clamps (N, CLAMP_COLUMNS)."""
    tangents = tangent_from_quaternion(clamp[:, ENDS:].reshape(-1, 2, 4))
    tilting = clamp[:, TILT_START : TILT_END + 1]
    held = lengths[:, outer_edges(lengths.shape[1])] * (1 - tilting)
    line = clamp[:, TARGET : TARGET + 3] - (held[..., None] * tangents).sum(axis=1)
    return _FreePart(tilting, line, np.linalg.norm(line, axis=1), clamp[:, TOTAL] - held.sum(axis=1))


def _rows(lengths: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """(N, E) the lengths of some starts."""
    return lengths[np.zeros_like(rows) if len(lengths) == 1 else rows]


def _bowed(start, lengths, clamp, rows, up) -> np.ndarray:
    """Starts of which the slack rods ``rows`` can be projected: free edges in one straight line have no first-order way to
    bring the far end closer.

    Where they are they are bowed to the needed chord, downwards, or towards m1 where the line is upright.
    """
    edges, own = start.shape[1], _rows(lengths, rows)
    free = _free_part(own, clamp[rows])
    tilting = np.ones((len(rows), edges))
    tilting[:, outer_edges(edges)] = free.tilting
    whole = whole_start(start[rows], clamp[rows])
    matrix = matrix_from_quaternion(whole)
    chord = np.linalg.norm(((own * tilting)[..., None] * matrix[..., 0]).sum(axis=1), axis=-1)
    straight = chord > free.reach * (1 - TAUT_SLACK)
    rows, tilting, whole, matrix = rows[straight], tilting[straight], whole[straight], matrix[straight]
    share = (free.span / free.reach)[straight]
    middle = matrix[:, edges // 2]
    axis = np.cross(-up, middle[..., 0])
    upright = np.linalg.norm(axis, axis=-1, keepdims=True) < 1e-3
    axis = np.where(upright, middle[..., 2], axis)
    axis /= np.linalg.norm(axis, axis=-1, keepdims=True)
    # A sine arch of slope a cos(π s/L) has the chord L (1 − a²/4).
    place = (np.cumsum(tilting, axis=1) - 0.5) / tilting.sum(axis=1, keepdims=True)
    slope = np.minimum(2 * np.sqrt(1 - share), 1.0)[:, None] * np.cos(np.pi * place) * tilting
    turn = quaternion_about(-axis[:, None] * np.ones((1, edges, 1)), slope)
    return _changed(start, clamp, rows, quaternion_product(turn, whole))


def _stretched(start, lengths, clamp, rows) -> np.ndarray:
    """Starts of which the rods ``rows``, as long as their span, are the one straight line they can be, with nothing left to
    relax but the spins.

    Their clamps are changed to say so; the turns of their frames are kept by parallel transport.
    """
    free = _free_part(_rows(lengths, rows), clamp[rows])
    whole = whole_start(start[rows], clamp[rows])
    turn = smallest_rotation(tangent_from_quaternion(whole), (free.line / free.span[:, None])[:, None])
    straight = quaternion_product(turn, whole)
    held = free.tilting == 0
    outer = outer_edges(start.shape[1])
    straight[:, outer] = np.where(held[..., None], whole[:, outer], straight[:, outer])
    clamp[rows[:, None], [CLOSED, TILT_START, TILT_END, TILT_INNER]] = 0.0
    return _changed(start, clamp, rows, straight)


def _changed(start, clamp, rows, quaternions) -> np.ndarray:
    """``start`` with other frames in some rows, as given left as it is; ``clamp`` takes their ends in place."""
    start = start.copy()
    start[rows] = quaternions
    clamp[rows, ENDS:] = quaternions[:, outer_edges(start.shape[1])].reshape(-1, 8)
    return start
