"""Errors of twist angles over many trials (Fig. 7)."""

import numpy as np

from doo_ti.report.canvas import literal, new_figure

BAR, FAILED = "#31688e", "#ff9f1c"
BIN_DEG = 15.0
LARGEST_DEG = 180.0


def angle_errors_picture(path_or_buffer, errors: dict[str, np.ndarray], *, success_deg: float, title: str) -> None:
    """Write histograms of errors as a PNG, side by side on one scale; the last bar holds all that are larger.

    errors       title of each: (N,) degrees, NaN where nothing was found, which is reported and not drawn
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
        within = f"{100 * np.mean(error <= success_deg):.1f} % within {success_deg:g}°"
        axes.set_title(f"{literal(name)}: {within}{lost}", fontsize=10)
        axes.set_xticks(np.arange(0, LARGEST_DEG + 1, 45))
        axes.grid(axis="y", alpha=0.25)
    for axes in panels[len(errors):]:
        axes.set_axis_off()
    figure.supxlabel(f"|error of φ| [°], whole turns counted; the last bar holds all above {LARGEST_DEG - BIN_DEG:g}°",
                     fontsize=10)
    figure.supylabel("share of trials [%]", fontsize=10)
    figure.suptitle(literal(title), fontsize=12)
    figure.canvas.print_png(path_or_buffer)
