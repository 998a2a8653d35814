"""Pictures of rods in space: moments of a motion (§III-D), and ribbons as bands along their material frames (Fig. 5c)."""

from dataclasses import dataclass

import numpy as np

from doo_ti.report.canvas import box, limits_around, literal, new_figure, save_figure
from doo_ti.report.grid_view import upright_basis
from doo_ti.report.touched import Touched

MOST_RODS, COLUMNS = 12, 4
SHOWN = 9
"""Moments of each rod, evenly chosen."""
JUMP = "#ff2e63"
VIEWS = {"from the front": (0.0, 0.0), "from the side and above": (50.0, 30.0)}
"""Views of ribbons: the angles in degrees by which the viewer moves around to the right and up."""
COLUMN_INCHES = 3.6
LIGHT = np.array([-0.45, -0.65, 0.6]) / np.linalg.norm([0.45, 0.65, 0.6])


@dataclass(frozen=True)
class MovingRods:
    """T moments of R rods whose clamps move.

    time      (T,) s
    vertices  (T, R, V, 3) mm, NaN where a rod has no configuration
    names     R of them
    jumps     (T, R) jumps to another branch since the moment before
    sound     (T, R) bool: certified minima so far
    up        (3,) direction against gravity
    grippers  (T, R, lines, points, 3) mm: lines that show how the ends are held; None: not drawn
    marks     (R, V, 3) mm: what was observed of the rods at the start, NaN where missing; None where nothing was
    touched   obstacles around the rods, and the forces of contact; None without obstacles
    """

    time: np.ndarray
    vertices: np.ndarray
    names: list[str]
    jumps: np.ndarray
    sound: np.ndarray
    up: np.ndarray = (0.0, 0.0, 1.0)
    grippers: np.ndarray | None = None
    marks: np.ndarray | None = None
    touched: Touched | None = None

    @property
    def basis(self) -> np.ndarray:
        """(3, 3) rows right, into the picture, and up."""
        return upright_basis(self.vertices.reshape(-1, *self.vertices.shape[2:]), self.up)


def motions_picture(path_or_buffer, rods: MovingRods, *, title: str) -> None:
    """Write the motions as a PNG, at most the first ``MOST_RODS``, ``COLUMNS`` beside each other: each from the front and
    below that from above. Early moments are dark; the shapes before a jump, dashed, and after it are thick and red."""
    shown, time = min(len(rods.names), MOST_RODS), rods.time
    vertices, jumps = rods.vertices[:, :shown], rods.jumps[:, :shown]
    moments = np.unique(np.linspace(0, len(time) - 1, SHOWN).round().astype(int))
    views = [rods.basis[[0, 2]], rods.basis[:2]]
    limits = [limits_around(vertices @ view.T, 0.55, 0.18) for view in views]
    heights = [np.ptp(limit[1]) / np.ptp(limit[0]) for limit in limits]
    columns, blocks = min(shown, COLUMNS), -(-shown // COLUMNS)
    figure = new_figure((3.4 * columns + 0.8, blocks * (3.2 * sum(heights) + 0.8) + 0.8))
    panels = figure.subplots(2 * blocks, columns, squeeze=False, height_ratios=blocks * heights)
    for rod in range(columns * blocks):
        block, column = divmod(rod, columns)
        for row, (view, label) in enumerate(zip(views, ("from the front", "from above"), strict=True)):
            axes = panels[2 * block + row, column]
            if rod >= shown:
                axes.set_axis_off()
                continue
            axes.set(xlim=limits[row][0], ylim=limits[row][1])
            _draw_moments(axes, vertices[:, rod] @ view.T, time, moments, np.flatnonzero(jumps[:, rod]))
            if rods.touched is not None:
                rods.touched.draw(axes, rod, view, [len(time) - 1])
            axes.set_aspect("equal")
            axes.grid(alpha=0.2)
            if column == 0:
                axes.set_ylabel(f"{label} [mm]", fontsize=10)
            if row == 0:
                count = int(jumps[:, rod].sum())
                axes.set_title(literal(rods.names[rod]) + f": {count} jump{'s' * (count != 1)}" * (count > 0), fontsize=10)
    figure.supxlabel("[mm]", fontsize=10)
    figure.colorbar(_time_scale(time), ax=list(panels.ravel()), pad=0.01, aspect=40).set_label("time [s]", fontsize=10)
    more = f" ({len(rods.names) - shown} more are not drawn)" if len(rods.names) > shown else ""
    red = "\nred: before a jump (dashed) and after it" if jumps.any() else ""
    blue = "" if rods.touched is None else f"\nblue, at the end:\n{rods.touched.legend}"
    figure.suptitle(f"{literal(title)}{more}{red}{blue}", fontsize=10)
    save_figure(figure, path_or_buffer)


def _draw_moments(axes, flat: np.ndarray, time: np.ndarray, moments: np.ndarray, jumps: np.ndarray) -> None:
    """Shapes (T, V, 2) at some moments, and before and after jumps."""
    scale = _time_scale(time)
    for moment in moments:
        axes.plot(*flat[moment].T, color=scale.to_rgba(time[moment]), linewidth=1.4)
    for moment in jumps:
        axes.plot(*flat[max(moment - 1, 0)].T, "--", color=JUMP, linewidth=1.8)
        axes.plot(*flat[moment].T, color=JUMP, linewidth=1.8)


def _time_scale(time: np.ndarray):
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    return ScalarMappable(Normalize(time[0], time[-1]), colormaps["viridis"])


@dataclass(frozen=True)
class Ribbons:
    """Ribbons of one kind, D of them.

    label   what they are
    color   (3,) uint8
    sides   (D, 2, V, 3) mm, the two borders of each, as `ribbon_sides` finds them
    filled  whether their faces are drawn, or only their outlines
    """

    label: str
    color: tuple[int, int, int]
    sides: np.ndarray
    filled: bool = True


def ribbon_sides(vertices: np.ndarray, across: np.ndarray, width: float) -> np.ndarray:
    """(..., 2, V, 3) mm, the borders of bands of ``width`` along middle lines (..., V, 3); ``across`` (..., E, 3) is m1 of each
    edge, and at a vertex the mean of the edges beside it is used."""
    ends = np.concatenate([across[..., :1, :], across, across[..., -1:, :]], axis=-2)
    mean = ends[..., 1:, :] + ends[..., :-1, :]
    half = 0.5 * width * mean / np.maximum(np.linalg.norm(mean, axis=-1, keepdims=True), 1e-9)
    return np.stack([vertices - half, vertices + half], axis=-3)


def ribbons_picture(path_or_buffer, ribbons: list[Ribbons], which: int, *, basis: np.ndarray, title: str) -> None:
    """Write the ribbon ``which`` of each kind as a PNG: a column for each filled kind, the outlined ones in all columns, a row
    for each view. ``basis`` (3, 3) has rows right, into the picture and up."""
    from matplotlib.lines import Line2D

    filled, outlined = ([kind for kind in ribbons if kind.filled == wanted] for wanted in (True, False))
    views = [_turned(*angles) @ basis for angles in VIEWS.values()]
    middles, sizes = _frames(np.stack([kind.sides[which] for kind in ribbons]), views)
    heights = COLUMN_INCHES * sizes[:, 1] / sizes[0, 0]
    figure = new_figure((COLUMN_INCHES * len(filled), heights.sum() + 1.4))
    grid = figure.subplots(len(VIEWS), len(filled), squeeze=False, height_ratios=heights)
    for places, name, view, middle, size in zip(grid, VIEWS, views, middles, sizes, strict=True):
        for axes, kind in zip(places, filled, strict=True):
            _draw_band(axes, kind.sides[which] @ view.T, kind.color)
            for other in outlined:
                _draw_outline(axes, other.sides[which] @ view.T, other.color)
            axes.set(xlim=middle[0] + 0.5 * size[0] * np.array([-1, 1]), ylim=middle[1] + 0.5 * size[1] * np.array([-1, 1]))
            axes.set_aspect("equal")
            axes.set_axis_off()
        _label_view(places[0], name)
    for axes, kind in zip(grid[0], filled, strict=True):
        axes.set_title(literal(kind.label), fontsize=9.5, color=np.array(kind.color) / 255)
    figure.suptitle(literal(title), fontsize=13)
    if outlined:
        keys = [Line2D([], [], color=np.array(kind.color) / 255, label=literal(kind.label)) for kind in outlined]
        figure.legend(handles=keys, loc="outside lower center", ncols=len(keys), frameon=False, fontsize=10)
    save_figure(figure, path_or_buffer)


def _draw_band(axes, sides: np.ndarray, color: tuple[int, int, int]) -> None:
    """Faces between borders (2, V, 3), the far ones first, lit from the upper left."""
    from matplotlib.collections import PolyCollection

    low, high = sides
    faces = np.stack([low[:-1], low[1:], high[1:], high[:-1]], axis=1)
    normal = np.cross(faces[:, 2] - faces[:, 0], faces[:, 3] - faces[:, 1])
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-9)
    colors = (0.5 + 0.5 * np.abs(normal @ LIGHT))[:, None] * np.array(color) / 255
    order = np.argsort(-faces[..., 1].mean(axis=1), kind="stable")
    axes.add_collection(PolyCollection(faces[order][..., [0, 2]], facecolors=colors[order], linewidths=0.35,
                                       edgecolors=(0.08, 0.08, 0.08, 0.55)))


def _draw_outline(axes, sides: np.ndarray, color: tuple[int, int, int]) -> None:
    """Borders (2, V, 3) and the lines across them, in front of everything."""
    from matplotlib.collections import LineCollection

    flat, shade = sides[..., [0, 2]], np.array(color) / 255
    axes.add_collection(LineCollection(list(flat), colors=[shade], linewidths=1.3, zorder=3))
    axes.add_collection(LineCollection(flat.swapaxes(0, 1), colors=[shade], linewidths=0.4, zorder=3))


def _label_view(axes, name: str) -> None:
    """The name of a row's view, and a scale bar of 20 mm."""
    left, low = axes.get_xlim()[0] + 1, axes.get_ylim()[0] + 2
    axes.plot([left, left + 20], [low, low], color="#202020", linewidth=2)
    axes.annotate("20 mm", (left + 10, low), xytext=(0, 4), textcoords="offset points", ha="center", va="bottom", fontsize=9)
    axes.annotate(literal(name), (0.0, 1.0), xycoords="axes fraction", ha="left", va="top", fontsize=10, color="#606060")


def _frames(points: np.ndarray, views: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Middle, and width and height in mm, of (..., 3) points in each view; all views are equally wide, at least a third of
    their heights."""
    low, high = box(np.stack([(points @ view.T)[..., [0, 2]].reshape(-1, 2) for view in views]))
    sizes = high - low + [8.0, 10.0]
    sizes[:, 0] = max(sizes[:, 0].max(), sizes[:, 1].max() / 3)
    return 0.5 * (low + high), sizes


def _turned(around: float, above: float) -> np.ndarray:
    """(3, 3) right, into and up of a viewer who moved around and up by these angles in degrees."""
    cosine, sine = np.cos(np.radians([around, above])), np.sin(np.radians([around, above]))
    right = np.array([[cosine[0], sine[0], 0], [-sine[0], cosine[0], 0], [0, 0, 1]])
    return np.array([[1, 0, 0], [0, cosine[1], -sine[1]], [0, sine[1], cosine[1]]]) @ right
