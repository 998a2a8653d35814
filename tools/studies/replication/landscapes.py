"""Eqs. 2 and 3 of a specimen over its scene's grid, in memory."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from doo_ti import Landscape, Material, Pairs, distance
from doo_ti.learning.cells import journey
from doo_ti.learning.experiment import Experiment, started
from doo_ti.learning.sweeps import chunk_rows
from tools.studies.replication.settings import Setting
from tools.studies.replication.specimens import Specimen

CELLS_AT_ONCE = 125


def landscape(specimen: Specimen, setting: Setting, objective: str, pairs: Pairs | None = None) -> Landscape:
    """The distances of all observations, or pairs, in all cells.

    pairs  of Eq. 3; None: the paper's
    """
    options = replace(setting.sweeps, objective=objective, frame_weight=specimen.frame_weight)
    experiment = Experiment(specimen.observations, specimen.grid, options, pairs)
    rows_of = chunk_rows if objective == "static" or setting.relaxed_first else _carried_from_the_observation
    chunks = [rows_of(experiment, first, min(first + CELLS_AT_ONCE, specimen.grid.size))
              for first in range(0, specimen.grid.size, CELLS_AT_ONCE)]
    names = {"distance_mm", "status", "stable"} | ({"jumps"} if objective == "dynamic" else set())
    shape = specimen.grid.size, experiment.terms
    found = {name: np.concatenate([chunk[name] for chunk in chunks]).reshape(shape) for name in names}
    if experiment.pairs is None:
        begin = end = np.arange(experiment.terms)
        weight = np.ones(experiment.terms)
    else:
        begin, end, weight = experiment.pairs.from_index, experiment.pairs.to_index, experiment.pairs.weight
    observations = specimen.observations
    return Landscape(
        run=Path(specimen.name), name=specimen.name, grid=specimen.grid, objective=objective, distance=found["distance_mm"],
        status=found["status"], stable=found["stable"], observation=end, from_observation=begin, weight=weight,
        end_distance=observations.end_distance[end], end_rotation=observations.end_rotation[end], jumps=found.get("jumps"))


def _carried_from_the_observation(experiment: Experiment, first: int, last: int) -> dict[str, np.ndarray]:
    """Eq. 3 as printed, F(Γ^x, E_Θ, C^y): the observation itself is carried, not the rod relaxed from it."""
    materials = experiment.grid.materials(slice(first, last))
    hypothesis, term = experiment.rods
    starts, _ = started(experiment.observations, experiment.clamps, experiment.hypotheses)
    solution, jumps = journey(experiment, materials).end(starts.take(np.tile(hypothesis, materials.count)))
    own = np.tile(experiment.pairs.to_index[term], materials.count)
    off = distance(solution.configuration, experiment.observations, own, experiment.options.frame_weight)
    return {"distance_mm": off, "status": solution.status, "stable": solution.stable, "jumps": jumps}


def best_cells(landscape: Landscape) -> dict[float, int]:
    """The best cell of each end distance."""
    found = {}
    for each in np.unique(landscape.end_distance):
        terms = landscape.end_distance == each
        error = np.where(landscape.sound[:, terms].all(axis=1), landscape.distance[:, terms].mean(axis=1), np.inf)
        found[float(each)] = int(error.argmin())
    return found


def learned(landscape: Landscape, by_distance: bool) -> Material:
    """Θ of the static objective: one, or a row for each observation by its end distance."""
    if not by_distance:
        return landscape.grid.materials(slice(landscape.best, landscape.best + 1))
    best = best_cells(landscape)
    cells = np.array([best[float(each)] for each in landscape.end_distance])
    return landscape.grid.materials().take(cells)


def values(landscape: Landscape, cell: int) -> dict[str, float]:
    """Θ of a cell by name."""
    return {name: float(value[0]) for name, value in landscape.grid.cell_values(np.array([cell])).items()}
