"""Recorded motion: missing frames, confused markers, grippers out of reach, and recordings that are refused."""

import numpy as np
import pytest

from doo_ti import RecordedMotion
from doo_ti.dynamics.recorded import FINE, GRIPPED, LOST, SWAPPED, elapsed_steps
from doo_ti.dynamics.rollouts import LARGEST_REACH, lay_out
from tests.conftest import check_refused
from tests.dynamics.recordings import RATE, carried

REFERENCE, LENGTHS = np.array([0.0, 0.0, 1.0]), np.full(7, 40.0)


def laid_out(positions, **options):
    return lay_out(RecordedMotion.of(positions, RATE), LENGTHS, REFERENCE, **options)


@pytest.mark.parametrize("speed", [600.0, 3000.0])
def test_missing_frames_are_found_and_bridged(rng, speed):
    whole = carried(rng, 12, 80, 8, speed=speed) + 0.2 * rng.normal(size=(12, 80, 8, 3))
    shown, expected, kept = np.empty((12, 60, 8, 3)), np.ones((12, 60), dtype=int), []
    for r in range(12):
        gone, at = 1 + r % 6, int(rng.integers(12, 40))
        kept.append(np.delete(np.arange(80), np.arange(at, at + gone))[:60])
        shown[r], expected[r, at] = whole[r, kept[r]], gone + 1
    motion = RecordedMotion.of(shown, RATE)
    np.testing.assert_array_equal(motion.elapsed, expected)
    assert len(motion.glitches()) == 12 and (motion.confused == FINE).all()
    begun = lay_out(motion, motion.edge_lengths(), REFERENCE)
    for r in range(12):
        np.testing.assert_array_equal(begun.steps[r], kept[r][1:] - 1)
        steps = kept[r][-1]
        apart = np.linalg.norm(begun.grippers.start_position[r, :steps] - whole[r, 1 : steps + 1, 0], axis=-1)
        assert apart.max() < 2.0 + 1e-4 * speed


def test_a_whole_recording_has_no_glitches(rng):
    positions = carried(rng, 6, 100, 8) + 0.2 * rng.normal(size=(6, 100, 8, 3))
    still = np.repeat(positions[:, :1], 100, axis=1) + 0.2 * rng.normal(size=positions.shape)
    assert RecordedMotion.of(positions, RATE).glitches() == RecordedMotion.of(still, RATE).glitches() == []


def test_swapped_markers_are_changed_back(rng):
    whole = carried(rng, 3, 80, 8)
    shown = whole.copy()
    shown[0, 20:28, [0, 1]] = whole[0, 20:28, [1, 0]]
    shown[1, 30:, [-1, -2]] = whole[1, 30:, [-2, -1]]
    shown[2, :5, [0, 1]] = whole[2, :5, [1, 0]]
    motion = RecordedMotion.of(shown, RATE)
    expected = np.full((3, 80, 2), FINE)
    expected[0, 20:28, 0], expected[1, 30:, 1], expected[2, :5, 0] = SWAPPED, SWAPPED, SWAPPED
    np.testing.assert_array_equal(motion.confused, expected)
    assert (motion.elapsed == 1).all() and len(motion.glitches()) == 3
    mended, clean = laid_out(shown), laid_out(whole)
    for name in ("start_position", "end_position", "start_frame", "end_frame"):
        np.testing.assert_allclose(getattr(mended.grippers, name), getattr(clean.grippers, name), atol=1e-9)
    np.testing.assert_allclose(mended.start.configuration.vertices, clean.start.configuration.vertices, atol=1e-9)
    np.testing.assert_allclose(mended.start.velocity, clean.start.velocity, atol=1e-6)


def test_lost_markers_are_taken_from_the_frames_around(rng):
    whole = carried(rng, 2, 80, 8)
    shown = whole.copy()
    across = np.cross(whole[0, 40:46, 1] - whole[0, 40:46, 0], REFERENCE)
    shown[0, 40:46, 1] = whole[0, 40:46, 0] + across
    motion = RecordedMotion.of(shown, RATE)
    assert (motion.confused[0, 40:46, 0] == LOST).all() and np.sum(motion.confused != FINE) == 6
    begun = laid_out(shown)
    assert np.abs(begun.grippers.start_position[0] - whole[0, 1:, 0]).max() < 2.0
    edge = whole[0, 1:, 1] - whole[0, 1:, 0]
    along = np.sum(begun.grippers.start_frame[0, :, :, 0] * edge, axis=-1) / np.linalg.norm(edge, axis=-1)
    assert along.min() > 0.999


def test_grippers_stay_within_reach(rng):
    whole = carried(rng, 1, 60, 8)
    shown = whole.copy()
    chord = whole[0, :, -1] - whole[0, :, 0]
    away = np.where((np.arange(60) >= 25) & (np.arange(60) < 31), 60.0, 0.0)
    shown[0, :, -2:] += (away[:, None] * chord / np.linalg.norm(chord, axis=-1, keepdims=True))[:, None]
    held = laid_out(shown).grippers
    first, last = held.start_frame[0, :, :, 0] * 40.0, held.end_frame[0, :, :, 0] * 40.0
    span = np.linalg.norm(held.end_position[0] - last - held.start_position[0] - first, axis=-1)
    assert span.max() <= LARGEST_REACH * 200.0 * (1 + 1e-12)
    far = away[1:] > 0
    assert span[far].min() > 0.998 * 200.0
    np.testing.assert_allclose(held.end_position[0, ~far], shown[0, 1:, -1][~far], rtol=0, atol=1e-9)


@pytest.mark.parametrize("change", [
    lambda p: (p[..., :2], RATE), lambda p: (p[:, :2], RATE), lambda p: (p[:, :, :4], RATE), lambda p: (p[0, 0], RATE),
    lambda p: (p, 0.0), lambda p: (p, 5e-324), lambda p: (p, np.nan), lambda p: (p * 5e-324, RATE),
    lambda p: (p[:, :, [0, 0, 2, 3, 4, 5]], RATE), lambda p: (p * 1e6, RATE), lambda p: (_with(p, np.nan), RATE),
    lambda p: (_with(p, np.inf), RATE)])
def test_recordings_that_are_refused(rng, change):
    check_refused(": ", RecordedMotion.of, *change(carried(rng, 2, 20, 8)))


def test_files_and_gaps(rng, tmp_path):
    positions = carried(rng, 2, 30, 8)
    path = tmp_path / "motion.npz"
    np.savez(path, positions_mm=_with(positions, np.nan), rate_hz=RATE, recording=np.array(["a", "b"]))
    check_refused(": ", RecordedMotion.load, path)
    filled = RecordedMotion.load(path, fill_gaps=True)
    assert filled.names == ("a", "b") and filled.rate == RATE
    np.testing.assert_allclose(filled.positions[1, 10, 3], positions[1, [9, 11], 3].mean(axis=0), atol=1e-9)
    np.savez(path, positions_mm=positions)
    check_refused(": ", RecordedMotion.load, path)
    np.savez(path, positions_mm=positions[0], rate_hz=RATE)
    one = RecordedMotion.load(path)
    assert one.positions.shape == (1, 30, 8, 3)
    check_refused(": ", RecordedMotion.together, [one, RecordedMotion.of(positions, 2 * RATE)], ["first", "second"])
    both = RecordedMotion.together([one, RecordedMotion.of(positions[:, :20], RATE)], ["first", "second"])
    assert both.positions.shape == (3, 20, 8, 3) and both.take([0, 2]).count == 2
    assert both.names == ("first", "second 0", "second 1")


def _with(positions, value):
    changed = positions.copy()
    changed[1, 10, 3] = value
    return changed


def test_grippers_that_start_and_stop_at_once_are_no_jumps():
    positions = np.zeros((1, 40, 6, 3))
    positions[..., 0] = 50.0 * np.arange(6)
    positions[..., 1] += 20.0 * np.clip(np.arange(40) - 10, 0, 15)[None, :, None]
    assert (elapsed_steps(positions[:, :, GRIPPED]) == 1).all()
    shortened = np.delete(positions, [14, 15, 16], axis=1)
    np.testing.assert_array_equal(elapsed_steps(shortened[:, :, GRIPPED])[0], np.where(np.arange(37) == 14, 4, 1))


def test_smoothing_keeps_parabolas_and_takes_noise_away(rng):
    times = np.arange(60) / RATE
    rod = carried(rng, 1, 1, 8)[:, 0]
    velocity, acceleration = np.array([300.0, -200.0, 50.0]), np.array([-1800.0, 800.0, 1200.0])
    way = np.outer(times, velocity) + np.outer(0.5 * times**2, acceleration)
    exact = rod[:, None] + way[:, None]
    noisy = exact + 0.3 * rng.normal(size=exact.shape)
    true, smooth, rough = laid_out(exact, smoothing=9), laid_out(noisy, smoothing=9), laid_out(noisy, smoothing=1)
    np.testing.assert_allclose(true.grippers.start_position[0], exact[0, 1:, 0], atol=1e-9)
    np.testing.assert_allclose(true.start.velocity[0], np.tile(velocity + acceleration / RATE, (8, 1)), atol=1e-6)
    off = [np.std(found.grippers.start_position[0] - exact[0, 1:, 0]) for found in (smooth, rough)]
    speed = [np.std(found.start.velocity - true.start.velocity) for found in (smooth, rough)]
    print(f"grippers off by {off[0]:.2f} instead of {off[1]:.2f} mm, first velocities by {speed[0]:.0f} instead of "
          f"{speed[1]:.0f} mm/s")
    assert off[0] < 0.65 * off[1] and speed[0] < 0.3 * speed[1]
    assert true.start.velocity_age == 0.0 and rough.start.velocity_age == 0.5 / RATE
