"""This machine. ``bench``: throughput and accuracy of relaxations, as JSON and as Markdown: a table of the cases, and below it
what the figures are made of. ``warm``: kernels compiled before they are needed: each command that has any is run on a small
input, in a process of its own, whose kernels Taichi keeps for the next ones.
"""

import math
import os
import subprocess
import sys
import time
from argparse import Namespace
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from tempfile import TemporaryDirectory

from doo_ti.commands import given, results
from doo_ti.system.arguments import counted
from doo_ti.system.errors import InputError
from doo_ti.system.files import write_text
from doo_ti.system.terminal import ended, in_line, kept_from_children, progress

RODS, ROUNDS = 65_536, 3
MOST_ROUNDS = 1000
MOST_RODS = 1 << 22  # four times as many are relaxed at once to measure the memory they need: some 20 GB


def declare(add) -> None:
    parser = given.command(add, "bench", run_bench, "measure throughput and accuracy on this machine, in one table")
    given.add(parser, "--rods", "N", given.whole(1, MOST_RODS), "rods in the large batches", RODS)
    given.add(parser, "--threads", "N", given.whole(1, os.cpu_count() or 1), "threads of the kernels (default: one per "
              "processor)")
    given.add(parser, "--rounds", "N", given.whole(1, MOST_ROUNDS), "number of measurements; their median is printed", ROUNDS)
    given.add(parser, "--out", "FOLDER", given.folder, "folder for bench.json (default: not written)")
    parser = given.command(add, "warm", run_warm, "compile the kernels of commands now, so that their first use does not wait")
    parser.add_argument("commands", nargs="*", metavar="COMMAND",
                        help=f"those whose kernels to compile: {', '.join(STEPS)} (default: all); those of obstacles depend "
                        "on their kinds and are compiled at their first use")


def run_bench(options: Namespace) -> int:
    from doo_ti.lab.cases import benchmark

    summary = benchmark(options.rods, options.rounds, options.threads)
    if options.out is not None:
        results.save_json(options.out / "bench.json", summary)
    results.report(options, summary, lambda: [text(summary)])
    return 0


def text(summary: dict) -> str:
    """Markdown of a summary."""
    found, versions = summary["machine"], ", ".join(f"{name} {number}" for name, number in summary["versions"].items())
    machine = (f"{found['processor']}, {counted(found['cores'], 'core')}, {counted(found['threads'], 'thread')}"
               f"{'' if found['architecture'] == 'cpu' else ', ' + found['architecture']}; {versions}; "
               f"batches of {summary['rods']}, rods of 33 edges, medians of {summary['rounds']}")
    heads = ["case", "per second", "ratio ·10⁶", "converged", "stable", "iterations", "residual", "lanes busy"]
    lines = [[name, f"{case['per_second']:,.0f} {case['unit']}", f"{1e6 * case['ratio']:.4g}", percent(case["converged"]),
              percent(case["stable"]), f"{case['iterations']:.1f}" if case["iterations"] else "–",
              "–" if case["residual"] is None else f"{case['residual']:.0e} /mm", percent(case["busy"])]
             for name, case in summary["cases"].items()]  # a dash where a figure does not apply
    widths = [max(map(len, column)) for column in zip(heads, *lines, strict=True)]
    rows = [heads, ["-" * width for width in widths], *lines]
    table = "\n".join("| " + " | ".join(map(str.ljust, row, widths)) + " |" for row in rows)
    accuracy = summary["f32_against_f64"]
    return "\n\n".join([
        machine, table,
        "- ratio: to the multiply-adds per second of NumPy's dot products in the same round; compare this one where other work "
        f"shares the machine\n- f32 against f64: {percent(accuracy['same_minimum'])} of {accuracy['rods']} rods in the same "
        f"minimum, there {accuracy['median_mm']:.1e} mm apart (median), {accuracy['percentile_99_mm']:.1e} mm (99th "
        "percentile)"])


def percent(share: float | None) -> str:
    """A share in per cent, rounded down: only a share of 1 is printed as 100 %."""
    return "–" if share is None else "100 %" if share == 1 else f"{math.floor(1e4 * share + 1e-6) / 100:.2f} %"


# --- warm ----------------------------------------------------------------------------------------------------------------

AT_ONCE = 2  # processes. Taichi compiles in one thread, and what two compile at the same time both compile
MATERIAL = "--bend 4e5 --twist 4e5"
LAB, SEEN = "synth lab.toml --out lab.npz", f"--rig images/rig.yaml --rest-length 3:33 {MATERIAL} --no-recording"
IMAGES = "synth seen.toml --images images --rig scenes/rig.yaml"
STEPS = {
    "relax": (LAB, f"relax lab.npz {MATERIAL} --out many.npz", "convert lab.npz one.npz --select 0:1",
              f"relax one.npz {MATERIAL} --out one_relaxed.npz"),
    "perceive": (IMAGES, f"perceive {SEEN} --sets images/sets.csv --no-picture --out rods.npz",
                 f"perceive --rig images/rig.yaml {MATERIAL} --sets clicked.csv --no-picture --no-recording --out found.npz"),
    "sweep": (LAB, "sweep lab.npz --bend 2e5:8e5:3 --out run"),
    "group": ("group hooked_slings --out group.npz",),
    "refine": (LAB, f"refine lab.npz {MATERIAL} --rest-curvature none --clip 1.5 --clamps exact --no-models"),
    "simulate": ("simulate moving.toml --out moved.npz",),
    "track": (IMAGES, f"track {SEEN} --frames frames.csv --out video.npz"),
    "identify": ("simulate moving.toml --out moved.npz", "identify moved.npz --bend 1e6 --modes 1 --fit drag --out theta.json"),
    "predict": (LAB, f"predict lab.npz --motion motion.csv --relative {MATERIAL} --out predicted.npz"),
    "twist": (LAB, f"twist lab.npz {MATERIAL} --out phi.npz"),
    "plan": ("plan lab.toml --twist 4e5",),
}
"""Of each command with kernels the commands that compile them, those first that take longest."""
_LAB_SCENE = """{}[synthesis]
bend = 4e5
twist = 4e5
end_distances_mm = {}
end_rotations_deg = {}
[grid]
bend = "2e5:8e5:3"
"""
INPUTS = {
    "lab.toml": _LAB_SCENE.format('clamp_start = "frame"\nclamp_end = "frame"\n', [54, 66, 78], [30, 60, 90, 120]),
    "seen.toml": _LAB_SCENE.format("", [66], [60]),
    "moving.toml": """rate_hz = 50
duration_s = 0.4
[rod]
length_mm = 500.0
edges = 12
[materials.rope]
bend = 1e6
drag_per_s = 0.2
[clamps]
start = "frame"
end = "frame"
[[moments]]
time_s = 0.0
end_position_mm = [400.0, 0.0, 0.0]
[[moments]]
time_s = 0.4
end_position_mm = [420.0, 0.0, 0.0]
""",
    "frames.csv": """frame,front,left,seed_x,seed_y,seed_z,dir_x,dir_y,dir_z
1,images/seen_66mm_060deg_front.jpg,images/seen_66mm_060deg_left.jpg,0,0,0,0.94,0,0.34
2,images/seen_66mm_060deg_front.jpg,images/seen_66mm_060deg_left.jpg,,,,,,
""",
    "clicked.csv": """name,front,left,left_u,left_v
one,images/seen_66mm_060deg_front.jpg,images/seen_66mm_060deg_left.jpg,478,516
""",
    "motion.csv": "time_s,end_x,end_y,end_z\n0,0,0,0\n1,1,0,0\n",
}


def run_warm(options: Namespace) -> int:
    if unknown := next((name for name in options.commands if name not in STEPS), None):
        raise InputError(given.SOURCE, "COMMAND", f"{unknown!r} has no kernels", f"give some of {', '.join(STEPS)}")
    names = [name for name in STEPS if not options.commands or name in options.commands]
    seconds, failed, processes = {}, {}, []
    with (TemporaryDirectory(ignore_cleanup_errors=True) as folder, progress() as bar, ThreadPoolExecutor(AT_ONCE) as threads):
        task = bar.add_task("compiling", total=len(names), unit="commands")
        found = threads.map(lambda name: _warmed(name, Path(folder) / name, processes), names)
        try:
            for name, (taken, problem) in zip(names, found, strict=True):
                seconds[name] = taken
                if problem is not None:
                    failed[name] = problem
                bar.advance(task)
        finally:
            threads.shutdown(wait=False, cancel_futures=True)
            for process in processes:
                ended(process)
    results.report(options, {"seconds": seconds, "failed": failed}, lambda: [
        f"  {name:<11} {taken:.1f} s{f', FAILED: {in_line(failed[name])}' if name in failed else ''}"
        for name, taken in seconds.items()])
    return 1 if failed else 0


def _warmed(name: str, folder: Path, processes: list[subprocess.Popen]) -> tuple[float, str | None]:
    """Run the steps of a command in ``folder``, a process each, which are added to ``processes``: how long they took, in s, and
    why one failed."""
    began = time.monotonic()
    for file, content in INPUTS.items():
        write_text(folder / file, content)
    for step in STEPS[name]:
        with (folder / "log.txt").open("w+") as log:
            with kept_from_children():
                processes.append(process := subprocess.Popen(
                    [sys.executable, "-m", "doo_ti", *step.split()], cwd=folder, stdout=log, stderr=log,
                    env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}))
            if process.wait():
                log.seek(0)
                return time.monotonic() - began, [f"exit code {process.returncode}", *log.read().splitlines()][-1]
    return time.monotonic() - began, None
