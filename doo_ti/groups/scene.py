"""Scenes of groups, in one TOML file, whose keys docs/scenes.md explains.

    name, radius_mm, rate_hz, ...      of all rods, and the moments of a motion; without a rate one relaxation
    [materials.NAME]                   one or more; ties and density are relative to the first one's weight
    [rods.NAME]                        one or more, in the order in which they are numbered: start, clamps and material
    [[rods.NAME.moments]]              of its clamps (:mod:`doo_ti.io.toml_file`); ends that are elsewhere are drawn there
    [[ties]]                           points that stay at one place
    [[obstacles]]                      kind "itself" has the rods' friction (:mod:`doo_ti.contact.obstacle_file`)
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from msgspec import UNSET, Meta, UnsetType

from doo_ti.contact import touch
from doo_ti.contact.obstacle_file import obstacles_of
from doo_ti.contact.surroundings import Surroundings
from doo_ti.dynamics.parameters import Dynamics
from doo_ti.dynamics.scene import InertiaKeys, checked_material, stated_instants
from doo_ti.groups.group import Group, Tie
from doo_ti.io import toml_file
from doo_ti.io.toml_file import ClampName, NotNegative, Positive, Table, Vector, checked
from doo_ti.relaxation.newton import MOST_IN_CONTACT, Newton
from doo_ti.rod.frames import unit_direction
from doo_ti.rod.material import STANDARD_GRAVITY
from doo_ti.rod.shapes import rod_along, with_end_edges
from doo_ti.rod.types import LARGEST, POSES, Clamp, Clamps, Configuration, Material
from doo_ti.system.errors import InputError, require
from doo_ti.system.terminal import in_line

MOST_MOMENTS, MOST_EDGES, MOST_POINTS = 100_000, 1000, 10_000
MOST_OF_ALL = 2000  # edges of all rods: the memory of their Newton system grows with the square, to half a gigabyte
MOST_HELD = 200_000  # rods times moments
SAME_UNIT = 1e-6
SAMPLES = 40  # of a curve, for each edge of the rod along it


@dataclass(frozen=True)
class GroupScene:
    """A scene, checked."""

    name: str
    names: tuple[str, ...]  # G of the rods
    group: Group  # one group, with the clamps of the first moment
    clamps: list[list[Clamps]]  # those of all T moments, each of G rods
    time: np.ndarray  # (T,) s; one moment where there is no motion
    rate: float  # moments per second
    surroundings: Surroundings  # the obstacles, and the radius of the rods, one or (1, G), where they touch each other
    dynamics: list[Dynamics] | None = None  # G of them, or None without inertia
    scheme: str | None = None  # of the time steps, as :func:`.follow_group` takes it
    newton: float | None = None  # N in the unit of force, where the materials state their mass per length, or None
    gap_tolerance: float | None = None  # of the rods' radius, as of :class:`.Newton`

    @property
    def arguments(self) -> dict:
        """What :func:`.follow_group` takes besides the group and its clamps."""
        inertia = {} if self.dynamics is None else {"dynamics": self.dynamics, "rate": self.rate, "scheme": self.scheme}
        solver = Newton(max_iterations=MOST_IN_CONTACT, gap_tolerance=self.gap_tolerance)
        return self.surroundings.arguments | inertia | {"solver": solver}


class _File(Table):
    materials: Annotated[dict, Meta(min_length=1)]
    rods: Annotated[dict, Meta(min_length=1)]
    name: str | None = None
    radius_mm: Positive | None = None
    rate_hz: Positive | None = None
    duration_s: Positive | None = None
    dynamic: bool = False
    scheme: Literal["bdf2", "euler"] | None = None
    gap_tolerance: Annotated[float, Meta(ge=touch.LEAST, le=touch.MOST)] | None = None
    ties: list = []
    obstacles: list = []


class _Rod(Table):
    edges: Annotated[int, Meta(ge=4, le=MOST_EDGES)]
    material: str | None = None
    radius_mm: Positive | None = None
    length_mm: Annotated[float, Meta(ge=1e-6, le=LARGEST)] | None = None
    position_mm: Vector | UnsetType = UNSET
    direction: Vector | UnsetType = UNSET
    points_mm: Annotated[list[Vector], Meta(min_length=2, max_length=MOST_POINTS)] | None = None
    closed: bool = False
    start: ClampName = "free"
    end: ClampName = "free"
    vertex_clamps: bool = False
    moments: list = []


class _Tie(Table):
    first: tuple[str, int]
    second: tuple[str, int]
    weight: NotNegative = 0.0
    mass_g: NotNegative | None = None
    weld: bool = False


def load_group_scene(path: str | Path) -> GroupScene:
    """The scene of a TOML file. Raises InputError for unreadable files, unknown keys and names, wrong types and values."""
    path = Path(path)
    values = toml_file.read_toml(path)[0]
    if "rods" not in values and {"rod", "grid", "clamps"} & values.keys():
        raise InputError(path, "rods", "missing: this is a scene of another command",
                         "give it to doo-ti simulate, predict or sweep")
    file = checked(path, "", values, _File)
    time = stated_instants(path, file, MOST_MOMENTS, "moments")
    time = np.zeros(1) if time is None else time
    found, newton = _materials(path, file.materials, file.dynamic)
    if file.dynamic and len(time) == 1:
        raise InputError(path, "rate_hz", "missing beside dynamic", "give it and duration_s")
    if len(time) * len(file.rods) > MOST_HELD:
        raise InputError(path, "duration_s", f"{len(time):,} moments of {len(file.rods)} rods",
                         f"give at most {MOST_HELD // len(file.rods):,} moments")
    rods, materials, dynamics, clamps, radii = [], [], [], [], []
    for name, table in file.rods.items():
        key = f"rods.{name}"
        rod = checked(path, key, table, _Rod)
        require(len(time) > 1 or len(rod.moments) < 2, path, "rate_hz", f"missing beside {key}.moments",
                "give it and duration_s")
        start = _start(path, key, rod)
        start = with_end_edges(start) if rod.vertex_clamps else start
        if rod.material is None and len(found) > 1:
            raise InputError(path, f"{key}.material", "missing beside several materials", f"give one of {', '.join(found)}")
        material = next(iter(found)) if rod.material is None else rod.material
        rods.append(start)
        radii.append(file.radius_mm if rod.radius_mm is None else rod.radius_mm)
        own = found[_known(path, f"{key}.material", material, found)]
        materials.append(own[0])
        dynamics.append(own[1])
        clamps.append(_clamps(path, key, rod, start, time))
    if (count := sum(rod.edges for rod in rods)) > MOST_OF_ALL:
        raise InputError(path, "rods", f"{count} edges in all", f"give at most {MOST_OF_ALL:,}")
    moments = [list(held) for held in zip(*clamps, strict=True)]
    ties = [_tie(path, f"ties[{number}]", row, list(file.rods), rods, newton) for number, row in enumerate(file.ties)]
    try:
        group = Group(rods, materials, moments[0], ties)
    except InputError as error:
        raise InputError(path, error.field, error.problem, error.remedy) from None
    if None in radii and (file.obstacles or any(radii)):
        raise InputError(path, "radius_mm", f"missing beside {'obstacles' if file.obstacles else 'that of one rod'}",
                         "give the radius of the rods")
    radius = radii[0] if len(set(radii)) == 1 else np.array([radii])
    return GroupScene(in_line(path.stem if file.name is None else file.name), tuple(map(in_line, file.rods)), group, moments,
                      time, file.rate_hz or 1.0, Surroundings(obstacles_of(path, file.obstacles), radius),
                      dynamics if file.dynamic else None, file.scheme, newton, file.gap_tolerance)


def _known(path: Path, key: str, name: str, names) -> str:
    """``name``, one of ``names``. Raises InputError where it is not."""
    if name not in names:
        raise InputError(path, key, f"{name!r} is not in the scene", f"give one of {', '.join(names)}")
    return name


def _materials(path: Path, tables: dict, moves: bool) -> tuple[dict[str, tuple[Material, Dynamics | None]], float | None]:
    """The materials by their names, and N in their common unit of force, or None."""
    keys = {name: checked(path, f"materials.{name}", table, InertiaKeys) for name, table in tables.items()}
    first = next(iter(keys.values()))
    odd = next((name for name, one in keys.items() if (one.EI is None) != (first.EI is None)), None)
    if odd is not None:
        raise InputError(path, f"materials.{odd}", "in other units than the first material",
                         "state all by bend, or all by EI and linear_density")
    unit = first.linear_density if first.EI is not None else None
    each = {name: checked_material(path, f"materials.{name}", one, unit) for name, one in keys.items()}
    found = {name: (material, keys[name].dynamics(path, f"materials.{name}", stated.weight) if moves else None)
             for name, (stated, material) in each.items()}
    units = toml_file.newtons([stated for stated, _ in each.values()])
    if units is not None and np.ptp(units) > SAME_UNIT * units[0]:
        raise InputError(path, "materials", "weights and linear densities that are not proportional", "correct them")
    return found, None if units is None else float(units[0])


def _start(path: Path, key: str, rod: _Rod) -> Configuration:
    """A rod as it is at first."""
    if rod.points_mm is None:
        if rod.length_mm is None:
            raise InputError(path, f"{key}.length_mm", "missing", "give the length of a straight rod, or points_mm of a curve")
        if rod.closed:
            raise InputError(path, f"{key}.closed", "given without points_mm", "leave it out")
        position, direction = (default if value is UNSET else value for value, default in (
            (rod.position_mm, (0.0, 0.0, 0.0)), (rod.direction, (1.0, 0.0, 0.0))))
        return Configuration.straight(position, unit_direction(path, f"{key}.direction", direction), rod.length_mm, rod.edges)
    for name, value in (("length_mm", rod.length_mm or UNSET), ("position_mm", rod.position_mm), ("direction", rod.direction)):
        if value is not UNSET:
            raise InputError(path, f"{key}.{name}", "given beside points_mm", "give the one or the other")
    return rod_along(_curve(path, f"{key}.points_mm", rod), rod.edges)


def _curve(path: Path, key: str, rod: _Rod) -> np.ndarray:
    """Points along the smooth curve through those of ``rod``."""
    from scipy.interpolate import CubicSpline

    points = np.array([*rod.points_mm, *rod.points_mm[: rod.closed]])
    steps = np.linalg.norm(np.diff(points, axis=0), axis=-1)
    if not (steps > 0).all():
        number = int(np.argmin(steps))
        raise InputError(path, key, f"{number} and {(number + 1) % len(rod.points_mm)} are at one place", "give others")
    # Centripetal parameters: with them a spline makes no loops where points are unevenly spaced.
    along = np.concatenate([[0.0], np.cumsum(np.sqrt(steps))])
    if len(points) == 2:
        return points
    curve = CubicSpline(along, points, bc_type="periodic" if rod.closed else "natural")
    return curve(np.linspace(0.0, along[-1], SAMPLES * rod.edges + 1))


def _clamps(path: Path, key: str, rod: _Rod, start: Configuration, time: np.ndarray) -> list[Clamps]:
    """Those of a rod at each of T moments."""
    held = toml_file.end_paths(path, f"{key}.moments", rod.moments, start, time)
    kinds = Clamp[rod.start.upper()], Clamp[rod.end.upper()]
    return [Clamps(*kinds, *(getattr(held, name)[moment][None] for name in POSES)) for moment in range(len(time))]


def _tie(path: Path, key: str, row, names: list[str], rods: list[Configuration], newton: float | None) -> Tie:
    tie = checked(path, key, row, _Tie)
    weight = tie.weight
    if tie.mass_g is not None:
        if newton is None or weight:
            problem, remedy = ("beside weight", "give one of them") if weight else (
                "given, but the materials do not state their mass", "state EI and linear_density, or give weight, in mm²/mm")
            raise InputError(path, f"{key}.mass_g", problem, remedy)
        weight = 1e-3 * tie.mass_g * STANDARD_GRAVITY / newton
    ends = []
    for end in ("first", "second"):
        name, vertex = getattr(tie, end)
        rod = names.index(_known(path, f"{key}.{end}", name, names))
        ends_held = bool(rods[rod].rest_length[0] == 0)  # the two vertices of an end edge without length are one in the scene
        most = rods[rod].edges - 2 * ends_held
        if not -most - 1 <= vertex <= most:
            raise InputError(path, f"{key}.{end}", f"{name!r} has no vertex {vertex}",
                             f"give one from 0 to {most}, or below 0 from its end")
        if ends_held:
            vertex = {0: 0, most: -1}.get(vertex % (most + 1), vertex % (most + 1) + 1)
        ends.append((rod, vertex))
    return Tie(*ends, weight=weight, weld=tie.weld)
