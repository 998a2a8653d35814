"""The cases that are timed: rods × material × precision, NumPy in to NumPy out, kernels warm.

    measured = measure(case, clock.Reference(threads), rounds)

Of rods that are relaxed only those that converged count.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from statistics import median

import numpy as np

from doo_ti.bench import clock, workload
from doo_ti.bench.workload import Rods
from doo_ti.dataset import Observations
from doo_ti.metric import distance
from doo_ti.relaxation import batch
from doo_ti.relaxation.descent import Descent
from doo_ti.relaxation.newton import Newton
from doo_ti.relaxation.relax import relax_again
from doo_ti.types import Configuration, Material, Solution

COARSE, FINE = Newton(tolerance=1e-6), Newton(tolerance=1e-9)
CLOSE = Newton(tolerance=1e-6, first_shift=0.0)
# Additions, multiplications, divisions and roots of one iteration over one edge, counted in the loops' machine code.
FLOPS_PER_EDGE = {"isotropic": 890.0, "general": 1480.0, "springs": 1140.0}
ROUND_SECONDS = 0.3
"""A round repeats its case for about this long, so that a neighbour's moment of work does not decide it."""


@dataclass(frozen=True)
class Outcome:
    """What one run of a case did.

    amount      how much of its unit
    converged, stable  shares of the rods
    residual    the largest of the rods that converged, 1/mm; None where nothing is relaxed
    iterations  (R,) of the rods, empty where nothing is relaxed
    flops       floating-point operations by FLOPS_PER_EDGE, 0 where they are not counted
    """

    amount: float
    converged: float = 1.0
    stable: float | None = None
    residual: float | None = None
    iterations: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    flops: float = 0.0


@dataclass(frozen=True)
class Case:
    """Something timed: ``run()`` once, warm, does an :class:`Outcome`, counted in ``unit``.

    ``launches`` are the precisions in bits of the kernel's launches in a run, where a run is one call of them: then the
    lanes that were busy can be told.
    """

    name: str
    unit: str
    run: Callable[[], Outcome]
    launches: tuple[int, ...] = ()


@dataclass(frozen=True)
class Measurement:
    """Medians over the rounds.

    per_second  of the case's unit
    ratio       that rate to the NumPy workload's of the same round
    iterations  mean over the rods
    gflops      10⁹ operations per second by FLOPS_PER_EDGE, None where they are not counted
    busy        share of the lanes' trips that were iterations of a rod, None where it cannot be told
    histogram   number of rods that took 0, 1, 2, … iterations
    """

    unit: str
    per_second: float
    ratio: float
    converged: float
    iterations: float
    stable: float | None = None
    residual: float | None = None
    gflops: float | None = None
    busy: float | None = None
    histogram: tuple[int, ...] = ()


class Specimens:
    """The rods of all cases, made when they are first asked for; ``count`` of them where the size is not the point."""

    def __init__(self, count: int):
        self.count = count

    @cached_property
    def sutures(self) -> list[Observations]:
        return workload.observed(*workload.SUTURES)

    @cached_property
    def many(self) -> Rods:
        """The sutures' observations in turn, under isotropic materials."""
        tables = workload.in_turn([workload.started(observations) for observations in self.sutures])
        return workload.paired(*tables, workload.isotropic_materials(self.count))

    @cached_property
    def band(self) -> Rods:
        """The ribbon's observations under materials with a B of two values."""
        return workload.paired(*workload.started(*workload.observed("ribbon")), workload.ribbon_materials(self.count))

    @cached_property
    def relaxed(self) -> Solution:
        """The solution of ``many``."""
        return self.many.relaxed(COARSE, "f32")

    @cached_property
    def near(self) -> Material:
        """A tenth of bend and twist away from what ``many`` is relaxed under."""
        return workload.near(self.many)

    @cached_property
    def pulled(self) -> Rods:
        """``many`` with their far end free and springs at their vertices."""
        return workload.pulled(self.many)

    @cached_property
    def handfuls(self) -> list[Rods]:
        """Batches of 256 of ``many``, over tables that hold no other rods."""
        return self._batches(256, max(self.count // 4096, 1))

    @cached_property
    def singles(self) -> list[Rods]:
        """Rods of ``many``, each by itself."""
        return self._batches(1, max(self.count // 512, 1))

    def _batches(self, size: int, count: int) -> list[Rods]:
        return [self.many.alone(slice(at, at + size)) for at in (k * size % max(self.count - size, 1) for k in range(count))]


def cases(rods: Specimens) -> list[Case]:
    """The matrix."""
    return [
        Case("newton f32", "rods/s", lambda: relaxed(rods.many, COARSE, "f32"), (32,)),
        Case("newton f64", "rods/s", lambda: relaxed(rods.many, FINE, "f64"), (64,)),
        Case("newton mixed", "rods/s", lambda: relaxed(rods.many, FINE, "mixed"), (32, 64)),
        Case("newton f32 general B", "rods/s", lambda: relaxed(rods.band, COARSE, "f32"), (32,)),
        Case("newton f32 warm start", "rods/s", lambda: followed(rods), (32,)),
        Case("newton f32 free end, springs", "rods/s", lambda: relaxed(rods.pulled, COARSE, "f32"), (32,)),
        Case("newton f32 batches of 256", "rods/s", lambda: one_by_one(rods.handfuls)),
        Case("newton f32 one rod", "rods/s", lambda: one_by_one(rods.singles)),
        Case("descent f64", "iterations/s", lambda: stepped(rods.many.take(slice(max(rods.count // 64, 1))))),
        Case("metric", "rods/s", lambda: compared(rods.relaxed.configuration, rods.sutures[0])),
    ]


def relaxed(rods: Rods, solver: Newton, precision: str) -> Outcome:
    """All rods in one call."""
    return converged(rods, rods.relaxed(solver, precision))


def followed(rods: Specimens) -> Outcome:
    """All rods from their solution, under materials near those it is for."""
    return converged(rods.many, relax_again(rods.relaxed, rods.near, CLOSE, precision="f32"))


def one_by_one(batches: list[Rods]) -> Outcome:
    """One call after another."""
    return converged(batches[0], *(rods.relaxed(COARSE, "f32") for rods in batches))


def converged(rods: Rods, *solutions: Solution) -> Outcome:
    """Only rods that converged count."""
    done, stable, residual, iterations = (
        np.concatenate([getattr(solution, name) for solution in solutions])
        for name in ("converged", "stable", "residual", "iterations"))
    variant = "springs" if rods.springs else "isotropic" if rods.material.is_isotropic else "general"
    flops = rods.starts.edges * FLOPS_PER_EDGE[variant]
    return Outcome(float(done.sum()), float(done.mean()), float(stable.mean()), float(np.max(residual[done], initial=0.0)),
                   iterations, flops * float(iterations.sum()))


def stepped(rods: Rods) -> Outcome:
    """Gradient steps of the paper's scheme count, whether they were enough or not."""
    iterations = rods.relaxed(Descent(max_iterations=1000), "f64").iterations
    return Outcome(float(iterations.sum()), iterations=iterations)


def compared(configuration: Configuration, observations: Observations) -> Outcome:
    """Eq. 1 of all rods."""
    error = distance(configuration, observations, np.arange(configuration.count) % observations.count)
    return Outcome(float(configuration.count), float(np.isfinite(error).mean()))


def measure(case: Case, reference: clock.Reference, rounds: int) -> Measurement:
    """Warm up, then time the case between two runs of the reference, ``rounds`` times."""
    case.run()
    once, outcome = clock.timed(case.run)
    busy = _busy(outcome, case.launches)
    calls = max(1, round(ROUND_SECONDS / once))
    rates, ratios = [], []
    for _ in range(rounds):
        before = reference.rate()
        seconds, outcomes = clock.timed(lambda: [case.run() for _ in range(calls)])
        rates.append(sum(outcome.amount for outcome in outcomes) / seconds)
        ratios.append(rates[-1] / (0.5 * (before + reference.rate())))
    rate, iterations = median(rates), outcome.iterations
    return Measurement(
        case.unit, rate, median(ratios), outcome.converged, float(iterations.mean()) if len(iterations) else 0.0,
        outcome.stable, outcome.residual, 1e-9 * outcome.flops * rate / outcome.amount if outcome.flops else None, busy,
        tuple(np.bincount(iterations).tolist()),
    )


def _busy(outcome: Outcome, launches: tuple[int, ...]) -> float | None:
    """The rods' iterations over the trips of all lanes in the run just made."""
    trips = sum(int(trips) * lanes for trips, lanes in map(batch.pack_trips, launches))
    return float(outcome.iterations.sum()) / trips if trips else None
