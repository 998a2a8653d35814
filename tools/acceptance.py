"""Measure the solver and the static search against their bars: ``python tools/acceptance.py [ROW ...] [--data FOLDER]``.

Prints a Markdown table, ``| check | bar | measured | holds |``, and below it what each figure is made of. Rows whose data
is absent are skipped and say so. Exit code 1 where a bar is missed.
"""

import argparse
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
if not __package__:
    sys.path.insert(0, str(ROOT))

from doo_ti import (  # noqa: E402
    Clamps, Configuration, Descent, Grid, Material, Newton, Observations, Status, load_observations,
)
from doo_ti.errors import InputError  # noqa: E402
from doo_ti.grid import parse_axis  # noqa: E402
from doo_ti.learning import Landscape, read_landscape, status_counts  # noqa: E402
from doo_ti.relax import relax  # noqa: E402
from doo_ti.sweep import SweepOptions, sweep  # noqa: E402
from doo_ti.types import Solution  # noqa: E402
from tools.bench import clock, workload  # noqa: E402

SAME_MM = 0.02
"""Two rods are in the same minimum where the mean distance between their vertices is no more than this."""
TRUTH = {  # bend_1, bend_2, twist of the lab's rods, mm³
    "nylon": (1.8e6, 1.8e6, 1.2e6), "vicryl": (6e5, 6e5, 8e5), "silk": (1.5e5, 1.5e5, 5e4), "ribbon": (6e6, 1.2e5, 5e5),
}
RIBBON_WIDTH = 6.7  # mm, w_m of Eq. 1
LISTED = 30  # rods listed one by one, at most


@dataclass(frozen=True)
class Sizes:
    """How much is measured; smaller only to try the study out."""

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
    tell: Callable[[str], None] = lambda text: None
    checks: list[Check] = field(default_factory=list)
    details: list[str] = field(default_factory=list)

    def check(self, name: str, bar: str, measured: str, holds: bool) -> None:
        self.checks.append(Check(name, bar, measured, bool(holds)))

    def detail(self, text: str) -> None:
        self.details.append(text)

    def observations(self, name: str) -> Observations:
        """The observations of a file, cut down to the study's size."""
        whole = load_observations(self.data / f"{name}.npz")
        return whole.take(np.arange(min(whole.count, self.sizes.observations)))

    def lab(self, names) -> list[Observations]:
        return [self.observations(f"lab_a/{name}") for name in names]


def cables(study: Study) -> None:
    """Real cables: where the static search puts bend, and how far the best rod is from the markers."""
    for name, low, high, bar in (("dlo1", 2e6, 5e6, 14.3), ("dlo3", 3e7, 1e8, 16.1)):
        axis = parse_axis("--bend", f"1e5:1e8:{study.sizes.cable_cells}")
        found = swept(study, study.observations(f"cables/{name}"), Grid((axis,)))
        best = found.grid.cell_values()["bend_1"][found.best]
        error = found.mean_distance[found.best]
        study.check(f"cable {name}: bend at the minimum, error there", f"{low:.0e} … {high:.0e}, ≤ {bar} mm",
                    f"{best:.3g}, {error:.2f} mm", low <= best <= high and error <= bar)
        study.detail(f"- cable {name}, tangent clamps: {intervals(found)}; {ended(found)}")
        curve = ", ".join(f"{b:.2g}: {e:.1f}" for b, e in zip(axis.values, found.mean_distance, strict=True))
        study.detail(f"  - error in mm by bend: {curve}")


def lab(study: Study) -> None:
    """Sutures of the lab: the error at the true Θ, and how far below it the search gets."""
    bars = {"nylon": 0.90, "vicryl": 0.85, "silk": 0.90}
    for observations in study.lab(workload.SUTURES):
        name = observations.name
        bend, _, twist = TRUTH[name]
        truth = swept(study, observations, Grid((parse_axis("--bend", f"{bend}"), parse_axis("--twist", f"{twist}"))))
        found = swept(study, observations, suture_grid(study.sizes.search))
        at_truth, lowest = truth.mean_distance[0], found.mean_distance[found.best]
        study.check(f"{name}: error at the true Θ", f"≤ {bars[name]:.2f} mm", f"{at_truth:.3f} mm", at_truth <= bars[name])
        study.check(f"{name}: minimum of {study.sizes.search}×{study.sizes.search} cells", "≤ truth + 0.02 mm",
                    f"{lowest:.3f} mm ({lowest - at_truth:+.3f})", lowest <= at_truth + 0.02)
        median, worst = np.median(truth.distance[0]), int(np.argmax(truth.distance[0]))
        study.detail(f"- {name} at the true Θ (bend {bend:.3g}, twist {twist:.3g}): median {median:.3f} mm, largest "
                     f"{truth.distance[0, worst]:.2f} mm at observation {worst}; {ended(truth)}")
        study.detail(f"  - search: {intervals(found)}; {ended(found)}")


def ribbon(study: Study) -> None:
    """The ribbon of the lab: bend_1 × bend_2, started from the measured frames, frames weighed in."""
    observations = study.observations("lab_a/ribbon")
    found = swept(study, observations, ribbon_grid(study.sizes.search), frame_weight=RIBBON_WIDTH)
    values = found.grid.cell_values()
    first, second = values["bend_1"][found.best], values["bend_2"][found.best]
    factors = (first / TRUTH["ribbon"][0], second / TRUTH["ribbon"][1])
    near = all(1 / 3 <= factor <= 3 for factor in factors)
    study.check("ribbon: bend_1, bend_2 at the minimum", "bend_1 > bend_2, each within a factor 3 of the truth",
                f"{first:.3g}, {second:.3g} ({factors[0]:.2f}×, {factors[1]:.2f}×)", first > second and near)
    study.detail(f"- ribbon, w_m {RIBBON_WIDTH} mm: minimum {found.mean_distance[found.best]:.3f} mm; {intervals(found)}; "
                 f"{ended(found)}")


def newton(study: Study) -> None:
    """Newton in f64 on every rod of the lab × cells: convergence, certificate, edge lengths."""
    sound, edge_error, closure, lost = [], 0.0, 0.0, []
    for batch in lab_batches(study):
        study.tell(f"Newton f64: {batch.name}")
        solution = batch.relaxed(Newton(tolerance=1e-9), "f64")
        good = solution.converged & solution.stable & (solution.residual <= 1e-9)
        vertices, length = solution.configuration.vertices, solution.configuration.rest_length
        error = np.abs(np.linalg.norm(np.diff(vertices, axis=1), axis=-1) - length).max()
        edge_error, closure = max(edge_error, error), max(closure, np.nanmax(solution.closure))
        sound.append(good)
        lost += [batch.describe(rod, solution) for rod in np.flatnonzero(~good)]
        study.detail(f"- Newton f64, {batch.name}: {percent(good)} of {len(good)} rods sound, iterations mean "
                     f"{solution.iterations.mean():.1f}, 99th percentile {np.percentile(solution.iterations, 99):.0f}, "
                     f"most {solution.iterations.max()}; {ended(solution)}")
    everything = np.concatenate(sound)
    cells = f"{study.sizes.cells}×{study.sizes.cells}"
    study.check(f"Newton f64, lab × {cells}: converged and certified stable at 1e-9", "≥ 99.5 %",
                f"{percent(everything)} of {len(everything)}", everything.mean() >= 0.995)
    study.check("… edge lengths", "exact to 1e-10 mm", f"{edge_error:.1e} mm", edge_error <= 1e-10)
    study.detail(f"- Newton f64: the far end misses its clamp by {closure:.1e} of the rod's length at most")
    listed(study, "Newton f64: rods that are not sound", lost)


def single(study: Study) -> None:
    """Newton in f32 against f64 on the same rods."""
    fractions, apart, unsure = {}, [], 0
    for batch in lab_batches(study):
        study.tell(f"Newton f32: {batch.name}")
        coarse, fine = batch.relaxed(Newton(), "f32"), batch.relaxed(Newton(), "f64")
        gap = vertex_distance(coarse, fine)
        same = gap <= SAME_MM
        fractions[batch.name] = same
        unsure += int((~same & ~(coarse.stable & fine.stable)).sum())
        apart += [f"{batch.describe(rod, coarse)}, {gap[rod]:.3g} mm apart, energy f32 − f64 "
                  f"{coarse.energy[rod] - fine.energy[rod]:+.3g}, f64 {state(fine, rod)}" for rod in np.flatnonzero(~same)]
        quantiles = " / ".join(f"{value:.1e}" for value in np.percentile(gap[same], [50, 99, 100]))
        study.detail(f"- Newton f32, {batch.name}: {percent(same)} the same minimum, there {quantiles} mm apart (median / "
                     f"99th percentile / most); {np.count_nonzero(coarse.precision == 64)} rods finished in f64; {ended(coarse)}")
    sutures = np.concatenate([fractions[name] for name in workload.SUTURES])
    band = fractions["ribbon"]
    study.check("Newton f32: same minimum as f64, sutures", "≥ 99 %", percent(sutures), sutures.mean() >= 0.99)
    study.check("Newton f32: same minimum as f64, ribbon", "≥ 97 %", percent(band), band.mean() >= 0.97)
    study.check("… where they differ", "both certified stable", f"{unsure} of {len(apart)} rods are not", unsure == 0)
    listed(study, "Newton f32: rods in another minimum than f64", apart)


def descent(study: Study) -> None:
    """The paper's scheme against Newton from the same starts; bend × factor keeps the twist ratio, β follows."""
    limit = study.sizes.descent_iterations
    study.detail("- Descent: cells are the truth, B and β ×5, B and β ÷5, and β ×3 alone; solved to 1e-7, counted as "
                 f"converged at a residual ≤ 1e-6, at most {limit} iterations")
    for observations in study.lab(TRUTH):
        batch = lab_batch(observations, neighbours(observations.name), ("truth", "bend ×5", "bend ÷5", "twist ratio ×3"))
        study.tell(f"Descent: {batch.name}")
        slow = batch.relaxed(Descent(tolerance=1e-7, max_iterations=limit), "f64")
        fast = batch.relaxed(Newton(), "f64")
        done = slow.residual <= 1e-6
        gap = vertex_distance(slow, fast)
        same = gap <= SAME_MM
        agreed = same[done]
        study.check(f"Descent, {batch.name}: converged to 1e-6", "≥ 95 %", percent(done), done.mean() >= 0.95)
        study.check("… same minimum as Newton", "≥ 98 % of those", percent(agreed), done.any() and agreed.mean() >= 0.98)
        per_cell = "; ".join(f"{label} {percent(done[batch.cell == cell])} converged, {percent(same[done & (batch.cell == cell)])}"
                             " the same" for cell, label in enumerate(batch.labels))
        study.detail(f"- Descent, {batch.name}: {per_cell}; iterations median {np.median(slow.iterations):.0f}, most "
                     f"{slow.iterations.max()}; {ended(slow)}")
        listed(study, f"Descent, {batch.name}: converged to another minimum than Newton", [
            f"{batch.describe(rod, slow)}, {gap[rod]:.3g} mm apart, energy Descent − Newton "
            f"{slow.energy[rod] - fast.energy[rod]:+.3g} of {abs(fast.energy[rod]):.3g}, Newton {state(fast, rod)}"
            for rod in np.flatnonzero(done & ~same)])
        listed(study, f"Descent, {batch.name}: not converged", [
            f"{batch.describe(rod, slow)}, {gap[rod]:.3g} mm from Newton's" for rod in np.flatnonzero(~done)])


def throughput(study: Study) -> None:
    """NumPy in to NumPy out, warm kernels: the three sutures' observations in turn under drawn materials."""
    starts, clamps = workload.in_turn([workload.started(observations) for observations in study.lab(workload.SUTURES)])
    count = study.sizes.rods
    drawn = workload.isotropic_materials(count)
    bend, twist = drawn.bend[:, 0, 0, 0].copy(), drawn.twist[:, 0].copy()
    rods = np.arange(count)

    def once() -> Solution:
        return relax(starts, Material(bend, twist), clamps, Newton(tolerance=1e-6), precision="f32",
                     configuration_index=rods % starts.count, material_index=rods)

    study.tell("throughput")
    once()
    seconds, solutions = zip(*(clock.timed(once) for _ in range(study.sizes.repeats)), strict=True)
    solution = solutions[-1]
    done = solution.converged & (solution.residual <= 1e-6)
    rates = done.sum() / np.array(seconds)
    study.check(f"throughput, {count} rods, f32 to 1e-6, converged rods only", "≥ 40 000 rods/s",
                f"{np.median(rates):,.0f} rods/s", np.median(rates) >= 40_000)
    posing, _ = clock.timed(lambda: solution.configuration.vertices)
    machine = clock.machine()
    study.detail(f"- throughput on {machine['processor']}, {machine['cores']} cores: median of {len(rates)}, lowest "
                 f"{rates.min():,.0f}, highest {rates.max():,.0f} rods/s; {percent(done)} converged, "
                 f"{percent(solution.stable)} certified stable, {np.count_nonzero(solution.precision == 64)} rods finished in f64, "
                 f"iterations mean {solution.iterations.mean():.1f}; "
                 f"vertices from the frames take {posing / np.median(seconds):.0%} of that time on top")


def independence(study: Study) -> None:
    """A rod's result to the last bit: alone, in a batch, and at other places of it."""
    differing, compared = 0, 0
    sutures = workload.in_turn([workload.started(observations) for observations in study.lab(workload.SUTURES)])
    band = workload.started(study.observations("lab_a/ribbon"))
    cases = [(name, solver, precision) for name in ("sutures", "ribbon") for solver, precision in (
        (Newton(), "f64"), (Newton(), "f32"), (Newton(), "mixed"), (Descent(max_iterations=200), "f64"))]
    for name, solver, precision in cases:
        label = f"{name}, {type(solver).__name__} {precision}"
        study.tell(f"independence: {label}")
        batch = drawn_batch(name, *(sutures if name == "sutures" else band), study.sizes.batch)
        together = batch.relaxed(solver, precision)
        random = np.random.default_rng(workload.SEED)
        order = random.permutation(batch.count)
        moved = batch.take(order).relaxed(solver, precision)
        wrong = ~identical(together, order, moved, np.arange(batch.count))
        probes = random.choice(batch.count, min(study.sizes.probes, batch.count), replace=False)
        alone = [not identical(together, [rod], batch.single(rod).relaxed(solver, precision), [0])[0] for rod in probes]
        differing, compared = differing + wrong.sum() + sum(alone), compared + len(wrong) + len(alone)
        study.detail(f"- independence, {label}: {wrong.sum()} of {len(wrong)} rods differ in another order, {sum(alone)} of "
                     f"{len(alone)} differ alone")
    study.check(f"independence: alone, in a batch of {study.sizes.batch}, in another place", "bit-identical",
                f"{differing} of {compared} differ", differing == 0)


ROWS = {"cables": cables, "lab": lab, "ribbon": ribbon, "newton": newton, "f32": single, "descent": descent,
        "throughput": throughput, "independence": independence}
FILES = {"cables": ("cables/dlo1", "cables/dlo3"), "ribbon": ("lab_a/ribbon",),
         **{row: tuple(f"lab_a/{name}" for name in workload.SUTURES) for row in ("lab", "throughput")},
         **{row: tuple(f"lab_a/{name}" for name in TRUTH) for row in ("newton", "f32", "descent", "independence")}}


@dataclass(frozen=True)
class Batch:
    """R rods: row ``observation[r]`` of the starts under row ``cell[r]`` of the materials; ``labels`` name the cells."""

    name: str
    starts: Configuration
    clamps: Clamps
    up: np.ndarray
    material: Material
    observation: np.ndarray
    cell: np.ndarray
    labels: tuple[str, ...] = ()

    @property
    def count(self) -> int:
        return len(self.cell)

    def relaxed(self, solver: Newton | Descent, precision: str) -> Solution:
        return relax(self.starts, self.material, self.clamps, solver, up=self.up, precision=precision,
                     configuration_index=self.observation, material_index=self.cell)

    def take(self, rods) -> "Batch":
        return replace(self, observation=self.observation[rods], cell=self.cell[rods])

    def single(self, rod: int) -> "Batch":
        """One rod with tables of one row each."""
        start, cell = self.observation[[rod]], self.cell[[rod]]
        material = Material(self.material.bend[cell], self.material.twist[cell], self.material.weight[cell])
        return replace(self, starts=self.starts.take(start), clamps=self.clamps.take(start), material=material,
                       observation=np.zeros(1, dtype=int), cell=np.zeros(1, dtype=int))

    def describe(self, rod: int, solution: Solution) -> str:
        cell = self.cell[rod]
        first, second = self.material.bend[cell, 0, 0, 0], self.material.bend[cell, 0, 1, 1]
        label = f"{self.labels[cell]}, " if self.labels else ""
        return (f"{self.name}, observation {self.observation[rod]}, {label}bend {first:.3g}/{second:.3g}, twist "
                f"{self.material.twist[cell, 0]:.3g}: {state(solution, rod)}")


def lab_batches(study: Study):
    """Every observation of the four materials under every cell of its grid."""
    for observations in study.lab(TRUTH):
        grid = (ribbon_grid if observations.name == "ribbon" else suture_grid)(study.sizes.cells)
        yield lab_batch(observations, grid.materials())


def lab_batch(observations: Observations, material: Material, labels: tuple[str, ...] = ()) -> Batch:
    starts, clamps = workload.started(observations)
    cell, observation = np.divmod(np.arange(material.count * starts.count), starts.count)
    return Batch(observations.name, starts, clamps, observations.up, material, observation, cell, labels)


def drawn_batch(name: str, starts: Configuration, clamps: Clamps, count: int) -> Batch:
    """Starts in turn under drawn materials."""
    material = (workload.ribbon_materials if name == "ribbon" else workload.isotropic_materials)(count)
    rods = np.arange(count)
    return Batch(name, starts, clamps, np.array([0.0, 0.0, 1.0]), material, rods % starts.count, rods)


def suture_grid(count: int) -> Grid:
    return Grid((parse_axis("--bend", f"5e4:1e7:{count}"), parse_axis("--twist-ratio", f"0.1:6:{count}")))


def ribbon_grid(count: int) -> Grid:
    ends = f"5e4:1e7:{count}"
    return Grid((parse_axis("--bend-1", ends), parse_axis("--bend-2", ends), parse_axis("--twist", f"{TRUTH['ribbon'][2]}")))


def neighbours(name: str) -> Material:
    """The truth, bend × 5, bend ÷ 5 (twist ratio held), twist ratio × 3."""
    bend = np.array([1.0, 5.0, 0.2, 1.0])
    first, second, twist = TRUTH[name]
    if first == second:
        return Material(first * bend, twist * bend * [1, 1, 1, 3])
    return Material.diagonal(first * bend, second * bend, twist * bend * [1, 1, 1, 3])


def swept(study: Study, observations: Observations, grid: Grid, frame_weight: float = 0.0) -> Landscape:
    """The landscape of a sweep into a folder that is thrown away."""
    study.tell(f"sweep: {observations.name}, {grid.size} cells")
    with tempfile.TemporaryDirectory() as folder:
        run = Path(folder) / "run"
        sweep(run, observations, grid, options=SweepOptions(frame_weight=frame_weight))
        return read_landscape(run)


def vertex_distance(one: Solution, other: Solution) -> np.ndarray:
    """(R,) mean distance between vertices, mm."""
    return np.linalg.norm(one.configuration.vertices - other.configuration.vertices, axis=-1).mean(axis=1)


def identical(one: Solution, rows, other: Solution, places) -> np.ndarray:
    """(R,) whether rods ``rows`` of one and ``places`` of the other agree in every bit of every result."""
    pairs = [(getattr(one, name)[rows], getattr(other, name)[places])
             for name in ("energy", "residual", "closure", "iterations", "status", "stable", "precision")]
    pairs += [(one.configuration.quaternions[rows], other.configuration.quaternions[places]),
              (one.configuration.start[rows], other.configuration.start[places])]
    return np.all([_bits(first) == _bits(second) for first, second in pairs], axis=0)


def _bits(array: np.ndarray) -> np.ndarray:
    """(R,) the bytes of each row, as one value to compare; singles as doubles, which is exact: whether an array comes in
    one or the other may depend on the batch."""
    rows = np.ascontiguousarray(array, dtype=np.float64).reshape(len(array), -1)
    return rows.view(np.dtype((np.void, rows.itemsize * rows.shape[1])))[:, 0]


def percent(good: np.ndarray) -> str:
    """The share that is true; never rounded up to all of them."""
    share = 100 * np.mean(good) if len(good) else 0.0
    return "100 %" if share == 100 else f"{min(share, 99.99):.2f} %"


def state(solution: Solution, rod: int) -> str:
    stable = "stable" if solution.stable[rod] else "not certified"
    return (f"{Status(solution.status[rod]).name.lower()}, {stable}, residual {solution.residual[rod]:.1e}, "
            f"{solution.iterations[rod]} iterations")


def ended(result: Solution | Landscape) -> str:
    """How many rods ended how."""
    counts = ", ".join(f"{count} {name.replace('_', ' ')}" for name, count in status_counts(result.status).items())
    return f"{counts}, {int(np.sum(result.stable))} certified stable"


def intervals(landscape: Landscape) -> str:
    return "within 5 % of the minimum " + ", ".join(map(str, landscape.intervals))


def listed(study: Study, title: str, rods: list[str]) -> None:
    """A list of single rods in the details, cut short where it is long."""
    if rods:
        study.detail(f"- {title} ({len(rods)}):")
        study.details += [f"  - {rod}" for rod in rods[:LISTED]]
        if len(rods) > LISTED:
            study.detail(f"  - … and {len(rods) - LISTED} more")


def measure(study: Study, rows: list[str]) -> None:
    """Run the rows in order; those without data are entered as skipped."""
    for row in rows:
        absent = [name for name in FILES[row] if not (study.data / f"{name}.npz").is_file()]
        if absent:
            study.checks.append(Check(row, "", f"skipped: {absent[0]}.npz is not in the data folder", None))
        else:
            ROWS[row](study)


def table(checks: list[Check]) -> str:
    lines = ["| check | bar | measured | holds |", "|---|---|---|---|"]
    verdict = {True: "yes", False: "**no**", None: "–"}
    return "\n".join(lines + [f"| {c.name} | {c.bar} | {c.measured} | {verdict[c.holds]} |" for c in checks])


def main(arguments: list[str]) -> int:
    from rich.console import Console

    parser = argparse.ArgumentParser(prog="acceptance.py", description=__doc__.splitlines()[0])
    parser.add_argument("rows", nargs="*", metavar="ROW", help=f"{', '.join(ROWS)}; all by default")
    parser.add_argument("--data", type=Path, default=ROOT.parent / "shared" / "data", help="folder with lab_a/ and cables/")
    options = parser.parse_args(arguments)
    unknown = [row for row in options.rows if row not in ROWS]
    if unknown:
        parser.error(f"no row {unknown[0]!r}; rows are {', '.join(ROWS)}")
    study = Study(options.data, tell=Console(stderr=True, highlight=False).print)
    try:
        measure(study, options.rows or list(ROWS))
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    print(table(study.checks) + "\n\n" + "\n".join(study.details))
    return int(any(check.holds is False for check in study.checks))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
