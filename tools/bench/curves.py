"""Lines over a common axis, log-log, side by side."""

from dataclasses import dataclass

import numpy as np

from doo_ti.report.canvas import MISSING, PICTURE_INCHES, literal, new_figure, plain_ticks


@dataclass(frozen=True)
class Panel:
    """Lines over a common axis, log-log.

    x, y    labels of the axes, with units
    lines   name: (x values, y values), both positive; other values are left out
    growth  True: compare the lines with linear growth: the slope of their later half is printed, and a dashed line of
            slope one is drawn through the middle of it. False: the lines are counts, drawn as steps.
    """

    title: str
    x: str
    y: str
    lines: dict
    growth: bool = False


def panels_picture(path_or_buffer, panels: list[Panel], title: str) -> None:
    """Write panels side by side as a PNG."""
    from matplotlib.ticker import FuncFormatter, LogLocator

    width, height = PICTURE_INCHES
    figure = new_figure((max(width, 5.0 * len(panels)), height))
    figure.suptitle(literal(title), fontsize=14)
    for place, panel in enumerate(panels):
        axes = figure.add_subplot(1, len(panels), place + 1)
        axes.set(xlabel=panel.x, ylabel=panel.y, title=literal(panel.title))
        axes.set_xscale("log", base=2)
        axes.set_yscale("log")
        for name, (x, y) in panel.lines.items():
            x, y = (np.asarray(values, float)[np.greater(x, 0) & np.greater(y, 0)] for values in (x, y))
            if panel.growth:
                _draw_growth(axes, name, x, y)
            else:
                axes.plot(x, y, linewidth=2, drawstyle="steps-mid", label=literal(name))
        plain_ticks(axes.yaxis, True, *axes.get_ylim())
        axes.xaxis.set_major_locator(LogLocator(base=2, numticks=9))
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.0f}"))
        axes.tick_params(labelsize=9)
        axes.grid(alpha=0.25)
        axes.legend(frameon=False)
    figure.canvas.print_png(path_or_buffer)


def _draw_growth(axes, name: str, x: np.ndarray, y: np.ndarray) -> None:
    """Points with the slope of their later half, and linear growth."""
    later = slice(len(x) // 2 if len(x) > 3 else 0, None)
    log_x, log_y = np.log(x), np.log(y)
    slope = np.polyfit(log_x[later], log_y[later], 1)[0] if len(x) > 1 else np.nan
    linear = np.exp(log_y[later].mean() + log_x - log_x[later].mean())
    axes.plot(x, y, "o-", linewidth=2, label=f"{literal(name)}, slope {slope:.2f}")
    axes.plot(x, linear, "--", color=MISSING, linewidth=1.5, label="linear growth, slope 1")
