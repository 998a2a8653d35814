"""The end of a sweep over hypotheses: one for each observation, the same in all cells, and the cells' files made of those."""

from pathlib import Path

import numpy as np

from doo_ti.learning.chunk_file import chunk_path, read_columns, read_rows, write_rows
from doo_ti.learning.experiment import Experiment
from doo_ti.learning.hypotheses import resolved, scores
from doo_ti.types import Status


def resolve(run: Path, experiment: Experiment, chunks: list[tuple[int, int]]) -> dict:
    """Write the rows of RUN/hypotheses that stand into RUN/cells, and tell which those are, as JSON holds it.

    ``kept`` are the hypotheses of all observations, of an ambiguous one all that it had.
    """
    hypotheses, (of_rod, _) = experiment.hypotheses, experiment.rods
    distance, sound = [], []
    for first, last in chunks:
        columns = read_columns(chunk_path(run, "hypotheses", first, last), [experiment.witness, "status", "stable"])
        error, status, stable = columns.values()
        distance.append(error.reshape(last - first, -1))
        sound.append(((status == Status.CONVERGED) & stable).reshape(last - first, -1))
    score = scores(np.concatenate(distance), np.concatenate(sound), experiment.weight, of_rod)
    observation, table = hypotheses.table
    weight = np.ones(len(table))
    if experiment.pairs is not None:
        weight = np.bincount(experiment.pairs.from_index, experiment.pairs.weight)[observation]
    chosen, ambiguous = resolved(*score, weight, hypotheses)
    for first, last in chunks:
        rows = read_rows(chunk_path(run, "hypotheses", first, last))
        write_rows(chunk_path(run, "cells", first, last), rows.take(experiment.rows_of(chosen[first:last])))
    settled = np.isin(hypotheses.observation, observation[ambiguous]) | np.isin(np.arange(hypotheses.count), chosen[0])
    return {"hypotheses": hypotheses.count, "resolved": int((~ambiguous).sum()), "ambiguous": observation[ambiguous].tolist(),
            "kept": hypotheses.take(settled).as_dict()}
