"""Studies whose tables pages show: each runs at its smallest size; what they count, and the truth that one of them makes."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.conftest import SEED
from tools.studies import calibration_study, group_study, picture_study
from tools.studies.calibration.coverage import Count, Interval, coverage, table, wilson
from tools.studies.marks_study.rod import cross, equilibria, turned


@pytest.mark.slow
@pytest.mark.parametrize(("study", "words", "said"), [
    (group_study, ["--groups", "4"], "converge"),
    (picture_study, ["--specimens", "1", "--seed", "2018"], "1 of 1 intervals")], ids=["groups", "pictures"])
def test_a_study_of_few(capfd, study, words, said):
    assert study.main(words) == 0 and said in capfd.readouterr().out


@pytest.mark.slow
def test_the_calibration_study_of_two_specimens(tmp_path, capsys):
    """A second run has nothing left to do and prints the same; a failed fit fails the study."""
    words = ["--specimens", "2", "--workers", "2", "--out", str(tmp_path)]
    calibration_study.main(words)
    first = capsys.readouterr().out
    assert "| bend |" in first and "failed" not in first and (tmp_path / "calibration.png").stat().st_size > 10_000
    calibration_study.main(words)
    assert capsys.readouterr().out == first
    file = tmp_path / "specimens.jsonl"
    file.write_text(file.read_text().replace('"failure": ""', '"failure": "torn"'))
    assert calibration_study.main(words) == 1 and "torn" in capsys.readouterr().out


def test_counts_by_kind_and_widths():
    some = [Interval(1.0, 1.1, 0.9, 1.3), Interval(1.0, 1.2, 1.1, 1.3), Interval(1.0, 0.9, 0.3, 1.5),
            Interval(1.0, 4.0, 2.0, 10.0), Interval(1.0, 2.0, 0.5, None), Interval(1.0, 2.0, 1.5, None),
            Interval(1.0, None, None, None), Interval(1.0, 0.8, 0.7, 1.2)]
    found = coverage(some)
    assert found.all == Count(5, 8) and found.two_sided == Count(3, 5) and found.wide == Count(1, 2)
    assert found.one_sided == Count(1, 2) and found.unbounded == Count(1, 1)
    assert found.bias == pytest.approx(np.median(np.log([1.1, 1.2, 0.9, 4.0, 2.0, 2.0, 0.8]))) and not found.accepted
    assert wilson(Count(95, 100)) == pytest.approx((0.8882, 0.9785), abs=1e-3)
    lines = table({"bend": found, "twist_ratio": coverage([])}).splitlines()
    assert len({line.replace("\\|", "").count("|") for line in lines}) == 1 and "5 of 8" in lines[2]


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
