"""doo-ti track: from a video to a file of rods and a recording, also with lost frames and errors."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial import cKDTree

from doo_ti import Material, Tracker, detect
from doo_ti.commands.track import _off_thread
from doo_ti.vision.rig_files import save_rig
from doo_ti.vision.tubes import smooth_curve
from tests.commands.calls import ended, refused, succeeded, written
from tests.conftest import check_refused
from tests.perception.test_tracking import EDGES, FRAMES, LENGTH, far_motion, images, rods
from tests.record.runs import read
from tests.vision.scenes import three_cameras

BLANK = (4, 5)


def film(folder, frames: int):
    """A folder with a video in which nothing is seen for two frames, its FRAMES.csv, the rig, and the far clamp's motion."""
    save_rig(folder / "rig.yaml", three_cameras())
    seed = ",".join(f"{value:.6f}" for value in (*rods()[0, 0], *(rods()[0, 1] - rods()[0, 0])))
    lines = ["frame,cam0,cam1,cam2,time_s,seed_x,seed_y,seed_z,dir_x,dir_y,dir_z\n"]
    for row in range(frames):
        names = [f"{row:03d}_cam{camera}.png" for camera in range(3)]
        for name, image in zip(names, images(row), strict=True):
            assert cv2.imwrite(str(folder / name), np.full_like(image, 200) if row in BLANK else image)
        lines.append(",".join([f"{row:03d}", *names, f"{row / 30:.4f}", seed if row == 0 else ",,,,,"]) + "\n")
    (folder / "frames.csv").write_text("".join(lines))
    clamps = [far_motion().at(row / (FRAMES - 1)) for row in range(frames)]
    np.savez(folder / "motion.npz", end_position_mm=np.array([held.end_position[0] for held in clamps]),
             end_frame=np.array([held.end_frame[0] for held in clamps]))
    np.savez(folder / "short.npz", end_position_mm=np.zeros((3, 3)))
    return folder


@pytest.fixture(scope="module")
def filmed(tmp_path_factory):
    return film(tmp_path_factory.mktemp("video"), 8)


def of(folder, more: str = "", out: str = "new/f.npz") -> str:
    return (f"track --rig {folder}/rig.yaml --frames {folder}/frames.csv --rest-length {LENGTH}:{EDGES} --bend 2e5 --twist 2e5 "
            f"--weight 1 --out {out} {more}")


def changed(folder, path, change) -> None:
    """Write lines of FRAMES.csv, changed, beside the images."""
    path.write_text("\n".join(change((folder / "frames.csv").read_text().splitlines())) + "\n")


@pytest.mark.thorough
def test_a_video_is_tracked_and_recorded(tmp_path_factory, capsys):
    printed = succeeded(capsys, of(film(tmp_path_factory.mktemp("whole"), FRAMES)))
    assert "16 frames of 3 images" in printed and "2 frames by Algorithm 1: 000, 006" in printed and "lost: 004, 005" in printed
    assert sorted(path.name for path in Path("new").iterdir()) == ["f.npz", "f.rrd"]
    found = written("new/f.npz")
    assert {name: value.shape for name, value in found.items()} == {
        "name": (FRAMES,), "time_s": (FRAMES,), "rest_length_mm": (EDGES,), "up": (3,), "length_range_mm": (2,),
        "vertices_mm": (FRAMES, EDGES + 1, 3), "energy_vis": (FRAMES,), "camera_error_px": (FRAMES, 3), "status": (FRAMES,),
        "stable": (FRAMES,), "how": (FRAMES,), "verdict": (FRAMES,), "doubts": (FRAMES,), "sigma_mm": (FRAMES, EDGES + 1)}
    assert "".join(map(str, found["how"])) == "1000221000000000"
    off = np.linalg.norm(found["vertices_mm"] - rods(), axis=-1).mean(axis=1)
    assert np.isnan(off[list(BLANK)]).all() and np.delete(off, BLANK).max() < 0.15
    static, moving = read("new/f.rrd")
    assert moving["/world/rods"]["frame"]["frame"] == list(range(FRAMES))
    drawn = [len(strips[0]) for strips in moving["/images/cam1/rods"]["frame"]["LineStrips2D:strips"]]
    assert [row for row, count in enumerate(drawn) if count == 0] == list(BLANK) and set(drawn) == {0, EDGES + 1}
    assert len(moving["/images/cam2"]["frame"]["frame"]) == FRAMES and "/world/cameras/cam0" in static


def test_a_video_is_tracked_from_a_click(filmed, tmp_path, capsys):
    """In two frames of two of the rig's cameras; neither length nor stiffness is stated."""
    frames = filmed / "clicked.csv"
    u, v = three_cameras().cameras[1].project(rods()[0, :1])[0]
    changed(filmed, frames, lambda lines: [",".join(line.split(",")[:1] + line.split(",")[2:4]) for line in lines[:3]])
    words = f"track --rig {filmed}/rig.yaml --no-recording --out new/f.npz --frames"
    clicked = f"{words} {frames} --seed-pixel cam1:{u + 3:.0f},{v - 2:.0f}"
    refused(capsys, tmp_path, f"{words} {frames}", "seed_x")
    printed, found = succeeded(capsys, clicked), written("new/f.npz")
    assert found["how"].tolist() == [1, 0] and abs(found["rest_length_mm"].sum() / (LENGTH * EDGES) - 1) < 0.03
    assert (found["sigma_mm"][:, 0] > 0.05).all(), "a click is no exact seed"
    for rod, truth in zip(found["vertices_mm"], rods(), strict=False):
        assert cKDTree(smooth_curve(truth, 20)).query(rod)[0].mean() < 0.3
    low, high = found["length_range_mm"]
    assert low < LENGTH * EDGES < high and "length uncertain in 2" in printed and "whose start is uncertain" not in printed
    changed(filmed, frames, lambda _: [f"{line},{own}" for line, own in zip(frames.read_text().split(), ("cam1_u", "3"))])
    refused(capsys, tmp_path, clicked, "cam1_u", "either")
    refused(capsys, tmp_path, of(filmed, "--seed-pixel cam1:3,3"), "--seed-pixel", "seed_x")


@pytest.mark.thorough
def test_images_in_another_order_are_said(filmed, capsys):
    frames, (u, v) = filmed / "swapped.csv", three_cameras().cameras[0].project(rods()[0, :1])[0]
    changed(filmed, frames, lambda _: ["frame,cam0,cam1,cam2", "0,000_cam0.png,000_cam2.png,000_cam1.png"])
    err = ended(capsys, f"track --rig {filmed}/rig.yaml --frames {frames} --seed-pixel cam0:{u:.0f},{v:.0f} --no-recording "
                        f"--rest-length {LENGTH}:{EDGES} --out new/f.npz", 1)[1]
    assert "as those of cam0, cam2, cam1" in err


def test_a_start_that_the_thread_has_left_is_uncertain():
    rig, rod = three_cameras(), smooth_curve(rods()[0], 20)
    seen = [detect(image) for image in images(0)]
    assert _off_thread(rig, seen, rod[0]) < 0.5 < 3.0 < _off_thread(rig, seen, rod[0] - 5 * (rod[40] - rod[0]))
    nothing = seen[1].take(np.zeros(seen[1].count, dtype=bool))
    assert _off_thread(rig, [seen[0], nothing, nothing], rod[0]) == 0


def test_a_known_motion_is_taken(filmed, tmp_path, capsys):
    printed = json.loads(succeeded(capsys, of(filmed, f"--motion {filmed}/motion.npz --no-recording --json", "f.npz")))
    assert printed["seeded"] == ["000", "006"] and printed["lost"] == ["004", "005"] and len(printed["tracked"]) == 4
    assert printed["written"] == ["f.npz"] and [path.name for path in tmp_path.iterdir()] == ["f.npz"]


@pytest.mark.thorough
def test_finished_frames_are_kept(filmed, tmp_path, capsys):
    broken = tmp_path / "broken.png"
    broken.write_bytes(b"no image")
    frames = filmed / "broken.csv"
    changed(filmed, frames, lambda lines: [line.replace("003_cam1.png", str(broken)) for line in lines])
    err = ended(capsys, of(filmed, f"--frames {frames}", "f.npz"), 1)[1]
    assert err.count("\n") == 1 and "broken.png" in err and "3 of 8 frames are kept" in err
    assert written("f.npz")["how"].tolist() == [1, 0, 0]


@pytest.mark.parametrize("change, words", [
    (lambda lines: lines[:1], ("no rows",)),
    (lambda lines: [line.replace("dir_z", "dir_w") for line in lines], ("dir_z", "missing")),
    (lambda lines: [line.replace("cam2,", "cam7,", 1) for line in lines], ("cam7", "no camera of the rig")),
    (lambda lines: [lines[0], *lines[2:]], ("seed_x", "'' in line 2")),
    (lambda lines: [*lines[:3], lines[3].replace(",,,,,,", ",1,2,3,4,5,x")], ("dir_z", "'x' in line 4")),
    (lambda lines: [*lines[:2], lines[3], lines[2]], ("time_s", "rise")),
    (lambda lines: [line.replace("002_cam0.png", "missing.png") for line in lines], ("cam0", "missing.png' in line 4"))])
def test_wrong_frames_are_reported(filmed, tmp_path, capsys, change, words):
    frames = filmed / "changed.csv"
    changed(filmed, frames, change)
    refused(capsys, tmp_path, of(filmed, f"--frames {frames}"), "changed.csv", *words)


def test_videos_and_single_cameras_are_refused(filmed, tmp_path, capsys):
    (filmed / "v.mp4").write_bytes(b"\x00\x8f")
    refused(capsys, tmp_path, of(filmed, f"--frames {filmed}/v.mp4"), "v.mp4", "a video")
    check_refused("one camera", Tracker, three_cameras().take([0]), np.full(5, 3.0), Material(1e5, 1e5))


@pytest.mark.parametrize("change, words", [
    ("--bend 1e5:1e6:5", ("--bend", "grid")), ("--bend 1e5,2e5", ("--bend", "round")), ("--frames none.csv", ("none.csv",)),
    ("--rest-length 3:x", ("--rest-length",)), ("--bend-1 1e5", ("--bend-1", "unknown")),
    ("--motion missing.npz", ("missing.npz",)), ("--motion short.npz", ("short.npz", "3 moments for 8 frames"))])
def test_wrong_options_are_reported(filmed, tmp_path, capsys, monkeypatch, change, words):
    monkeypatch.chdir(filmed)
    refused(capsys, tmp_path, of(filmed, change), *words)
