"""Twist angles: how far off they are over many trials (Fig. 7), and the curves of Eq. 4 they come from."""

import numpy as np

from doo_ti.report.canvas import literal, new_figure

BAR, FAILED, MINIMUM, CURVE, SHADE = "#31688e", "#ff9f1c", "#ff2e63", "#31688e", "#fde725"
BIN_DEG = 15.0
LARGEST_DEG = 180.0
MOST_CURVES = 24
"""In one picture."""


def angle_errors_picture(path_or_buffer, errors: dict[str, np.ndarray], *, success_deg: float, title: str) -> None:
    """Write histograms of errors as a PNG, side by side on one scale; the last bar holds all that are larger.

    errors       title of each: (N,) degrees, NaN where nothing was found, which is told and not drawn
    success_deg  up to which an error counts as success: the bars beyond have another colour
    """
    edges = np.arange(0.0, LARGEST_DEG + BIN_DEG, BIN_DEG)
    columns = min(3, len(errors))
    rows = -(-len(errors) // columns)
    figure = new_figure((3.2 * columns + 0.6, 2.4 * rows + 0.8))
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    for axes, (name, error) in zip(panels, errors.items(), strict=False):
        found = error[np.isfinite(error)]
        share = np.histogram(np.minimum(found, LARGEST_DEG - 1e-9), edges)[0] / max(len(error), 1)
        colors = [BAR if edge < success_deg - 1e-9 else FAILED for edge in edges[:-1]]
        axes.bar(edges[:-1], 100 * share, width=BIN_DEG, align="edge", color=colors, edgecolor="white", linewidth=0.6)
        axes.axvline(success_deg, color="#606060", linewidth=1, linestyle="--")
        lost = f", {len(error) - len(found)} undetermined" if len(found) < len(error) else ""
        axes.set_title(f"{literal(name)}: {100 * np.mean(error <= success_deg):.1f} % within {success_deg:g}°{lost}", fontsize=10)
        axes.set_xticks(np.arange(0, LARGEST_DEG + 1, 45))
        axes.grid(axis="y", alpha=0.25)
    for axes in panels[len(errors):]:
        axes.set_axis_off()
    figure.supxlabel(f"|error of φ| [°], whole turns counted; the last bar holds all above {LARGEST_DEG - BIN_DEG:g}°",
                     fontsize=10)
    figure.supylabel("share of trials [%]", fontsize=10)
    figure.suptitle(literal(title), fontsize=12)
    figure.canvas.print_png(path_or_buffer)


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
