"""Recorded motion: markers along rods held by grippers, and what is wrong with them (docs/dynamics.md)."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from doo_ti.dynamics.parameters import LEAST_RATE, MOST_RATE
from doo_ti.io.observation_files import read_recording
from doo_ti.rod.observations import median_of_seen
from doo_ti.rod.types import Rows
from doo_ti.system.arguments import short_repr, typed
from doo_ti.system.errors import InputError

LEAST_JUMP, LARGEST_MISFIT, SMALLEST_JUMP = 1.7, 0.2, 10.0
"""Frames are missing where the gripper markers together move by more than the first times their usual move; where what that
multiple does not explain is below the second, a share of the sum of squares; and where they move by more than the third, mm."""
NEIGHBOURS = 3  # frames on either side that tell how fast a gripper is
MOST_LOST = 100  # frames that may be missing at one place
LARGEST_TURN = np.radians(60.0)  # a gripper that seems to turn by more in one frame does not: its markers were confused
FINE, SWAPPED, LOST = 0, 1, 2
MOST_CONFUSED = 50  # frames after which such a turn is taken as real
LEAST_MM, MOST_MM = 1e-6, 1e6  # between neighbouring markers, and from the origin
ROUNDED = 1e-3  # of the distance of a gripper's markers: by so much a clip that ends at the inner one may be longer
LEAST_HELD = 5e-3  # of an end edge: half the length of the edge that stands for it where a gripper holds all of it
GRIPPED = (0, 1, -2, -1)  # vertices of the first and last edge


@typed
@dataclass(frozen=True)
class RecordedMotion:
    """R rods of V markers at T frames.

    positions  (R, T, V, 3) mm; the first and last edges are held by grippers, or the first alone
    rate       frames per second
    names      (R,) of the recordings
    elapsed    (R, T) steps of 1/rate since the frame before: more than one where frames are missing from the recording
    confused   (R, T, 2) of the start gripper's and the end gripper's markers: FINE, SWAPPED, or LOST, where they contradict the
               frames around, from which the gripper is then taken
    alone      the one recording came without an axis for several
    up         (3,) direction against gravity that the file states, or None
    free_end   no gripper holds the last edge
    frames     (T,) what the file calls the frames, for messages

    Raises InputError for shapes that do not fit and numbers that are not finite.
    """

    __repr__ = short_repr

    positions: Annotated[np.ndarray, "R T V 3"]
    rate: float
    names: tuple[str, ...]
    elapsed: Annotated[np.ndarray, "R T"]
    confused: Annotated[np.ndarray, "R T 2"]
    alone: bool = False
    up: Annotated[np.ndarray | None, "3"] = None
    free_end: bool = False
    frames: np.ndarray | None = None

    @classmethod
    @typed
    def of(cls, positions: ArrayLike, rate: float, names: Iterable[object] | None = None, source: str = "motion",
           free_end: bool = False, frames: np.ndarray | None = None) -> "RecordedMotion":
        """With ``elapsed`` found from how the grippers move; ``free_end``: no gripper holds the last edge."""
        positions = np.array(positions, dtype=np.float64)
        alone = positions.ndim == 3
        if alone:
            positions = positions[None]
        if positions.ndim != 4 or positions.shape[-1] != 3 or positions.shape[2] < 5 or positions.shape[1] < 3:
            raise InputError(source, "positions_mm", f"shape {positions.shape}",
                             "give (R, T, V, 3) or (T, V, 3), three frames and five markers at least")
        frames = np.arange(positions.shape[1]) if frames is None else frames
        wrong = np.argwhere(~np.isfinite(positions).all(axis=(2, 3)))
        if len(wrong):
            raise InputError(source, "positions_mm", f"not finite in {len(wrong)} frames, first recording {wrong[0, 0]}, "
                             f"frame {frames[wrong[0, 1]]}", "have them filled (`fill_gaps`), or leave those recordings out")
        if not LEAST_RATE <= rate <= MOST_RATE:
            raise InputError(source, "rate_hz", f"{rate}", f"give frames per second, {LEAST_RATE:g} to {MOST_RATE:g}")
        if (np.abs(positions) > MOST_MM).any():
            raise InputError(source, "positions_mm", f"up to {np.abs(positions).max():.3g} mm from the origin", "give mm")
        names = tuple(str(k) for k in (range(len(positions)) if names is None else names))
        held = GRIPPED[:2] if free_end else GRIPPED
        confused = confused_frames(positions)
        confused[:, :, len(held) // 2 :] = FINE
        lost = np.argwhere((confused == LOST).all(axis=1))
        if len(lost):
            raise InputError(source, "positions_mm", f"the markers of the {('start', 'end')[lost[0, 1]]} gripper in recording "
                             f"{lost[0, 0]} do not say where it points", "give the two markers of each held edge apart")
        found = cls(positions, float(rate), names, elapsed_steps(positions[:, :, held]), confused, alone, free_end=free_end,
                    frames=frames)
        same = np.flatnonzero(~(found.edge_lengths() > LEAST_MM))
        if len(same):
            raise InputError(source, "positions_mm", f"markers {same[0]} and {same[0] + 1} coincide", "leave one of them out")
        return found

    @classmethod
    @typed
    def load(cls, path: str | Path, fill_gaps: bool = False, unit: str | None = None,
             columns: Mapping[str, str] | Sequence[str] | None = None, rate: float | None = None,
             free_end: bool = False) -> "RecordedMotion":
        """The recordings of a file (:mod:`doo_ti.io.observation_files`): npz, motion capture, tables.

        fill_gaps             positions that are not finite are taken from lines between the frames around
        unit, columns, rate   as of :func:`doo_ti.io.observation_files.read_recording`
        free_end              no gripper holds the last edge

        Raises InputError for files that cannot be read, and as the class does.
        """
        found = read_recording(path, unit, columns, rate)
        positions = found.positions
        if fill_gaps and positions.ndim in (3, 4):
            positions = _filled(positions if positions.ndim == 4 else positions[None], path).reshape(positions.shape)
        return replace(cls.of(positions, found.rate, found.names, str(path), free_end, found.frames), up=found.up)

    @classmethod
    def together(cls, parts: list["RecordedMotion"], sources: list[str]) -> "RecordedMotion":
        """The recordings of several files, as long as the shortest. Raises InputError where markers or rates differ."""
        first = parts[0]
        for part, source in zip(parts, sources, strict=True):
            if part.positions.shape[2] != first.positions.shape[2] or part.rate != first.rate:
                problem = (f"{part.positions.shape[2]} markers at {part.rate:g}/s, the first file has "
                           f"{first.positions.shape[2]} at {first.rate:g}/s")
                raise InputError(source, "positions_mm", problem, "give recordings of one rod alike")
            if (part.up is None) != (first.up is None) or part.up is not None and not np.allclose(part.up, first.up):
                raise InputError(source, "up", "differs from that of the first file", "convert both files, with one --up")
        frames = min(part.positions.shape[1] for part in parts)
        cut = [part.until(frames) for part in parts]
        names = first.names
        if len(parts) > 1:
            names = tuple(Path(source).stem + (f" {name}" if part.count > 1 else "")
                          for part, source in zip(parts, sources, strict=True) for name in part.names)
        joined = {name: np.concatenate([getattr(part, name) for part in cut]) for name in ("positions", "elapsed", "confused")}
        return replace(cut[0], names=names, **joined)

    @property
    def count(self) -> int:
        """R, the number of recordings."""
        return len(self.positions)

    @property
    def edges(self) -> int:
        """E, the number of edges."""
        return self.positions.shape[2] - 1

    @property
    def gripped(self) -> tuple[int, ...]:
        """The vertices that grippers hold."""
        return GRIPPED[:2] if self.free_end else GRIPPED

    @property
    def predicted(self) -> slice:
        """The vertices that no gripper holds."""
        return slice(2, None if self.free_end else -2)

    def take(self, rows: Rows) -> "RecordedMotion":
        """The recordings named by ``rows``."""
        rows = np.atleast_1d(rows)
        names = tuple(np.array(self.names)[rows])
        return replace(self, positions=self.positions[rows], names=names, elapsed=self.elapsed[rows],
                       confused=self.confused[rows], alone=False)

    def until(self, frames: int) -> "RecordedMotion":
        """The first ``frames`` frames."""
        return replace(self, positions=self.positions[:, :frames], elapsed=self.elapsed[:, :frames],
                       confused=self.confused[:, :frames], frames=self.frames[:frames], alone=False)

    def refined(self, rest_length: np.ndarray) -> tuple["RecordedMotion", np.ndarray, np.ndarray]:
        """The same with one marker more amid each edge that no gripper holds, on the cubic spline through the markers; the
        lengths of its edges where those of this one are ``rest_length`` (E,) mm; and which of its markers (V,) these are."""
        from scipy.interpolate import CubicSpline

        lengths, free = self.edge_lengths(), slice(1, None if self.free_end else -1)
        arc = np.concatenate([[0.0], np.cumsum(lengths)])
        places = np.sort(np.concatenate([arc, 0.5 * (arc[:-1] + arc[1:])[free]]))
        fine = replace(self, positions=CubicSpline(arc, self.positions, axis=2)(places))
        halves = fine.edge_lengths()[1 : None if self.free_end else -1].reshape(-1, 2) * (rest_length / lengths)[free, None]
        ends = rest_length[:1], rest_length[len(halves) + 1 :]
        return fine, np.concatenate([ends[0], halves.ravel(), ends[1]]), np.searchsorted(places, arc)

    def edge_lengths(self) -> np.ndarray:
        """(E,) median lengths of the edges, mm."""
        return np.median(np.linalg.norm(np.diff(self.positions, axis=2), axis=-1), axis=(0, 1))

    def rest_length(self, clip: float | None = None) -> np.ndarray:
        """(E,) mm of the rod's edges, whose first and last, or first alone, grippers hold: as long as between the markers or,
        where a gripper holds ``clip`` mm from its outer marker on, so long that their middle, in which a clamp acts, is there.
        Raises InputError for a clip that ends beyond the inner marker."""
        lengths = self.edge_lengths()
        if clip is None:
            return lengths
        ends = [0] if self.free_end else [0, -1]
        if clip > (1.0 + ROUNDED) * lengths[ends].min():
            raise InputError("motion", "clip", f"{clip:g} mm; a gripper's inner marker is at {lengths[ends].min():.6g} mm",
                             "leave out the outer marker, so that the next two are the gripper's")
        lengths[ends] = 2.0 * np.maximum(lengths[ends] - clip, LEAST_HELD * lengths[ends])
        return lengths

    def glitches(self) -> list[str]:
        """What is wrong with the recordings, one line each."""
        lines = [f"recording {self.names[r]}, frame {self.frames[t]}: {self.elapsed[r, t] - 1} frames are missing before it"
                 for r, t in np.argwhere(self.elapsed > 1)]
        for kind, problem in ((SWAPPED, "are swapped"), (LOST, "contradict the frames around")):
            for r, end in np.argwhere((self.confused == kind).any(axis=1)):
                frames = np.flatnonzero(self.confused[r, :, end] == kind)
                lines.append(f"recording {self.names[r]}, {len(frames)} frames from {self.frames[frames[0]]} to "
                             f"{self.frames[frames[-1]]}: the two markers of the {('start', 'end')[end]} gripper {problem}")
        return lines


def _filled(positions: np.ndarray, path: str | Path) -> np.ndarray:
    """Positions (R, T, V, 3) with gaps closed by lines in time. Raises InputError for a marker that was never seen."""
    result = positions.copy()
    for r, v in np.argwhere(~np.isfinite(positions).all(axis=(1, 3))):
        seen = np.isfinite(positions[r, :, v]).all(axis=-1)
        if not seen.any():
            raise InputError(path, "positions_mm", f"marker {v} of recording {r} is never finite", "leave that recording out")
        for axis in range(3):
            result[r, :, v, axis] = np.interp(np.arange(len(seen)), np.flatnonzero(seen), positions[r, seen, v, axis])
    return result


def elapsed_steps(held: np.ndarray) -> np.ndarray:
    """(R, T) steps since the frame before, from the positions of gripper markers (R, T, 4, 3), or of one gripper.

    A capture that loses frames leaves a jump: all markers of the grippers move by the same multiple n of what they do in the
    frames around, in the same directions. With moves d of all and the median u of their moves around, n = Σ d·u / Σ u·u.
    """
    moves = np.diff(held, axis=1)
    padded = np.pad(moves, ((0, 0), (NEIGHBOURS, NEIGHBOURS), (0, 0), (0, 0)), constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * NEIGHBOURS + 1, axis=1)
    around = np.moveaxis(np.delete(windows, NEIGHBOURS, axis=-1), -1, 0)
    usual = np.nanmedian(around, axis=0)
    square = np.sum(usual**2, axis=(-2, -1))
    # Longer than the moves on both sides: a gripper that starts or stops at once moves usually on one of them.
    sides = np.stack([median_of_seen(around[:NEIGHBOURS]), median_of_seen(around[NEIGHBOURS:])])
    fastest = np.nanmax(np.sum(sides**2, axis=(-2, -1)), axis=0)
    number = np.sum(moves * usual, axis=(-2, -1)) / np.maximum(square, 1e-12)
    left = np.sum((moves - number[..., None, None] * usual) ** 2, axis=(-2, -1))
    all_moves = np.sum(moves**2, axis=(-2, -1))
    lost = (number > LEAST_JUMP) & (left < LARGEST_MISFIT * all_moves) & (all_moves > SMALLEST_JUMP**2)
    lost &= all_moves > LEAST_JUMP**2 * fastest
    steps = np.ones(held.shape[:2], dtype=np.int64)
    steps[:, 1:][lost] = np.clip(np.rint(number[lost]), 1, MOST_LOST).astype(np.int64)
    return steps


def confused_frames(positions: np.ndarray) -> np.ndarray:
    """(R, T, 2) frames of (R, T, V, 3) positions in which the first or the last edge points elsewhere than before, for a while:
    SWAPPED where it points the opposite way, else LOST. Before frame 0 it continues the edge beside it."""
    edges = np.stack([positions[:, :, 1] - positions[:, :, 0], positions[:, :, -1] - positions[:, :, -2]], axis=2)
    direction = edges / np.maximum(np.linalg.norm(edges, axis=-1, keepdims=True), 1e-12)
    beside = np.stack([positions[:, 0, 2] - positions[:, 0, 1], positions[:, 0, -2] - positions[:, 0, -3]], axis=1)
    kinked = np.sum(direction[:, 0] * beside, axis=-1) < -0.5 * np.linalg.norm(beside, axis=-1)
    believed = np.where(kinked[..., None], -direction[:, 0], direction[:, 0])
    confused = np.full(direction.shape[:3], FINE, dtype=np.int8)
    since = np.zeros(kinked.shape, dtype=np.int64)
    for t in range(direction.shape[1]):
        along = np.sum(direction[:, t] * believed, axis=-1)
        swapped, lost = along < -np.cos(LARGEST_TURN), np.abs(along) < np.cos(LARGEST_TURN)
        since = np.where(lost, since + 1, 0)
        for r, end in np.argwhere(since > MOST_CONFUSED):
            confused[r, t - MOST_CONFUSED : t, end], lost[r, end] = FINE, False
        since[~lost] = 0
        confused[:, t] = np.where(lost, LOST, np.where(swapped, SWAPPED, FINE))
        believed = np.where(lost[..., None], believed, np.where(swapped[..., None], -direction[:, t], direction[:, t]))
    return confused
