"""Compare the solver and the static search with their required values (bars).

    python tools/acceptance.py [ROW ...] [--data DIR]

Prints a Markdown table, ``| check | bar | measured | holds |``, and below it the details of each figure. By default the data
that ships with the tests, and all rows but ``cables``, whose data does not ship (docs/cables.md). Exit code 1 where a bar is
missed, and where a row has no data.
"""

import argparse
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
if not __package__:
    sys.path.insert(0, str(ROOT))

from doo_ti import Descent, Grid, Material, Newton, Observations, Status, load_observations  # noqa: E402
from doo_ti.bench import clock, workload  # noqa: E402
from doo_ti.bench.workload import SUTURES, TWIST_RATIO_RANGE, Rods  # noqa: E402
from doo_ti.errors import InputError  # noqa: E402
from doo_ti.grid import parse_axis  # noqa: E402
from doo_ti.learning.landscape import Landscape, read_landscape  # noqa: E402
from doo_ti.learning.objective import status_counts  # noqa: E402
from doo_ti.learning.sweeps import SweepOptions, sweep  # noqa: E402
from doo_ti.relaxation.newton import TOLERANCES  # noqa: E402
from doo_ti.types import Solution  # noqa: E402
from tools.bench import lab  # noqa: E402

SAME_MM = 0.02
"""Two rods are in the same minimum where the mean distance between their vertices is no more than this."""
RIBBON_WIDTH = 6.7  # mm, w_m of Eq. 1
RATIO_RANGE = TWIST_RATIO_RANGE[1] / TWIST_RATIO_RANGE[0]
LISTED = 30  # rods listed one by one, at most


SHIPPED = ROOT / "tests" / "data"


@dataclass(frozen=True)
class Sizes:
    """Sizes of the study; smaller ones are for tests of the study."""

    observations: int = 60
    search: int = 25
    cells: int = 10
    cable_cells: int = 13
    descent_iterations: int = 100_000
    rods: int = 65_536
    repeats: int = 5
    batch: int = 4096
    probes: int = 24


@dataclass(frozen=True)
class Check:
    """One line of the table; ``holds`` is None where nothing could be measured."""

    name: str
    bar: str
    measured: str
    holds: bool | None


@dataclass
class Study:
    """The data's folder, how much is measured, the lines of the table so far, and the details below it."""

    data: Path
    sizes: Sizes = Sizes()
    progress: Callable[[str], None] = lambda text: None
    checks: list[Check] = field(default_factory=list)
    details: list[str] = field(default_factory=list)

    def check(self, name: str, bar: str, measured: str, holds: bool) -> None:
        self.checks.append(Check(name, bar, measured, bool(holds)))

    def detail(self, text: str, rods: list[str] | None = None) -> None:
        """A line of the details, or none if it is to list ``rods`` and there are none."""
        if rods is None:
            self.details.append(f"- {text}")
        elif rods:
            cut = [f"… and {len(rods) - LISTED} more"] if len(rods) > LISTED else []
            self.details += [f"- {text} ({len(rods)}):", *(f"  - {line}" for line in rods[:LISTED] + cut)]

    def observations(self, name: str) -> Observations:
        """The observations of a file, cut down to the study's size."""
        whole = load_observations(self.data / f"{name}.npz")
        return whole.take(np.arange(min(whole.count, self.sizes.observations)))

    def started(self, name: str):
        return workload.started(self.observations(f"lab_a/{name}"))

    def searched(self) -> Iterator[tuple[str, Rods]]:
        """Every observation of the lab under every cell of its grid, material by material."""
        for name in lab.TRUTH:
            yield name, lab.crossed(*self.started(name), lab.search_grid(name, self.sizes.cells).materials())

    def swept(self, observations: Observations, grid: Grid, frame_weight: float = 0.0) -> Landscape:
        """The landscape of a sweep into a temporary folder."""
        self.progress(f"sweep: {observations.name}, {grid.size} cells")
        with tempfile.TemporaryDirectory() as folder:
            run = Path(folder) / "run"
            sweep(run, observations, grid, options=SweepOptions(frame_weight=frame_weight))
            return read_landscape(run)


def cables(study: Study) -> None:
    """Real cables: where the static search puts bend, and how far the best rod is from the markers."""
    for name, low, high, bar in (("dlo1", 2e6, 5e6, 14.3), ("dlo3", 3e7, 1e8, 16.1)):
        axis = parse_axis("--bend", f"1e5:1e8:{study.sizes.cable_cells}")
        found = study.swept(study.observations(f"cables/{name}"), Grid((axis,)))
        best, error = axis.values[found.best], found.mean_distance[found.best]
        study.check(f"cable {name}: bend at the minimum, error there", f"{low:.0e} … {high:.0e}, ≤ {bar} mm",
                    f"{best:.3g}, {error:.2f} mm", low <= best <= high and error <= bar)
        curve = ", ".join(f"{b:.2g}: {e:.1f}" for b, e in zip(axis.values, found.mean_distance, strict=True))
        study.detail(f"cable {name}, tangent clamps: {intervals(found)}; {ended(found)}; error in mm by bend {curve}")


def sutures(study: Study) -> None:
    """Sutures of the lab: the error at the true Θ, and how far from it the search finds the twist ratio."""
    count = study.sizes.search
    for name, bar in (("nylon", 0.90), ("vicryl", 0.85), ("silk", 0.90)):
        observations = study.observations(f"lab_a/{name}")
        truth = study.swept(observations, lab.true_grid(name))
        found = study.swept(observations, lab.search_grid(name, count))
        at_truth, lowest = truth.mean_distance[0], found.mean_distance[found.best]
        study.check(f"{name}: error at the true Θ", f"≤ {bar:.2f} mm", f"{at_truth:.3f} mm", at_truth <= bar)
        theta = {key: value[found.best] for key, value in found.grid.cell_values().items()}
        bend, _, twist = lab.TRUTH[name]
        steps = abs(np.log(theta["twist"] / theta["bend_1"] * bend / twist)) / np.log(RATIO_RANGE) * (count - 1)
        study.check(f"{name}: β/α at the minimum of {count}×{count} cells", "within one cell of the truth",
                    f"{steps:.1f} cells, {theta['twist'] / theta['bend_1']:.2f}; bend {theta['bend_1'] / bend:.2f}× the truth; "
                    f"{lowest:.3f} mm ({lowest - at_truth:+.3f})", steps <= 1.0)
        median, worst = np.median(truth.distance[0]), int(np.argmax(truth.distance[0]))
        study.detail(f"{name} at the true Θ: median {median:.3f} mm, largest {truth.distance[0, worst]:.2f} mm at "
                     f"observation {worst}; {ended(truth)}")
        study.detail(f"{name}, search: {intervals(found)}; {ended(found)}")


def ribbon(study: Study) -> None:
    """The ribbon of the lab: bend_1 × bend_2, started from the measured frames, with frames weighted in Eq. 1."""
    grid = lab.search_grid("ribbon", study.sizes.search)
    found = study.swept(study.observations("lab_a/ribbon"), grid, RIBBON_WIDTH)
    best = [grid.cell_values()[name][found.best] for name in ("bend_1", "bend_2")]
    factors = np.array(best) / lab.TRUTH["ribbon"][:2]
    near = ((factors >= 1 / 3) & (factors <= 3)).all()
    study.check("ribbon: bend_1, bend_2 at the minimum", "bend_1 > bend_2, each within a factor 3 of the truth",
                f"{best[0]:.3g}, {best[1]:.3g} ({factors[0]:.2f}×, {factors[1]:.2f}×)", best[0] > best[1] and near)
    study.detail(f"ribbon, w_m {RIBBON_WIDTH} mm: minimum {found.mean_distance[found.best]:.3f} mm; "
                 f"{intervals(found)}; {ended(found)}")


def newton(study: Study) -> None:
    """Newton in f64 on every rod of the lab × cells: convergence, certificate, edge lengths."""
    sound, edge_error, closure, lost = [], 0.0, 0.0, []
    for name, rods in study.searched():
        study.progress(f"Newton f64: {name}")
        solution = rods.relaxed(Newton(tolerance=1e-7), "f64")
        good = solution.converged & solution.stable & (solution.residual <= TOLERANCES[64])
        steps = np.diff(solution.configuration.vertices, axis=1)
        error = np.abs(np.linalg.norm(steps, axis=-1) - solution.configuration.rest_length).max()
        edge_error, closure = np.maximum(edge_error, error), max(closure, np.nanmax(solution.closure))
        sound.append(good)
        lost += [described(name, rods, rod, solution) for rod in np.flatnonzero(~good)]
        study.detail(f"Newton f64, {name}: {percent(good)} of {len(good)} rods sound, iterations mean "
                     f"{solution.iterations.mean():.1f}, 99th percentile {np.percentile(solution.iterations, 99):.0f}, "
                     f"most {solution.iterations.max()}; {ended(solution)}")
    every = np.concatenate(sound)
    study.check(f"Newton f64, lab × {study.sizes.cells}×{study.sizes.cells}: converged and certified stable",
                "≥ 99.5 %", f"{percent(every)} of {len(every)}", every.mean() >= 0.995)
    study.check("… edge lengths", "exact to 1e-10 mm", f"{edge_error:.1e} mm", edge_error <= 1e-10)
    study.detail(f"Newton f64: the far end misses its clamp by {closure:.1e} of the rod's length at most")
    study.detail("Newton f64, rods that are not sound", lost)


def single(study: Study) -> None:
    """Newton in f32 against f64 on the same rods."""
    agreement, apart, unsure = {}, [], 0
    for name, rods in study.searched():
        study.progress(f"Newton f32: {name}")
        coarse, fine = rods.relaxed(Newton(), "f32"), rods.relaxed(Newton(), "f64")
        gap = vertex_distance(coarse, fine)
        same = agreement[name] = gap <= SAME_MM
        unsure += int((~same & ~(coarse.stable & fine.stable)).sum())
        apart += [f"{described(name, rods, rod, coarse)}; {gap[rod]:.3g} mm apart, energy f32 − f64 "
                  f"{coarse.energy[rod] - fine.energy[rod]:+.3g}; f64 {state(fine, rod)}"
                  for rod in np.flatnonzero(~same)]
        spread = " / ".join(f"{value:.1e}" for value in np.percentile(gap, [50, 99, 100]))
        study.detail(f"Newton f32, {name}: {percent(same)} the same minimum, {spread} mm apart (median / 99th "
                     f"percentile / most); {in_doubles(coarse)} finished in f64; {ended(coarse)}")
    round_rods, band = np.concatenate([agreement[name] for name in SUTURES]), agreement["ribbon"]
    study.check("Newton f32: same minimum as f64, sutures", "≥ 99 %", percent(round_rods), round_rods.mean() >= 0.99)
    study.check("Newton f32: same minimum as f64, ribbon", "≥ 97 %", percent(band), band.mean() >= 0.97)
    study.check("… where they differ", "both certified stable", f"{unsure} of {len(apart)} rods are not", unsure == 0)
    study.detail(f"Newton f32, rods more than {SAME_MM} mm from f64's", apart)


def descent(study: Study) -> None:
    """The paper's scheme against Newton from the same starts."""
    limit = study.sizes.descent_iterations
    study.detail("Descent: cells are the truth, bend ×5 and ÷5 at the same twist ratio (β follows), and twist ratio "
                 f"×3; solved to 1e-5, counted as converged at a residual ≤ 1e-4, at most {limit} iterations")
    for name in lab.TRUTH:
        study.progress(f"Descent: {name}")
        rods = lab.crossed(*study.started(name), lab.neighbours(name))
        slow = rods.relaxed(Descent(tolerance=1e-5, max_iterations=limit), "f64")
        fast = rods.relaxed(Newton(), "f64")
        done = slow.residual <= 1e-4
        gap = vertex_distance(slow, fast)
        same = done & (gap <= SAME_MM)
        study.check(f"Descent, {name}: converged to 1e-4", "≥ 95 %", percent(done), done.mean() >= 0.95)
        study.check("… same minimum as Newton", "≥ 98 % of those", percent(same[done]),
                    same.sum() >= 0.98 * max(done.sum(), 1))
        of_cell = [rods.of_material == cell for cell in range(len(lab.NEIGHBOURS))]
        cells = "; ".join(f"{label} {done[these].sum()} of {these.sum()} converged, {same[these].sum()} the same"
                          for label, these in zip(lab.NEIGHBOURS, of_cell, strict=True))
        study.detail(f"Descent, {name}: {cells}; iterations median {np.median(slow.iterations):.0f}, most "
                     f"{slow.iterations.max()}; {ended(slow)}")
        study.detail(f"Descent, {name}, converged to another minimum than Newton", [
            f"{described(name, rods, rod, slow)}; {gap[rod]:.3g} mm apart, energy Descent − Newton "
            f"{slow.energy[rod] - fast.energy[rod]:+.3g}; Newton {state(fast, rod)}"
            for rod in np.flatnonzero(done & ~same)])
        study.detail(f"Descent, {name}, not converged", [
            f"{described(name, rods, rod, slow)}; {gap[rod]:.3g} mm from Newton's" for rod in np.flatnonzero(~done)])


def throughput(study: Study) -> None:
    """NumPy in to NumPy out, warm kernels: the three sutures' observations in turn under drawn materials."""
    drawn = workload.isotropic_materials(study.sizes.rods)
    rods = workload.paired(*workload.in_turn([study.started(name) for name in SUTURES]), drawn)
    bend, twist = drawn.bend[:, 0, 0, 0].copy(), drawn.twist[:, 0].copy()

    def relaxed() -> Solution:
        return replace(rods, material=Material(bend, twist)).relaxed(Newton(tolerance=1e-4), "f32")

    study.progress("throughput")
    relaxed()
    seconds = []
    for _ in range(study.sizes.repeats):
        solution = None  # results that are kept need new memory, whose cost is not to be measured
        elapsed, solution = clock.timed(relaxed)
        seconds.append(elapsed)
    done = solution.converged & (solution.residual <= TOLERANCES[32])
    rates = done.sum() / np.array(seconds)
    study.check(f"throughput, {rods.count} rods, f32 to {TOLERANCES[32]:g}, converged rods only", "≥ 40 000 rods/s",
                f"{np.median(rates):,.0f} rods/s", np.median(rates) >= 40_000)
    posing, _ = clock.timed(lambda: solution.configuration.vertices)
    machine = clock.machine()
    study.detail(f"throughput on {machine['processor']}, {machine['cores']} cores: median of {len(rates)}, lowest "
                 f"{rates.min():,.0f}, highest {rates.max():,.0f} rods/s; {percent(done)} converged, "
                 f"{percent(solution.stable)} certified stable, {in_doubles(solution)} finished in f64, iterations "
                 f"mean {solution.iterations.mean():.1f}; what comes out are frames: their vertices "
                 f"(`configuration.vertices`) take another {posing:.2f} s beside {np.median(seconds):.2f} s")


def independence(study: Study) -> None:
    """A rod's result to the last bit: alone, in a batch, and at other places of it."""
    count, differing, compared = study.sizes.batch, 0, 0
    tables = {
        "sutures": (*workload.in_turn([study.started(name) for name in SUTURES]), workload.isotropic_materials(count)),
        "ribbon": (*study.started("ribbon"), workload.ribbon_materials(count)),
    }
    solvers = [(Newton(), "f64"), (Newton(), "f32"), (Newton(), "mixed"), (Descent(max_iterations=200), "f64")]
    for name, solver, precision in [(name, *solver) for name in tables for solver in solvers]:
        label = f"{name}, {type(solver).__name__} {precision}"
        study.progress(f"independence: {label}")
        rods, random = workload.paired(*tables[name]), np.random.default_rng(workload.SEED)
        together, order = rods.relaxed(solver, precision), random.permutation(count)
        moved = ~identical(together, order, rods.take(order).relaxed(solver, precision), np.arange(count))
        probes = random.choice(count, min(study.sizes.probes, count), replace=False)
        alone = [not identical(together, [rod], rods.alone([rod]).relaxed(solver, precision), [0])[0] for rod in probes]
        differing, compared = differing + moved.sum() + sum(alone), compared + count + len(alone)
        study.detail(f"independence, {label}: {moved.sum()} of {count} rods differ in another order, {sum(alone)} of "
                     f"{len(alone)} alone")
    study.check(f"independence: alone, in a batch of {count}, in another place", "bit-identical",
                f"{differing} of {compared} differ", differing == 0)


ROWS = {"cables": cables, "sutures": sutures, "ribbon": ribbon, "newton": newton, "f32": single, "descent": descent,
        "throughput": throughput, "independence": independence}
FILES = {"cables": ("cables/dlo1", "cables/dlo3"), "ribbon": ("lab_a/ribbon",),
         **{row: tuple(f"lab_a/{name}" for name in SUTURES) for row in ("sutures", "throughput")},
         **{row: tuple(f"lab_a/{name}" for name in lab.TRUTH) for row in ("newton", "f32", "descent", "independence")}}


def vertex_distance(one: Solution, other: Solution) -> np.ndarray:
    """(R,) mean distance between vertices, mm."""
    return np.linalg.norm(one.configuration.vertices - other.configuration.vertices, axis=-1).mean(axis=1)


def identical(one: Solution, rows, other: Solution, places) -> np.ndarray:
    """(R,) whether rods ``rows`` of one and ``places`` of the other agree in every bit of every result."""
    names = ("energy", "residual", "closure", "iterations", "status", "stable", "precision")
    pairs = [(getattr(one, name)[rows], getattr(other, name)[places]) for name in names]
    pairs += [(getattr(one.configuration, name)[rows], getattr(other.configuration, name)[places])
              for name in ("start", "quaternions")]
    return np.all([_bits(first) == _bits(second) for first, second in pairs], axis=0)


def _bits(array: np.ndarray) -> np.ndarray:
    """(R,) the bytes of each row, as one value to compare; singles as doubles, which is exact: whether an array comes
    in one or the other may depend on the batch."""
    rows = np.ascontiguousarray(array, dtype=np.float64).reshape(len(array), -1)
    return rows.view(np.dtype((np.void, rows.itemsize * rows.shape[1])))[:, 0]


def percent(good: np.ndarray) -> str:
    """The share that is true, rounded down: only all is 100 %."""
    share = 100 * np.mean(good) if len(good) else 0.0
    return "100 %" if share == 100 else f"{min(share, 99.99):.2f} %"


def described(name: str, rods: Rods, rod: int, solution: Solution) -> str:
    """Which rod it is, and how it ended."""
    material, row = rods.material, rods.of_material[rod]
    first, second = material.bend[row, 0, 0, 0], material.bend[row, 0, 1, 1]
    bend = f"bend {first:.3g}" if first == second else f"bend_1 {first:.3g}, bend_2 {second:.3g}"
    twist = f"twist {material.twist[row, 0]:.3g}"
    return f"{name}, observation {rods.of_start[rod]}, {bend}, {twist}: {state(solution, rod)}"


def state(solution: Solution, rod: int) -> str:
    stable = "stable" if solution.stable[rod] else "not certified"
    return (f"{Status(solution.status[rod]).name.lower().replace('_', ' ')}, {stable}, residual "
            f"{solution.residual[rod]:.1e}, {solution.iterations[rod]} iterations")


def ended(result: Solution | Landscape) -> str:
    """Number of rods of each status."""
    counts = ", ".join(f"{count} {name.replace('_', ' ')}" for name, count in status_counts(result.status).items())
    return f"{counts}, {int(np.sum(result.stable))} certified stable"


def in_doubles(solution: Solution) -> str:
    count = int(np.count_nonzero(solution.precision == 64))
    return "1 rod" if count == 1 else f"{count} rods"


def intervals(landscape: Landscape) -> str:
    return "within 5 % of the minimum " + ", ".join(map(str, landscape.intervals))


def measure(study: Study, rows: list[str]) -> None:
    """Run the rows in order; those without data are entered as skipped."""
    for row in rows:
        absent = [name for name in FILES[row] if not (study.data / f"{name}.npz").is_file()]
        if absent:
            study.checks.append(Check(row, "–", f"skipped: no {absent[0]}.npz in the data folder", None))
        else:
            ROWS[row](study)


def table(checks: list[Check]) -> str:
    lines = ["| check | bar | measured | holds |", "|---|---|---|---|"]
    verdict = {True: "yes", False: "**no**", None: "–"}
    return "\n".join(lines + [f"| {c.name} | {c.bar} | {c.measured} | {verdict[c.holds]} |" for c in checks])


def main(arguments: list[str]) -> int:
    from rich.console import Console

    parser = argparse.ArgumentParser(prog="acceptance.py", description=__doc__.splitlines()[0])
    parser.add_argument("rows", nargs="*", metavar="ROW", help=f"{', '.join(ROWS)}; all but cables by default")
    parser.add_argument("--data", type=Path, default=SHIPPED, metavar="DIR", help="folder with lab_a/ and cables/")
    options = parser.parse_args(arguments)
    unknown = [row for row in options.rows if row not in ROWS]
    if unknown:
        parser.error(f"no row {unknown[0]!r}; rows are {', '.join(ROWS)}")
    study = Study(options.data, progress=Console(stderr=True, highlight=False).print)
    try:
        measure(study, options.rows or [row for row in ROWS if row != "cables"])
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    print(table(study.checks) + "\n\n" + "\n".join(study.details))
    return int(not all(check.holds for check in study.checks))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
