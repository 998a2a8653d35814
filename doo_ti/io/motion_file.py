"""Motions of grippers: poses of both clamps over time, and their files (docs/motions.md): an npz, or a CSV file with a row for
each moment (:mod:`doo_ti.io.pose_table`).

A tool's x axis points along the rod, from its start to its end, unless another is named. Between two moments frames turn by
less than half a turn, unless ``end_rotation_deg`` is given.

Axes: T moments, N motions, V marks of a rod.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np

from doo_ti.io.arrays import AXES, checked_arrays, frame_columns, read_numbers
from doo_ti.io.pose_table import put_frames, read_poses
from doo_ti.rod import frames as rotations
from doo_ti.rod.material import doubt_angle, mm_in
from doo_ti.rod.types import POSES, Clamps
from doo_ti.system.arguments import owning, short_repr, typed
from doo_ti.system.errors import InputError, require, require_whole
from doo_ti.system.files import csv_text

SHAPES = {"time_s": (), "start_position_mm": (3,), "end_position_mm": (3,), "start_frame": (3, 3), "end_frame": (3, 3),
          "start_quaternion": (4,), "end_quaternion": (4,), "end_rotation_deg": ()}
"""Of the keys, at a moment."""
TOOL_AXES = {f"{sign}{name}": (axis, -1.0 if sign else 1.0) for sign in ("", "-") for axis, name in enumerate("xyz")}
"""Of a tool: which points along the rod, from its start to its end."""
_POSES = ("start_position_mm", "end_position_mm", "start_frame", "end_frame")
_LENGTHS = {"start_position_mm", "end_position_mm", "positions_mm"}
CONTRADICTION = np.radians(45.0)
"""Largest difference between a frame's turn and the given rotation, which may count the swing of the tangent differently."""
MOST_MM = 1e6  # from the origin to a clamp
MOST_TURNS = 1000.0
MOST_MOMENTS = 1_000_000


@owning
@dataclass(frozen=True)
class ClampPath:
    """Poses of both clamps of N rods, or of one motion for all, at T moments; None: it does not move.

    time                          (T,) s
    start_position, end_position  (T, N, 3) mm
    start_frame, end_frame        (T, N, 3, 3)
    end_rotation                  (T, N) rad about the rod, whole turns included
    tangents_only                 only the tangents in the frames are known
    timed                         the times are those of the motion, not the numbers of its moments
    source                        where it comes from, for messages

    Raises InputError for times that do not rise, frames that are not rotations, half turns, whose sense is ambiguous, and a
    rotation that contradicts the end frames.
    """

    __repr__ = short_repr

    time: Annotated[np.ndarray, "T"]
    start_position: Annotated[np.ndarray | None, "T 1N 3"] = None
    end_position: Annotated[np.ndarray | None, "T 1N 3"] = None
    start_frame: Annotated[np.ndarray | None, "T 1N 3 3"] = None
    end_frame: Annotated[np.ndarray | None, "T 1N 3 3"] = None
    end_rotation: Annotated[np.ndarray | None, "T 1N"] = None
    tangents_only: bool = False
    timed: bool = True
    source: str = "motion"

    def __post_init__(self) -> None:
        if self.time.ndim != 1 or len(self.time) < 2 or not (np.diff(self.time) > 0).all():
            raise InputError(self.source, "time_s", "not two or more rising times", "give the moments in their order")
        for name, most, unit in (("start_position", MOST_MM, "mm"), ("end_position", MOST_MM, "mm"),
                                 ("end_rotation", MOST_TURNS * 2 * np.pi, "rad")):
            value = getattr(self, name)
            if value is not None and not (np.abs(value) <= most).all():
                raise InputError(self.source, name, f"{np.abs(value).max():g} {unit}", f"stay within {most:g} {unit}")
        for name in ("start_frame", "end_frame"):
            frames = getattr(self, name)
            if frames is not None:
                self._check_frames(name, frames)
        doubt_angle("ClampPath", "end_rotation", self.end_rotation)
        if self.end_frame is not None and self.end_rotation is not None and not self.tangents_only:
            self._check_rotation()

    @property
    def moments(self) -> int:
        """T, the number of moments."""
        return len(self.time)

    def states(self, between: int) -> np.ndarray:
        """((T − 1) between + 1,) s of the states that a prediction returns, ``between`` of them for each interval. Raises
        InputError for none, and for more than a million."""
        require_whole("prediction", "between", between, 1, MOST_MOMENTS // (self.moments - 1))
        return np.interp(np.arange(between * (self.moments - 1) + 1) / between, np.arange(self.moments), self.time)

    @property
    def count(self) -> int:
        """N, the number of paths."""
        given = (getattr(self, name) for name in (*POSES, "end_rotation"))
        return max((value.shape[1] for value in given if value is not None), default=1)

    def at(self, moment: int, clamps: Clamps) -> Clamps:
        """(R) clamps at a moment, ``clamps`` at the start; N is one or R. What the path leaves out stays as in ``clamps``."""
        def put(path, own):
            return own if path is None else np.ascontiguousarray(np.broadcast_to(path[moment], own.shape))
        end_frame = put(self.end_frame, clamps.end_frame)
        if self.end_frame is None and self.end_rotation is not None:
            angle = np.broadcast_to(self.end_rotation[moment] - self.end_rotation[0], len(end_frame))
            end_frame = rotations.turned_about_tangent(end_frame, angle)
        return replace(clamps, start_position=put(self.start_position, clamps.start_position), end_frame=end_frame,
                       end_position=put(self.end_position, clamps.end_position),
                       start_frame=put(self.start_frame, clamps.start_frame))

    def rotation(self, moment: int, count: int) -> np.ndarray | None:
        """(R,) rad by which the far frames turn about the rod until the next moment, or None where the frames show it."""
        if self.end_rotation is None:
            return None
        return np.broadcast_to(self.end_rotation[moment + 1] - self.end_rotation[moment], count)

    def relative_to(self, clamps: Clamps) -> "ClampPath":
        """The same displacements and turns, starting from where R ``clamps`` are."""
        def shifted(path, own):
            return None if path is None else own + path - path[:1]
        def turned(path, own):
            return None if path is None else np.einsum("tnij,tnkj,nkl->tnil", path, np.broadcast_to(path[:1], path.shape), own)
        return replace(self, **{name: (turned if name.endswith("frame") else shifted)(
            getattr(self, name), getattr(clamps, name)) for name in POSES})

    def resampled(self, rate: float) -> "ClampPath":
        """The same path at ``rate`` moments per second, on monotone cubics between its own."""
        from scipy.interpolate import PchipInterpolator

        count = int(np.floor((self.time[-1] - self.time[0]) * rate * (1 + 1e-9))) + 1
        if not 2 <= count <= MOST_MOMENTS:
            raise InputError(self.source, "time_s", f"{count} moments at {rate:g} per second", f"choose 2 to {MOST_MOMENTS:,}")
        time = self.time[0] + np.arange(count) / rate
        now = np.minimum(time, self.time[-1])

        def smooth(path):
            return None if path is None else PchipInterpolator(self.time, path)(now)

        def turning(frames):
            if frames is None:
                return None
            between = smooth(rotations.of_like_signs(rotations.quaternion_from_matrix(frames).swapaxes(0, 1)).swapaxes(0, 1))
            return rotations.matrix_from_quaternion(between / np.linalg.norm(between, axis=-1, keepdims=True))
        return replace(self, time=time, end_rotation=smooth(self.end_rotation), **{
            name: (turning if name.endswith("frame") else smooth)(getattr(self, name)) for name in POSES})

    def _check_frames(self, name: str, frames: np.ndarray) -> None:
        bad = ~rotations.is_rotation(frames)
        if bad.any():
            raise InputError(self.source, name, f"the frame of moment {np.argwhere(bad)[0, 0]} is not a rotation",
                             "give unit, orthogonal columns t, m1, m2 with m2 = t x m1")
        tangents = self.tangents_only or (name == "end_frame" and self.end_rotation is not None)
        unclear = rotations.is_half_turn(frames[:-1], frames[1:], not tangents)
        if unclear.any():
            moment = np.argwhere(unclear)[0, 0]
            raise InputError(self.source, name, f"half a turn from moment {moment} to {moment + 1}, in either sense",
                             "give moments in between" + ", or end_rotation_deg" * (name == "end_frame"))

    def _check_rotation(self) -> None:
        turned = rotations.turn_about_tangent(self.end_frame[:-1], self.end_frame[1:])
        given = np.diff(self.end_rotation, axis=0)
        apart = np.abs(np.angle(np.exp(1j * (given - turned))))
        if (apart > CONTRADICTION).any():
            moment, rod = np.argwhere(apart > CONTRADICTION)[0]
            given = np.broadcast_to(given, apart.shape)[moment, rod]
            raise InputError(self.source, "end_rotation_deg", f"{np.degrees(given):.0f} from moment {moment} to {moment + 1}, "
                             f"where end_frame turns by {np.degrees(turned[moment, rod]):.0f} and whole turns",
                             "correct one of them, or leave one out")


def path_of_marks(positions: np.ndarray, time: np.ndarray | None = None, source: str = "motion") -> ClampPath:
    """The path of grippers that hold the first and the last edge of rods with marks (T, N, V, 3) mm."""
    first, last = positions[..., 1, :] - positions[..., 0, :], positions[..., -1, :] - positions[..., -2, :]
    for edge, place in ((first, "first"), (last, "last")):
        if not (np.linalg.norm(edge, axis=-1) > 0).all():
            raise InputError(source, "positions_mm", f"two marks of the {place} edge coincide", "correct the marks")
    timed, numbers = time is not None, np.arange(len(positions), dtype=np.float64)
    frames = (rotations.some_frames(edge / np.linalg.norm(edge, axis=-1, keepdims=True)) for edge in (first, last))
    return ClampPath(time if timed else numbers, positions[..., 0, :], positions[..., -1, :], *frames, tangents_only=True,
                     timed=timed, source=source)


@typed
def load_path(path: str | Path, unit: str | None = None, named: Mapping[str, str] | None = None,
              axes: tuple[str, str] = ("x", "x"), turn: np.ndarray | None = None) -> ClampPath:
    """The clamps' path from a motion file.

    unit   "mm", "cm", "m" or "in": the unit of all lengths, whatever the file states
    named  of a CSV file, some of :data:`doo_ti.io.pose_table.NAMED`: how the file calls them
    axes   of :data:`TOOL_AXES`, of the tools at the start and at the end whose orientations the file states
    turn   (3, 3) by which the path is turned about the origin, into the coordinates of the rods

    Raises InputError for files that cannot be read or do not describe a path.
    """
    path, given = Path(path), None if unit is None else mm_in(unit, "load_path")
    require(set(axes) <= TOOL_AXES.keys(), "load_path", "axes", f"{axes!r}", f"give two of {', '.join(TOOL_AXES)}")
    arrays, stated = _read(path, named)
    for key in arrays.keys() & _LENGTHS:
        arrays[key] = arrays[key] * (stated.get(key, 1.0) if given is None else given)
    if turn is not None:
        arrays |= {key: arrays[key] @ turn.T for key in arrays.keys() & _LENGTHS}
    arrays = checked_arrays(path, arrays)
    rate = arrays.pop("rate_hz", None)
    if "positions_mm" in arrays:
        return _of_positions(path, arrays, rate)
    for end, axis in zip(("start", "end"), axes, strict=True):
        tool = arrays.pop(f"{end}_orientation", None)
        if tool is not None:  # whose axis points along the rod; m1 is the axis after it
            number, sign = TOOL_AXES[axis]
            t, m1 = sign * tool[..., number], tool[..., (number + 1) % 3]
            arrays[f"{end}_frame"] = np.stack([t, m1, np.cross(t, m1)], axis=-1)
        if turn is not None and f"{end}_frame" in arrays:
            arrays[f"{end}_frame"] = turn @ arrays[f"{end}_frame"]
    require(arrays.keys() - {"time_s"}, path, "end_position_mm", "missing, so nothing moves",
            f"give some of {', '.join([*_POSES, 'end_rotation_deg'])}")
    count = len(next(iter(arrays.values())))
    poses = {key.removesuffix("_mm"): arrays[key][:, None] for key in _POSES if key in arrays}
    rotation = np.radians(arrays["end_rotation_deg"])[:, None] if "end_rotation_deg" in arrays else None
    return ClampPath(arrays.get("time_s", np.arange(count, dtype=np.float64)), end_rotation=rotation, timed="time_s" in arrays,
                     source=str(path), **poses)


def _read(path: Path, named: Mapping[str, str] | None) -> tuple[dict[str, np.ndarray], dict[str, float]]:
    """The keys of a file, those of poses with T moments each; and mm in the units of its positions, where it states them."""
    if path.suffix == ".csv":
        return read_poses(path, named)
    arrays = read_numbers(path, (*SHAPES, "positions_mm", "rate_hz"))
    require(named is None, path, "columns", "an npz has keys", "leave them out")
    if "positions_mm" not in arrays:
        count = max((len(value) if value.ndim else 0 for key, value in arrays.items() if key in SHAPES), default=0)
        for key in arrays.keys() & SHAPES.keys():
            if arrays[key].shape != (count, *SHAPES[key]):
                raise InputError(path, key, f"shape {arrays[key].shape}", f"make it {(count, *SHAPES[key])}: T moments")
        put_frames(path, arrays, "orientation")
    return arrays, {}


def _of_positions(path: Path, arrays: dict[str, np.ndarray], rate: np.ndarray | None) -> ClampPath:
    positions = arrays["positions_mm"]
    if positions.ndim not in (3, 4) or positions.shape[-1] != 3 or positions.shape[-2] < 3:
        raise InputError(path, "positions_mm", f"shape {positions.shape}", "make it (T, V, 3) or (N, T, V, 3) with V >= 3")
    positions = positions[:, None] if positions.ndim == 3 else positions.swapaxes(0, 1)
    time = arrays.get("time_s")
    if time is not None and time.shape != positions.shape[:1]:
        raise InputError(path, "time_s", f"shape {time.shape}", f"make it ({len(positions)},)")
    if time is None and rate is not None and rate.size == 1 and rate.item() > 0:
        time = np.arange(len(positions)) / rate.item()
    return path_of_marks(positions, time, str(path))


def path_table(path: ClampPath) -> str:
    """The path of the grippers of one rod as CSV, which ``predict --motion`` reads."""
    names, columns = ["time_s"], [path.time[:, None]]
    for end in ("start", "end"):
        names += [f"{end}_{axis}_mm" for axis in AXES] + list(frame_columns(f"{end}_frame"))
        columns += [getattr(path, f"{end}_position")[:, 0], getattr(path, f"{end}_frame")[:, 0].reshape(path.moments, 9)]
    rows = np.concatenate(columns, axis=1)
    return csv_text(names, rows)
