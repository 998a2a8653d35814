"""Pictures of rods that are brought to a target (§VI). Axes: T steps, V vertices."""

import numpy as np

from doo_ti.report.canvas import literal, new_figure, save_figure
from doo_ti.report.grid_view import upright_basis

START, TARGET, END = "#9a9a9a", "#2f7bff", "#c2410c"


def servo_picture(path_or_buffer, name: str, start: np.ndarray, end: np.ndarray, target: np.ndarray, distance: np.ndarray,
                  reached: float, up: np.ndarray) -> None:
    """Write a PNG: the true rod (V, 3) at the ``start`` and at the ``end`` and its ``target``, NaN where nothing is asked, from
    the front and from above; and its ``distance`` (T, 2) mm to the target after each step, true and as estimated."""
    figure = new_figure((9.0, 5.6))
    grid = figure.add_gridspec(2, 2, width_ratios=[1.1, 1.0])
    basis = upright_basis(np.stack([start, end]), up)
    for row, (view, label) in enumerate(((basis[[0, 2]], "from the front"), (basis[:2], "from above"))):
        axes = figure.add_subplot(grid[row, 0])
        axes.plot(*(start @ view.T).T, color=START, lw=1.6, label="start")
        axes.plot(*(target @ view.T).T, color=TARGET, lw=4.5, alpha=0.5, marker="o", ms=3, label="target")
        axes.plot(*(end @ view.T).T, color=END, lw=1.4, label="end")
        axes.set_aspect("equal", adjustable="datalim")
        axes.set_title(f"{label} [mm]", fontsize=9)
        axes.tick_params(labelsize=8)
        axes.grid(alpha=0.2)
        if not row:
            axes.legend(fontsize=8, frameon=False)
    axes = figure.add_subplot(grid[:, 1])
    steps = np.arange(1, len(distance) + 1)
    axes.plot(steps, distance[:, 0], color=END, lw=1.6, label="true")
    axes.plot(steps, distance[:, 1], color="black", lw=1.0, ls="--", label="as estimated")
    axes.axhline(reached, color=TARGET, lw=0.8, label="reached")
    axes.set_yscale("log")
    axes.set_xlabel("step")
    axes.set_title("distance to the target [mm], root mean square", fontsize=9)
    axes.legend(fontsize=8, frameon=False)
    axes.grid(alpha=0.2, which="both")
    figure.suptitle(literal(f"{name}: {len(distance)} steps"), fontsize=11)
    save_figure(figure, path_or_buffer)
