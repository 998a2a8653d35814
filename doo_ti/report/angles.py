"""The curves of Eq. 4 over the twist angle."""

import numpy as np

from doo_ti.report.canvas import literal, new_figure

MINIMUM, CURVE, SHADE = "#ff2e63", "#31688e", "#fde725"
MOST_CURVES = 24
"""In one picture."""


def angle_curves_picture(path_or_buffer, angles: np.ndarray, objective: np.ndarray, *, phi, low, high, names: list[str],
                         unsound: np.ndarray, title: str) -> None:
    """Write the curves of Eq. 4 as a PNG, a panel each, at most the first ``MOST_CURVES`` of them.

    angles     (F,) degrees, objective (K, F) mm
    phi        (K,) degrees of the minimum, NaN where there is none; low and high (K,) of what is nearly as good
    names      K titles of panels
    unsound    (K, F) rods that came to no certified minimum: hollow where there are any
    """
    shown = min(len(objective), MOST_CURVES)
    columns = min(4, shown)
    rows = -(-shown // columns)
    figure = new_figure((3.0 * columns + 0.6, 2.2 * rows + 0.8))
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
        axes.set_xticks(np.arange(-360, 361, 180))
        axes.set_xlim(angles[0], angles[-1])
        axes.tick_params(labelbottom=k + columns >= shown)  # the last row may be short
        axes.set_title(literal(names[k]), fontsize=9)
        axes.grid(alpha=0.25)
    more = f"; {len(objective) - shown} more are not drawn" if len(objective) > shown else ""
    figure.supxlabel(f"φ [°]; red: the minimum, yellow: nearly as good{more}", fontsize=10)
    figure.supylabel("Σ d [mm] (Eq. 4)", fontsize=10)
    figure.suptitle(literal(title), fontsize=12)
    figure.canvas.print_png(path_or_buffer)
