"""One error landscape on a pair of axes: a map over two parameters or a line over one, with its marks."""

import numpy as np

from doo_ti.report.canvas import MEAN_DISTANCE, MISSING, axis_label, literal, plain_ticks, quantity
from doo_ti.report.plane import REGIMES, LandscapePlane, cell_edges, regime

STAR, VALLEY, REGION, LINE, BORDER = "#ff2e63", "#fde725", "#ff9f1c", "#31688e", "#202020"


def draw_map(axes, plane: LandscapePlane, norm, size: float = 1.0):
    """Cells in colour, valley outlined, uncertified cells hatched, lines between the regimes of a ribbon; returns the coloured
    mesh. ``size`` scales text and marks: 1 in a picture of its own.
    """
    from matplotlib.collections import LineCollection, PolyCollection

    first, second = plane.axes
    drawn, (x, y) = plane.blocks()
    axes.set_facecolor(MISSING)
    mesh = axes.pcolormesh(x, y, np.ma.masked_invalid(drawn.values.T), cmap="viridis", norm=norm, rasterized=True)
    axes.add_collection(PolyCollection(
        _rectangles(x, y, drawn.unfinished > 0), facecolor=(0.6, 0.6, 0.6, 0.45), edgecolor=(0.15, 0.15, 0.15, 0.9),
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
    axes.set_xlim(x[0], x[-1])
    axes.set_ylim(y[0], y[-1])
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


def draw_star(axes, plane: LandscapePlane, size: float = 1.0) -> None:
    """Draw the star at the minimum."""
    axes.plot(*place_of(plane, plane.minimum), "*", markersize=17 * size, color=STAR, markeredgecolor="white",
              markeredgewidth=1.2 * size, zorder=5)


def draw_marks(axes, plane: LandscapePlane, marks, size: float = 1.0) -> None:
    """Circles on further cells, (text, cell) each; texts are in a column on the side with more room, a line leads to each."""
    from matplotlib.patheffects import Normal, Stroke

    rim = [Stroke(linewidth=2.8 * size, foreground="#202020"), Normal()]
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


def draw_region(axes, region) -> None:
    """The outline (n, 2) of a region, in the axes' units; closed, whether its last point is its first or not."""
    from matplotlib.patches import Polygon

    axes.add_patch(Polygon(region, closed=True, fill=False, edgecolor=REGION, linewidth=2.2, linestyle="--", zorder=4,
                           path_effects=edged()))


def cell_boxes(axes, plane: LandscapePlane, cells: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """(N, 4) left, top, width and height in pixels of the cells a and b (N,), once the figure is laid out. Over one free
    axis a cell is as high as the axes."""
    edges = [cell_edges(axis) for axis in plane.axes]
    low = [edges[0][cells[0]], edges[1][cells[1]] if len(edges) > 1 else np.full(len(cells[0]), axes.get_ylim()[0])]
    high = [edges[0][cells[0] + 1],
            edges[1][cells[1] + 1] if len(edges) > 1 else np.full(len(cells[0]), axes.get_ylim()[1])]
    low, high = (axes.transData.transform(np.stack(corner, axis=-1)) for corner in (low, high))
    top = axes.figure.bbox.height - high[:, 1]
    return np.stack([low[:, 0], top, *(high - low).T], axis=-1)


def edged() -> list:
    """A dark rim that makes a light line visible on any background."""
    from matplotlib.patheffects import Normal, Stroke

    return [Stroke(linewidth=3.8, foreground="#202020"), Normal()]


def _draw_regimes(axes, plane: LandscapePlane, size: float) -> None:
    """B₁₁ = B₂₂, B₁₁ = β and B₂₂ = β, and the regimes' numbers in the middle of their cells (Fig. 5)."""
    from matplotlib.patheffects import withStroke

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
                      path_effects=[withStroke(linewidth=3 * size, foreground="#202020")], clip_on=True)


def _rectangles(x: np.ndarray, y: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """(N, 4, 2) corners of the rectangles that cover the cells in ``mask`` (A, B), each one cell wide along a."""
    a, first, behind = _stretches(mask)
    left, right, low, high = x[a], x[a + 1], y[first], y[behind]
    return np.stack([np.stack([left, right, right, left], -1), np.stack([low, low, high, high], -1)], axis=-1)


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
