"""Recorded motion: markers along rods held by grippers, frame by frame, as what a simulation starts from and is compared with."""

from dataclasses import dataclass

import numpy as np

from doo_ti.dynamics.grippers import Grippers, edge_frames
from doo_ti.errors import InputError
from doo_ti.frames import bishop_frames, quaternion_from_matrix
from doo_ti.types import Clamp, Configuration

JUMP = 4.0
"""A gripper that moves so many times as far in one frame as in those around it was not seen in between."""
NEIGHBOURS = 3
"""Frames on either side that tell how fast a gripper is."""
MOST_LOST = 100
"""Frames that may be missing at one place."""
GRIPPED = (0, 1, -2, -1)
"""Vertices of the first and last edge."""


@dataclass(frozen=True)
class RecordedMotion:
    """R rods of V markers at T frames.

    positions  (R, T, V, 3) mm; the first and last edges are held by grippers
    rate       frames per second
    names      (R,) of the recordings
    elapsed    (R, T) steps of 1/rate since the frame before: more than one where frames are missing from the recording

    Raises InputError for shapes that do not fit and numbers that are not finite.
    """

    positions: np.ndarray
    rate: float
    names: tuple[str, ...]
    elapsed: np.ndarray

    @classmethod
    def of(cls, positions, rate: float, names=None, source: str = "motion") -> "RecordedMotion":
        """With ``elapsed`` found from how the grippers move."""
        positions = np.asarray(positions, dtype=np.float64)
        if positions.ndim == 3:
            positions = positions[None]
        if positions.ndim != 4 or positions.shape[-1] != 3 or positions.shape[2] < 5 or positions.shape[1] < 3:
            raise InputError(source, "positions_mm", f"shape {positions.shape}",
                             "give (R, T, V, 3) or (T, V, 3), three frames and five markers at least")
        wrong = np.argwhere(~np.isfinite(positions).all(axis=(2, 3)))
        if len(wrong):
            raise InputError(source, "positions_mm", f"not finite in {len(wrong)} frames, first recording {wrong[0, 0]}, "
                             f"frame {wrong[0, 1]}", "fill the gaps first (--fill-gaps), or leave those recordings out")
        if not (np.isfinite(rate) and rate > 0):
            raise InputError(source, "rate_hz", f"{rate}", "give frames per second")
        names = tuple(str(k) for k in range(len(positions))) if names is None else tuple(names)
        return cls(positions, float(rate), names, elapsed_steps(positions))

    @property
    def count(self) -> int:
        """R."""
        return len(self.positions)

    def take(self, rows) -> "RecordedMotion":
        """The recordings named by ``rows``."""
        rows = np.atleast_1d(rows)
        return RecordedMotion(self.positions[rows], self.rate, tuple(np.array(self.names)[rows]), self.elapsed[rows])

    def edge_lengths(self) -> np.ndarray:
        """(E,) median lengths of the edges, mm."""
        return np.median(np.linalg.norm(np.diff(self.positions, axis=2), axis=-1), axis=(0, 1))

    def jumps(self) -> list[tuple[str, int, int]]:
        """(recording, frame, frames missing before it) of every place where frames are missing."""
        return [(self.names[r], int(t), int(self.elapsed[r, t]) - 1) for r, t in np.argwhere(self.elapsed > 1)]


def elapsed_steps(positions: np.ndarray) -> np.ndarray:
    """(R, T) steps since the frame before, from (R, T, V, 3) positions.

    A capture that loses frames leaves a jump: all markers of the grippers move many times as far as in the frames around, each
    by the same multiple, which is the number of steps that have passed.
    """
    count, frames = positions.shape[:2]
    steps = np.ones((count, frames), dtype=np.int64)
    way = np.linalg.norm(np.diff(positions[:, :, GRIPPED], axis=1), axis=-1)  # (R, T − 1, 4) of the frame after
    around = np.full((2 * NEIGHBOURS + 1, *way.shape), np.nan)
    for k in range(-NEIGHBOURS, NEIGHBOURS + 1):
        if k and abs(k) < way.shape[1]:
            around[k + NEIGHBOURS, :, max(0, -k) : way.shape[1] - max(0, k)] = way[:, max(0, k) : way.shape[1] + min(0, k)]
    usual = np.nanmedian(around, axis=0)
    # Of each gripper's two markers together; slow grippers tell nothing of how long it was.
    both, usually = way[..., :2].sum(-1) + way[..., 2:].sum(-1), usual.sum(-1)
    noise = np.median(usually, axis=1, keepdims=True)
    ratio = both / np.maximum(usually, 0.2 * noise + 1e-9)
    lost = (ratio > JUMP) & (both > JUMP * noise)
    steps[:, 1:][lost] = np.clip(np.rint(ratio[lost]), 1, MOST_LOST).astype(np.int64)
    return steps


@dataclass(frozen=True)
class Rollout:
    """A recorded motion as a simulation begins it: from frames 0 and 1.

    start     R rods at frame 1
    velocity  (R, V, 3) mm/s there
    grippers  at every step from frame 1 on, missing frames included
    steps     (R, T − 1) the step of each frame from 1 on
    rate      steps per second
    """

    start: Configuration
    velocity: np.ndarray
    grippers: Grippers
    steps: np.ndarray
    rate: float


def rollout(motion: RecordedMotion, rest_length: np.ndarray, reference: np.ndarray, smoothing: int = 0,
            end: Clamp = Clamp.TANGENT) -> Rollout:
    """Lay out the recordings of ``motion`` for :func:`doo_ti.dynamics.simulate.simulate`.

    rest_length  (E,) mm
    reference    (3,) direction towards which m1 of the first edge points at frame 1
    smoothing    frames on either side over which gripper markers are smoothed
    end          what the far gripper holds
    """
    held = motion.positions[:, 1:][:, :, GRIPPED]
    if smoothing:
        held = _smoothed(held, motion.elapsed[:, 1:], smoothing)
    expanded, steps = _with_missing(held, motion.elapsed[:, 1:])
    first = edge_frames(expanded[:, :, 1] - expanded[:, :, 0], np.broadcast_to(reference, (motion.count, 3)))
    last = edge_frames(expanded[:, :, 3] - expanded[:, :, 2])
    grippers = Grippers(Clamp.FRAME, end, expanded[:, :, 0], expanded[:, :, 3], first, last)
    x = motion.positions[:, 1]
    edges = np.diff(x, axis=1)
    tangents = edges / np.linalg.norm(edges, axis=-1, keepdims=True)
    frames = quaternion_from_matrix(bishop_frames(tangents, first[:, 0, :, 1]))
    velocity = (x - motion.positions[:, 0]) * motion.rate / motion.elapsed[:, 1, None, None]
    return Rollout(Configuration(x[:, 0].copy(), frames, rest_length), velocity, grippers, steps, motion.rate)


def _with_missing(held: np.ndarray, elapsed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """((R, steps, 4, 3) gripper markers at every step, (R, T) step of each frame) from (R, T, 4, 3), the last position held where
    a recording is shorter: cubics through frames that are missing, with the velocities on either side."""
    count, frames = held.shape[:2]
    since = elapsed.copy()
    since[:, 0] = 0
    steps = np.cumsum(since, axis=1)
    total = int(steps[:, -1].max()) + 1
    result = np.repeat(held[:, -1:], total, axis=1)
    for r in range(count):
        result[r, steps[r]] = held[r]
    for r, t in np.argwhere(since > 1):
        n = int(since[r, t])
        here, there = held[r, t - 1], held[r, t]
        before = (here - held[r, t - 2]) / max(1, since[r, t - 1]) if t > 1 else (there - here) / n
        after = (held[r, t + 1] - there) / since[r, t + 1] if t + 1 < frames else (there - here) / n
        u = (np.arange(1, n) / n)[:, None, None]
        result[r, steps[r, t - 1] + 1 : steps[r, t]] = (
            (1 + 2 * u) * (1 - u) ** 2 * here + u**2 * (3 - 2 * u) * there
            + n * (u * (1 - u) ** 2 * before + u**2 * (u - 1) * after))
    return result, steps


def _smoothed(held: np.ndarray, elapsed: np.ndarray, reach: int) -> np.ndarray:
    """Markers (R, T, 4, 3) fitted by quadratics over ``reach`` frames on either side, never across missing frames."""
    count, frames = held.shape[:2]
    segment = np.cumsum(elapsed > 1, axis=1)
    offsets = np.arange(-reach, reach + 1)
    result = np.empty_like(held)
    for t in range(frames):
        at = np.clip(t + offsets, 0, frames - 1)
        inside = (t + offsets >= 0) & (t + offsets < frames)
        weight = (inside & (segment[:, at] == segment[:, t : t + 1])).astype(float)  # (R, K)
        basis = np.stack([np.ones_like(offsets), offsets, offsets**2], axis=1).astype(float)
        normal = np.einsum("rk,ki,kj->rij", weight, basis, basis) + 1e-9 * np.eye(3)
        right = np.einsum("rk,ki,rkvc->rivc", weight, basis, held[:, at])
        result[:, t] = np.linalg.solve(normal, right.reshape(count, 3, -1))[:, 0].reshape(count, 4, 3)
    return result
