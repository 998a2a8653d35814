"""Pictures of rods in space: recovered from images, drawn over them (Fig. 6), and ribbons as bands along their material frames
(Fig. 5c); and of what data determine: maps over configurations of how strongly each informs each parameter (§V-A), and the
curves of Eq. 4 over the twist angle.
"""

from dataclasses import dataclass

import numpy as np
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import LogNorm
from matplotlib.lines import Line2D

from doo_ti.report import canvas
from doo_ti.vision.cameras import Rig

BEST, RUNNER_UP, TRUTH, DETECTED = "#2f7bff", "#ff2e4d", "#ffd400", "#00c08b"
WIDTHS = {TRUTH: 2.8, RUNNER_UP: 1.8, BEST: 1.0}  # points: curves drawn first are wider, so that they stay visible
MOST_SETS = 12  # rows of a picture
MARGIN_PX, MARGIN = 40, 0.5  # least margin of the images around what is drawn, in px and over its extent: thread may be missing
PANEL_INCHES = 3.2
VIEWS = {"from the front": (0.0, 0.0), "from the side and above": (50.0, 30.0)}
"""Views of ribbons: the angles in degrees by which the viewer moves around to the right and up."""
COLUMN_INCHES = 3.6
LIGHT = np.array([-0.45, -0.65, 0.6]) / np.linalg.norm([0.45, 0.65, 0.6])


@dataclass(frozen=True)
class SeenRod:
    """One set of images and the rods that explain them.

    name       of the set
    images     C of (H, W) uint8
    detected   C of (N, 2) px, points of the line that was found
    best       (n, 3) mm, the rod that scores best
    runner_up  (n', 3) mm, the next best that differs, or None
    truth      (n'', 3) mm, the rod as it is, or None
    verdict    how certain the best rod is, in words
    """

    name: str
    images: list[np.ndarray]
    detected: list[np.ndarray]
    best: np.ndarray
    runner_up: np.ndarray | None
    truth: np.ndarray | None
    verdict: str

    @property
    def rods(self) -> list[tuple[str, np.ndarray, str]]:
        """(name, curve, colour) of the rods that exist, in the order in which they are drawn."""
        every = (("truth", self.truth, TRUTH), ("runner-up", self.runner_up, RUNNER_UP), ("best", self.best, BEST))
        return [(name, curve, color) for name, curve, color in every if curve is not None and np.isfinite(curve).all()]


def reprojections_picture(path_or_buffer, rig: Rig, sets: list[SeenRod], *, up, left_out: int = 0) -> None:
    """Write sets as a PNG, a row each: every camera's image with the detected points and the rods' reprojections, and the rods
    in space.

    up        direction against gravity
    left_out  number of sets that are not drawn, for the title
    """
    columns = len(rig.cameras) + 1
    figure = canvas.new_figure((PANEL_INCHES * columns, 0.82 * PANEL_INCHES * len(sets) + 0.9), dpi=130)
    grid = figure.add_gridspec(len(sets), columns)
    for row, seen in enumerate(sets):
        for column, camera in enumerate(rig.cameras):
            axes = figure.add_subplot(grid[row, column])
            _draw_image(axes, camera, seen, column)
            axes.set_xlabel("u [px]" if row == len(sets) - 1 else "", fontsize=7)
            if column == 0:
                axes.set_title(f"{canvas.literal(seen.name)}: {seen.verdict}", fontsize=9, loc="left")
                axes.set_ylabel("v [px]", fontsize=7)
        _draw_space(figure.add_subplot(grid[row, -1], projection="3d"), seen, np.asarray(up, float))
    keys = [Line2D([], [], color=color, linewidth=2, label=name) for name, color in
            (("detected", DETECTED), ("best", BEST), ("runner-up", RUNNER_UP), ("truth", TRUTH))
            if name in ("detected", "best") or any(name == drawn for seen in sets for drawn, _, _ in seen.rods)]
    more = f"; {left_out} more sets are not drawn" if left_out else ""
    figure.legend(handles=keys, loc="outside lower center", ncols=len(keys), frameon=False, fontsize=10)
    canvas.save_figure(figure, path_or_buffer, f"Rods recovered from images (Alg. 1){more}", 12)


def _draw_image(axes, camera, seen: SeenRod, column: int) -> None:
    """One camera's image around the thread, with the detected points and the curves."""
    image, detected = seen.images[column], seen.detected[column]
    projected = [(camera.project(curve), color) for _, curve, color in seen.rods]
    height, width = image.shape
    axes.imshow(image, cmap="gray", vmin=0, vmax=255, interpolation="nearest")
    for pixels, color in projected:
        axes.plot(*pixels.T, color=color, linewidth=WIDTHS[color], zorder=1 if color == TRUTH else 3)
    axes.plot(*detected.T, ".", color=DETECTED, markersize=2.6, markeredgewidth=0, zorder=2)
    axes.annotate(canvas.literal(camera.name), (0.02, 0.03), xycoords="axes fraction", fontsize=8, color="white")
    around = np.concatenate([detected] + [pixels for pixels, _ in projected])
    corner = np.array([width - 0.5, height - 0.5])
    low, high = canvas.box(np.clip(around, -0.5, corner))
    margin = max(MARGIN_PX, MARGIN * float((high - low).max()))
    low, high = np.maximum(low - margin, -0.5), np.minimum(high + margin, corner)
    axes.set(xlim=(low[0], high[0]), ylim=(high[1], low[1]))
    axes.tick_params(labelsize=6, length=2, pad=1)
    axes.locator_params(nbins=5)


def _draw_space(axes, seen: SeenRod, up: np.ndarray) -> None:
    """All rods in space, gravity downwards, seen from the side of the plane in which the best one mostly lies."""
    frame = canvas.upright_basis(seen.best[None], up)
    points = np.concatenate([curve for _, curve, _ in seen.rods]) @ frame.T
    for _, curve, color in seen.rods:
        axes.plot(*(curve @ frame.T).T, color=color, linewidth=WIDTHS[color])
    axes.scatter(*(seen.best[0] @ frame.T), color="#202020", s=10)
    limits = canvas.limits_around(points, 0.525, 0.105)
    axes.set(xlim=limits[0], ylim=limits[1], zlim=limits[2])
    axes.set_box_aspect(np.ptp(limits, axis=1), zoom=0.85)
    axes.view_init(elev=18, azim=-65)
    for axis, label in ((axes.xaxis, "horizontal [mm]"), (axes.yaxis, "depth [mm]"), (axes.zaxis, "height [mm]")):
        axis.set_label_text(label, fontsize=7)
        axis.labelpad = -5
    axes.tick_params(labelsize=6, pad=-2)
    axes.locator_params(nbins=4)


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
    filled, outlined = ([kind for kind in ribbons if kind.filled == wanted] for wanted in (True, False))
    views = [_turned(*angles) @ basis for angles in VIEWS.values()]
    middles, sizes = _frames(np.stack([kind.sides[which] for kind in ribbons]), views)
    heights = COLUMN_INCHES * sizes[:, 1] / sizes[0, 0]
    figure = canvas.new_figure((COLUMN_INCHES * len(filled), heights.sum() + 1.4))
    grid = figure.subplots(len(VIEWS), len(filled), squeeze=False, height_ratios=heights)
    for places, name, view, middle, size in zip(grid, VIEWS, views, middles, sizes, strict=True):
        for axes, kind in zip(places, filled, strict=True):
            _draw_band(axes, kind.sides[which] @ view.T, kind.color)
            for other in outlined:  # the borders and the lines across them, in front of everything
                flat, shade = (other.sides[which] @ view.T)[..., [0, 2]], np.array(other.color) / 255
                axes.add_collection(LineCollection(list(flat), colors=[shade], linewidths=1.3, zorder=3))
                axes.add_collection(LineCollection(flat.swapaxes(0, 1), colors=[shade], linewidths=0.4, zorder=3))
            axes.set(xlim=middle[0] + 0.5 * size[0] * np.array([-1, 1]), ylim=middle[1] + 0.5 * size[1] * np.array([-1, 1]),
                     aspect="equal")
            axes.set_axis_off()
        first = places[0]  # with the view's name, and a scale bar of 20 mm
        left, low = first.get_xlim()[0] + 1, first.get_ylim()[0] + 2
        first.plot([left, left + 20], [low, low], color="#202020", linewidth=2)
        first.annotate("20 mm", (left + 10, low), xytext=(0, 4), textcoords="offset points", ha="center", va="bottom",
                       fontsize=9)
        first.annotate(name, (0.0, 1.0), xycoords="axes fraction", ha="left", va="top", fontsize=10, color="#606060")
    for axes, kind in zip(grid[0], filled, strict=True):
        axes.set_title(canvas.literal(kind.label), fontsize=9.5, color=np.array(kind.color) / 255)
    if outlined:
        keys = [Line2D([], [], color=np.array(kind.color) / 255, label=canvas.literal(kind.label)) for kind in outlined]
        figure.legend(handles=keys, loc="outside lower center", ncols=len(keys), frameon=False, fontsize=10)
    canvas.save_figure(figure, path_or_buffer, title, 13)


def _draw_band(axes, sides: np.ndarray, color: tuple[int, int, int]) -> None:
    """Faces between borders (2, V, 3), the far ones first, lit from the upper left."""
    low, high = sides
    faces = np.stack([low[:-1], low[1:], high[1:], high[:-1]], axis=1)
    normal = np.cross(faces[:, 2] - faces[:, 0], faces[:, 3] - faces[:, 1])
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-9)
    colors = (0.5 + 0.5 * np.abs(normal @ LIGHT))[:, None] * np.array(color) / 255
    order = np.argsort(-faces[..., 1].mean(axis=1), kind="stable")
    axes.add_collection(PolyCollection(faces[order][..., [0, 2]], facecolors=colors[order], linewidths=0.35,
                                       edgecolors=(0.08, 0.08, 0.08, 0.55)))


def _frames(points: np.ndarray, views: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Middle, and width and height in mm, of (..., 3) points in each view; all views are equally wide, at least a third of
    their heights."""
    low, high = canvas.box(np.stack([(points @ view.T)[..., [0, 2]].reshape(-1, 2) for view in views]))
    sizes = high - low + [8.0, 10.0]
    sizes[:, 0] = max(sizes[:, 0].max(), sizes[:, 1].max() / 3)
    return 0.5 * (low + high), sizes


def _turned(around: float, above: float) -> np.ndarray:
    """(3, 3) right, into and up of a viewer who moved around and up by these angles in degrees."""
    cosine, sine = np.cos(np.radians([around, above])), np.sin(np.radians([around, above]))
    right = np.array([[cosine[0], sine[0], 0], [-sine[0], cosine[0], 0], [0, 0, 1]])
    return np.array([[1, 0, 0], [0, cosine[1], -sine[1]], [0, sine[1], cosine[1]]]) @ right


# --- what data determine -------------------------------------------------------------------------------------------------

RANK = MINIMUM = "#ff2e63"
CURVE, SHADE = "#31688e", "#fde725"
MOST_CURVES = 24  # in one picture


def identifiability_picture(path_or_buffer, parameters, strength, rank, end_distance=None, end_rotation=None) -> None:
    """Write a map for each parameter as a PNG; configurations without labels are in one row, by their numbers.

    parameters  P names
    strength    (D, P) mm by which a mark moves when the parameter grows by a factor e; grey where NaN
    rank        (D,) place in the order in which to measure, from 1; 0 where it has none
    end_distance, end_rotation  (D,) mm and degrees, or None
    """
    number = np.arange(len(strength))
    labelled = None if end_distance is None or end_rotation is None else canvas.label_table(end_distance, end_rotation)
    columns, column, rows, row = labelled or (number, number, np.zeros(1), 0 * number)
    finite = strength[np.isfinite(strength) & (strength > 0)]
    low, high = (finite.min(), finite.max()) if finite.size else (1e-3, 1.0)
    # Of a parameter without any effect only rounding errors are left: the scale does not extend to these.
    norm = LogNorm(max(low, 1e-4 * high), high)
    middle = {"ha": "center", "va": "center"}
    figure = canvas.new_figure((4.6 * len(parameters) + 1.0, 1.2 + 0.45 * max(len(rows), 6)))
    panels = figure.subplots(1, len(parameters), sharey=True, squeeze=False)[0]
    for panel, name, values in zip(panels, parameters, np.asarray(strength).T, strict=True):
        table = np.full((len(rows), len(columns)), np.nan)
        table[row, column] = np.maximum(values, norm.vmin)
        panel.set_facecolor(canvas.MISSING)
        mesh = panel.pcolormesh(np.ma.masked_invalid(table), cmap="viridis", norm=norm, edgecolor="white", linewidth=0.5)
        for place in range(len(values)):
            x, y = column[place] + 0.5, row[place] + 0.5
            if np.isfinite(values[place]):
                color = "white" if norm(np.maximum(values[place], norm.vmin)) < 0.55 else "black"
                panel.text(x, y, f"{values[place]:.2g}", color=color, fontsize=8, **middle)
            if rank[place]:
                panel.plot(x - 0.33, y + 0.26, "o", markersize=11, color=RANK, markeredgecolor="white")
                panel.text(x - 0.33, y + 0.25, str(rank[place]), color="white", fontsize=7, fontweight="bold", **middle)
        panel.set_title(canvas.SYMBOLS.get(name, name), fontsize=13)
        panel.set_xticks(np.arange(len(columns)) + 0.5, [f"{value:g}" for value in columns])
        panel.set_yticks(np.arange(len(rows)) + 0.5, [f"{value:g}" for value in rows])
        panel.set_xlabel("end distance [mm]" if end_distance is not None else "configuration", fontsize=11)
    panels[0].set_ylabel("end rotation [°]" if end_rotation is not None else "", fontsize=11)
    figure.colorbar(mesh, ax=list(panels), pad=0.01, aspect=30).set_label("shift of a mark per factor e [mm]", fontsize=11)
    canvas.save_figure(figure, path_or_buffer, "Effect of each parameter in each configuration (median over the grid); red: "
                       "the order in which to measure", 13)


def angle_curves_picture(path_or_buffer, angles: np.ndarray, objective: np.ndarray, *, phi, low, high, names: list[str],
                         unsound: np.ndarray, title: str) -> None:
    """Write the curves of Eq. 4 as a PNG, a panel each, at most the first ``MOST_CURVES`` of them.

    angles     (F,) degrees, objective (K, F) mm
    phi        (K,) degrees of the minimum, NaN where there is none; low and high (K,) are the ends of the 95 % interval
    names      K titles of panels
    unsound    (K, F) rods that are no certified minima: points with any are hollow
    """
    shown = min(len(objective), MOST_CURVES)
    columns = min(4, shown)
    rows = -(-shown // columns)
    figure = canvas.new_figure((3.0 * columns + 0.6, 2.2 * rows + 0.8))
    panels = figure.subplots(rows, columns, sharex=True, squeeze=False).ravel()
    for k, axes in enumerate(panels):
        if k >= shown:
            axes.set_axis_off()
            continue
        sound = unsound[k] == 0
        axes.plot(angles, objective[k], color=CURVE, linewidth=1.4)
        axes.plot(angles[sound], objective[k][sound], "o", color=CURVE, markersize=2.5)
        axes.plot(angles[~sound], objective[k][~sound], "o", markerfacecolor="white", color=CURVE, markersize=4)
        if np.isfinite(phi[k]):
            axes.axvspan(low[k], high[k], color=SHADE, alpha=0.35, linewidth=0)
            axes.axvline(phi[k], color=MINIMUM, linewidth=1.2)
        axes.set_ylim(bottom=0)
        axes.set(xticks=np.arange(-360, 361, 180), xlim=(angles[0], angles[-1]))
        axes.tick_params(labelbottom=k + columns >= shown)  # the last row may be incomplete
        axes.set_title(canvas.literal(names[k]), fontsize=9)
        axes.grid(alpha=0.25)
    more = f"; {len(objective) - shown} more are not drawn" if len(objective) > shown else ""
    figure.supxlabel(f"φ [°]; red: the minimum, yellow: 95 % interval{more}", fontsize=10)
    figure.supylabel("Σ d [mm] (Eq. 4)", fontsize=10)
    canvas.save_figure(figure, path_or_buffer, title, 12)
