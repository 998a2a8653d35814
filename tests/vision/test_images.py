"""Images as cameras and editors store them: depths, orientation tags, alpha channels, damage; and lists of them, SETS.csv."""

import os
import struct
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from doo_ti import Camera, DetectionOptions, InputError, Rig
from doo_ti.vision.images import ImageSets, load_sets, orientation_tags, read_image, read_mask
from doo_ti.vision.sight import Sight, mask_of
from tests.conftest import check_refused
from tests.vision.boards import around
from tests.vision.test_follow import SIZE, beside, drawn, shares, wave

PICTURE = np.full((60, 80), 180, np.uint8)
PICTURE[:, :5] = 255  # a light border at its left
PICTURE[28:33] = 40  # and a dark line


def camera(turned: bool = False) -> Camera:
    return Camera("cam0", 80, 60, np.diag([100.0, 100, 1]), np.zeros(5), np.eye(3), np.zeros(3), turned=turned)


def tagged(path, image: np.ndarray, tag: int) -> None:
    content = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 100])[1].tobytes()
    exif = b"Exif\0\0" + b"II*\0" + struct.pack("<IHHHIHHI", 8, 1, 274, 3, 1, tag, 0, 0)
    path.write_bytes(content[:2] + b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif + content[2:])


@pytest.mark.parametrize("suffix, bits", [(suffix, bits) for suffix in ("png", "tiff") for bits in (8, 10, 12, 14, 16)] + [
    ("tiff", "fractions")])
def test_images_of_any_depth(tmp_path, suffix, bits):
    if bits == "fractions":
        deep = (PICTURE / 255).astype(np.float32)
        deep[0, 0] = np.nan
    else:
        deep = np.round(PICTURE * ((2**bits - 1) / 255)).astype(np.uint16 if bits > 8 else np.uint8)
    cv2.imwrite(str(tmp_path / f"deep.{suffix}"), deep)
    found = read_image(tmp_path / f"deep.{suffix}", camera())
    assert found.dtype == np.uint8 and np.abs(found.astype(int) - PICTURE)[np.isfinite(deep)].max() <= 1


@pytest.mark.parametrize("tag", range(1, 9))
def test_tags_are_ignored_unless_the_rig_says_otherwise(tmp_path, tag):
    path = tmp_path / "image.jpg"
    tagged(path, PICTURE, tag)
    assert np.abs(read_image(path, camera()).astype(int) - PICTURE).max() < 12
    assert orientation_tags([path]) == (tag > 1)
    assert read_image(path, turned=True).shape == ((80, 60) if tag > 4 else (60, 80))
    if tag > 4:
        check_refused("size", read_image, path, camera(turned=True))
    if tag in (2, 3):
        assert read_image(path, camera(turned=True))[0, -1] > 240


def test_alpha_channels_and_masks(tmp_path):
    alpha = np.where(PICTURE < 100, 255, 0).astype(np.uint8)
    (tmp_path / "masks").mkdir()
    for name, image in (("cut", np.dstack([PICTURE] * 3 + [alpha])), ("plain", PICTURE), ("masks/plain", alpha // 255),
                        ("opaque", np.dstack([PICTURE] * 3 + [np.full_like(alpha, 255)]))):
        cv2.imwrite(str(tmp_path / f"{name}.png"), image)
    np.testing.assert_array_equal(read_mask(tmp_path / "cut.png"), alpha)
    assert read_mask(tmp_path / "opaque.png") is None and read_mask(tmp_path / "plain.png") is None
    for name, sight, method in (
            ("cut.png", Sight(), "mask"), ("plain.png", Sight(), "ridge"),
            ("plain.png", Sight(masks=tmp_path / "masks"), "mask"),
            ("plain.png", Sight(masks={camera().name: tmp_path / "cut.png"}), "mask"),
            ("plain.png", Sight(DetectionOptions(colour=(40, 40, 40)), {"cam0": (10, 10, 60, 40)}), "colour")):
        found = sight.detected(tmp_path / name, camera())
        assert found.method == method and found.count > 50
        np.testing.assert_allclose(np.median(found.points[:, 1]), 30, atol=0.2)
        assert found.width_px == pytest.approx(5, abs=1.5)
    check_refused("opaque", Sight(masks=tmp_path / "masks").detected, tmp_path / "opaque.png", camera())


def test_a_thread_that_turns_from_lighter_to_darker_is_followed_on(tmp_path):
    path, camera = of_lines(tmp_path, (320, 120), 110, ((20, 60), (160, 60), [200] * 3, 7), ((160, 60), (300, 60), [40] * 3, 7))
    light = Sight(DetectionOptions(polarity="light")).detected(path, camera)
    assert light.points[:, 0].max() < 170 and np.ptp(Sight().with_opposite([light], [path], [camera])[0].points[:, 0]) > 270


def of_lines(folder, size: tuple[int, int], background: int, *lines):
    """(the path of an image of this size with lines (from, to, colour, width), the camera that took it)."""
    image = np.full((*size[::-1], 3), background, dtype=np.uint8)
    for line in lines:
        cv2.line(image, *line, cv2.LINE_AA)
    cv2.imwrite(str(folder / "lines.png"), image)
    return folder / "lines.png", replace(camera(), width=size[0], height=size[1])


def test_a_thread_that_is_clicked_is_detected_beside_a_more_distinct_one(tmp_path):
    path, seen = of_lines(tmp_path, (240, 160), 60, ((10, 40), (230, 40), (230, 230, 230), 25),
                          ((10, 120), (230, 130), (110, 100, 100), 5))
    for row, sight in ((40, Sight()), (125, Sight(clicks=({0: (120.0, 125.0)},)).of_set(0, [path], [seen])[0])):
        found = sight.detected(path, seen)
        assert found.count > 150 and np.abs(found.points[:, 1] - row).max() < 8


def test_a_thread_is_sought_by_its_colour_where_it_was_clicked(tmp_path):
    """Not another one, more distinct, that crosses it; and in later sets of which no pixel is known."""
    path, seen = of_lines(tmp_path, (160, 120), 230, ((10, 60), (150, 70), (60, 60, 200), 4),
                          ((70, 5), (90, 115), (20, 20, 20), 4))
    sight = Sight(clicks=({0: (40.0, 62.0)}, {}), by_colour=True)
    for row in range(2):
        sight, _ = sight.of_set(row, [path], [seen])
        found = sight.detected(path, seen)
        assert found.count > 100 and np.abs(found.points[:, 1] - 60 - (found.points[:, 0] - 10) / 14).max() < 4
    of_lines(tmp_path, (160, 120), 230)
    check_refused("pixel: no thread", Sight(clicks=({0: (20.0, 20.0)},), by_colour=True).of_set, 0, [path], [seen])


@pytest.mark.sampled(1)
@pytest.mark.parametrize("gripper", [True, False])
def test_a_clicked_thread_is_sought_by_what_shows_it_best(tmp_path, gripper):
    """A glossy blue thread on red ground, whose grey is that of the ground: the highlight along it is more distinct, and that
    of the gripper that holds it."""
    curve = wave()
    strokes = [(curve, (190, 80, 25), 9), (beside(curve, 2.0)[200:1400], (230, 190, 170), 1)]
    if gripper:
        strokes.append((np.array([[15.0, 200.0], [64.0, 200.0]]), (250, 250, 250), 8))
    path, plain = tmp_path / "a.png", Sight(clicks=({0: tuple(curve[30])},))
    cv2.imwrite(str(path), drawn(*strokes, ground=(50, 50, 140)))
    seen = replace(camera(), width=SIZE[1], height=SIZE[0])
    chosen, known = plain.of_set(0, [path], [seen])
    assert shares(plain.detected(path, seen).points, curve)[0] < 0.9
    found = chosen.detected(path, seen).points
    np.testing.assert_array_equal(known[0].points, found)
    assert chosen.options.colour is not None and min(shares(found, curve)) > 0.95


def test_a_thread_is_dark_or_light_in_all_images_of_a_set(tmp_path):
    paths = []
    for number, level in enumerate((150, 255)):
        (tmp_path / str(number)).mkdir()
        path, seen = of_lines(tmp_path / str(number), (240, 160), 130, ((10, 40), (230, 40), (60, 60, 60), 5),
                              ((10, 120), (230, 130), (level,) * 3, 9))
        paths.append(path)
    found = [Sight().detected(path, seen) for path in paths]
    assert [one.polarity for one in found] == ["dark", "light"]
    for clicks, row in ((None, 125), (({0: (120.0, 40.0)},), 40)):
        agreed = Sight(clicks=clicks).agreed(found, 0, paths, [seen, seen])
        assert len({one.polarity for one in agreed}) == 1 and abs(np.median(agreed[1].points[:, 1]) - row) < 8


def test_libraries_say_nothing_of_damaged_images(tmp_path, capfd):
    """Of such as begin and end well, too, and from several threads; afterwards the standard error is heard again."""
    good = cv2.imencode(".png", np.zeros((20, 30), np.uint8))[1].tobytes()
    at = good.index(b"IDAT")
    (length,) = struct.unpack(">I", good[at - 4:at])
    wrong_sum = good[:at + 4 + length] + b"wrng" + good[at + 8 + length:]
    files = {"a.png": good, "sum.png": wrong_sum, "depth.png": good[:24] + b"\x03" + good[25:], "cut.png": good[:-20]}
    for name, content in files.items():
        (tmp_path / name).write_bytes(content)

    def read(name: str) -> bool:
        try:
            return read_image(tmp_path / name).shape == (20, 30)
        except InputError:
            return False

    with ThreadPoolExecutor(4) as threads:
        read_well = dict(zip(files, threads.map(read, [*files] * 20)))
    os.write(2, b"heard")
    assert capfd.readouterr().err == "heard" and read_well["a.png"] and not read_well["cut.png"]


HEADER = "name,cam0,cam2,seed_x,seed_y,seed_z,dir_x,dir_y,dir_z\n"
LINE = "a,a0.png,a2.png,1,2,3,0,3,4\n"
CLICKS = "name,cam0,cam2,cam0_u,cam0_v,cam2_u,cam2_v\n"


def test_a_file_of_sets_whose_rods_begin_at_points_or_pixels(tmp_path):
    (tmp_path / "sets.csv").write_text(HEADER + LINE + LINE.replace("a,", "b,", 1))
    sets = load_sets(tmp_path / "sets.csv", around())
    assert sets.names == ("a", "b") and sets.rig.names == ("cam0", "cam2")
    assert sets.paths[0] == (tmp_path / "a0.png", tmp_path / "a2.png")
    np.testing.assert_allclose(sets.point[0], [1, 2, 3])
    np.testing.assert_allclose(sets.direction[0], [0, 0.6, 0.8])
    (tmp_path / "sets.csv").write_text(CLICKS + "a,a0.png,a2.png,10,20.5,,\nb,b0.png,b2.png,1,2,3,4\nc,c0.png,c2.png,,,5,6\n")
    sets = load_sets(tmp_path / "sets.csv", around())
    assert sets.point is None and sets.direction is None and sets.rig.names == ("cam0", "cam2")
    assert sets.clicks == ({0: (10.0, 20.5)}, {0: (1.0, 2.0), 1: (3.0, 4.0)}, {1: (5.0, 6.0)})
    check_refused("seed pixel: -3,5 is outside the image of cam0", ImageSets, ("one",), ((Path("a.png"),),), Rig((camera(),)),
                  None, None, "sets", ({0: (-3.0, 5.0)},))


@pytest.mark.parametrize("text, word", [
    (HEADER.replace("seed_y", "y") + LINE, "seed_y"), (HEADER.replace("cam2", "cam9") + LINE, "cam9"),
    (HEADER + LINE.replace("1,2,3", "1,x,3"), "seed_y: 'x' in line 2"), (HEADER + LINE + LINE, "twice"),
    (HEADER + LINE.replace("a2.png", ""), "cam2"), (HEADER + LINE.replace("0,3,4", "0,0,0"), "direction"),
    (HEADER + LINE.replace("1,2,3", "1,2,nan"), "finite"), (HEADER + LINE.replace("1,2,3", "0,0,9000"), "behind"),
    (CLICKS + "a,a0.png,a2.png,,,,\n", "cam0_u: '' in line 2"), (CLICKS + "a,a0.png,a2.png,3,,,\n", "cam0_v: '' in line 2"),
    (CLICKS.replace("cam2_u", "cam1_u") + "a,a0.png,a2.png,3,4,5,6\n", "cam1_v|cam2_v"),
    (CLICKS.replace("\n", ",seed_x\n") + "a,a0.png,a2.png,3,4,,,1\n", "seed_x"),
    (CLICKS.replace("cam0_v", "x") + "a,a0.png,a2.png,3,4,,\n", "cam0_v"),
    (CLICKS.replace("cam2_", "cam1_") + "a,a0.png,a2.png,3,4,,\n", "cam1")])
def test_wrong_lists_are_reported(tmp_path, text, word):
    (tmp_path / "sets.csv").write_text(text)
    check_refused(word, load_sets, tmp_path / "sets.csv", around())


def test_masks_of_images_of_the_same_name_lie_in_folders_of_the_same_names(tmp_path):
    masks = tmp_path / "masks"
    for folder in ("left", "right"):
        (masks / folder).mkdir(parents=True)
        (masks / folder / "a[1].png").write_bytes(b"")
    for folder in ("left", "right"):
        assert mask_of(masks, tmp_path / folder / "a[1].jpg") == masks / folder / "a[1].png"
    (masks / "b.left.png").write_bytes(b"")
    check_refused("b: no mask of this name", mask_of, masks, tmp_path / "b.png")


def test_a_jpeg_may_have_fill_bytes(tmp_path):
    content = cv2.imencode(".jpg", PICTURE)[1].tobytes()
    (tmp_path / "filled.jpg").write_bytes(content[:2] + b"\xff\xff" + content[2:])
    assert read_image(tmp_path / "filled.jpg").shape == PICTURE.shape
