"""Benchmark of the hot path: ``python tools/bench/relaxation.py [CASE ...] [--rounds N] [--check | --write]``.

Prints one table: rods/s, the ratio to a NumPy workload timed in the same round, and that ratio over the baseline's.
``--check`` exits with 1 where a ratio falls below half the baseline or fewer rods converge; ``--write`` makes a new
baseline, on an idle machine. ``doo-ti bench`` measures the same cases and more.
"""

import argparse
import json
import sys
from pathlib import Path

if not __package__:
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from doo_ti.bench import clock  # noqa: E402
from doo_ti.bench.baseline import as_baseline, measured_again, regressions, table  # noqa: E402
from doo_ti.bench.cases import Specimens, cases, measure  # noqa: E402
from doo_ti.runtime import start as start_runtime  # noqa: E402
from doo_ti.runtime import thread_count  # noqa: E402

BASELINE = Path(__file__).with_name("baseline.json")


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
    chosen = [case for case in cases(Specimens(options.rods))
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
        text = json.dumps(as_baseline(measured, options.rods, options.rounds, thread_count()), indent=2) + "\n"
        options.baseline.write_text(text, encoding="utf-8")
    behind = regressions(measured, baseline) if options.check else []
    for sentence in behind:
        print(sentence, file=sys.stderr)
    return int(bool(behind))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
