"""``doo-ti twist``: output, files, refused input."""

import json
from pathlib import Path

import numpy as np
import pytest

from doo_ti import Material, save_observations
from tests.commands.calls import made, refused, succeeded
from tests.references.rods import at_rest, bows, observed

BARE = "twist bare.npz --bend 6e5 --twist 4e5 --out phi.npz"
TWIST = np.radians([-200.0, -40.0, 90.0, 250.0])


@pytest.fixture
def twist():
    rods = observed(at_rest(bows(0.5, 0.8, 0.6, 0.9, edges=20, rest_length=5.0, twist=TWIST), Material(6e5, 4e5)))
    twist = rods.total_twist
    save_observations("seen.npz", rods)
    np.savez("bare.npz", vertices_mm=rods.vertices, name=np.array(["a", "b", "c", "d"]))
    np.savez("frames.npz", start_frame=rods.start_frame, end_frame=rods.end_frame, total_twist_deg=np.degrees(twist))
    Path("offsets.csv").write_text("offset_deg\n" + "\n".join(str(np.degrees(t) + 45) for t in twist))
    return twist


def test_what_perception_wrote(twist, capsys):
    summary = json.loads(succeeded(capsys, f"{BARE} --json"))
    np.testing.assert_allclose(summary["phi_deg"], np.degrees(twist), atol=2.0)
    assert summary["verdicts"] == {"clear": 4} and summary["unsound_rods"] == 0
    low, phi, high, total = (np.array(summary[name]) for name in ("low_deg", "phi_deg", "high_deg", "total_twist_deg"))
    assert ((low <= phi) & (phi <= high)).all() and np.allclose(total, phi)


def test_several_share_an_angle_by_offsets_and_grasps(twist):
    found = made(f"{BARE.replace('bare', 'seen')} --observations 2 --picture phi.png")
    assert found["objective_mm"].shape == (2, 49) and Path("phi.png").read_bytes().startswith(b"\x89PNG")
    np.testing.assert_allclose(found["phi_grid_deg"], np.arange(-360, 361, 15))
    np.testing.assert_allclose(found["phi_deg"], 0, atol=1.0)  # end frames and twist are the true ones
    np.testing.assert_allclose(found["total_twist_deg"], np.degrees(twist), atol=1.0)
    assert found["group"].tolist() == [0, 0, 1, 1]
    np.testing.assert_allclose(made(f"{BARE} --offsets offsets.csv")["phi_deg"], [-45.0], atol=2.0)
    found = made(f"{BARE} --offsets frames.npz --regrasp 1 3")
    assert found["group"].tolist() == [0, 1, 1, 2]
    np.testing.assert_allclose(found["phi_deg"], 0, atol=2.0)
    np.testing.assert_allclose(found["total_twist_deg"], np.degrees(twist), atol=2.0)


@pytest.mark.parametrize("words, printed", [
    ("--observations 2", "end_frame"), ("--observations 9", "--observations"), ("--regrasp 7", "--regrasp"),
    ("--offsets none.csv", "none.csv"), ("--bend 1e5:1e6:3", "grid"), ("--picture phi.jpg", "ends in .png"),
    ("offset_deg\n1\n2\n3\n1e6\n", "more than 100 turns"), ("offset_deg\n1\n2\n", "one for each"),
    ("total_twist_deg\n1\n2\n3\n4\n", "end_frame"), ("colour\n1\n", "colour")])
def test_wrong_input_is_one_line(twist, tmp_path, capsys, words, printed):
    Path("wrong.csv").write_text(words)
    more = "--offsets wrong.csv" if words.endswith("\n") else words
    refused(capsys, tmp_path, f"{BARE} {more}", printed)
