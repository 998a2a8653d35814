"""``doo-ti twist``: output, files, refused input."""

import json

import numpy as np
import pytest

from doo_ti import Material, save_observations
from doo_ti.commands.cli import main
from tests.commands.calls import made, refused
from tests.references.rods import at_rest, bows, observed

MATERIAL = ["--bend", "6e5", "--twist", "4e5"]
TWIST = np.radians([-200.0, -40.0, 90.0, 250.0])


@pytest.fixture
def files(tmp_path):
    """Observations with their frames, perception's vertices alone, and two files of offsets."""
    rods = observed(at_rest(bows(0.5, 0.8, 0.6, 0.9, edges=20, rest_length=5.0, twist=TWIST), Material(6e5, 4e5)))
    twist = rods.total_twist
    save_observations(tmp_path / "seen.npz", rods)
    np.savez(tmp_path / "bare.npz", vertices_mm=rods.vertices, name=np.array(["a", "b", "c", "d"]))
    np.savez(tmp_path / "frames.npz", start_frame=rods.start_frame, end_frame=rods.end_frame, total_twist_deg=np.degrees(twist))
    (tmp_path / "offsets.csv").write_text("offset_deg\n" + "\n".join(str(np.degrees(t) + 45) for t in twist), encoding="utf-8")
    return tmp_path, twist


def test_what_perception_wrote(files, capsys):
    folder, twist = files
    assert main(["twist", "bare.npz", *MATERIAL, "--out", "phi.npz", "--json"]) == 0
    summary = json.loads(capsys.readouterr().out)
    np.testing.assert_allclose(summary["phi_deg"], np.degrees(twist), atol=2.0)
    assert summary["verdicts"] == {"clear": 4} and summary["unsound_rods"] == 0
    low, phi, high, total = (np.array(summary[name]) for name in ("low_deg", "phi_deg", "high_deg", "total_twist_deg"))
    assert ((low <= phi) & (phi <= high)).all() and np.allclose(total, phi)


def test_several_share_an_angle(files):
    folder, twist = files
    found = made(["twist", "seen.npz", *MATERIAL, "--observations", "2", "--out", "phi.npz", "--picture", "phi.png"])
    assert found["objective_mm"].shape == (2, 49) and (folder / "phi.png").read_bytes().startswith(b"\x89PNG")
    np.testing.assert_allclose(found["phi_grid_deg"], np.arange(-360, 361, 15))
    np.testing.assert_allclose(found["phi_deg"], 0, atol=1.0)  # end frames and twist are the true ones
    np.testing.assert_allclose(found["total_twist_deg"], np.degrees(twist), atol=1.0)
    assert found["group"].tolist() == [0, 0, 1, 1]


def test_offsets_and_grasps(files):
    folder, twist = files
    words = ["twist", "bare.npz", *MATERIAL, "--out", "phi.npz"]
    np.testing.assert_allclose(made([*words, "--offsets", "offsets.csv"])["phi_deg"], [-45.0], atol=2.0)
    found = made([*words, "--offsets", "frames.npz", "--regrasp", "1", "3"])
    assert found["group"].tolist() == [0, 1, 1, 2]
    np.testing.assert_allclose(found["phi_deg"], 0, atol=2.0)
    np.testing.assert_allclose(found["total_twist_deg"], np.degrees(twist), atol=2.0)


@pytest.mark.parametrize("words, printed", [
    (["--observations", "2"], "end_frame"), (["--observations", "9"], "--observations"), (["--regrasp", "7"], "--regrasp"),
    (["--offsets", "none.csv"], "none.csv"), (["--bend", "1e5:1e6:3"], "grid"), (["--picture", "phi.jpg"], "ends in .png"),
    ("offset_deg\n1\n2\n3\n1e6\n", "more than 100 turns"), ("offset_deg\n1\n2\n", "one for each"),
    ("total_twist_deg\n1\n2\n3\n4\n", "end_frame"), ("colour\n1\n", "colour")])
def test_wrong_input_is_one_line(files, capsys, words, printed):
    """Words of the command line, or a file of offsets."""
    folder, _ = files
    if isinstance(words, str):
        (folder / "wrong.csv").write_text(words, encoding="utf-8")
        words = ["--offsets", "wrong.csv"]
    capsys.readouterr()
    refused(capsys, folder, ["twist", "bare.npz", *MATERIAL, "--out", "phi.npz", *words], printed)
