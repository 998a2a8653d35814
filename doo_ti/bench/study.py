"""Everything ``doo-ti bench`` measures, step by step, into one dictionary: what ``bench.json`` holds."""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np

from doo_ti import runtime
from doo_ti.bench import clock, process, scaling
from doo_ti.bench.cases import FINE, Case, Specimens, cases, measure
from doo_ti.bench.peak import peak_gflops
from doo_ti.progress import progress
from doo_ti.report import Panel, panels_picture
from doo_ti.whole_file import write_whole

COMPARED = 4096  # rods whose shape in f32 is compared with f64's
SAME_MM = 0.02
"""Two rods are in the same minimum where the mean distance between their vertices is no more than this."""
CALLS_IN_ROUND = 3  # of the processes with other numbers of threads
JAX_RODS = 4096
JAX_ROWS = {32: "newton f32", 64: "newton f64"}
"""The case that each precision of the same solver in JAX stands beside: the kernel in that precision."""
JAX_DERIVATIVES = ("explicit", "automatic")


@dataclass(frozen=True)
class Plan:
    """rods in the large batches, rounds of which the median counts, threads (None: one per processor), and what is
    measured besides."""

    rods: int = 65_536
    rounds: int = 3
    threads: int | None = None
    scaling: bool = False
    jax: bool = False


@dataclass(frozen=True)
class Step:
    """``run(summary)`` enters what it measures and returns it in a few words, for the progress."""

    name: str
    run: Callable[[dict], str]


def measured(plan: Plan) -> dict:
    """Run all steps, with their progress on standard error. Raises InterruptedRunError where a process of its own fails."""
    architecture = runtime.start(threads=plan.threads)
    threads = runtime.thread_count()
    summary = {"machine": {**clock.machine(), "threads": threads, "architecture": architecture},
               "versions": clock.versions(), "rods": plan.rods, "rounds": plan.rounds, "cases": {}, "process": {}}
    rods = Specimens(plan.rods)
    with progress(lasting=True) as bar, process.Children(lambda: (rods.many.starts, rods.many.clamps)) as children:
        found = steps(plan, rods, children, threads)
        task = bar.add_task("", total=len(found), unit="steps", rate="")
        for step in found:
            bar.update(task, description=step.name)
            bar.update(task, rate=step.run(summary), advance=1)
    return summary


def steps(plan: Plan, rods: Specimens, children: process.Children, threads: int) -> list[Step]:
    """What ``plan`` asks for, in order."""
    reference = clock.Reference(threads)
    found = [Step("peak", _peak)]
    found += [Step(case.name, partial(_case, case, reference, plan.rounds)) for case in cases(rods)]
    found += [Step("f32 against f64", partial(_accuracy, rods)), *_processes(children, plan, threads)]
    if plan.scaling:
        found += _scaling(rods)
    if plan.jax:
        found += [Step(f"JAX f{bits}, {derivatives} derivatives", partial(_jax, rods, bits, derivatives, plan.rounds))
                  for derivatives in JAX_DERIVATIVES for bits in JAX_ROWS]
    return found


def draw(folder: Path, summary: dict) -> None:
    """histogram.png, and scaling.png where scaling was measured."""
    lines = {}
    for name, case in summary["cases"].items():
        if case["busy"] is not None:
            counts = np.array(case["histogram"])
            lines[name] = (np.arange(len(counts)), 100 * counts / counts.sum())
    panel = Panel("", "iterations", "share of the rods [%]", lines)
    title = f"iterations of {summary['rods']} rods"
    write_whole(folder / "histogram.png", lambda file: panels_picture(file, [panel], title))
    if "scaling" in summary:
        found = summary["machine"]
        panels = scaling.panels(**summary["scaling"], threads=summary["process"]["threads"])
        title = f"{found['processor']}, {found['cores']} cores, {found['threads']} threads"
        write_whole(folder / "scaling.png", lambda file: panels_picture(file, panels, title))


def _peak(summary: dict) -> str:
    summary["peak_gflops"] = peak_gflops()
    return ", ".join(f"{value:,.0f} GFlop/s" for value in summary["peak_gflops"].values())


def _case(case: Case, reference: clock.Reference, rounds: int, summary: dict) -> str:
    measured = measure(case, reference, rounds)
    peak = summary["peak_gflops"].get(f"f{case.launches[0]}") if len(case.launches) == 1 else None
    share = measured.gflops / peak if peak and measured.gflops else None
    summary["cases"][case.name] = {**asdict(measured), "share_of_peak": share}
    return f"{measured.per_second:,.0f} {measured.unit}"


def _accuracy(rods: Specimens, summary: dict) -> str:
    """Where f32 ends beside f64, on the first rods."""
    some = rods.many.take(slice(COMPARED))
    coarse, fine = rods.relaxed.configuration.take(slice(COMPARED)), some.relaxed(FINE, "f64").configuration
    apart = np.linalg.norm(coarse.vertices - fine.vertices, axis=-1).mean(axis=1)
    same = apart <= SAME_MM
    median, high = np.percentile(apart[same], [50, 99]) if same.any() else (np.nan, np.nan)
    summary["f32_against_f64"] = {"rods": some.count, "same_minimum": float(same.mean()), "median_mm": float(median),
                                  "percentile_99_mm": float(high)}
    return f"{median:.1e} mm"


def _processes(children: process.Children, plan: Plan, threads: int) -> list[Step]:
    """Start-up, memory and threads, each in processes of its own."""
    def entered(name: str, unit: str, measure: Callable[[], float | None], summary: dict) -> str:
        value = summary["process"][name] = measure()
        return "–" if value is None else f"{value:.3g} {unit}"

    def threaded(count: int, summary: dict) -> str:
        rate = children.rods_per_second(count, plan.rods, CALLS_IN_ROUND * plan.rounds)
        summary["process"].setdefault("threads", []).append({"threads": count, "rods_per_second": rate})
        return f"{rate:,.0f} rods/s"

    counts = scaling.thread_counts(threads) if plan.scaling else sorted({1, threads})
    return [
        Step("import", partial(entered, "import_s", "s", children.import_seconds)),
        Step("first relaxation", partial(entered, "first_relaxation_s", "s", children.process_seconds)),
        Step("from the cache", partial(entered, "cached_relaxation_s", "s", children.process_seconds)),
        Step("memory", partial(entered, "bytes_per_rod", "B", partial(children.bytes_per_rod, plan.rods))),
        Step("memory over calls", partial(entered, "growth_kb_per_call", "kB",
                                          partial(children.growth_kb_per_call, process.CALLS))),
        *(Step(f"threads: {count}", partial(threaded, count)) for count in counts),
    ]


def _scaling(rods: Specimens) -> list[Step]:
    def point(axis: str, measure: Callable, count: int, summary: dict) -> str:
        found = measure(rods.many, count)
        summary.setdefault("scaling", {}).setdefault(axis, []).append(
            {**asdict(found), "rods_per_second": found.rods_per_second})
        return f"{found.rods_per_second:,.0f} rods/s"

    return [Step(f"{count} {axis}", partial(point, axis, measure, count))
            for axis, measure, counts in (("rods", scaling.with_rods, scaling.RODS),
                                          ("edges", scaling.with_edges, scaling.EDGES)) for count in counts]


def _jax(rods: Specimens, bits: int, derivatives: str, rounds: int, summary: dict) -> str:
    """The same solver in JAX, and how many times as fast the case beside it is."""
    from doo_ti.bench.newton_in_jax import rate

    some = rods.many.take(slice(JAX_RODS))
    found = rate(some, bits, rounds, derivatives)
    times = summary["cases"][JAX_ROWS[bits]]["per_second"] / found.rods_per_second
    summary.setdefault("jax", []).append(
        {"derivatives": derivatives, "beside": JAX_ROWS[bits], "rods": some.count, "times": times, **asdict(found)})
    return f"{found.rods_per_second:,.0f} rods/s"
