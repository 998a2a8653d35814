"""doo-ti calibrate: images of a board to a rig file; doo-ti triangulate: labelled marks to observations."""

import json
import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from doo_ti import Clamp, Rig, load_observations, observation_clamps, start_configuration
from doo_ti.commands.cli import main
from doo_ti.vision.board import Board
from doo_ti.vision.rig_files import load_rig, save_rig
from tests.commands.calls import refused, succeeded
from tests.conftest import SEED
from tests.io.rods import wavy_vertices
from tests.vision.boards import around, look, poses
from tests.vision.test_triangulation import HEADER, good_rows, ribbon, written

BOARD, RIG, SMALL = Board(9, 6, 10.0), around(), around(320, 240)
TEXT = "chessboard:9x6:10"


@pytest.fixture(scope="module")
def pictures(tmp_path_factory):
    """A folder with images of four views by three cameras; cam2 misses view 2, and cam0's image of view 3 is blank."""
    folder, rng = tmp_path_factory.mktemp("views"), np.random.default_rng(SEED)
    lines = ["view,cam0,cam1,cam2"]
    for view, (turn, place) in enumerate(poses(BOARD, 4, rng)):
        names = []
        for index, camera in enumerate(SMALL.cameras):
            name = f"{view}_{camera.name}.png"
            image = look(BOARD, camera, turn, place, rng) if (view, index) != (3, 0) else np.full((240, 320), 90, np.uint8)
            cv2.imwrite(str(folder / name), image)
            names.append("" if (view, index) == (2, 2) else name)
        lines.append(",".join([f"view{view}", *names]))
    (folder / "views.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder


def test_a_rig_from_images(pictures, tmp_path, capsys):
    out, argv = Path("new/rig.yaml"), f"calibrate {pictures}/views.csv --board {TEXT} --out new/rig.yaml"
    printed = succeeded(capsys, argv)
    assert "3 cameras" in printed and "4 views" in printed and "540 corners" in printed and "1 of 11 images" in printed
    found, middle = load_rig(out), BOARD.points.mean(axis=0)
    assert found.names == SMALL.names
    for camera, truth in zip(found.cameras, SMALL.cameras):
        assert (camera.width, camera.height) == (320, 240)
        assert np.linalg.norm(camera.centre - truth.centre - middle) < 0.5
    summary = json.loads(succeeded(capsys, f"{argv} --json --world camera --distortion 2"))
    assert summary["rms_px"] < 0.3 and len(summary["images"]) == 11
    assert summary["without_board"] == [{"view": "view3", "camera": "cam0", "corners": 0, "left_out": 0, "rms_px": None}]
    assert summary["worst"]["rms_px"] == max(image["rms_px"] or 0 for image in summary["images"])
    cameras = summary["cameras"]
    assert cameras[0]["centre_mm"] == [0, 0, 0] and cameras[0]["centre_sigma_mm"] == [0, 0, 0]
    assert cameras[1]["distortion"][2:] == [0, 0, 0] and min(cameras[2]["centre_sigma_mm"]) > 0


TABLES = {
    "one camera": ("view,cam0\na,x.png\n", "a rig has two or more"),
    "a camera twice": ("view,cam0,cam0\na,x.png,x.png\n", "'cam0' is there twice"),
    "a view twice": ("view,cam0,cam1\na,,\na,,\n", "'a' in line 2"),
    "an image that is not there": ("view,cam0,cam1\na,x.png,\n", "cam0: no such file")}


@pytest.mark.parametrize("case", TABLES)
def test_wrong_lists_of_views(capsys, tmp_path, case):
    text, problem = TABLES[case]
    Path("views.csv").write_text(text)
    refused(capsys, tmp_path, f"calibrate views.csv --board {TEXT} --out rig.yaml", "views.csv", problem)


def test_wrong_images(capsys, tmp_path):
    blank, small = np.full((480, 640), 90, np.uint8), np.full((240, 320), 90, np.uint8)
    for name, image in (("a.png", blank), ("b.png", blank), ("small.png", small)):
        cv2.imwrite(name, image)
    views, argv = Path("views.csv"), f"calibrate views.csv --board {TEXT} --out rig.yaml"
    for second, words in (("small.png", ["small.png", "size", "320 x 240 px, but cam0's first image has 640 x 480"]),
                          ("b.png", ["views.csv", "cam0", "the board was found in 0 of its images"])):
        views.write_text(f"view,cam0,cam1\none,a.png,b.png\ntwo,{second},b.png\n")
        refused(capsys, tmp_path, argv, *words)
    views.write_text("view,cam0,cam1,cam2\none,a.png,b.png,\n")
    refused(capsys, tmp_path, argv, "cam2", "no image of this camera")


OPTIONS = {
    "no board": (["--board", "checkers"], "--board", "'checkers'"),
    "an ambiguous board": (["--board", "chessboard:8x6:10"], "--board", "half a turn"),
    "another file": (["--out", "rig.json"], "--out", "rig.json"),
    "another world": (["--world", "table"], "--world", "'table'"),
    "distortion": (["--distortion", "3"], "--distortion", "3")}


@pytest.mark.parametrize("case", OPTIONS)
def test_wrong_options(capsys, pictures, tmp_path, case):
    words, *expected = OPTIONS[case]
    refused(capsys, tmp_path, [*f"calibrate {pictures}/views.csv --board {TEXT} --out rig.yaml".split(), *words], *expected)


def rows_of(marks: np.ndarray, rng, noise: float = 0.3) -> list[list]:
    """Rows of a file for (D, V, 3) marks, or (D, V, 2, 3) on both edges of ribbons."""
    pixels = RIG.project(marks)
    pixels, rows = pixels + rng.normal(0, noise, pixels.shape), []
    for at in np.ndindex(*pixels.shape[:-1]):
        camera, observation, vertex, *side = at
        rows.append([f"pose{observation}", RIG.names[camera], f"{vertex}{'LR'[side[0]] if side else ''}", *pixels[at].tolist()])
    return rows


def prepared(folder, rows) -> str:
    save_rig(folder / "rig.yaml", RIG)
    return f"triangulate {written(folder, rows)} --rig {folder}/rig.yaml"


def test_marks_become_observations(tmp_path, rng, capsys):
    vertices = wavy_vertices(rng, count=3, marks=10)
    vertices -= vertices.mean(axis=1, keepdims=True)
    rows = rows_of(vertices, rng)
    next(row for row in rows if row[:3] == ["pose1", "cam2", "4"])[3] += 25.0
    unlabelled = (["pose2", "cam0", "9"], ["pose0", "cam0", "3"], ["pose0", "cam2", "3"])
    rows = [row for row in rows if row[:3] not in unlabelled]
    Path("labels.csv").write_text("observation,end_distance_mm,end_rotation_deg,total_twist_deg\n" + "".join(
        f"pose{d},{30 + 12 * d},{30 * d},{400 * d}\n" for d in range(3)))
    argv = f"{prepared(tmp_path, rows)} --out new/silk.npz --sigma-px 0.3 --labels labels.csv --up 0,-1,0"
    written(tmp_path, [[*row, "note"] for row in rows], HEADER.replace("\n", ",remark\n"))  # a column more is no matter
    printed = succeeded(capsys, argv)
    assert "3 observations" in printed and "29 of 30" in printed and re.search("outlier .*pose1.* 4.*cam2", printed)
    found = load_observations("new/silk.npz")
    assert found.name == "silk" and np.argwhere(~found.valid).tolist() == [[0, 3]]
    assert (np.linalg.norm(found.vertices - vertices, axis=-1)[found.valid] / found.sigma[found.valid]).max() < 8
    assert found.end_distance.tolist() == [30, 42, 54] and found.up.tolist() == [0, -1, 0]
    np.testing.assert_allclose(found.total_twist, np.radians([0, 400, 800]))
    summary = json.loads(succeeded(capsys, f"{argv} --json"))
    assert summary["names"] == ["pose0", "pose1", "pose2"]
    assert summary["marks"] == {"triangulated": 28, "outlier_left_out": 1, "few_views": 1}
    (outlier,) = summary["outliers"]
    assert (outlier["observation"], outlier["mark"], outlier["camera"]) == ("pose1", "4", "cam2")
    assert 15 < outlier["residual_px"] < 35 and summary["contradictory"] == []
    assert 0.2 < summary["label_sigma_px"] < 0.4 and all(0.1 < rms < 0.5 for rms in summary["rms_px"].values())


def test_a_ribbon_is_ready_to_be_relaxed(tmp_path, rng, capsys):
    printed = succeeded(capsys, f"{prepared(tmp_path, rows_of(ribbon(rng)[2], rng))} --out ribbon.csv")
    assert "a ribbon" in printed and "0 carried over" in printed and "start_frame and end_frame" in printed
    found = load_observations("ribbon.csv")
    assert found.frames.shape == (4, 11, 3, 3) and found.sigma.shape == (4, 12)
    clamps = observation_clamps(found)
    assert clamps.start == clamps.end == Clamp.FRAME
    assert start_configuration(found, clamps).quaternions.shape == (4, 11, 4)


def test_two_labels_that_contradict_each_other_are_reported(tmp_path, rng, capsys):
    vertices = wavy_vertices(rng, count=1, marks=5)
    rows = [row for row in rows_of(vertices - vertices.mean(axis=1, keepdims=True), rng) if row[1] != "cam2"]
    rows[2][4] += 60
    rows[2][3] += 60
    argv = f"{prepared(tmp_path, rows)} --out F.npz"
    refused(capsys, tmp_path, argv, "no observation has positions for both 1 and 2", "--rest-length")
    printed = succeeded(capsys, f"{argv} --rest-length 3")
    assert re.search("contradictory .*pose0.* 2.*cam0", printed) and "cam1" in printed and "1 contradictory" in printed
    found = load_observations("F.npz")
    assert not found.valid[0, 2] and found.rest_length.tolist() == [3, 3, 3, 3]
    assert main([*argv.split(), "--threshold", "500"]) == 0 and load_observations("F.npz").valid.all()


def test_wrong_options_of_triangulate(capsys, tmp_path):
    argv = prepared(tmp_path, good_rows())
    refused(capsys, tmp_path, f"{argv} --out marks.csv", "--out", "the input itself")
    refused(capsys, tmp_path, f"{argv} --out F.npz --threshold -1", "threshold", "positive")


@pytest.mark.parametrize("spoil, option", [
    (lambda camera: (camera.rotation.T, camera.centre), "--rig-poses opencv-to-world"),
    (lambda camera: (camera.rotation, camera.translation / 1000), "--rig-unit m")])
def test_a_rig_in_metres_or_of_poses_in_the_world_is_recognised(capsys, tmp_path, rng, spoil, option):
    vertices = wavy_vertices(rng, count=2, marks=8)
    vertices -= vertices.mean(axis=1, keepdims=True)
    argv = f"{prepared(tmp_path, rows_of(vertices, rng))} --out F.npz"
    poses = [spoil(camera) for camera in RIG.cameras]
    save_rig(tmp_path / "rig.yaml", Rig(tuple(replace(camera, rotation=turn, translation=shift)
                                              for camera, (turn, shift) in zip(RIG.cameras, poses))))
    refused(capsys, tmp_path, argv, "rig.yaml", option)
    succeeded(capsys, f"{argv} {option}")
    np.testing.assert_allclose(load_observations("F.npz").vertices, vertices, atol=1.0)
