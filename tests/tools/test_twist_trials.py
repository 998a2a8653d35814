"""Trials of Eq. 4 rotate the known end frames by a hidden angle and find it (Fig. 7)."""

import numpy as np
import pytest

from doo_ti import Material, load_observations
from tests.twist.rods import MATERIAL, twisted_rods
from tools.studies.trials.twist import twist_trials


@pytest.fixture(scope="module")
def made():
    return twisted_rods()


def test_trials_rotate_known_frames_and_find_the_angle(made):
    trials = twist_trials(made, made.total_twist, MATERIAL, 3, 5, seed=4)
    assert trials.configurations.shape == (5, 3) and (np.diff(np.sort(trials.configurations)) > 0).all()
    assert np.ptp(trials.truth) > 1 and trials.successful.all() and trials.error.max() < np.radians(1.5)
    again = twist_trials(made, made.total_twist, MATERIAL, 3, 5, seed=4)
    np.testing.assert_array_equal(again.estimate.phi, trials.estimate.phi)


def test_fig_7_on_the_lab(laboratory):
    """A part of the study: success within a quarter turn, whole turns counted, under the lab's own Θ."""
    observations = load_observations(laboratory / "lab_a" / "vicryl.npz")
    with np.load(laboratory / "lab_a" / "vicryl_truth.npz") as file:
        truth = np.radians(file["total_twist_deg"])
    for together, least in ((1, 0.9), (6, 0.99)):
        trials = twist_trials(observations, truth, Material(6e5, 8e5), together, 40, seed=1)
        print(f"D = {together}: {trials.successful.mean():.0%}, median error {np.degrees(np.median(trials.error)):.1f}°")
        assert trials.successful.mean() >= least
