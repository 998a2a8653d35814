"""How well ``doo-ti refine`` knows the stiffness of cables and sutures from marks:
``python tools/studies/marks_study [SET ...]``.

Each specimen is a continuum rod (rod.py), measured as people measure (specimens.py), and fitted with the commands of the
README: ``sweep``, then ``refine RUN``. A line of JSON per fit goes to FOLDER/rows.jsonl; fits that are there are not repeated.

    all          random nuisances, families in turn (default)
    none         no nuisance at all, small specimens, as those that follow
    only:NAME    this nuisance alone: spacing, clip, frames, chord, missing, mislabel, curvature, uneven, turns
    leave        small specimens with random nuisances, each pose left out in turn
"""

import argparse
import contextlib
import io
import json
import math
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from doo_ti.commands.cli import main as doo_ti
from tools.studies.marks_study.specimens import FAMILIES, SOMETIMES, Recipe, drawn, specimen

GRIDS = {"cable": "1e-5:1e-1:25", "suture": "1e-9:1e-5:17"}  # N m², of EI
HEADER = ("| set | family | parameter | truth inside | not determined | open on a side | no answer | not converged "
          "| median factor | median high/low | median s |\n|" + "---|" * 11)


@dataclass(frozen=True)
class Job:
    group: str
    family: str
    seed: int

    @property
    def key(self) -> str:
        return f"{self.group} {self.family} {self.seed}"


def recipe_of(job: Job) -> Recipe:
    kind, _, name = job.group.partition(":")
    if kind == "all":
        return drawn(job.family, job.seed)
    if kind == "leave":
        return drawn(job.family, job.seed, small=True)
    recipe = drawn(job.family, job.seed, (name,) if name else (), small=True)
    return replace(recipe, frames_given=True) if name == "frames" else recipe


def command(*words: object) -> tuple[int, str]:
    """Exit code and all that a command printed."""
    out = io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(out):
        code = doo_ti([str(word) for word in words])
    return code, out.getvalue()


def source(recipe: Recipe, folder: Path) -> list[object]:
    """The file of marks with the options that say how to read it."""
    lengths = ["--rest-length", folder / "spacing.txt"] if recipe.spacings_stated else []
    if recipe.frames_given:
        return [folder / "marks.npz", *lengths]
    return [folder / "marks.csv", "--unit", "m", "--up", recipe.up, "--columns", "observation=pose,vertex=mark", *lengths]


def result(folder: Path, code: int, text: str, began: float) -> dict:
    """What ``refine`` found, from its ``--out``."""
    row = {"code": code, "text": text, "seconds": round(time.perf_counter() - began, 2)}
    if code == 0:
        found = json.loads((folder / "out.json").read_text())[0]
        row |= {key: found.get(key) for key in ("converged", "sensitive", "advice", "not_determined")}
        for name in ("EI", "GJ"):
            row[name] = (found["stiffness"] or {}).get(f"{name}_Nm2")
    return row


def fit(recipe: Recipe, folder: Path) -> dict:
    marks = source(recipe, folder)
    twist = ["--twist-ratio", "0.25:4:5"] if recipe.frames_given else []
    began = time.perf_counter()
    code, text = command("sweep", *marks, "--EI", GRIDS[recipe.family], *twist, "--linear-density", recipe.grams_per_metre,
                         "--out", folder / "run")
    if code:
        return result(folder, code, text, began)
    warned, began = {"warned": text}, time.perf_counter()
    code, text = command("refine", folder / "run", "--no-models", "--out", folder / "out.json")
    return warned | result(folder, code, text, began)


def left_out(recipe: Recipe, folder: Path, whole: dict) -> list[dict]:
    """EI and GJ without each pose, of the specimen in ``folder`` whose fit is ``whole``: as many folds as poses."""
    poses = [pose for pose in range(recipe.poses) if f"observation {pose} is left out" not in whole["warned"]]
    code, text = command("refine", folder / "run", "--no-models", "--folds", len(poses), "--out", folder / "folds.json")
    if code:
        return [{"code": code, "text": text}]
    found = json.loads((folder / "folds.json").read_text())[0]
    folds, all_poses = found["held_out"], found["theta"]
    rows = []
    for pose, fold in zip(poses, folds["fold"], strict=True):
        rows.append({"pose": pose})
        for name, key in (("EI", "bend_1"), ("GJ", "twist")):
            value = found["stiffness"][f"{name}_Nm2"][0]
            rows[-1][name] = [value * folds["theta"][fold][key] / all_poses[key]]
    return rows


def done(job: Job) -> dict:
    recipe = recipe_of(job)
    with tempfile.TemporaryDirectory() as name:
        folder, began = Path(name), time.perf_counter()
        try:
            truth = specimen(recipe, folder)
        except RuntimeError as error:  # its clamps have too few stable rods
            return {"key": job.key, "group": job.group, "skipped": str(error)}
        row = {"key": job.key, "group": job.group, "generated": round(time.perf_counter() - began, 2), "truth": truth}
        row |= fit(recipe, folder)
        if job.group == "leave" and row["code"] == 0:
            row["left_out"] = left_out(recipe, folder, row)
    return row


def deviation(found: list | None, truth: float) -> float | None:
    """ln(estimate / truth) over the half of the interval towards the truth, times 1.96; None where there is no interval."""
    if not found or found[0] is None:
        return None
    value, low, high = found
    side = low if truth < value else high
    return 0.0 if side is None else 1.96 * math.log(value / truth) / abs(math.log(value / side))


def outside(row: dict) -> dict[str, float]:
    """Parameter: how far, of those whose interval does not contain the truth."""
    z = {name: deviation(row.get(name), row["truth"][name]) for name in ("EI", "GJ")}
    return {name: value for name, value in z.items() if value is not None and abs(value) > 1.96}


def line(rows: list[dict], label: str, family: str, name: str) -> str | None:
    rows = [row for row in rows if row["truth"]["family"] == family and (name == "EI" or row["truth"]["frames_given"])]
    if not rows:
        return None
    answered = [row for row in rows if row["code"] == 0]
    z = [(row, deviation(row[name], row["truth"][name])) for row in answered]
    some = [(row, one) for row, one in z if one is not None]
    closed = [row for row, _ in some if None not in row[name]]
    factor = [abs(math.log(row[name][0] / row["truth"][name])) for row in closed]
    width = [row[name][2] / row[name][1] for row in closed]
    inside = sum(abs(one) <= 1.96 for _, one in some)

    def median(values):
        return f"{np.median(values):.3f}" if values else "–"

    cells = [label, family, name, f"{inside} of {len(some)}", len(z) - len(some), len(some) - len(closed),
             len(rows) - len(answered), sum(not row["converged"] for row in answered),
             median([math.exp(one) for one in factor]), median(width), median([row["seconds"] for row in answered])]
    return f"| {' | '.join(map(str, cells))} |"


def table(rows: list[dict]) -> str:
    """Markdown: each set, and in ``all`` each nuisance on and off; below it what was outside, and what leaving out moved."""
    rows = [row for row in rows if "truth" in row]
    parts = {group: [row for row in rows if row["group"] == group] for group in sorted({row["group"] for row in rows})}
    whole = parts.get("all", ())
    for name in (*SOMETIMES, "frames_given", "spacings_stated"):
        for on in (True, False):
            parts[f"all, {name} {'on' if on else 'off'}"] = [
                row for row in whole if on == row["truth"].get(name, name in row["truth"]["nuisances"])]
    lines = [line(part, label, family, name) for label, part in parts.items() for family in ("cable", "suture")
             for name in ("EI", "GJ")]
    below = [f"{row['key']}: {', '.join(f'{name} z {z:+.2f}' for name, z in outside(row).items())}; "
             f"{', '.join(row['truth']['nuisances'])}" for row in rows if outside(row)]
    below += [text for row in rows for text in moved(row)]
    return "\n".join([HEADER, *filter(None, lines), "", *below])


def moved(row: dict) -> list[str]:
    """Poses without which an estimate leaves its interval."""
    lines = []
    for part in row.get("left_out", ()):
        for name in ("EI", "GJ"):
            z = deviation(row.get(name), part[name][0]) if part.get(name) else None
            if z is not None and abs(z) > 1.96:
                mentioned = f"observation {part['pose']} " in row["text"]
                lines.append(f"{row['key']} without pose {part['pose']}: {name} × {part[name][0] / row[name][0]:.3f}, "
                             f"{abs(z) / 1.96:.2f} of the interval; {'' if mentioned else 'NOT '}mentioned")
    return lines


def main(words: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sets", nargs="*", metavar="SET", default=["all"])
    parser.add_argument("--specimens", type=int, default=100, help="of each family and set (default 100)")
    parser.add_argument("--seed", type=int, default=7000, help="the first (default 7000)")
    parser.add_argument("--families", nargs="+", choices=FAMILIES, default=FAMILIES)
    parser.add_argument("--jobs", type=int, default=1, help="processes (default 1)")
    parser.add_argument("--out", type=Path, default=Path(tempfile.gettempdir()) / "marks_study")
    options = parser.parse_args(words)
    options.out.mkdir(parents=True, exist_ok=True)
    file = options.out / "rows.jsonl"
    rows = [json.loads(line) for line in file.read_text().splitlines()] if file.exists() else []
    there = {row["key"] for row in rows}
    seeds = range(options.seed, options.seed + options.specimens)
    jobs = [Job(group, family, seed) for seed in seeds for group in options.sets for family in options.families]
    jobs = [job for job in jobs if job.key not in there]
    with ProcessPoolExecutor(options.jobs, mp_context=get_context("spawn")) as pool:
        for row in pool.map(done, jobs):
            with file.open("a") as lines:
                lines.write(json.dumps(row) + "\n")
            rows.append(row)
            print(row["key"], row.get("skipped") or f"code {row['code']}, {row['seconds']} s", file=sys.stderr, flush=True)
    print(table(rows))
    return 0
