"""Compare the solver's speed with its required values (bars), from one rod to a whole sweep.

    python tools/engine.py [ROW ...] [--data DIR]

Prints a Markdown table, ``| check | bar | measured | holds |``, and below it the details of each figure. Figures are medians;
only converged rods count. The data is that of the tests, or
--data. Exit code 1 where a bar is missed, or a row has no data.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
if not __package__:
    sys.path.insert(0, str(ROOT))

from doo_ti import Newton, Status, runtime  # noqa: E402
from doo_ti.bench import clock, peak, workload  # noqa: E402
from doo_ti.bench.cases import COARSE, FINE, Specimens, measure  # noqa: E402
from doo_ti.bench.table import machine  # noqa: E402
from doo_ti.bench.workload import SUTURES, Rods  # noqa: E402
from doo_ti.errors import InputError, InterruptedRunError  # noqa: E402
from tools import hard_set  # noqa: E402
from tools.acceptance import Check, Study, ended, in_doubles, percent, table  # noqa: E402
from tools.bench import lab, scaling  # noqa: E402
from tools.bench.cases import cases  # noqa: E402
from tools.bench.process import Children  # noqa: E402

SPEED = {"newton f32": 450_000, "newton mixed": 250_000, "newton f32 general B": 200_000, "newton f32 batches of 256": 150_000,
         "newton f32 free end, springs": 150_000}
"""Cases of :mod:`tools.bench.cases`, and the required rods/s of each."""
ONE, COLD, WARM = "newton f32 one rod", "newton f32", "newton f32 warm start"
SPREAD = 0.15
"""Allowed deviation of a size's time from the median of all sizes, as a share of it."""
FEWEST_EDGES = 33  # least number of edges compared: with fewer the constant cost per rod dominates
FLAT = 0.1  # kB a call that still count as flat: 200 kB over 2000 calls


@dataclass(frozen=True)
class Sizes:
    """Sizes of the study; smaller ones are for tests of the study."""

    observations: int = 60
    cells: int = 10
    rods: int = 65_536
    repeats: int = 5
    hard: int = 1000
    batches: tuple[int, ...] = (2**12, 2**14, 2**16, 2**18)
    edges: tuple[int, ...] = (16, 24, 33, 48, 64, 96, 128)
    rods_of_edges: int = 8192
    sweep: int = 50
    sweeps: int = 3
    calls: int = 2000


@dataclass
class Engine(Study):
    """A study of the engine, with the rods that its rows share."""

    sizes: Sizes = Sizes()

    @cached_property
    def rods(self) -> Specimens:
        """The benchmark's rods, with the lab's observations in the place of the scenes'."""
        rods = Specimens(self.sizes.rods)
        rods.sutures = [self.observations(f"lab_a/{name}") for name in SUTURES]
        rods.band = workload.paired(*self.started("ribbon"), workload.ribbon_materials(rods.count))
        return rods

    def children(self) -> Children:
        """Processes that relax the sutures' starts, with a kernel cache of their own that is still empty."""
        return Children(lambda: (self.rods.many.starts, self.rods.many.clamps))


def speed(study: Engine) -> None:
    """Rods a second, NumPy in to NumPy out, kernels warm; the processor's peak before and after."""
    found, known = {}, {case.name: case for case in cases(study.rods)}
    study.progress("speed: peak")
    before, reference = peak.peak_gflops(), clock.Reference(runtime.thread_count())
    for name in (COLD, WARM, ONE, *(name for name in SPEED if name != COLD)):
        study.progress(f"speed: {name}")
        m = found[name] = measure(known[name], reference, study.sizes.repeats)
        study.detail(f"{name}: {m.per_second:,.0f} rods/s, {sum(m.gflops.values()):.0f} GFlop/s; "
                     f"{hard_set.percent(m.converged)} converged, {hard_set.percent(m.stable)} certified stable; "
                     f"iterations mean {m.iterations:.1f}, most {len(m.histogram) - 1}; meanwhile NumPy "
                     f"{2e-9 * m.per_second / m.ratio:.1f} GFlop/s of dot products")
    after = peak.peak_gflops()
    for name, bar in SPEED.items():
        rate = found[name].per_second
        study.check(f"speed: {name}", f"≥ {bar:,} rods/s", f"{rate:,.0f} rods/s", rate >= bar)
    each = 1e3 / found[ONE].per_second
    study.check(f"speed: {ONE}", "≤ 1 ms", f"{each:.2f} ms", each <= 1)
    study.progress("speed: warm and cold in turn")
    seconds = np.median([[clock.timed(known[name].run)[0] for name in (COLD, WARM)] for _ in range(4 * study.sizes.repeats)],
                        axis=0)
    gain, fewer = seconds[0] / seconds[1], found[COLD].iterations / found[WARM].iterations
    study.check(f"speed: {WARM}, times the cold one", "≥ 2", f"{gain:.2f} ({fewer:.2f} times fewer iterations)", gain >= 2)
    study.detail("multiply-adds alone, before and after the cases: " + ("; ".join(
        f"{name} {before[name]:,.0f} and {after[name]:,.0f} GFlop/s" for name in before) or "–"))


def accuracy(study: Engine) -> None:
    """Every observation of the lab under every cell of its grid: shares of feasible rods that converge and are certified."""
    sound = {"f32": [], "mixed": []}
    for name, rods in study.searched():
        for precision, shares in sound.items():
            study.progress(f"accuracy: {name}, {precision}")
            solution = rods.relaxed(Newton(), precision)
            feasible = solution.status != Status.INFEASIBLE
            shares.append(np.stack([solution.converged, solution.converged & solution.stable])[:, feasible])
            study.detail(f"accuracy, {name}, {precision}: {ended(solution)}; iterations mean {solution.iterations.mean():.1f}, "
                         f"most {solution.iterations.max()}; {in_doubles(solution)} finished in f64")
    for precision, bar in (("f32", 0.999), ("mixed", 1.0)):
        converged, stable = np.concatenate(sound[precision], axis=1)
        study.check(f"accuracy, lab × {study.sizes.cells}×{study.sizes.cells}, {precision}: feasible rods that converge",
                    "100 %" if bar == 1 else f"≥ {100 * bar:.1f} %",
                    f"{percent(converged)} of {len(converged)}, {percent(stable)} certified stable", converged.mean() >= bar)


def hard(study: Engine) -> None:
    """The hard set in mixed precision."""
    for row in hard_set.ROWS:
        study.progress(f"hard: {row}")
        line = hard_set.measured(row, study.sizes.hard, "mixed")
        study.check(f"hard, mixed: {row}", f"≥ {100 * hard_set.BAR:.0f} %",
                    f"{hard_set.percent(line.converged)} of {line.rods}, {hard_set.percent(line.stable)} certified stable",
                    not line.falls_short)
        study.detail(f"hard, mixed, {row}: worst residual {line.residual:.1e} /mm, iterations mean {line.mean_iterations:.1f}, "
                     f"most {line.max_iterations}; {hard_set.percent(line.feasible)} feasible")


def growth(study: Engine) -> None:
    """Growth of the time with the number of rods, and with their edges."""
    sizes, held = study.sizes, (study.rods.many.starts, study.rods.many.clamps)
    study.progress("growth: rods")
    batches = [workload.paired(*held, workload.isotropic_materials(count)) for count in sizes.batches]
    seconds, converged, _ = relaxed_in_turn(batches, COARSE, "f32", sizes.repeats)
    each = dict(zip(sizes.batches, 1e6 * seconds / converged, strict=True))
    proportional(study, "time per rod, f32, of batches", "rods", each, "µs")
    study.progress("growth: edges")
    drawn = workload.isotropic_materials(sizes.rods_of_edges)
    finer = [workload.paired(scaling.refined(held[0], edges), held[1], drawn) for edges in sizes.edges]
    seconds, _, iterations = relaxed_in_turn(finer, FINE, "f64", sizes.repeats)
    each = dict(zip(sizes.edges, 1e9 * seconds / (iterations * sizes.edges), strict=True))
    proportional(study, f"time per rod, edge and iteration, f64, {sizes.rods_of_edges} rods", "edges", each, "ns", FEWEST_EDGES)


def relaxed_in_turn(batches: list[Rods], solver: Newton, precision: str, rounds: int) -> np.ndarray:
    """(3, batches): median seconds of a call, rods that converged, iterations of all rods together.

    In a round the batches alternate, so that a disturbance affects all; small ones are repeated until they have as many rods
    as the largest.
    """
    def seconds(batch: Rods) -> float:
        calls = max(1, max(rods.count for rods in batches) // batch.count)
        return sum(clock.timed(lambda: batch.relaxed(solver, precision))[0] for _ in range(calls)) / calls

    # No solution is kept: its memory is available to the next call.
    solutions = (batch.relaxed(solver, precision) for batch in batches)
    counts = [(solution.converged.sum(), solution.iterations.sum()) for solution in solutions]
    taken = np.median([[seconds(batch) for batch in batches] for _ in range(rounds)], axis=0)
    return np.vstack([taken, np.transpose(counts)])


def proportional(study: Engine, name: str, size: str, each: dict[int, float], unit: str, smallest: int = 0) -> None:
    """Add a check of the largest deviation of the times ``each`` from their median, over sizes from ``smallest`` on."""
    judged = {count: value for count, value in each.items() if count >= smallest}
    middle = np.median(list(judged.values()))
    at = max(judged, key=lambda count: abs(judged[count] / middle - 1))
    apart = judged[at] / middle - 1
    study.check(f"growth: {name}, {min(judged)} … {max(judged)} {size}", f"within {100 * SPREAD:.0f} % of the median",
                f"{100 * apart:+.1f} % at {at} {size}", abs(apart) <= SPREAD)
    study.detail(f"growth, {name}, {unit} by {size}: " + ", ".join(f"{count}: {value:.3f}" for count, value in each.items()))


def swept(study: Engine) -> None:
    """A sweep as a process, from start to end; the first, which compiles the kernels, does not count."""
    count, ranges = study.sizes.sweep, (workload.BEND_RANGE, workload.TWIST_RATIO_RANGE)
    bend, ratio = (f"{low}:{high}:{count}" for low, high in ranges)
    words = [sys.executable, "-m", "doo_ti", "sweep", str((study.data / "lab_a/nylon.npz").resolve()), "--bend", bend,
             "--twist-ratio", ratio]
    seconds = []
    for _ in range(1 + study.sizes.sweeps):
        study.progress("sweep")
        with tempfile.TemporaryDirectory() as folder:
            whole, _ = clock.timed(lambda: subprocess.run([*words, "--out", f"{folder}/run"], cwd=ROOT, check=True,
                                                          stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL))
            timing = json.loads(Path(folder, "run", "summary.json").read_text(encoding="utf-8"))["timing"]
        inside, relaxation = timing["total_s"], timing["relaxation_s"]
        seconds.append((whole, whole - inside, relaxation, inside - relaxation))
    whole, outside, relaxation, rest = zip(*seconds[1:], strict=True)
    at_most(study, f"sweep: nylon, {count}×{count} cells, the whole process", 6, whole, "{:.3g} s")
    study.detail(f"sweep: starting and ending the process {np.median(outside):.2f} s; relaxing, comparing, storing "
                 f"{np.median(relaxation):.2f} s; landscape and recording {np.median(rest):.2f} s")


def startup(study: Engine) -> None:
    """Processes that relax one rod per start and end; each round has a kernel cache of its own."""
    rounds = []
    for _ in range(study.sizes.repeats):
        study.progress("startup")
        with study.children() as children:
            rounds.append((children.process_seconds(), children.process_seconds(), children.import_seconds()))
    empty, cached, imported = zip(*rounds, strict=True)
    at_most(study, "startup: first use, kernel cache empty", 15, empty, "{:.3g} s")
    at_most(study, "startup: first use, kernels in the cache", 2, cached, "{:.3g} s")
    at_most(study, "startup: import doo_ti", 0.5, imported, "{:.2g} s")


def memory(study: Engine) -> None:
    """Memory above the results, and over many calls."""
    rods, calls, rounds = study.sizes.rods, study.sizes.calls, range(study.sizes.repeats)
    with study.children() as children:
        study.progress("memory: by rods")
        each = [children.bytes_per_rod(rods) for _ in rounds]
        study.progress("memory: over calls")
        growing = [children.growth_kb_per_call(calls) for _ in rounds]
    at_most(study, f"memory: a rod above the results, {rods} to {4 * rods} rods", 1000, each, "{:,.0f} bytes")
    at_most(study, f"memory: growth a call, later half of {calls} calls of varied size", FLAT, growing, "{:.2f} kB")


def at_most(study: Engine, name: str, bar: float, values, form: str) -> None:
    """Add a check that the median of ``values`` is at most ``bar``, with their range; None: the system does not report
    them."""
    if None in values:
        study.checks.append(Check(name, f"≤ {form.format(bar)}", "–: the system does not report it", None))
        return
    middle = float(np.median(values))
    study.check(name, f"≤ {form.format(bar)}", form.format(middle), middle <= bar)
    study.detail(f"{name}: median of {len(values)}, {form.format(min(values))} … {form.format(max(values))}")


def threads(study: Engine) -> None:
    """Two threads compared with one, in alternating processes; the processor time shows whether both had a core."""
    rods, calls = study.sizes.rods, 4 * study.sizes.repeats
    rates, spent = {1: [], 2: []}, {1: [], 2: []}
    with study.children() as children:
        children.process_seconds()  # fills the cache
        for count in study.sizes.repeats * (1, 2):
            study.progress(f"threads: {count}")
            (_, once), (rate, often) = (rate_and_processor(children, count, rods, runs) for runs in (1, 1 + calls))
            rates[count].append(rate)
            spent[count].append((often - once) / (calls * rods))  # without what starting the process takes
    gain = np.median(np.divide(rates[2], rates[1]))
    study.check(f"threads: two beside one, {rods} rods", "≥ 1.7 times", f"{gain:.2f} times", gain >= 1.7)
    for count in rates:
        rate, processor = np.median(rates[count]), np.median(spent[count])
        study.detail(f"threads, {count}: {rate:,.0f} rods/s, processor time {1e6 * processor:.2f} µs a rod: "
                     f"{rate * processor:.2f} cores at work")


def rate_and_processor(children: Children, count: int, rods: int, calls: int) -> tuple[float, float]:
    """(rods/s, processor seconds of the whole process) on ``count`` threads."""
    before = os.times()
    rate, after = children.rods_per_second(count, rods, calls), os.times()
    return rate, after.children_user + after.children_system - before.children_user - before.children_system


ROWS = {"speed": speed, "accuracy": accuracy, "hard": hard, "growth": growth, "sweep": swept, "startup": startup,
        "memory": memory, "threads": threads}


def measure_rows(study: Engine, rows: list[str]) -> None:
    """Run the rows in order; those without data are entered as skipped."""
    absent = [name for name in lab.TRUTH if not (study.data / f"lab_a/{name}.npz").is_file()]
    for row in rows:
        if absent and row != "hard":
            study.checks.append(Check(row, "–", f"skipped: no lab_a/{absent[0]}.npz in the data folder", None))
        else:
            ROWS[row](study)


def main(arguments: list[str]) -> int:
    from rich.console import Console

    parser = argparse.ArgumentParser(prog="engine.py", description=__doc__.splitlines()[0])
    parser.add_argument("rows", nargs="*", metavar="ROW", help=f"{', '.join(ROWS)}; all by default")
    parser.add_argument("--data", type=Path, default=ROOT / "tests" / "data", metavar="DIR", help="folder with lab_a/")
    options = parser.parse_args(arguments)
    unknown = [row for row in options.rows if row not in ROWS]
    if unknown:
        parser.error(f"no row {unknown[0]!r}; rows are {', '.join(ROWS)}")
    study = Engine(options.data, progress=Console(stderr=True, highlight=False).print)
    try:
        measure_rows(study, options.rows or list(ROWS))
    except (InputError, InterruptedRunError, subprocess.CalledProcessError) as error:
        print(error, file=sys.stderr)
        return 2
    found = {"machine": {**clock.machine(), "architecture": runtime.start(), "threads": runtime.thread_count()},
             "versions": clock.versions(), "rods": study.sizes.rods, "rounds": study.sizes.repeats}
    print("\n\n".join([machine(found), table(study.checks), "\n".join(study.details)]))
    return int(any(check.holds is False for check in study.checks))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
