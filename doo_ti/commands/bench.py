"""Throughput and accuracy of relaxations on this machine."""

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


def run(options: Namespace, words: list[str]) -> int:
    """Throughput and accuracy on this machine; with a folder also as JSON."""
    rods = given.whole("--rods", options.rods, 1, MOST_RODS) or RODS
    threads = given.whole("--threads", options.threads, 1, os.cpu_count() or 1)
    rounds = given.whole("--rounds", options.rounds, 1, MOST_ROUNDS) or ROUNDS
    out = given.output_folder(options.out)

    from doo_ti.bench.cases import Specimens, cases
    from doo_ti.bench.clock import Reference
    from doo_ti.bench.table import accuracy_step, begun, case_steps, completed, text
    from doo_ti.system import runtime

    specimens = Specimens(rods)
    summary = begun(specimens, rounds, threads)
    steps = case_steps(cases(specimens), Reference(runtime.thread_count()))
    summary = completed(summary, [*steps, accuracy_step(specimens)])
    if out is not None:
        save_json(out / "bench.json", summary)
    report(options, summary, lambda: [text(summary)])
    return 0
