"""``doo-ti simulate`` and ``doo-ti identify``: from files to files, and what they refuse."""

import json

import numpy as np
import pytest

from doo_ti.commands import identify
from doo_ti.commands.cli import main
from tests.commands.calls import made, refused, succeeded, written
from tests.io.test_formats import motive, table

SCENE = """
rate_hz = 50
duration_s = 0.2
[rod]
length_mm = 300.0
edges = 6
[materials.rope]
bend = 1e6
bend_damping_s = 0.02
[clamps]
end = "frame"
[[moments]]
time_s = 0.0
end_position_mm = [250, 0, 0]
[[moments]]
time_s = 0.2
end_position_mm = [250, 40, 20]
"""


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """A recording of four rods that grippers move, made by a simulation."""
    folder = tmp_path_factory.mktemp("motion")
    scene = folder / "scene.toml"
    scene.write_text(SCENE.replace("duration_s = 0.2", "duration_s = 1.2").replace("edges = 6", "edges = 24\nat_rest = true"))
    positions = made(["simulate", str(scene), "--substeps", "8", "--out", str(folder / "made.npz")])["positions_mm"]
    noise = np.random.default_rng(5).normal(0, 0.05, (4, *positions.shape[1:]))
    noise[:, :, [0, 1, -2, -1]] = 0.0  # noise of grippers shakes the rod, and biases its damping
    np.savez(folder / "recorded.npz", positions_mm=positions + noise, rate_hz=50.0)
    return folder


@pytest.fixture(scope="module")
def theta(recording):
    out = recording / "theta.json"
    assert main(["identify", str(recording / "recorded.npz"), "--modes", "0", "--fit", "bend_damping", "--bend", "5e5", "--out",
                 str(out)]) == 0
    return out


def test_the_bend_stiffness_that_made_the_motion_is_identified(theta):
    assert json.loads(theta.read_text())["bend_mm3"] == pytest.approx(1e6, rel=0.05)


@pytest.mark.thorough
def test_a_fit_far_off_is_doubted(recording, tmp_path, capsys, monkeypatch):
    command = ["identify", str(recording / "recorded.npz"), "--modes", "0", "--fit", "bend_damping", "--bend", "5e5", "--out"]
    for most in (identify.FAR_OFF, 1e-5):
        monkeypatch.setattr(identify, "FAR_OFF", most)
        assert main([*command, "theta.json"]) == 0
        assert ("of its length off; check the rate" in capsys.readouterr().err) is (most == 1e-5)


@pytest.mark.thorough
def test_still_frames_join_the_motion(recording, tmp_path, capsys):
    shape = np.load(recording / "made.npz")["positions_mm"][0, :1]
    np.savez(tmp_path / "still.npz", vertices_mm=np.repeat(shape, 3, axis=0), rest_length_mm=np.full(24, 12.5))
    command = ["identify", str(recording / "recorded.npz"), "--modes", "0", "--fit", "bend_damping", "--bend", "5e5", "--out",
               "theta.json", "--still", "still.npz"]
    assert "3 still frames, 0 left out" in succeeded(capsys, [*command, "--still-noise", "0.05"])
    fitted = json.loads((tmp_path / "theta.json").read_text())
    assert fitted["bend_mm3"] == pytest.approx(1e6, rel=0.02) and fitted["stills"]["mean_error_mm"] < 0.2
    np.savez(tmp_path / "still.npz", vertices_mm=2.0 * shape, rest_length_mm=np.full(24, 25.0))
    for more in ([], ["--still-noise", "-1"]):
        assert main([*command, *more]) == 2
    assert main([*command[:-2], "--still-noise", "1"]) == 2 and capsys.readouterr().err.count("\n") == 3


def test_a_recording_is_predicted_from_its_grippers(recording, theta):
    marks = recording / "recorded.npz"
    found = made(["simulate", str(marks), "--theta", str(theta), "--out", str(recording / "predicted.npz")])
    recorded = written(marks)["positions_mm"]
    assert found["positions_mm"].shape == recorded.shape
    assert found["status"].shape == found["error_mm"].shape == recorded.shape[:2] and not found["status"].any()
    np.testing.assert_array_equal(found["positions_mm"][:, :2], recorded[:, :2])
    np.testing.assert_array_equal(found["positions_mm"][:, :, [0, 1, -2, -1]], recorded[:, :, [0, 1, -2, -1]])
    assert found["error_mm"].mean() < 0.5


@pytest.mark.thorough
def test_captures_are_read_as_they_are(recording, theta, tmp_path, capsys):
    """Motion capture in metres, and a table without a rate, as the npz made of the same marks."""
    positions = np.load(recording / "recorded.npz")["positions_mm"][0]
    np.savez(tmp_path / "one.npz", positions_mm=positions, rate_hz=50.0, up=(0, 0, 1))
    (tmp_path / "take.csv").write_text(motive(positions / 1000, "Meters"))
    (tmp_path / "marks.csv").write_text(table(positions / 10, "frame,mark,x,y,z"))
    found = {}
    for name, more in (("one.npz", []), ("take.csv", ["--rate", "50", "--up", "0,0,1"]),
                       ("marks.csv", ["--rate", "50", "--unit", "cm", "--columns", "observation=frame,vertex=mark"])):
        out = f"{name}.out.npz"
        found[name] = made(["simulate", str(tmp_path / name), "--theta", str(theta), "--out", out, *more])["positions_mm"]
        np.testing.assert_allclose(found[name], found["one.npz"], atol=1e-6)
    assert found["one.npz"].shape == positions.shape, "one recording has no axis for it"
    capsys.readouterr()
    assert main(["simulate", "marks.csv", "--theta", str(theta), "--out", "f.npz"]) == 2
    assert main(["simulate", "marks.csv", "--theta", str(theta), "--out", "f.npz", "--columns",
                 "observation=frame,vertex=mark"]) == 2
    missing, rate = capsys.readouterr().err.splitlines()
    assert "--rate" in rate and "marks.csv" in rate


@pytest.mark.thorough
def test_gravity_of_a_capture_is_its_own(recording, tmp_path):
    """Motive's y axis points up: marks whose axes are turned give the same rod."""
    positions = np.load(recording / "recorded.npz")["positions_mm"][:1]
    thetas = []
    turned = np.stack([positions[..., 0], positions[..., 2], -positions[..., 1]], axis=-1)
    np.savez(tmp_path / "z.npz", positions_mm=positions, rate_hz=50.0)
    (tmp_path / "y.csv").write_text(motive(turned[0] / 1000, "Meters"))
    for name, more in (("z.npz", []), ("y.csv", ["--rate", "50"])):
        out = tmp_path / f"{name}.json"
        assert main(["identify", str(tmp_path / name), "--modes", "0", "--fit", "bend_damping", "--bend", "5e5", "--out",
                     str(out), *more]) == 0
        thetas.append(json.loads(out.read_text()))
    assert thetas[0]["bend_mm3"] == pytest.approx(thetas[1]["bend_mm3"], rel=1e-4)
    np.testing.assert_allclose(thetas[1]["up"], [0, 1, 0])


def test_poses_of_grippers_without_markers(recording, theta, tmp_path, capsys):
    """From a table of poses, and the rod at rest where observations show it: as predict carries it."""
    positions = np.load(recording / "made.npz")["positions_mm"][0]
    np.savez(tmp_path / "seen.npz", vertices_mm=positions[:1])
    time = np.arange(12) / 50.0
    ends = positions[0, -1] + np.stack([-20 * time, 60 * time**2, 0 * time], axis=-1)
    np.savez(tmp_path / "poses.npz", time_s=time, end_position_mm=ends)
    poses, more = "poses.npz", ["--theta", str(theta), "--out", "f.npz"]
    assert main(["simulate", poses, *more]) == 2 and "--motion" in capsys.readouterr().err
    command = ["simulate", "seen.npz", "--motion", poses, *more]
    found = made(command)
    assert found["positions_mm"].shape == (1, 12, 25, 3) and (found["status"] == 0).all() and found["rate_hz"] == 50
    np.testing.assert_allclose(found["positions_mm"][0, :, -1], ends, atol=1e-6)
    as_before = made(["simulate", poses, "--start", "seen.npz", *more])
    np.testing.assert_array_equal(found["positions_mm"], as_before["positions_mm"])
    np.savez(tmp_path / "poses.npz", time_s=np.delete(time, 3), end_position_mm=np.delete(ends, 3, axis=0))
    capsys.readouterr()
    assert main(command) == 2 and "time_s" in capsys.readouterr().err
    np.testing.assert_allclose(made([*command, "--rate", "50"])["positions_mm"][0, :, -1], ends, atol=0.1)


@pytest.mark.parametrize(("change", "field"), [({"rate_hz": -1.0}, "rate_hz"), ({"positions_mm": "text"}, "positions_mm")])
def test_wrong_recordings_are_one_line(recording, theta, change, field, tmp_path, capsys):
    np.savez(tmp_path / "wrong.npz", **dict(np.load(recording / "recorded.npz")) | change)
    for command, more, suffix in (("simulate", ["--theta", str(theta)], ".npz"), ("identify", [], ".json")):
        refused(capsys, tmp_path, [command, "wrong.npz", *more, "--out", f"out{suffix}"], field)


def test_gaps_are_filled_only_if_asked(recording, theta, tmp_path):
    content = dict(np.load(recording / "recorded.npz"))
    content["positions_mm"][1, 20:23, 3] = np.nan
    np.savez(tmp_path / "gaps.npz", **content)
    command = ["simulate", "gaps.npz", "--theta", str(theta), "--out", "out.npz"]
    assert main(command) == 2 and main([*command, "--fill-gaps"]) == 0


@pytest.mark.parametrize(("old", "new", "field"), [
    ("edges = 6", "edges = 2", "rod.edges"), ("time_s = 0.2", "time_s = -0.2", "time_s"),
    ("bend_damping_s", "damping", "damping")])
def test_wrong_scenes_are_one_line(old, new, field, tmp_path, capsys):
    (tmp_path / "scene.toml").write_text(SCENE.replace(old, new))
    refused(capsys, tmp_path, ["simulate", "scene.toml", "--out", "f.npz"], field)


def test_a_theta_of_another_rod(recording, theta, tmp_path, capsys):
    content = json.loads(theta.read_text())
    content["rest_length_mm"] = content["rest_length_mm"][:-1]
    (tmp_path / "other.json").write_text(json.dumps(content))
    refused(capsys, tmp_path, ["simulate", str(recording / "recorded.npz"), "--theta", "other.json", "--out",
                               "f.npz"], "rest_length_mm")


def test_pictures_and_animations(recording, theta, tmp_path):
    scene = tmp_path / "scene.toml"
    scene.write_text(SCENE)
    energy = made(["simulate", str(scene), "--out", "f.npz", "--picture", "f.png",
                   "--animation", "f.gif", "--recording", "f.rrd"])
    assert all((tmp_path / name).stat().st_size > 1000 for name in ("f.png", "f.gif", "f.rrd"))
    parts = [energy[f"energy_{name}"] for name in ("kinetic", "gravity", "bending", "twist")]
    np.testing.assert_allclose(energy["energy_sum"], sum(parts))
    assert (energy["energy_dissipated"][:, -1] > 0).all() and (energy["energy_work"][:, -1] != 0).all()
