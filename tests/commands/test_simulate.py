"""``doo-ti simulate`` and ``doo-ti identify``: from files to files, and what they refuse."""

import json
from pathlib import Path

import numpy as np
import pytest

from doo_ti.commands import identify
from doo_ti.commands.cli import main
from tests.commands.calls import ended, made, refused, succeeded, written
from tests.io.test_formats import motive, table

SCENE = """
rate_hz = 50
duration_s = 0.2
rod = { length_mm = 300.0, edges = 6 }
materials.rope = { bend = 1e6, bend_damping_s = 0.02 }
clamps.end = "frame"
[[moments]]
time_s = 0.0
end_position_mm = [250, 0, 0]
[[moments]]
time_s = 0.2
end_position_mm = [250, 40, 20]
"""
FIT = "--modes 0 --fit bend_damping --bend 5e5"


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    folder = tmp_path_factory.mktemp("motion")
    scene = folder / "scene.toml"
    scene.write_text(SCENE.replace("duration_s = 0.2", "duration_s = 1.2").replace("edges = 6", "edges = 24, at_rest = true"))
    positions = made(f"simulate {scene} --substeps 8 --out {folder}/made.npz")["positions_mm"]
    noise = np.random.default_rng(5).normal(0, 0.05, (4, *positions.shape[1:]))
    noise[:, :, [0, 1, -2, -1]] = 0.0  # noise of grippers shakes the rod, and biases its damping
    np.savez(folder / "recorded.npz", positions_mm=positions + noise, rate_hz=50.0)
    return folder


@pytest.fixture(scope="module")
def theta(recording):
    assert main(f"identify {recording}/recorded.npz {FIT} --out {recording}/theta.json".split()) == 0
    return recording / "theta.json"


def test_the_bend_stiffness_that_made_the_motion_is_identified(theta):
    assert json.loads(theta.read_text())["bend_mm3"] == pytest.approx(1e6, rel=0.05)


@pytest.mark.thorough
def test_a_fit_far_off_is_doubted(recording, capsys, monkeypatch):
    for least in (None, -1.0):
        if least:
            for name in ("FAR_OFF", "RATE_OFF", "RATE_GAIN"):
                monkeypatch.setattr(identify, name, least)
        err = ended(capsys, f"identify {recording}/recorded.npz {FIT} --out theta.json")[1]
        for words in ("of its length off; check the rate", "frames a second than at the 50 stated"):
            assert (words in err) is bool(least)


@pytest.mark.thorough
def test_still_frames_join_the_motion(recording, tmp_path, capsys):
    shape = written(recording / "made.npz")["positions_mm"][0, :1]
    np.savez("still.npz", vertices_mm=np.repeat(shape, 3, axis=0), rest_length_mm=np.full(24, 12.5))
    command = f"identify {recording}/recorded.npz {FIT} --out theta.json"
    assert "3 still frames, 0 left out" in succeeded(capsys, f"{command} --still still.npz --still-noise 0.05")
    fitted = json.loads(Path("theta.json").read_text())
    assert fitted["bend_mm3"] == pytest.approx(1e6, rel=0.02) and fitted["stills"]["mean_error_mm"] < 0.2
    np.savez("still.npz", vertices_mm=2.0 * shape, rest_length_mm=np.full(24, 25.0))
    for more in ("--still still.npz", "--still still.npz --still-noise -1", "--still-noise 1"):
        refused(capsys, tmp_path, f"{command} {more}")


def test_a_recording_is_predicted_from_its_grippers(recording, theta):
    found = made(f"simulate {recording}/recorded.npz --theta {theta} --out predicted.npz")
    recorded = written(recording / "recorded.npz")["positions_mm"]
    assert found["positions_mm"].shape == recorded.shape
    assert found["status"].shape == found["error_mm"].shape == recorded.shape[:2] and not found["status"].any()
    np.testing.assert_array_equal(found["positions_mm"][:, :2], recorded[:, :2])
    np.testing.assert_array_equal(found["positions_mm"][:, :, [0, 1, -2, -1]], recorded[:, :, [0, 1, -2, -1]])
    assert found["error_mm"].mean() < 0.5


@pytest.mark.thorough
def test_captures_are_read_as_they_are(recording, theta, tmp_path, capsys):
    """Motion capture in metres, and a table without a rate, as the npz made of the same marks."""
    positions = written(recording / "recorded.npz")["positions_mm"][0]
    np.savez("one.npz", positions_mm=positions, rate_hz=50.0, up=(0, 0, 1))
    Path("take.csv").write_text(motive(positions / 1000, "Meters"))
    Path("marks.csv").write_text(table(positions / 10, "frame,mark,x,y,z"))
    found, columns = [], "--columns observation=frame,vertex=mark"
    for words in ("one.npz", "take.csv --rate 50 --up 0,0,1", f"marks.csv --rate 50 --unit cm {columns}"):
        found.append(made(f"simulate {words} --theta {theta} --out f.npz")["positions_mm"])
        np.testing.assert_allclose(found[-1], found[0], atol=1e-6)
    assert found[0].shape == positions.shape, "one recording has no axis for it"
    refused(capsys, tmp_path, f"simulate marks.csv --theta {theta} --out f.npz")
    refused(capsys, tmp_path, f"simulate marks.csv --theta {theta} --out f.npz {columns}", "--rate", "marks.csv")


@pytest.mark.thorough
def test_gravity_of_a_capture_is_its_own(recording, capsys):
    """Motive's y axis points up: marks whose axes are turned give the same rod."""
    positions, thetas = written(recording / "recorded.npz")["positions_mm"][:1], []
    turned = np.stack([positions[..., 0], positions[..., 2], -positions[..., 1]], axis=-1)
    np.savez("z.npz", positions_mm=positions, rate_hz=50.0)
    Path("y.csv").write_text(motive(turned[0] / 1000, "Meters"))
    for words in ("z.npz", "y.csv --rate 50"):
        succeeded(capsys, f"identify {words} {FIT} --out theta.json")
        thetas.append(json.loads(Path("theta.json").read_text()))
    assert thetas[0]["bend_mm3"] == pytest.approx(thetas[1]["bend_mm3"], rel=1e-4)
    np.testing.assert_allclose(thetas[1]["up"], [0, 1, 0])


def test_poses_of_grippers_without_markers(recording, theta, tmp_path, capsys):
    """From a table of poses, and the rod at rest where observations show it: as predict carries it."""
    positions = written(recording / "made.npz")["positions_mm"][0]
    np.savez("seen.npz", vertices_mm=positions[:1])
    time = np.arange(12) / 50.0
    ends = positions[0, -1] + np.stack([-20 * time, 60 * time**2, 0 * time], axis=-1)
    np.savez("poses.npz", time_s=time, end_position_mm=ends)
    more = f"--theta {theta} --out f.npz"
    refused(capsys, tmp_path, f"simulate poses.npz {more}", "--motion")
    command = f"simulate seen.npz --motion poses.npz {more}"
    found = made(command)
    assert found["positions_mm"].shape == (1, 12, 25, 3) and (found["status"] == 0).all() and found["rate_hz"] == 50
    np.testing.assert_allclose(found["positions_mm"][0, :, -1], ends, atol=1e-6)
    np.testing.assert_array_equal(found["positions_mm"], made(f"simulate poses.npz --start seen.npz {more}")["positions_mm"])
    np.savez("poses.npz", time_s=np.delete(time, 3), end_position_mm=np.delete(ends, 3, axis=0))
    refused(capsys, tmp_path, command, "time_s")
    np.testing.assert_allclose(made(f"{command} --rate 50")["positions_mm"][0, :, -1], ends, atol=0.1)


def test_wrong_recordings_and_thetas_of_other_rods_are_one_line_and_gaps_are_filled_only_if_asked(
        recording, theta, tmp_path, capsys):
    content, form = written(recording / "recorded.npz"), json.loads(theta.read_text())
    for change in ({"rate_hz": -1.0}, {"positions_mm": "text"}):
        np.savez("wrong.npz", **content | change)
        for command in (f"simulate wrong.npz --theta {theta} --out f.npz", "identify wrong.npz --out f.json"):
            refused(capsys, tmp_path, command, *change)
    Path("other.json").write_text(json.dumps(form | {"rest_length_mm": form["rest_length_mm"][:-1]}))
    refused(capsys, tmp_path, f"simulate {recording}/recorded.npz --theta other.json --out f.npz", "rest_length_mm")
    content["positions_mm"][1, 20:23, 3] = np.nan
    np.savez("gaps.npz", **content)
    command = f"simulate gaps.npz --theta {theta} --out out.npz"
    refused(capsys, tmp_path, command)
    succeeded(capsys, f"{command} --fill-gaps")


@pytest.mark.parametrize(("old", "new", "field"), [
    ("edges = 6", "edges = 2", "rod.edges"), ("time_s = 0.2", "time_s = -0.2", "time_s"),
    ("bend_damping_s", "damping", "damping")])
def test_wrong_scenes_are_one_line(old, new, field, tmp_path, capsys):
    Path("scene.toml").write_text(SCENE.replace(old, new))
    refused(capsys, tmp_path, "simulate scene.toml --out f.npz", field)


@pytest.mark.thorough
def test_energy_that_the_time_steps_lose_is_said(capsys):
    """A stiff rod let go: with a step a twentieth of its period long it comes to rest, without any damping in the scene."""
    Path("rod.toml").write_text("rate_hz = 200\nduration_s = 0.3\nrod = { length_mm = 100.0, edges = 8 }\n"
                                "materials.steel = { EI = 0.0025, linear_density = 25 }\n")
    for substeps, said in ((1, True), (16, False)):
        printed = succeeded(capsys, f"simulate rod.toml --substeps {substeps} --out r.npz")
        assert ("the time steps lose up to" in printed) is said


def test_pictures_and_animations():
    Path("scene.toml").write_text(SCENE)
    energy = made("simulate scene.toml --out f.npz --picture f.png --animation f.gif --recording f.rrd")
    assert all(Path(name).stat().st_size > 1000 for name in ("f.png", "f.gif", "f.rrd"))
    parts = [energy[f"energy_{name}"] for name in ("kinetic", "gravity", "bending", "twist")]
    np.testing.assert_allclose(energy["energy_sum"], sum(parts))
    assert (energy["energy_dissipated"][:, -1] > 0).all() and (energy["energy_work"][:, -1] != 0).all()
