"""Rig files, ours and those of others, against OpenCV's projections; and what is said of another unit or other axes."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from doo_ti.vision.cameras import POSES, Rig, RigReading
from doo_ti.vision.rig_files import load_rig, rational_of_fisheye, save_rig
from tests.conftest import check_refused
from tests.vision.boards import around


def test_projection_is_opencv_s_and_cameras_have_names():
    grid = np.random.default_rng(1).uniform(-60, 60, size=(5, 7, 3))
    pixels = around().project(grid)
    assert pixels.shape == (3, 5, 7, 2)
    for camera, found in zip(around().cameras, pixels, strict=True):
        wanted = cv2.projectPoints(grid.reshape(-1, 3), cv2.Rodrigues(np.array(camera.rotation))[0], *map(np.array, (
            camera.translation, camera.matrix, camera.distortion)))[0]
        np.testing.assert_allclose(found.reshape(-1, 2), wanted.reshape(-1, 2), atol=1e-9)
        np.testing.assert_allclose(camera.rotation @ camera.centre + camera.translation, 0, atol=1e-10)
        behind = camera.centre - 10 * camera.rotation[2]
        assert np.isnan(camera.project(behind)).all() and camera.depth(behind) == pytest.approx(-10)
    assert around().only(["cam2", "cam0"]).names == ("cam2", "cam0")
    check_refused("no camera", around().only, ["cam7"])


@pytest.mark.sampled(9)
@pytest.mark.parametrize("spoil, word", [
    (lambda text: text.replace("cameras:", "kameras:"), "cameras"),
    (lambda text: text.replace("width: 640", "width: x"), "width"),
    (lambda text: text.replace("name: cam1", "name: seed_x"), "cameras"),
    (lambda text: text.replace("name: cam1", 'name: "cam\\n1"'), "line break"),
    (lambda text: text.replace("   K:", "   Q:"), "K"),
    (lambda text: "{{{", "not a rig"),
    (lambda text: "<?xml version='1.0'?><opencv_storage><cameras/></opencv_storage>", "cameras"),
    (lambda text: text.replace("         cols: 3\n", "", 1), "not a rig"),
    (lambda text: text.replace("cols: 3", "cols: 2147483647", 1), "not a rig"),
    (lambda text: text.replace("rows: 3", "rows: *x", 1), "not a rig"), (lambda text: text + "? [a]\n: b\n", "not a rig"),
    (lambda text: text.replace("width: 640", "width: 100000"), "width"),
    (lambda text: text.replace("width: 640", "width: 100000000000"), "width"),
    (lambda text: text.replace("name: cam1", "name: cam1\n      width: !!python/object/apply:os.getcwd []"), "not a rig"),
    (lambda text: "[" * 100_000, "not a rig")])
def test_a_bad_file_is_refused(tmp_path, spoil, word):
    save_rig(tmp_path / "rig.yaml", around())
    (tmp_path / "bad.yaml").write_text(spoil((tmp_path / "rig.yaml").read_text()))
    check_refused(word, load_rig, tmp_path / "bad.yaml")


@pytest.mark.parametrize("change", [
    {"rotation": np.diag([1.0, 1, -1])}, {"matrix": np.eye(3) * -1}, {"width": 0}, {"distortion": [1.0, 2]},
    {"translation": [0, 0, np.nan]}, {"translation": [0, 0, 1e300]}, {"distortion": [1e300, 0, 0, 0, 0]},
    {"matrix": [[1e300, 0, 0], [0, 1e300, 0], [0, 0, 1]]}, {"matrix": [[1e-300, 0, 0], [0, 1e-300, 0], [0, 0, 1]]},
    {"matrix": [[1e3, 0, 1e300], [0, 1e3, 0], [0, 0, 1]]}, {"matrix": np.eye(3) + 1j}, {"height": 10**11}])
def test_invalid_cameras_are_refused(change):
    check_refused(": ", replace, around().cameras[0], **change)


MATRIX = np.array([[610.0, 0, 633], [0, 612, 471], [0, 0, 1]])
SIZE = 1280, 960
POINTS = np.random.default_rng(4).uniform((-200, -150, 250), (200, 150, 500), (200, 3))
TURN, SHIFT = cv2.Rodrigues(np.array([0.05, -0.3, 0.02]))[0], np.array([-60.0, 3, 5])


def projected(coefficients, turn=np.zeros(3), shift=np.zeros(3), matrix=MATRIX, lens=cv2) -> np.ndarray:
    """(N, 2) px of ``POINTS`` by OpenCV, or by its module of another ``lens``."""
    return lens.projectPoints(POINTS[:, None], turn, shift, matrix, np.array(coefficients))[0].reshape(-1, 2)


def stereo(path, matrix="K", distortion="D", size=True, coefficients=(-0.2, 0.05, 1e-3, -5e-4, 0.01)) -> None:
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    of_lenses = {f"{name}{number}": value for number in (1, 2)
                 for name, value in ((matrix, MATRIX), (distortion, np.array([coefficients])))}
    of_images = {"image_width": SIZE[0], "image_height": SIZE[1]} if size else {}
    for name, value in (of_lenses | {"R": TURN, "T": SHIFT.reshape(3, 1)} | of_images).items():
        storage.write(name, value)
    storage.release()


@pytest.mark.parametrize("matrix, distortion, coefficients", [
    ("K", "D", (-0.2, 0.05, 1e-3, -5e-4, 0.01)), ("cameraMatrix", "distCoeffs", (0.1, 0.1, 0.1, 0.1)),
    ("M", "D", (-0.1, 0.02, 1e-3, 0, 0.01, 0.05, -0.01, 0.002))])
def test_opencv_s_stereo_files(tmp_path, matrix, distortion, coefficients):
    stereo(tmp_path / "stereo.yml", matrix, distortion, coefficients=coefficients)
    found = load_rig(tmp_path / "stereo.yml")
    for camera, turn, shift in zip(found.cameras, (np.eye(3), TURN), (np.zeros(3), SHIFT)):
        np.testing.assert_allclose(camera.project(POINTS), projected(coefficients, cv2.Rodrigues(turn)[0], shift), atol=1e-8)
    save_rig(tmp_path / "rig.yaml", found)
    np.testing.assert_array_equal(load_rig(tmp_path / "rig.yaml").project(POINTS), found.project(POINTS))


def test_size_and_unit_may_be_given_and_extrinsics_lie_beside(tmp_path):
    stereo(tmp_path / "whole.yml", size=False)
    check_refused("--image-size", load_rig, tmp_path / "whole.yml")
    intrinsics, _, extrinsics = (tmp_path / "whole.yml").read_text().partition("R: ")
    (tmp_path / "intrinsics.yml").write_text(intrinsics)
    (tmp_path / "extrinsics.yml").write_text(f"{intrinsics.partition('---')[0]}---\nR: {extrinsics}")
    for unit, mm in (("m", 1000), (37.5, 37.5)):
        found = load_rig(tmp_path / "intrinsics.yml", RigReading(unit=unit, size=SIZE))
        np.testing.assert_allclose(found.cameras[1].translation, mm * SHIFT)
        assert (found.cameras[0].width, found.cameras[0].height) == SIZE
    check_refused("unit", RigReading, unit=0.0)


@pytest.mark.parametrize("kind", ["!!opencv-matrix", ""])
def test_one_camera_of_opencv_or_ros(tmp_path, kind):
    def entry(name: str, rows: int, numbers) -> str:
        size = f"   rows: {rows}\n   cols: {len(numbers) // rows}\n"
        return f"{name}: {kind}\n{size}   dt: d\n   data: {list(map(float, numbers))}\n"

    text = "%YAML:1.0\n---\nimage_width: 640\nimage_height: 480\n" + entry("camera_matrix", 3, MATRIX.ravel()) + entry(
        "distortion_coefficients", 5, (0.1, -0.02, 1e-3, 0.0, 0.01))
    (tmp_path / "camera.yml").write_text(text if kind else text.partition("---")[2].replace("   dt: d\n", ""))
    (camera,) = load_rig(tmp_path / "camera.yml").cameras
    np.testing.assert_allclose(camera.project(POINTS), projected((0.1, -0.02, 1e-3, 0.0, 0.01)), atol=1e-8)
    (tmp_path / "bad.yml").write_text(text.replace("rows: 3", "rows: 4"))
    check_refused("camera_matrix|K|matrix", load_rig, tmp_path / "bad.yml")


FISHEYE = (0.02, 0.01, -0.003, 0.0005)


def test_fisheye_lenses(tmp_path):
    stereo(tmp_path / "fish.yml", coefficients=FISHEYE)
    camera = load_rig(tmp_path / "fish.yml", RigReading(lens="fisheye")).cameras[0]
    rays = np.random.default_rng(2).normal(size=(4000, 3))
    rays[:, 2] = np.abs(rays[:, 2]) + 0.12 * np.linalg.norm(rays[:, :2], axis=1)
    wanted = cv2.fisheye.projectPoints(rays[None], np.zeros(3), np.zeros(3), MATRIX, np.array(FISHEYE))[0][0]
    inside = ((wanted >= 0) & (wanted < SIZE)).all(axis=1)
    assert inside.sum() > 1000 and np.abs(camera.project(rays) - wanted)[inside].max() < 0.3
    check_refused("fisheye", rational_of_fisheye, "rig", "dist", MATRIX, np.arange(5.0), *SIZE)


LENSES = {
    "SIMPLE_PINHOLE": ("610 633.5 471.5", ()), "PINHOLE": ("610 612 633.5 471.5", ()),
    "SIMPLE_RADIAL": ("610 633.5 471.5 -0.1", (-0.1, 0, 0, 0)), "RADIAL": ("610 633.5 471.5 -0.1 0.02", (-0.1, 0.02, 0, 0)),
    "OPENCV": ("610 612 633.5 471.5 -0.1 0.02 1e-3 -2e-3", (-0.1, 0.02, 1e-3, -2e-3)),
    "FULL_OPENCV": ("610 612 633.5 471.5 -0.1 0.02 1e-3 0 .01 .02 -.01 .001", (-0.1, 0.02, 1e-3, 0, 0.01, 0.02, -0.01, 1e-3)),
    "OPENCV_FISHEYE": ("610 612 633.5 471.5 .02 .01 -.003 .0005", FISHEYE)}


def colmap(folder, model: str) -> None:
    (folder / "cameras.txt").write_text(f"# cameras\n1 {model} 1280 960 {LENSES[model][0]}\n")
    w, (x, y, z) = np.cos(0.1), np.sin(0.1) * np.array([0.6, 0.8, 0])
    (folder / "images.txt").write_text(f"# images\n1 1 0 0 0 0 0 0 1 left.png\n\n"
                                       f"2 {w} {x} {y} {z} -60 3 5 1 right view.png\n1.5 2.5 7 3 4 -1\n")


@pytest.mark.parametrize("model", LENSES)
def test_colmap_s_text(tmp_path, model):
    colmap(tmp_path, model)
    found = load_rig(tmp_path)
    assert found.names == ("left", "right view") == load_rig(tmp_path / "images.txt").names
    matrix = MATRIX.copy()
    if LENSES[model][0].startswith("610 633"):
        matrix[1, 1] = 610
    lens, atol = (cv2.fisheye, 0.2) if model.endswith("FISHEYE") else (cv2, 1e-8)
    wanted = projected(LENSES[model][1], 0.2 * np.array([0.6, 0.8, 0]), SHIFT, matrix, lens)
    np.testing.assert_allclose(found.cameras[1].project(POINTS), wanted, atol=atol)


@pytest.mark.parametrize("file, old, new", [
    ("cameras.txt", "OPENCV", "THIN_PRISM"), ("cameras.txt", "610", "nan"), ("cameras.txt", "1280", "1e9"),
    ("cameras.txt", " -2e-3", ""), ("cameras.txt", "1280 960 610 612 633", ""), ("images.txt", " -60", " inf"),
    ("images.txt", " 1 left.png", " 7 left.png"), ("images.txt", "1 1 0 0 0", "1 0 0 0 0"),
    ("images.txt", "left", "right view"), ("cameras.txt", "1 OPENCV", "1 OPENCV\0\0"), ("images.txt", " 0 0 0 1 left.png", "")])
def test_damaged_models_are_refused_in_one_line(tmp_path, file, old, new):
    colmap(tmp_path, "OPENCV")
    text = (tmp_path / file).read_text()
    assert old in text
    (tmp_path / file).write_text(text.replace(old, new, 1))
    check_refused(": ", load_rig, tmp_path)


@pytest.mark.parametrize("spoil", [
    lambda text: text.replace("R: ", "Q: "), lambda text: text.replace("K2", "L2"), lambda text: text.replace("610.", "-610."),
    lambda text: text.replace("image_width: 1280", "image_width: [1, 2]"), lambda text: text[: len(text) // 2],
    lambda text: text.replace("D1: ", "D1: 3\nE: "), lambda text: "[]",
    lambda text: text.replace("cols: 5", "cols: 500000000")])
def test_damaged_stereo_files_are_refused_in_one_line(tmp_path, spoil):
    stereo(tmp_path / "stereo.yml")
    (tmp_path / "stereo.yml").write_text(spoil((tmp_path / "stereo.yml").read_text()))
    check_refused(": ", load_rig, tmp_path / "stereo.yml")


FLIP = np.diag([1.0, -1, -1])
MEANT = {
    "opencv": lambda c: (c.rotation, c.translation), "opengl": lambda c: (FLIP @ c.rotation, FLIP @ c.translation),
    "opencv-to-world": lambda c: (c.rotation.T, c.centre), "opengl-to-world": lambda c: (c.rotation.T @ FLIP, c.centre),
    "opencv-centre": lambda c: (c.rotation, c.centre)}


@pytest.mark.parametrize("unit", ["mm", "m"])
@pytest.mark.parametrize("poses", POSES)
def test_other_poses_and_units_are_read_and_recognised(tmp_path, poses, unit):
    meant = [(camera, *MEANT[poses](camera)) for camera in around().cameras]
    save_rig(tmp_path / "rig.yaml", Rig(tuple(
        replace(camera, rotation=turn, translation=shift / (1000 if unit == "m" else 1)) for camera, turn, shift in meant)))
    seen = np.array([[20.0, 10, 0], [25, 12, 3], [-20, 8, -4], [2, -15, 9]])
    found = load_rig(tmp_path / "rig.yaml", RigReading(unit, poses))
    np.testing.assert_allclose(found.project(seen), around().project(seen), atol=1e-8)
    found.check_sight(seen, "the seed")
    doubtful = load_rig(tmp_path / "rig.yaml")
    if (poses, unit) == ("opencv", "mm"):
        return doubtful.check_sight(seen, "the seed")
    check_refused("--rig-unit m" if poses == "opencv" else f"--rig-poses {poses}", doubtful.check_sight, seen, "the seed")


def test_a_rig_some_metres_away_has_no_reading_in_metres():
    """Which would put its cameras kilometres away: the other readings are tried all the same."""
    near = replace(around(), reading=RigReading(None, None))
    far = replace(near, cameras=tuple(replace(camera, translation=camera.translation + [0, 0, 2e3]) for camera in near.cameras))
    assert {rig.reading.unit for rig, *_ in near.read_otherwise()} == {None, "m"}
    assert {rig.reading.unit for rig, *_ in far.read_otherwise()} == {None}
