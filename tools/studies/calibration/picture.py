"""Intervals over the truth, specimen by specimen, and histograms of their widths."""

import numpy as np

from doo_ti.report.canvas import new_figure
from tools.studies.calibration.coverage import Interval

HELD, MISSED = "#3b75af", "#d1342f"
LARGEST = (30.0, 3.0, 1.2, 1.05)
"""The axes end at the smallest factor from the truth that contains nine tenths of all bounds; other bounds are drawn at the
ends of the axes."""
BINS = 24
TICKS = {30.0: (0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20), 3.0: (0.5, 0.7, 1, 1.5, 2), 1.2: (0.85, 0.9, 1, 1.1, 1.2),
         1.05: (0.96, 0.98, 1, 1.02, 1.04)}


def calibration_picture(path_or_buffer, intervals: dict[str, list[Interval]], *, title: str) -> None:
    """Write a PNG: for each parameter its intervals over the truth, sorted, and a histogram of their widths."""
    figure = new_figure((12.0, 3.2 * len(intervals) + 0.8), dpi=120)
    panels = figure.subplots(len(intervals), 2, squeeze=False, width_ratios=(3, 1))
    for (left, right), (name, found) in zip(panels, intervals.items(), strict=True):
        largest = _largest(found)
        _draw_intervals(left, name, found, largest)
        _draw_widths(right, found, largest)
    panels[-1][0].set_xlabel("specimens, sorted by value / truth")
    panels[-1][1].set_xlabel("width of the interval, high / low")
    figure.suptitle(title, fontsize=12)
    figure.canvas.print_png(path_or_buffer)


def _largest(found: list[Interval]) -> float:
    """The factor from the truth at which the axes end."""
    ends = [np.inf if end is None else abs(np.log(end / one.truth)) for one in found for end in (one.low, one.high)]
    fitting = [factor for factor in LARGEST if np.mean(np.array(ends) <= np.log(factor)) >= 0.9]
    return min(fitting, default=LARGEST[0])


def _draw_intervals(axes, name: str, found: list[Interval], largest: float) -> None:
    found = sorted(found, key=lambda one: one.log_off if np.isfinite(one.log_off) else np.inf)
    for place, one in enumerate(found):
        color = HELD if one.holds else MISSED
        low, high, value = (None if number is None else np.clip(number / one.truth, 1 / largest, largest)
                            for number in (one.low, one.high, one.value))
        axes.plot([place, place], [low or 1 / largest, high or largest], color=color, linewidth=1.6, alpha=0.8)
        for bound, end, marker in ((low, 1 / largest, "v"), (high, largest, "^")):
            if bound is None:
                axes.plot(place, end, marker=marker, color=color, markersize=4, clip_on=False)
        if value is not None:
            axes.plot(place, value, "o", color=color, markersize=3)
    axes.axhline(1.0, color="#404040", linewidth=1)
    axes.set_yscale("log")
    axes.set_ylim(1 / largest, largest)
    ticks = TICKS[largest]
    axes.set_yticks(ticks, [f"{tick:g}" for tick in ticks], minor=False)
    axes.minorticks_off()
    axes.set_xlim(-1, len(found))
    axes.grid(axis="y", alpha=0.25)
    held = sum(one.holds for one in found)
    axes.set_title(f"{name.replace('_', ' ')}: the truth is in {held} of {len(found)} intervals; those that miss it are red, "
                   "arrows have no bound", fontsize=10)
    axes.set_ylabel("interval / truth")


def _draw_widths(axes, found: list[Interval], largest: float) -> None:
    widths = np.array([one.width for one in found])
    bins = np.geomspace(1.0, 100.0 if largest == LARGEST[0] else largest**2, BINS + 1)
    bounded = np.minimum(widths[np.isfinite(widths)], bins[-1] * (1 - 1e-9))
    axes.hist(bounded, bins, color=HELD, edgecolor="white", linewidth=0.6)
    axes.set_xscale("log")
    ticks = [1, 2, 4, 10, 30, 100] if largest == LARGEST[0] else np.geomspace(1, bins[-1], 4)
    axes.set_xticks(ticks, [f"×{tick:.3g}" for tick in ticks], minor=False)
    axes.minorticks_off()
    open_ended = len(widths) - len(bounded)
    axes.set_title(f"widths; {open_ended} one-sided or unbounded" if open_ended else "widths", fontsize=10)
    axes.set_ylabel("specimens")
    axes.grid(axis="y", alpha=0.25)
