"""Pictures of error landscapes: one large (`landscape_picture`), or several side by side (Fig. 3, 4, 5)."""

from dataclasses import dataclass, replace

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon

from doo_ti.report import canvas
from doo_ti.report import plane as drawing
from doo_ti.report.plane import LandscapePlane


@dataclass(frozen=True)
class LandscapePanel:
    """One landscape among several, with its title.

    plane   the landscape
    marks   (text, (a, b)) of further cells to mark with circles, such as the minima of the panels beside it
    """

    title: str
    plane: LandscapePlane
    marks: tuple = ()


def landscape_picture(path_or_buffer, plane: LandscapePlane, *, title: str, region: np.ndarray | None = None,
                      newton_per_bend: float | None = None) -> None:
    """Write the landscape as a 1600 × 1200 PNG: a line over one free axis, else a map; cells without a value are grey, cells
    that do not compete hatched.

    region           (n, 2) outline of a confidence region in the units of the two axes drawn; not drawn over one axis
    newton_per_bend  EI in N m² of a rod with a bend stiffness of 1 mm³, for a second axis; None where its weight is not known
    """
    canvas.save_figure(draw_landscape(plane, title, region, newton_per_bend), path_or_buffer)


def landscapes_picture(path_or_buffer, rows: list[list[LandscapePanel]], *, title: str, marks: str = "",
                       relative: bool = False) -> None:
    """Write rows of panels as one PNG.

    marks     what the panels' marks are, for the legend
    relative  one colour scale for all maps, in multiples of each one's minimum; else each has its own, which shows more
    """
    figure, _ = draw_panels(rows, title, marks, relative)
    canvas.save_figure(figure, path_or_buffer)


def cells_image(rows: list[list[LandscapePanel]], index: tuple, *, marks: str = "",
                relative: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """The same drawing, small and without a title, as (H, W, 3) uint8, and (N, P, 4) left, top, width and height in pixels of N
    cells in each of the P panels. ``index`` holds (N,) indices per axis of the grid."""
    figure, drawn = draw_panels(rows, "", marks, relative, canvas.VIEWER_DPI)
    image = canvas.pixels(figure)
    boxes = [_cell_boxes(axes, panel.plane, panel.plane.places(index)) for axes, panel in drawn]
    return image, np.stack(boxes, axis=1)


def _cell_boxes(axes, plane: LandscapePlane, cells: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """(N, 4) left, top, width and height in pixels of the cells a and b (N,), once the figure is laid out. Over one free
    axis a cell is as high as the axes."""
    edges = [drawing.cell_edges(axis) for axis in plane.axes] + [np.array(axes.get_ylim())] * (len(plane.axes) == 1)
    low, high = (axes.transData.transform(np.stack([edge[cell + beyond] for edge, cell in zip(edges, cells, strict=True)],
                                                   axis=-1)) for beyond in (0, 1))
    return np.stack([low[:, 0], axes.figure.bbox.height - high[:, 1], *(high - low).T], axis=-1)


def draw_landscape(plane: LandscapePlane, title: str, region: np.ndarray | None = None, newton_per_bend: float | None = None):
    """The figure of one landscape, its legend below; other arguments as :func:`landscape_picture` has them."""
    figure = canvas.new_figure()
    axes = figure.add_subplot()
    _draw(figure, axes, plane, None, 1.0)
    region = region if len(plane.axes) == 2 else None
    if region is not None:
        # Closed, whether its last point is its first or not.
        axes.add_patch(Polygon(region, closed=True, fill=False, edgecolor=drawing.REGION, linewidth=2.2, linestyle="--",
                               zorder=4, path_effects=drawing.edged()))
    if plane.minimum is not None:
        drawing.label_minimum(axes, plane)
    if newton_per_bend is not None and plane.axes[0][0] in ("bend", "bend_1"):
        above = axes.secondary_xaxis("top", functions=(lambda bend: bend * newton_per_bend, lambda EI: EI / newton_per_bend))
        canvas.plain_ticks(above.xaxis, plane.axes[0][2], *axes.get_xlim())
        above.tick_params(labelsize=11)
        above.set_xlabel("EI [N m²]", fontsize=13)
    axes.set_title("\n".join([canvas.literal(title), *_remarks(plane)]), fontsize=14, pad=12)
    _put_legend(figure, [plane], 1 if plane.hidden else 2, with_region=region is not None)
    return figure


def draw_panels(rows: list[list[LandscapePanel]], title: str, marks: str, relative: bool, dpi: int = canvas.PICTURE_DPI):
    """The figure of several landscapes, and its (axes, panel) in reading order."""
    panels, columns = [panel for row in rows for panel in row], max(len(row) for row in rows)
    size, width, height = (0.9, 5.4, 4.4) if columns <= 3 else (0.75, 3.2, 3.0)
    figure = canvas.new_figure((max(width * columns, 8.0), height * len(rows) + 1.0), dpi)
    grid = figure.subplots(len(rows), columns, squeeze=False)
    relative = relative and all(len(panel.plane.axes) == 2 for panel in panels)
    norm = None
    if relative:  # one colour scale, in multiples of their minima, up to the largest of the flattest one
        multiples = [_multiples(panel.plane) for panel in panels if panel.plane.minimum is not None]
        largest = [np.max(values, where=np.isfinite(values), initial=1.0) for values in multiples]
        norm = LogNorm(1.0, max(min(largest, default=2.0), 2.0))
    drawn, meshes = [], []
    for place, axes in np.ndenumerate(grid):
        if place[1] >= len(rows[place[0]]):
            axes.set_axis_off()
            continue
        panel = rows[place[0]][place[1]]
        meshes.append(_draw_panel(figure, axes, panel, norm, size))
        drawn.append((axes, panel))
        if relative:  # over the same axes: they are labelled once, at the left and the bottom of the picture
            at_left, at_bottom = place[1] == 0, all(place[1] >= len(row) for row in rows[place[0] + 1:])
            axes.tick_params(labelleft=at_left, labelbottom=at_bottom)
            axes.set(**({} if at_left else {"ylabel": ""}), **({} if at_bottom else {"xlabel": ""}))
    if relative:
        label = canvas.MEAN_DISTANCE.rpartition(" [")[0] + ", in multiples of the panel's smallest"
        _color_bar(figure, meshes[0], grid, label, extend="max")
    figure.suptitle(canvas.literal(title), fontsize=14)
    _put_legend(figure, [panel.plane for panel in panels], 3 if columns <= 3 else 6,
                marks if any(panel.marks for panel in panels) else "")
    return figure, drawn


def _draw_panel(figure, axes, panel: LandscapePanel, norm, size: float):
    """One panel with its title; returns as :func:`_draw`."""
    plane, lines = panel.plane, [canvas.literal(panel.title)]
    mesh = _draw(figure, axes, plane, norm, size)
    if plane.minimum is not None:
        lines = [f"{lines[0]}: {canvas.quantity(plane.values[plane.minimum], 'mm')}", f"at {canvas.values_text(plane.best)}"]
    drawing.draw_marks(axes, plane, panel.marks, size)
    axes.set_title("\n".join(lines + _remarks(plane)), fontsize=12 * size)
    return mesh


def _draw(figure, axes, plane: LandscapePlane, norm, size: float):
    """A line or a map, on a colour scale of its own unless a common one, ``norm``, is given, and the minimum; returns the
    coloured mesh, None for a line."""
    mesh = None
    if len(plane.axes) == 1:
        drawing.draw_line(axes, plane, size)
    elif norm is None:
        mesh = drawing.draw_map(axes, plane, canvas.norm_of(plane.values), size)
        _color_bar(figure, mesh, axes, size=size)
    else:
        mesh = drawing.draw_map(axes, replace(plane, values=_multiples(plane)), norm, size)
    if plane.minimum is not None:
        axes.plot(*drawing.place_of(plane, plane.minimum), "*", markersize=17 * size, color=drawing.STAR,
                  markeredgecolor="white", markeredgewidth=1.2 * size, zorder=5)
    return mesh


def _multiples(plane: LandscapePlane) -> np.ndarray:
    """The values over the smallest one, in mm where that is zero."""
    least = plane.values[plane.minimum] if plane.minimum is not None else 0.0
    return plane.values / (least if least > 0 else 1.0)


def _color_bar(figure, mesh, axes, label: str = canvas.MEAN_DISTANCE, size: float = 1.0, extend: str = "neither") -> None:
    bar = figure.colorbar(mesh, ax=axes, pad=0.02, aspect=28, extend=extend)
    bar.set_label(label, fontsize=12 * size)
    bar.ax.tick_params(labelsize=11 * size)
    canvas.plain_ticks(bar.ax.yaxis, isinstance(mesh.norm, LogNorm), mesh.norm.vmin, mesh.norm.vmax)


def _remarks(plane: LandscapePlane) -> list[str]:
    """Lines for the title: axes that are not shown, and a minimum at the border."""
    hidden = ", ".join(canvas.SYMBOLS.get(name, name) for name in plane.hidden)
    return [f"minimum over {hidden}"] * bool(hidden) + ["minimum at the border of the grid: widen it"] * plane.at_border


def _put_legend(figure, planes: list[LandscapePlane], columns: int, marks: str | None = None,
                with_region: bool = False) -> None:
    """The legend below the axes, its entries in rows: matplotlib fills columns first. ``marks`` as in :func:`_legend`."""
    keys = _legend(planes, marks, with_region)
    if keys:
        rows = [key for column in range(columns) for key in keys[column::columns]]
        figure.legend(handles=rows, loc="outside lower center", ncols=min(columns, len(keys)), frameon=False, fontsize=10,
                      handlelength=1.6, handletextpad=0.6, columnspacing=1.4)


def _legend(planes: list[LandscapePlane], marks: str | None, with_region: bool) -> list:
    """Entries for the minimum, the valley, marks, cells that do not compete or have no value, the region, and the regimes of a
    ribbon with the lines between them. ``marks`` says what the panels' marks are, empty where there are none; None: of one
    landscape, with its numbers."""
    line, keys = all(len(plane.axes) == 1 for plane in planes), []
    if any(plane.minimum is not None for plane in planes):
        at = cells = ""
        if marks is None:
            at = f" at {canvas.values_text(planes[0].best)}"
            cells = f": {planes[0].valley.sum()} of {planes[0].values.size} cells"
        style = {"facecolor": drawing.VALLEY, "alpha": 0.35} if line else {
            "facecolor": "none", "edgecolor": "white", "linewidth": 2.2, "path_effects": drawing.edged()}
        keys += [_point(f"minimum{at}", marker="*", markersize=14, color=drawing.STAR, markeredgecolor="white"),
                 Patch(label=f"within 5 % of the minimum{cells}", **style)]
    if marks:
        keys.append(_point(marks, marker="o", markersize=8, markerfacecolor="white", markeredgecolor="#202020",
                           markeredgewidth=1.2))
    if rods := sum(plane.unfinished.sum() for plane in planes):
        label = f"cells not competing: {sum((plane.unfinished > 0).sum() for plane in planes)} (rods not certified: {rods})"
        keys.append(_point(label, marker="o", markerfacecolor="white", color=canvas.MISSING, markersize=8) if line else Patch(
            facecolor="#c4c4c4", edgecolor="#262626", hatch="////", linewidth=0, label=label))
    if missing := sum((np.isnan(plane.values) & (plane.unfinished == 0)).sum() for plane in planes):
        keys.append(Patch(facecolor=canvas.MISSING, alpha=0.5 if line else 1, label=f"cells not evaluated: {missing}"))
    if with_region:
        keys.append(Line2D([], [], color=drawing.REGION, linewidth=2.2, linestyle="--", path_effects=drawing.edged(),
                           label="confidence region"))
    if twists := sorted({plane.twist for plane in planes if plane.twist is not None}):
        label = f"B₁₁ = B₂₂, B₁₁ = β and B₂₂ = β, β = {', '.join(canvas.quantity(twist, 'mm³') for twist in twists)}"
        keys.append(Line2D([], [], color=drawing.BORDER, linewidth=1.4, linestyle=(0, (5, 3)), label=label))
        keys += [_point(regime, marker=f"${number}$", markersize=9, color=drawing.BORDER)
                 for number, regime in enumerate(drawing.REGIMES, 1)]
    return keys


def _point(label: str, **style):
    return Line2D([], [], linestyle="", label=label, **style)
