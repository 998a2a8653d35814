"""Predicted steps of the lab and predicted motions of a cable, compared with observations and with baselines."""

import numpy as np
import pytest

from doo_ti import ClampPath, Material, Observations, load_observations, load_path
from tests.relaxation.lab import lab
from tools.studies.trials.prediction import moved_as_one, moved_by_blend, predict_marks, predict_steps, rotation_steps


@pytest.mark.parametrize("name, largest", [("nylon", 1.0), ("vicryl", 1.0), ("silk", 1.0)])
def test_the_lab_s_rotation_steps(laboratory, name, largest):
    rods = lab(laboratory, name)
    steps = predict_steps(rods.observations, *rotation_steps(rods.observations), rods.material())
    print(f"{name}: mean {steps.error.mean():.3f} mm over {len(steps.error)} steps, {steps.jumps.sum()} jumps")
    assert len(steps.error) == 54 and steps.error.mean() <= largest and steps.same_branch.all()


def test_the_ribbon_s_rotation_steps(laboratory):
    """Where the prediction ends on another branch than the observation, that is known, and named by the study."""
    rods = lab(laboratory, "ribbon")
    steps = predict_steps(rods.observations, *rotation_steps(rods.observations), rods.material())
    print(f"ribbon: median {np.median(steps.error):.3f} mm, {steps.jumps.sum()} jumps, {(~steps.same_branch).sum()} elsewhere")
    assert np.median(steps.error) <= 0.8
    assert (np.abs(steps.error - steps.own_error)[steps.same_branch] < 0.5).all()


def test_a_cable_between_two_grippers(shared_data):
    """0.2 m/s: the quasi-static prediction is better than the baselines on every sequence."""
    folder = shared_data / "cables"
    still = load_observations(folder / "dlo1.npz")
    path = load_path(folder / "dlo1_motion.npz")
    assert path.count == 6 and path.moments == 150 and path.time[-1] == pytest.approx(1.49)
    with np.load(folder / "dlo1_motion.npz") as file:
        marks = file["positions_mm"].astype(float)
    first = Observations(marks[:, 0], rest_length=still.rest_length)
    sparse = ClampPath(path.time[::-1][::10][::-1], tangents_only=True, **{
        name: getattr(path, name)[::-1][::10][::-1] for name in ("start_position", "end_position", "start_frame", "end_frame")})
    prediction = predict_marks(first, Material(3.16e6, 3.16e6), sparse, sub_step=np.radians(10.0))
    assert prediction.followed.all()
    shifts = marks[:, -1, 0] - marks[:, 0, 0], marks[:, -1, -1] - marks[:, 0, -1]
    guesses = moved_as_one(first.vertices, *shifts), moved_by_blend(first.vertices, *shifts, still.rest_length)
    off, *others = (np.linalg.norm(shape - marks[:, -1], axis=-1).mean(axis=1) for shape in (prediction.vertices[-1], *guesses))
    print("predicted", off.round(1), "guessed", [other.round(1) for other in others])
    assert (off < np.minimum(*others)).all()
