"""The same calls on the CPU and on a GPU: whether they find the same, and how long each takes.

    python tools/studies/compare_architectures.py [CASE ...] [--rods N] [--rounds N] [--limit SECONDS] [--report FILE]

Every case runs in a process of its own on either architecture, NumPy in to NumPy out: once with the compilation of its kernels,
then a few times. The table names the seconds of the first call, the rate of the fastest call after it, and how far apart
the shapes of rods that converged on both lie: the median and the largest, as a share of the length. Rods under contact may
have several minima, and rounding may decide between them; they are counted apart. Exit code 1 where a case fails on the GPU.
"""

import argparse
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
if not __package__:
    sys.path.insert(0, str(ROOT))

from doo_ti import Itself, relax  # noqa: E402
from doo_ti.bench import cases as plain  # noqa: E402
from doo_ti.bench.clock import machine, timed  # noqa: E402
from doo_ti.dynamics.parameters import Dynamics, Stepping  # noqa: E402
from doo_ti.dynamics.simulate import simulate  # noqa: E402
from doo_ti.groups.relax_group import relax_group  # noqa: E402
from doo_ti.relaxation.descent import Descent  # noqa: E402
from doo_ti.relaxation.sensitivity import sensitivity  # noqa: E402
from doo_ti.rod.types import Clamp, Configuration, Solution  # noqa: E402
from doo_ti.system.files import write_text  # noqa: E402
from doo_ti.vision.reprojection.score import score  # noqa: E402
from tools import contact_motions  # noqa: E402
from tools.bench import contact, scoring  # noqa: E402
from tools.studies import group_study  # noqa: E402

ARCHITECTURES = ("cpu", "cuda")
SAME = 1e-3
"""Of the length: rods nearer than this are in the same minimum."""
FRAMES = 10
"""Of a motion."""


@dataclass(frozen=True)
class Found:
    """What a case found: (R, …) numbers, of shapes in units of the rod's length, and (R,) whether each may be compared."""

    values: np.ndarray
    converged: np.ndarray


Prepared = Callable[[], Found]
"""A call, after everything has been made that is not part of it."""


def shapes(solution: Solution) -> Found:
    return Found(in_lengths(solution.configuration), solution.converged)


def in_lengths(rods: Configuration) -> np.ndarray:
    """Their vertices over the length of the longest."""
    return rods.vertices / np.sum(rods.rest_length, axis=-1).max()


def at_rest(name: str, precision: str) -> Callable[[int], Prepared]:
    def prepare(count: int) -> Prepared:
        rods = getattr(plain.Specimens(count), name)
        return lambda: shapes(rods.relaxed(plain.COARSE if precision == "f32" else plain.FINE, precision))
    return prepare


def descended(count: int) -> Prepared:
    rods = plain.Specimens(max(1, count // 64)).many
    return lambda: shapes(rods.relaxed(Descent(tolerance=1e-3, max_iterations=20_000), "f32"))


def differentiated(count: int) -> Prepared:
    solution = plain.Specimens(max(1, count // 8)).many.relaxed(plain.FINE, "f64")

    def run() -> Found:
        slopes = sensitivity(solution)
        largest = np.abs(slopes.vertices).max(axis=(1, 2), keepdims=True)
        return Found(slopes.vertices / largest, slopes.usable)
    return run


def scored(count: int) -> Prepared:
    rods = scoring.Specimens(count)
    hypotheses, images = rods.hypotheses.astype(np.float32), rods.images

    def run() -> Found:
        total = score(hypotheses, images, rods.sets, rods.rig, scoring.NU, scoring.MATERIAL).total
        return Found(total[:, None] / np.median(total), np.ones(count, dtype=bool))
    return run


def on_images(count: int) -> Prepared:
    rods = scoring.Specimens(max(1, count // 16))
    start, clamps = rods.grown(scoring.EDGES)
    return lambda: shapes(relax(start, scoring.MATERIAL, clamps, scoring.SEARCH, precision="f32", external=rods.external,
                                external_index=rods.sets))


def on_a_table(which: str, precision: str) -> Callable[[int], Prepared]:
    def prepare(count: int) -> Prepared:
        rods, material, clamps = getattr(contact.Specimens(max(1, count // 16)), which)
        return lambda: shapes(relax(rods, material, clamps, precision=precision, obstacles=contact.obstacles(),
                                    radius=contact.RADIUS))
    return prepare


def moved(quasi_static: bool, among: str) -> Callable[[int], Prepared]:
    def prepare(count: int) -> Prepared:
        rest, material, grippers = contact_motions.drawn(np.random.default_rng(0), max(1, count // 128), among == "itself")
        rows = np.flatnonzero(rest.converged)
        start, material, held = rest.configuration.take(rows), material.take(rows), grippers.take(rows).until(FRAMES)
        bodies = {"nothing": [], "pegs": contact_motions.obstacles(), "itself": [Itself(friction=0.2)]}[among]
        stepping = Stepping(rate=10.0, quasi_static=quasi_static)

        def run() -> Found:
            path = simulate(start, material, held, Dynamics(), stepping, obstacles=bodies,
                            radius=contact_motions.RADIUS if bodies else None)
            return Found(path.positions / contact_motions.LENGTH, path.converged)
        return run
    return prepare


def grouped(count: int) -> Prepared:
    group = group_study.drawn(np.random.default_rng(0), max(1, count // 512), Clamp.FRAME, True)

    def run() -> Found:
        solution = relax_group(group, radius=group_study.RADIUS)
        points = np.concatenate([in_lengths(rod) for rod in solution.group.rods], axis=1)
        return Found(points, solution.converged)
    return run


CASES: dict[str, Callable[[int], Prepared]] = {
    "relax, f32": at_rest("many", "f32"),
    "relax, f64": at_rest("many", "f64"),
    "relax, mixed": at_rest("many", "mixed"),
    "relax, general B, f32": at_rest("band", "f32"),
    "relax, springs, f32": at_rest("pulled", "f32"),
    "relax, descent, f32": descended,
    "sensitivity, f64": differentiated,
    "score, f32": scored,
    "relax on images, f32": on_images,
    "table and pegs, laid down, f32": on_a_table("laid_down", "f32"),
    "table and pegs, moved on, f32": on_a_table("moved_on", "f32"),
    "table and pegs, moved on, f64": on_a_table("moved_on", "f64"),
    "motion with inertia, f64": moved(False, "nothing"),
    "motion past pegs, f64": moved(True, "pegs"),
    "coiling, f64": moved(True, "itself"),
    "groups, f64": grouped,
}


def one(name: str, count: int, rounds: int, out: Path) -> None:
    """Run a case in this process, and write what it found and how long it took."""
    run = CASES[name](count)
    first, found = timed(run)
    best = min(timed(run)[0] for _ in range(rounds))
    np.savez(out, values=found.values, converged=found.converged, seconds=np.array([first, best]))


def in_a_process(name: str, architecture: str, options: argparse.Namespace, out: Path) -> str:
    """Run a case there: why it failed, or nothing."""
    words = [sys.executable, str(Path(__file__).resolve()), name, "--rods", str(options.rods), "--rounds", str(options.rounds),
             "--one", str(out)]
    try:
        done = subprocess.run(words, env={**os.environ, "DOO_TI_ARCHITECTURE": architecture}, cwd=ROOT, capture_output=True,
                              text=True, timeout=options.limit)
    except subprocess.TimeoutExpired:
        return f"not done after {options.limit:.0f} s"
    return "" if done.returncode == 0 else (done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1]


def compared(cpu: dict, cuda: dict) -> str:
    """Cells of the table."""
    both = cpu["converged"] & cuda["converged"]
    apart = np.abs(cpu["values"] - cuda["values"]).reshape(len(both), -1).max(axis=1)[both]
    same = apart[apart < SAME]
    rates = [len(both) / found["seconds"][1] for found in (cpu, cuda)]
    return (f"{len(both):,} | {cpu['seconds'][0]:.1f} | {cuda['seconds'][0]:.1f} | {rates[0]:,.0f} | {rates[1]:,.0f} | "
            f"{100 * cpu['converged'].mean():.2f} | {100 * cuda['converged'].mean():.2f} | {len(apart) - len(same)} | "
            f"{np.median(same) if len(same) else np.nan:.0e} | {same.max(initial=0.0):.0e}")


def main(words: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("cases", nargs="*", metavar="CASE", help="beginnings of their names, by default all")
    parser.add_argument("--rods", type=int, default=65_536, help="of the fastest case (default 65536); others take fewer")
    parser.add_argument("--rounds", type=int, default=3, help="calls after the first")
    parser.add_argument("--limit", type=float, default=300.0, help="seconds for a case on one architecture")
    parser.add_argument("--report", type=Path, help="file for the table, Markdown")
    parser.add_argument("--one", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args(words)
    if options.one is not None:
        one(options.cases[0], options.rods, options.rounds, options.one)
        return 0
    chosen = [name for name in CASES if not options.cases or name.startswith(tuple(options.cases))]
    lines = [f"{machine()['processor']}, {machine()['cores']} cores. Seconds of the first call, rods per second after it, % "
             f"that converge; of those that converge on both, how many are in another minimum, and the median and the largest "
             f"difference of the others, in lengths.", "",
             "| case | rods | first, CPU | first, GPU | CPU | GPU | CPU % | GPU % | other minimum | median | largest |",
             "|---" * 11 + "|"]
    print("\n".join(lines), flush=True)
    failed = False
    with tempfile.TemporaryDirectory() as folder:
        for name in chosen:
            files = [Path(folder) / f"{architecture}.npz" for architecture in ARCHITECTURES]
            why = [in_a_process(name, architecture, options, file)
                   for architecture, file in zip(ARCHITECTURES, files, strict=True)]
            failed |= bool(why[1])
            cells = "; ".join(filter(None, why)) + " |" * 9 if any(why) else compared(*(dict(np.load(file)) for file in files))
            lines.append(f"| {name} | {cells} |")
            print(lines[-1], flush=True)
    if options.report is not None:
        write_text(options.report, "\n".join(lines) + "\n")
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
