"""Rig files and the projection through distorted cameras."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from doo_ti import InputError
from doo_ti.vision.rig_files import load_rig, save_rig
from tests.vision.boards import around


def test_projection_is_opencv_s():
    points = np.random.default_rng(1).uniform(-60, 60, size=(5, 7, 3))
    pixels = around().project(points)
    assert pixels.shape == (3, 5, 7, 2)
    for camera, found in zip(around().cameras, pixels, strict=True):
        turn = cv2.Rodrigues(np.array(camera.rotation))[0]
        wanted = cv2.projectPoints(points.reshape(-1, 3), turn, np.array(camera.translation), np.array(camera.matrix),
                                   np.array(camera.distortion))[0]
        np.testing.assert_allclose(found.reshape(-1, 2), wanted.reshape(-1, 2), atol=1e-9)
        np.testing.assert_allclose(camera.rotation @ camera.centre + camera.translation, 0, atol=1e-10)
        behind = camera.centre - 10 * camera.rotation[2]
        assert np.isnan(camera.project(behind)).all() and camera.depth(behind) == pytest.approx(-10)


def test_a_rig_survives_its_file(tmp_path):
    save_rig(tmp_path / "rig.yaml", around())
    again = load_rig(tmp_path / "rig.yaml")
    for first, second in zip(around().cameras, again.cameras, strict=True):
        assert (first.name, first.width, first.height) == (second.name, second.width, second.height)
        for name in ("matrix", "distortion", "rotation", "translation"):
            np.testing.assert_array_equal(getattr(first, name), getattr(second, name))


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
    (lambda text: text.replace("rows: 3", "rows: *x", 1), "not a rig"),
    (lambda text: text + "? [a]\n: b\n", "not a rig"),
    (lambda text: text.replace("width: 640", "width: 100000"), "width"),
    (lambda text: text.replace("width: 640", "width: 100000000000"), "width"),
    (lambda text: text.replace("name: cam1", "name: cam1\n      width: !!python/object/apply:os.getcwd []"), "not a rig"),
    (lambda text: "[" * 100_000, "not a rig"),
])
def test_a_bad_file_is_refused(tmp_path, spoil, word):
    save_rig(tmp_path / "rig.yaml", around())
    text = (tmp_path / "rig.yaml").read_text()
    (tmp_path / "bad.yaml").write_text(spoil(text))
    with pytest.raises(InputError, match=word):
        load_rig(tmp_path / "bad.yaml")


@pytest.mark.parametrize("change", [
    {"rotation": np.diag([1.0, 1, -1])}, {"matrix": np.eye(3) * -1}, {"width": 0}, {"distortion": [1.0, 2]},
    {"translation": [0, 0, np.nan]}, {"translation": [0, 0, 1e300]}, {"distortion": [1e300, 0, 0, 0, 0]},
    {"matrix": [[1e300, 0, 0], [0, 1e300, 0], [0, 0, 1]]}, {"matrix": [[1e-300, 0, 0], [0, 1e-300, 0], [0, 0, 1]]},
    {"matrix": [[1e3, 0, 1e300], [0, 1e3, 0], [0, 0, 1]]}, {"matrix": np.eye(3) + 1j}, {"height": 10**11},
])
def test_invalid_cameras_are_refused(change):
    with pytest.raises(InputError):
        replace(around().cameras[0], **change)


def test_cameras_by_name():
    assert around().only(["cam2", "cam0"]).names == ("cam2", "cam0")
    with pytest.raises(InputError, match="no camera"):
        around().only(["cam7"])
