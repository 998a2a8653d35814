"""Poses of grippers in CSV files, of this package and of robots' logs: one row per moment, to the keys of motion files
(docs/motions.md).

Names are known in any case, with points or slashes for underscores, and as logs write them: ``end.pose.position.x``,
``end/orientation/w``. The time is time, timestamp, stamp or t, also in ms, us or ns; roll, pitch and yaw are turns about the
fixed x, then y, then z. Columns without ``start`` and ``end`` are those of the end gripper, where none has them. Other columns
are ignored.
"""

import os
import re
from collections.abc import Mapping
from difflib import get_close_matches
from pathlib import Path

import numpy as np

from doo_ti.io.arrays import AXES, LENGTH_ENDINGS, NEARLY, CsvTable, frame_columns, given_columns, listed, read_csv, read_npz
from doo_ti.rod.frames import matrix_from_quaternion, rotation_matrix
from doo_ti.system.errors import InputError, real_array, require
from doo_ti.system.files import read_content

ENDS = ("start", "end")
NAMED = ("time", *ENDS)
"""What a user may say is called otherwise: the column of the time, and what the columns of a gripper begin with."""
FORM = "time_s, start_x_mm, start_y_mm, start_z_mm, start_qw, …, end_x_mm, …, end_rotation_deg"
_TIMES = {f"{name}{unit}": factor for name in ("time", "timestamp", "stamp", "t")
          for unit, factor in (("_s", 1.0), ("", 1.0), ("_ms", 1e-3), ("_us", 1e-6), ("_ns", 1e-9))}
_POSITION, _ORIENTATION = re.compile(r"^(pose_)?(position|translation|pos|t)_?(?=[xyz](_|$))"), re.compile(
    r"^(pose_)?(orientation|quaternion|quat|q)_?(?=[wxyz]$)")
_ANGLE_ENDINGS = {"": 1.0, "_rad": 1.0, "_deg": np.pi / 180}  # of a column of angles: rad in its unit
_QUATERNION, _VECTOR, _TURNS = ("qw", "qx", "qy", "qz"), ("rx", "ry", "rz"), ("roll", "pitch", "yaw")
LARGEST_MISFIT = 1e-2  # of the length of a quaternion from one


def read_poses(path: Path, named: Mapping[str, str] | None = None) -> tuple[dict[str, np.ndarray], dict[str, float]]:
    """The keys of motion files from a CSV file, and mm in the unit of each position, in which it still is.

    named  some of :data:`NAMED`: their names in the file

    Raises InputError for files without poses, columns that lack others, and orientations that are none.
    """
    table = read_csv(path, (), form=FORM)
    columns = {_plain(name): name for name in table.columns}
    keys, units = {}, {}
    time = _time(path, columns, dict(named or {}))
    if time is not None:
        keys["time_s"] = time[1] * table.numbers(time[0])
    prefixes = {end: _plain((named or {}).get(end, end)) for end in ENDS}
    found = {end: _local(columns, f"{prefix}_") for end, prefix in prefixes.items()}
    for end in (end for end in ENDS if end in (named or {}) and not found[end]):
        raise InputError(path, "columns", f"none begins with {named[end]!r}", f"the file has {listed(table.columns)}")
    if not any(_poses(local) for local in found.values()):
        found["end"] = _local(columns, "") | found["end"]
    for end, local in found.items():
        _add(table, end, local, keys, units)
    if "end_rotation_deg" in columns:
        keys["end_rotation_deg"] = table.numbers(columns["end_rotation_deg"])
    if not keys.keys() - {"time_s"}:
        first = next((name for name in table.columns if time is None or name != time[0]), "header")
        raise InputError(path, first, "no pose of a gripper", f"give some of {FORM}")
    used = {*_TIMES, "end_rotation_deg"}
    alike = next((name for plain, name in columns.items() if plain not in used and
                  get_close_matches(plain, ["end_rotation_deg"], 1, NEARLY)), None)
    require(alike is None, path, alike, f"unknown column {alike!r}", "name it end_rotation_deg, or otherwise")
    return keys, units


def holds_poses(path: Path) -> bool:
    """Whether a CSV or npz file states poses of grippers, by its names."""
    if path.suffix == ".npz":
        names = tuple(f"{end}_{what}" for end in ENDS for what in ("position_mm", "frame", "quaternion"))
        found = read_npz(path, read_content(path), (*names, "positions_mm")).keys()
        return bool(found) and "positions_mm" not in found
    if path.suffix != ".csv" or not os.path.isfile(path):
        return False
    try:
        columns = {_plain(name): name for name in read_csv(path, ()).columns}
    except InputError:
        return False
    return any(_poses(_local(columns, prefix)) for prefix in ("start_", "end_")) or "qw" in _local(columns, "")


def _plain(name: str) -> str:
    return re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")


def _local(columns: dict[str, str], prefix: str) -> dict[str, str]:
    """The columns that begin with ``prefix``, by their short names without it."""
    found = {}
    for plain, name in columns.items():
        if plain.startswith(prefix):
            short = _POSITION.sub("", plain[len(prefix) :])
            found.setdefault(_ORIENTATION.sub("q", short), name)
    return found


def _poses(local: dict[str, str]) -> bool:
    """Whether there is any pose among the columns of a gripper."""
    positions = {f"{axis}{ending}" for axis in AXES for ending in LENGTH_ENDINGS}
    angles = {f"{name}{ending}" for name in (*_VECTOR, *_TURNS) for ending in _ANGLE_ENDINGS}
    return bool(local.keys() & (positions | angles | {*_QUATERNION} | {"frame_t_x"}))


def _time(path: Path, columns: dict[str, str], named: dict[str, str]) -> tuple[str, float] | None:
    """The column of the time, and s in its unit."""
    if (own := named.get("time")) is not None:
        require(_plain(own) in columns, path, own, "the column is missing", f"the file has {listed(columns.values())}")
        unit = re.search(r"_(ms|us|ns)$", _plain(own))
        return columns[_plain(own)], _TIMES[f"time_{unit[1]}"] if unit else 1.0
    return next(((columns[name], factor) for name, factor in _TIMES.items() if name in columns), None)


def _add(table: CsvTable, end: str, local: dict[str, str], keys: dict, units: dict) -> None:
    """Add the pose of one gripper to ``keys``."""
    for ending, factor in LENGTH_ENDINGS.items():
        if values := _columns(table, local, [f"{axis}{ending}" for axis in AXES]):
            keys[f"{end}_position_mm"], units[f"{end}_position_mm"] = np.stack(values, axis=-1), factor
            break
    frames = {}
    if values := _columns(table, local, list(frame_columns("frame"))):
        frames["frame"] = np.stack(values, axis=-1).reshape(-1, 3, 3)
    if values := _columns(table, local, list(_QUATERNION)):
        frames["quaternion"] = frame_of_quaternion(table.path, local["qw"], np.stack(values, axis=-1))
    for ending, factor in _ANGLE_ENDINGS.items():
        if values := _angles(table, local, _VECTOR, ending):
            frames["rotation vector"] = rotation_matrix(factor * np.stack(values, axis=-1))
        if values := _angles(table, local, _TURNS, ending):
            about = [rotation_matrix(factor * value[:, None] * np.eye(3)[k]) for k, value in enumerate(values)]
            frames["turns"] = about[2] @ about[1] @ about[0]
    require(len(frames) <= 1, table.path, end, f"orientation as {' and as '.join(frames)}", "give one of them")
    for kind, frame in frames.items():
        keys[f"{end}_frame" if kind == "frame" else f"{end}_orientation"] = frame


def _angles(table: CsvTable, local: dict[str, str], names: tuple[str, ...], unit: str) -> list[np.ndarray]:
    """The numbers in the columns ``names`` with that ``unit``. Raises InputError for more than a turn without a unit: they are
    in degrees, or turns are counted."""
    values = _columns(table, local, [f"{name}{unit}" for name in names])
    largest = np.nanmax(np.abs(values), axis=1, initial=0.0) if values else np.zeros(1)
    if not unit and largest.max() > 2 * np.pi:
        name = local.get(names[largest.argmax()], names[0])
        raise InputError(table.path, name, f"{largest.max():.4g} rad, more than a turn",
                         f"name the columns {name}_deg, or {name}_rad if they are in radians, and so on")
    return values


def _columns(table: CsvTable, local: dict[str, str], names: list[str]) -> list[np.ndarray]:
    """The numbers in the columns with those short names, none where there are none of them. Raises InputError for some."""
    if not local.keys() & set(names):
        return []
    first = next(name for name in names if name in local)
    before, _, behind = local[first].lower().rpartition(first)
    whole = {name: local.get(name, f"{before}{name}{behind}") for name in names}
    given_columns(table.path, tuple(whole.values()), table.columns)
    return [table.numbers(name) for name in whole.values()]


def put_frames(path: Path, arrays: dict[str, np.ndarray], name: str) -> None:
    """In place of ``start_quaternion`` and ``end_quaternion`` in ``arrays``, their frames as ``start_NAME`` and ``end_NAME``.
    Raises InputError for a quaternion beside a frame of the same end."""
    for end in ENDS:
        if (quaternion := arrays.pop(f"{end}_quaternion", None)) is not None:
            require(f"{end}_frame" not in arrays, path, f"{end}_quaternion", f"given beside {end}_frame", "give one of them")
            arrays[f"{end}_{name}"] = frame_of_quaternion(path, f"{end}_quaternion", quaternion)


def frame_of_quaternion(path: Path, field: str, quaternion: np.ndarray) -> np.ndarray:
    """(T, 3, 3) of (T, 4) unit quaternions, the scalar first. Raises InputError for others."""
    quaternion = real_array(path, field, quaternion, "give unit quaternions, the scalar as qw").astype(np.float64)
    if quaternion.ndim != 2 or quaternion.shape[1] != 4:
        raise InputError(path, field, f"shape {quaternion.shape}", "give four numbers in each row, the scalar first")
    length = np.linalg.norm(quaternion, axis=-1, keepdims=True)
    wrong = np.flatnonzero(~(np.abs(length[:, 0] - 1) < LARGEST_MISFIT))
    if len(wrong):
        raise InputError(path, field, f"row {wrong[0]} has a quaternion of length {length[wrong[0], 0]:.4g}",
                         "give unit quaternions, the scalar as qw")
    return matrix_from_quaternion(quaternion / length)
