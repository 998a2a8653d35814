"""Results of sweeps, compared with their required values (bars).

    python tools/learning.py [ROW ...] [--data DIR] [--runs DIR]

Prints a Markdown table, ``| check | bar | measured | holds |``, and the tables behind it. Exit code 1 where a bar is missed.

    effort   three materials, 60 observations, 50 x 50 cells, both objectives: the whole commands
    table1   training and test by material
    table2   by material and end distance
    table3   by objective and end distance, and a scene in which rods jump
    plan     the least and the most informative configurations
"""

import argparse
import csv
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
if not __package__:
    sys.path.insert(0, str(ROOT))

from doo_ti import load_observations  # noqa: E402
from doo_ti.grid import Grid, parse_axis  # noqa: E402
from doo_ti.io.scene import Synthesis  # noqa: E402
from doo_ti.learning.cross_validation import Scores, cross_validate  # noqa: E402
from doo_ti.learning.landscape import read_landscape  # noqa: E402
from doo_ti.learning.partition import partition  # noqa: E402
from doo_ti.learning.score_table import text  # noqa: E402
from doo_ti.plan import plan, planned  # noqa: E402
from tools.acceptance import Check, table  # noqa: E402

SUTURES = ("nylon", "vicryl", "silk")
WIDTH = 200  # columns of text
DISTANCES = (30.0, 54.0, 78.0)  # mm, the paper's
GRID = ("--bend", "5e4:1e7:50", "--twist-ratio", "0.05:20:50")
SMALL_GRID = ("--bend", "5e4:6e5:25", "--twist-ratio", "0.1:2:25")
EFFORT = re.compile(r"([\d,]+) rods in ([\d.]+) s \(([\d,]+) rods/s, loading the kernels included\); ([\d,]+) MB")


def command(*words: str) -> tuple[str, float]:
    """(output, seconds) of a whole doo-ti process."""
    began = time.monotonic()
    done = subprocess.run([sys.executable, "-m", "doo_ti", *map(str, words)], capture_output=True, text=True, encoding="utf-8")
    if done.returncode:
        raise SystemExit(done.stderr)
    return done.stdout, time.monotonic() - began


def swept(data: Path, runs: Path, objective: str) -> str:
    """The sweeps of all sutures under one objective, by one command; those that are finished are not repeated."""
    sources = [data / f"lab_a/{name}.npz" for name in SUTURES]
    return command("sweep", *sources, *GRID, "--objective", objective, "--out", runs / objective)[0]


def effort(data: Path, runs: Path) -> list[Check]:
    checks = []
    for objective in ("static", "dynamic"):
        with tempfile.TemporaryDirectory() as folder:
            rods, seconds, rate, memory = EFFORT.search(swept(data, Path(folder), objective)).groups()
        checks.append(Check(f"3 materials × 60 observations × 50 × 50 cells, {objective}, one command", "reported",
                            f"{rods} rods in {seconds} s, {rate} rods/s, loading the kernels included, {memory} MB", True))
    return checks


def scores(data: Path, runs: Path, by: tuple[str, ...], objectives=("static",), names=SUTURES) -> Scores:
    for objective in objectives:
        swept(data, runs, objective)
    landscapes = [read_landscape(runs / objective / name) for objective in objectives for name in names]
    (found,) = partition(landscapes, by, DISTANCES if "end-distance" in by else ())
    result = cross_validate(found)
    print(text(result, WIDTH), end="\n\n")
    return result


def near_diagonal(found: Scores, share: float) -> np.ndarray:
    """(P,) columns whose diagonal is within ``share`` or one standard error of the best entry."""
    best = found.mean.min(axis=0)
    error = found.standard_error[found.mean.argmin(axis=0), np.arange(len(best))]
    diagonal = np.diag(found.mean)
    return (diagonal <= best * (1 + share)) | (diagonal <= best + error)


def table1(data: Path, runs: Path) -> list[Check]:
    found = scores(data, runs, ("material",))
    near = near_diagonal(found, 0.0)
    return [Check("Table I: columns with the diagonal best or within one standard error of it", "3 of 3",
                  f"{near.sum()} of 3: {', '.join(f'{value:.3f}' for value in np.diag(found.mean))} mm", near.all())]


def table2(data: Path, runs: Path) -> list[Check]:
    near = near_diagonal(scores(data, runs, ("material", "end-distance")), 0.07)
    return [Check("Table II, 30, 54, 78 mm: columns with the diagonal within 7 % or one standard error of the best", "≥ 8 of 9",
                  f"{near.sum()} of {len(near)}", near.sum() >= 8)]


def table3(data: Path, runs: Path) -> list[Check]:
    checks = []
    for name in SUTURES:
        found = scores(data, runs, ("objective", "end-distance"), ("static", "dynamic"), (name,))
        count = len(DISTANCES)
        static, dynamic = (found.mean[k : k + count, count:].diagonal() for k in (0, count))
        error = found.standard_error[count:, count:].diagonal()
        holds = dynamic <= static + error
        figures = ", ".join(f"{a:.2f} against {b:.2f} ± {e:.2f}" for a, b, e in zip(dynamic, static, error, strict=True))
        checks.append(Check(f"Table III, {name}: learned on Eq. 3 against learned on Eq. 2, tested on Eq. 3, same distance",
                            "not worse beyond one standard error", f"{figures} mm", holds.all()))
    return [*checks, jumping(data, runs)]


def jumping(data: Path, runs: Path) -> Check:
    """Silk carried only in the recorded direction: in the other direction it would follow other branches."""
    observations = load_observations(data / "lab_a/silk.npz")
    distance, rotation = observations.end_distance, observations.end_rotation
    forward = (distance[:, None] == distance) & np.isclose(rotation - rotation[:, None], 120.0)
    runs.mkdir(parents=True, exist_ok=True)
    pairs = runs / "forward.csv"
    with pairs.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["from", "to", "rotation_deg"])
        writer.writerows([*pair, 120] for pair in np.argwhere(forward).tolist())
    landscapes = []
    for objective, more in (("static", ()), ("dynamic", ("--pairs", pairs))):
        run = runs / "forward" / objective
        command("sweep", data / "lab_a/silk.npz", *SMALL_GRID, "--objective", objective, *more, "--out", run)
        landscapes.append(read_landscape(run))
    (found,) = partition(landscapes, ("objective",))
    result = cross_validate(found)
    print(text(result, WIDTH), end="\n\n")
    (_, static), (_, dynamic) = result.mean
    error, (before, after) = result.standard_error[0, 1], result.jumped[:, 1]
    return Check("rods that jump: silk carried as recorded, learned on Eq. 3 against Eq. 2, tested on Eq. 3",
                 "clearly better (beyond one standard error)",
                 f"{dynamic:.3f} against {static:.3f} ± {error:.3f} mm; {after} against {before} of {result.count[0, 1]} jump",
                 dynamic < static - error)


def plans(data: Path, runs: Path) -> list[Check]:
    grid = Grid((parse_axis("--bend", "5e4:1e7:13"), parse_axis("--twist-ratio", "0.1:6:9")))
    lab = load_observations(data / "lab_a/nylon.npz")
    least = plan(lab, grid, sigma=0.12).least
    label = f"{lab.end_distance[least]:g} mm, {lab.end_rotation[least]:g}°"
    line = planned(Synthesis(bend=1.8e6, twist=1.2e6, start_direction=(1, 0, 0), end_direction=(1, 0, 0)))
    found = plan(line, grid, sigma=0.12)
    order = np.argsort(found.total)
    untwisted = [f"{line.end_distance[k]:g} mm, {line.end_rotation[k]:g}°" for k in order[line.end_rotation[order] == 0][:4]]
    twisted = order[line.end_rotation[order] > 0][0]
    other = f"{line.end_distance[twisted]:g} mm, {line.end_rotation[twisted]:g}°"
    return [
        Check("plan: the least informative configuration of lab_a nylon", "42 mm, 120°", label, label == "42 mm, 120°"),
        Check("plan: the same, clamps on one line, among rods that are turned", "54 mm, 120°",
              f"{other}; untwisted arches are even less informative: {'; '.join(untwisted)}", other == "54 mm, 120°"),
    ]


ROWS: dict[str, Callable[[Path, Path], list[Check]]] = {
    "effort": effort, "table1": table1, "table2": table2, "table3": table3, "plan": plans,
}


def main(arguments: list[str]) -> int:
    parser = argparse.ArgumentParser(prog="learning.py", description=__doc__.splitlines()[0])
    parser.add_argument("rows", nargs="*", metavar="ROW", help=f"of {', '.join(ROWS)}; all by default")
    parser.add_argument("--data", type=Path, default=ROOT.parent / "shared" / "data")
    parser.add_argument("--runs", type=Path, help="folder to keep the sweeps in (default: thrown away)")
    options = parser.parse_args(arguments)
    unknown = [row for row in options.rows if row not in ROWS]
    if unknown:
        parser.error(f"no row is named {unknown[0]}; there are {', '.join(ROWS)}")
    if not options.data.exists():
        print(f"skipped: no data at {options.data}")
        return 0
    with tempfile.TemporaryDirectory() as folder:
        runs = options.runs or Path(folder)
        checks = [check for row in options.rows or ROWS for check in ROWS[row](options.data, runs)]
    print(table(checks))
    return int(not all(check.holds for check in checks))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
