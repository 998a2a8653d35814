"""Benchmark of the hot path: ``python tools/bench/relaxation.py [CASE ...] [--rounds N] [--check | --write]``.

Prints one table: rods/s, the ratio to a NumPy workload timed in the same round, and that ratio over the baseline's.
``--check`` exits with 1 where a ratio falls below half the baseline or fewer rods converge; ``--write`` makes a new
baseline, on an idle machine. The rods are those of the shipped scenes, so nothing else is needed.
"""

import argparse
import json
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path
from statistics import median

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
if not __package__:
    sys.path.insert(0, str(ROOT))

from doo_ti import Configuration, Descent, Newton, Observations  # noqa: E402
from doo_ti.metric import distance  # noqa: E402
from doo_ti.runtime import start as start_runtime  # noqa: E402
from doo_ti.runtime import thread_count  # noqa: E402
from doo_ti.scene import load_scene  # noqa: E402
from doo_ti.synthesis import synthesise  # noqa: E402
from doo_ti.types import Solution  # noqa: E402
from tools.bench import clock, workload  # noqa: E402
from tools.bench.workload import Rods  # noqa: E402

BASELINE = Path(__file__).with_name("baseline.json")
SLOWEST = 0.5
"""A ratio below this share of the baseline's is a regression."""
FEWER = 0.002
"""Share of rods that may converge less than in the baseline: a result that is wrong is worse than a slow one."""
ROUND_SECONDS = 0.3
"""A round repeats its case for about this long, so that a neighbour's moment of work does not decide it."""


@dataclass(frozen=True)
class Outcome:
    """What one run of a case did: how much of its unit, and where rods are relaxed the share that converged and their
    mean iterations."""

    amount: float
    converged: float = 1.0
    iterations: float = 0.0


@dataclass(frozen=True)
class Case:
    """Something timed: ``run()`` once, warm, does an :class:`Outcome`, counted in ``unit``."""

    name: str
    unit: str
    run: Callable[[], Outcome]


@dataclass(frozen=True)
class Measurement:
    """Medians over the rounds; ``ratio`` is that of rates taken in the same round."""

    unit: str
    per_second: float
    ratio: float
    converged: float
    iterations: float


def observed(*names: str) -> list[Observations]:
    """The observations of shipped scenes."""
    return [synthesise(load_scene(ROOT / "scenes" / f"{name}.toml").observations) for name in names]


def cases(rods: int) -> list[Case]:
    """The hot path, ``rods`` at a time where the size is not the point."""
    sutures = observed(*workload.SUTURES)
    starts, clamps = workload.in_turn([workload.started(observations) for observations in sutures])
    many = workload.paired(starts, clamps, workload.isotropic_materials(rods))
    band = workload.paired(*workload.started(*observed("ribbon")), workload.ribbon_materials(rods))
    slow = many.take(slice(max(rods // 64, 1)))
    coarse, fine = Newton(tolerance=1e-6), Newton(tolerance=1e-9)
    posed = many.relaxed(coarse, "f32").configuration
    return [
        Case("newton f32", "rods/s", lambda: converged(many.relaxed(coarse, "f32"))),
        Case("newton f64", "rods/s", lambda: converged(many.relaxed(fine, "f64"))),
        Case("newton mixed", "rods/s", lambda: converged(many.relaxed(fine, "mixed"))),
        Case("newton f32 general B", "rods/s", lambda: converged(band.relaxed(coarse, "f32"))),
        Case("newton f32 batches of 256", "rods/s", partial(in_batches, many, 256, max(rods // 4096, 1))),
        Case("newton f32 one rod", "rods/s", partial(in_batches, many, 1, max(rods // 512, 1))),
        Case("descent f64", "iterations/s", lambda: stepped(slow.relaxed(Descent(max_iterations=1000), "f64"))),
        Case("metric", "rods/s", lambda: compared(posed, sutures[0])),
    ]


def converged(*solutions: Solution) -> Outcome:
    """Only rods that converged count."""
    done = np.concatenate([solution.converged for solution in solutions])
    iterations = np.concatenate([solution.iterations for solution in solutions])
    return Outcome(float(done.sum()), float(done.mean()), float(iterations.mean()))


def in_batches(rods: Rods, size: int, calls: int) -> Outcome:
    """One call of ``size`` rods after another, over tables that hold no other rods."""
    first = [k * size % max(rods.count - size, 1) for k in range(calls)]
    return converged(*(rods.alone(slice(at, at + size)).relaxed(Newton(tolerance=1e-6), "f32") for at in first))


def stepped(solution: Solution) -> Outcome:
    """Gradient steps count, whether they were enough or not."""
    return Outcome(float(solution.iterations.sum()), 1.0, float(solution.iterations.mean()))


def compared(configuration: Configuration, observations: Observations) -> Outcome:
    """Eq. 1 of all rods."""
    error = distance(configuration, observations, np.arange(configuration.count) % observations.count)
    return Outcome(float(configuration.count), float(np.isfinite(error).mean()))


def measure(case: Case, reference: clock.Reference, rounds: int) -> Measurement:
    """Warm up, then time the case between two runs of the reference, ``rounds`` times."""
    case.run()
    once, outcome = clock.timed(case.run)
    calls = max(1, round(ROUND_SECONDS / once))
    rates, ratios = [], []
    for _ in range(rounds):
        before = reference.rate()
        seconds, outcomes = clock.timed(lambda: [case.run() for _ in range(calls)])
        rates.append(sum(outcome.amount for outcome in outcomes) / seconds)
        ratios.append(rates[-1] / (0.5 * (before + reference.rate())))
    return Measurement(case.unit, median(rates), median(ratios), outcome.converged, outcome.iterations)


def measured_again(case: Case, first: Measurement, reference: clock.Reference, rounds: int) -> Measurement:
    """The better of two measurements, the second over twice the rounds: a case that seems to have fallen behind may
    only have met a busy moment."""
    second = measure(case, reference, 2 * rounds)
    return second if second.ratio > first.ratio else first


def table(measured: dict[str, Measurement], baseline: dict) -> str:
    """Markdown, one line per case; the ratio per 10⁶ multiply-adds of the reference."""
    lines = ["| case | per second | converged | iterations | ratio ·10⁶ | of baseline |", "|---|---|---|---|---|---|"]
    for name, m in measured.items():
        old = baseline.get("cases", {}).get(name)
        share = f"{m.ratio / old['ratio']:.2f}" if old else "new"
        lines.append(f"| {name} | {m.per_second:,.0f} {m.unit} | {100 * m.converged:.2f} % | {m.iterations:.1f} | "
                     f"{1e6 * m.ratio:.4g} | {share} |")
    return "\n".join(lines)


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


def as_baseline(measured: dict[str, Measurement], rods: int, rounds: int) -> dict:
    """What ``baseline.json`` holds."""
    return {
        "machine": {**clock.machine(), "threads": thread_count()},
        "versions": {name: version(name) for name in ("taichi", "numpy")},
        "rods": rods,
        "rounds": rounds,
        "cases": {
            name: {"unit": m.unit, "per_second": float(f"{m.per_second:.4g}"), "ratio": float(f"{m.ratio:.4g}"),
                   "converged": round(m.converged, 5), "iterations": round(m.iterations, 2)}
            for name, m in measured.items()
        },
    }


def main(arguments: list[str]) -> int:
    from rich.console import Console
    from rich.progress import track

    parser = argparse.ArgumentParser(prog="relaxation.py", description=__doc__.splitlines()[0])
    parser.add_argument("cases", nargs="*", metavar="CASE", help="names or parts of names; all by default")
    parser.add_argument("--rods", type=int, default=65_536, help="rods in the large batches; the baseline is for 65536")
    parser.add_argument("--rounds", type=int, default=5, help="measurements of which the median counts")
    parser.add_argument("--baseline", type=Path, default=BASELINE, help="file to compare with and to write")
    action = parser.add_mutually_exclusive_group()
    action.add_argument("--check", action="store_true", help="exit with 1 where a case has fallen behind the baseline")
    action.add_argument("--write", action="store_true", help="make this run the baseline")
    options = parser.parse_args(arguments)
    if options.rods < 1 or options.rounds < 1:
        parser.error("--rods and --rounds need to be 1 or more")
    if options.write and options.cases:
        parser.error("--write needs all cases")
    start_runtime()
    chosen = [case for case in cases(options.rods)
              if not options.cases or any(part in case.name for part in options.cases)]
    if not chosen:
        parser.error(f"no case is named {', '.join(options.cases)}")
    baseline = json.loads(options.baseline.read_text(encoding="utf-8")) if options.baseline.exists() else {}
    if baseline.get("rods", options.rods) != options.rods:
        parser.error(f"the baseline is for {baseline['rods']} rods: name another file with --baseline")
    reference = clock.Reference(thread_count())
    measured = {case.name: measure(case, reference, options.rounds)
                for case in track(chosen, "timing", console=Console(stderr=True))}
    if options.check:
        for case in chosen:
            if regressions({case.name: measured[case.name]}, baseline):
                measured[case.name] = measured_again(case, measured[case.name], reference, options.rounds)
    machine = clock.machine()
    print(f"{machine['processor']}, {machine['cores']} cores, {thread_count()} threads; medians of {options.rounds}\n")
    print(table(measured, baseline))
    if options.write:
        text = json.dumps(as_baseline(measured, options.rods, options.rounds), indent=2) + "\n"
        options.baseline.write_text(text, encoding="utf-8")
    behind = regressions(measured, baseline) if options.check else []
    for sentence in behind:
        print(sentence, file=sys.stderr)
    return int(bool(behind))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
