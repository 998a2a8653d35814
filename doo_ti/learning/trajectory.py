"""How the rods of one cell came to where they are: iteration by iteration under Eq. 2, sub-step by sub-step under Eq. 3.

Axes: T moments, N terms of the objective.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from doo_ti.learning.cells import settled
from doo_ti.learning.experiment import Experiment
from doo_ti.learning.hypotheses import started
from doo_ti.learning.objective import sub_steps
from doo_ti.metric import distance
from doo_ti.relaxation.newton import Newton
from doo_ti.relaxation.relax import relax
from doo_ti.types import Material

MOST_MOMENTS = 60
"""Iterations, or sub-steps, evenly chosen, that are kept."""


@dataclass(frozen=True)
class Trajectory:
    """vertices (T, N, V, 3) mm; energy, residual (T, N), NaN where there is none; status and distance (N,) at the end."""

    vertices: np.ndarray
    energy: np.ndarray
    residual: np.ndarray
    status: np.ndarray
    distance: np.ndarray


def trajectory(experiment: Experiment, cell: int) -> Trajectory:
    """That of a cell's rods, each observation under the hypothesis that is nearest there."""
    experiment = settled(experiment, cell)
    material = experiment.grid.materials(slice(cell, cell + 1))
    terms = experiment.rods[1]
    if experiment.pairs is None:
        index, moments = None, list(_iterations(experiment, material))
    else:
        index, moments = experiment.pairs.to_index[terms], list(sub_steps(experiment, material))
    kept = np.unique(np.linspace(0, len(moments) - 1, min(len(moments), MOST_MOMENTS + 1)).round().astype(int))
    configurations, energy, residual, status = zip(*(moments[k] for k in kept), strict=True)
    error = distance(configurations[-1], experiment.observations, index, experiment.options.frame_weight)
    vertices = np.stack([configuration.vertices for configuration in configurations])
    return Trajectory(vertices, np.stack(energy), np.stack(residual), status[-1], error)


def _iterations(experiment: Experiment, material: Material) -> Iterator[tuple]:
    """The rods of Eq. 2 at their starts, then after 1, 2, … iterations of Newton, as
    :func:`doo_ti.learning.objective.sub_steps` gives
    them. A relaxation stopped after k iterations is the first k of the whole one."""
    starts, clamps = started(experiment.observations, experiment.clamps, experiment.hypotheses)
    nothing = np.full(starts.count, np.nan)
    yield starts, nothing, nothing, None
    for count in range(1, MOST_MOMENTS + 1):
        solution = relax(starts, material, clamps, Newton(max_iterations=count), up=experiment.observations.up)
        yield solution.configuration, solution.energy, solution.residual, solution.status
        if (solution.iterations < count).all():
            return
