"""Where the clamps are during a motion, as the kernels read it (docs/dynamics.md)."""

from dataclasses import replace

import numpy as np

from doo_ti.dynamics.grippers import Grippers
from doo_ti.relaxation.time_loading import PATH_ANCHOR, PATH_COLUMNS, PATH_ENDS, PATH_STILL, PATH_TARGET
from doo_ti.rod.frames import quaternion_from_matrix, smallest_rotation
from doo_ti.rod.types import Clamp, Configuration


def clamp_path(grippers: Grippers, start: Configuration, steps: slice) -> np.ndarray:
    """(S, steps, PATH_COLUMNS) where the clamps are at the end of these steps."""
    after = slice(steps.start + 1, steps.stop + 1)
    kinds = [np.broadcast_to(np.asarray(kind), (grippers.count,)) for kind in (grippers.start, grippers.end)]
    path = np.zeros((start.count, steps.stop - steps.start, PATH_COLUMNS))
    # A free vertex 0 is measured from where it starts.
    first = np.asarray(start.start, dtype=np.float64)[:, None]
    path[..., PATH_ANCHOR : PATH_ANCHOR + 3] = np.where((kinds[0] == Clamp.FREE)[:, None, None], first,
                                                        grippers.start_position[:, after])
    path[..., PATH_TARGET : PATH_TARGET + 3] = np.where(
        (kinds[1] != Clamp.FREE)[:, None, None],
        grippers.end_position[:, after] - path[..., PATH_ANCHOR : PATH_ANCHOR + 3], 0.0)
    path[..., PATH_ENDS] = path[..., PATH_ENDS + 4] = 1.0
    for column, kind, frames in ((PATH_ENDS, kinds[0], grippers.start_frame), (PATH_ENDS + 4, kinds[1], grippers.end_frame)):
        if (kind >= Clamp.TANGENT).any():
            path[..., column : column + 4] = _frames(frames[:, after], kind)
    path[..., PATH_STILL] = _still(grippers, kinds, steps)
    return path


def _still(grippers: Grippers, kinds: list[np.ndarray], steps: slice) -> np.ndarray:
    """(S, steps) whether what the grippers hold is where it was at the step's beginning."""
    still = np.ones((grippers.count, steps.stop - steps.start), dtype=bool)
    for kind, position, frame in zip(kinds, (grippers.start_position, grippers.end_position),
                                     (grippers.start_frame, grippers.end_frame), strict=True):
        for least, poses in ((Clamp.POSITION, position), (Clamp.TANGENT, frame.reshape(*frame.shape[:2], 9))):
            moves = (poses[:, steps.start : steps.stop] != poses[:, steps.start + 1 : steps.stop + 1]).any(axis=-1)
            still &= ~moves | (kind < least)[:, None]
    return still


def refined_within_reach(grippers: Grippers, parts: int, rest_length: np.ndarray) -> Grippers:
    """:meth:`.Grippers.refined` for rods of ``rest_length`` (E,) or (S, E) mm. Where a rod reaches from one gripper to the
    other at two neighbouring instants it does so between them: the far gripper does not go as far as a cubic would that is bent
    by a gripper which stops where the rod is taut."""
    if grippers.count == 1 and rest_length.ndim == 2:
        grippers = grippers.take(np.zeros(len(rest_length), dtype=np.int64))
    fine = grippers.refined(parts)
    held = [np.broadcast_to(np.asarray(kind), (grippers.count,)) for kind in (grippers.start, grippers.end)]
    closed = (held[0] != Clamp.FREE) & (held[1] != Clamp.FREE)
    if parts == 1 or not closed.any():
        return fine
    line = fine.end_position - fine.start_position
    reach = np.broadcast_to(rest_length.sum(axis=-1), (fine.count,))[:, None]
    for kind, frames, edge in ((held[0], fine.start_frame, 0), (held[1], fine.end_frame, -1)):
        length = np.where(kind >= Clamp.TANGENT, rest_length[..., edge], 0.0)[:, None]
        line = line - np.where(length[..., None] > 0, length[..., None] * frames[..., 0], 0.0)
        reach = reach - length
    excess = 1.0 - reach / np.maximum(np.linalg.norm(line, axis=-1), reach)
    beyond = excess[:, ::parts] > 0
    between = np.repeat(beyond[:, :-1] | beyond[:, 1:], parts, axis=1)
    excess[:, :-1][between | ~closed[:, None]] = 0.0
    excess[:, ::parts] = 0.0
    return replace(fine, end_position=np.where(excess[..., None] > 0, fine.end_position - excess[..., None] * line,
                                               fine.end_position))


def _frames(frames: np.ndarray, kinds: np.ndarray) -> np.ndarray:
    """(S, T, 4) quaternions of (S, T, 3, 3) frames; of tangent clamps of any frame with that tangent."""
    tangent = np.broadcast_to((kinds == Clamp.TANGENT)[:, None], frames.shape[:2])
    if not tangent.any():
        return quaternion_from_matrix(frames)
    t = frames[..., 0] / np.linalg.norm(frames[..., 0], axis=-1, keepdims=True)
    any_frame = smallest_rotation(np.array([1.0, 0.0, 0.0]), t)
    whole = np.where(tangent[..., None, None], np.eye(3), frames)
    return np.where(tangent[..., None], any_frame, quaternion_from_matrix(whole))
