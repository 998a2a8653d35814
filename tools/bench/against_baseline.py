"""The command of a benchmark with a committed baseline: time its cases, compare them, or make a new baseline."""

import argparse
import json
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from doo_ti.bench import clock
from doo_ti.bench.cases import Case, measure
from doo_ti.system.runtime import start as start_runtime
from doo_ti.system.runtime import thread_count
from tools.bench.baseline import as_baseline, measured_again, regressions, table


@dataclass(frozen=True)
class Benchmark:
    """A benchmark and its baseline.

    name         of the script
    description  one line
    baseline     the committed file
    count        the items, such as "rods", whose number the option ``--rods`` sets; its default and least value
    cases        the cases for a number of items
    """

    name: str
    description: str
    baseline: Path
    count: str
    default: int
    least: int
    cases: Callable[[int], list[Case]]


def run(benchmark: Benchmark, arguments: list[str]) -> int:
    """The exit code: 1 where ``--check`` finds a case behind the baseline, or fewer rods converged."""
    from rich.console import Console
    from rich.progress import track

    parser = _parser(benchmark)
    options = parser.parse_args(arguments)
    count = getattr(options, benchmark.count)
    if count < benchmark.least or options.rounds < 1:
        parser.error(f"--{benchmark.count} needs to be {benchmark.least} or more, --rounds 1 or more")
    if options.write and options.cases:
        parser.error("--write needs all cases")
    baseline = json.loads(options.baseline.read_text(encoding="utf-8")) if options.baseline.exists() else {}
    if baseline.get("rods", count) != count and not options.write:
        parser.error(f"the baseline is for {baseline['rods']} {benchmark.count}: name another file with --baseline")
    start_runtime()
    console = Console(stderr=True)
    with console.status("preparing the cases"):
        every = benchmark.cases(count)
    chosen = [case for case in every if not options.cases or any(part in case.name for part in options.cases)]
    if not chosen:
        parser.error(f"no case is named {', '.join(options.cases)}")
    reference = clock.Reference(thread_count())
    measured = {case.name: measure(case, reference, options.rounds) for case in track(chosen, "timing", console=console)}
    if options.check:
        for case in chosen:
            if regressions({case.name: measured[case.name]}, baseline):
                measured[case.name] = measured_again(case, measured[case.name], reference, options.rounds)
    machine = clock.machine()
    print(f"{machine['processor']}, {machine['cores']} cores, {thread_count()} threads; medians of {options.rounds}\n")
    print(table(measured, baseline))
    if options.write:
        text = json.dumps(as_baseline(measured, count, options.rounds, thread_count()), indent=2) + "\n"
        options.baseline.write_text(text, encoding="utf-8")
    behind = regressions(measured, baseline) if options.check else []
    for sentence in behind:
        print(sentence, file=sys.stderr)
    return int(bool(behind))


def _parser(benchmark: Benchmark) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog=benchmark.name, description=benchmark.description)
    parser.add_argument("cases", nargs="*", metavar="CASE", help="names or parts of names; all by default")
    parser.add_argument(f"--{benchmark.count}", type=int, default=benchmark.default,
                        help=f"in the large batches; the baseline is for {benchmark.default}")
    parser.add_argument("--rounds", type=int, default=5, help="measurements of which the median counts")
    parser.add_argument("--baseline", type=Path, default=benchmark.baseline, help="file to compare with and to write")
    action = parser.add_mutually_exclusive_group()
    action.add_argument("--check", action="store_true", help="exit with 1 where a case is slower than the baseline allows")
    action.add_argument("--write", action="store_true", help="make this run the baseline")
    return parser
