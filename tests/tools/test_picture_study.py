"""The study of stiffness from photographs: its rods, and once the whole of it on one specimen."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tools.studies import picture_study as study


@pytest.mark.thorough
def test_a_soft_cable_hangs_in_a_catenary():
    """Under a large load between clips in the directions of its ends; a is its lowest radius, in lengths of the rod."""
    half = 0.3
    a = 0.2
    for _ in range(60):  # 2 a sinh(half / a) = 1
        a *= (2 * a * np.sinh(half / a)) ** 0.5
    slope = np.arctan(np.sinh(half / a))
    start, end = (Rotation.from_euler("y", angle) for angle in (slope, -slope))
    found = study.hanging(3000.0, 0.8, start, np.array([2 * half, 0, 0]), end)
    catenary = a * (np.cosh((found[:, 0] - half) / a) - np.cosh(half / a))
    assert np.abs(found[:, 1]).max() < 1e-6 and np.abs(found[:, 2] - catenary).max() < 5e-3
    np.testing.assert_allclose(np.linalg.norm(np.diff(found, axis=0), axis=1).sum(), 1.0, atol=1e-5)


@pytest.mark.slow
def test_the_interval_of_a_specimen_contains_the_truth(capfd):
    assert study.main(["--specimens", "1", "--seed", "2018"]) == 0
    assert "1 of 1 intervals" in capfd.readouterr().out
