"""Scenes of motion: a straight rod, its materials, and the motion of its clamps, in one TOML file.

    name = "loop"
    between = 40                       # moments kept from one to the next (1)

    [rod]
    length_mm = 99.0
    edges = 33
    radius_mm = 0.5                    # needed with obstacles
    vertex_clamps = true               # clamps act at the end vertices, not in the middle of the outer edges (false)

    [materials.vicryl]                 # one or more, all under the same motion
    bend = 6e5                         # mm³, or EI in N m²: doo_ti/io/material_keys.py
    twist = 8e5
    weight = 1.0

    [[moments]]                        # two or more; omitted quantities stay as they were
    time_s = 0.0
    start_position_mm = [0, 0, 0]      # at first the origin
    start_direction = [1, 0, 0]        # of the first edge, at first along x
    end_position_mm = [90, 0, 0]       # at first where the straight rod ends
    end_direction = [1, 0, 0]          # of the last edge
    end_rotation_deg = 0.0             # of the last edge about itself, whole turns included

    [[obstacles]]                      # none or more, which may move, see doo_ti/contact/obstacle_file.py
    kind = "sphere"
    centre = [50, 0, -20]
    radius = 15.0

The rod is straight at first, at the start position of the first moment, and is brought to that moment before the time begins.
"""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from msgspec import Meta

from doo_ti.io.material_keys import MaterialKeys, newtons, stated_material
from doo_ti.io.motion_file import ClampPath
from doo_ti.io.toml_file import Finite, Positive, Table, Vector, checked, read_toml, unit_direction
from doo_ti.rod.frames import (
    across,
    bishop_frames,
    matrix_from_quaternion,
    quaternion_about,
    quaternion_from_matrix,
    quaternion_product,
    smallest_rotation,
)
from doo_ti.rod.straight import with_end_edges
from doo_ti.rod.types import LARGEST, Clamp, Clamps, Configuration, Material
from doo_ti.system.errors import InputError
from doo_ti.system.terminal import in_line

MOST_EDGES = 10_000


@dataclass(frozen=True)
class MotionScene:
    """A scene of motion, checked.

    names      G of the materials
    material   G rows
    newtons    (G,) N in the unit of force of each material, or None
    start      one rod, straight, and ``clamps`` that hold it there
    path       where the clamps go
    between    moments kept from one to the next
    obstacles  as they are written, with the ``radius`` of the rod in mm, or None without
    """

    name: str
    names: tuple[str, ...]
    material: Material
    start: Configuration
    clamps: Clamps
    path: ClampPath
    between: int
    source: str
    obstacles: list
    radius: float | None
    newtons: np.ndarray | None = None


class _File(Table):
    """A scene of motion as it is written."""

    rod: dict
    materials: Annotated[dict, Meta(min_length=1)]
    moments: Annotated[list, Meta(min_length=2)]
    name: str | None = None
    between: Annotated[int, Meta(ge=1, le=100_000)] = 1
    obstacles: list = []


class _Rod(Table):
    length_mm: Annotated[float, Meta(ge=1e-6, le=LARGEST)]
    edges: Annotated[int, Meta(ge=4, le=MOST_EDGES)]
    radius_mm: Positive | None = None
    vertex_clamps: bool = False


class _Moment(Table):
    """One moment; omitted quantities stay as at the moment before."""

    time_s: Finite | None = None
    start_position_mm: Vector | None = None
    start_direction: Vector | None = None
    end_position_mm: Vector | None = None
    end_direction: Vector | None = None
    end_rotation_deg: Finite | None = None


def load_motion_scene(path: str | os.PathLike[str]) -> MotionScene:
    """The scene of a TOML file. Raises InputError for unreadable files, unknown keys, wrong types and values."""
    path = Path(path)
    file = checked(path, "", read_toml(path)[0], _File)
    rod = checked(path, "rod", file.rod, _Rod)
    names, material, in_newton = _materials(path, file.materials)
    moments = _moments(path, file.moments, rod.length_mm)
    start, clamps = _straight(moments, rod)
    return MotionScene(name=in_line(path.stem if file.name is None else file.name), names=names, material=material, start=start,
                       clamps=clamps, path=_path(moments, clamps, str(path)), between=file.between, source=str(path),
                       obstacles=file.obstacles, radius=rod_radius(path, file.obstacles, rod.radius_mm), newtons=in_newton)


def rod_radius(path: Path, obstacles: list, radius: float | None) -> float | None:
    """``radius``, the value of ``rod.radius_mm``. Raises InputError where a scene has ``obstacles`` without it."""
    if obstacles and radius is None:
        raise InputError(path, "rod.radius_mm", "missing beside obstacles", "give the radius of the rod")
    return radius


def _materials(path: Path, table: dict) -> tuple[tuple[str, ...], Material, np.ndarray | None]:
    found = []
    for name, values in table.items():
        keys = checked(path, f"materials.{name}", values, MaterialKeys)
        if keys.twist is None and keys.GJ is None:
            raise InputError(path, f"materials.{name}.{'twist' if keys.EI is None else 'GJ'}", "missing", "add it")
        found.append(stated_material(path, f"materials.{name}", keys))
    try:
        material = Material(*(np.array([getattr(one, field) for one in found]) for field in ("bend", "twist", "weight")))
    except InputError as error:
        raise InputError(path, f"materials: {error.field}", error.problem, error.remedy) from None
    return tuple(map(in_line, table)), material, newtons(found)


def _moments(path: Path, rows: list, length: float) -> dict[str, np.ndarray]:
    """The keys of a moment, (T) or (T, 3) each."""
    now = {"time_s": 0.0, "start_position_mm": (0.0, 0.0, 0.0), "start_direction": (1.0, 0.0, 0.0), "end_position_mm": None,
           "end_direction": (1.0, 0.0, 0.0), "end_rotation_deg": 0.0}
    found = {key: [] for key in now}
    for number, row in enumerate(rows):
        moment = checked(path, f"moments[{number}]", row, _Moment)
        if number and moment.time_s is None:
            raise InputError(path, f"moments[{number}].time_s", "missing", "give every moment after the first its time")
        for key in now:
            value = now[key] if getattr(moment, key) is None else np.array(getattr(moment, key))
            if key.endswith("direction"):
                value = unit_direction(path, f"moments[{number}].{key}", value)
            if key == "end_position_mm" and value is None:
                value = now["start_position_mm"] + length * now["start_direction"]
            now[key] = value
            found[key].append(value)
    return {key: np.array(values) for key, values in found.items()}


def _straight(moments: dict[str, np.ndarray], rod: _Rod) -> tuple[Configuration, Clamps]:
    start = Configuration.straight(moments["start_position_mm"][0], moments["start_direction"][0], rod.length_mm, rod.edges)
    start = with_end_edges(start) if rod.vertex_clamps else start
    frame = bishop_frames(moments["start_direction"][:1, None], across(moments["start_direction"][:1]))[:, 0]
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
