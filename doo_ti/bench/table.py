"""A summary as Markdown: one table of the cases, and below it what the figures are made of."""

import math


def text(summary: dict) -> str:
    """Markdown of a summary."""
    return "\n\n".join([machine(summary), cases(summary["cases"]), "\n".join(notes(summary))])


def machine(summary: dict) -> str:
    """One line: what the figures were measured on and with."""
    found = summary["machine"]
    made_of = ", ".join(f"{name} {number}" for name, number in summary["versions"].items())
    return (f"{found['processor']}, {_counted(found['cores'], 'core')}, {_counted(found['threads'], 'thread')}"
            f"{'' if found['architecture'] == 'cpu' else ', ' + found['architecture']}; {made_of}; "
            f"batches of {summary['rods']}, rods of 33 edges, medians of {summary['rounds']}")


def cases(found: dict[str, dict]) -> str:
    """One line per case; a dash where a figure does not apply."""
    heads = ["case", "per second", "ratio ·10⁶", "converged", "stable", "iterations", "residual", "lanes busy", "of peak"]
    return markdown(heads, [[
        name, f"{case['per_second']:,.0f} {case['unit']}", f"{1e6 * case['ratio']:.4g}", percent(case["converged"]),
        percent(case["stable"]), f"{case['iterations']:.1f}" if case["iterations"] else "–",
        given(case["residual"], "{:.0e} /mm"), percent(case["busy"]), percent(case["share_of_peak"])]
        for name, case in found.items()])


def notes(summary: dict) -> list[str]:
    """What ratio and peak are, and the accuracy."""
    accuracy, peak = summary["f32_against_f64"], summary["peak_gflops"]
    return [
        "- ratio: to the multiply-adds per second of NumPy's dot products in the same round; compare this one where other work "
        "shares the machine",
        "- of peak: operations that the kernels executed, those of idle lanes too, beside multiplications and additions in "
        "registers: " + (", ".join(f"{rate:,.0f} GFlop/s {name}" for name, rate in peak.items()) or "–"),
        f"- f32 against f64: {percent(accuracy['same_minimum'])} of {accuracy['rods']} rods in the same minimum, there "
        f"{accuracy['median_mm']:.1e} mm apart (median), {accuracy['percentile_99_mm']:.1e} mm (99th percentile)"]


def percent(share: float | None) -> str:
    """A share in per cent, rounded down: only a share of 1 is printed as 100 %."""
    return "–" if share is None else "100 %" if share == 1 else f"{math.floor(1e4 * share + 1e-6) / 100:.2f} %"


def given(value: float | None, form: str) -> str:
    """The value in a format, a dash where there is none."""
    return "–" if value is None else form.format(value)


def markdown(heads: list[str], lines: list[list[str]]) -> str:
    """A table whose columns are aligned."""
    widths = [max(map(len, column)) for column in zip(heads, *lines, strict=True)]
    rows = [heads, ["-" * width for width in widths], *lines]
    return "\n".join("| " + " | ".join(map(str.ljust, row, widths)) + " |" for row in rows)


def _counted(count: int, what: str) -> str:
    return f"{count} {what}{'s' * (count != 1)}"
