"""Studies of the lab: twist by Eq. 4 and predicted rotation steps, at small sizes; pickles of the public cable data."""

import os
import pickle
import sys
from importlib import import_module

import numpy as np
import pytest

from doo_ti import Material, load_observations
from doo_ti.rod.frames import curve_length
from tests.conftest import check_refused
from tests.perception.test_twist import MATERIAL, TWIST
from tests.references.rods import at_rest, bows, observed
from tests.relaxation.rods import lab
from tools.studies.cables import read_recordings
from tools.studies.prediction_study import predict_steps
from tools.studies.replication.twist import SUCCESS, twist_trials


def test_trials_of_eq_4_rotate_known_frames_and_find_the_angle():
    made = observed(at_rest(bows(0.5, 0.7, 0.9, 0.6, 0.8, twist=TWIST), MATERIAL))
    trials, again = (twist_trials(made, made.total_twist, MATERIAL, 3, 5, seed=4) for _ in range(2))
    assert trials.configurations.shape == (5, 3) and (np.diff(np.sort(trials.configurations)) > 0).all()
    assert np.ptp(trials.truth) > 1 and trials.error.max() < np.radians(1.5)
    np.testing.assert_array_equal(again.estimate.phi, trials.estimate.phi)


@pytest.mark.thorough
def test_fig_7_on_the_lab(laboratory):
    """A part of the study: success within a quarter turn, whole turns counted, under the lab's own Θ."""
    observations = load_observations(laboratory / "lab_a" / "vicryl.npz")
    truth = np.radians(np.load(laboratory / "lab_a" / "vicryl_truth.npz")["total_twist_deg"])
    for together, least in ((1, 0.9), (6, 0.99)):
        assert np.mean(twist_trials(observations, truth, Material(6e5, 8e5), together, 40, seed=1).error <= SUCCESS) >= least


@pytest.mark.sampled(1)
@pytest.mark.parametrize("name", ["ribbon", "nylon", "vicryl", "silk"])
def test_rotation_steps_of_the_lab_are_predicted(laboratory, name):
    """Where the ribbon's prediction ends on another branch than the observation, that is known."""
    rods = lab(laboratory, name)
    steps = predict_steps(rods.observations, rods.material)
    assert len(steps.error) == 54
    if name == "ribbon":
        assert np.median(steps.error) <= 0.8
        assert (np.abs(steps.error - steps.own_error)[steps.same_branch] < 0.5).all()
    else:
        assert steps.error.mean() <= 1.0 and steps.same_branch.all()


@pytest.mark.parametrize("protocol", range(2, pickle.HIGHEST_PROTOCOL + 1))
def test_a_folder_of_pickles_becomes_one_array(tmp_path, monkeypatch, protocol):
    class Calls:  # a pickle that runs a command where it is unpickled as usual
        def __reduce__(self):
            return os.system, ("touch trace",)

    monkeypatch.chdir(tmp_path)
    frames = np.arange(5 * 3 * 4, dtype=np.float64).reshape(5, 3, 4) / 100
    for number in (9, 10):
        (tmp_path / f"{number}.pkl").write_bytes(pickle.dumps([number * frame for frame in frames], protocol))
    positions, names = read_recordings(tmp_path)
    assert positions.shape == (2, 5, 4, 3) and names.tolist() == [9, 10]
    np.testing.assert_allclose(positions[1, 2, 3], 1e4 * frames[2, :, 3], rtol=1e-6)
    (tmp_path / "11.pkl").write_bytes(pickle.dumps([frames[0], Calls()], protocol))
    check_refused("names", read_recordings, tmp_path)
    assert not (tmp_path / "trace").exists()


@pytest.mark.thorough
@pytest.mark.parametrize("words", [
    "angle_study --curves 1 --angles 40", "detection_study --rods 1", "group_study --groups 4", "perception_study lab --sets 1",
    "planner_study same --goals 1", "servo_study own --tasks 2 --steps 2", "servo_study own --cameras --tasks 1 --steps 1"])
def test_studies_run(words, monkeypatch):
    """As others change what they call."""
    name, *options = words.split()
    monkeypatch.setattr(sys, "argv", [name, *options])
    assert import_module(f"tools.studies.{name}").main() in (None, 0, 1)


def test_cables_for_pictures_hang(rng):
    from tools.studies.picture_study import LENGTH, pose

    assert curve_length(pose(rng, -30.0, 0.7)) == pytest.approx(LENGTH, rel=1e-6)
