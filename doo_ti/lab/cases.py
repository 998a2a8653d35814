"""The cases that are timed: rods × material × precision, NumPy in to NumPy out, kernels compiled before; and what
``doo-ti bench`` measures.

    measured = measure(case, workload.Reference(threads), rounds)

Of rods that are relaxed only those that converged count.
"""

from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from statistics import median

import numpy as np

from doo_ti.lab import workload
from doo_ti.lab.workload import Rods
from doo_ti.relaxation import batch
from doo_ti.relaxation.external import Springs
from doo_ti.relaxation.newton import Newton
from doo_ti.relaxation.relax import relax
from doo_ti.rod.observations import Observations
from doo_ti.rod.types import Clamp, Material, Solution
from doo_ti.system import runtime
from doo_ti.system.terminal import progress

COARSE, FINE = Newton(tolerance=1e-4), Newton(tolerance=1e-7)
CLOSE = Newton(tolerance=1e-4, first_shift=0.0)
BATCH = 256
NEAR = 0.1  # share by which bend and twist of a warm start differ from those that it is the solution for
SPRING = 100.0  # stiffness of a spring: 1 mm off its point it pulls as much as 5 cm of rod weigh
ROUND_SECONDS = 0.3  # a round repeats its case for about this long, so that a short interruption does not decide it


@dataclass(frozen=True)
class Outcome:
    """What one run of a case did.

    amount      how much of its unit
    converged, stable  shares of the rods
    residual    the largest of the rods that converged, without a unit; None where nothing is relaxed
    iterations  (R,) of the rods, empty where nothing is relaxed
    trips       through the kernels' loops, those of all lanes added up; 0 where they are not counted
    """

    amount: float
    converged: float = 1.0
    stable: float | None = None
    residual: float | None = None
    iterations: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    trips: int = 0


@dataclass(frozen=True)
class Case:
    """Something timed: ``run()`` once does an :class:`Outcome`, counted in ``unit``."""

    name: str
    unit: str
    run: Callable[[], Outcome]


@dataclass(frozen=True)
class Measurement:
    """Medians over the rounds.

    per_second  of the case's unit
    ratio       that rate to the NumPy workload's of the same round
    iterations  mean over the rods
    busy        share of the lanes' trips that were iterations of a rod, None where trips are not counted
    histogram   number of rods that took 0, 1, 2, … iterations
    """

    unit: str
    per_second: float
    ratio: float
    converged: float
    iterations: float
    stable: float | None = None
    residual: float | None = None
    busy: float | None = None
    histogram: tuple[int, ...] = ()


class Specimens:
    """The rods of all cases, made on first use; ``count`` of them where the size is not the point."""

    def __init__(self, count: int):
        self.count = count

    @cached_property
    def sutures(self) -> list[Observations]:
        return workload.observed(*workload.SUTURES)

    @cached_property
    def many(self) -> Rods:
        """The sutures' observations in turn, under isotropic materials, bend and twist ratio log-uniform over their ranges."""
        random = np.random.default_rng(workload.SEED)
        bend, ratio = (workload.log_uniform(random, limits, self.count)
                       for limits in (workload.BEND_RANGE, workload.TWIST_RATIO_RANGE))
        tables = workload.in_turn([workload.started(observations) for observations in self.sutures])
        return workload.paired(*tables, Material(bend, bend * ratio))

    @cached_property
    def band(self) -> Rods:
        """The ribbon's observations under materials with a B of two values, log-uniform, and the ribbon's twist."""
        random = np.random.default_rng(workload.SEED)
        first, second = (workload.log_uniform(random, workload.BEND_RANGE, self.count) for _ in range(2))
        material = Material.diagonal(first, second, workload.LAB["ribbon"].twist)
        return workload.paired(*workload.started(*workload.observed("ribbon")), material)

    @cached_property
    def relaxed(self) -> Solution:
        """The solution of the rods ``many``."""
        return self.many.relaxed(COARSE, "f32")

    @cached_property
    def near(self) -> Material:
        """Bend and twist, each a tenth higher or lower than what ``many`` is relaxed under, from the fixed seed."""
        random, own = np.random.default_rng(workload.SEED), self.many.material.take(self.many.of_material)
        bend, twist = (1.0 + random.choice([-NEAR, NEAR], self.count) for _ in range(2))
        return Material(own.bend * bend[:, None, None, None], own.twist * twist[:, None], own.weight)

    @cached_property
    def pulled(self) -> Rods:
        """``many`` with their far end free, and a spring from every vertex to where the start has it."""
        points = self.many.starts.vertices
        springs = Springs(points, np.full(points.shape[:2], SPRING))
        return replace(self.many, clamps=replace(self.many.clamps, end=Clamp.FREE), springs=springs)

    @cached_property
    def batches(self) -> list[Rods]:
        """Batches of BATCH rods each."""
        return self.alone(BATCH, max(self.count // 4096, 1))

    def alone(self, size: int, count: int) -> list[Rods]:
        """``count`` batches of ``size`` of ``many``, over tables that hold no other rods."""
        return [self.many.alone(slice(at, at + size)) for at in (k * size % max(self.count - size, 1) for k in range(count))]


def cases(rods: Specimens) -> list[Case]:
    """The rows of ``doo-ti bench``."""
    return [
        Case("newton f32", "rods/s", lambda: relaxed([rods.many], COARSE, "f32")),
        Case("newton f64", "rods/s", lambda: relaxed([rods.many], FINE, "f64")),
        Case("newton mixed", "rods/s", lambda: relaxed([rods.many], FINE, "mixed")),
        Case("newton f32 general B", "rods/s", lambda: relaxed([rods.band], COARSE, "f32")),
        Case("newton f32 warm start", "rods/s", lambda: followed(rods)),
        Case("newton f32 free end, springs", "rods/s", lambda: relaxed([rods.pulled], COARSE, "f32")),
        Case("newton f32 batches of 256", "rods/s", lambda: relaxed(rods.batches, COARSE, "f32")),
    ]


def relaxed(batches: list[Rods], solver: Newton, precision: str) -> Outcome:
    """One call after another, each of all rods of a batch."""
    calls = []
    for rods in batches:
        solution = rods.relaxed(solver, precision)
        calls.append((solution, trips(solution, precision)))
    return converged(*calls)


def followed(rods: Specimens) -> Outcome:
    """All rods from their solution, under materials near those it is for."""
    solution = relax(rods.relaxed, rods.near, solver=CLOSE, precision="f32")
    return converged((solution, trips(solution, "f32")))


def trips(solution: Solution, precision: str) -> int:
    """Trips of all lanes of the call just made: of a launch in f32 unless f64 was asked for, and of one in f64 where that ended
    any rod."""
    launches = [32] * (precision != "f64") + [64] * bool((solution.precision == 64).any())
    return sum(int(np.prod(batch.pack_trips(bits))) for bits in launches)


def converged(*calls: tuple[Solution, int]) -> Outcome:
    """Calls, and the trips of their lanes, as one outcome. Only rods that converged count."""
    solutions, made = zip(*calls, strict=True)
    done, stable, residual, iterations = (
        np.concatenate([getattr(solution, name) for solution in solutions])
        for name in ("converged", "stable", "residual", "iterations"))
    return Outcome(float(done.sum()), float(done.mean()), float(stable.mean()), float(np.max(residual[done], initial=0.0)),
                   iterations, sum(made))


def measure(case: Case, reference: workload.Reference, rounds: int) -> Measurement:
    """Run once so that kernels are compiled, then time the case between two runs of the reference, ``rounds`` times."""
    case.run()
    once, outcome = workload.timed(case.run)
    calls = max(1, round(ROUND_SECONDS / once))
    rates, ratios = [], []
    for _ in range(rounds):
        before = reference.rate()
        seconds, outcomes = workload.timed(lambda: [case.run() for _ in range(calls)])
        rates.append(sum(outcome.amount for outcome in outcomes) / seconds)
        ratios.append(rates[-1] / (0.5 * (before + reference.rate())))
    rate, iterations = median(rates), outcome.iterations
    return Measurement(
        case.unit, rate, median(ratios), outcome.converged, float(iterations.mean()) if len(iterations) else 0.0,
        outcome.stable, outcome.residual,
        float(iterations.sum()) / outcome.trips if outcome.trips else None, tuple(np.bincount(iterations).tolist()),
    )


COMPARED = 4096  # rods whose shape in f32 is compared with f64's
SAME_MM = 0.02  # two rods are in the same minimum where the mean distance between their vertices is no more than this


def benchmark(count: int, rounds: int, threads: int | None) -> dict:
    """What ``doo-ti bench`` measures, with its progress on standard error: the content of ``bench.json``."""
    architecture, rods = runtime.start(threads=threads), Specimens(count)
    reference, chosen, measured = workload.Reference(runtime.thread_count()), cases(rods), {}
    with progress(keep=True) as bar:
        task = bar.add_task("", total=len(chosen) + 1, unit="steps", rate="")
        for case in chosen:
            bar.update(task, description=case.name)
            found = measured[case.name] = measure(case, reference, rounds)
            bar.update(task, rate=f"{found.per_second:,.0f} {found.unit}", advance=1)
        bar.update(task, description="f32 against f64")
        accuracy = f32_against_f64(rods)
        bar.update(task, rate=f"{accuracy['median_mm']:.1e} mm", advance=1)
    return {"machine": {**workload.machine(), "threads": runtime.thread_count(), "architecture": architecture},
            "versions": workload.versions(), "rods": count, "rounds": rounds,
            "cases": {name: asdict(found) for name, found in measured.items()},
            "f32_against_f64": accuracy}


def f32_against_f64(rods: Specimens) -> dict[str, float]:
    """Where f32 ends beside f64, on the first rods."""
    some = rods.many.take(slice(COMPARED))
    coarse, fine = rods.relaxed.configuration.take(slice(COMPARED)), some.relaxed(FINE, "f64").configuration
    apart = np.linalg.norm(coarse.vertices - fine.vertices, axis=-1).mean(axis=1)
    same = apart <= SAME_MM
    median_mm, high = np.percentile(apart[same], [50, 99]) if same.any() else (np.nan, np.nan)
    return {"rods": some.count, "same_minimum": float(same.mean()), "median_mm": float(median_mm),
            "percentile_99_mm": float(high)}
