"""Only cells whose rods all converged to certified minima compete: a rod that stalls at its observation scores best."""

from dataclasses import replace

import numpy as np
import pytest

from doo_ti import InputError, Status
from doo_ti.learning.cross_validation import cross_validate, partition
from doo_ti.learning.landscape import plane_of
from doo_ti.learning.terms import Hypotheses, resolved
from tests.learning.landscapes import static


def fooled(name: str = "nylon"):
    """Five cells of four rods, the second the best, except for the fourth, in which a rod stalled close to its observation."""
    distance = np.array([3.0, 1.0, 2.0, 0.1, 3.0])[:, None] + np.zeros(4)
    landscape = static(name, distance)
    landscape.status[3, 1] = Status.STALLED
    return landscape


def test_a_cell_with_a_rod_that_stalled_does_not_win():
    landscape = fooled()
    assert landscape.best == 1 and np.flatnonzero(np.isnan(landscape.mean_distance)).tolist() == [3]
    assert landscape.competition == {"cells_competing": 4, "cells_not_competing": 1, "terms_left_out": 0}
    interval, = landscape.intervals
    assert interval.best == landscape.grid.axes[0].values[1] and not interval.high_is_open
    # Nor does one with a saddle.
    landscape = fooled()
    landscape.status[:] = Status.CONVERGED
    stable = np.ones((5, 4), dtype=bool)
    stable[3, 0] = False
    assert replace(landscape, stable=stable).best == 1


def test_a_term_that_is_sound_in_no_cell_is_left_out():
    landscape = fooled()
    landscape.status[:, 2] = Status.ITERATION_LIMIT
    assert landscape.best == 1 and landscape.competition["terms_left_out"] == 1
    landscape = fooled()
    landscape.status[:] = Status.STALLED
    assert landscape.competition == {"cells_competing": 0, "cells_not_competing": 0, "terms_left_out": 4}
    with pytest.raises(InputError, match="certified"):
        landscape.best


def test_a_training_set_does_not_choose_it_nor_does_an_entry_win_a_column_by_rods_that_stalled():
    scores = cross_validate(partition([fooled(), static("silk", fooled().distance)], ("material",))[0])
    assert scores.best.tolist() == [1, 3] and (scores.mean[1] < scores.mean[0]).all()
    assert replace(scores, uncertified=np.array([[0, 0], [1, 0]])).is_best.tolist() == [[True, False], [False, True]]


def test_the_picture_marks_cells_that_do_not_compete():
    plane = plane_of(fooled())
    assert plane.minimum == (1, 0) and plane.unfinished.ravel().tolist() == [0, 0, 0, 1, 0]
    assert np.isnan(plane.values[3, 0]) and not plane.valley[3, 0]


def test_hypotheses_are_not_resolved_by_such_a_cell():
    """In the first cell the second hypothesis is right, in the other one, where rods stalled, the first."""
    hypotheses = Hypotheses(np.array([0, 0, 1]), np.array([0, 1, 0]))
    distance = np.array([[3.0, 1.0, 1.0], [0.1, 3.0, 0.1]])
    sound = np.array([[True, True, True], [False, False, False]])
    chosen, ambiguous = resolved(distance, sound, np.ones(2), hypotheses)
    assert chosen[0].tolist() == [1, 2] and not ambiguous.any()
