"""The command of a benchmark with a committed baseline: time its cases, compare them, or make a new baseline.

A baseline holds ratios to the NumPy workload of the same run, and the share of rods that converged.
"""

import argparse
import json
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np

from doo_ti import Solution, gripper_jacobian
from doo_ti.lab import workload
from doo_ti.lab.cases import Case, Measurement, Outcome, measure
from doo_ti.system.runtime import start as start_runtime
from doo_ti.system.runtime import thread_count

SLOWEST = 0.5  # a ratio below this share of the baseline's is a regression
FEWER = 0.002  # allowed decrease of the share of converged rods


def run(arguments: list[str], description: str, file: Path, items: str, default: int, least: int,
        cases: Callable[[int], list[Case]]) -> int:
    """The exit code: 1 where ``--check`` finds a case behind the baseline, or fewer rods converged.

    file   the committed baseline
    items  what the cases are made of, such as "rods"; the option ``--rods`` sets their number: its default and least value
    cases  those of a number of items
    """
    from rich.console import Console
    from rich.progress import track

    parser = _parser(description, file, items, default)
    options = parser.parse_args(arguments)
    count = getattr(options, items)
    if count < least or options.rounds < 1:
        parser.error(f"--{items} needs to be {least} or more, --rounds 1 or more")
    if options.write and options.cases:
        parser.error("--write needs all cases")
    baseline = json.loads(options.baseline.read_text(encoding="utf-8")) if options.baseline.exists() else {}
    if baseline.get("rods", count) != count and not options.write:
        parser.error(f"the baseline is for {baseline['rods']} {items}: name another file with --baseline")
    start_runtime()
    console = Console(stderr=True)
    with console.status("preparing the cases"):
        every = cases(count)
    chosen = [case for case in every if not options.cases or any(part in case.name for part in options.cases)]
    if not chosen:
        parser.error(f"no case is named {', '.join(options.cases)}")
    reference = workload.Reference(thread_count())
    measured = {case.name: measure(case, reference, options.rounds) for case in track(chosen, "timing", console=console)}
    if options.check:
        for case in chosen:
            first = measured[case.name]
            if regressions({case.name: first}, baseline):  # another process may have disturbed it: the better of two counts
                measured[case.name] = max(first, measure(case, reference, 2 * options.rounds), key=lambda one: one.ratio)
    machine = workload.machine()
    print(f"{machine['processor']}, {machine['cores']} cores, {thread_count()} threads; medians of {options.rounds}\n")
    print(table(measured, baseline))
    if options.write:
        options.baseline.write_text(json.dumps(as_baseline(measured, count, options.rounds), indent=2) + "\n", encoding="utf-8")
    behind = regressions(measured, baseline) if options.check else []
    for sentence in behind:
        print(sentence, file=sys.stderr)
    return int(bool(behind))


def _parser(description: str, file: Path, items: str, default: int) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("cases", nargs="*", metavar="CASE", help="names or parts of names; all by default")
    parser.add_argument(f"--{items}", type=int, default=default, help=f"in the large batches; the baseline is for {default}")
    parser.add_argument("--rounds", type=int, default=5, help="measurements of which the median counts")
    parser.add_argument("--baseline", type=Path, default=file, help="file to compare with and to write")
    action = parser.add_mutually_exclusive_group()
    action.add_argument("--check", action="store_true", help="exit with 1 where a case is slower than the baseline allows")
    action.add_argument("--write", action="store_true", help="make this run the baseline")
    return parser


def as_baseline(measured: dict[str, Measurement], count: int, rounds: int) -> dict:
    """What a baseline holds."""
    versions = workload.versions()
    return {
        "machine": {**workload.machine(), "threads": thread_count()},
        "versions": {name: versions[name] for name in ("taichi", "numpy")},
        "rods": count,
        "rounds": rounds,
        "cases": {
            name: {"unit": m.unit, "per_second": float(f"{m.per_second:.4g}"), "ratio": float(f"{m.ratio:.4g}"),
                   "converged": round(m.converged, 5), "iterations": round(m.iterations, 2)}
            for name, m in measured.items()
        },
    }


def regressions(measured: dict[str, Measurement], baseline: dict) -> list[str]:
    """One sentence per case that is much slower than the baseline, or converges less often."""
    found = []
    for name, m in measured.items():
        old = baseline.get("cases", {}).get(name)
        if old and m.ratio < SLOWEST * old["ratio"]:
            found.append(f"{name}: {m.ratio / old['ratio']:.2f} of the baseline's ratio")
        if old and m.converged < old["converged"] - FEWER:
            found.append(f"{name}: {100 * m.converged:.2f} % converged, {100 * old['converged']:.2f} % in the baseline")
    return found


def table(measured: dict[str, Measurement], baseline: dict) -> str:
    """Markdown, one line per case; the ratio per 10⁶ multiply-adds of the reference."""
    lines = ["| case | per second | converged | iterations | ratio ·10⁶ | of baseline |", "|---|---|---|---|---|---|"]
    for name, m in measured.items():
        old = baseline.get("cases", {}).get(name)
        share = f"{m.ratio / old['ratio']:.2f}" if old else "new"
        lines.append(f"| {name} | {m.per_second:,.0f} {m.unit} | {100 * m.converged:.2f} % | {m.iterations:.1f} | "
                     f"{1e6 * m.ratio:.4g} | {share} |")
    return "\n".join(lines)


def outcome(found: Solution) -> Outcome:
    """Of one call; only rods that converged count."""
    done = found.converged
    return Outcome(float(done.sum()), float(done.mean()), float(found.stable.mean()),
                   float(np.max(found.residual[done], initial=0.0)), found.iterations)


def derived(solution: Solution) -> Outcome:
    """Derivatives of shapes, forces and moments by both grippers' poses, 12 columns."""
    usable = gripper_jacobian(solution).usable
    return Outcome(float(usable.sum()), float(usable.mean()))
