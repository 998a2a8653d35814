"""What ``doo-ti bench`` measures, step by step, in one dictionary, what ``bench.json`` holds; and as Markdown: a table of the
cases, and below it what the figures are made of."""

import math
from collections.abc import Callable
from dataclasses import asdict

import numpy as np

from doo_ti.bench import clock
from doo_ti.bench.cases import FINE, Case, Specimens, measure
from doo_ti.bench.clock import peak_gflops
from doo_ti.system import runtime
from doo_ti.system.terminal import progress

COMPARED = 4096  # rods whose shape in f32 is compared with f64's
SAME_MM = 0.02
"""Two rods are in the same minimum where the mean distance between their vertices is no more than this."""
Step = tuple[str, Callable[[dict], str]]
"""A name, and what enters its figures in the summary and returns them in a few words, for the progress."""


def begun(rods: Specimens, rounds: int, threads: int | None) -> dict:
    """Start Taichi on so many threads: a summary of nothing but the machine, the versions and the sizes."""
    architecture = runtime.start(threads=threads)
    return {"machine": {**clock.machine(), "threads": runtime.thread_count(), "architecture": architecture},
            "versions": clock.versions(), "rods": rods.count, "rounds": rounds, "peak_gflops": {}, "cases": {}}


def completed(summary: dict, steps: list[Step]) -> dict:
    """The summary after all steps, with their progress on standard error."""
    with progress(keep=True) as bar:
        task = bar.add_task("", total=len(steps), unit="steps", rate="")
        for name, run in steps:
            bar.update(task, description=name)
            bar.update(task, rate=run(summary), advance=1)
    return summary


def case_steps(chosen: list[Case], reference: clock.Reference) -> list[Step]:
    """Time each case; their shares of the peak at the end, because it is measured again before each of them."""
    measured = {}

    def timed(case: Case, summary: dict) -> str:
        summary["peak_gflops"] = peak_gflops(summary["peak_gflops"])
        found = measured[case.name] = measure(case, reference, summary["rounds"])
        return f"{found.per_second:,.0f} {found.unit}"

    def shared(summary: dict) -> str:
        peak = summary["peak_gflops"] = peak_gflops(summary["peak_gflops"])
        summary["cases"] = {name: {**asdict(found), "share_of_peak": found.share_of(peak)} for name, found in measured.items()}
        return ", ".join(f"{value:,.0f} GFlop/s" for value in peak.values())

    return [*((case.name, lambda summary, case=case: timed(case, summary)) for case in chosen), ("peak", shared)]


def accuracy_step(rods: Specimens) -> Step:
    """Where f32 ends beside f64, on the first rods."""

    def compared(summary: dict) -> str:
        some = rods.many.take(slice(COMPARED))
        coarse, fine = rods.relaxed.configuration.take(slice(COMPARED)), some.relaxed(FINE, "f64").configuration
        apart = np.linalg.norm(coarse.vertices - fine.vertices, axis=-1).mean(axis=1)
        same = apart <= SAME_MM
        median, high = np.percentile(apart[same], [50, 99]) if same.any() else (np.nan, np.nan)
        summary["f32_against_f64"] = {"rods": some.count, "same_minimum": float(same.mean()), "median_mm": float(median),
                                      "percentile_99_mm": float(high)}
        return f"{median:.1e} mm"

    return "f32 against f64", compared


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
