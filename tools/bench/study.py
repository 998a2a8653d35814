"""All measurements of the solver's speed: ``python tools/bench/study.py [OPTION ...]``.

The table of ``doo-ti bench``, and: single rods, the paper's scheme, Eq. 1, start-up, memory, threads, numbers of
iterations; ``--scaling`` adds curves over rods, edges and threads. With ``--out FOLDER`` also as bench.json,
histogram.png and scaling.png.
"""

import argparse
import json
import sys
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from pathlib import Path

import numpy as np

if not __package__:
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from doo_ti.bench.cases import Specimens  # noqa: E402
from doo_ti.bench.clock import Reference  # noqa: E402
from doo_ti.bench.summary import Step, accuracy_step, begun, case_steps, completed  # noqa: E402
from doo_ti.commands.results import plain  # noqa: E402
from doo_ti.system.errors import InterruptedRunError  # noqa: E402
from doo_ti.system.files import write_whole  # noqa: E402
from tools.bench import process, scaling  # noqa: E402
from tools.bench.cases import cases  # noqa: E402
from tools.bench.curves import Panel, panels_picture  # noqa: E402
from tools.bench.table import large_batches, text  # noqa: E402

CALLS_IN_ROUND = 3  # of the processes with other numbers of threads


def main(arguments: list[str]) -> int:
    options = _parsed(arguments)
    try:
        summary = plain(measured(options))
    except InterruptedRunError as error:
        print(error, file=sys.stderr)
        return 1
    if options.out is not None:
        options.out.mkdir(parents=True, exist_ok=True)
        content = json.dumps(summary, indent=2) + "\n"
        write_whole(options.out / "bench.json", lambda file: file.write(content.encode()))
        draw(options.out, summary)
    print(text(summary))
    return 0


def _parsed(arguments: list[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="study.py", description=__doc__.splitlines()[0])
    parser.add_argument("--rods", type=int, default=65_536, help="in the large batches")
    parser.add_argument("--rounds", type=int, default=3, help="measurements of which the median counts")
    parser.add_argument("--threads", type=int, help="of the kernels; one per processor by default")
    parser.add_argument("--scaling", action="store_true", help="also over rods, edges and threads; takes minutes")
    parser.add_argument("--out", type=Path, help="folder for bench.json and pictures")
    options = parser.parse_args(arguments)
    if min(options.rods, options.rounds, options.threads or 1) < 1:
        parser.error("--rods, --rounds and --threads need to be 1 or more")
    return options


def measured(options: argparse.Namespace) -> dict:
    """Run all steps, with their progress on standard error. Raises InterruptedRunError where a process of its own fails."""
    rods = Specimens(options.rods)
    summary = begun(rods, options.rounds, options.threads)
    threads = summary["machine"]["threads"]
    with process.Children(lambda: (rods.many.starts, rods.many.clamps)) as children:
        steps = [*case_steps(cases(rods), Reference(threads)), accuracy_step(rods), *_processes(children, options, threads)]
        if options.scaling:
            steps += _scaling(rods)
        return completed({**summary, "process": {}}, steps)


def draw(folder: Path, summary: dict) -> None:
    """histogram.png, and scaling.png where scaling was measured."""
    lines = {}
    for name, histogram in large_batches(summary["cases"]).items():
        counts = np.array(histogram)
        lines[name] = (np.arange(len(counts)), 100 * counts / counts.sum())
    panel = Panel("", "iterations", "share of the rods [%]", lines)
    title = f"iterations of {summary['rods']} rods"
    write_whole(folder / "histogram.png", lambda file: panels_picture(file, [panel], title))
    if "scaling" in summary:
        found = summary["machine"]
        panels = scaling.panels(**summary["scaling"], threads=summary["process"]["threads"])
        title = f"{found['processor']}, {found['cores']} cores, {found['threads']} threads"
        write_whole(folder / "scaling.png", lambda file: panels_picture(file, panels, title))


def _processes(children: process.Children, options: argparse.Namespace, threads: int) -> list[Step]:
    """Start-up, memory and threads, each in processes of its own."""
    def entered(name: str, unit: str, measure: Callable[[], float | None], summary: dict) -> str:
        value = summary["process"][name] = measure()
        return "–" if value is None else f"{value:.3g} {unit}"

    def threaded(count: int, summary: dict) -> str:
        rate = children.rods_per_second(count, options.rods, CALLS_IN_ROUND * options.rounds)
        summary["process"].setdefault("threads", []).append({"threads": count, "rods_per_second": rate})
        return f"{rate:,.0f} rods/s"

    counts = scaling.thread_counts(threads) if options.scaling else sorted({1, threads})
    return [
        ("import", partial(entered, "import_s", "s", children.import_seconds)),
        ("first relaxation", partial(entered, "first_relaxation_s", "s", children.process_seconds)),
        ("from the cache", partial(entered, "cached_relaxation_s", "s", children.process_seconds)),
        ("memory", partial(entered, "bytes_per_rod", "B", partial(children.bytes_per_rod, options.rods))),
        ("memory over calls", partial(entered, "growth_kb_per_call", "kB",
                                          partial(children.growth_kb_per_call, process.CALLS))),
        *((f"threads: {count}", partial(threaded, count)) for count in counts),
    ]


def _scaling(rods: Specimens) -> list[Step]:
    def point(axis: str, measure: Callable, count: int, summary: dict) -> str:
        found = measure(rods.many, count)
        summary.setdefault("scaling", {}).setdefault(axis, []).append(
            {**asdict(found), "rods_per_second": found.rods_per_second})
        return f"{found.rods_per_second:,.0f} rods/s"

    return [(f"{count} {axis}", partial(point, axis, measure, count))
            for axis, measure, counts in (("rods", scaling.with_rods, scaling.RODS),
                                          ("edges", scaling.with_edges, scaling.EDGES)) for count in counts]


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
