"""Contact in pictures and recordings: obstacles and the forces they exert on rods; and groups of rods, as thick as they are,
with the forces that hold them. Axes: R rods, T frames or moments, V vertices."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib import colormaps
from matplotlib.collections import PolyCollection

from doo_ti.contact.distance_grid import mesh
from doo_ti.contact.obstacles import PLANE, Obstacle
from doo_ti.contact.surroundings import Moving, Surroundings
from doo_ti.report.canvas import box, direction, limits_around, literal, new_figure, save_figure, upright_basis, widest

if TYPE_CHECKING:  # it brings the solvers, and Taichi with them
    from doo_ti.groups.relax_group import GroupSolution

PLANE_COLOR, OBSTACLE, FORCE = "#eceef2", "#c9ced8", "#1d4ed8"
FAINT = 0.25  # of an obstacle that has moved on
LONG, MOST_SHORTER = 0.2, 0.95
"""Of the size of the scene: the length of an arrow; and that share of all forces, and those at the last frame, which pictures
show, have shorter ones."""


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
        wanted = self._box[1] * LONG / max(np.quantile(force[force > 0], MOST_SHORTER),
                                           np.nanmax(force[:, -1], initial=0.0))
        power = 10.0 ** np.floor(np.log10(wanted))
        return float(power * max(step for step in (1.0, 2.0, 5.0) if step * power <= wanted * (1 + 1e-9)))

    @property
    def _unit(self) -> str:
        """Of forces, as they are shown."""
        return "mm²/mm" if self.newtons is None else "N"

    @property
    def legend(self) -> str:
        """The line that says how large the arrows of contact forces are."""
        if not np.nan_to_num(self.force).any():
            return "no contact forces"
        return f"contact forces (an arrow of 10 mm: {10 / self.arrow_scale:g} {self._unit})"

    @property
    def legend_at_end(self) -> str:
        """The same of a picture that shows the forces of the last frame."""
        if np.nan_to_num(self.force[:, -1]).any() or not np.nan_to_num(self.force).any():
            return f"blue, at the end: {self.legend}"
        most = np.linalg.norm(np.nan_to_num(self._shown).sum(axis=2), axis=-1).max()
        return f"at the end nothing touches; before, {most:.3g} {self._unit} in all at most"

    def arrows(self, row: int, frame: int) -> tuple[np.ndarray, np.ndarray]:
        """Origins and vectors (N, 3) in mm of the forces on a rod at a frame."""
        force, places = self._shown[row, frame], self.positions[row, frame]
        shown = np.isfinite(places).all(axis=-1) & (np.nan_to_num(force) != 0).any(axis=-1)
        return places[shown], self.arrow_scale * force[shown]

    def tips(self, rows: Iterable[int], frame: int) -> np.ndarray:
        """(N, 3) mm, where the arrows of the forces on some rods end at a frame."""
        return np.concatenate([np.add(*self.arrows(row, frame)) for row in rows])

    def draw(self, plot, row: int, view: np.ndarray, frame: int) -> None:
        """The obstacles around a rod, and the forces on it, at a frame in a plot with the axes ``view`` (2, 3)."""
        self.draw_obstacles(plot, row, view, frame, Obstacle)
        self.draw_obstacles(plot, row, view, frame, Moving)
        self.draw_forces(plot, row, view, frame)

    def draw_obstacles(self, plot, row: int, view: np.ndarray, frame: int, given: type, alpha: float = 1.0) -> list:
        """The obstacles around a rod that do not move, :class:`Obstacle`, or those :class:`Moving`, where they are at a frame:
        what was drawn; the plot's limits stay as they are."""
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


# --- groups --------------------------------------------------------------------------------------------------------------

EARLIER = 4  # moments before the last that are drawn, faintly
WIDTH, HIGHEST, CURVES = 6.4, 6.0, 2.4  # inches: of the picture, the most of a view, and of the curves
ABOVE_ARROWS = 4  # of what is drawn, so that arrows do not hide how rods cross
MOST_NAMED = 12  # entries of a legend


@dataclass(frozen=True)
class GroupMotion:
    """One group at T moments, as pictures and recordings show it.

    names    of its G rods
    rods     T lists of them, (V, 3) mm each, NaN where they have no place
    held     the forces (T,) of the clamps, mm²/mm, by the end that they hold; those that hold none are left out
    tied     numbers of the tied vertices among all of the group
    sound    (T,) bool: converged
    radii    (G,) mm, or None where the rods have no thickness
    touched  the obstacles, and the contact forces on all vertices of the group
    rate     moments per second
    up       (3,) direction against gravity
    """

    name: str
    names: list[str]
    rods: list[list[np.ndarray]]
    held: dict[str, np.ndarray]
    tied: np.ndarray
    sound: np.ndarray
    radii: np.ndarray | None
    touched: Touched
    rate: float
    up: Sequence[float]

    @classmethod
    def of(cls, moments: "Sequence[GroupSolution]", name: str, names: list[str], surroundings: Surroundings | None = None,
           rate: float = 1.0, up: Sequence[float] = (0.0, 0.0, 1.0), newton: float | None = None) -> "GroupMotion":
        """The first group of solutions, ``newton`` N in their unit of force; None: arrows are not in N."""
        group, around = moments[0].group, Surroundings()
        if surroundings is not None:  # the radius may be that of each rod of a group
            around = replace(surroundings, obstacles=[body.take(np.array([0])) for body in surroundings.obstacles])
        rods = [[rod.vertices[0] for rod in moment.rods] for moment in moments]
        force = np.array([np.concatenate([part[0] for part in moment.contact_force]) for moment in moments])
        radii = None if around.radius is None else group.radii(around.radius)[0]
        touched = Touched(around, np.array([np.concatenate(own) for own in rods])[None], force[None], newton)
        held = {f"{rod}, {end}": np.array([np.linalg.norm(getattr(moment, f"{end}_force")[0, row]) for moment in moments])
                for row, rod in enumerate(names) for end in ("start", "end")}
        return cls(name, names, rods, {end: force for end, force in held.items() if np.nan_to_num(force).any()},
                   group.tied[:, 0], np.array([moment.converged[0] for moment in moments]), radii, touched, rate, up)

    @property
    def vertices(self) -> np.ndarray:
        """(T, vertices of the group, 3) mm."""
        return self.touched.positions[0]


def save_group(path: Path, seen: GroupMotion) -> None:
    """Write a picture of the last moment with its ties, obstacles and contact forces, some earlier ones faintly; of a motion
    also the forces of the clamps."""
    moments, names = len(seen.rods), seen.names
    radii = np.zeros(len(names)) if seen.radii is None else seen.radii
    basis = upright_basis(seen.vertices.reshape(1, -1, 3), seen.up)
    # Rows right, into the picture and up.
    views = {"from the side": basis, "from above": np.stack([basis[0], -basis[2], basis[1]])}
    places = np.concatenate([seen.vertices.reshape(-1, 3), seen.touched.tips([0], -1)])
    limits = [limits_around(places @ view[[0, 2]].T, 0.55, 0.1) for view in views.values()]
    heights = [min(HIGHEST, WIDTH * np.ptp(limit[1]) / np.ptp(limit[0])) for limit in limits]
    heights += [CURVES] * (moments > 1)
    figure = new_figure((WIDTH + 1.0, sum(heights) + 0.5 * len(heights) + 0.8))
    plots = figure.subplots(len(heights), 1, squeeze=False, height_ratios=heights)[:, 0]
    colors = colormaps["tab10"](np.arange(len(names)) % 10)
    earlier = np.unique(np.linspace(0, moments - 1, EARLIER + 1).round().astype(int))[:-1]
    for plot, (label, view), limit in zip(plots, views.items(), limits, strict=False):
        plot.set(xlim=limit[0], ylim=limit[1], xlabel=f"{direction(view[0])} [mm]",
                 ylabel=f"{label}\n{direction(view[2])} [mm]", aspect="equal")
        for moment in earlier:
            for rod, color in zip(seen.rods[moment], colors, strict=True):
                plot.plot(*(rod @ view[[0, 2]].T).T, color=color, lw=0.8, alpha=0.3)
        _draw_rods(plot, seen.rods[-1], colors, view, radii)
        seen.touched.draw(plot, 0, view[[0, 2]], moments - 1)
        tied = seen.vertices[-1, seen.tied] @ view[[0, 2]].T
        plot.plot(*tied.T, "o", color="white", markeredgecolor="black", markersize=4, zorder=ABOVE_ARROWS + 1)
        plot.grid(alpha=0.2)
    for rod, color in zip(names[:MOST_NAMED], colors, strict=False):
        plots[0].plot([], [], color=color, lw=3, label=literal(rod))
    plots[0].legend(fontsize=8, frameon=False, loc="best")
    if moments > 1:
        _draw_forces(plots[-1], seen)
    status, ties = ", not converged" * (not seen.sound[-1]), "; circles: ties" * bool(len(seen.tied))
    when = "" if moments == 1 else f" after {(moments - 1) / seen.rate:.3g} s, earlier moments faint"
    save_figure(figure, path, f"{seen.name}{when}{status}\nblue: {seen.touched.legend}{ties}")


def _draw_rods(plot, rods: list[np.ndarray], colors: np.ndarray, view: np.ndarray, radii: np.ndarray) -> None:
    """The edges of rods as bands of their thickness, those in front over those behind."""
    bands, depth = [], []
    for rod, radius in zip(rods, radii, strict=True):
        local = rod @ view.T
        flat = local[:, [0, 2]]
        along = np.diff(flat, axis=0)
        along /= np.maximum(np.linalg.norm(along, axis=-1, keepdims=True), 1e-9)
        side = radius * np.stack([-along[:, 1], along[:, 0]], axis=-1)
        bands.append(np.stack([flat[:-1] + side, flat[1:] + side, flat[1:] - side, flat[:-1] - side], axis=1))
        depth.append(local[:-1, 1] + local[1:, 1])
    order = np.argsort(-np.concatenate(depth), kind="stable")
    shade = np.repeat(colors, [len(band) for band in bands], axis=0)[order]
    plot.add_collection(PolyCollection(np.concatenate(bands)[order], facecolors=shade, edgecolors=shade, linewidths=1.0,
                                       zorder=ABOVE_ARROWS), autolim=False)


def _draw_forces(plot, seen: GroupMotion) -> None:
    """The forces of clamps on the ends of rods over time, the largest named."""
    time, sound = np.arange(len(seen.rods)) / seen.rate, seen.sound
    curves = [(np.where(sound, force, np.nan), end) for end, force in seen.held.items()]
    curves.sort(key=lambda curve: -np.nanmax(np.nan_to_num(curve[0])))
    for number, (force, label) in enumerate(curves):
        plot.plot(time, force, ".-", lw=1.2, markersize=3, label=literal(label) if number < MOST_NAMED else None)
    if not sound.all():
        plot.plot(time[~sound], np.zeros((~sound).sum()), "x", color="red", label="not converged")
    plot.set(xlabel="time [s]", ylabel="clamps' forces [mm²/mm]")
    plot.grid(alpha=0.2)
    if curves:
        plot.legend(fontsize=7, frameon=False, ncols=2)
