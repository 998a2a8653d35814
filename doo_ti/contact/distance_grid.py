"""An obstacle of any shape, given by its signed distances on a regular grid (docs/contact.md); and obstacles as triangles, for
pictures and recordings. Axes of these: N vertices, M triangles.

Between the values a cubic spline φ_g interpolates, which has continuous second derivatives. Outside the grid, with c the
nearest point of its box, φ = √(φ_g(c)² + |x − c|²), which is never more than the distance to what is inside.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
from numpy.typing import ArrayLike

from doo_ti.contact.obstacles import BOX, CAPSULE, CYLINDER, GRID, PLANE, Distances, Obstacle, Placed, require_rotation
from doo_ti.io.arrays import first_line
from doo_ti.system.arguments import short_repr, typed
from doo_ti.system.errors import InputError, real_array
from doo_ti.system.files import read_content

HEADER = 4  # numbers that a grid has in front of all coefficients: where its own begin, and how many there are along each axis
MOST_POINTS = 8_000_000
FORMATS = (".stl", ".ply", ".obj")  # trimesh reads more: archives, which it unpacks, and files that name others
STL_HEADER, STL_TRIANGLE = 84, 50  # bytes of a binary STL file
MARGIN, MARGIN_SPACINGS = 0.1, 2.0  # of the surface's largest size, and besides so many spacings: grid around it


@typed
@dataclass(frozen=True, eq=False, repr=False)
class DistanceGrid(Obstacle):
    """An obstacle by its signed distances ``values`` (X, Y, Z) in mm, negative inside, at points that are ``spacing`` mm apart.

    origin              (3,) the point of values[0, 0, 0], in the obstacle's own axes
    position, rotation  (3,) mm and (3, 3), of the obstacle's own axes, its columns, in the scene

    All of the obstacle is inside the grid: at the border all values are positive, larger than a rod's diameter.
    """

    values: Annotated[np.ndarray, "X Y Z", float]
    spacing: np.ndarray
    origin: np.ndarray = (0.0, 0.0, 0.0)
    position: np.ndarray = (0.0, 0.0, 0.0)
    rotation: np.ndarray = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    friction: np.ndarray = 0.0
    kind, points, turning, positive = GRID, ("position",), ("rotation",), ("spacing",)
    shapes = {"spacing": (), "origin": (3,), "position": (3,), "rotation": (3, 3), "friction": ()}
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
        return cls(*sampled(mesh, spacing, margin), **pose)

    def _check(self) -> None:
        values = np.array(self.values, dtype=np.float64)
        if min(values.shape) < 2:
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
    def spline(self):
        """SciPy's spline of cubic B-splines through the values over the spacing, a function of the place in spacings; at the
        border its second derivatives are zero."""
        from scipy.interpolate import NdBSpline

        found = self.values / self.spacing[0]
        for axis in range(3):
            found = np.moveaxis(_coefficients(np.moveaxis(found, axis, 0)), 0, axis)
        return NdBSpline(tuple(np.arange(-3.0, size + 1.0) for size in found.shape), np.ascontiguousarray(found), 3)

    @property
    def coefficients(self) -> np.ndarray:
        """(X+2, Y+2, Z+2) of the B-splines."""
        return self.spline.c

    def _with(self, values: dict[str, np.ndarray]) -> "DistanceGrid":
        other = super()._with(values)
        other.__dict__["spline"] = self.spline
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
        value = self.spline(nearest) * spacing
        slope = np.stack([self.spline(nearest, nu=along) for along in np.eye(3, dtype=int)], axis=-1)
        away = np.linalg.norm(beyond, axis=-1)
        whole = np.hypot(value, away)
        slant = (value[..., None] * slope * (beyond == 0) + beyond) / np.maximum(whole, 1e-300)[..., None]
        outside = away > 0
        return np.where(outside, whole, value), np.where(outside[..., None], slant, slope)


def _coefficients(values: np.ndarray) -> np.ndarray:
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


# --- from a closed surface of triangles, read by the library trimesh ---


def sampled(mesh, spacing: float, margin: float | None) -> tuple[np.ndarray, float, np.ndarray]:
    """(values (X, Y, Z) mm, spacing, the first point (3,)) of the grid around a surface, as
    :meth:`.DistanceGrid.from_mesh` takes it. Raises InputError for what is no closed surface, and where trimesh is missing."""
    if not spacing > 0:
        raise InputError("DistanceGrid", "spacing", f"{spacing:g}", "give a positive length in mm")
    surface, name = _surface(mesh)
    from doo_ti.contact.distance import signed_distances

    low, high = surface.bounds
    if margin is None:
        margin = MARGIN * (high - low).max() + MARGIN_SPACINGS * spacing
    if not margin > 0:
        raise InputError("DistanceGrid", "margin", f"{margin:g}", "give a positive length in mm")
    counts = np.ceil((high - low + 2 * margin) / spacing) + 1
    if counts.prod() > MOST_POINTS:
        raise InputError(name, "spacing", f"{spacing:g} mm makes {counts.prod():.3g} points", "give a larger one")
    counts = counts.astype(np.int64)
    first = 0.5 * (low + high) - 0.5 * spacing * (counts - 1)
    return signed_distances(np.array(surface.triangles), first, spacing, counts), spacing, first


def _surface(mesh):
    """(the mesh of trimesh, its name for messages). Raises InputError."""
    try:
        import trimesh
    except ImportError:
        raise InputError("DistanceGrid", "mesh", "trimesh is not installed", "pip install 'doo_ti[mesh]'") from None
    if isinstance(mesh, str | Path):
        name, path = mesh, Path(mesh)
        if path.suffix.lower() not in FORMATS:
            raise InputError(path, "file", f"suffix {path.suffix!r} is not a format of meshes", f"give {', '.join(FORMATS)}")
        content = _readable(path, read_content(path, remedy="name a readable mesh"))
        try:
            with np.errstate(invalid="ignore"):  # numbers that no integer holds
                found = trimesh.load(BytesIO(content), file_type=path.suffix[1:].lower(), force="mesh")
            is_surface = len(found.faces) and np.isfinite(found.vertices).all()
        except Exception as error:  # trimesh has no exception of its own
            raise InputError(path, "file", f"no mesh ({first_line(error)})", "give STL, PLY or OBJ") from None
        if not is_surface:
            raise InputError(path, "file", "has no triangles, or points that are not finite", "give a closed surface")
    else:
        name = "DistanceGrid"
        vertices, triangles = (real_array(name, "mesh", part, "give vertices (N, 3) and triangles (M, 3)") for part in mesh)
        if vertices.ndim != 2 or triangles.ndim != 2 or vertices.shape[1] != 3 or triangles.shape[1] != 3:
            raise InputError(name, "mesh", f"shapes {vertices.shape} and {triangles.shape}",
                             "give vertices (N, 3) and triangles (M, 3)")
        if not np.isfinite(vertices).all() or not np.isin(triangles, np.arange(len(vertices))).all():
            raise InputError(name, "mesh", "points that are not finite, or triangles of points that are not there",
                             "give triangles by the numbers of their points, from 0")
        found = trimesh.Trimesh(vertices, triangles)
    if not len(found.faces) or not found.is_watertight:
        raise InputError(name, "mesh", "not a closed surface", "close its holes, with trimesh.repair for example")
    return found, name


def _readable(path: Path, content: bytes) -> bytes:
    """The bytes of a mesh, text among them in UTF-8. Raises InputError for a binary STL file that is not whole."""
    suffix = path.suffix.lower()
    if suffix == ".stl":
        whole = STL_HEADER + STL_TRIANGLE * int.from_bytes(content[STL_HEADER - 4 : STL_HEADER], "little")
        if len(content) == whole:
            return content
        if not content.lstrip().lower().startswith(b"solid"):
            raise InputError(path, "file", f"{len(content):,} bytes where its header says {whole:,}", "export the mesh again")
    try:
        content.decode()
    except UnicodeDecodeError:
        return content if suffix == ".ply" else content.decode("latin-1").encode()
    return content


AROUND, ALONG = 48, 24  # vertices around an axis, and along a round profile
CORNERS = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])  # of a box, over half its size
WIDER = 0.6  # of the size of the scene: half the side of the square that stands for a plane


def mesh(obstacle: Obstacle, row: int, centre: np.ndarray, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (N, 3) in mm and triangles (M, 3) of one obstacle's surface.

    row           of the rod, where each has its own obstacle
    centre, size  (3,) and mm, of the scene, near which a plane is shown
    """
    point, axes, sizes, _ = (part[min(row, len(part) - 1)] for part in obstacle.placed)
    if obstacle.kind == PLANE:
        middle = (centre - point) @ axes * [1.0, 1.0, 0.0]
        local = middle + WIDER * size * np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)])
        triangles = np.array([(0, 1, 2), (0, 2, 3)])
    elif obstacle.kind == BOX:
        local = sizes * CORNERS
        quads = np.array([(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)])
        triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    elif isinstance(obstacle, DistanceGrid):
        local, triangles = _grid_surface(obstacle.values)
        local = sizes[0] * local
    else:
        local, triangles = _revolved(_profile(obstacle.kind, sizes))
    return point + local @ axes.T, triangles


def _profile(kind: int, sizes: np.ndarray) -> np.ndarray:
    """(P, 2) distance from the axis and place along it of the profile of a body of revolution."""
    a, b = sizes[:2]
    if kind == CYLINDER:
        return np.array([(0.0, -b), (a, -b), (a, b), (0.0, b)])
    if kind == CAPSULE:
        angle = np.linspace(-0.5 * np.pi, 0.5 * np.pi, ALONG)
        return np.stack([a * np.cos(angle), a * np.sin(angle) + b * np.sign(angle)], axis=-1)
    angle = np.linspace(0.0, 2 * np.pi, ALONG)
    return np.stack([a + b * np.cos(angle), b * np.sin(angle)], axis=-1)


def _revolved(profile: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The surface that a profile (P, 2) makes around the third axis."""
    angle = 2 * np.pi * np.arange(AROUND) / AROUND
    radial = profile[:, :1] * np.stack([np.cos(angle), np.sin(angle)])[:, None]  # (2, P, AROUND)
    vertices = np.concatenate([radial, np.broadcast_to(profile[:, 1:], radial.shape[1:])[None]]).transpose(2, 1, 0)
    count = len(profile)
    here = (np.arange(AROUND)[:, None] * count + np.arange(count - 1)).ravel()
    beside = (here + count) % (AROUND * count)
    return vertices.reshape(-1, 3), np.concatenate([np.stack([here, beside, here + 1], -1),
                                                    np.stack([beside, beside + 1, here + 1], -1)])


def _grid_surface(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The surface where distances on a grid are zero, in steps of the grid: in each cell that it crosses a vertex, at the mean
    of where it crosses the cell's edges, and a quad across each edge of the grid that it crosses."""
    inside = values < 0
    total, count, quads = np.zeros((*values.shape, 3)), np.zeros(values.shape), []
    for axis in range(3):
        here, beside = (np.take(values, np.arange(values.shape[axis] - 1) + step, axis=axis) for step in (0, 1))
        place = np.stack(np.nonzero((here < 0) != (beside < 0)), axis=-1)
        first, second = here[tuple(place.T)], beside[tuple(place.T)]
        crossing = place + (first / (first - second))[:, None] * np.eye(3)[axis]
        around = [-np.eye(3, dtype=int)[(axis + 1) % 3] * a - np.eye(3, dtype=int)[(axis + 2) % 3] * b
                  for a, b in ((0, 0), (0, 1), (1, 1), (1, 0))]
        cells = place[:, None] + around  # (N, 4, 3) the cells that share the edge; the border is outside, so that all exist
        np.add.at(total, tuple(np.moveaxis(cells, -1, 0)), crossing[:, None])
        np.add.at(count, tuple(np.moveaxis(cells, -1, 0)), 1.0)
        cells[inside[tuple(place.T)]] = cells[inside[tuple(place.T)], ::-1]
        quads.append(cells)
    crossed = count > 0
    number = np.cumsum(crossed).reshape(count.shape) - 1
    corners = number[tuple(np.moveaxis(np.concatenate(quads), -1, 0))]
    return total[crossed] / count[crossed][:, None], np.concatenate([corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]])
