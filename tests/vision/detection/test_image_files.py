"""Images as cameras and editors store them: depths, orientation tags, alpha channels, masks beside them."""

import struct

import cv2
import numpy as np
import pytest

from doo_ti import Camera, DetectionOptions, InputError
from doo_ti.vision.detection.detect import Sight
from doo_ti.vision.detection.images import orientation_tags, read_image, read_mask


def picture() -> np.ndarray:
    """(60, 80) uint8 with a dark line and a light border at its left."""
    image = np.full((60, 80), 180, np.uint8)
    image[:, :5] = 255
    image[28:33] = 40
    return image


def camera(turned: bool = False) -> Camera:
    return Camera("cam0", 80, 60, np.diag([100.0, 100, 1]), np.zeros(5), np.eye(3), np.zeros(3), turned=turned)


def tagged(path, image: np.ndarray, tag: int) -> None:
    """A JPEG file with an orientation tag."""
    content = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 100])[1].tobytes()
    exif = b"Exif\0\0" + b"II*\0" + struct.pack("<IHHHIHHI", 8, 1, 274, 3, 1, tag, 0, 0)
    path.write_bytes(content[:2] + b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif + content[2:])


@pytest.mark.parametrize("suffix", [".png", ".tiff"])
@pytest.mark.parametrize("bits", [8, 10, 12, 14, 16])
def test_images_of_any_depth(tmp_path, suffix, bits):
    most = 2**bits - 1
    deep = np.round(picture() * (most / 255)).astype(np.uint16)
    cv2.imwrite(str(tmp_path / f"deep{suffix}"), deep if bits > 8 else deep.astype(np.uint8))
    found = read_image(tmp_path / f"deep{suffix}", camera())
    assert found.dtype == np.uint8 and np.abs(found.astype(int) - picture()).max() <= 1


def test_fractions(tmp_path):
    values = (picture() / 255).astype(np.float32)
    values[0, 0] = np.nan
    cv2.imwrite(str(tmp_path / "fractions.tiff"), values)
    assert np.abs(read_image(tmp_path / "fractions.tiff").astype(int) - picture())[1:].max() <= 1


@pytest.mark.parametrize("tag", range(1, 9))
def test_tags_are_ignored_unless_the_rig_says_otherwise(tmp_path, tag):
    tagged(tmp_path / "image.jpg", picture(), tag)
    assert np.abs(read_image(tmp_path / "image.jpg", camera()).astype(int) - picture()).max() < 12
    assert orientation_tags([tmp_path / "image.jpg"]) == (tag > 1)
    turned = read_image(tmp_path / "image.jpg", turned=True)
    assert turned.shape == ((80, 60) if tag > 4 else (60, 80))
    if tag > 4:
        with pytest.raises(InputError, match="size"):
            read_image(tmp_path / "image.jpg", camera(turned=True))
    if tag in (2, 3):
        assert read_image(tmp_path / "image.jpg", camera(turned=True))[0, -1] > 240


def test_alpha_channels_and_masks(tmp_path):
    alpha = np.where(picture() < 100, 255, 0).astype(np.uint8)
    cv2.imwrite(str(tmp_path / "cut.png"), np.dstack([picture()] * 3 + [alpha]))
    cv2.imwrite(str(tmp_path / "opaque.png"), np.dstack([picture()] * 3 + [np.full_like(alpha, 255)]))
    cv2.imwrite(str(tmp_path / "plain.png"), picture())
    (tmp_path / "masks").mkdir()
    cv2.imwrite(str(tmp_path / "masks" / "plain.png"), alpha // 255)
    np.testing.assert_array_equal(read_mask(tmp_path / "cut.png"), alpha)
    assert read_mask(tmp_path / "opaque.png") is None and read_mask(tmp_path / "plain.png") is None
    for name, sight, method in (
            ("cut.png", Sight(), "mask"), ("plain.png", Sight(), "ridge"),
            ("plain.png", Sight(masks=tmp_path / "masks"), "mask"),
            ("plain.png", Sight(masks={tmp_path / "plain.png": tmp_path / "cut.png"}), "mask"),
            ("plain.png", Sight(DetectionOptions(colour=(40, 40, 40)), {"cam0": (10, 10, 60, 40)}), "ridge")):
        found = sight.detected(tmp_path / name, camera())
        assert found.method == method and found.count > 50
        np.testing.assert_allclose(np.median(found.points[:, 1]), 30, atol=0.2)
        assert found.width_px == pytest.approx(5, abs=1.5)
    with pytest.raises(InputError, match="opaque"):
        Sight(masks=tmp_path / "masks").detected(tmp_path / "opaque.png", camera())
