"""Obstacles and contact forces in pictures and recordings. Axes: R rods, T frames, V vertices."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from doo_ti.contact.meshes import mesh
from doo_ti.contact.moving import Moving
from doo_ti.contact.obstacles import PLANE, Obstacle
from doo_ti.contact.surroundings import Surroundings
from doo_ti.report.canvas import box, widest

PLANE_COLOR, OBSTACLE, FORCE = "#eceef2", "#c9ced8", "#1d4ed8"
FAINT = 0.25
"""Of an obstacle that has moved on."""
LONG, MOST_SHORTER, LONGEST = 0.2, 0.95, 0.3
"""Of the size of the scene: the length of an arrow; that share of all forces has shorter ones; and the most at the last frame,
which pictures show."""


@dataclass(frozen=True)
class Touched:
    """What rods touch, and what it exerts.

    surroundings  the obstacles
    positions     (R, T, V, 3) mm of the rods
    force         (R, T, V, 3) on their vertices, energy (mm²) per mm
    newtons       (R,) N in that unit, for arrows of N, or None
    """

    surroundings: Surroundings
    positions: np.ndarray
    force: np.ndarray
    newtons: np.ndarray | None = None

    @cached_property
    def _shown(self) -> np.ndarray:
        """(R, T, V, 3) the forces in the unit of the arrows."""
        return self.force if self.newtons is None else self.force * np.reshape(self.newtons, (-1, 1, 1, 1))

    @cached_property
    def _box(self) -> tuple[np.ndarray, float]:
        """Centre (3,) and size of where the rods are."""
        low, high = box(self.positions.reshape(-1, 3))
        return 0.5 * (low + high), max(float(np.linalg.norm(high - low)), widest(low, high))

    def meshes(self, row: int, frame: int, kinds: tuple[type, ...] = (Obstacle, Moving)
               ) -> Iterator[tuple[Obstacle | Moving, int, np.ndarray, np.ndarray, np.ndarray]]:
        """Of each obstacle around the rod ``row`` that was given as one of ``kinds``, planes first: what was given, its kind
        and, at a frame, vertices (N, 3), triangles (M, 3) and their outward normals (M, 3)."""
        own = self.surroundings.take(np.array([row]))
        found = [pair for pair in zip(own.bodies, own.at(frame).bodies, strict=True) if isinstance(pair[0], kinds)]
        for given, obstacle in sorted(found, key=lambda pair: pair[1].kind != PLANE):
            vertices, triangles = mesh(obstacle, 0, *self._box)
            normals = obstacle.distance(vertices[triangles].mean(axis=1)[None])[1][0]
            yield given, obstacle.kind, vertices, triangles, normals

    @cached_property
    def arrow_scale(self) -> float:
        """mm that a force of 1 is long in their unit: a round number."""
        force = np.linalg.norm(self._shown, axis=-1)
        if not (force > 0).any():
            return 1.0
        wanted = self._box[1] * min(LONG / np.quantile(force[force > 0], MOST_SHORTER),
                                    LONGEST / max(np.nanmax(force[:, -1], initial=0.0), 1e-300))
        power = 10.0 ** np.floor(np.log10(wanted))
        return float(power * max(step for step in (1.0, 2.0, 5.0) if step * power <= wanted * (1 + 1e-9)))

    @property
    def legend(self) -> str:
        """The line that says how large the arrows of contact forces are."""
        if not np.nan_to_num(self.force).any():
            return "no contact forces"
        return f"contact forces (an arrow of 10 mm: {10 / self.arrow_scale:g} {'mm²/mm' if self.newtons is None else 'N'})"

    def arrows(self, row: int, frame: int) -> tuple[np.ndarray, np.ndarray]:
        """Origins and vectors (N, 3) in mm of the forces on a rod at a frame."""
        force, places = self._shown[row, frame], self.positions[row, frame]
        shown = np.isfinite(places).all(axis=-1) & (np.nan_to_num(force) != 0).any(axis=-1)
        return places[shown], self.arrow_scale * force[shown]

    def draw(self, plot, row: int, view: np.ndarray, frames: list[int]) -> None:
        """The obstacles around a rod, and the forces on it at some frames, in a plot with the axes ``view`` (2, 3)."""
        self.draw_still(plot, row, view)
        for frame in frames:
            self.draw_moving(plot, row, view, frame)
            self.draw_forces(plot, row, view, frame)

    def draw_still(self, plot, row: int, view: np.ndarray) -> None:
        """The obstacles around a rod that do not move; the plot's limits stay as they are."""
        self._draw_obstacles(plot, row, view, 0, Obstacle)

    def draw_moving(self, plot, row: int, view: np.ndarray, frame: int, faint: bool = False) -> list:
        """Those that move, where they are at a frame: what was drawn."""
        return self._draw_obstacles(plot, row, view, frame, Moving, FAINT if faint else 1.0)

    def _draw_obstacles(self, plot, row: int, view: np.ndarray, frame: int, given: type, alpha: float = 1.0) -> list:
        from matplotlib.collections import PolyCollection

        limits, drawn = plot.axis(), []
        for _, kind, vertices, triangles, _ in self.meshes(row, frame, (given,)):
            color = PLANE_COLOR if kind == PLANE else OBSTACLE
            # The edges of triangles would add up where these are faint.
            drawn.append(plot.add_collection(PolyCollection(
                (vertices @ view.T)[triangles], facecolors=color, edgecolors=color if alpha == 1.0 else "none",
                linewidths=0.8, alpha=alpha, zorder=0), autolim=False))
        plot.axis(limits)
        return drawn

    def draw_forces(self, plot, row: int, view: np.ndarray, frame: int) -> list:
        """The forces on a rod at a frame: what was drawn."""
        places, vectors = self.arrows(row, frame)
        if not len(places):
            return []
        return [plot.quiver(*(places @ view.T).T, *(vectors @ view.T).T, angles="xy", scale_units="xy", scale=1.0, color=FORCE,
                            width=0.003, zorder=3)]
