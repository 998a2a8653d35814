"""The recipe for the public cable data: which stretches are kept, and what happens without the data."""

import csv

import numpy as np

from tools.studies.cables import APART, SLOWEST, STILL, STRETCH, main, slowest


def test_the_slowest_stretches_are_kept_in_order():
    """Recording r moves uniformly by r + 1 mm a frame, and stops for a while in one of them."""
    frames = 4 * APART + STRETCH
    place = np.cumsum(np.ones((3, frames)) * np.array([[1.0], [2.0], [3.0]]), axis=1)
    place[2, APART:] = place[2, APART]
    positions = np.zeros((3, frames, 4, 3), dtype=np.float32)
    positions[..., 0] = place[..., None]
    found, speed = slowest(positions)
    assert found.shape == (SLOWEST, STRETCH, 4, 3) and (np.diff(speed) >= 0).all()
    np.testing.assert_array_equal(found[0], positions[2, APART * 2 : APART * 2 + STRETCH])
    np.testing.assert_allclose(speed[4:], 0.1, rtol=1e-6)  # 1 mm a frame at 100 Hz


def test_still_frames_are_sixty_of_two_cables():
    with STILL.open(encoding="utf-8", newline="") as file:
        rows = [tuple(row.values()) for row in csv.DictReader(file)]
    assert len(set(rows)) == 120 and [sum(row[0] == name for row in rows) for name in ("dlo1", "dlo3")] == [60, 60]


def test_missing_data_is_an_error(tmp_path, capsys):
    assert main(["make", str(tmp_path), "--out", str(tmp_path / "out")]) == 2
    assert main(["results", str(tmp_path)]) == 1
    assert all("missing" in line or "folder" in line for line in capsys.readouterr().err.strip().splitlines())
