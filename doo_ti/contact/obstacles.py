"""Obstacles: what a rod may touch but not enter, each by its signed distance φ, positive outside (docs/contact.md).

    relax(start, material, clamps, obstacles=[Plane((0, 0, 0), (0, 0, 1)), Sphere((50, 0, 20), 15)], radius=2.0)

All lengths are in mm. Every field may have one row for all rods or, with a leading axis (R,), a row for each rod.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from doo_ti.rod.frames import unit_vectors
from doo_ti.system.arguments import typed
from doo_ti.system.errors import InputError, real_array

# Kinds, as the kernels number them.
PLANE, CAPSULE, CYLINDER, RING, BOX, GRID = range(6)

# Columns of an obstacle: its point, its three axes one after the other (the third is the axis of revolution), three sizes,
# the largest depth inside it, and its coefficient of friction.
POINT, AXES, SIZES, DEPTH, FRICTION, OBSTACLE_COLUMNS = 0, 3, 12, 15, 16, 17

Placed = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
Distances = tuple[np.ndarray, np.ndarray]

UNBOUNDED = 1e6  # mm: the depth of a half space


@dataclass(frozen=True)
class Obstacle:
    """The part that all obstacles share.

    friction  Coulomb's coefficient between rod and obstacle, which acts in motions (:func:`doo_ti.dynamics.simulate.simulate`)

    Of the fields, with their ``shapes`` without rows, ``positive`` are lengths, ``points`` are places and ``turning`` are
    directions or axes.
    """

    kind: ClassVar[int]
    shapes: ClassVar[dict[str, tuple[int, ...]]]
    positive: ClassVar[tuple[str, ...]] = ()
    points: ClassVar[tuple[str, ...]] = ()
    turning: ClassVar[tuple[str, ...]] = ()

    def __post_init__(self) -> None:
        name, count = type(self).__name__, 1
        for field in fields(self):
            if field.name not in self.shapes:
                continue
            size = self.shapes[field.name]
            wanted = f"give {size or 'a number'}, or (R, {', '.join(map(str, size))})"
            value = np.array(real_array(name, field.name, getattr(self, field.name), wanted), dtype=np.float64)
            if value.shape[value.ndim - len(size) :] != size or value.ndim > len(size) + 1:
                raise InputError(name, field.name, f"shape {value.shape}", wanted)
            if not np.isfinite(value).all():
                raise InputError(name, field.name, "not finite", "give finite numbers")
            if field.name in self.positive and not (value > 0).all():
                raise InputError(name, field.name, f"{value.min():g}", "give a positive length in mm")
            value = value.reshape(-1, *size)
            if not len(value) or len(value) not in (1, count) and count > 1:
                raise InputError(name, field.name, f"{len(value)} rows beside {count}", "give one, or one for each rod")
            count = max(count, len(value))
            value.setflags(write=False)
            object.__setattr__(self, field.name, value)
        if (self.friction < 0).any():
            raise InputError(name, "friction", f"{self.friction.min():g}", "give zero or more")
        self._check()

    def _check(self) -> None:
        """Raise InputError for fields that do not make such an obstacle."""

    @property
    def count(self) -> int:
        """Number of rows: one for all rods, or R."""
        return max(len(getattr(self, name)) for name in self.shapes)

    def take(self, rows: ArrayLike) -> "Obstacle":
        """The rows of the rods ``rows``; an obstacle that all rods share stays as it is."""
        own = {name: value[rows] for name in self.shapes if len(value := getattr(self, name)) > 1}
        return self._with(own) if own else self

    def moved(self, rotation: np.ndarray, shift: np.ndarray) -> "Obstacle":
        """The obstacle with every place x of it at ``rotation`` (rows, 3, 3) x + ``shift`` (rows, 3) mm."""
        points = {name: (rotation @ getattr(self, name)[..., None])[..., 0] + shift for name in self.points}
        columns = {name: getattr(self, name).reshape(-1, 3, np.prod(self.shapes[name]) // 3) for name in self.turning}
        return self._with(points | {
            name: (rotation @ value).reshape(-1, *self.shapes[name]) for name, value in columns.items()})

    def rubbing(self, friction: ArrayLike) -> "Obstacle":
        """The obstacle with another coefficient of friction, or (R,)."""
        return self._with({"friction": friction})

    def _with(self, values: dict[str, np.ndarray]) -> "Obstacle":
        """This obstacle with other values of some fields."""
        return replace(self, **values)

    @cached_property
    def placed(self) -> Placed:
        """(rows, 3) point, (rows, 3, 3) axes as columns, (rows, 3) sizes and (rows,) largest depth inside, mm."""
        raise NotImplementedError

    def numbers(self) -> np.ndarray:
        """(rows, OBSTACLE_COLUMNS) of the kernels."""
        point, axes, sizes, depth = self.placed
        table = np.zeros((self.count, OBSTACLE_COLUMNS))
        table[:, POINT:AXES] = point
        table[:, AXES:SIZES] = np.swapaxes(axes, -1, -2).reshape(-1, 9)
        table[:, SIZES:DEPTH] = sizes
        table[:, DEPTH], table[:, FRICTION] = depth, self.friction
        return table

    def distance(self, points: np.ndarray) -> Distances:
        """φ (R, N) mm and its gradient, the outward normal (R, N, 3), at ``points`` (R, N, 3)."""
        point, axes, sizes, _ = self.placed
        value, normal = self.local_distance((points - point[:, None]) @ axes, sizes[:, None])
        return value, normal @ np.swapaxes(axes, -1, -2)

    @staticmethod
    def local_distance(local: np.ndarray, sizes: np.ndarray) -> Distances:
        """Signed distance of points that are given along the obstacle's axes from its point."""
        raise NotImplementedError


@typed
@dataclass(frozen=True)
class Plane(Obstacle):
    """A half space: all that lies behind the plane through ``point`` (3,) whose outward normal is ``normal`` (3,)."""

    point: np.ndarray
    normal: np.ndarray
    friction: np.ndarray = 0.0
    kind, points, turning = PLANE, ("point",), ("normal",)
    shapes = {"point": (3,), "normal": (3,), "friction": ()}

    if TYPE_CHECKING:
        def __init__(self, point: ArrayLike, normal: ArrayLike, friction: ArrayLike = 0.0) -> None: ...

    def _check(self) -> None:
        require_direction("Plane", "normal", self.normal)

    @cached_property
    def placed(self) -> Placed:
        return self.point, axes_about(self.normal), np.zeros((1, 3)), np.full(1, UNBOUNDED)

    @staticmethod
    def local_distance(local: np.ndarray, sizes: np.ndarray) -> Distances:
        return local[..., 2], np.broadcast_to([0.0, 0.0, 1.0], local.shape)


@typed
@dataclass(frozen=True)
class Sphere(Obstacle):
    """A ball of that ``radius`` about ``centre`` (3,)."""

    centre: np.ndarray
    radius: np.ndarray
    friction: np.ndarray = 0.0
    kind, points, positive = CAPSULE, ("centre",), ("radius",)
    shapes = {"centre": (3,), "radius": (), "friction": ()}

    if TYPE_CHECKING:
        def __init__(self, centre: ArrayLike, radius: ArrayLike, friction: ArrayLike = 0.0) -> None: ...

    @cached_property
    def placed(self) -> Placed:
        return self.centre, np.eye(3)[None], np.stack([self.radius, 0 * self.radius, 0 * self.radius], -1), self.radius

    @staticmethod
    def local_distance(local: np.ndarray, sizes: np.ndarray) -> Distances:
        return _to_core(local, sizes[..., :1])


@dataclass(frozen=True)
class _Rod(Obstacle):
    """The part that a capsule and a cylinder share: an axis from ``start`` (3,) to ``end`` (3,), and a ``radius``."""

    start: np.ndarray
    end: np.ndarray
    radius: np.ndarray
    friction: np.ndarray = 0.0
    points, positive = ("start", "end"), ("radius",)
    shapes = {"start": (3,), "end": (3,), "radius": (), "friction": ()}

    def _check(self) -> None:
        require_direction(type(self).__name__, "end", self.end - self.start, "at the start")

    @cached_property
    def placed(self) -> Placed:
        axis = self.end - self.start
        half = 0.5 * np.linalg.norm(axis, axis=-1)
        radius, half = np.broadcast_arrays(self.radius, half)
        depth = radius if self.kind == CAPSULE else np.minimum(radius, half)
        return 0.5 * (self.start + self.end), axes_about(axis), np.stack([radius, half, 0 * radius], -1), depth


@typed
@dataclass(frozen=True)
class Capsule(_Rod):
    """A cylinder with round ends: all within ``radius`` of the segment from ``start`` (3,) to ``end`` (3,)."""

    kind = CAPSULE

    if TYPE_CHECKING:
        def __init__(self, start: ArrayLike, end: ArrayLike, radius: ArrayLike, friction: ArrayLike = 0.0) -> None: ...

    @staticmethod
    def local_distance(local: np.ndarray, sizes: np.ndarray) -> Distances:
        axial = local[..., 2] - np.clip(local[..., 2], -sizes[..., 1], sizes[..., 1])
        return _to_core(np.concatenate([local[..., :2], axial[..., None]], -1), sizes[..., :1])


@typed
@dataclass(frozen=True)
class Cylinder(_Rod):
    """A cylinder with flat ends, whose axis goes from ``start`` (3,) to ``end`` (3,): a peg."""

    kind = CYLINDER

    if TYPE_CHECKING:
        def __init__(self, start: ArrayLike, end: ArrayLike, radius: ArrayLike, friction: ArrayLike = 0.0) -> None: ...

    @staticmethod
    def local_distance(local: np.ndarray, sizes: np.ndarray) -> Distances:
        radial, outward = _radial(local)
        side, cap = radial - sizes[..., 0], np.abs(local[..., 2]) - sizes[..., 1]
        upward = np.where(local[..., 2] < 0, -1.0, 1.0)[..., None] * [0.0, 0.0, 1.0]
        rim = np.hypot(side, cap)
        slant = (side[..., None] * outward + cap[..., None] * upward) / np.maximum(rim, 1e-300)[..., None]
        beyond, lateral = (side > 0) & (cap > 0), side >= cap
        normal = np.where(beyond[..., None], slant, np.where(lateral[..., None], outward, upward))
        return np.where(beyond, rim, np.maximum(side, cap)), normal


@typed
@dataclass(frozen=True)
class Ring(Obstacle):
    """A torus: all within ``thickness`` of the circle of that ``radius`` about ``centre`` (3,) and ``axis`` (3,)."""

    centre: np.ndarray
    axis: np.ndarray
    radius: np.ndarray
    thickness: np.ndarray
    friction: np.ndarray = 0.0
    kind, points, turning, positive = RING, ("centre",), ("axis",), ("radius", "thickness")
    shapes = {"centre": (3,), "axis": (3,), "radius": (), "thickness": (), "friction": ()}

    if TYPE_CHECKING:
        def __init__(self, centre: ArrayLike, axis: ArrayLike, radius: ArrayLike, thickness: ArrayLike,
                     friction: ArrayLike = 0.0) -> None: ...

    def _check(self) -> None:
        require_direction("Ring", "axis", self.axis)
        if (self.thickness >= self.radius).any():
            raise InputError("Ring", "thickness", f"{self.thickness.max():g} mm closes the hole", "give less than the radius")

    @cached_property
    def placed(self) -> Placed:
        radius, thickness = np.broadcast_arrays(self.radius, self.thickness)
        return self.centre, axes_about(self.axis), np.stack([radius, thickness, 0 * radius], -1), thickness

    @staticmethod
    def local_distance(local: np.ndarray, sizes: np.ndarray) -> Distances:
        radial, outward = _radial(local)
        beside = (radial - sizes[..., 0])[..., None] * outward + local[..., 2:] * [0.0, 0.0, 1.0]
        return _to_core(beside, sizes[..., 1:2])


@typed
@dataclass(frozen=True)
class Box(Obstacle):
    """A box with edges of those lengths ``size`` (3,) about ``centre`` (3,), along the columns of ``rotation`` (3, 3)."""

    centre: np.ndarray
    size: np.ndarray
    rotation: np.ndarray = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    friction: np.ndarray = 0.0
    kind, points, turning, positive = BOX, ("centre",), ("rotation",), ("size",)
    shapes = {"centre": (3,), "size": (3,), "rotation": (3, 3), "friction": ()}

    if TYPE_CHECKING:
        def __init__(self, centre: ArrayLike, size: ArrayLike, rotation: ArrayLike = np.eye(3),
                     friction: ArrayLike = 0.0) -> None: ...

    def _check(self) -> None:
        require_rotation("Box", self.rotation)

    @cached_property
    def placed(self) -> Placed:
        return self.centre, self.rotation, 0.5 * self.size, 0.5 * self.size.min(axis=-1)

    @staticmethod
    def local_distance(local: np.ndarray, sizes: np.ndarray) -> Distances:
        beyond = np.abs(local) - sizes
        sign = np.where(local < 0, -1.0, 1.0)
        outside = np.maximum(beyond, 0.0)
        away = np.linalg.norm(outside, axis=-1)
        face = np.arange(3) == beyond.argmax(axis=-1)[..., None]
        normal = np.where((away > 0)[..., None], outside / np.maximum(away, 1e-300)[..., None], face) * sign
        return np.where(away > 0, away, beyond.max(axis=-1)), normal


def require_direction(name: str, field: str, value: np.ndarray, what: str = "of length zero") -> None:
    """Raise InputError unless every row has a length."""
    if not (np.linalg.norm(value, axis=-1) > 0).all():
        raise InputError(name, field, what, "give three numbers that are not all zero")


def require_rotation(name: str, rotation: np.ndarray) -> None:
    """Raise InputError unless every matrix is a rotation."""
    off = np.abs(np.swapaxes(rotation, -1, -2) @ rotation - np.eye(3)).max(initial=0.0)
    if not off <= 1e-6:
        raise InputError(name, "rotation", f"off a rotation by {off:.2g}", "give a 3×3 rotation matrix")
    if not (np.linalg.det(rotation) > 0).all():
        raise InputError(name, "rotation", "a reflection", "give a 3×3 rotation matrix, whose determinant is 1")


def axes_about(direction: np.ndarray) -> np.ndarray:
    """(rows, 3, 3) three axes as columns, the third along ``direction`` (rows, 3)."""
    third = unit_vectors(direction)
    first = unit_vectors(np.cross(np.where(np.abs(third[:, :1]) < 0.7, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]]), third))
    return np.stack([first, np.cross(third, first), third], axis=-1)


def _radial(local: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance from the third axis, and the unit vector away from it; on the axis that is the first one."""
    radial = np.hypot(local[..., 0], local[..., 1])
    flat = local * [1.0, 1.0, 0.0]
    away = flat / np.maximum(radial, 1e-300)[..., None]
    return radial, np.where((radial > 0)[..., None], away, [1.0, 0.0, 0.0])


def _to_core(beside: np.ndarray, radius: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance and normal where ``beside`` is the vector from the nearest point of the core, the obstacle's skeleton."""
    away = np.linalg.norm(beside, axis=-1)
    return away - radius[..., 0], beside / np.maximum(away, 1e-300)[..., None]


def obstacle_table(obstacles: Sequence[Obstacle]) -> np.ndarray:
    """(1 or R, M, OBSTACLE_COLUMNS) the numbers of M obstacles as the kernels have them, of one row or R each."""
    table = np.empty((max((obstacle.count for obstacle in obstacles), default=1), len(obstacles), OBSTACLE_COLUMNS))
    for place, obstacle in enumerate(obstacles):
        table[:, place] = obstacle.numbers()
    return table
