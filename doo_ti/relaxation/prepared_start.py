"""Starts that can be projected onto closure (§III-B): which rods are feasible, and what becomes of straight ones."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from doo_ti.frames import (
    matrix_from_quaternion,
    quaternion_about,
    quaternion_product,
    smallest_rotation,
    tangent_from_quaternion,
)
from doo_ti.relaxation.clamp_table import normalised, outer_edges, whole_start
from doo_ti.relaxation.columns import CLOSED, ENDS, TARGET, TILT_END, TILT_INNER, TILT_START, TOTAL

TAUT = 1e-9
"""A rod whose slack is less than this share of its length is straight."""


def prepared(start: np.ndarray, lengths: np.ndarray, clamp: np.ndarray, up: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(starts that can be projected, feasible (S,)). Where starts are changed ``clamp`` is, too, in place."""
    closed = clamp[:, CLOSED] > 0
    if not closed.any():
        return start, ~closed
    edges = start.shape[1]
    # Straight rods have their inner edges in line: two of them tell most others apart.
    inner = start[:, [min(1, edges - 1), edges // 2]]
    tangents = _tangents(np.concatenate([clamp[:, ENDS:].reshape(-1, 2, 4), inner], axis=1))
    free = _free_part(tangents[:, :2], lengths, clamp)
    # Two free edges at least leave the far point three ways to go.
    feasible = ~closed | ((free.share <= 1 + 1e-12) & (free.tilting.sum(axis=0) >= 4 - edges))
    closed &= feasible
    in_line = np.abs(tangents[:, 2] - tangents[:, 3]).max(axis=0) < 1e-2
    slack = np.flatnonzero(closed & in_line & (free.share < 1 - 1e-8))
    if len(slack):
        start = _bowed(start, lengths, clamp, free, slack, up)
    taut = np.flatnonzero(closed & (free.share > 1 - TAUT))
    if len(taut):
        start = _stretched(start, clamp, free, taut)
    return start, feasible


@dataclass(frozen=True)
class _FreePart:
    """What the clamps leave of each rod: which of the end edges may tilt (2, S), as all inner ones may, the line (3, S) and
    its length, the span (S,), that the free edges have to bridge, and how far they reach (S,), mm."""

    tilting: np.ndarray
    line: np.ndarray
    span: np.ndarray
    reach: np.ndarray

    @cached_property
    def share(self) -> np.ndarray:
        """(S,) of the reach that the span takes."""
        return self.span / self.reach


def _tangents(frames: np.ndarray) -> np.ndarray:
    """(3, N, S) tangents of the frames (S, N, 4) of any length."""
    return np.ascontiguousarray(tangent_from_quaternion(np.moveaxis(normalised(frames), 0, -1)).transpose(2, 0, 1))


def _free_part(tangents: np.ndarray, lengths: np.ndarray, clamp: np.ndarray) -> _FreePart:
    """The free part of rods whose end edges have these tangents (3, 2, S)."""
    tilting = clamp[:, TILT_START : TILT_END + 1].T
    held = lengths[:, outer_edges(lengths.shape[1])].T * (1 - tilting)
    line = clamp[:, TARGET : TARGET + 3].T - (held * tangents).sum(axis=1)
    return _FreePart(tilting, line, np.sqrt((line * line).sum(axis=0)), clamp[:, TOTAL] - held.sum(axis=0))


def _bowed(start, lengths, clamp, free: _FreePart, rows, up) -> np.ndarray:
    """Starts of which the slack rods ``rows`` can be projected: free edges in one straight line have no first-order way to
    bring the far end closer.

    Where they are they are bowed to the needed chord, downwards, or towards m1 where the line is upright.
    """
    edges = start.shape[1]
    tilting = np.ones((len(rows), edges))
    tilting[:, outer_edges(edges)] = free.tilting[:, rows].T
    whole = whole_start(start[rows], clamp[rows])
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
    slope = np.minimum(2 * np.sqrt(1 - free.share[rows]), 1.0)[:, None] * np.cos(np.pi * place) * tilting
    turn = quaternion_about(-axis[:, None] * np.ones((1, edges, 1)), slope)
    return _changed(start, clamp, rows, quaternion_product(turn, whole))


def _stretched(start, clamp, free: _FreePart, rows) -> np.ndarray:
    """Starts of which the rods ``rows``, as long as their span, are the one straight line they can be, with nothing left to
    relax but the spins.

    Their clamps are changed to say so; the turns of their frames are kept by parallel transport.
    """
    whole = whole_start(start[rows], clamp[rows])
    turn = smallest_rotation(tangent_from_quaternion(whole), (free.line[:, rows] / free.span[rows]).T[:, None])
    straight = quaternion_product(turn, whole)
    held = free.tilting[:, rows].T == 0
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
