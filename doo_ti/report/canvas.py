"""What all pictures and recordings share: figures, where points lie, ticks, how values are written, and the colours of
distances."""

import os
from pathlib import Path

import numpy as np

from doo_ti.system.files import write_whole

A_POINT, ROOM = 1e-9, 1.0
"""Of the coordinates, below which a box is a point; and how wide such a box is drawn, mm."""


def box(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(..., k) lowest and highest coordinates of the finite ones among (..., N, k) points; the origin where none is finite."""
    finite = np.isfinite(points).all(axis=-1, keepdims=True)
    some = finite.any(axis=-2)
    low = np.where(finite, points, np.inf).min(axis=-2, initial=np.inf)
    high = np.where(finite, points, -np.inf).max(axis=-2, initial=-np.inf)
    return np.where(some, low, 0.0), np.where(some, high, 0.0)


def widest(low: np.ndarray, high: np.ndarray) -> float:
    """The longest side of boxes with the corners (..., k), mm; that of a point is :data:`ROOM`."""
    side = float(np.max(high - low))
    return side if side > A_POINT * float(np.max(np.maximum(np.abs(low), np.abs(high)))) else ROOM


def deviations(points: np.ndarray, axis: int = -2) -> np.ndarray:
    """Points (..., k) less the mean of the finite ones along ``axis``; zero where they are not finite."""
    finite = np.isfinite(points).all(axis=-1, keepdims=True)
    mean = np.sum(points, axis=axis, keepdims=True, where=finite) / np.maximum(finite.sum(axis=axis, keepdims=True), 1)
    return np.where(finite, points - mean, 0.0)


PICTURE_INCHES, PICTURE_DPI = (8.0, 6.0), 200
"""1600 × 1200 pixels."""
VIEWER_DPI = 80
"""Of pictures in a recording, which the viewer shows small: of larger ones it leaves pixels out."""
MEAN_DISTANCE = "mean distance (Eq. 1) [mm]"
"""What the colours and heights of a landscape are."""
SYMBOLS = {
    "bend": "bend α", "bend_1": "bend B₁₁", "bend_2": "bend B₂₂", "bend_12": "bend B₁₂", "twist": "twist β",
    "twist_ratio": "twist ratio β/α", "weight": "weight μ",
}
"""How the axes of the grid are written; other names stay as they are."""
FEW_COLORS = ((45, 212, 191), (253, 231, 37), (125, 170, 255), (255, 159, 28), (198, 120, 221), (152, 195, 121))
"""Of a few rods on a dark ground."""
SMALLEST_FONT = 4.0
MISSING = "#9a9a9a"
"""Colour where there is no distance."""


def new_figure(inches: tuple[float, float] = PICTURE_INCHES, dpi: int = PICTURE_DPI):
    """An empty figure on a canvas of its own."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=inches, dpi=dpi, layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def literal(text: str) -> str:
    """``text`` for matplotlib, which parses text between dollar signs as mathematics."""
    return text.replace("$", r"\$")


def limits_around(points: np.ndarray, half: float, least: float) -> np.ndarray:
    """(2, 2) limits to the right and up around (..., 2) points: from their middle to either side ``half`` of their extent, and
    at least the share ``least`` of the larger extent; around the origin where no point is finite."""
    low, high = box(points.reshape(-1, 2))
    middle, reach = 0.5 * (low + high), np.maximum(half * (high - low), least * widest(low, high))
    return np.stack([middle - reach, middle + reach], axis=-1)


def save_figure(figure, path_or_buffer) -> None:
    """Write a figure as a PNG, its titles as large as fit; a file appears when it is complete."""
    fit_titles(figure)
    if isinstance(path_or_buffer, (str, os.PathLike)):
        write_whole(Path(path_or_buffer), figure.canvas.print_png)
    else:
        figure.canvas.print_png(path_or_buffer)


def fit_titles(figure) -> None:
    """Make titles that reach out of the figure smaller until they fit; this also lays the figure out."""
    from matplotlib.text import Text

    figure.canvas.draw()
    width = figure.bbox.width
    for title in [*figure.texts, *(child for axes in figure.axes for child in axes.get_children() if isinstance(child, Text))]:
        box = title.get_window_extent()
        middle = 0.5 * (box.x0 + box.x1)
        room = width - box.x0 if title.get_horizontalalignment() == "left" else 2 * min(middle, width - middle)
        if title.get_text() and box.width > room > 0:
            title.set_fontsize(max(SMALLEST_FONT, 0.97 * room / box.width * title.get_fontsize()))


def pixels(figure) -> np.ndarray:
    """(H, W, 3) uint8 of a figure; this also lays it out."""
    fit_titles(figure)
    figure.canvas.draw()
    return np.asarray(figure.canvas.buffer_rgba())[..., :3].copy()


def plain_ticks(axis, is_log: bool, low: float, high: float) -> None:
    """Ticks as plain numbers or powers of ten; at 1, 2 and 5 where a log axis is short."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    if is_log:
        decades = np.log10(high / low)
        steps = (1,) if decades > 3 else (1, 3) if decades > 1.5 else (1, 2, 5) if decades > 0.5 else range(1, 10)
        axis.set_major_locator(LogLocator(subs=steps, numticks=20))
        axis.set_minor_formatter(NullFormatter())
    axis.set_major_formatter(FuncFormatter(lambda value, _: quantity(value)))


def quantity(value: float, unit: str = "") -> str:
    """A value with its unit: three digits, powers of ten from 10⁴ on."""
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


def values_text(values) -> str:
    """(name, value, unit) of several parameters in one line, by their symbols: ``α = 10⁶ mm³, β/α = 0.5``."""
    return ", ".join(f"{SYMBOLS.get(name, name).split()[-1]} = {quantity(value, unit)}" for name, value, unit in values)


def landscape_colors(values: np.ndarray, landscape: np.ndarray) -> np.ndarray:
    """(..., 3) uint8 of ``values`` in mm, as the picture of ``landscape`` colours them; grey where NaN."""
    return _colors(norm_of(landscape), values)


def distance_colors(distance: np.ndarray, scale: np.ndarray | None = None) -> np.ndarray:
    """(..., 3) uint8 for rods on a dark ground, from teal, the smallest distance of ``scale``, to yellow, the largest; grey
    where NaN. ``scale`` is by default ``distance`` itself."""
    from matplotlib.colors import LogNorm, Normalize

    norm = norm_of(distance if scale is None else scale)
    # The dark half of the map is invisible on a dark ground: the scale starts below the data.
    if isinstance(norm, LogNorm):
        norm = LogNorm(norm.vmin * (norm.vmin / norm.vmax) ** 0.9, norm.vmax)
    else:
        norm = Normalize(norm.vmin - 0.9 * (norm.vmax - norm.vmin), norm.vmax)
    return _colors(norm, distance)


def distinct_colors(count: int) -> np.ndarray:
    """(count, 3) uint8: colours on a dark ground of which no two are the same, none of them the red of failed rods."""
    from matplotlib.colors import hsv_to_rgb

    if count <= len(FEW_COLORS):
        return np.array(FEW_COLORS[:count], dtype=np.uint8)
    place = np.arange(count)
    hue = 0.1 + 0.78 * place / count
    saturation, value = np.array([(0.85, 0.95), (0.45, 1.0), (0.75, 0.65)])[place % 3].T
    return np.round(255 * hsv_to_rgb(np.stack([hue, saturation, value], axis=-1))).astype(np.uint8)


def norm_of(values: np.ndarray):
    """The colour scale of distances. A sweep spans decades: on a linear scale the valley would be one colour."""
    from matplotlib.colors import LogNorm, Normalize

    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
    return LogNorm(low, high) if 0 < 3 * low < high else Normalize(low, high if high > low else low + 1)


def _colors(norm, values: np.ndarray) -> np.ndarray:
    from matplotlib import colormaps
    from matplotlib.colors import to_rgba

    color_map = colormaps["viridis"].with_extremes(bad=to_rgba(MISSING))
    return color_map(norm(np.ma.masked_invalid(values)), bytes=True)[..., :3]
