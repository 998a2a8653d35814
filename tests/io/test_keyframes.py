"""Quantities that a file states at some moments."""

import numpy as np

from doo_ti.io.scene_keys import between_moments
from doo_ti.io.toml_file import NotNegative, Table, Vector

TIME = np.linspace(0.0, 2.0, 5)
FIRST = {"shift": np.zeros(3)}


class Moment(Table):
    time_s: NotNegative
    shift: Vector | None = None


def at(rows: list) -> np.ndarray:
    """(5,) of the first component."""
    return between_moments("scene.toml", "moments", rows, Moment, FIRST, TIME)["shift"][:, 0]


def test_without_moments_all_stays_as_it_is_at_first():
    assert not at([]).any()


def test_one_moment_at_time_zero_says_where_it_stays():
    assert (at([{"time_s": 0.0, "shift": [3.0, 0.0, 0.0]}]) == 3.0).all()


def test_what_is_left_out_stays_as_it_was():
    path = at([{"time_s": 0.0, "shift": [1.0, 0.0, 0.0]}, {"time_s": 1.0, "shift": [2.0, 0.0, 0.0]}, {"time_s": 1.5}])
    np.testing.assert_allclose(path[[0, 2, 3, 4]], [1.0, 2.0, 2.0, 2.0])
    assert 1.0 < path[1] < 2.0
