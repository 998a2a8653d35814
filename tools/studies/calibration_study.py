"""Coverage of the 95 % intervals of the default pipeline: ``python tools/studies/calibration_study.py [OPTION ...]``.

Draws specimens of the virtual lab with all parameters random, fits each with ``doo-ti sweep`` and ``doo-ti refine
RUN``, and prints a Markdown table of coverage, bias and width for bend, twist and their ratio. FOLDER/calibration.png shows
every interval over the truth. Exit code 1 where a coverage is outside 90–99 % or a fit failed.

FOLDER/specimens.jsonl keeps a line for each specimen. Specimens that are already there are not computed again: after a change
of the estimator use another folder.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Lock

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the commands set it, before NumPy reads it

import numpy as np  # noqa: E402

if not __package__:
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from doo_ti.io.observation_files import save_observations  # noqa: E402
from doo_ti.system.terminal import progress  # noqa: E402
from tools.studies.calibration.coverage import NAMES, Interval, coverage, table  # noqa: E402
from tools.studies.calibration.picture import calibration_picture  # noqa: E402
from tools.studies.calibration.specimens import specimen  # noqa: E402

SEED = 2011
GRID = ("--bend", "5e4:1e7:25", "--twist-ratio", "0.1:6:25")
MAKING = Lock()
"""Specimens are made in this process, one after the other, and fitted in processes of their own."""


def studied(seed: int) -> dict:
    """One specimen, made, and fitted by the commands: its truth, and the parameters that ``refine`` reports."""
    with MAKING:
        made = specimen(seed)
    began = time.perf_counter()
    recipe, row = made.recipe, {"seed": seed, "redrawn": made.redrawn, "failure": "", "parameters": []}
    row["truth"] = {"bend": recipe.bend, "twist": recipe.twist, "twist_ratio": recipe.twist / recipe.bend}
    with tempfile.TemporaryDirectory() as folder:
        file, run = Path(folder) / "specimen.npz", Path(folder) / "run"
        save_observations(file, made.observations)
        for words in (["sweep", file, *GRID, "--out", run, "--json"], ["refine", run, "--no-models", "--json"]):
            done = subprocess.run([sys.executable, "-m", "doo_ti", *map(str, words)], capture_output=True, text=True,
                                  env={**os.environ, "DOO_TI_PINNED": "0"})
            if done.returncode:
                said = (done.stderr.strip().splitlines() or ["no message"])[-1]
                row["failure"] = f"doo-ti {words[0]} ended with {done.returncode}: {said}"
                break
        else:
            row["parameters"] = json.loads(done.stdout)[0]["parameters"]
    return {**row, "seconds": time.perf_counter() - began}


def completed(file: Path, seeds: range, workers: int) -> list[dict]:
    """The row of each seed, from the file where it is there, else computed and added to it at once."""
    lines = file.read_text(encoding="utf-8").splitlines() if file.is_file() else []
    known = {row["seed"]: row for row in map(json.loads, lines)}
    todo = [seed for seed in seeds if seed not in known]
    with progress(keep=True) as bar, ThreadPoolExecutor(workers) as pool, file.open("a", encoding="utf-8") as out:
        task = bar.add_task("specimens", total=len(seeds), completed=len(seeds) - len(todo), unit="specimens")
        for row in pool.map(studied, todo):
            known[row["seed"]] = row
            out.write(json.dumps(row) + "\n")
            out.flush()
            bar.advance(task)
    return [known[seed] for seed in seeds]


def intervals(rows: list[dict]) -> dict[str, list[Interval]]:
    """The intervals that were reported, by parameter."""
    return {name: [Interval(row["truth"][name], one["value"], one["low"], one["high"]) for row in rows
                   for one in row["parameters"] if one["name"] == name] for name in NAMES}


def report(rows: list[dict], picture: Path) -> int:
    """Print the table and its notes, draw the picture; the exit code."""
    found, failed = intervals(rows), [row for row in rows if row["failure"]]
    covered, seconds = {name: coverage(some) for name, some in found.items()}, [row["seconds"] for row in rows]
    print(f"{len(rows)} specimens, seeds {rows[0]['seed']} … {rows[-1]['seed']}; {sum(row['redrawn'] for row in rows)} draws "
          f"could not be synthesised and were replaced; 'n of m': n of m such intervals hold the truth\n\n{table(covered)}\n\n"
          f"wall time per specimen, sweep and refinement: median {np.median(seconds):.1f} s, largest {max(seconds):.1f} s")
    for row in failed:
        print(f"failed: seed {row['seed']}: {row['failure']}")
    drawn = {name: some for name, some in found.items() if some}
    if drawn:
        calibration_picture(picture, drawn, title=f"95 % intervals of {len(rows) - len(failed)} specimens")
    # A ratio that is not reported does not affect the exit code; bend and twist always do.
    judged = [one for name, one in covered.items() if one.all.total or name != "twist_ratio"]
    return int(bool(failed) or not all(one.accepted for one in judged))


def main(words: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--specimens", type=int, default=100, metavar="N", help="how many (default 100)")
    parser.add_argument("--seed", type=int, default=SEED, metavar="S", help=f"of the first; the others follow (default {SEED})")
    parser.add_argument("--workers", type=int, default=1, metavar="N", help="fits at a time, which share the processors")
    parser.add_argument("--out", type=Path, default=Path("runs/calibration"), metavar="FOLDER", help="default runs/calibration")
    options = parser.parse_args(words)
    if min(options.specimens, options.seed + 1, options.workers) < 1:
        parser.error("--specimens and --workers: give 1 or more, --seed: 0 or more")
    options.out.mkdir(parents=True, exist_ok=True)
    rows = completed(options.out / "specimens.jsonl", range(options.seed, options.seed + options.specimens), options.workers)
    return report(rows, options.out / "calibration.png")


if __name__ == "__main__":
    raise SystemExit(main())
