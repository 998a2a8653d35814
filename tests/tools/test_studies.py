"""Studies whose tables pages show: each runs at its smallest size; what one of them counts, and the truth that it makes."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.conftest import SEED
from tools.studies import group_study, picture_study
from tools.studies.marks_study.rod import cross, equilibria, turned
from tools.studies.marks_study.table import deviation


@pytest.mark.slow
@pytest.mark.parametrize(("study", "words", "said"), [
    (group_study, ["--groups", "4"], "converge"),
    (picture_study, ["--specimens", "1", "--seed", "2018"], "1 of 1 intervals")], ids=["groups", "pictures"])
def test_a_study_of_few(capfd, study, words, said):
    assert study.main(words) == 0 and said in capfd.readouterr().out


def test_the_marks_study_counts_what_is_outside_on_either_side():
    assert deviation([1.1, 0.9, 1.3], 1.0) == pytest.approx(1.96 * np.log(1.1) / np.log(1.1 / 0.9))
    assert deviation([1.1, 1.05, 1.3], 1.0) > 1.96 and deviation([0.9, 0.7, 0.95], 1.0) < -1.96
    assert deviation([2.0, None, 3.0], 1.0) == 0.0 and deviation(None, 1.0) is None


@pytest.mark.parametrize("load", [0.0, 60.0])
def test_a_rod_of_the_marks_study_solves_the_initial_value_problem_of_its_start(load):
    rng = np.random.default_rng(SEED)
    start, end = turned(rng.normal(0, 0.4, (4, 3))), turned(rng.normal(0, 0.6, (4, 3)))
    span = np.array([[0.7, 0.2, 0.1]]) * rng.uniform(0.8, 1.1, (4, 1))
    bent = np.array([0, 0.4, -0.2])
    rods, right = equilibria(34, 0.6, np.tile([0, 0, load], (4, 1)), start, span, end, np.tile(bent, (35, 1)))
    assert right.all()

    def along(s, y, rod):
        frame = y[3:12].reshape(3, 3)
        kappa = frame.T @ y[12:] / [0.6, 1, 1] + bent
        return np.concatenate([frame[:, 0], (frame @ cross(kappa)).ravel(), -np.cross(frame[:, 0], force(rod, s))])

    def force(rod, s):
        return rods.force[rod] + s * rods.weight[rod]

    for rod in range(4):
        y = np.concatenate([np.zeros(3), start[rod].ravel(), rods.moments()[rod, 0]])
        y = solve_ivp(along, (0, 1), y, args=(rod,), rtol=1e-9, atol=1e-11).y[:, -1]
        np.testing.assert_allclose(y[:3], span[rod], atol=3e-5)
        np.testing.assert_allclose(y[3:12], end[rod].ravel(), atol=3e-4)
