"""Rods recovered from images, drawn over them and in space (Fig. 6)."""

from dataclasses import dataclass

import numpy as np

from doo_ti.report.canvas import box, literal, new_figure, save_figure, widest
from doo_ti.report.grid_view import upright_basis
from doo_ti.vision.cameras.rig import Rig

BEST, RUNNER_UP, TRUTH, DETECTED = "#2f7bff", "#ff2e4d", "#ffd400", "#00c08b"
WIDTHS = {TRUTH: 2.8, RUNNER_UP: 1.8, BEST: 1.0}
"""Points: curves drawn first are wider, so that they stay visible."""
MOST_SETS = 12
"""Rows of a picture."""
MARGIN_PX = 40
"""Margin of the images around the drawn curves."""
PANEL_INCHES = 3.2


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
    from matplotlib.lines import Line2D

    columns = len(rig.cameras) + 1
    figure = new_figure((PANEL_INCHES * columns, 0.82 * PANEL_INCHES * len(sets) + 0.9), dpi=130)
    grid = figure.add_gridspec(len(sets), columns)
    for row, seen in enumerate(sets):
        for column, camera in enumerate(rig.cameras):
            axes = figure.add_subplot(grid[row, column])
            _draw_image(axes, camera, seen, column)
            if column == 0:
                axes.set_title(f"{literal(seen.name)}: {seen.verdict}", fontsize=9, loc="left")
                axes.set_ylabel("v [px]", fontsize=7)
            if row == len(sets) - 1:
                axes.set_xlabel("u [px]", fontsize=7)
        _draw_space(figure.add_subplot(grid[row, -1], projection="3d"), seen, np.asarray(up, float))
    keys = [Line2D([], [], color=color, linewidth=2, label=name) for name, color in
            (("detected", DETECTED), ("best", BEST), ("runner-up", RUNNER_UP), ("truth", TRUTH))
            if name in ("detected", "best") or any(name == drawn for seen in sets for drawn, _, _ in seen.rods)]
    more = f"; {left_out} more sets are not drawn" if left_out else ""
    figure.legend(handles=keys, loc="outside lower center", ncols=len(keys), frameon=False, fontsize=10)
    figure.suptitle(f"Rods recovered from images (Alg. 1){more}", fontsize=12)
    save_figure(figure, path_or_buffer)


def _draw_image(axes, camera, seen: SeenRod, column: int) -> None:
    """One camera's image around the thread, with the detected points and the curves."""
    image, detected = seen.images[column], seen.detected[column]
    projected = [(camera.project(curve), color) for _, curve, color in seen.rods]
    height, width = image.shape
    axes.imshow(image, cmap="gray", vmin=0, vmax=255, interpolation="nearest")
    for pixels, color in projected:
        axes.plot(*pixels.T, color=color, linewidth=WIDTHS[color], zorder=1 if color == TRUTH else 3)
    axes.plot(*detected.T, ".", color=DETECTED, markersize=2.6, markeredgewidth=0, zorder=2)
    axes.annotate(literal(camera.name), (0.02, 0.03), xycoords="axes fraction", fontsize=8, color="white")
    around = np.concatenate([detected] + [pixels for pixels, _ in projected])
    corner = np.array([width - 0.5, height - 0.5])
    low, high = box(np.clip(around, -0.5, corner))
    low, high = np.maximum(low - MARGIN_PX, -0.5), np.minimum(high + MARGIN_PX, corner)
    axes.set(xlim=(low[0], high[0]), ylim=(high[1], low[1]))
    axes.tick_params(labelsize=6, length=2, pad=1)
    axes.locator_params(nbins=5)


def _draw_space(axes, seen: SeenRod, up: np.ndarray) -> None:
    """All rods in space, gravity downwards, seen from the side of the plane in which the best one mostly lies."""
    frame = upright_basis(seen.best[None], up)
    points = np.concatenate([curve for _, curve, _ in seen.rods]) @ frame.T
    for _, curve, color in seen.rods:
        axes.plot(*(curve @ frame.T).T, color=color, linewidth=WIDTHS[color])
    axes.scatter(*(seen.best[0] @ frame.T), color="#202020", s=10)
    low, high = box(points)
    half = 0.5 * np.maximum(high - low, 0.2 * widest(low, high)) * 1.05
    middle = 0.5 * (low + high)
    axes.set(xlim=(middle[0] - half[0], middle[0] + half[0]), ylim=(middle[1] - half[1], middle[1] + half[1]),
             zlim=(middle[2] - half[2], middle[2] + half[2]))
    axes.set_box_aspect(half, zoom=0.85)
    axes.view_init(elev=18, azim=-65)
    for axis, label in ((axes.xaxis, "horizontal [mm]"), (axes.yaxis, "depth [mm]"), (axes.zaxis, "height [mm]")):
        axis.set_label_text(label, fontsize=7)
        axis.labelpad = -5
    axes.tick_params(labelsize=6, pad=-2)
    axes.locator_params(nbins=4)
