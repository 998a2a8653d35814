"""Scenes of rods in motion, in one TOML file.

    name = "whip"
    rate_hz = 200                      # frames per second
    duration_s = 1.0
    substeps = 2                       # time steps from one frame to the next (1)
    quasi_static = true                # without inertia and drag: every step is an equilibrium, with friction (false)
    scheme = "bdf2"                    # or "euler"

    [rod]
    length_mm = 1000.0
    edges = 40
    direction = [0, 0, -1]             # in which it is straight at first (along x)
    position_mm = [0, 0, 0]            # of its first vertex (the origin)
    at_rest = true                     # relaxed before the motion begins (false: it begins straight)
    vertex_clamps = true               # clamps act at the end vertices, not in the middle of the outer edges (false)
    radius_mm = 3.0                    # needed with obstacles and with a knot
    knot_loop_mm = 20.0                # an open overhand knot in its middle at first, with a loop of that radius (none)
    knot_finer = 4.0                   # edges in the knot, where it touches itself, are so many times shorter (as needed)

    [materials.rope]                   # one or more, all in the same motion
    bend = 6e5                         # mm³, or EI in N m²: doo_ti/io/material_keys.py; not a matrix
    twist = 8e5
    weight = 1.0
    density = 1.0                      # mass per length over that of a rod of weight 1 (the weight)
    bend_damping_s = 0.01              # (0)
    twist_damping_s = 0.01             # (0)
    drag_per_s = 0.1                   # (0)
    quadratic_drag_per_mm = 1e-5       # (0)

    [clamps]                           # free, position, tangent or frame
    start = "frame"                    # (frame)
    end = "free"                       # (free)

    [[moments]]                        # of the clamps, none or more; what is left out stays as it was; smooth between them
    time_s = 0.0
    start_position_mm = [0, 0, 0]
    start_direction = [0, 0, -1]
    end_position_mm = [0, 0, -1000]
    end_direction = [0, 0, -1]
    start_turns = 0.0                  # about its direction, since the beginning (0)
    end_turns = 2.5

    [circle]                           # on which the start runs besides, horizontal
    radius_mm = 50.0
    turns_per_s = 1.5

    [[obstacles]]                      # none or more, which may move, see doo_ti/contact/obstacle_file.py
    kind = "plane"
    point = [0, 0, -900]
    normal = [0, 0, 1]
    friction = 0.3
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from msgspec import Meta

from doo_ti.contact.obstacle_file import obstacles_of
from doo_ti.contact.surroundings import Surroundings
from doo_ti.dynamics.grippers import Grippers
from doo_ti.dynamics.inertia_keys import InertiaKeys
from doo_ti.dynamics.parameters import Dynamics, Stepping
from doo_ti.io.clamp_moments import ClampName, end_paths, instants
from doo_ti.io.material_keys import newtons, stated_material
from doo_ti.io.motion_scene import rod_radius
from doo_ti.io.toml_file import Finite, Positive, Table, Vector, checked, read_toml, unit_direction
from doo_ti.rod.frames import quaternion_product, smallest_rotation
from doo_ti.rod.knots import overhand_knot
from doo_ti.rod.straight import with_end_edges
from doo_ti.rod.types import Clamp, Configuration, Material
from doo_ti.system.errors import InputError
from doo_ti.system.terminal import in_line

MOST_FRAMES = 1_000_000


@dataclass(frozen=True)
class DynamicScene:
    """A scene, checked: one rod ``start``, relaxed first where ``at_rest``, under G materials called ``names``; ``newtons``
    (G,) are N in the unit of force of each, or None."""

    name: str
    names: tuple[str, ...]
    start: Configuration
    at_rest: bool
    material: Material
    dynamics: Dynamics
    grippers: Grippers
    stepping: Stepping
    surroundings: Surroundings
    newtons: np.ndarray | None = None


class _File(Table):
    rate_hz: Positive
    duration_s: Positive
    rod: dict
    materials: Annotated[dict, Meta(min_length=1)]
    name: str | None = None
    substeps: Annotated[int, Meta(ge=1, le=1000)] = 1
    scheme: Literal["bdf2", "euler"] = "bdf2"
    clamps: dict = {}
    moments: list = []
    circle: dict | None = None
    obstacles: list = []
    quasi_static: bool = False


class _Rod(Table):
    length_mm: Annotated[float, Meta(ge=1e-6, le=1e6)]
    edges: Annotated[int, Meta(ge=4, le=10_000)]
    direction: Vector = (1.0, 0.0, 0.0)
    position_mm: Vector = (0.0, 0.0, 0.0)
    at_rest: bool = False
    vertex_clamps: bool = False
    radius_mm: Positive | None = None
    knot_loop_mm: Positive | None = None
    knot_finer: Positive | None = None


class _Material(InertiaKeys, kw_only=True):
    bend: Positive | None = None
    EI: Positive | None = None


class _Clamps(Table):
    start: ClampName = "frame"
    end: ClampName = "free"


class _Circle(Table):
    radius_mm: Positive
    turns_per_s: Finite


def load_dynamic_scene(path: str | Path) -> DynamicScene:
    """The scene of a TOML file. Raises InputError for unreadable files, unknown keys, wrong types and values."""
    path = Path(path)
    file = checked(path, "", read_toml(path)[0], _File)
    rod, clamps = checked(path, "rod", file.rod, _Rod), checked(path, "clamps", file.clamps, _Clamps)
    time = instants(path, file.rate_hz, file.duration_s, MOST_FRAMES, "frames")
    start = _start(path, rod, unit_direction(path, "rod.direction", rod.direction))
    start = with_end_edges(start) if rod.vertex_clamps else start
    grippers = _grippers(path, file, clamps, start, time)
    names = tuple(map(in_line, file.materials))
    material, dynamics, in_newton = _materials(path, file.materials)
    surroundings = Surroundings(obstacles_of(path, file.obstacles, time), rod_radius(path, file.obstacles, rod.radius_mm))
    return DynamicScene(in_line(path.stem if file.name is None else file.name), names, start, rod.at_rest, material, dynamics,
                        grippers, Stepping(file.rate_hz, file.substeps, file.scheme, quasi_static=file.quasi_static),
                        surroundings, in_newton)


def _start(path: Path, rod: _Rod, direction: np.ndarray) -> Configuration:
    """The rod as it is at first."""
    if rod.knot_loop_mm is None:
        return Configuration.straight(rod.position_mm, direction, rod.length_mm, rod.edges)
    if rod.radius_mm is None:
        raise InputError(path, "rod.radius_mm", "missing beside a knot", "give the radius of the rod")
    try:
        knot = overhand_knot(rod.length_mm, rod.edges, radius=rod.radius_mm, loop=rod.knot_loop_mm, finer=rod.knot_finer)
    except InputError as error:
        key = f"{error.field}_mm" if error.field in ("length", "radius") else error.field
        raise InputError(path, f"rod.{key}", error.problem, error.remedy.replace("`finer`", "knot_finer")) from None
    turn = smallest_rotation(np.array([1.0, 0.0, 0.0]), direction)
    return Configuration(np.array([rod.position_mm], dtype=np.float64), quaternion_product(turn, knot.quaternions),
                         knot.rest_length)


def _materials(path: Path, table: dict) -> tuple[Material, Dynamics, np.ndarray | None]:
    keys = {f"materials.{name}": checked(path, f"materials.{name}", values, _Material) for name, values in table.items()}
    found = [stated_material(path, key, one) for key, one in keys.items()]
    material = Material(*(np.array([getattr(one, field) for one in found]) for field in ("bend", "twist", "weight")))
    each = [one.dynamics(path, key, own.weight) for (key, one), own in zip(keys.items(), found, strict=True)]
    return material, Dynamics(*(np.array([getattr(own, name) for own in each]) for name in (
        "density", "bend_damping", "twist_damping", "drag", "quadratic_drag"))), newtons(found)


def _grippers(path: Path, file: _File, clamps: _Clamps, start: Configuration, time: np.ndarray) -> Grippers:
    held = end_paths(path, "moments", file.moments, start, time)
    begin = held.start_position
    if file.circle is not None:
        circle = checked(path, "circle", file.circle, _Circle)
        angle = 2 * np.pi * circle.turns_per_s * time
        begin = begin + circle.radius_mm * np.stack([np.cos(angle) - 1, np.sin(angle), 0 * angle], axis=-1)
    return Grippers(Clamp[clamps.start.upper()], Clamp[clamps.end.upper()], begin[None], held.end_position[None],
                    held.start_frame[None], held.end_frame[None])
