"""What rods may touch, with their radius, and the gaps between them: obstacles, the rod itself, and obstacles that move, such
as pushers, tilting tables and turning drums (docs/contact.md). Axes: R rods, V vertices, T instants."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Annotated

import numpy as np
from numpy.typing import ArrayLike

from doo_ti.contact.obstacles import Obstacle, require_rotation
from doo_ti.system.arguments import short_repr, typed
from doo_ti.system.errors import InputError, real_array

ITSELF = -1  # its kind. Kernels do not meet it: they have a code of their own for it.
LEAST_ARC = np.pi  # radii: parts of a rod with less of it between them do not touch, since it cannot bend that much
LEAST_SQUARE = 1e-30  # mm²
CLOSER = 4  # times that places about the least distance are looked at, each time four times as close
PAIRS_AT_ONCE = 2_000_000  # of edges, whose distances are measured together


@typed
@dataclass(frozen=True)
class Itself(Obstacle):
    """The rod itself: no part of it passes through another one, or comes nearer to it than twice the radius."""

    friction: np.ndarray = 0.0
    kind, shapes = ITSELF, {"friction": ()}

    if TYPE_CHECKING:
        def __init__(self, friction: ArrayLike = 0.0) -> None: ...


def smallest_self_gap(vertices: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """(R,) mm between the surfaces of different parts of each rod (R, V, 3) of that ``radius`` (1 or R,): the smallest distance
    of two edges with more than :data:`LEAST_ARC` of the rod between them, less two radii. Infinite where there are no such
    edges, NaN for a rod without places."""
    radius = np.broadcast_to(np.asarray(radius, dtype=np.float64).reshape(-1), (len(vertices),))
    early, late = np.triu_indices(vertices.shape[1] - 1, 2)
    lengths = np.linalg.norm(np.diff(vertices, axis=1), axis=-1)
    arc = np.concatenate([np.zeros((len(vertices), 1)), np.cumsum(lengths, axis=1)], axis=1)

    def gaps(rods: slice, distance: np.ndarray) -> np.ndarray:
        between, own = arc[rods, late] - arc[rods, early + 1], radius[rods, None]
        return np.where(between > LEAST_ARC * own, distance - 2.0 * own, np.inf)

    return np.where(np.isfinite(vertices).all(axis=(1, 2)), smallest_of_pairs(vertices, early, late, gaps), np.nan)


def smallest_of_pairs(vertices: np.ndarray, early: np.ndarray, late: np.ndarray,
                      gaps: Callable[[slice, np.ndarray], np.ndarray]) -> np.ndarray:
    """(R,) the smallest of the ``gaps`` that K pairs of edges of rods (R, V, 3) have, infinite without pairs. Some rods at a
    time: ``gaps`` is given a slice of them and the distances (-, K) of their edges."""
    smallest = np.full(len(vertices), np.inf)
    if len(early):
        rows = max(1, PAIRS_AT_ONCE // len(early))
        for rods in (slice(first, first + rows) for first in range(0, len(vertices), rows)):
            x, edges = vertices[rods], np.diff(vertices[rods], axis=1)
            distance = edge_distance(x[:, late] - x[:, early], edges[:, early], edges[:, late])
            smallest[rods] = gaps(rods, distance).min(axis=1)
    return smallest


def edge_distance(w: np.ndarray, p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Least distance of the edges 0 … p and w … w + q, all (..., 3)."""
    pp, qq, pq, wp, wq, ww = ((a * b).sum(axis=-1) for a, b in ((p, p), (q, q), (p, q), (w, p), (w, q), (w, w)))
    pp, qq = np.maximum(pp, LEAST_SQUARE), np.maximum(qq, LEAST_SQUARE)  # edges may have no length

    def square(s, t):
        return ww + s * (s * pp - 2.0 * wp) + t * (t * qq + 2.0 * wq) - 2.0 * s * t * pq

    with np.errstate(all="ignore"):
        determinant = pp * qq - pq * pq
        s, t = (wp * qq - wq * pq) / determinant, (wp * pq - wq * pp) / determinant
        inside = (determinant > 0) & (s > 0) & (s < 1) & (t > 0) & (t < 1)
        least = np.where(inside, square(s, t), np.inf)
        for end in (0.0, 1.0):
            least = np.minimum(least, square(end, np.clip((pq * end - wq) / qq, 0.0, 1.0)))
            least = np.minimum(least, square(np.clip((wp + pq * end) / pp, 0.0, 1.0), end))
    return np.sqrt(np.maximum(least, 0.0))


def least_distance(obstacle: Obstacle, vertices: np.ndarray, places: int) -> np.ndarray:
    """(R,) mm from the centreline of each rod (R, V, 3) to an obstacle: the least of ``places`` along each edge, and of ever
    closer ones about it on the edges that may have a smaller one."""
    start, edge = vertices[:, :-1], np.diff(vertices, axis=1)
    share, apart = np.linspace(0.0, 1.0, places), 1.0 / (places - 1)
    points = start[:, :, None] + share[:, None] * edge[:, :, None]
    distance = obstacle.distance(points.reshape(len(vertices), points.shape[1] * places, 3))[0].reshape(points.shape[:3])
    least = distance.min(axis=(1, 2))
    # The distance changes no faster than the place.
    rows, edges = np.nonzero(distance.min(axis=2) - 0.5 * apart * np.linalg.norm(edge, axis=-1) < least[:, None])
    start, edge, around = start[rows, edges], edge[rows, edges], share[distance[rows, edges].argmin(axis=1)]
    for _ in range(CLOSER):
        closer = np.clip(around[:, None] + apart * np.linspace(-1.0, 1.0, 9), 0.0, 1.0)
        distance = obstacle.take(rows).distance(start[:, None] + closer[..., None] * edge[:, None])[0]
        around, apart = closer[np.arange(len(rows)), distance.argmin(axis=1)], apart / 4
        np.minimum.at(least, rows, distance.min(axis=1))
    return least


@typed
@dataclass(frozen=True, eq=False, repr=False)
class Moving:
    """An obstacle at the T instants of a motion, those of its grippers: a place x of it is at pivot + rotation (x − pivot) +
    shift.

    obstacle  where it is before it moves, with its friction
    shift     (T, 3) mm or, for each rod, (R, T, 3)
    rotation  (T, 3, 3) or (R, T, 3, 3); unrotated unless given. From one instant to the next less than half a turn
    pivot     (3,) mm or (R, 3); the obstacle's own point unless given: a centre, the middle of an axis, the point of a plane,
              the position of a grid

    Raises InputError for other shapes and for what is no rotation.
    """

    obstacle: Obstacle
    shift: Annotated[np.ndarray, "T 3 | 1R T 3", float]
    rotation: Annotated[np.ndarray | None, "S 3 3 | 1R S 3 3", float] = None
    pivot: Annotated[np.ndarray | None, "3 | 1R 3", float] = None
    __repr__ = short_repr

    if TYPE_CHECKING:
        def __init__(self, obstacle: Obstacle, shift: ArrayLike, rotation: ArrayLike | None = None,
                     pivot: ArrayLike | None = None) -> None: ...

    def __post_init__(self) -> None:
        if isinstance(self.obstacle, Itself):
            raise InputError("Moving", "obstacle", "Itself", "give Plane(...), Sphere(...) and the like")
        own = np.mean(np.broadcast_arrays(*(getattr(self.obstacle, name) for name in self.obstacle.points)), axis=0)
        shift = _rows("shift", self.shift, 3)
        still = np.broadcast_to(np.eye(3), (1, shift.shape[1], 3, 3))
        rotation = still if self.rotation is None else _rows("rotation", self.rotation, 4)
        pivot = own if self.pivot is None else _rows("pivot", self.pivot, 2)
        require_rotation("Moving", rotation)
        if rotation.shape[1] != shift.shape[1] or shift.shape[1] < 2:
            raise InputError("Moving", "rotation", f"{rotation.shape[1]} instants beside {shift.shape[1]} of shift",
                             "give both at the same instants, two or more")
        rows = {len(value) for value in (shift, rotation, pivot)} | {self.obstacle.count}
        if 0 in rows or len(rows - {1}) > 1:
            raise InputError("Moving", "shift", f"rows for {' and '.join(map(str, sorted(rows)))} rods",
                             "give one, or one for each rod")
        for name, value in (("shift", shift), ("rotation", rotation), ("pivot", pivot)):
            value.setflags(write=False)
            object.__setattr__(self, name, value)

    @property
    def count(self) -> int:
        """Number of rows: one for all rods, or R."""
        return max(len(self.shift), len(self.rotation), len(self.pivot), self.obstacle.count)

    @property
    def instants(self) -> int:
        """T, the number of instants."""
        return self.shift.shape[1]

    @property
    def friction(self) -> np.ndarray:
        """The obstacle's coefficient of friction."""
        return self.obstacle.friction

    def take(self, rows: ArrayLike) -> "Moving":
        """The obstacle's rows of the rods ``rows``; an obstacle that all rods share stays as it is."""
        own = {name: value[rows] for name in ("shift", "rotation", "pivot") if len(value := getattr(self, name)) > 1}
        return replace(self, obstacle=self.obstacle.take(rows), **own)

    def at(self, instant: int) -> Obstacle:
        """The obstacle where it is at one instant."""
        rotation, shift = self.path
        return self.obstacle.moved(rotation[:, instant], shift[:, instant])

    @cached_property
    def path(self) -> tuple[np.ndarray, np.ndarray]:
        """(1 or R, T, 3, 3) rotation R and (1 or R, T, 3) shift s: a place x of the obstacle is at R x + s."""
        return self.rotation, about(self.pivot[:, None], self.rotation, self.shift)


def since_first(rotation: np.ndarray, shift: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A :attr:`Moving.path` of the places where the obstacle is at the first instant."""
    turned = rotation @ np.swapaxes(rotation[:, :1], -1, -2)
    return turned, shift - (turned @ shift[:, :1, :, None])[..., 0]


def about(pivot: np.ndarray, rotation: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """(..., 3) what is added to ``rotation`` (..., 3, 3) x where a place x is turned about ``pivot`` (..., 3) and moved by
    ``shift`` (..., 3)."""
    return shift + pivot - (rotation @ pivot[..., None])[..., 0]


def _rows(name: str, value: np.ndarray, axes: int) -> np.ndarray:
    """A field with so many axes, the first of which are rods."""
    found = np.array(value, dtype=np.float64)
    if not np.isfinite(found).all():
        raise InputError("Moving", name, "not finite", "give finite numbers")
    return found if found.ndim == axes else found[None]


PLACES = 8  # of an edge, both ends included, at which its gap is measured
SHALLOW, MOST_STEPS = 0.5, 10_000  # of a radius; and the most steps that are taken for it


@typed
@dataclass(frozen=True)
class Surroundings:
    """What rods may touch.

    obstacles  each with one row, or R; in motions some may be :class:`.Moving`
    radius     of the rods, mm, one or (R,); None without obstacles
    """

    obstacles: Sequence[Obstacle | Moving] = ()
    radius: np.ndarray | float | None = None

    @classmethod
    def checked(cls, source: str, obstacles: Sequence[Obstacle | Moving], radius: ArrayLike | None, count: int
                ) -> "Surroundings":
        """The surroundings of ``count`` rods. Raises InputError, naming ``source``, for more than one :class:`Itself`, where
        numbers of rows do not match, and for a ``radius`` that is missing or not positive."""
        if sum(isinstance(obstacle, Itself) for obstacle in obstacles) > 1:
            raise InputError(source, "obstacles", "Itself more than once", "give it once")
        for obstacle in obstacles:
            if obstacle.count not in (1, count):
                name = type(getattr(obstacle, "obstacle", obstacle)).__name__
                raise InputError(source, "obstacles", f"{obstacle.count} rows of {name} for {count} rods",
                                 "give one, or one for each rod")
        if radius is None:
            if obstacles:
                raise InputError(source, "radius", "missing beside obstacles", "give the rod's radius in mm")
            return cls()
        radius = real_array(source, "radius", radius, "give mm, or one for each rod").astype(np.float64).reshape(-1)
        if len(radius) not in (1, count):
            raise InputError(source, "radius", f"{len(radius)} for {count} rods", "give one, or one for each rod")
        if not ((radius > 0) & (radius < np.inf)).all():
            raise InputError(source, "radius", f"{radius.min():g}", "give a positive radius in mm, or one for each rod")
        return cls(obstacles, radius)

    def __bool__(self) -> bool:
        return len(self.obstacles) > 0

    @property
    def bodies(self) -> list[Obstacle | Moving]:
        """All obstacles but the rod itself."""
        return [obstacle for obstacle in self.obstacles if not isinstance(obstacle, Itself)]

    @property
    def itself(self) -> Itself | None:
        """The rod as its own obstacle, if it is one."""
        return next((obstacle for obstacle in self.obstacles if isinstance(obstacle, Itself)), None)

    @property
    def arguments(self) -> dict:
        """What :func:`doo_ti.relaxation.relax.relax` and :func:`doo_ti.dynamics.simulate.simulate` take."""
        return {"obstacles": self.obstacles, "radius": self.radius}

    @property
    def rub(self) -> bool:
        """Whether an obstacle has friction."""
        return any((obstacle.friction > 0).any() for obstacle in self.obstacles)

    @property
    def moves(self) -> bool:
        """Whether an obstacle moves."""
        return any(isinstance(obstacle, Moving) for obstacle in self.obstacles)

    def at(self, instant: int) -> "Surroundings":
        """The obstacles where they are at an instant of a motion."""
        return replace(self, obstacles=[obstacle.at(instant) if isinstance(obstacle, Moving) else obstacle
                                        for obstacle in self.obstacles])

    def take(self, rows: np.ndarray) -> "Surroundings":
        """The surroundings of the rods ``rows``."""
        radius = self.radius if np.size(self.radius) < 2 else np.asarray(self.radius)[rows]
        return Surroundings([obstacle.take(rows) for obstacle in self.obstacles], radius)

    def for_seeds(self, point: np.ndarray) -> "Surroundings":
        """The same, if rods in images can begin at ``point`` (A, 3) mm there. Raises InputError."""
        if self and (np.size(self.radius) != 1 or any(obstacle.count > 1 for obstacle in self.obstacles)):
            raise InputError("perceive", "obstacles", "other ones, or another radius, for each rod",
                             "give the same to all rods")
        if self.itself is not None:
            raise InputError("perceive", "obstacles", "the rod itself", "leave it out: a growing rod is no obstacle to itself")
        for obstacle in self.obstacles:
            depth = float(np.max(self.radius - obstacle.distance(point[None])[0][0]))
            if depth > 0:
                raise InputError("perceive", "point", f"a rod that begins there is {depth:.3g} mm inside a "
                                 f"{type(obstacle).__name__}", "correct the seed or the obstacle, or give a smaller `radius`")
        return self

    def rubbing(self, friction: ArrayLike) -> "Surroundings":
        """Those with another coefficient of friction, or (R,), against all but the rod itself; nothing that moves."""
        return replace(self, obstacles=[obstacle if isinstance(obstacle, Itself) else obstacle.rubbing(friction)
                                        for obstacle in self.obstacles])

    def steps_for(self, shift: np.ndarray | None) -> np.ndarray | int:
        """(N,) steps in which clamps are to move by ``shift`` (N, 3) mm: a step begins with the rods as they were, moved with
        the first clamp, and none of them may be inside an obstacle then by more than :data:`SHALLOW`."""
        if not self or shift is None:
            return 1
        steps = np.ceil(np.linalg.norm(shift, axis=-1) / (SHALLOW * np.min(self.radius)))
        return np.minimum(steps, MOST_STEPS).astype(np.int64)

    def smallest_gaps(self, instants: Iterable[np.ndarray]) -> np.ndarray:
        """(T, R) :meth:`smallest_gap` of rods (R, V, 3) at each instant of a motion, with obstacles where they are then."""
        return np.stack([self.at(number).smallest_gap(vertices) for number, vertices in enumerate(instants)])

    def smallest_gap(self, vertices: np.ndarray, places: int = PLACES) -> np.ndarray:
        """(R,) mm between the surface of each rod (R, V, 3) and the nearest obstacle, itself if it is one, the least along the
        rod, looked for from ``places`` of each edge; negative inside an obstacle, NaN for a rod without places."""
        least = np.full(len(vertices), np.inf)
        for obstacle in self.bodies:
            least = np.minimum(least, least_distance(obstacle, vertices, places))
        radius = np.zeros(1) if self.radius is None else np.asarray(self.radius, dtype=np.float64).reshape(-1)
        least = least - radius
        return least if self.itself is None else np.minimum(least, smallest_self_gap(vertices, radius))
