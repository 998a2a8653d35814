"""Obstacles that move: pushers, tilting tables, turning drums (docs/contact.md). Axes: R rods, T instants."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from doo_ti.contact.itself import Itself
from doo_ti.contact.obstacles import Obstacle, require_rotation
from doo_ti.system.arguments import short_repr, typed
from doo_ti.system.errors import InputError, real_array


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
    shift: np.ndarray
    rotation: np.ndarray | None = None
    pivot: np.ndarray | None = None
    __repr__ = short_repr

    if TYPE_CHECKING:
        def __init__(self, obstacle: Obstacle, shift: ArrayLike, rotation: ArrayLike | None = None,
                     pivot: ArrayLike | None = None) -> None: ...

    def __post_init__(self) -> None:
        if not isinstance(self.obstacle, Obstacle) or isinstance(self.obstacle, Itself):
            raise InputError("Moving", "obstacle", f"{type(self.obstacle).__name__}",
                             "give Plane(...), Sphere(...) and the like")
        own = np.mean(np.broadcast_arrays(*(getattr(self.obstacle, name) for name in self.obstacle.points)), axis=0)
        shift = _rows("shift", self.shift, (3,), 1)
        still = np.broadcast_to(np.eye(3), (1, shift.shape[1], 3, 3))
        rotation = still if self.rotation is None else _rows("rotation", self.rotation, (3, 3), 1)
        pivot = own if self.pivot is None else _rows("pivot", self.pivot, (3,), 0)
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


def _rows(name: str, value, shape: tuple[int, ...], instants: int) -> np.ndarray:
    """A field as (R, T, *shape), or (R, *shape) where it has no ``instants``."""
    lead = ("T",) * instants
    wanted = f"give ({', '.join(map(str, (*lead, *shape)))}) or ({', '.join(map(str, ('R', *lead, *shape)))})"
    found = np.array(real_array("Moving", name, value, wanted), dtype=np.float64)
    least = instants + len(shape)
    if found.shape[found.ndim - len(shape):] != shape or found.ndim not in (least, least + 1):
        raise InputError("Moving", name, f"shape {found.shape}", wanted)
    if not np.isfinite(found).all():
        raise InputError("Moving", name, "not finite", "give finite numbers")
    return found if found.ndim > least else found[None]
