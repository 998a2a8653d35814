"""The legend of an error landscape, and remarks for its title."""

import numpy as np

from doo_ti.report.canvas import MISSING, SYMBOLS, quantity, values_text
from doo_ti.report.landscape_axes import BORDER, REGION, STAR, VALLEY, edged
from doo_ti.report.plane import REGIMES, Plane


def key_of(plane: Plane, with_region: bool) -> list:
    """Handles of a legend for one landscape, with its numbers."""
    line, keys = len(plane.axes) == 1, []
    if plane.minimum is not None:
        keys += [_star(f"minimum at {values_text(plane.best)}"),
                 _valley(f"within 5 % of the minimum: {plane.valley.sum()} of {plane.values.size} cells", line)]
    if (count := (plane.unfinished > 0).sum()):
        keys.append(_unfinished(_not_competing(count, plane.unfinished.sum()), line))
    if (count := _not_evaluated(plane)):
        keys.append(_missing(f"cells not evaluated: {count}", line))
    return keys + _extras([plane], with_region)


def key_of_panels(planes: list[Plane], with_region: bool, marks: str) -> list:
    """Handles of a legend for several landscapes; ``marks`` says what the circles are, where there are any."""
    from matplotlib.lines import Line2D

    line, keys = all(len(plane.axes) == 1 for plane in planes), []
    if any(plane.minimum is not None for plane in planes):
        keys += [_star("minimum"), _valley("within 5 % of the minimum", line)]
    if marks:
        keys.append(Line2D([], [], linestyle="", marker="o", markersize=8, markerfacecolor="white",
                           markeredgecolor="#202020", markeredgewidth=1.2, label=marks))
    if (count := sum(plane.unfinished.sum() for plane in planes)):
        keys.append(_unfinished(_not_competing(sum((plane.unfinished > 0).sum() for plane in planes), count), line))
    if (count := sum(map(_not_evaluated, planes))):
        keys.append(_missing(f"cells not evaluated: {count}", line))
    return keys + _extras(planes, with_region)


def remarks(plane: Plane) -> list[str]:
    """Lines for the title: axes that are not shown, and a minimum at the border."""
    lines = []
    if plane.hidden:
        lines.append(f"minimum over {', '.join(SYMBOLS.get(name, name) for name in plane.hidden)}")
    if plane.at_border:
        lines.append("minimum at the border of the grid: widen it")
    return lines


def _extras(planes: list[Plane], with_region: bool) -> list:
    """The confidence region, and the regimes of a ribbon."""
    from matplotlib.lines import Line2D

    keys = []
    if with_region:
        keys.append(Line2D([], [], color=REGION, linewidth=2.2, linestyle="--", path_effects=edged(),
                           label="confidence region"))
    twists = sorted({plane.twist for plane in planes if plane.twist is not None})
    if twists:
        keys.append(Line2D([], [], color=BORDER, linewidth=1.4, linestyle=(0, (5, 3)), label="B₁₁ = B₂₂, B₁₁ = β and B₂₂ = β, "
                           f"β = {', '.join(quantity(twist, 'mm³') for twist in twists)}"))
        keys += [Line2D([], [], linestyle="", marker=f"${number}$", markersize=9, color=BORDER, label=regime)
                 for number, regime in enumerate(REGIMES, start=1)]
    return keys


def _not_evaluated(plane: Plane) -> int:
    """Number of cells without a value that were not evaluated."""
    return int((np.isnan(plane.values) & (plane.unfinished == 0)).sum())


def _not_competing(cells: int, rods: int) -> str:
    return f"cells not competing: {cells} (rods not certified: {rods})"


def _star(text: str):
    from matplotlib.lines import Line2D

    return Line2D([], [], linestyle="", marker="*", markersize=14, color=STAR, markeredgecolor="white", label=text)


def _valley(text: str, line: bool):
    from matplotlib.patches import Patch

    if line:
        return Patch(facecolor=VALLEY, alpha=0.35, label=text)
    return Patch(facecolor="none", edgecolor="white", linewidth=2.2, path_effects=edged(), label=text)


def _unfinished(text: str, line: bool):
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    if line:
        return Line2D([], [], linestyle="", marker="o", markerfacecolor="white", color=MISSING, markersize=8, label=text)
    return Patch(facecolor="#c4c4c4", edgecolor="#262626", hatch="////", linewidth=0, label=text)


def _missing(text: str, line: bool):
    from matplotlib.patches import Patch

    return Patch(facecolor=MISSING, alpha=0.5 if line else 1, label=text)
