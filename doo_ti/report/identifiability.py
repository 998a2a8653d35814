"""How strongly each configuration informs each parameter: a map over end distances and rotations per parameter (§V-A)."""

import numpy as np

from doo_ti.report.canvas import new_figure
from doo_ti.report.quantities import SYMBOLS

_RANK = "#ff2e63"


def identifiability_picture(path_or_buffer, parameters, strength, rank, end_distance=None, end_rotation=None) -> None:
    """Write the maps as a PNG; configurations without labels stand in one row, by their numbers.

    parameters  P names
    strength    (D, P) mm by which a mark moves when the parameter grows by a factor e; grey where NaN
    rank        (D,) place in the order in which to measure, from 1; 0 where it has none
    end_distance, end_rotation  (D,) mm and degrees, or None
    """
    from matplotlib.colors import LogNorm

    columns, column, rows, row = _places(len(strength), end_distance, end_rotation)
    finite = strength[np.isfinite(strength) & (strength > 0)]
    low, high = (finite.min(), finite.max()) if finite.size else (1e-3, 1.0)
    # Where a parameter does nothing at all the scale must not stretch to rounding.
    norm = LogNorm(max(low, 1e-4 * high), high)
    middle = {"ha": "center", "va": "center"}
    figure = new_figure((4.6 * len(parameters) + 1.0, 1.2 + 0.45 * max(len(rows), 6)))
    panels = figure.subplots(1, len(parameters), sharey=True, squeeze=False)[0]
    for panel, name, values in zip(panels, parameters, np.asarray(strength).T, strict=True):
        table = np.full((len(rows), len(columns)), np.nan)
        table[row, column] = np.maximum(values, norm.vmin)
        panel.set_facecolor("#9a9a9a")
        mesh = panel.pcolormesh(np.ma.masked_invalid(table), cmap="viridis", norm=norm, edgecolor="white", linewidth=0.5)
        for place in range(len(values)):
            x, y = column[place] + 0.5, row[place] + 0.5
            if np.isfinite(values[place]):
                color = "white" if norm(np.maximum(values[place], norm.vmin)) < 0.55 else "black"
                panel.text(x, y, f"{values[place]:.2g}", color=color, fontsize=8, **middle)
            if rank[place]:
                panel.plot(x - 0.33, y + 0.26, "o", markersize=11, color=_RANK, markeredgecolor="white")
                panel.text(x - 0.33, y + 0.25, str(rank[place]), color="white", fontsize=7, fontweight="bold", **middle)
        panel.set_title(SYMBOLS.get(name, name), fontsize=13)
        panel.set_xticks(np.arange(len(columns)) + 0.5, [f"{value:g}" for value in columns])
        panel.set_yticks(np.arange(len(rows)) + 0.5, [f"{value:g}" for value in rows])
        panel.set_xlabel("end distance [mm]" if end_distance is not None else "configuration", fontsize=11)
    panels[0].set_ylabel("end rotation [°]" if end_rotation is not None else "", fontsize=11)
    figure.colorbar(mesh, ax=list(panels), pad=0.01, aspect=30).set_label("shift of a mark per factor e [mm]", fontsize=11)
    figure.suptitle("What each configuration tells (median over the grid); red: the order in which to measure", fontsize=13)
    figure.canvas.print_png(path_or_buffer)


def _places(count: int, end_distance, end_rotation):
    """(columns, (D,) column of each configuration, rows, (D,) row): by their labels where these tell all of them apart."""
    number = np.arange(count)
    if end_distance is not None and end_rotation is not None:
        columns, column = np.unique(end_distance, return_inverse=True)
        rows, row = np.unique(end_rotation, return_inverse=True)
        if len(np.unique(row * len(columns) + column)) == count:
            return columns, column, rows, row
    return number, number, np.zeros(1), np.zeros(count, dtype=np.int64)
