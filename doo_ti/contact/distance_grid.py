"""An obstacle of any shape, given by its signed distances on a regular grid (docs/contact.md).

Between the values a cubic spline φ_g interpolates, which has continuous second derivatives. Outside the grid, with c the
nearest point of its box, φ = √(φ_g(c)² + |x − c|²), which is never more than the distance to what is inside.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from doo_ti.contact.obstacles import GRID, Distances, Obstacle, Placed
from doo_ti.contact.orientation import require_rotation
from doo_ti.system.arguments import typed
from doo_ti.system.errors import InputError, real_array
from doo_ti.system.short_repr import short_repr

HEADER = 4
"""Numbers that a grid has in front of all coefficients: where its own begin, and how many there are along each axis."""
SIXTH = 1.0 / 6.0


@typed
@dataclass(frozen=True, eq=False, repr=False)
class DistanceGrid(Obstacle):
    """An obstacle by its signed distances ``values`` (X, Y, Z) in mm, negative inside, at points that are ``spacing`` mm apart.

    origin              (3,) the point of values[0, 0, 0], in the obstacle's own axes
    position, rotation  (3,) mm and (3, 3), of the obstacle's own axes, its columns, in the scene

    All of the obstacle is inside the grid: at the border all values are positive, larger than a rod's diameter.
    """

    values: np.ndarray
    spacing: np.ndarray
    origin: np.ndarray = (0.0, 0.0, 0.0)
    position: np.ndarray = (0.0, 0.0, 0.0)
    rotation: np.ndarray = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    friction: np.ndarray = 0.0
    kind: ClassVar[int] = GRID
    shapes: ClassVar[dict[str, tuple[int, ...]]] = {
        "spacing": (), "origin": (3,), "position": (3,), "rotation": (3, 3), "friction": ()}
    positive: ClassVar[tuple[str, ...]] = ("spacing",)
    points: ClassVar[tuple[str, ...]] = ("position",)
    turning: ClassVar[tuple[str, ...]] = ("rotation",)
    __repr__, __eq__, __hash__ = short_repr, object.__eq__, object.__hash__

    if TYPE_CHECKING:
        def __init__(self, values: ArrayLike, spacing: float, origin: ArrayLike = (0.0, 0.0, 0.0),
                     position: ArrayLike = (0.0, 0.0, 0.0), rotation: ArrayLike = np.eye(3),
                     friction: ArrayLike = 0.0) -> None: ...

    @classmethod
    @typed
    def from_mesh(cls, mesh: str | Path | tuple[ArrayLike, ArrayLike], spacing: float, margin: float | None = None,
                  **pose: ArrayLike) -> "DistanceGrid":
        """The grid of a closed surface: a file that trimesh reads (STL, PLY, OBJ), in mm, or its vertices (N, 3) and triangles
        (M, 3).

        margin  mm of grid around it; a tenth of its largest size and two spacings unless given
        pose    ``position``, ``rotation`` and ``friction``
        """
        from doo_ti.contact.mesh_distance import sampled

        return cls(*sampled(mesh, spacing, margin), **pose)

    def _check(self) -> None:
        values = np.array(real_array("DistanceGrid", "values", self.values, "give (X, Y, Z) mm"), dtype=np.float64)
        if values.ndim != 3 or min(values.shape) < 2:
            raise InputError("DistanceGrid", "values", f"shape {values.shape}", "give (X, Y, Z), two or more along each axis")
        if not np.isfinite(values).all():
            raise InputError("DistanceGrid", "values", "not finite", "give a distance in mm at every point")
        if len(self.spacing) != 1:
            raise InputError("DistanceGrid", "spacing", f"{len(self.spacing)} rows", "give one number in mm")
        require_rotation("DistanceGrid", self.rotation)
        values.setflags(write=False)
        object.__setattr__(self, "values", values)
        if self.border <= 0:
            raise InputError("DistanceGrid", "values", f"{self.border:g} mm at the border: the obstacle goes on outside",
                             "give a grid that is larger than the obstacle, by more than a rod's diameter all around")

    @property
    def border(self) -> float:
        """mm: the least value at the border."""
        return min(float(np.take(self.values, [0, -1], axis=axis).min()) for axis in range(3))

    @cached_property
    def coefficients(self) -> np.ndarray:
        """(X+2, Y+2, Z+2) of the cubic B-splines, over the spacing; at the border second derivatives are zero."""
        found = self.values / self.spacing[0]
        for axis in range(3):
            found = np.moveaxis(_spline(np.moveaxis(found, axis, 0)), 0, axis)
        return np.ascontiguousarray(found)

    def _with(self, values: dict[str, np.ndarray]) -> "DistanceGrid":
        other = super()._with(values)
        other.__dict__["coefficients"] = self.coefficients
        return other

    @cached_property
    def placed(self) -> Placed:
        corner = self.position + np.einsum("rij,rj->ri", *(np.broadcast_to(part, (self.count, *part.shape[1:]))
                                                           for part in (self.rotation, self.origin)))
        depth = max(-float(self.values.min()), 0.0)
        return corner, self.rotation, self.spacing[:, None] * [[1.0, 0.0, 0.0]], np.full(1, depth)

    def local_distance(self, local: np.ndarray, sizes: np.ndarray) -> Distances:
        spacing, last = self.spacing[0], np.array(self.values.shape) - 1
        place = local / spacing
        nearest = np.clip(place, 0.0, last)
        beyond = (place - nearest) * spacing
        value, slope = self._interpolated(nearest)
        value = value * spacing
        away = np.linalg.norm(beyond, axis=-1)
        whole = np.hypot(value, away)
        slant = (value[..., None] * slope * (beyond == 0) + beyond) / np.maximum(whole, 1e-300)[..., None]
        outside = away > 0
        return np.where(outside, whole, value), np.where(outside[..., None], slant, slope)

    def _interpolated(self, place: np.ndarray) -> Distances:
        """The spline (...) over the spacing and its derivatives (..., 3) at ``place`` (..., 3) in the grid, in spacings."""
        cell = np.minimum(np.nan_to_num(place).astype(np.int64), np.array(self.values.shape) - 2)
        weights, slopes = _weights(place - cell)
        count_y, count_z = self.coefficients.shape[1:]
        first = (cell[..., 0] * count_y + cell[..., 1]) * count_z + cell[..., 2]
        flat = self.coefficients.reshape(-1)
        value, slope = np.zeros(place.shape[:-1]), np.zeros(place.shape)
        for i, j, k in np.ndindex(4, 4, 4):
            c = flat[first + (i * count_y + j) * count_z + k]
            x, y, z = weights[i, ..., 0], weights[j, ..., 1], weights[k, ..., 2]
            dx, dy, dz = slopes[i, ..., 0], slopes[j, ..., 1], slopes[k, ..., 2]
            value += c * x * y * z
            slope += c[..., None] * np.stack([dx * y * z, x * dy * z, x * y * dz], axis=-1)
        return value, slope


def _weights(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(4, ...) the cubic B-splines of a cell at the place t in it, and their derivatives."""
    u = 1.0 - t
    return (np.stack([u**3, 3 * t**3 - 6 * t**2 + 4, 3 * u**3 - 6 * u**2 + 4, t**3]) * SIXTH,
            0.5 * np.stack([-u**2, 3 * t**2 - 4 * t, 4 * u - 3 * u**2, t**2]))


def _spline(values: np.ndarray) -> np.ndarray:
    """(X+2, ...) coefficients of B-splines that interpolate values (X, ...), without second derivative at both ends."""
    from scipy.linalg import solve_banded

    found = np.array(values)
    inner = len(values) - 2
    if inner > 0:
        right = 6.0 * values[1:-1]
        right[0] -= values[0]
        right[-1] -= values[-1]
        bands = np.array([[1.0], [4.0], [1.0]]) * np.ones(inner)
        found[1:-1] = solve_banded((1, 1), bands, right.reshape(inner, -1)).reshape(right.shape)
    return np.concatenate([2 * found[:1] - found[1:2], found, 2 * found[-1:] - found[-2:-1]])


@lru_cache(maxsize=4)
def _packed(grids: tuple[DistanceGrid, ...]) -> np.ndarray:
    header = np.zeros((len(grids), HEADER))
    header[:, 0] = header.size + np.cumsum([0, *(grid.coefficients.size for grid in grids[:-1])])
    header[:, 1:] = [grid.coefficients.shape for grid in grids]
    return np.concatenate([header.reshape(-1), *(grid.coefficients.reshape(-1) for grid in grids)])


def grid_table(obstacles: Sequence[Obstacle]) -> tuple[np.ndarray, np.ndarray]:
    """(M,) int32 kinds of obstacles as the kernels have them, GRID and its number of a grid, and the numbers of all grids."""
    kinds = np.array([obstacle.kind for obstacle in obstacles], dtype=np.int32)
    grids = tuple(obstacle for obstacle in obstacles if isinstance(obstacle, DistanceGrid))
    kinds[kinds == GRID] += np.arange(len(grids), dtype=np.int32)
    return kinds, _packed(grids) if grids else np.zeros(1)
