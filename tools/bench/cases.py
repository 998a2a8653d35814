"""Cases beside those of ``doo-ti bench``: single rods, the paper's scheme, Eq. 1."""

from functools import cache

import numpy as np

from doo_ti.bench.cases import COARSE, Case, Outcome, Specimens, relaxed
from doo_ti.bench.cases import cases as command_cases
from doo_ti.bench.workload import Rods
from doo_ti.io.observations import Observations
from doo_ti.metric import distance
from doo_ti.relaxation.descent import Descent
from doo_ti.types import Configuration


def cases(rods: Specimens) -> list[Case]:
    """All cases, those of the command first."""
    singles = cache(lambda: rods.alone(1, max(rods.count // 512, 1)))
    return [
        *command_cases(rods),
        Case("newton f32 one rod", "rods/s", lambda: relaxed(singles(), COARSE, "f32")),
        Case("descent f64", "iterations/s", lambda: stepped(rods.many.take(slice(max(rods.count // 64, 1))))),
        Case("metric", "rods/s", lambda: compared(rods.relaxed.configuration, rods.sutures[0])),
    ]


def stepped(rods: Rods) -> Outcome:
    """Gradient steps of the paper's scheme, whether they were enough or not."""
    iterations = rods.relaxed(Descent(max_iterations=1000), "f64").iterations
    return Outcome(float(iterations.sum()), iterations=iterations)


def compared(configuration: Configuration, observations: Observations) -> Outcome:
    """Eq. 1 of all rods."""
    error = distance(configuration, observations, np.arange(configuration.count) % observations.count)
    return Outcome(float(configuration.count), float(np.isfinite(error).mean()))
