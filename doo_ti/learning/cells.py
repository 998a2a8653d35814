"""The rods of Eqs. 2 and 3, relaxed cell by cell (§III-E): rows of numbers as the run's files hold them, and their shapes.

Axes: G cells or materials, D observations, H hypotheses of all observations, N rods of each cell, R = G·N rods, cell by cell.
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from doo_ti.learning.chunks import chunk_path, read_columns, read_rows, write_rows
from doo_ti.learning.experiment import Experiment, nearest, resolved, scores, started
from doo_ti.motion.journey import Journey
from doo_ti.motion.path import motion_between
from doo_ti.relaxation.newton import Newton
from doo_ti.relaxation.relax import relax
from doo_ti.rod.metric import distance
from doo_ti.rod.types import Configuration, Material, Solution, Status, sticky

FEW_RODS = 64  # enough for the kernels of large batches: fewer rods have kernels with fewer of them in a value
RESULTS = ("energy", "residual", "iterations", "status", "stable", "precision")  # arrays of a solution that become columns


def relaxed(experiment: Experiment, materials: Material) -> Solution:
    """Γ̃^x of Eq. 2: each hypothesis under each material, G·H rods."""
    options, observations = experiment.options, experiment.observations
    starts, clamps = started(observations, experiment.clamps, experiment.hypotheses)
    of_material, hypothesis = np.divmod(np.arange(materials.count * starts.count), starts.count)
    return relax(starts, materials, clamps, options.solver, up=observations.up, precision=options.precision,
                 configuration_index=hypothesis, material_index=of_material, **options.surroundings.arguments)


def load_kernels(experiment: Experiment) -> None:
    """Relax a few rods, which compiles the kernels of a sweep, or loads them where they were compiled before."""
    options, observations = experiment.options, experiment.observations
    starts, clamps = started(observations, experiment.clamps, experiment.hypotheses)
    rows = np.resize(np.arange(starts.count), FEW_RODS)
    relax(starts.take(rows), experiment.grid.materials(slice(0, 1)), clamps.take(rows), options.solver, up=observations.up,
          precision=options.precision, **options.surroundings.arguments)


def carried(experiment: Experiment, materials: Material) -> tuple[Solution, np.ndarray, np.ndarray]:
    """Γ̃^xy of Eq. 3, R rods; the number of jumps of each (R,); and the distance of Γ̃^x from Γ^x (R,), Eq. 1 in mm."""
    begin, rows = _relaxed_once(experiment, materials)
    solution, jumps = journey(experiment, materials).end(begin.configuration.take(rows))
    first = np.tile(experiment.hypotheses.observation, materials.count)
    off = distance(begin.configuration, experiment.observations, first, experiment.options.frame_weight)
    status, iterations = sticky(begin.status[rows], solution.status), begin.iterations[rows] + solution.iterations
    return replace(solution, status=status, iterations=iterations), jumps, off[rows]


def sub_steps(experiment: Experiment, material: Material) -> Iterator[tuple[Configuration, np.ndarray, np.ndarray, np.ndarray]]:
    """Configuration, energy, residual and status (N,) of the rods of Eq. 3 under one material: before their motion, after each
    sub-step, and at the end."""
    begin, rows = _relaxed_once(experiment, material)
    there = begin.configuration.take(rows)
    yield there, begin.energy[rows], begin.residual[rows], begin.status[rows]
    for solution in journey(experiment, material).follow(there):
        yield solution.configuration, solution.energy, solution.residual, solution.status


def iterations(experiment: Experiment, material: Material, most: int) -> Iterator[tuple]:
    """As :func:`sub_steps` the rods of Eq. 2 at their starts, then after 1, 2, … iterations of Newton, ``most`` of them. A
    relaxation stopped after k iterations equals the first k of the whole one."""
    starts, clamps = started(experiment.observations, experiment.clamps, experiment.hypotheses)
    nothing = np.full(starts.count, np.nan)
    yield starts, nothing, nothing, None
    for count in range(1, most + 1):
        solution = relax(starts, material, clamps, Newton(max_iterations=count), up=experiment.observations.up,
                         **experiment.options.surroundings.arguments)
        yield solution.configuration, solution.energy, solution.residual, solution.status
        if (solution.iterations < count).all():
            return


def journey(experiment: Experiment, materials: Material) -> Journey:
    """The motions from C^x to C^y of the pairs, one for each hypothesis of x."""
    pairs, options, observations = experiment.pairs, experiment.options, experiment.observations
    hypothesis, term = experiment.rods
    _, clamps = started(observations, experiment.clamps, experiment.hypotheses)
    rotation = None if pairs.rotation is None else pairs.rotation[term]
    motion = motion_between(clamps.take(hypothesis), experiment.clamps.take(pairs.to_index[term]), rotation)
    return Journey(motion, materials, options.sub_step, observations.rest_length, observations.up, options.solver,
                   options.precision, options.surroundings)


def relax_cells(experiment: Experiment, first: int, last: int) -> tuple[dict[str, np.ndarray], Configuration]:
    """The rows of cells ``first`` to ``last`` as their files hold them, columns by name, and the rods, aligned.

    Cell by cell, then observation by observation under Eq. 2 and pair by pair under Eq. 3. Of several hypotheses of an
    observation each cell holds the nearest one; the column ``turns`` says which.
    """
    columns, rods = relax_hypotheses(experiment, first, last)
    if not experiment.hypotheses.are_several:
        return columns, rods
    rows = experiment.rows_of(_nearest(experiment, columns))
    return {name: column[rows] for name, column in columns.items()}, rods.take(rows)


def relax_hypotheses(experiment: Experiment, first: int, last: int) -> tuple[dict[str, np.ndarray], Configuration]:
    """As :func:`relax_cells`, with a row for each hypothesis."""
    observations, grid, pairs = experiment.observations, experiment.grid, experiment.pairs
    hypothesis, term = experiment.rods
    cells, rods = last - first, len(hypothesis)
    of_cell, of_rod = np.divmod(np.arange(cells * rods), rods)
    materials = grid.materials(slice(first, last))
    if pairs is None:
        solution, observation = relaxed(experiment, materials), term
    else:
        solution, jumps, off = carried(experiment, materials)
        observation = pairs.to_index[term]
    own = observation[of_rod]
    columns = {name: values[of_cell] for name, values in grid.cell_values(slice(first, last)).items()}
    if pairs is not None:
        columns["from_observation"] = pairs.from_index[term].astype(np.int32)[of_rod]
    columns["observation"] = own.astype(np.int32)
    columns["turns"] = experiment.hypotheses.turns[hypothesis].astype(np.int32)[of_rod]
    if experiment.hypotheses.spin is not None:
        columns["spin_deg"] = np.degrees(experiment.hypotheses.spin[hypothesis])[of_rod]
    for name, labels in (("end_distance_mm", observations.end_distance), ("end_rotation_deg", observations.end_rotation)):
        columns[name] = np.full(len(own), np.nan) if labels is None else labels[own]
    columns["distance_mm"] = distance(solution.configuration, observations, own, experiment.options.frame_weight)
    columns |= {name: getattr(solution, name) for name in RESULTS}
    if pairs is not None:
        columns |= {"start_distance_mm": off, "jumps": jumps, "pair_weight": pairs.weight[term][of_rod]}
    return columns, solution.configuration


def settled(experiment: Experiment, cell: int) -> Experiment:
    """The experiment with one hypothesis for each observation: the nearest in that cell."""
    if not experiment.hypotheses.are_several:
        return experiment
    chosen, = _nearest(experiment, relax_hypotheses(experiment, cell, cell + 1)[0])
    return replace(experiment, hypotheses=experiment.hypotheses.take(chosen))


def resolve(run: Path, experiment: Experiment, chunks: list[tuple[int, int]]) -> dict:
    """Choose one hypothesis for each observation, the same in all cells, and write its rows of RUN/hypotheses into RUN/cells;
    returns the choice as JSON holds it.

    ``kept`` are the hypotheses of all observations: one, or of an ambiguous observation all that it has.
    """
    hypotheses, (of_rod, _) = experiment.hypotheses, experiment.rods
    distances, sound = [], []
    for first, last in chunks:
        columns = read_columns(chunk_path(run, "hypotheses", first, last), [experiment.decides, "status", "stable"])
        of_chunk = _by_cell(experiment, columns)
        distances.append(of_chunk[0])
        sound.append(of_chunk[1])
    score = scores(np.concatenate(distances), np.concatenate(sound), experiment.weight, of_rod)
    observation, table = hypotheses.table
    weight = np.ones(len(table))
    if experiment.pairs is not None:
        weight = np.bincount(experiment.pairs.from_index, experiment.pairs.weight)[observation]
    chosen, ambiguous = resolved(*score, weight, hypotheses)
    for first, last in chunks:
        rows = read_rows(chunk_path(run, "hypotheses", first, last))
        write_rows(chunk_path(run, "cells", first, last), rows.take(experiment.rows_of(chosen[first:last])))
    kept = np.isin(hypotheses.observation, observation[ambiguous]) | np.isin(np.arange(hypotheses.count), chosen[0])
    return {"hypotheses": hypotheses.count, "resolved": int((~ambiguous).sum()), "ambiguous": observation[ambiguous].tolist(),
            "kept": hypotheses.take(kept).as_dict()}


def _relaxed_once(experiment: Experiment, materials: Material) -> tuple[Solution, np.ndarray]:
    """Γ̃^x, each (material, hypothesis) once, and for each of the R rods its row (R,)."""
    hypothesis, _ = experiment.rods
    rows = np.arange(materials.count)[:, None] * experiment.hypotheses.count + hypothesis
    return relaxed(experiment, materials), rows.ravel()


def _nearest(experiment: Experiment, columns: dict[str, np.ndarray]) -> np.ndarray:
    """(G, D) the hypothesis of each observation that is nearest in each cell of ``columns``."""
    score = scores(*_by_cell(experiment, columns), experiment.weight, experiment.rods[0])
    return nearest(*score, experiment.hypotheses)


def _by_cell(experiment: Experiment, columns: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """(G, N) the distance that decides between hypotheses, mm, and whether the rod is a certified minimum."""
    shape = -1, len(experiment.rods[0])
    sound = (columns["status"] == Status.CONVERGED) & columns["stable"]
    return columns[experiment.decides].reshape(shape), sound.reshape(shape)
