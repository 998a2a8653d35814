"""Rods on their way: some moments of a motion, one over the other (§III-D)."""

import numpy as np

from doo_ti.report.canvas import literal, new_figure

MOST_RODS, COLUMNS = 12, 4
SHOWN = 9
"""Moments of each rod, evenly chosen."""


def motions_picture(path_or_buffer, time: np.ndarray, vertices: np.ndarray, names: list[str], jumps: np.ndarray, *, up,
                    title: str) -> None:
    """Write the motions of R rods as a PNG, at most the first ``MOST_RODS``, ``COLUMNS`` beside each other: each from the front
    and below that from above.

    time      (T,) s, early moments dark
    vertices  (T, R, V, 3) mm, NaN where a rod came to nothing
    jumps     (T, R) falls: the shapes before one, dashed, and after it are drawn thick and red
    up        direction against gravity
    """
    shown = min(len(names), MOST_RODS)
    moments = np.unique(np.linspace(0, len(time) - 1, SHOWN).round().astype(int))
    views = _views(vertices[:, :shown], np.asarray(up, float))
    limits = [_limits(vertices[:, :shown] @ view.T) for view in views]
    heights = [np.ptp(limit[1]) / np.ptp(limit[0]) for limit in limits]
    columns, blocks = min(shown, COLUMNS), -(-shown // COLUMNS)
    figure = new_figure((3.4 * columns + 0.8, blocks * (3.2 * sum(heights) + 0.8) + 0.8))
    panels = figure.subplots(2 * blocks, columns, squeeze=False, height_ratios=blocks * heights)
    for rod in range(columns * blocks):
        block, column = divmod(rod, columns)
        for row, (view, label) in enumerate(zip(views, ("from the front", "from above"), strict=True)):
            axes = panels[2 * block + row, column]
            if rod >= shown:
                axes.set_axis_off()
                continue
            axes.set(xlim=limits[row][0], ylim=limits[row][1])
            _draw(axes, vertices[:, rod] @ view.T, time, moments, np.flatnonzero(jumps[:, rod]))
            axes.set_aspect("equal")
            axes.grid(alpha=0.2)
            if column == 0:
                axes.set_ylabel(f"{label} [mm]", fontsize=10)
            if row == 0:
                falls = int(jumps[:, rod].sum())
                axes.set_title(literal(names[rod]) + f": {falls} fall{'s' * (falls != 1)}" * (falls > 0), fontsize=10)
    figure.supxlabel("along the line between the ends [mm]", fontsize=10)
    figure.colorbar(_scale(time), ax=list(panels.ravel()), pad=0.01, aspect=40).set_label("time [s]", fontsize=10)
    more = f" ({len(names) - shown} more are not drawn)" if len(names) > shown else ""
    red = "; red: before a fall (dashed) and after it" if jumps[:, :shown].any() else ""
    figure.suptitle(f"{literal(title)}{more}{red}", fontsize=12)
    figure.canvas.print_png(path_or_buffer)


def _draw(axes, flat: np.ndarray, time: np.ndarray, moments: np.ndarray, falls: np.ndarray) -> None:
    """Shapes (T, V, 2) at some moments, and around falls."""
    scale = _scale(time)
    for moment in moments:
        axes.plot(*flat[moment].T, color=scale.to_rgba(time[moment]), linewidth=1.4)
    for moment in falls:
        axes.plot(*flat[max(moment - 1, 0)].T, "--", color="#ff2e63", linewidth=1.8)
        axes.plot(*flat[moment].T, color="#ff2e63", linewidth=1.8)


def _limits(flat: np.ndarray) -> np.ndarray:
    """(2, 2) what is seen to the right and up, mm, of (..., 2) points: at least a third as high as wide."""
    low, high = (edge(flat.reshape(-1, 2), axis=0) for edge in (np.nanmin, np.nanmax))
    half = 0.5 * (high - low) + 3.0
    half[1] = max(half[1], half[0] / 3)
    middle = 0.5 * (low + high)
    return np.stack([middle - half, middle + half], axis=-1)


def _scale(time: np.ndarray):
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    return ScalarMappable(Normalize(time[0], time[-1]), colormaps["viridis"])


def _views(vertices: np.ndarray, up: np.ndarray) -> list[np.ndarray]:
    """(2, 3) right and up from the front, and right and back from above: right is along the mean line between the ends."""
    up = up / np.linalg.norm(up)
    chord = np.nanmean(vertices[..., -1, :] - vertices[..., 0, :], axis=(0, 1))
    right = chord - (chord @ up) * up
    if not np.linalg.norm(right) > 1e-6 * (np.linalg.norm(chord) + 1e-9):
        right = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    right /= np.linalg.norm(right)
    return [np.stack([right, up]), np.stack([right, np.cross(up, right)])]
