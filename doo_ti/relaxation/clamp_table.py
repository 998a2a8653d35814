"""The table of clamps: what holds each rod's ends and what it measures between them, as the kernels read it (§III-B)."""

import numpy as np

from doo_ti.errors import InputError
from doo_ti.frames import (
    FRAME_TOLERANCE,
    handedness,
    orthonormality_error,
    quaternion_from_matrix,
    quaternion_product,
    smallest_rotation,
    tangent_from_quaternion,
)
from doo_ti.relaxation.columns import (
    ANCHOR,
    CLAMP_COLUMNS,
    CLOSED,
    ENDS,
    FRAME,
    HANGING,
    LONGEST,
    POSITION,
    RELEASED,
    SHORTEST_PAIR,
    TANGENT,
    TARGET,
    TOTAL,
)
from doo_ti.types import Clamp, Clamps, Configuration


def _flags() -> np.ndarray:
    """(4, 4, 7) the columns CLOSED to RELEASED of a clamp, by its kinds at the start and at the end."""
    start, end = np.indices((len(Clamp), len(Clamp)))
    flags = ((start >= POSITION) & (end >= POSITION), start < FRAME, end < FRAME, start < TANGENT, end < TANGENT,
             np.ones_like(start), (start < POSITION) & (end >= POSITION))
    return np.stack(flags, axis=-1).astype(np.float64)


FLAGS = _flags()


def outer_edges(edges: int) -> slice:
    """The first edge and the last."""
    return slice(None, None, edges - 1)


def clamp_table(configuration: Configuration, lengths: np.ndarray, kinds: np.ndarray, clamps: Clamps) -> np.ndarray:
    """(S, CLAMP_COLUMNS): see the columns' names."""
    table = np.empty((len(kinds), CLAMP_COLUMNS))
    table[:, CLOSED : RELEASED + 1] = FLAGS[kinds[:, 0], kinds[:, 1]]
    first = np.where(kinds[:, :1] >= POSITION, clamps.start_position, configuration.start)
    table[:, TARGET : TARGET + 3] = np.where(table[:, CLOSED, None] > 0, clamps.end_position - first, 0.0)
    table[:, ANCHOR : ANCHOR + 3] = first
    total = lengths.sum(axis=1)
    table[:, TOTAL] = total
    table[:, LONGEST] = lengths.max(axis=1)
    table[:, SHORTEST_PAIR] = (lengths[:, 1:] + lengths[:, :-1]).min(axis=1)
    arm = lengths + 2 * (total[:, None] - np.cumsum(lengths, axis=1))
    table[:, HANGING] = np.abs(lengths * arm).max(axis=1)
    released = table[:, RELEASED] > 0
    if released.any():
        from_end = np.abs(lengths * (arm - 2 * total[:, None])).max(axis=1)
        table[:, HANGING] = np.where(released, from_end, table[:, HANGING])
        table[released, ANCHOR : ANCHOR + 3] = clamps.end_position[released]
    table[:, ENDS:] = _imposed(configuration.quaternions[:, outer_edges(configuration.edges)], kinds, clamps).reshape(-1, 8)
    return table


def normalised(frames: np.ndarray) -> np.ndarray:
    """(4, N, S) the frames (S, N, 4) of any length as unit quaternions, rods running fastest: a sum over the last axis of few
    takes NumPy several times as long."""
    parts = np.ascontiguousarray(frames.T)
    return parts / np.sqrt((parts * parts).sum(axis=0))


def _imposed(ends: np.ndarray, kinds: np.ndarray, clamps: Clamps) -> np.ndarray:
    """The two end frames (S, 2, 4) with what the clamps hold in place; a tangent clamp turns the edge by parallel transport,
    keeping its spin. Raises InputError where a frame that is held is no rotation."""
    result = np.ascontiguousarray(normalised(ends).T)
    frames = np.stack([clamps.start_frame, clamps.end_frame], axis=1)
    whole = kinds == FRAME
    if whole.any():
        _check_frames(frames, whole)
        result = np.where(whole[..., None], quaternion_from_matrix(frames), result)
    tangent = kinds == TANGENT
    if tangent.any():
        old = result[tangent]
        turned = quaternion_product(smallest_rotation(tangent_from_quaternion(old), frames[tangent][..., 0]), old)
        result[tangent] = turned / np.linalg.norm(turned, axis=-1, keepdims=True)
    return result


def _check_frames(frames: np.ndarray, held: np.ndarray) -> None:
    """Raise InputError where one of the frames (S, 2, 3, 3) that are ``held`` (S, 2) by clamps is finite but no rotation."""
    for row, end in np.argwhere(held & ((orthonormality_error(frames) > FRAME_TOLERANCE) | (handedness(frames) < 0))):
        frame = frames[row, end]
        # A frame of zeros says that there is none.
        if np.isfinite(frame).all() and frame.any():
            raise InputError("clamps", ("start_frame", "end_frame")[end], f"{np.round(frame, 4).tolist()} is no rotation",
                             "give unit, orthogonal columns t, m1, m2 with m2 = t x m1")


def whole_start(start: np.ndarray, clamp: np.ndarray) -> np.ndarray:
    """(S, E, 4) ``start`` normalised, with the frames of ``clamp`` at its ends."""
    result = start / np.linalg.norm(start, axis=-1, keepdims=True)
    result[:, outer_edges(start.shape[1])] = clamp[:, ENDS:].reshape(-1, 2, 4)
    return result
