"""The cells of a sweep, relaxed: rows of numbers and the rods they are about (§III-E).

Axes: G cells, D observations, H hypotheses of all observations, N rods of each cell, R = G·N rods.
"""

from dataclasses import replace

import numpy as np

from doo_ti.learning.experiment import Experiment
from doo_ti.learning.hypotheses import nearest, scores
from doo_ti.learning.objective import RESULTS, carried, relaxed
from doo_ti.metric import distance
from doo_ti.types import Configuration, Status


def relax_cells(experiment: Experiment, first: int, last: int) -> tuple[dict[str, np.ndarray], Configuration]:
    """The rows of cells ``first`` to ``last`` as their files hold them, columns by name, and the rods, aligned.

    Cell by cell, then observation by observation under Eq. 2 and pair by pair under Eq. 3. Of several hypotheses of an
    observation the nearest one stands in each cell; ``turns`` says which.
    """
    columns, rods = relax_hypotheses(experiment, first, last)
    if not experiment.hypotheses.are_several:
        return columns, rods
    rows = experiment.rows_of(_nearest(experiment, columns))
    return {name: column[rows] for name, column in columns.items()}, rods.take(rows)


def settled(experiment: Experiment, cell: int) -> Experiment:
    """The experiment with one hypothesis for each observation: the one that is nearest in that cell."""
    if not experiment.hypotheses.are_several:
        return experiment
    chosen, = _nearest(experiment, relax_hypotheses(experiment, cell, cell + 1)[0])
    return replace(experiment, hypotheses=experiment.hypotheses.take(chosen))


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


def _nearest(experiment: Experiment, columns: dict[str, np.ndarray]) -> np.ndarray:
    """(G, D) the hypothesis of each observation that is nearest in each cell of ``columns``."""
    of_rod, _ = experiment.rods
    sound = (columns["status"] == Status.CONVERGED) & columns["stable"]
    by_cell = (array.reshape(-1, len(of_rod)) for array in (columns[experiment.witness], sound))
    return nearest(*scores(*by_cell, experiment.weight, of_rod), experiment.hypotheses)
