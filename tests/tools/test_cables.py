"""The recipe for the public cable data: which stretches are kept, and what happens without the data."""

import csv
import os
import pickle

import numpy as np
import pytest

from doo_ti.system.errors import InputError
from tools.studies.cables import APART, SLOWEST, STILL, STRETCH, main, read_recordings, slowest

FRAMES = np.arange(5 * 3 * 4, dtype=np.float64).reshape(5, 3, 4) / 100


class Calls:
    """A pickle that runs a command where it is unpickled as usual."""

    def __reduce__(self):
        return os.system, ("touch trace",)


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


@pytest.mark.parametrize("protocol", range(2, pickle.HIGHEST_PROTOCOL + 1))
def test_a_folder_of_pickles_becomes_one_array(tmp_path, monkeypatch, protocol):
    monkeypatch.chdir(tmp_path)
    for number in (9, 10):
        (tmp_path / f"{number}.pkl").write_bytes(pickle.dumps([number * frame for frame in FRAMES], protocol))
    positions, names = read_recordings(tmp_path)
    assert positions.shape == (2, 5, 4, 3) and names.tolist() == [9, 10]
    np.testing.assert_allclose(positions[1, 2, 3], 1e4 * FRAMES[2, :, 3], rtol=1e-6)
    (tmp_path / "11.pkl").write_bytes(pickle.dumps([FRAMES[0], Calls()], protocol))
    with pytest.raises(InputError, match="names"):
        read_recordings(tmp_path)
    assert not (tmp_path / "trace").exists()
