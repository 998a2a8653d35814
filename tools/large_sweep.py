"""Time and memory of a sweep of many rods, and of the same command repeated when it is finished.

    python tools/large_sweep.py [--values 648] [--workers N] [--folder FOLDER]

48 observations of the virtual lab under VALUES × VALUES cells: 648 are 2·10⁷ rods. Memory is the largest resident set. Give an
empty folder: an existing sweep is resumed. Exit code 1 where a bar is missed.
"""

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SCENE = """[synthesis]
bend = 4e5
twist = 4e5
end_distances_mm = [36.0, 42.0, 48.0, 54.0, 60.0, 66.0]
end_rotations_deg = [0.0, 30.0, 60.0, 90.0, 120.0, 150.0, 180.0, 210.0]
[grid]
bend = "1e5:1e6:{values}"
twist_ratio = "0.5:2:{values}"
"""
MOST_MB, MOST_SECONDS = 700, 2.0
"""Of memory in a sweep, and from beginning to end of one that is finished."""


@dataclass(frozen=True)
class Cost:
    """What a command took: seconds on the clock and of processors, MB of its own process, and of the largest of it and its
    workers."""

    seconds: float
    processor: float
    own: int
    largest: int


def swept(folder: Path, values: int, workers: int) -> Cost:
    """The cost of the sweep's command, whatever is done already."""
    scene = folder / "scene.toml"
    scene.write_text(SCENE.format(values=values))
    words = [sys.executable, "-m", "doo_ti", "sweep", str(scene), "--out", str(folder / "run"),
             *(["--workers", str(workers)] if workers else [])]
    began = time.monotonic()
    with tempfile.TemporaryFile("w+") as output:
        process = subprocess.Popen(words, env={**os.environ, "PYTHONPATH": str(ROOT)}, stdout=output)
        _, status, used = os.wait4(process.pid, 0)
        seconds, process.returncode = time.monotonic() - began, os.waitstatus_to_exitcode(status)
        output.seek(0)
        printed = output.read()
    if process.returncode:
        raise SystemExit(f"the sweep failed, exit code {process.returncode}")
    own = re.search(r"([\d,]+) MB of memory at most", printed)
    return Cost(seconds, used.ru_utime + used.ru_stime, int(own[1].replace(",", "")), used.ru_maxrss // 1024)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--values", type=int, default=648, help="of each of the grid's two axes")
    parser.add_argument("--workers", type=int, default=0)
    parser.add_argument("--folder", type=Path, help="where the run is kept (default: a temporary folder, which goes)")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.folder or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        costs = {"sweep": swept(folder, options.values, options.workers)}
        # The first repetition may wait for the disk.
        costs |= {f"repeated, {count}": swept(folder, options.values, options.workers) for count in ("once", "twice")}
        run = folder / "run"
        rods = json.loads((run / "summary.json").read_text())["rods"]["count"]
        size = sum(path.stat().st_size for path in run.rglob("*") if path.is_file())
    print(f"{rods:,} rods; {size / 1e6:,.0f} MB in files, {size / rods:.1f} B a rod\n")
    print("| command | time [s] | processor time [s] | memory [MB] | largest process [MB] |")
    print("|---|--:|--:|--:|--:|")
    for name, cost in costs.items():
        print(f"| {name} | {cost.seconds:.2f} | {cost.processor:.2f} | {cost.own} | {cost.largest} |")
    again = min(cost.seconds for name, cost in costs.items() if name != "sweep")
    good = costs["sweep"].own <= MOST_MB and again <= MOST_SECONDS
    print(f"\nbars: {MOST_MB} MB, repeated within {MOST_SECONDS:g} s: {'held' if good else 'missed'}")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
