"""The rod as its own obstacle, and how near its parts are to each other (docs/contact.md). Axes: R rods, V vertices."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from doo_ti.contact.obstacles import Obstacle
from doo_ti.system.arguments import typed

ITSELF = -1  # its kind. Kernels do not meet it: they have a code of their own for it.
LEAST_ARC = np.pi  # radii: parts of a rod with less of it between them do not touch, since it cannot bend that much
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
