"""Identification of a Θ under which synthetic recordings were made."""

from dataclasses import replace

import numpy as np
import pytest

from doo_ti import IdentifyOptions, MotionTheta, RecordedMotion, identify
from tests.dynamics.recordings import RATE, recorded

TRUE = MotionTheta(
    bend=3e6, twist_ratio=1.0, bend_damping=0.04, drag=0.6, quadratic_drag=2e-4, marker_share=0.0,
    rest=1e-3 * np.array([[1.5, -1.0], [0.8, 0.6]]), rest_length=np.full(8, 50.0), reference=np.array([0.0, 1.0, 0.0]))
OPTIONS = IdentifyOptions(modes=2, horizons=(30, 10**6))
GUESS = replace(TRUE, bend=5e6, twist_ratio=0.7, bend_damping=0.02, drag=0.2, quadratic_drag=1e-5, rest=np.zeros((2, 0)))


def rolled_out(rng, count: int, noise: float) -> RecordedMotion:
    """``count`` recordings of 80 frames as the rollout under TRUE has them from their first two frames, with noise."""
    settled = RecordedMotion.of(recorded(rng, TRUE, count, 80, 0.0), RATE)
    positions, status = OPTIONS.rollouts(settled, TRUE).predicted([TRUE])
    assert (status == 0).all()
    return RecordedMotion.of(positions[:, 0] + noise * rng.normal(size=positions[:, 0].shape), RATE)


def test_what_was_simulated_is_predicted(rng):
    """From two frames on, but for the first velocity, a difference; straight at rest, so that no twist is hidden in them."""
    theta = replace(TRUE, rest=np.zeros((2, 0)))
    motion = RecordedMotion.of(recorded(rng, theta, 4, 80, 0.0), RATE)
    assert motion.glitches() == []
    positions, status = OPTIONS.rollouts(motion, theta).predicted([theta])
    apart = np.abs(positions[:, 0] - motion.positions).max()
    moved = np.abs(motion.positions[:, :, 4] - motion.positions[:, :1, 4]).max()
    print(f"off by {apart:.2f} mm of up to {moved:.0f} mm moved")
    assert (status == 0).all() and apart < 0.5


def test_theta_is_found_from_recordings_without_noise(rng):
    found = identify(rolled_out(rng, 4, 0.0), GUESS, OPTIONS)
    apart = np.abs(found.vector - found.unknowns.vector(TRUE)).max()
    print(f"p off by {apart:.1e}, markers by {found.error.max():.1e} mm, {found.iterations} iterations")
    assert not found.failed.any()
    assert apart < 1e-4 and found.error.max() < 1e-5


@pytest.mark.thorough
def test_theta_is_found_from_recordings_with_noise(rng):
    """0.1 mm at every marker, the first two frames included, from which the velocity is taken. Drag and quadratic drag
    cannot be separated by so few."""
    begin = replace(GUESS, quadratic_drag=TRUE.quadratic_drag, twist_ratio=TRUE.twist_ratio)
    options = replace(OPTIONS, fitted=("bend_damping", "drag"))
    inside = []
    for _ in range(4):
        found = identify(rolled_out(rng, 4, 0.1), begin, options)
        theta, deviation = found.theta, np.sqrt(np.diag(found.covariance))
        inside.append(np.abs(found.vector - found.unknowns.vector(TRUE)) < 1.96 * deviation)
        apart = [getattr(theta, name) / getattr(TRUE, name) - 1 for name in ("bend", "bend_damping", "drag")]
        curvature = np.abs(theta.rest - TRUE.rest).max()
        print("off: bend {:+.3f}, damping {:+.3f}, drag {:+.3f}".format(*apart), f"rest {curvature:.1e} 1/mm")
        assert (np.abs(apart) < [0.03, 0.05, 0.2]).all() and curvature < 3e-4
        assert found.error.max() < 0.15
    print(f"{np.mean(inside):.0%} of the intervals contain the truth")
    assert np.mean(inside) > 0.5


@pytest.mark.thorough
def test_intervals_of_parameters_are_those_of_the_vector(rng):
    found = identify(rolled_out(rng, 4, 0.1), GUESS, replace(OPTIONS, horizons=(20,)))
    rows = {row["name"]: row for row in found.parameters()}
    assert list(rows) == found.unknowns.names
    for name in ("bend", "bend_damping", "drag", "quadratic_drag"):
        row = rows[name]
        assert row["value"] == pytest.approx(getattr(found.theta, name), abs=1e-15)
        assert (row["low"] is None or row["low"] <= row["value"]) and row["value"] <= row["high"]
    np.testing.assert_allclose([rows[f"rest_curvature_{1 + k // 2}_{k % 2}"]["value"] for k in range(4)],
                               found.theta.rest.ravel(), rtol=1e-12)


@pytest.mark.thorough
def test_theta_is_found_of_rods_with_a_free_end(rng):
    """From recordings that one gripper shakes; the last two markers count as well."""
    free = RecordedMotion.of(recorded(rng, TRUE, 4, 80, 0.0), RATE, free_end=True)
    assert free.glitches() == [] and free.predicted == slice(2, None)
    positions, status = OPTIONS.rollouts(free, TRUE).predicted([TRUE])
    assert (status == 0).all() and np.abs(positions[:, 0] - free.positions)[:, -1, -1].max() > 20.0
    found = identify(RecordedMotion.of(positions[:, 0], RATE, free_end=True), GUESS, OPTIONS)
    apart = np.abs(found.vector - found.unknowns.vector(TRUE)).max()
    print(f"p off by {apart:.1e}, markers by {found.error.max():.1e} mm, {found.iterations} iterations")
    assert not found.failed.any() and apart < 1e-4
