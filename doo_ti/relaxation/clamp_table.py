"""The table of clamps: what holds each rod's ends and what it measures between them, as the kernels read it (§III-B)."""

import numpy as np

from doo_ti import runtime
from doo_ti.errors import InputError
from doo_ti.relaxation.clamp_kernel import FINDINGS, NOT_THE_FIRST, NOT_THE_LAST, OF_FRAMES, OF_REACH, clamp_kernel
from doo_ti.relaxation.columns import CLAMP_COLUMNS, ENDS
from doo_ti.types import Clamps, Configuration

FEW = 512
"""Starts that the caller's thread reads by itself: to wake another takes as long."""


def outer_edges(edges: int) -> slice:
    """The first edge and the last."""
    return slice(None, None, edges - 1)


def clamp_table(configuration: Configuration, lengths: np.ndarray, kinds: np.ndarray, clamps: Clamps):
    """((S, CLAMP_COLUMNS) table, see the columns' names, and (S,) whether each start can be relaxed as it is, one of SOUND,
    INFEASIBLE, STRAIGHT and TAUT).

    lengths  (1 or S, E) mm
    kinds    (S, 2) Clamp numbers

    Raises InputError where a frame that is to be held is no rotation, or a tangent no direction.
    """
    count = len(kinds)
    table, found = np.empty((count, CLAMP_COLUMNS)), np.empty((count, FINDINGS), dtype=np.int32)
    on_cpu = runtime.start() == "cpu"
    serial = on_cpu and count <= FEW
    threads = 1 if serial else runtime.thread_count() if on_cpu else max(1, count)
    doubles = (np.ascontiguousarray(array, dtype=np.float64) for array in (
        configuration.start, configuration.quaternions, lengths, clamps.start_position, clamps.end_position,
        clamps.start_frame, clamps.end_frame))
    if not count:
        return table, found[:, OF_REACH]
    clamp_kernel(serial, 1 if on_cpu else 64)(np.ascontiguousarray(kinds, dtype=np.int32), *doubles, threads, table, found)
    _check_frames(found[:, OF_FRAMES], clamps)
    return table, found[:, OF_REACH]


def _check_frames(found: np.ndarray, clamps: Clamps) -> None:
    """Raise InputError where a frame was found to be no rotation, or its tangent no direction. Frames that are not finite
    are data: their rods get a status."""
    for name, which in (("start_frame", NOT_THE_FIRST), ("end_frame", NOT_THE_LAST)):
        frames = getattr(clamps, name)[found == which]
        wrong = frames[np.isfinite(frames).all(axis=(1, 2))]
        if len(wrong):
            raise InputError("clamps", name, f"{np.round(wrong[0], 4).tolist()} is no frame that can be held",
                             "give unit, orthogonal columns t, m1, m2 with m2 = t x m1; of a tangent t at least")


def whole_start(start: np.ndarray, clamp: np.ndarray) -> np.ndarray:
    """(S, E, 4) ``start`` normalised, with the frames of ``clamp`` at its ends."""
    result = start / np.linalg.norm(start, axis=-1, keepdims=True)
    result[:, outer_edges(start.shape[1])] = clamp[:, ENDS:].reshape(-1, 2, 4)
    return result
