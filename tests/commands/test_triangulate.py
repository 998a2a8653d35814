"""doo-ti triangulate: labelled marks to observations that the other commands read."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from doo_ti import Clamp, load_observations, observation_clamps, start_configuration
from doo_ti.commands.cli import main
from doo_ti.vision.cameras import Rig
from doo_ti.vision.rig_files import save_rig
from tests.commands.calls import refused
from tests.io.rods import wavy_vertices
from tests.vision.boards import around
from tests.vision.test_triangulation import HEADER, good_rows, ribbon, written

RIG = around()


def rows_of(marks: np.ndarray, rng, noise: float = 0.3) -> list[list]:
    """Rows of a file for (D, V, 3) marks, or (D, V, 2, 3) on both edges of ribbons."""
    pixels = RIG.project(marks)
    pixels = pixels + rng.normal(0, noise, pixels.shape)
    rows = []
    for at in np.ndindex(*pixels.shape[:-1]):
        camera, observation, vertex, *side = at
        rows.append([f"pose{observation}", RIG.names[camera], f"{vertex}{'LR'[side[0]] if side else ''}", *pixels[at].tolist()])
    return rows


def prepared(folder, rows) -> list[str]:
    """The command on a rig and these rows."""
    save_rig(folder / "rig.yaml", RIG)
    return ["triangulate", str(written(folder, rows)), "--rig", str(folder / "rig.yaml")]


def test_marks_become_observations(tmp_path, rng, capsys):
    vertices = wavy_vertices(rng, count=3, marks=10)
    vertices -= vertices.mean(axis=1, keepdims=True)
    rows = rows_of(vertices, rng)
    next(row for row in rows if row[:3] == ["pose1", "cam2", "4"])[3] += 25.0
    unlabelled = (["pose2", "cam0", "9"], ["pose0", "cam0", "3"], ["pose0", "cam2", "3"])
    rows = [row for row in rows if row[:3] not in unlabelled]
    (tmp_path / "labels.csv").write_text("observation,end_distance_mm,end_rotation_deg,total_twist_deg\n" + "".join(
        f"pose{d},{30 + 12 * d},{30 * d},{400 * d}\n" for d in range(3)))
    out = tmp_path / "new" / "silk.npz"
    argv = [*prepared(tmp_path, rows), "--out", str(out), "--sigma-px", "0.3", "--labels", str(tmp_path / "labels.csv"),
            "--up", "0,-1,0"]
    assert main(argv) == 0
    printed = capsys.readouterr().out
    assert "3 observations" in printed and "29 of 30" in printed
    assert re.search("outlier .*pose1.* 4.*cam2", printed)
    found = load_observations(out)
    assert found.name == "silk" and np.argwhere(~found.valid).tolist() == [[0, 3]]
    assert (np.linalg.norm(found.vertices - vertices, axis=-1)[found.valid] / found.sigma[found.valid]).max() < 8
    assert found.end_distance.tolist() == [30, 42, 54] and found.up.tolist() == [0, -1, 0]
    np.testing.assert_allclose(found.total_twist, np.radians([0, 400, 800]))

    assert main([*argv, "--json"]) == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary["names"] == ["pose0", "pose1", "pose2"]
    assert summary["marks"] == {"triangulated": 28, "outlier_left_out": 1, "few_views": 1}
    (outlier,) = summary["outliers"]
    assert (outlier["observation"], outlier["mark"], outlier["camera"]) == ("pose1", "4", "cam2")
    assert 15 < outlier["residual_px"] < 35 and summary["contradictory"] == []
    assert 0.2 < summary["label_sigma_px"] < 0.4 and all(0.1 < rms < 0.5 for rms in summary["rms_px"].values())


def test_a_ribbon_is_ready_to_be_relaxed(tmp_path, rng, capsys):
    vertices, _, edges = ribbon(rng)
    out = tmp_path / "ribbon.csv"
    assert main([*prepared(tmp_path, rows_of(edges, rng)), "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "a ribbon" in printed and "0 carried over" in printed and "start_frame and end_frame" in printed
    found = load_observations(out)
    assert found.frames.shape == (4, 11, 3, 3) and found.sigma.shape == (4, 12)
    clamps = observation_clamps(found)
    assert clamps.start == clamps.end == Clamp.FRAME
    assert start_configuration(found, clamps).quaternions.shape == (4, 11, 4)


def test_two_labels_that_contradict_each_other_are_reported(tmp_path, rng, capsys):
    vertices = wavy_vertices(rng, count=1, marks=5)
    rows = [row for row in rows_of(vertices - vertices.mean(axis=1, keepdims=True), rng) if row[1] != "cam2"]
    rows[2][4] += 60
    rows[2][3] += 60
    argv = [*prepared(tmp_path, rows), "--out", str(tmp_path / "F.npz")]
    refused(capsys, tmp_path, argv, "no observation has positions for both 1 and 2", "--rest-length")
    assert main([*argv, "--rest-length", "3"]) == 0
    printed = capsys.readouterr().out
    assert re.search("contradictory .*pose0.* 2.*cam0", printed) and "cam1" in printed and "1 contradictory" in printed
    found = load_observations(tmp_path / "F.npz")
    assert not found.valid[0, 2] and found.rest_length.tolist() == [3, 3, 3, 3]


WRONG = {
    "a name of two lines": ([('"a\nb"', *row[1:]) for row in good_rows()], [], "marks.csv", "line break"),
    "sigma": (good_rows(), ["--sigma-px", "0"], "--sigma-px", "positive"),
    "threshold": (good_rows(), ["--threshold", "-1"], "threshold", "positive"),
    "the input itself": (good_rows(), ["--out", "marks.csv"], "--out", "the input itself"),
    "labels": (good_rows(), ["--labels", "none.csv"], "none.csv", "no such file"),
    "rig": (good_rows(), ["--rig", "none.yaml"], "none.yaml", "no such file"),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_input(capsys, tmp_path, monkeypatch, case):
    monkeypatch.chdir(tmp_path)
    rows, words, *expected = WRONG[case]
    argv = [*prepared(tmp_path, rows), "--out", str(tmp_path / "F.npz"), *words]
    refused(capsys, tmp_path, argv, *expected)


def test_one_camera_is_no_rig(capsys, tmp_path):
    argv = [*prepared(tmp_path, good_rows()), "--out", str(tmp_path / "F.npz")]
    save_rig(tmp_path / "rig.yaml", Rig(RIG.cameras[:1]))
    refused(capsys, tmp_path, argv, "rig.yaml", "cameras", "two or more")


def test_the_header_may_have_more_columns(tmp_path, rng):
    vertices = wavy_vertices(rng, count=1, marks=4)
    rows = [[*row, "note"] for row in rows_of(vertices - vertices.mean(axis=1, keepdims=True), rng)]
    argv = prepared(tmp_path, rows)
    written(tmp_path, rows, HEADER.replace("\n", ",remark\n"))
    assert main([*argv, "--out", str(tmp_path / "F.npz")]) == 0


@pytest.mark.parametrize("spoil, option", [
    (lambda camera: (camera.rotation.T, camera.centre), "--rig-poses opencv-to-world"),
    (lambda camera: (camera.rotation, camera.translation / 1000), "--rig-unit m"),
])
def test_a_rig_in_metres_or_of_poses_in_the_world_is_recognised(capsys, tmp_path, rng, spoil, option):
    vertices = wavy_vertices(rng, count=2, marks=8)
    rows = rows_of(vertices - vertices.mean(axis=1, keepdims=True), rng)
    argv = [*prepared(tmp_path, rows), "--out", str(tmp_path / "F.npz")]
    cameras = []
    for camera in RIG.cameras:
        rotation, translation = spoil(camera)
        cameras.append(replace(camera, rotation=rotation, translation=translation))
    save_rig(tmp_path / "rig.yaml", Rig(tuple(cameras)))
    capsys.readouterr()
    refused(capsys, tmp_path, argv, "rig.yaml", option)
    assert main([*argv, *option.split()]) == 0
    found = load_observations(tmp_path / "F.npz").vertices
    np.testing.assert_allclose(found, vertices - vertices.mean(axis=1, keepdims=True), atol=1.0)
