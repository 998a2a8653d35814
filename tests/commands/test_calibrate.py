"""doo-ti calibrate: images of a board to a rig file."""

import json

import cv2
import numpy as np
import pytest

from doo_ti.commands.cli import main
from doo_ti.vision.board import Board
from doo_ti.vision.rig_files import load_rig
from tests.commands.calls import in_process, refused
from tests.conftest import SEED
from tests.vision.boards import around, look, poses

BOARD, RIG = Board(9, 6, 10.0), around()
TEXT = "chessboard:9x6:10"


@pytest.fixture(scope="module")
def pictures(tmp_path_factory):
    """A folder with images of four views by three cameras; cam2 misses view 2, and cam0's image of view 3 is blank."""
    folder = tmp_path_factory.mktemp("views")
    rng = np.random.default_rng(SEED)
    lines = ["view,cam0,cam1,cam2"]
    for view, (turn, place) in enumerate(poses(BOARD, 4, rng)):
        names = []
        for index, camera in enumerate(RIG.cameras):
            name = f"{view}_{camera.name}.png"
            image = look(BOARD, camera, turn, place, rng) if (view, index) != (3, 0) else np.full((480, 640), 90, np.uint8)
            cv2.imwrite(str(folder / name), image)
            names.append("" if (view, index) == (2, 2) else name)
        lines.append(",".join([f"view{view}", *names]))
    (folder / "views.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder


@pytest.mark.thorough
def test_a_rig_from_images(pictures, tmp_path, capsys):
    out = tmp_path / "new" / "rig.yaml"
    assert main(["calibrate", str(pictures / "views.csv"), "--board", TEXT, "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "3 cameras" in printed and "4 views" in printed and "540 corners" in printed and "1 of 11 images" in printed
    found = load_rig(out)
    assert found.names == RIG.names
    middle = BOARD.points.mean(axis=0)
    for camera, truth in zip(found.cameras, RIG.cameras):
        assert (camera.width, camera.height) == (640, 480)
        assert np.linalg.norm(camera.centre - truth.centre - middle) < 0.5
    again = tmp_path / "again.yaml"
    assert main(["calibrate", str(pictures / "views.csv"), "--board", TEXT, "--out", str(again)]) == 0
    assert again.read_bytes() == out.read_bytes()


def test_its_summary_for_machines(pictures, tmp_path, capsys):
    argv = ["calibrate", str(pictures / "views.csv"), "--board", TEXT, "--out", str(tmp_path / "rig.yaml"), "--json",
            "--world", "camera", "--distortion", "2"]
    assert main(argv) == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary["rms_px"] < 0.3 and len(summary["images"]) == 11
    assert summary["without_board"] == [{"view": "view3", "camera": "cam0", "corners": 0, "rms_px": None}]
    assert summary["worst"]["rms_px"] == max(image["rms_px"] or 0 for image in summary["images"])
    cameras = summary["cameras"]
    assert cameras[0]["centre_mm"] == [0, 0, 0] and cameras[0]["centre_sigma_mm"] == [0, 0, 0]
    assert cameras[1]["distortion"][2:] == [0, 0, 0] and min(cameras[2]["centre_sigma_mm"]) > 0


TABLES = {
    "one camera": ("view,cam0\na,x.png\n", "a rig has two or more"),
    "a camera twice": ("view,cam0,cam0\na,x.png,x.png\n", "'cam0' is there twice"),
    "a view twice": ("view,cam0,cam1\na,,\na,,\n", "'a' in line 2"),
    "an image that is not there": ("view,cam0,cam1\na,x.png,\n", "cam0: no such file"),
}


@pytest.mark.parametrize("case", TABLES)
def test_wrong_lists_of_views(capsys, tmp_path, case):
    text, problem = TABLES[case]
    (tmp_path / "views.csv").write_text(text)
    argv = ["calibrate", str(tmp_path / "views.csv"), "--board", TEXT, "--out", str(tmp_path / "rig.yaml")]
    refused(capsys, tmp_path, argv, "views.csv", problem)


def test_wrong_images(capsys, tmp_path, pictures):
    blank, small = np.full((480, 640), 90, np.uint8), np.full((240, 320), 90, np.uint8)
    for name, image in (("a.png", blank), ("b.png", blank), ("small.png", small)):
        cv2.imwrite(str(tmp_path / name), image)
    (tmp_path / "broken.png").write_bytes((pictures / "0_cam0.png").read_bytes()[:20])
    (tmp_path / "text.png").write_text("no image")
    views = tmp_path / "views.csv"
    argv = ["calibrate", str(views), "--board", TEXT, "--out", str(tmp_path / "rig.yaml")]
    for second, words in (("small.png", ["small.png", "size", "320 x 240 px, but cam0's first image has 640 x 480"]),
                          ("broken.png", ["broken.png"]), ("text.png", ["text.png"]),
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
    "distortion": (["--distortion", "3"], "--distortion", "3"),
}


@pytest.mark.parametrize("case", OPTIONS)
def test_wrong_options(capsys, pictures, tmp_path, case):
    words, *expected = OPTIONS[case]
    argv = ["calibrate", str(pictures / "views.csv"), "--board", TEXT, "--out", str(tmp_path / "rig.yaml"), *words]
    refused(capsys, tmp_path, argv, *expected)


@pytest.mark.thorough
def test_a_broken_image_is_reported_in_one_line(pictures, tmp_path):
    """Image libraries write to the standard error themselves."""
    whole = (pictures / "0_cam0.png").read_bytes()
    (tmp_path / "half.png").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "views.csv").write_text("view,cam0,cam1\none,half.png,half.png\n")
    argv = ["calibrate", str(tmp_path / "views.csv"), "--board", TEXT, "--out", str(tmp_path / "rig.yaml")]
    done = in_process(argv)
    assert done.returncode == 2 and done.stdout == ""
    assert done.stderr.count("\n") == 1 and "half.png: file: cannot be read as an image" in done.stderr
