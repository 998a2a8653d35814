"""What all pictures and recordings share: figures, where points lie, ticks, how values are written, the colours of distances,
and the grid view: observations side by side in an upright plane, because in space they overlap.

Axes: D observations, V vertices.
"""

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np
from matplotlib import colormaps
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LogNorm, Normalize, hsv_to_rgb, to_rgba
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from doo_ti.rod.observations import Observations
from doo_ti.system.arguments import short_repr, typed
from doo_ti.system.files import write_whole

A_POINT, ROOM = 1e-9, 1.0  # of the coordinates, below which a box is a point; and how wide such a box is drawn, mm


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


PICTURE_INCHES, PICTURE_DPI = (8.0, 6.0), 200  # 1600 × 1200 pixels
VIEWER_DPI = 80  # of pictures in a recording, which the viewer shows small: of larger ones it leaves pixels out
MEAN_DISTANCE = "mean distance (Eq. 1) [mm]"  # what the colours and heights of a landscape are
SYMBOLS = {
    "bend": "bend α", "bend_1": "bend B₁₁", "bend_2": "bend B₂₂", "bend_12": "bend B₁₂", "twist": "twist β",
    "twist_ratio": "twist ratio β/α", "weight": "weight μ",
}
"""How the axes of the grid are written; other names stay as they are."""
FEW_COLORS = ((45, 212, 191), (253, 231, 37), (125, 170, 255), (255, 159, 28), (198, 120, 221), (152, 195, 121))
"""Of a few rods on a dark ground."""
SMALLEST_FONT = 4.0
FILLED = 0.95  # of the width that a title has room in
MISSING = "#9a9a9a"
"""Colour where there is no distance."""


def new_figure(inches: tuple[float, float] = PICTURE_INCHES, dpi: int = PICTURE_DPI):
    """An empty figure on a canvas of its own."""
    figure = Figure(figsize=inches, dpi=dpi, layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def literal(text: str) -> str:
    """``text`` for matplotlib, which parses text between dollar signs as mathematics."""
    return text.replace("$", r"\$")


def limits_around(points: np.ndarray, half: float, least: float) -> np.ndarray:
    """(k, 2) limits around (..., k) points: from their middle to either side ``half`` of their extent, and at least the share
    ``least`` of the largest extent; around the origin where no point is finite."""
    low, high = box(points.reshape(-1, points.shape[-1]))
    middle, reach = 0.5 * (low + high), np.maximum(half * (high - low), least * widest(low, high))
    return np.stack([middle - reach, middle + reach], axis=-1)


def save_figure(figure, path_or_buffer, title: str = "", size: float = 10) -> None:
    """Write a figure, under a ``title`` in letters of that ``size``, as a PNG, its titles as large as fit; a file appears when
    it is complete."""
    if title:
        figure.suptitle(literal(title), fontsize=size)
    fit_titles(figure)
    if isinstance(path_or_buffer, (str, os.PathLike)):
        write_whole(Path(path_or_buffer), figure.canvas.print_png)
    else:
        figure.canvas.print_png(path_or_buffer)


def fit_titles(figure) -> None:
    """Make titles that fill the figure's width smaller until they fit; this also lays the figure out."""
    figure.canvas.draw()
    width = figure.bbox.width
    for title in [*figure.texts, *(child for axes in figure.axes for child in axes.get_children() if isinstance(child, Text))]:
        box = title.get_window_extent()
        middle = 0.5 * (box.x0 + box.x1)
        room = width - box.x0 if title.get_horizontalalignment() == "left" else 2 * min(middle, width - middle)
        if title.get_text() and box.width > FILLED * room > 0:
            title.set_fontsize(max(SMALLEST_FONT, 0.97 * FILLED * room / box.width * title.get_fontsize()))


def pixels(figure) -> np.ndarray:
    """(H, W, 3) uint8 of a figure; this also lays it out."""
    fit_titles(figure)
    figure.canvas.draw()
    return np.asarray(figure.canvas.buffer_rgba())[..., :3].copy()


def plain_ticks(axis, is_log: bool, low: float, high: float) -> None:
    """Ticks as plain numbers or powers of ten; at 1, 2 and 5 where a log axis is short."""
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
    return SYMBOLS.get(name, name) + f" [{unit}]" * bool(unit)


def values_text(values) -> str:
    """(name, value, unit) of several parameters in one line, by their symbols: ``α = 10⁶ mm³, β/α = 0.5``."""
    return ", ".join(f"{SYMBOLS.get(name, name).split()[-1]} = {quantity(value, unit)}" for name, value, unit in values)


def landscape_colors(values: np.ndarray, landscape: np.ndarray) -> np.ndarray:
    """(..., 3) uint8 of ``values`` in mm, as the picture of ``landscape`` colours them; grey where NaN."""
    return _colors(norm_of(landscape), values)


def distance_colors(distance: np.ndarray, scale: np.ndarray | None = None) -> np.ndarray:
    """(..., 3) uint8 for rods on a dark ground, from teal, the smallest distance of ``scale``, to yellow, the largest; grey
    where NaN. ``scale`` is by default ``distance`` itself."""
    norm = norm_of(distance if scale is None else scale)
    # The dark half of the map is invisible on a dark ground: the scale starts below the data.
    if isinstance(norm, LogNorm):
        norm = LogNorm(norm.vmin * (norm.vmin / norm.vmax) ** 0.9, norm.vmax)
    else:
        norm = Normalize(norm.vmin - 0.9 * (norm.vmax - norm.vmin), norm.vmax)
    return _colors(norm, distance)


def distinct_colors(count: int) -> np.ndarray:
    """(count, 3) uint8: colours on a dark ground of which no two are the same, none of them the red of failed rods."""
    if count <= len(FEW_COLORS):
        return np.array(FEW_COLORS[:count], dtype=np.uint8)
    place = np.arange(count)
    hue = 0.1 + 0.78 * place / count
    saturation, value = np.array([(0.85, 0.95), (0.45, 1.0), (0.75, 0.65)])[place % 3].T
    return np.round(255 * hsv_to_rgb(np.stack([hue, saturation, value], axis=-1))).astype(np.uint8)


def norm_of(values: np.ndarray):
    """The colour scale of distances. A sweep spans decades: on a linear scale the valley would be one colour."""
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
    return LogNorm(low, high) if 0 < 3 * low < high else Normalize(low, high if high > low else low + 1)


def _colors(norm, values: np.ndarray) -> np.ndarray:
    color_map = colormaps["viridis"].with_extremes(bad=to_rgba(MISSING))
    return color_map(norm(np.ma.masked_invalid(values)), bytes=True)[..., :3]


# --- the grid view -------------------------------------------------------------------------------------------------------

FLAT = 3.0  # of what is seen from above: the depth of a view from the side over its height
SLENDER = 0.1  # of the larger extent of observations: the least width of a column
UNITS = {"mm": " mm", "deg": "°"}


@typed
@dataclass(frozen=True)
class Observed:
    """Observations as recordings show them.

    vertices  (D, V, 3) mm, NaN where a mark is missing
    labels    {"end_distance_mm": (D,), "end_rotation_deg": (D,)}, those that are known: the first makes the columns of the grid
              view, the second its rows
    up        (3,) direction against gravity
    numbers   (D,) numbers or names, what the file calls the observations, or None: 0, 1, …
    """

    __repr__ = short_repr

    vertices: Annotated[np.ndarray, "D V 3"]
    labels: dict[str, np.ndarray] = field(default_factory=dict)
    up: Annotated[np.ndarray, "3"] = (0.0, 0.0, 1.0)
    numbers: np.ndarray | Sequence[str] | None = None

    @classmethod
    @typed
    def of(cls, observations: Observations) -> "Observed":
        labels = {"end_distance_mm": observations.end_distance, "end_rotation_deg": observations.end_rotation}
        return cls(np.where(observations.valid[..., None], observations.vertices, np.nan),
                   {label: values for label, values in labels.items() if values is not None}, observations.up,
                   observations.labels)

    @property
    def names(self) -> list[str]:
        """``observation 13: 42 mm 60°`` for each of the D observations."""
        numbers = range(len(self.vertices)) if self.numbers is None else self.numbers
        names = [f"observation {number}" + ":" * bool(self.labels) for number in numbers]
        for label, values in self.labels.items():
            names = [f"{name} {_quantity(label, value)}" for name, value in zip(names, values, strict=True)]
        return names


@dataclass(frozen=True)
class GridView:
    """A place for each observation and its rods in an upright plane.

    offset         (D, 3) mm, added to rod and observation: subtract it for true coordinates. The first is zero
    headings       [(text, (3,) mm)] of columns and rows
    meaning        what columns and rows are
    centre, extent (3,) mm, and (width, height) mm
    basis          (3, 3) rows right, into the plane, up
    """

    offset: np.ndarray
    headings: list
    meaning: str
    centre: np.ndarray
    extent: np.ndarray
    basis: np.ndarray


def grid_view(observed: Observed) -> GridView:
    """Places in the plane along the main horizontal direction of the observations.

    Two labels that distinguish all observations, and leave at most half of the places empty, make columns and rows, ascending
    to the right and down; else observations are in reading order.
    """
    vertices, basis = observed.vertices, upright_basis(observed.vertices, observed.up)
    local = vertices @ basis.T
    low, high = box(local)
    size = (high - low).max(axis=0)
    width = max(size[0], SLENDER * widest(low[:, [0, 2]], high[:, [0, 2]]))
    pitch = np.array([1.12 * width, 0.0, -1.1 * size[2] - 0.1 * width])
    column, row, titles, meaning = _places(observed.labels, len(vertices), abs(pitch[2]) / pitch[0])
    # Centred in its column and about the plane; its lowest point at the bottom of its row.
    anchor = np.stack([0.5 * (low + high)[:, 0], 0.5 * (low + high)[:, 1], low[:, 2]], axis=-1)
    target = np.stack([column, 0 * column, row], axis=-1) * pitch
    shift = anchor[0] - target[0]
    above, left = np.array([0.0, 0.0, size[2] - 0.55 * pitch[2]]), np.array([-0.75 * pitch[0], 0.0, 0.4 * size[2]])
    headings = [(text, (shift + (above if on_top else left) + k * pitch * ([1, 0, 0] if on_top else [0, 0, 1])) @ basis)
                for on_top, k, text in titles]
    margin = (-1.1 if titles else -0.6, 0, -1.7 if any(on_top for on_top, _, _ in titles) else -1.1)
    corners = np.array([margin, (column.max() + 0.6, 0, row.max() + 0.2)]) * pitch
    return GridView((target + shift - anchor) @ basis, headings, meaning, (corners.mean(axis=0) + shift) @ basis,
                    np.abs(corners[1] - corners[0])[[0, 2]], basis)


def upright_basis(vertices: np.ndarray, up) -> np.ndarray:
    """(3, 3) rows: the main horizontal direction of rods (D, V, 3), the direction into that plane, up."""
    up = np.asarray(up, float) / np.linalg.norm(up)
    spread = deviations(vertices)
    spread = (spread - (spread @ up)[..., None] * up).reshape(-1, 3)
    # Up is a null direction of the spread; the small term keeps it last where the marks lie on one vertical line.
    right = np.linalg.eigh(spread.T @ spread - 1e-9 * (1 + np.sum(spread**2)) * np.outer(up, up))[1][:, -1]
    right = -right if right @ np.nansum(vertices[:, -1] - vertices[:, 0], axis=0) < 0 else right
    return np.stack([right, np.cross(up, right), up])


def direction(vector: np.ndarray) -> str:
    """A unit vector as text: an axis of the world, or a sum of axes with a sign each."""
    parts = [f"{share:+.2g}{axis}" for share, axis in zip(vector, "xyz", strict=True) if abs(share) > 0.02]
    if len(parts) == 1:
        return ("−" if vector.sum() < 0 else "") + parts[0][-1]
    text = " ".join(f"{part[0]} {part[1:-1]} {part[-1]}" for part in parts)
    return (text[2:] if text[0] == "+" else text.replace("- ", "-", 1)).replace("-", "−")


def facing(vertices: np.ndarray, up) -> tuple[np.ndarray, str]:
    """What points up in a view of rods (D, V, 3), and from where that is: from the side or, if they are flat, as on a table,
    from above."""
    basis = upright_basis(vertices, up)
    _, depth, height = np.std(deviations(vertices) @ basis.T, axis=(0, 1))
    return (basis[1], "from above") if depth > FLAT * height else (basis[2], "from the side")


def label_table(first, second) -> tuple | None:
    """(columns, (D,) column of each observation, rows, (D,) row) by two labels, (D,) each; None where these do not distinguish
    all observations."""
    columns, column = np.unique(np.asarray(first, float), return_inverse=True)
    rows, row = np.unique(np.asarray(second, float), return_inverse=True)
    return (columns, column, rows, row) if len(np.unique(row * len(columns) + column)) == len(row) else None


def _places(labels: dict, count: int, aspect: float) -> tuple[np.ndarray, np.ndarray, list, str]:
    """Column and row (D,) of each observation; titles (above a column or left of a row, its number, text); what columns and
    rows are."""
    if len(labels) >= 2:
        (across, first), (down, second) = list(labels.items())[:2]
        found = label_table(first, second)
        if found and len(found[0]) * len(found[2]) <= 2 * count:
            columns, column, rows, row = found
            return (column, row, [(True, k, _quantity(across, value)) for k, value in enumerate(columns)]
                    + [(False, k, _quantity(down, value)) for k, value in enumerate(rows)],
                    f"columns: {_words(across)}, rows: {_words(down)}")
    width = min(count, int(np.ceil(np.sqrt(1.2 * count * aspect))))
    index = np.arange(count)
    titles = [(False, k, f"from {k * width}") for k in range(-(-count // width))] if count > 1 else []
    return index % width, index // width, titles, "observations in reading order" if count > 1 else ""


def _quantity(label: str, value: float) -> str:
    return f"{value:g}{UNITS.get(label.rpartition('_')[2], '')}"


def _words(label: str) -> str:
    return label.rpartition("_")[0].replace("_", " ")
