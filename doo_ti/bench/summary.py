"""What ``doo-ti bench`` measures, step by step, in one dictionary: what ``bench.json`` holds."""

from collections.abc import Callable
from dataclasses import asdict

import numpy as np

from doo_ti.bench import clock
from doo_ti.bench.cases import FINE, Case, Specimens, measure
from doo_ti.bench.peak import peak_gflops
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
