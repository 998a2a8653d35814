"""Scenes of rods in motion, in one TOML file, for ``simulate`` and ``predict``, whose keys docs/scenes.md explains.

    name, rate_hz, duration_s, ...     frames per second, how long, and the time steps between frames
    [rod]                              the one rod: straight at first, or with a knot
    [materials.NAME]                   one or more, all in the same motion
    [clamps]                           how the ends are held
    [[moments]], [circle]              where, from moment to moment
    [[obstacles]]                      which may move (:mod:`doo_ti.contact.obstacle_file`)

Without rate_hz ``predict`` goes straight from one moment to the next, in ``between`` states, and the rod is at first straight
where the first moment has it. What is computed begins at the first moment: the rod is brought there before.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from msgspec import Meta

from doo_ti.contact.obstacle_file import obstacles_of
from doo_ti.contact.surroundings import Surroundings
from doo_ti.dynamics.grippers import Grippers
from doo_ti.dynamics.parameters import Dynamics, Stepping
from doo_ti.io import toml_file
from doo_ti.io.motion_file import MOST_MOMENTS, ClampPath
from doo_ti.io.toml_file import ClampName, Finite, MaterialKeys, Moment, NotNegative, Positive, Table, Vector, checked
from doo_ti.rod.frames import quaternion_product, smallest_rotation, unit_direction
from doo_ti.rod.shapes import end_clamps, overhand_knot, with_end_edges
from doo_ti.rod.types import POSES, Clamp, Clamps, Configuration, Material
from doo_ti.system.errors import InputError
from doo_ti.system.terminal import in_line

MOST_FRAMES = 1_000_000


@dataclass(frozen=True)
class MotionScene:
    """A scene, checked.

    names     G of the materials; ``newtons`` (G,) N in the unit of force of each, or None
    start     one rod, relaxed first where ``at_rest``, and ``clamps`` that hold it there
    time      (T,) s of the instants, or without a rate of the moments, and ``held`` where its ends are then
    between   states from one of them to the next
    dynamics, stepping  of rods with inertia; None without a rate
    """

    name: str
    names: tuple[str, ...]
    material: Material
    newtons: np.ndarray | None
    start: Configuration
    at_rest: bool
    clamps: Clamps
    time: np.ndarray
    held: toml_file.EndPaths
    between: int
    source: str
    obstacles: list
    radius: float | None
    dynamics: Dynamics | None
    stepping: Stepping | None

    @property
    def path(self) -> ClampPath:
        """Where the clamps go."""
        return ClampPath(self.time, *(getattr(self.held, name)[:, None] for name in (*POSES, "end_rotation")),
                         source=self.source)

    @property
    def grippers(self) -> Grippers:
        """The same at the instants of a motion."""
        return Grippers(self.clamps.start, self.clamps.end, *(getattr(self.held, name)[None] for name in POSES))

    def surroundings(self, between: int = 1) -> Surroundings:
        """What the rods may touch, at as many states ``between`` the instants. Raises InputError for wrong obstacles."""
        if not 1 <= between <= MOST_MOMENTS // (len(self.time) - 1):
            raise InputError(self.source, "between", f"{between}", f"give 1 to {MOST_MOMENTS // (len(self.time) - 1)}")
        states = np.interp(np.arange(between * (len(self.time) - 1) + 1) / between, np.arange(len(self.time)), self.time)
        return Surroundings(obstacles_of(self.source, self.obstacles, states), self.radius)


class InertiaKeys(MaterialKeys, kw_only=True):
    """Keys of a material and of a rod's mass and losses."""

    density: Positive | None = None
    bend_damping_s: NotNegative = 0.0
    twist_damping_s: NotNegative = 0.0
    drag_per_s: NotNegative = 0.0
    quadratic_drag_per_mm: NotNegative = 0.0

    def dynamics(self, path: Path, key: str, weight: float) -> Dynamics:
        """Those of rods with that ``weight``. Raises InputError, naming the table ``key``, for rods without mass."""
        density = weight if self.density is None else self.density
        if not density > 0:
            raise InputError(path, f"{key}.density", "missing for a rod without weight",
                             "give its mass per length over that of a rod of weight 1")
        return Dynamics(density, self.bend_damping_s, self.twist_damping_s, self.drag_per_s, self.quadratic_drag_per_mm)


class _File(Table):
    rod: dict
    materials: Annotated[dict, Meta(min_length=1)]
    rate_hz: Positive | None = None
    duration_s: Positive | None = None
    between: Annotated[int, Meta(ge=1, le=100_000)] = 1
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


class _Clamps(Table):
    start: ClampName = "frame"
    end: ClampName | None = None


class _Circle(Table):
    radius_mm: Positive
    turns_per_s: Finite


def load_motion_scene(path: str | Path) -> MotionScene:
    """The scene of a TOML file. Raises InputError for unreadable files, unknown keys, wrong types and values."""
    path = Path(path)
    file = checked(path, "", toml_file.read_toml(path)[0], _File)
    rod, kinds = checked(path, "rod", file.rod, _Rod), checked(path, "clamps", file.clamps, _Clamps)
    if file.obstacles and rod.radius_mm is None:
        raise InputError(path, "rod.radius_mm", "missing beside obstacles", "give the radius of the rod")
    time = _times(path, file)
    start = _start(path, rod, file)
    start = with_end_edges(start) if rod.vertex_clamps else start
    clamps = end_clamps(start, *(Clamp[name.upper()] for name in (
        kinds.start, kinds.end or ("frame" if file.rate_hz is None else "free"))))
    names, material, dynamics, in_newton = _materials(path, file)
    stepping = None if file.rate_hz is None else Stepping(
        file.rate_hz, file.substeps, file.scheme, quasi_static=file.quasi_static)
    return MotionScene(in_line(path.stem if file.name is None else file.name), names, material, in_newton, start, rod.at_rest,
                       clamps, time, _held(path, file, start, time), file.between, str(path), file.obstacles, rod.radius_mm,
                       dynamics, stepping)


def stated_instants(path: Path, file, most: int, called: str) -> np.ndarray | None:
    """(T,) s the instants that rate_hz and duration_s of a file state; None where it has neither. Raises InputError where one
    is missing."""
    if (file.rate_hz is None) != (file.duration_s is None):
        missing, other = ("rate_hz", "duration_s") if file.rate_hz is None else ("duration_s", "rate_hz")
        raise InputError(path, missing, f"missing beside {other}", "give both, or neither")
    return None if file.rate_hz is None else toml_file.instants(path, file.rate_hz, file.duration_s, most, called)


def _times(path: Path, file: _File) -> np.ndarray:
    """(T,) s: the instants, or without a rate the moments."""
    time = stated_instants(path, file, MOST_FRAMES, "frames")
    if time is not None:
        return time
    if len(file.moments) < 2:
        raise InputError(path, "moments", f"{len(file.moments)}", "give two or more, or rate_hz and duration_s")
    return np.array([checked(path, f"moments[{k}]", row, Moment).time_s for k, row in enumerate(file.moments)])


def _start(path: Path, rod: _Rod, file: _File) -> Configuration:
    """The rod as it is at first."""
    position, direction, key = rod.position_mm, rod.direction, "rod.direction"
    if file.rate_hz is None:
        first = checked(path, "moments[0]", file.moments[0], Moment)
        position = first.start_position_mm or position
        direction, key = (first.start_direction, "moments[0].start_direction") if first.start_direction else (direction, key)
    direction = unit_direction(path, key, direction)
    if rod.knot_loop_mm is None:
        return Configuration.straight(position, direction, rod.length_mm, rod.edges)
    if rod.radius_mm is None:
        raise InputError(path, "rod.radius_mm", "missing beside a knot", "give the radius of the rod")
    try:
        knot = overhand_knot(rod.length_mm, rod.edges, radius=rod.radius_mm, loop=rod.knot_loop_mm, finer=rod.knot_finer)
    except InputError as error:
        key = f"{error.field}_mm" if error.field in ("length", "radius") else error.field
        raise InputError(path, f"rod.{key}", error.problem, error.remedy.replace("`finer`", "knot_finer")) from None
    turn = smallest_rotation(np.array([1.0, 0.0, 0.0]), direction)
    return Configuration(np.array([position], dtype=np.float64), quaternion_product(turn, knot.quaternions),
                         knot.rest_length)


def _materials(path: Path, file: _File) -> tuple[tuple[str, ...], Material, Dynamics | None, np.ndarray | None]:
    keys = {f"materials.{name}": checked(path, f"materials.{name}", values, InertiaKeys)
            for name, values in file.materials.items()}
    found = [checked_material(path, key, one)[0] for key, one in keys.items()]
    material = Material(*(np.array([getattr(one, field) for one in found]) for field in ("bend", "twist", "weight")))
    return (tuple(map(in_line, file.materials)), material,
            None if file.rate_hz is None else _dynamics(path, keys, found), toml_file.newtons(found))


def checked_material(path: Path, key: str, keys: MaterialKeys, unit_density: float | None = None
                     ) -> tuple[toml_file.StatedMaterial, Material]:
    """What the table ``key`` states (:func:`.stated_material`), and the material. Raises InputError, naming its key, for one
    that no rod has."""
    stated = toml_file.stated_material(path, key, keys, unit_density)
    try:
        return stated, Material(stated.bend[None], stated.twist, stated.weight)
    except InputError as error:
        field = error.field if keys.EI is None else {"bend": "EI", "twist": "GJ"}.get(error.field, error.field)
        raise InputError(path, f"{key}.{field}", error.problem, error.remedy) from None


def _dynamics(path: Path, keys: dict[str, InertiaKeys], found: list[toml_file.StatedMaterial]) -> Dynamics:
    """Of rods with inertia, which are round."""
    for key, one in keys.items():
        if isinstance(one.bend, tuple) or isinstance(one.EI, tuple):
            raise InputError(path, f"{key}.{'bend' if one.EI is None else 'EI'}", "a matrix", "give a number, or no rate_hz")
    each = [one.dynamics(path, key, own.weight) for (key, one), own in zip(keys.items(), found, strict=True)]
    return Dynamics(*(np.array([getattr(own, name) for own in each]) for name in (
        "density", "bend_damping", "twist_damping", "drag", "quadratic_drag")))


def _held(path: Path, file: _File, start: Configuration, time: np.ndarray) -> toml_file.EndPaths:
    held = toml_file.end_paths(path, "moments", file.moments, start, time)
    if file.circle is None:
        return held
    circle = checked(path, "circle", file.circle, _Circle)
    angle = 2 * np.pi * circle.turns_per_s * time
    return replace(held, start_position=held.start_position + circle.radius_mm * np.stack(
        [np.cos(angle) - 1, np.sin(angle), 0 * angle], axis=-1))
