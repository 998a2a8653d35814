"""What data determine: maps over configurations of how strongly each informs each parameter (§V-A), and the curves of Eq. 4
over the twist angle."""

import numpy as np

from doo_ti.report.canvas import MISSING, SYMBOLS, literal, new_figure, save_figure
from doo_ti.report.grid_view import label_table

RANK = MINIMUM = "#ff2e63"
CURVE, SHADE = "#31688e", "#fde725"
MOST_CURVES = 24
"""In one picture."""


def identifiability_picture(path_or_buffer, parameters, strength, rank, end_distance=None, end_rotation=None) -> None:
    """Write a map for each parameter as a PNG; configurations without labels are in one row, by their numbers.

    parameters  P names
    strength    (D, P) mm by which a mark moves when the parameter grows by a factor e; grey where NaN
    rank        (D,) place in the order in which to measure, from 1; 0 where it has none
    end_distance, end_rotation  (D,) mm and degrees, or None
    """
    from matplotlib.colors import LogNorm

    number = np.arange(len(strength))
    labelled = None if end_distance is None or end_rotation is None else label_table(end_distance, end_rotation)
    columns, column, rows, row = labelled or (number, number, np.zeros(1), 0 * number)
    finite = strength[np.isfinite(strength) & (strength > 0)]
    low, high = (finite.min(), finite.max()) if finite.size else (1e-3, 1.0)
    # Of a parameter without any effect only rounding errors are left: the scale does not extend to these.
    norm = LogNorm(max(low, 1e-4 * high), high)
    middle = {"ha": "center", "va": "center"}
    figure = new_figure((4.6 * len(parameters) + 1.0, 1.2 + 0.45 * max(len(rows), 6)))
    panels = figure.subplots(1, len(parameters), sharey=True, squeeze=False)[0]
    for panel, name, values in zip(panels, parameters, np.asarray(strength).T, strict=True):
        table = np.full((len(rows), len(columns)), np.nan)
        table[row, column] = np.maximum(values, norm.vmin)
        panel.set_facecolor(MISSING)
        mesh = panel.pcolormesh(np.ma.masked_invalid(table), cmap="viridis", norm=norm, edgecolor="white", linewidth=0.5)
        for place in range(len(values)):
            x, y = column[place] + 0.5, row[place] + 0.5
            if np.isfinite(values[place]):
                color = "white" if norm(np.maximum(values[place], norm.vmin)) < 0.55 else "black"
                panel.text(x, y, f"{values[place]:.2g}", color=color, fontsize=8, **middle)
            if rank[place]:
                panel.plot(x - 0.33, y + 0.26, "o", markersize=11, color=RANK, markeredgecolor="white")
                panel.text(x - 0.33, y + 0.25, str(rank[place]), color="white", fontsize=7, fontweight="bold", **middle)
        panel.set_title(SYMBOLS.get(name, name), fontsize=13)
        panel.set_xticks(np.arange(len(columns)) + 0.5, [f"{value:g}" for value in columns])
        panel.set_yticks(np.arange(len(rows)) + 0.5, [f"{value:g}" for value in rows])
        panel.set_xlabel("end distance [mm]" if end_distance is not None else "configuration", fontsize=11)
    panels[0].set_ylabel("end rotation [°]" if end_rotation is not None else "", fontsize=11)
    figure.colorbar(mesh, ax=list(panels), pad=0.01, aspect=30).set_label("shift of a mark per factor e [mm]", fontsize=11)
    figure.suptitle("Effect of each parameter in each configuration (median over the grid); red: the order in which to measure",
                    fontsize=13)
    save_figure(figure, path_or_buffer)


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
        axes.tick_params(labelbottom=k + columns >= shown)  # the last row may be incomplete
        axes.set_title(literal(names[k]), fontsize=9)
        axes.grid(alpha=0.25)
    more = f"; {len(objective) - shown} more are not drawn" if len(objective) > shown else ""
    figure.supxlabel(f"φ [°]; red: the minimum, yellow: 95 % interval{more}", fontsize=10)
    figure.supylabel("Σ d [mm] (Eq. 4)", fontsize=10)
    figure.suptitle(literal(title), fontsize=12)
    save_figure(figure, path_or_buffer)
