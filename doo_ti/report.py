"""Pictures: the error landscape of a sweep, mean distance (Eq. 1) over the parameter grid (§III-E), and lines.

Only this module draws with matplotlib, on its own canvas: no window, no global figure, no changed setting.
"""

from dataclasses import dataclass

import numpy as np

from doo_ti.landscape import Plane, cell_edges

PICTURE_INCHES, PICTURE_DPI = (8.0, 6.0), 200
"""1600 × 1200 pixels."""

SYMBOLS = {
    "bend": "bend α", "bend_1": "bend B₁₁", "bend_2": "bend B₂₂", "bend_12": "bend B₁₂", "twist": "twist β",
    "twist_ratio": "twist ratio β/α", "weight": "weight μ",
}
"""How the axes of the grid are written; other names stay as they are."""

_STAR, _VALLEY, _MISSING = "#ff2e63", "#fde725", "#9a9a9a"


@dataclass(frozen=True)
class Panel:
    """Lines over a common axis, log-log.

    x, y    labels of the axes, with units
    lines   name: (x values, y values), both positive; other values are left out
    growth  whether the lines are to be compared with linear growth: the slope of their later half is told, and a dashed
            line of slope one drawn through the middle of it. Otherwise they are counts and drawn as steps.
    """

    title: str
    x: str
    y: str
    lines: dict
    growth: bool = False


def panels_picture(path_or_buffer, panels: list[Panel], title: str) -> None:
    """Write panels side by side as a PNG."""
    from matplotlib.ticker import FuncFormatter, LogLocator

    width, height = PICTURE_INCHES
    figure = _figure((max(width, 5.0 * len(panels)), height))
    figure.suptitle(title, fontsize=14)
    for place, panel in enumerate(panels):
        axes = figure.add_subplot(1, len(panels), place + 1)
        axes.set(xlabel=panel.x, ylabel=panel.y, title=panel.title)
        axes.set_xscale("log", base=2)
        axes.set_yscale("log")
        for name, (x, y) in panel.lines.items():
            x, y = (np.asarray(values, float)[np.greater(x, 0) & np.greater(y, 0)] for values in (x, y))
            if panel.growth:
                _draw_growth(axes, name, x, y)
            else:
                axes.plot(x, y, linewidth=2, drawstyle="steps-mid", label=name)
        _plain_ticks(axes.yaxis, True, *axes.get_ylim())
        axes.xaxis.set_major_locator(LogLocator(base=2, numticks=9))
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.0f}"))
        axes.tick_params(labelsize=9)
        axes.grid(alpha=0.25)
        axes.legend(frameon=False)
    figure.canvas.print_png(path_or_buffer)


def _draw_growth(axes, name: str, x: np.ndarray, y: np.ndarray) -> None:
    """Points with the slope of their later half, and linear growth."""
    later = slice(len(x) // 2 if len(x) > 3 else 0, None)
    log_x, log_y = np.log(x), np.log(y)
    slope = np.polyfit(log_x[later], log_y[later], 1)[0] if len(x) > 1 else np.nan
    linear = np.exp(log_y[later].mean() + log_x - log_x[later].mean())
    axes.plot(x, y, "o-", linewidth=2, label=f"{name}, slope {slope:.2f}")
    axes.plot(x, linear, "--", color=_MISSING, linewidth=1.5, label="linear growth, slope 1")


def landscape_picture(path_or_buffer, axes, values, *, minimum, valley=None, title, label, unfinished=None) -> None:
    """Write the landscape as a 1600 × 1200 PNG.

    axes        one (name, values, is_log, unit) per grid axis; those with one value are not drawn. One free axis gives
                a line, two a map; with more the map is of the first two, over the minimum of the others
    values      (grid) mean distance in mm, NaN where not evaluated (drawn grey)
    minimum     index of the minimum, one integer per axis; None where there is none
    valley      (grid) bool, the cells to outline; default: within 5 % of the minimum
    label       what the values are, with their unit: the colour bar's label
    unfinished  (grid) number of rods that came to no certified minimum: those cells are hatched
    """
    _draw(Plane.of(axes, values, minimum, valley, unfinished), title, label).canvas.print_png(path_or_buffer)


def landscape_image(axes, values, *, minimum, valley=None, title, label, unfinished=None) -> np.ndarray:
    """The same drawing as (1200, 1600, 3) uint8."""
    canvas = _draw(Plane.of(axes, values, minimum, valley, unfinished), title, label).canvas
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def quantity(value: float, unit: str = "") -> str:
    """A value with its unit for a person: three digits, powers of ten from 10⁴ on."""
    value = float(f"{value:.2e}")
    if value == 0 or 1e-2 <= abs(value) < 1e4 or not np.isfinite(value):
        text = f"{value:.3g}"
    else:
        mantissa, exponent = f"{value:.2e}".split("e")
        power = str(int(exponent)).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
        mantissa = mantissa.rstrip("0").rstrip(".")
        text = f"10{power}" if mantissa == "1" else f"{mantissa}×10{power}"
    return f"{text} {unit}".rstrip()


def axis_label(axis) -> str:
    """Name, symbol and unit of a grid axis: ``bend α [mm³]``."""
    name, _, _, unit = axis
    return SYMBOLS.get(name, name) + (f" [{unit}]" if unit else "")


def landscape_colors(values: np.ndarray, landscape: np.ndarray) -> np.ndarray:
    """(..., 3) uint8 of ``values`` in mm, as the picture of ``landscape`` colours them; grey where NaN."""
    return _colors(_norm(landscape), values)


def distance_colors(distance: np.ndarray) -> np.ndarray:
    """(D, 3) uint8 for rods on a dark ground: teal, the smallest distance, to yellow, the largest; grey where NaN."""
    from matplotlib.colors import Normalize

    norm = _norm(distance)
    # The dark half of the map would not show: start the scale below the data.
    return _colors(Normalize(norm.vmin - 0.9 * (norm.vmax - norm.vmin), norm.vmax), distance)


def _figure(inches: tuple[float, float]):
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=inches, dpi=PICTURE_DPI, layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def _draw(landscape: Plane, title: str, label: str):
    figure = _figure(PICTURE_INCHES)
    panel = figure.add_subplot()
    if len(landscape.axes) == 2:
        keys = _draw_map(figure, panel, landscape, label)
    else:
        keys = _draw_line(panel, landscape, label)
    if landscape.hidden:
        names = ", ".join(SYMBOLS.get(name, name) for name in landscape.hidden)
        title = f"{title}\nminimum over {names}"
    if landscape.at_border:
        title = f"{title}\nminimum at the border of the grid: widen it"
    panel.set_title(title, fontsize=14, pad=12)
    panel.tick_params(labelsize=11)
    if keys:
        figure.legend(handles=keys, loc="outside lower center", ncols=1 if landscape.hidden else 2, frameon=False,
                      fontsize=10, handlelength=1.6, handletextpad=0.6, columnspacing=1.4)
    return figure


def _draw_map(figure, panel, landscape: Plane, label: str) -> list:
    """Cells in colour, valley outlined, minimum starred; returns the handles of the key."""
    from matplotlib.collections import LineCollection, PolyCollection
    from matplotlib.colors import LogNorm

    first, second = landscape.axes
    x, y = cell_edges(first), cell_edges(second)
    norm = _norm(landscape.values)
    panel.set_facecolor(_MISSING)
    mesh = panel.pcolormesh(x, y, np.ma.masked_invalid(landscape.values.T), cmap="viridis", norm=norm, rasterized=True)
    bar = figure.colorbar(mesh, ax=panel, pad=0.02, aspect=28)
    bar.set_label(label, fontsize=12)
    _plain_ticks(bar.ax.yaxis, isinstance(norm, LogNorm), norm.vmin, norm.vmax)
    bar.ax.tick_params(labelsize=11)
    hatched = landscape.unfinished > 0
    panel.add_collection(PolyCollection(
        _rectangles(x, y, hatched), facecolor=(0.6, 0.6, 0.6, 0.45), edgecolor=(0.15, 0.15, 0.15, 0.9),
        hatch="////", linewidth=0), autolim=False)
    panel.add_collection(LineCollection(
        _outline(x, y, landscape.valley), colors="white", linewidths=2.2, capstyle="projecting",
        path_effects=_edged()), autolim=False)
    if landscape.minimum is not None:
        point = (first[1][landscape.minimum[0]], second[1][landscape.minimum[1]])
        fractions = [(k + 0.5) / n for k, n in zip(landscape.minimum, landscape.values.shape, strict=True)]
        _star(panel, point, landscape.values[landscape.minimum], [1 if f < 0.5 else -1 for f in fractions])
    for axis, scale, set_scale, set_label, grid in (
            (panel.xaxis, x, panel.set_xscale, panel.set_xlabel, first),
            (panel.yaxis, y, panel.set_yscale, panel.set_ylabel, second)):
        set_scale("log" if grid[2] else "linear")
        set_label(axis_label(grid), fontsize=13)
        _plain_ticks(axis, grid[2], scale[0], scale[-1])
    panel.set_xlim(x[0], x[-1])
    panel.set_ylim(y[0], y[-1])
    return _keys(landscape)


def _draw_line(panel, landscape: Plane, label: str) -> list:
    """Distance over the one free axis; returns the handles of the key."""
    axis = landscape.axes[0]
    x, edges = np.asarray(axis[1], float), cell_edges(axis)
    values, finished = landscape.values[:, 0], landscape.unfinished[:, 0] == 0
    for left, right in zip(edges[:-1][landscape.valley[:, 0]], edges[1:][landscape.valley[:, 0]], strict=True):
        panel.axvspan(left, right, color=_VALLEY, alpha=0.35, linewidth=0)
    for left, right in zip(edges[:-1][np.isnan(values)], edges[1:][np.isnan(values)], strict=True):
        panel.axvspan(left, right, color=_MISSING, alpha=0.5, linewidth=0)
    panel.plot(x, values, color="#31688e", linewidth=2.2)
    panel.plot(x[finished], values[finished], "o", color="#31688e", markersize=7)
    panel.plot(x[~finished], values[~finished], "o", markerfacecolor="white", color=_MISSING, markersize=8)
    panel.set_xscale("log" if axis[2] else "linear")
    finite = values[np.isfinite(values)]
    if finite.size and 0 < 10 * finite.min() < finite.max():
        panel.set_yscale("log")
        _plain_ticks(panel.yaxis, True, finite.min(), finite.max())
    panel.set_xlim(edges[0], edges[-1])
    panel.margins(y=0.18)
    if landscape.minimum is not None:
        best = landscape.minimum[0]
        _star(panel, (x[best], values[best]), values[best], (0, -1))
    panel.set_xlabel(axis_label(axis), fontsize=13)
    panel.set_ylabel(label, fontsize=12)
    _plain_ticks(panel.xaxis, axis[2], edges[0], edges[-1])
    panel.grid(alpha=0.25)
    return _keys(landscape)


def _keys(landscape: Plane) -> list:
    """What the marks mean, with the counts: handles of a legend."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    line = len(landscape.axes) == 1
    keys = []
    if landscape.minimum is not None:
        where = ", ".join(f"{SYMBOLS.get(name, name).split()[-1]} = {quantity(value, unit)}"
                          for name, value, unit in landscape.best)
        keys.append(Line2D([], [], linestyle="", marker="*", markersize=14, color=_STAR, markeredgecolor="white",
                           label=f"minimum at {where}"))
        text = f"within 5 % of the minimum: {landscape.valley.sum()} of {landscape.values.size} cells"
        keys.append(Patch(facecolor=_VALLEY, alpha=0.35, label=text) if line else
                    Patch(facecolor="none", edgecolor="white", linewidth=2.2, path_effects=_edged(), label=text))
    if (count := (landscape.unfinished > 0).sum()):
        text = f"rods not certified: {landscape.unfinished.sum()} (cells: {count})"
        keys.append(Line2D([], [], linestyle="", marker="o", markerfacecolor="white", color=_MISSING, markersize=8,
                           label=text) if line else
                    Patch(facecolor="#c4c4c4", edgecolor="#262626", hatch="////", linewidth=0, label=text))
    if (count := np.isnan(landscape.values).sum()):
        keys.append(Patch(facecolor=_MISSING, alpha=0.5 if line else 1, label=f"cells not evaluated: {count}"))
    return keys


def _edged() -> list:
    """A dark rim that keeps a white line visible on any ground."""
    from matplotlib.patheffects import Normal, Stroke

    return [Stroke(linewidth=3.8, foreground="#202020"), Normal()]


def _star(panel, point, value: float, side) -> None:
    """The minimum and its value, written to the ``side`` (x, y: −1, 0 or 1) of it."""
    panel.plot(*point, "*", markersize=17, color=_STAR, markeredgecolor="white", markeredgewidth=1.2, zorder=5)
    panel.annotate(
        quantity(value, "mm"), point, xytext=(26 * side[0], 24 * side[1]), textcoords="offset points", fontsize=13,
        fontweight="bold", ha=("right", "center", "left")[side[0] + 1], va=("top", "center", "bottom")[side[1] + 1],
        bbox={"boxstyle": "round,pad=0.3", "facecolor": "white", "edgecolor": _STAR, "alpha": 0.92}, zorder=6,
        arrowprops={"arrowstyle": "-", "color": _STAR, "linewidth": 1.6, "shrinkB": 8})


def _norm(values: np.ndarray):
    """The colour scale of distances. A sweep spans decades: on a linear scale the valley would be one colour."""
    from matplotlib.colors import LogNorm, Normalize

    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
    return LogNorm(low, high) if 0 < 3 * low < high else Normalize(low, high if high > low else low + 1)


def _colors(norm, values: np.ndarray) -> np.ndarray:
    from matplotlib import colormaps
    from matplotlib.colors import to_rgba

    color_map = colormaps["viridis"].with_extremes(bad=to_rgba(_MISSING))
    return color_map(norm(np.ma.masked_invalid(values)), bytes=True)[..., :3]


def _rectangles(x: np.ndarray, y: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """(N, 4, 2) corners of the cells in ``mask`` (A, B)."""
    a, b = np.nonzero(mask)
    left, right, low, high = x[a], x[a + 1], y[b], y[b + 1]
    return np.stack([np.stack([left, right, right, left], -1), np.stack([low, low, high, high], -1)], axis=-1)


def _outline(x: np.ndarray, y: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """(N, 2, 2) the sides on which a cell in ``mask`` (A, B) has a neighbour outside it."""
    padded = np.pad(mask, 1)
    a, b = np.nonzero(padded[1:, 1:-1] != padded[:-1, 1:-1])
    upright = np.stack([np.stack([x[a], x[a]], -1), np.stack([y[b], y[b + 1]], -1)], -1)
    a, b = np.nonzero(padded[1:-1, 1:] != padded[1:-1, :-1])
    level = np.stack([np.stack([x[a], x[a + 1]], -1), np.stack([y[b], y[b]], -1)], -1)
    return np.concatenate([upright, level])


def _plain_ticks(axis, is_log: bool, low: float, high: float) -> None:
    """Ticks a person reads: plain numbers or powers of ten; at 1, 2 and 5 where a log axis is short."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    if is_log:
        decades = np.log10(high / low)
        steps = (1,) if decades > 3 else (1, 3) if decades > 1.5 else (1, 2, 5) if decades > 0.5 else range(1, 10)
        axis.set_major_locator(LogLocator(subs=steps, numticks=20))
        axis.set_minor_formatter(NullFormatter())
    axis.set_major_formatter(FuncFormatter(lambda value, _: quantity(value)))
