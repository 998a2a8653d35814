"""Intervals over the truth, specimen by specimen, and how wide they are."""

import numpy as np

from doo_ti.report.canvas import new_figure
from tools.calibration.coverage import Interval

HELD, MISSED = "#3b75af", "#d1342f"
LARGEST = 30.0
"""The axes end at this factor from the truth; what lies beyond is drawn at their ends."""
WIDTHS = np.geomspace(1.0, 100.0, 25)


def calibration_picture(path_or_buffer, intervals: dict[str, list[Interval]], *, title: str) -> None:
    """Write a PNG: for each parameter its intervals over the truth, sorted, and a histogram of their widths."""
    figure = new_figure((12.0, 3.2 * len(intervals) + 0.8), dpi=120)
    panels = figure.subplots(len(intervals), 2, squeeze=False, width_ratios=(3, 1))
    for (left, right), (name, found) in zip(panels, intervals.items(), strict=True):
        _draw_intervals(left, name, found)
        _draw_widths(right, found)
    panels[-1][0].set_xlabel("specimens, sorted by value / truth")
    panels[-1][1].set_xlabel("width of the interval, high / low")
    figure.suptitle(title, fontsize=12)
    figure.canvas.print_png(path_or_buffer)


def _draw_intervals(axes, name: str, found: list[Interval]) -> None:
    found = sorted(found, key=lambda one: one.log_off if np.isfinite(one.log_off) else np.inf)
    for place, one in enumerate(found):
        color = HELD if one.holds else MISSED
        low, high, value = (None if number is None else np.clip(number / one.truth, 1 / LARGEST, LARGEST)
                            for number in (one.low, one.high, one.value))
        axes.plot([place, place], [low or 1 / LARGEST, high or LARGEST], color=color, linewidth=1.6, alpha=0.8)
        for bound, end, marker in ((low, 1 / LARGEST, "v"), (high, LARGEST, "^")):
            if bound is None:
                axes.plot(place, end, marker=marker, color=color, markersize=4, clip_on=False)
        if value is not None:
            axes.plot(place, value, "o", color=color, markersize=3)
    axes.axhline(1.0, color="#404040", linewidth=1)
    axes.set_yscale("log")
    axes.set_ylim(1 / LARGEST, LARGEST)
    ticks = [0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20]
    axes.set_yticks(ticks, [f"{tick:g}" for tick in ticks], minor=False)
    axes.minorticks_off()
    axes.set_xlim(-1, len(found))
    axes.grid(axis="y", alpha=0.25)
    held = sum(one.holds for one in found)
    axes.set_title(f"{name.replace('_', ' ')}: the truth is in {held} of {len(found)} intervals; those that miss it are red, "
                   "arrows have no bound", fontsize=10)
    axes.set_ylabel("interval / truth")


def _draw_widths(axes, found: list[Interval]) -> None:
    widths = np.array([one.width for one in found])
    bounded = np.minimum(widths[np.isfinite(widths)], WIDTHS[-1] * (1 - 1e-9))
    axes.hist(bounded, WIDTHS, color=HELD, edgecolor="white", linewidth=0.6)
    axes.set_xscale("log")
    ticks = [1, 2, 4, 10, 30, 100]
    axes.set_xticks(ticks, [f"×{tick}" for tick in ticks], minor=False)
    axes.minorticks_off()
    open_ended = len(widths) - len(bounded)
    axes.set_title(f"widths; {open_ended} one-sided or unbounded" if open_ended else "widths", fontsize=10)
    axes.set_ylabel("specimens")
    axes.grid(axis="y", alpha=0.25)
