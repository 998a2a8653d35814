"""Prediction with inertia: where the motion is slow it is that of statics, and where it is fast that of the time steps."""

from dataclasses import replace

import numpy as np
import pytest

from doo_ti import ClampPath, Dynamics, Grippers, InputError, Material, Stepping, predict, simulate
from doo_ti.motion.predict import predict_moving, rate_of
from tests.motion.test_predict import MATERIAL, bows, line

SHIFTS = np.linspace(0, 1, 5)[:, None] * [-6.0, 3.0, 2.0]
LOSSES = Dynamics(bend_damping=0.01, drag=1.0)


@pytest.mark.thorough
def test_a_slow_motion_is_that_of_statics():
    rods, clamps = bows(MATERIAL)
    path = replace(line(clamps, *SHIFTS), end_rotation=np.radians(40.0) * np.arange(5)[:, None])
    still = predict(rods, MATERIAL, clamps, path, between=2)
    slow = predict_moving(rods, MATERIAL, clamps, path, LOSSES, Stepping(0.02), between=2)
    print(f"off by {np.abs(slow.vertices - still.vertices)[-1].max():.1e} mm")
    np.testing.assert_allclose(slow.vertices[[0, -1]], still.vertices[[0, -1]], atol=1e-3)
    np.testing.assert_allclose(slow.end_rotation[::2], still.end_rotation[::2], atol=1e-6)
    np.testing.assert_allclose(slow.total_twist[-1], still.total_twist[-1], atol=1e-4)
    np.testing.assert_allclose(slow.energy[[0, -1]], still.energy[[0, -1]], rtol=1e-5)
    np.testing.assert_allclose(slow.end_force[-1], still.end_force[-1], rtol=1e-2, atol=5.0)
    assert slow.followed.all()


def test_a_fast_motion_is_that_of_the_time_steps():
    """Of two materials, every rod as it moves alone, with grippers on the same path."""
    material = Material([6e5, 2e5], [8e5, 3e5])
    rods, clamps = bows(MATERIAL)
    found = predict_moving(rods, material, clamps, line(clamps, *SHIFTS), LOSSES, Stepping(1000.0, 4), between=3)
    assert found.vertices.shape == (13, 4, 34, 3) and found.followed.all()
    np.testing.assert_allclose(found.time, np.arange(13) / 3000.0)
    positions = clamps.end_position[:, None] + SHIFTS
    still = Grippers.resting(clamps, 5)
    grippers = replace(still, end_position=positions).refined(3)
    for rod in range(4):
        of_material, motion = divmod(rod, 2)
        alone = simulate(found.at(0).take([rod]), material.take([of_material]), grippers.take([motion]), LOSSES,
                         Stepping(3000.0, 4))
        np.testing.assert_allclose(found.vertices[1:, rod], alone.positions[0], atol=1e-9)
    slow = predict(rods, material, clamps, line(clamps, *SHIFTS), between=3)
    assert np.abs(found.vertices - slow.vertices).max() > 1.0


def test_motions_whose_speed_or_sense_is_unclear_are_refused():
    rods, clamps = bows(MATERIAL)
    with pytest.raises(InputError, match="end_rotation"):
        predict_moving(rods, MATERIAL, clamps, line(clamps, rotation=[0.0, 7.0]), LOSSES, Stepping(10.0))
    with pytest.raises(InputError, match="time_s"):
        rate_of(ClampPath(np.array([0.0, 1.0, 3.0]), end_position=np.zeros((3, 1, 3))))
    assert rate_of(ClampPath(np.array([1.0, 1.5, 2.0]), end_position=np.zeros((3, 1, 3)))) == pytest.approx(2.0)
