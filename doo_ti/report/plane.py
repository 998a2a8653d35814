"""The error landscape of a sweep over at most two axes, its minimum and its valley (§III-E).

Axes of a grid are (name, values, is_log, unit); a landscape holds one mean distance (Eq. 1) per cell of the grid.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from doo_ti.system.arguments import typed
from doo_ti.system.short_repr import short_repr

REGIMES = ("β > B₁₁ and B₂₂", "B₂₂ > B₁₁ > β", "B₁₁ > B₂₂ > β")
"""The regimes of a ribbon in the order of Fig. 5: it bends sharply instead of twisting, it bends about the stiff axis, it
twists instead of bending about the stiff axis."""
MOST_DRAWN = 512
"""Cells along an axis of a picture, whose axes are some 1100 × 800 pixels."""


GridAxis = tuple[str, Sequence[float] | np.ndarray, bool, str]
"""(name, values, is_log, unit)."""


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
        return cls(
            axes=tuple(axes[k] for k in shown),
            shown=tuple(shown),
            grid=values,
            values=np.take_along_axis(flat, least, -1)[..., 0],
            minimum=cell,
            valley=valley.any(axis=-1),
            unfinished=np.take_along_axis(unfinished, least, -1)[..., 0],
            hidden=tuple(axes[k][0] for k in free[2:]),
            best=best,
            at_border=at_border,
            twist=float(twist[0]) if twist and [axes[k][0] for k in shown] == ["bend_1", "bend_2"] else None,
        )

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
