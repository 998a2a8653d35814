"""Recordings of motion, converted: frames and markers are chosen, and the rate is that of the frames which are left."""

import numpy as np
import pytest

from doo_ti.commands.cli import main
from doo_ti.io.observation_files import read_recording


@pytest.fixture
def take(tmp_path, rng):
    path = tmp_path / "take.npz"
    np.savez(path, positions_mm=rng.normal(size=(2, 40, 6, 3)), rate_hz=100.0, recording=np.array(["slow", "fast"]))
    return str(path)


def test_frames_and_markers_are_chosen(take, tmp_path, capsys):
    out = tmp_path / "out.npz"
    assert main(["convert", take, str(out), "--motion", "--select", "0:20:4", "--marks", "1:-1"]) == 0
    assert capsys.readouterr().out.startswith("2 recordings of 5 frames of 4 markers at 25/s, 0 positions missing")
    found, whole = read_recording(out), read_recording(take)
    np.testing.assert_array_equal(found.positions, whole.positions[:, :20:4, 1:-1])
    assert found.rate == 25.0 and found.names == whole.names


@pytest.mark.parametrize(("words", "named"), [
    (["--select", "5:5"], "positions_mm: none is left"), (["--complete"], "--complete: given with --motion"),
    (["--rest-length", "100"], "--rest-length: given with --motion"), (["--edges", "9"], "--edges: given with --motion")])
def test_what_a_motion_cannot_have_is_refused(words, named, take, tmp_path, capsys):
    assert main(["convert", take, str(tmp_path / "out.npz"), "--motion", *words]) == 2
    assert named in capsys.readouterr().err and not (tmp_path / "out.npz").exists()


def test_a_recording_that_states_no_rate_needs_one(tmp_path, capsys):
    names = ",,".join(f"m{k},m{k},m{k}" for k in range(3)).replace(",,", ",")
    axes = ",".join("XYZ" * 3)
    lines = [f"Format Version,1.23,Length Units,Meters\n,Type,{','.join(['Marker'] * 9)}", f",Name,{names}",
             f",,{','.join(['Position'] * 9)}", f"Frame,Time,{axes}",
             *(f"{k},{k / 100}," + ",".join(f"{j / 100}" for j in range(9)) for k in range(3))]
    (tmp_path / "take.csv").write_text("\n".join(lines) + "\n")
    words = ["convert", str(tmp_path / "take.csv"), str(tmp_path / "out.npz"), "--motion"]
    assert main(words) == 2
    assert "states no frames per second" in capsys.readouterr().err
    assert main([*words, "--rate", "50"]) == 0
    assert read_recording(tmp_path / "out.npz").rate == 50.0
