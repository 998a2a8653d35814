"""The obstacles around rods, with the rods' radius, and the gaps between them (docs/contact.md). Axes: R rods, V vertices."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from doo_ti.contact.itself import Itself, smallest_self_gap
from doo_ti.contact.moving import Moving
from doo_ti.contact.obstacles import Obstacle

PLACES = 8
"""Of an edge, both ends included, at which its gap is measured."""
SHALLOW, MOST_STEPS = 0.5, 10_000
"""Of a radius; and the most steps that are taken for it."""


@dataclass(frozen=True)
class Surroundings:
    """What rods may touch.

    obstacles  each with one row, or R; in motions some may be :class:`.Moving`
    radius     of the rods, mm, one or (R,); None without obstacles
    """

    obstacles: Sequence[Obstacle | Moving] = ()
    radius: np.ndarray | float | None = None

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
        """Those of the rods ``rows``."""
        radius = self.radius if np.size(self.radius) < 2 else np.asarray(self.radius)[rows]
        return Surroundings([obstacle.take(rows) for obstacle in self.obstacles], radius)

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

    def smallest_gap(self, vertices: np.ndarray) -> np.ndarray:
        """(R,) mm between the surface of each rod (R, V, 3) and the nearest obstacle, itself if it is one, the least along the
        rod, measured at :data:`PLACES` of each edge; negative inside an obstacle, NaN for a rod without places."""
        share = np.linspace(0.0, 1.0, PLACES)[:, None]
        points = vertices[:, :-1, None] + share * np.diff(vertices, axis=1)[:, :, None]
        points = points.reshape(len(vertices), -1, 3)
        least = np.full(len(vertices), np.inf)
        for obstacle in self.bodies:
            least = np.minimum(least, obstacle.distance(points)[0].min(axis=1))
        radius = np.zeros(1) if self.radius is None else np.asarray(self.radius, dtype=np.float64).reshape(-1)
        least = least - radius
        return least if self.itself is None else np.minimum(least, smallest_self_gap(vertices, radius))
