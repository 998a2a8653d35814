"""The rod of the marks study against a closed form and an initial value problem; its specimens; its table."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.special import ellipe, ellipk

from tests.conftest import SEED
from tools.studies.marks_study.rod import cross, equilibria, turned
from tools.studies.marks_study.table import deviation, table


def test_buckled_elastica():
    """Half of a rod between parallel clamps, at which modulus k gives distance 2E/K − 1 and deflection k/K of its length."""
    k = 0.6
    whole, K = ellipe(k * k), ellipk(k * k)
    span = np.array([[2 * whole / K - 1, 2 * k / K, 0]])
    ends = np.eye(3)[None]
    rods, right = equilibria(30, 0.7, np.zeros((1, 3)), ends, span, ends, np.zeros((31, 3)))
    assert right.all()
    np.testing.assert_allclose(rods.force[0], [-((2 * K) ** 2), 0, 0], atol=1e-5)
    np.testing.assert_allclose(rods.points_at([0.5, 1.0])[0], [span[0] / 2, span[0]], atol=1e-9)


@pytest.mark.parametrize("load", [0.0, 60.0])
def test_the_rod_solves_the_initial_value_problem_of_its_start(load):
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


def test_coverage_is_counted_towards_the_truth():
    assert deviation([1.0, 0.5, 4.0], 2.0) == pytest.approx(-0.98) and deviation([1.0, 0.5, 4.0], 0.25) == pytest.approx(3.92)
    assert deviation([1.0, 0.5, None], 9.0) == 0.0 and deviation([None, None, None], 1.0) is None
    truth = {"family": "suture", "frames_given": True, "spacings_stated": True, "nuisances": ["chord"], "EI": 1.0, "GJ": 3.0}
    row = {"key": "all suture 1", "group": "all", "truth": truth, "code": 0, "converged": True, "seconds": 1.0, "text": "",
           "EI": [1.1, 0.9, 1.2], "GJ": [1.0, 0.5, 2.0]}
    text = table([row])
    assert "| all | suture | EI | 1 of 1 |" in text and "| all | suture | GJ | 0 of 1 |" in text
    assert "all suture 1: GJ z -3.11; chord" in text
