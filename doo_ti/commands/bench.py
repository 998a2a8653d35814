"""Throughput and accuracy of relaxations on this machine, as JSON and as Markdown: a table of the cases, and below it what the
figures are made of."""

import math
import os
from argparse import Namespace

from doo_ti.commands import options as given
from doo_ti.commands.results import report, save_json

RODS, ROUNDS = 65_536, 3
MOST_ROUNDS = 1000
MOST_RODS = 1 << 22
"""Four times as many are relaxed at once to measure the memory they need: some 20 GB."""


def declare(add) -> None:
    parser = given.command(add, "bench", run, "measure throughput and accuracy on this machine, in one table")
    parser.add_argument("--rods", metavar="N", help=f"rods in the large batches (default {RODS})")
    parser.add_argument("--threads", metavar="N", help="threads of the kernels (default: one per processor)")
    parser.add_argument("--rounds", metavar="N", help=f"number of measurements; their median is printed (default {ROUNDS})")
    parser.add_argument("--out", metavar="FOLDER", help="folder for bench.json (default: not written)")


def run(options: Namespace) -> int:
    rods = given.whole("--rods", options.rods, 1, MOST_RODS) or RODS
    threads = given.whole("--threads", options.threads, 1, os.cpu_count() or 1)
    rounds = given.whole("--rounds", options.rounds, 1, MOST_ROUNDS) or ROUNDS
    out = given.output_folder(options.out)

    from doo_ti.lab.cases import benchmark

    summary = benchmark(rods, rounds, threads)
    if out is not None:
        save_json(out / "bench.json", summary)
    report(options, summary, lambda: [text(summary)])
    return 0


def text(summary: dict) -> str:
    """Markdown of a summary."""
    found, versions = summary["machine"], ", ".join(f"{name} {number}" for name, number in summary["versions"].items())
    machine = (f"{found['processor']}, {_counted(found['cores'], 'core')}, {_counted(found['threads'], 'thread')}"
               f"{'' if found['architecture'] == 'cpu' else ', ' + found['architecture']}; {versions}; "
               f"batches of {summary['rods']}, rods of 33 edges, medians of {summary['rounds']}")
    return "\n\n".join([machine, _table(summary["cases"]), "\n".join(_notes(summary))])


def _counted(count: int, what: str) -> str:
    return f"{count} {what}{'s' * (count != 1)}"


def _table(cases: dict[str, dict]) -> str:
    """One line per case, columns aligned; a dash where a figure does not apply."""
    heads = ["case", "per second", "ratio ·10⁶", "converged", "stable", "iterations", "residual", "lanes busy", "of peak"]
    lines = [[name, f"{case['per_second']:,.0f} {case['unit']}", f"{1e6 * case['ratio']:.4g}", percent(case["converged"]),
              percent(case["stable"]), f"{case['iterations']:.1f}" if case["iterations"] else "–",
              "–" if case["residual"] is None else f"{case['residual']:.0e} /mm", percent(case["busy"]),
              percent(case["share_of_peak"])] for name, case in cases.items()]
    widths = [max(map(len, column)) for column in zip(heads, *lines, strict=True)]
    rows = [heads, ["-" * width for width in widths], *lines]
    return "\n".join("| " + " | ".join(map(str.ljust, row, widths)) + " |" for row in rows)


def _notes(summary: dict) -> list[str]:
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
