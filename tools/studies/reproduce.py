"""Every table and figure of the paper, from the shipped scenes alone, in two configurations; writes REPLICATION.md.

    python tools/studies/reproduce.py [ITEM ...] [--quick] [--report FILE]

The whole run takes up to 40 minutes on two cores, ``--quick`` 5. Exit code 1 where an item cannot run, for example because a
scene is missing, and where a result is worse than the documents claim (``replication/criteria.py``). Results are kept in
runs/replication, or beside the report where that is named; ``--rewrite`` writes the report from them again, without a run.
"""

import argparse
import json
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from doo_ti import InputError, InterruptedRunError
from doo_ti.lab import workload
from doo_ti.system.files import write_text
from tools.studies.replication.report import Outcome, report
from tools.studies.replication.settings import FULL, QUICK, TINY, Size
from tools.studies.replication.study import ITEMS, Study

SIZES = {size.name: size for size in (FULL, QUICK, TINY)}


def measured(names: list[str], size: Size) -> Iterator[Outcome]:
    """The items, one after the other; one that cannot run does not keep the others from running."""
    study = Study(size, lambda text: print(text, file=sys.stderr, flush=True))
    for name in names:
        began, busy, found, problem = time.monotonic(), time.process_time(), None, ""
        try:
            found = ITEMS[name](study)
        except (InputError, InterruptedRunError, OSError) as error:
            problem = str(error)
        outcome = Outcome(name, found, problem, time.monotonic() - began, time.process_time() - busy)
        print(f"{name}: {outcome.seconds:.0f} s", file=sys.stderr, flush=True)
        yield outcome


def main(words: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("items", nargs="*", metavar="ITEM", choices=[*ITEMS, []],
                        help=f"of {', '.join(ITEMS)} (default: all)")
    parser.add_argument("--quick", action="store_true", help="fewer specimens and rods, 5 minutes")
    parser.add_argument("--rewrite", action="store_true", help="write the report of the last run again, with new words")
    parser.add_argument("--note", default="", help="a remark on the run, for the report")
    parser.add_argument("--size", choices=SIZES, help=argparse.SUPPRESS)
    parser.add_argument("--report", type=Path, help="file to write (default: REPLICATION.md, with --quick "
                        "runs/replication/REPLICATION.md)")
    options = parser.parse_args(words)
    size = SIZES[options.size or ("quick" if options.quick else "full")]
    path = options.report or (ROOT if size is FULL else ROOT / "runs" / "replication") / "REPLICATION.md"
    words = [*(f'"{name}"' for name in options.items), *["--quick"] * options.quick]
    command = " ".join(["python tools/studies/reproduce.py", *words])
    kept = (path.parent if options.report else ROOT / "runs" / "replication") / f"results_{size.name}.json"
    if options.rewrite:
        run = json.loads(kept.read_text(encoding="utf-8"))
        outcomes = [Outcome.from_dict(one) for one in run["outcomes"]]
    else:
        run, outcomes = {"command": command, "machine": workload.machine()}, []
        for outcome in measured(options.items or list(ITEMS), size):
            outcomes.append(outcome)  # kept at once: a run that is ended keeps the items that were done
            write_text(kept, json.dumps({**run, "outcomes": [asdict(one) for one in outcomes]}, default=bool) + "\n")
    text = report(outcomes, run["command"], run["machine"], options.note, size)
    write_text(path, text)
    print(text)
    failures = [failure for outcome in outcomes for failure in outcome.failures]
    for failure in failures:
        print(f"failed: {failure}", file=sys.stderr)
    print(f"written to {path}; {len(failures)} failed", file=sys.stderr)
    return int(bool(failures))


if __name__ == "__main__":
    sys.exit(main())
