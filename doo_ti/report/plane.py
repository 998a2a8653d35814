"""The error landscape of a sweep over at most two axes, its minimum and its valley (§III-E), and how it is drawn on a pair of
axes: a map over two parameters or a line over one, with its marks.

Axes of a grid are (name, values, is_log, unit); a landscape holds one mean distance (Eq. 1) per cell of the grid.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.patheffects import Normal, Stroke
from numpy.typing import ArrayLike

from doo_ti.report.canvas import MEAN_DISTANCE, MISSING, axis_label, literal, plain_ticks, quantity
from doo_ti.system.arguments import short_repr, typed

REGIMES = ("β > B₁₁ and B₂₂", "B₂₂ > B₁₁ > β", "B₁₁ > B₂₂ > β")
"""The regimes of a ribbon in the order of Fig. 5: it bends sharply instead of twisting, it bends about the stiff axis, it
twists instead of bending about the stiff axis."""
MOST_DRAWN = 512  # cells along an axis of a picture, whose axes are some 1100 × 800 pixels


GridAxis = tuple[str, Sequence[float] | np.ndarray, bool, str]  # (name, values, is_log, unit)


@typed
@dataclass(frozen=True)
class LandscapePlane:
    """A landscape over at most two free axes, A × B cells (B = 1 where there is one).

    axes        one or two (name, values, is_log, unit)
    shown       indices of these among the grid's axes
    grid        (grid) mean distance in mm of all cells
    values      (A, B) mean distance in mm, NaN where not evaluated; over further free axes the minimum
    minimum     (a, b) cell of the minimum, None where no cell was evaluated
    valley      (A, B) bool: within 5 % of the minimum
    unfinished  (A, B) number of rods that are no certified minima: cells with any do not compete
    hidden      names of further free axes
    best        (name, value, unit) of every free axis at the minimum
    at_border   the minimum lies at an end of a free axis: the true one may lie outside the grid
    twist       β in mm³ where the grid has one and the axes are bend_1 and bend_2 (Fig. 5), else None
    """

    __repr__ = short_repr

    HEIGHT: ClassVar[float] = 0.6
    """Height of the surface's highest cell over its base, the unit square."""

    axes: tuple[GridAxis, ...]
    shown: tuple[int, ...]
    grid: np.ndarray
    values: np.ndarray
    minimum: tuple[int, int] | None
    valley: np.ndarray
    unfinished: np.ndarray
    hidden: tuple[str, ...]
    best: tuple[tuple[str, float, str], ...]
    at_border: bool
    twist: float | None

    @classmethod
    @typed
    def of(cls, axes: Sequence[GridAxis], values: ArrayLike, minimum: Sequence[int] | None = None,
           unfinished: ArrayLike | None = None) -> "LandscapePlane":
        """The landscape over its first two free axes.

        axes        one (name, values, is_log, unit) per grid axis; those with one value are not drawn
        values      (grid) mean distance in mm, NaN where not evaluated
        minimum     index of the minimum, one integer per axis; None where there is none
        unfinished  (grid) number of rods that are no certified minima
        """
        values = np.asarray(values, float)
        minimum = None if minimum is None else tuple(int(i) for i in minimum)
        valley = valley_cells(values, minimum)
        unfinished = np.zeros(values.shape, int) if unfinished is None else np.asarray(unfinished, int)
        free = [k for k, axis in enumerate(axes) if len(axis[1]) > 1] or [0]
        shown = free[:2]
        order = shown + [k for k in range(len(axes)) if k not in shown]
        shape = (len(axes[shown[0]][1]), len(axes[shown[1]][1]) if len(shown) == 2 else 1, -1)
        flat, unfinished, valley = (np.transpose(a, order).reshape(shape) for a in (values, unfinished, valley))
        least = np.argmin(np.where(np.isnan(flat), np.inf, flat), axis=-1)[..., None]
        cell, best, at_border = None, (), False
        if minimum is not None:
            cell = (minimum[shown[0]], minimum[shown[1]] if len(shown) == 2 else 0)
            best = tuple((axes[k][0], axes[k][1][minimum[k]], axes[k][3]) for k in free)
            at_border = any(minimum[k] in (0, len(axes[k][1]) - 1) for k in free if len(axes[k][1]) > 1)
        twist = [axis[1][0] for axis in axes if axis[0] == "twist" and len(axis[1]) == 1]
        drawn, unfinished = (np.take_along_axis(array, least, -1)[..., 0] for array in (flat, unfinished))
        return cls(
            axes=tuple(axes[k] for k in shown), shown=tuple(shown), grid=values, values=drawn, minimum=cell,
            valley=valley.any(axis=-1), unfinished=unfinished, hidden=tuple(axes[k][0] for k in free[2:]), best=best,
            at_border=at_border,
            twist=float(twist[0]) if twist and [axes[k][0] for k in shown] == ["bend_1", "bend_2"] else None)

    def places(self, index: Sequence[ArrayLike]) -> tuple[np.ndarray, np.ndarray]:
        """The cells a and b (N,) of the plane at which cells of the grid are drawn, given as (N,) indices per axis."""
        first, *rest = (np.asarray(index[k]) for k in self.shown)
        return first, rest[0] if rest else 0 * first

    @property
    def unit_axes(self) -> tuple[np.ndarray, np.ndarray]:
        """(A,), (B,) the axes' values from 0 to 1, on log axes of the logarithms; an axis of one value is at 0."""
        units = []
        for _, values, is_log, _ in self.axes:
            values = np.log(values) if is_log else np.asarray(values, float)
            units.append((values - values[0]) / ((values[-1] - values[0]) or 1.0))
        return tuple(units + [np.zeros(1)] * (2 - len(units)))

    def height(self, values: np.ndarray) -> np.ndarray:
        """Distances in mm as heights of the surface, in proportion."""
        finite = self.values[np.isfinite(self.values)]
        return self.HEIGHT * values / (finite.max() if finite.size and finite.max() > 0 else 1.0)

    def blocks(self) -> tuple["LandscapePlane", list[np.ndarray]]:
        """The landscape in at most ``MOST_DRAWN`` cells along each axis, as many as a picture can show, and the borders of
        those cells along each axis.

        A block of cells becomes one cell, with the smallest of their values; it lies in the valley where any of them does, and
        is unfinished where all of them are. A landscape of fewer cells is returned unchanged.
        """
        plane, borders = self, []
        for number, axis in enumerate(self.axes):
            name, values, is_log, unit = axis
            step = -(-len(values) // MOST_DRAWN)
            first = np.arange(0, len(values), step)
            last = np.append(first[1:], len(values)) - 1
            borders.append(cell_edges(axis)[np.append(first, len(values))])
            if step > 1:
                low, high = np.asarray(values, float)[first], np.asarray(values, float)[last]
                middle = np.sqrt(low * high) if is_log else 0.5 * (low + high)
                values = np.fmin.reduceat(plane.values, first, axis=number)
                plane = replace(
                    plane, axes=(*plane.axes[:number], (name, middle, is_log, unit), *plane.axes[number + 1:]), values=values,
                    valley=np.logical_or.reduceat(plane.valley, first, axis=number),
                    unfinished=np.where(np.isnan(values), np.maximum.reduceat(plane.unfinished, first, axis=number), 0),
                    minimum=plane.minimum and tuple(
                        place // step if k == number else place for k, place in enumerate(plane.minimum)))
        return plane, borders

    def surface(self) -> tuple[np.ndarray, np.ndarray]:
        """(A, B, 3) points over the unit square, NaN where not evaluated, and (N, 3) triangles between those that were,
        numbered without the NaN ones."""
        points = np.stack([*np.meshgrid(*self.unit_axes, indexing="ij"), self.height(self.values)], axis=-1)
        inside = np.isfinite(self.values)
        number = np.cumsum(inside).reshape(inside.shape) - 1
        quad = inside[:-1, :-1] & inside[1:, :-1] & inside[:-1, 1:] & inside[1:, 1:]
        a, b, c, d = number[:-1, :-1][quad], number[1:, :-1][quad], number[1:, 1:][quad], number[:-1, 1:][quad]
        return points, np.concatenate([np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)])


def valley_cells(values: np.ndarray, minimum: tuple | None) -> np.ndarray:
    """(grid) bool: cells whose mean distance is at most 5 % above that of the cell ``minimum``."""
    values = np.asarray(values, float)
    if minimum is None:
        return np.zeros(values.shape, bool)
    with np.errstate(invalid="ignore"):
        return values <= 1.05 * values[tuple(minimum)]


def regime(bend_1, bend_2, twist) -> np.ndarray:
    """The number in REGIMES, from 1, of each ribbon B = diag(bend_1, bend_2), β; 0 where it belongs to none."""
    bend_1, bend_2, twist = np.broadcast_arrays(bend_1, bend_2, twist)
    return np.select([(twist > bend_1) & (twist > bend_2), (bend_2 > bend_1) & (bend_1 > twist),
                      (bend_1 > bend_2) & (bend_2 > twist)], [1, 2, 3], 0)


def cell_edges(axis) -> np.ndarray:
    """Borders of the cells around the values of an axis: midpoints, on a log axis of the logarithms."""
    _, values, is_log, _ = axis
    values = np.log(np.asarray(values, float)) if is_log else np.asarray(values, float)
    if len(values) == 1:
        edges = values[0] + np.array([-0.5, 0.5])
    else:
        inner = 0.5 * (values[1:] + values[:-1])
        edges = np.concatenate([[2 * values[0] - inner[0]], inner, [2 * values[-1] - inner[-1]]])
    return np.exp(edges) if is_log else edges


# --- drawing -------------------------------------------------------------------------------------------------------------

STAR, VALLEY, REGION, LINE, BORDER = "#ff2e63", "#fde725", "#ff9f1c", "#31688e", "#202020"


def draw_map(axes, plane: LandscapePlane, norm, size: float = 1.0):
    """Cells in colour, valley outlined, uncertified cells hatched, lines between the regimes of a ribbon; returns the coloured
    mesh. ``size`` scales text and marks: 1 in a picture of its own.
    """
    first, second = plane.axes
    drawn, (x, y) = plane.blocks()
    axes.set_facecolor(MISSING)
    mesh = axes.pcolormesh(x, y, np.ma.masked_invalid(drawn.values.T), cmap="viridis", norm=norm, rasterized=True)
    a, first_b, behind = _stretches(drawn.unfinished > 0)  # rectangles, each one cell wide along a
    left, right, low, high = x[a], x[a + 1], y[first_b], y[behind]
    corners = np.stack([np.stack([left, right, right, left], -1), np.stack([low, low, high, high], -1)], axis=-1)
    axes.add_collection(PolyCollection(
        corners, facecolor=(0.6, 0.6, 0.6, 0.45), edgecolor=(0.15, 0.15, 0.15, 0.9),
        hatch="////", linewidth=0), autolim=False)
    for axis, edges, set_scale, set_label, grid in (
            (axes.xaxis, x, axes.set_xscale, axes.set_xlabel, first),
            (axes.yaxis, y, axes.set_yscale, axes.set_ylabel, second)):
        set_scale("log" if grid[2] else "linear")
        set_label(axis_label(grid), fontsize=13 * size)
        plain_ticks(axis, grid[2], edges[0], edges[-1])
    if plane.twist is not None:
        _draw_regimes(axes, plane, size)
    axes.add_collection(LineCollection(
        _outline(x, y, drawn.valley), colors="white", linewidths=0.6 + 1.6 * size, capstyle="projecting",
        path_effects=edged()), autolim=False)
    axes.set(xlim=(x[0], x[-1]), ylim=(y[0], y[-1]))
    axes.tick_params(labelsize=11 * size)
    return mesh


def draw_line(axes, plane: LandscapePlane, size: float = 1.0) -> None:
    """Distance over the one free axis, log where it spans decades."""
    drawn, (edges,) = plane.blocks()
    axis = drawn.axes[0]
    x, values, finished = np.asarray(axis[1], float), drawn.values[:, 0], drawn.unfinished[:, 0] == 0
    for cells, color, alpha in ((drawn.valley[:, 0], VALLEY, 0.35), (np.isnan(values), MISSING, 0.5)):
        _, first, behind = _stretches(cells[None])
        for left, right in zip(edges[first], edges[behind], strict=True):
            axes.axvspan(left, right, color=color, alpha=alpha, linewidth=0)
    axes.plot(x, values, color=LINE, linewidth=2.2)
    axes.plot(x[finished], values[finished], "o", color=LINE, markersize=7)
    axes.plot(x[~finished], values[~finished], "o", markerfacecolor="white", color=MISSING, markersize=8)
    axes.set_xscale("log" if axis[2] else "linear")
    finite = values[np.isfinite(values)]
    if finite.size and 0 < 10 * finite.min() < finite.max():
        axes.set_yscale("log")
        plain_ticks(axes.yaxis, True, finite.min(), finite.max())
    axes.set_xlim(edges[0], edges[-1])
    axes.margins(y=0.18)
    axes.set_xlabel(axis_label(axis), fontsize=13 * size)
    axes.set_ylabel(MEAN_DISTANCE, fontsize=12 * size)
    plain_ticks(axes.xaxis, axis[2], edges[0], edges[-1])
    axes.tick_params(labelsize=11 * size)
    axes.grid(alpha=0.25)


def place_of(plane: LandscapePlane, cell: tuple[int, int]) -> tuple[float, float]:
    """The middle of a cell of the plane, in the axes' units."""
    first, *second = plane.axes
    return first[1][cell[0]], second[0][1][cell[1]] if second else plane.values[cell]


def draw_marks(axes, plane: LandscapePlane, marks, size: float = 1.0) -> None:
    """Circles on further cells, (text, cell) each; texts are in a column on the side with more room, a line leads to each."""
    rim = edged(2.8 * size)
    texts: dict[tuple, list[str]] = {}
    for text, cell in marks:
        texts.setdefault(tuple(int(k) for k in cell), []).append(text)
    right = np.mean([cell[0] for cell in texts] or [0]) < 0.5 * plane.values.shape[0]
    for row, cell in enumerate(sorted(texts, key=lambda cell: cell[::-1])):
        axes.plot(*place_of(plane, cell), "o", markersize=8 * size, markerfacecolor="none", markeredgecolor="white",
                  markeredgewidth=1.6 * size, zorder=5.5, path_effects=rim)
        if not any(texts[cell]):
            continue
        axes.annotate(literal(", ".join(texts[cell])), place_of(plane, cell), xytext=(
            0.62 if right else 0.38, 0.5 + 0.1 * (row - 0.5 * (len(texts) - 1))), textcoords="axes fraction", zorder=6,
            color="white", fontsize=11 * size, fontweight="bold", va="center", ha="left" if right else "right",
            path_effects=rim, arrowprops={"arrowstyle": "-", "color": "white", "linewidth": 0.9 * size, "shrinkB": 4 * size})


def label_minimum(axes, plane: LandscapePlane) -> None:
    """The value at the minimum, in a box towards the middle of the axes."""
    fractions = [(k + 0.5) / n for k, n in zip(plane.minimum, plane.values.shape, strict=True)]
    x, y = (1 if f < 0.5 else -1 for f in fractions) if len(plane.axes) == 2 else (0, -1)
    axes.annotate(
        quantity(plane.values[plane.minimum], "mm"), place_of(plane, plane.minimum), xytext=(26 * x, 24 * y),
        textcoords="offset points", fontsize=13, fontweight="bold", ha=("right", "center", "left")[x + 1],
        va=("top", "center", "bottom")[y + 1], zorder=6,
        bbox={"boxstyle": "round,pad=0.3", "facecolor": "white", "edgecolor": STAR, "alpha": 0.92},
        arrowprops={"arrowstyle": "-", "color": STAR, "linewidth": 1.6, "shrinkB": 8})


def edged(width: float = 3.8) -> list:
    """A dark rim that makes a light line visible on any background."""
    return [Stroke(linewidth=width, foreground="#202020"), Normal()]


def _draw_regimes(axes, plane: LandscapePlane, size: float) -> None:
    """B₁₁ = B₂₂, B₁₁ = β and B₂₂ = β, and the regimes' numbers in the middle of their cells (Fig. 5)."""
    style = {"color": BORDER, "linewidth": 1.4 * size, "linestyle": (0, (5, 3))}
    axes.axline((1, 1), (2, 2), **style)
    axes.axvline(plane.twist, **style)
    axes.axhline(plane.twist, **style)
    first, second = (np.asarray(axis[1], float) for axis in plane.axes)
    of_cell = regime(first[:, None], second, plane.twist)
    for number in range(1, len(REGIMES) + 1):
        a, b = np.nonzero(of_cell == number)
        if len(a):
            middle = np.exp(np.log(first[a]).mean()), np.exp(np.log(second[b]).mean())
            axes.text(*middle, str(number), fontsize=20 * size, fontweight="bold", color="white", ha="center", va="center",
                      path_effects=edged(3 * size), clip_on=True)


def _stretches(mask: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(N,) row, first column and the column behind the last, of each run of True in the rows of ``mask`` (A, B)."""
    turns = np.diff(np.pad(mask, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    (row, first), (_, behind) = np.nonzero(turns == 1), np.nonzero(turns == -1)
    return row, first, behind


def _outline(x: np.ndarray, y: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """(N, 2, 2) the sides on which a cell in ``mask`` (A, B) has a neighbour outside it."""
    padded = np.pad(mask, 1)
    a, b = np.nonzero(padded[1:, 1:-1] != padded[:-1, 1:-1])
    upright = np.stack([np.stack([x[a], x[a]], -1), np.stack([y[b], y[b + 1]], -1)], -1)
    a, b = np.nonzero(padded[1:-1, 1:] != padded[1:-1, :-1])
    level = np.stack([np.stack([x[a], x[a + 1]], -1), np.stack([y[b], y[b]], -1)], -1)
    return np.concatenate([upright, level])
