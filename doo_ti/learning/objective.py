"""F as the objectives call for it: from the observation under Eq. 2, carried from one to another under Eq. 3 (§III-E).

Axes: G materials, H hypotheses of all observations, N rods of each material under Eq. 3, R = G·N rods, material by material.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from doo_ti.learning.experiment import Experiment
from doo_ti.learning.hypotheses import started
from doo_ti.metric import distance
from doo_ti.motion.journey import Journey
from doo_ti.motion.path import motion_between
from doo_ti.relaxation.relax import relax
from doo_ti.types import Configuration, Material, Solution, lasting

RESULTS = ("energy", "residual", "iterations", "status", "stable", "precision")
"""What a row tells of a solution."""


def relaxed(experiment: Experiment, materials: Material) -> Solution:
    """Γ̃ of Eq. 2: each hypothesis under each of the materials, G·H rods."""
    options, observations = experiment.options, experiment.observations
    starts, clamps = started(observations, experiment.clamps, experiment.hypotheses)
    of_material, hypothesis = np.divmod(np.arange(materials.count * starts.count), starts.count)
    return relax(starts, materials, clamps, options.solver, up=observations.up, precision=options.precision,
                 configuration_index=hypothesis, material_index=of_material)


def carried(experiment: Experiment, materials: Material) -> tuple[Solution, np.ndarray, np.ndarray]:
    """Γ̃ of Eq. 3, R rods, how often each of them jumped (R,), and how far off it was where it set out (R,), Eq. 1 in mm."""
    begin, rows = _relaxed_once(experiment, materials)
    solution, jumps = journey(experiment, materials).end(begin.configuration.take(rows))
    first = np.tile(experiment.hypotheses.observation, materials.count)
    off = distance(begin.configuration, experiment.observations, first, experiment.options.frame_weight)
    status, iterations = lasting(begin.status[rows], solution.status), begin.iterations[rows] + solution.iterations
    return replace(solution, status=status, iterations=iterations), jumps, off[rows]


def sub_steps(experiment: Experiment, material: Material) -> Iterator[tuple[Configuration, np.ndarray, np.ndarray, np.ndarray]]:
    """Configuration, energy, residual and status (N,) of the rods of Eq. 3 under one material: where they set out, after each
    sub-step, and at the end."""
    begin, rows = _relaxed_once(experiment, material)
    there = begin.configuration.take(rows)
    yield there, begin.energy[rows], begin.residual[rows], begin.status[rows]
    for solution in journey(experiment, material).follow(there):
        yield solution.configuration, solution.energy, solution.residual, solution.status


def journey(experiment: Experiment, materials: Material) -> Journey:
    """The ways from C^x to C^y of the pairs, once for each hypothesis of x."""
    pairs, options, observations = experiment.pairs, experiment.options, experiment.observations
    hypothesis, term = experiment.rods
    _, clamps = started(observations, experiment.clamps, experiment.hypotheses)
    rotation = None if pairs.rotation is None else pairs.rotation[term]
    motion = motion_between(clamps.take(hypothesis), experiment.clamps.take(pairs.to_index[term]), rotation)
    return Journey(motion, materials, options.sub_step, observations.rest_length, observations.up, options.solver,
                   options.precision)


def _relaxed_once(experiment: Experiment, materials: Material) -> tuple[Solution, np.ndarray]:
    """The rods relaxed where they set out, each (material, hypothesis) once, and rows (R,) of these."""
    hypothesis, _ = experiment.rods
    rows = np.arange(materials.count)[:, None] * experiment.hypotheses.count + hypothesis
    return relaxed(experiment, materials), rows.ravel()
