"""Coverage and width of intervals, and errors of the values."""

import math
from dataclasses import dataclass

import numpy as np

NAMES = ("bend", "twist", "twist_ratio")
LEAST, MOST = 0.90, 0.99
"""Between these the coverage of 95 % intervals is accepted."""
WIDE = 4.0
"""An interval whose bounds differ by more than this factor is wide."""


@dataclass(frozen=True)
class Interval:
    """The value and interval that a fit reports for one positive parameter, and its true value.

    value      None where it is not determined
    low, high  None where unbounded; a lower bound of zero or less is none for a positive quantity
    """

    truth: float
    value: float | None
    low: float | None
    high: float | None

    def __post_init__(self):
        for name in ("value", "low", "high"):
            number = getattr(self, name)
            if number is not None and not math.isfinite(number):
                object.__setattr__(self, name, None)
        if self.low is not None and self.low <= 0:
            object.__setattr__(self, "low", None)

    @property
    def holds(self) -> bool:
        """Whether the truth is inside."""
        return (self.low is None or self.low <= self.truth) and (self.high is None or self.truth <= self.high)

    @property
    def bounds(self) -> int:
        """How many sides are bounded: 2, 1 or 0."""
        return (self.low is not None) + (self.high is not None)

    @property
    def width(self) -> float:
        """The factor from the lower to the upper bound; infinite where one is missing."""
        return self.high / self.low if self.bounds == 2 else math.inf

    @property
    def log_off(self) -> float:
        """ln of value over truth; NaN where there is none."""
        return math.log(self.value / self.truth) if self.value is not None and self.value > 0 else math.nan


@dataclass(frozen=True)
class Count:
    """Number of intervals, and number of those that contain the truth."""

    held: int
    total: int

    def __str__(self) -> str:
        return f"{self.held} of {self.total}" if self.total else "none"

    @property
    def share(self) -> float:
        return self.held / self.total if self.total else math.nan


@dataclass(frozen=True)
class Coverage:
    """Of N intervals of one parameter.

    two_sided, one_sided, unbounded  disjoint, by the number of bounds
    wide         two-sided ones whose bounds differ by more than ``WIDE``
    bias         median of ln(value / truth);  off: median of its size
    width        quartiles of high / low, infinite where unbounded
    """

    all: Count
    two_sided: Count
    one_sided: Count
    unbounded: Count
    wide: Count
    bias: float
    off: float
    width: tuple[float, float, float]

    @property
    def accepted(self) -> bool:
        return LEAST <= self.all.share <= MOST


def coverage(intervals: list[Interval]) -> Coverage:
    """Counts and medians; NaN where nothing was reported."""
    def among(chosen) -> Count:
        found = [interval.holds for interval in intervals if chosen(interval)]
        return Count(sum(found), len(found))

    logs = np.array([interval.log_off for interval in intervals])
    logs = logs[np.isfinite(logs)]
    widths = np.sort([interval.width for interval in intervals])
    # An element of the sample: between a finite and an infinite width nothing can be interpolated.
    places = [round(share * (len(widths) - 1)) for share in (0.25, 0.5, 0.75)]
    return Coverage(
        all=among(lambda interval: True),
        two_sided=among(lambda interval: interval.bounds == 2),
        one_sided=among(lambda interval: interval.bounds == 1),
        unbounded=among(lambda interval: interval.bounds == 0),
        wide=among(lambda interval: interval.bounds == 2 and interval.width > WIDE),
        bias=float(np.median(logs)) if len(logs) else math.nan,
        off=float(np.median(np.abs(logs))) if len(logs) else math.nan,
        width=tuple(float(widths[place]) if len(widths) else math.nan for place in places),
    )


def wilson(count: Count) -> tuple[float, float]:
    """Wilson's 95 % interval of a share: the uncertainty of the coverage from a finite number of specimens."""
    z, n, p = 1.959964, count.total, count.share
    middle, half = p + z * z / (2 * n), z * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    return (middle - half) / (1 + z * z / n), (middle + half) / (1 + z * z / n)


HEAD = ("| parameter | truth in the 95 % interval | coverage (its own 95 % range) | bias, median value / truth "
        "| median \\|ln factor\\| off | width high / low: median (quartiles) | two-sided | wider than ×4 | one-sided "
        "| unbounded | 90–99 % |")


def table(found: dict[str, Coverage]) -> str:
    """Markdown, one line per parameter; counts are of intervals that contain the truth."""
    lines = [HEAD, "|---" * (HEAD.replace("\\|", "").count("|") - 1) + "|"]
    for name, one in found.items():
        if not one.all.total:
            lines.append(f"| {name} | not reported |" + " |" * 9)
            continue
        low, high = wilson(one.all)
        first, middle, third = map(factor, one.width)
        lines.append(
            f"| {name} | {one.all} | {one.all.share:.1%} ({low:.0%} … {high:.0%}) | {factor(math.exp(one.bias))} "
            f"| {one.off:.3g} ({factor(math.exp(one.off))}) | {middle} ({first} … {third}) | {one.two_sided} | {one.wide} "
            f"| {one.one_sided} | {one.unbounded} | {'yes' if one.accepted else '**no**'} |")
    return "\n".join(lines)


def factor(number: float) -> str:
    return "none" if math.isnan(number) else "unbounded" if math.isinf(number) else f"×{number:.3g}"
