"""Scenes of motion: a straight rod, the materials it may be of, and where its clamps go, in one TOML file.

    name = "loop"
    between = 40                       # moments kept from one to the next (1)

    [rod]
    length_mm = 99.0
    edges = 33

    [materials.vicryl]                 # one or more, all under the same motion
    bend = 6e5                         # mm³, or a matrix [[A1, A12], [A12, A2]]
    twist = 8e5                        # mm³
    weight = 1.0                       # (1)

    [[moments]]                        # two or more; what is left out is as at the moment before
    time_s = 0.0
    start_position_mm = [0, 0, 0]      # at first the origin
    start_direction = [1, 0, 0]        # of the first edge, at first along x
    end_position_mm = [90, 0, 0]       # at first where the straight rod ends
    end_direction = [1, 0, 0]          # of the last edge
    end_rotation_deg = 0.0             # of the last edge about itself, whole turns included

The rod sets out straight from the first moment's start and is brought to that moment before time runs.
"""

import os
import tomllib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from doo_ti.errors import InputError
from doo_ti.frames import (
    across,
    bishop_frames,
    matrix_from_quaternion,
    quaternion_about,
    quaternion_from_matrix,
    quaternion_product,
    smallest_rotation,
)
from doo_ti.io.files import MOST_TEXT_BYTES, read_content
from doo_ti.io.motion_file import ClampPath
from doo_ti.terminal import in_line
from doo_ti.types import LARGEST, Clamp, Clamps, Configuration, Material

MOMENT = {"time_s": 1, "start_position_mm": 3, "start_direction": 3, "end_position_mm": 3, "end_direction": 3,
          "end_rotation_deg": 1}
"""The keys of a moment, and how many numbers each holds."""
MOST_EDGES = 10_000


@dataclass(frozen=True)
class MotionScene:
    """What a scene of motion says.

    names      G of the materials
    material   G rows
    start      one rod, straight, and clamps what holds it there
    path       where the clamps go
    between    moments kept from one to the next
    """

    name: str
    names: tuple[str, ...]
    material: Material
    start: Configuration
    clamps: Clamps
    path: ClampPath
    between: int
    source: str


def load_motion_scene(path: str | os.PathLike) -> MotionScene:
    """The scene of a TOML file. Raises InputError for unreadable files, unknown keys, wrong types and values."""
    path = Path(path)
    content = read_content(path, MOST_TEXT_BYTES, "name a readable scene")
    try:
        table = tomllib.loads(content.decode())
    except (ValueError, RecursionError) as error:
        raise InputError(path, "file", f"not TOML ({error})", "correct the scene") from None
    _check_keys(path, "", table, ("name", "between", "rod", "materials", "moments"))
    rod = _table(path, table, "rod")
    _check_keys(path, "rod", rod, ("length_mm", "edges"))
    length = _number(path, "rod.length_mm", rod.get("length_mm"), least=1e-6)
    edges = _whole(path, "rod.edges", rod.get("edges"), 4, MOST_EDGES)
    names, material = _materials(path, _table(path, table, "materials"))
    moments = _moments(path, table.get("moments"), length)
    start, clamps = _straight(moments, length, edges)
    return MotionScene(
        name=in_line(table.get("name", path.stem)), names=names, material=material, start=start, clamps=clamps,
        path=_path(moments, clamps, str(path)), between=_whole(path, "between", table.get("between", 1), 1, 100_000),
        source=str(path))


def _materials(path: Path, table: dict) -> tuple[tuple[str, ...], Material]:
    if not table:
        raise InputError(path, "materials", "none", "add [materials.NAME] with bend and twist")
    bend, twist, weight = [], [], []
    for name, values in table.items():
        if not isinstance(values, dict):
            raise InputError(path, f"materials.{name}", f"{values!r} is no table", "give it bend and twist")
        _check_keys(path, f"materials.{name}", values, ("bend", "twist", "weight"))
        own = np.array(values.get("bend", np.nan), dtype=object)
        if own.shape not in ((), (2, 2)):
            raise InputError(path, f"materials.{name}.bend", f"{values['bend']!r}", "give α or a matrix [[A1, A12], [A12, A2]]")
        entries = [_number(path, f"materials.{name}.bend", entry) for entry in own.ravel()]
        bend.append(np.array(entries).reshape(2, 2) if own.shape else entries[0] * np.eye(2))
        twist.append(_number(path, f"materials.{name}.twist", values.get("twist")))
        weight.append(_number(path, f"materials.{name}.weight", values.get("weight", 1.0)))
    try:
        return tuple(map(in_line, table)), Material(np.array(bend), np.array(twist), np.array(weight))
    except InputError as error:
        raise InputError(path, f"materials: {error.field}", error.problem, error.remedy) from None


def _moments(path: Path, rows, length: float) -> dict[str, np.ndarray]:
    """The keys of MOMENT, (T) or (T, 3) each."""
    if not isinstance(rows, list) or len(rows) < 2 or not all(isinstance(row, dict) for row in rows):
        raise InputError(path, "moments", "not two or more tables", "add [[moments]] in the order of their times")
    along = np.array([1.0, 0.0, 0.0])
    first = rows[0].get("start_direction", along.tolist())
    before = {"time_s": 0.0, "start_position_mm": np.zeros(3), "start_direction": along, "end_position_mm": None,
              "end_direction": along, "end_rotation_deg": 0.0}
    found = {key: [] for key in MOMENT}
    for number, row in enumerate(rows):
        _check_keys(path, f"moments[{number}]", row, MOMENT)
        if number and "time_s" not in row:
            raise InputError(path, f"moments[{number}].time_s", "missing", "give every moment after the first its time")
        for key, size in MOMENT.items():
            if key in row:
                before[key] = _vector(path, f"moments[{number}].{key}", row[key], size)
            if key.endswith("direction"):
                if not (norm := np.linalg.norm(before[key])) > 0:
                    raise InputError(path, f"moments[{number}].{key}", "no direction", "give a vector X, Y, Z that is not zero")
                before[key] = before[key] / norm
        if before["end_position_mm"] is None:
            direction = _vector(path, "moments[0].start_direction", first, 3)
            before["end_position_mm"] = before["start_position_mm"] + length * direction / np.linalg.norm(direction)
        for key in MOMENT:
            found[key].append(before[key])
    return {key: np.array(values) for key, values in found.items()}


def _straight(moments: dict[str, np.ndarray], length: float, edges: int) -> tuple[Configuration, Clamps]:
    tangent = moments["start_direction"][:1]
    frame = bishop_frames(tangent[:, None], across(tangent))[:, 0]
    start = Configuration(moments["start_position_mm"][:1], np.tile(quaternion_from_matrix(frame)[:, None], (1, edges, 1)),
                          np.full(edges, length / edges))
    return start, Clamps(Clamp.FRAME, Clamp.FRAME, start.start, start.vertices[:, -1], frame, frame)


def _path(moments: dict[str, np.ndarray], clamps: Clamps, source: str) -> ClampPath:
    """Frames are carried from each direction to the next by the shortest way; the last edge's turn about it besides."""
    start_frames, end_frames = (_carried(clamps.start_frame[0], moments[f"{end}_direction"]) for end in ("start", "end"))
    rotation = np.radians(moments["end_rotation_deg"])
    turn = quaternion_about(end_frames[..., 0], rotation)
    end_frames = matrix_from_quaternion(quaternion_product(turn, quaternion_from_matrix(end_frames)))
    return ClampPath(moments["time_s"], moments["start_position_mm"][:, None], moments["end_position_mm"][:, None],
                     start_frames[:, None], end_frames[:, None], rotation[:, None], source=source)


def _carried(frame: np.ndarray, directions: np.ndarray) -> np.ndarray:
    frames = []
    for direction in directions:  # as many as there are moments in a scene
        frame = matrix_from_quaternion(smallest_rotation(frame[:, 0], direction)) @ frame
        frames.append(frame)
    return np.array(frames)


def _check_keys(path: Path, section: str, table: dict, known) -> None:
    unknown = [key for key in table if key not in known]
    if unknown:
        raise InputError(path, f"{section}.{unknown[0]}".lstrip("."), "unknown key", f"the keys are {', '.join(known)}")


def _table(path: Path, table: dict, key: str) -> dict:
    if not isinstance(table.get(key), dict):
        raise InputError(path, key, "missing, or no table", f"add the table [{key}]")
    return table[key]


def _number(path: Path, key: str, value, least: float = -LARGEST) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not least <= value <= LARGEST:
        raise InputError(path, key, "missing" if value is None else f"{value!r} is out of range", "give a number in range")
    return float(value)


def _whole(path: Path, key: str, value, least: int, most: int) -> int:
    if type(value) is not int or not least <= value <= most:
        raise InputError(path, key, "missing" if value is None else f"{value!r} is out of range", f"give {least} to {most}")
    return value


def _vector(path: Path, key: str, value, size: int):
    if size == 1:
        return _number(path, key, value)
    if not isinstance(value, list) or len(value) != size:
        raise InputError(path, key, f"{value!r} is no vector", "give [X, Y, Z]")
    return np.array([_number(path, key, entry) for entry in value])
