"""Endless files, and files that unpack to huge sizes: refused before they fill the memory."""

import io
import os
import struct
import zipfile

import cv2
import numpy as np
import pyarrow
import pyarrow.parquet
import pytest

from doo_ti import InputError, Observations, load_observations, load_obstacles, load_path, load_rig, save_observations
from doo_ti.commands.refine import read_groups
from doo_ti.dynamics.scene import load_motion_scene
from doo_ti.io import arrays
from doo_ti.io.arrays import read_arrays
from doo_ti.io.scene import load_scene
from doo_ti.learning.pairs import load_pairs
from doo_ti.system.files import read_content
from doo_ti.vision.cameras.board import read_views
from doo_ti.vision.detection.images import load_sets, read_image, stated_size
from doo_ti.vision.reprojection.marks import read_labels, read_marks
from tests.io.test_formats import MARKS

SEEN = Observations(MARKS)
READERS = {
    ".npz": load_observations, ".csv": load_observations, ".parquet": load_observations, ".yaml": load_rig, ".png": read_image,
    "_sets.csv": lambda path: load_sets(path, None), "_views.csv": read_views,
    "_arrays.csv": lambda path: read_arrays(path, {"a": ((), ("a",))}),
    "_pairs.csv": lambda path: load_pairs(path, SEEN), "_labels.csv": lambda path: read_labels(path, ("a",)),
    "_marks.csv": lambda path: read_marks(path, None),
    ".toml": load_scene, "_motion.toml": load_motion_scene, "_obstacles.toml": load_obstacles, "_path.csv": load_path,
    "_groups.npz": lambda path: read_groups(f"{path}:key", SEEN),
}


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no pipes in folders")
@pytest.mark.parametrize("suffix", READERS)
def test_pipes_and_devices_are_no_files(tmp_path, suffix):
    os.mkfifo(tmp_path / f"pipe{suffix}")
    (tmp_path / f"zero{suffix}").symlink_to("/dev/zero")
    for name, problem in (("pipe", "not a file"), ("zero", "not a file"), ("none", "no such file")):
        with pytest.raises(InputError, match=problem) as caught:
            READERS[suffix](tmp_path / f"{name}{suffix}")
        assert name in caught.value.source


def test_a_file_beyond_its_bound_is_not_read(tmp_path):
    with open(tmp_path / "large", "wb") as file:
        file.truncate(1 << 40)
    with pytest.raises(InputError, match="at most"):
        read_content(tmp_path / "large")


def test_an_npz_that_unpacks_to_more_than_the_bound(tmp_path, monkeypatch):
    """Zeros, a thousand times as many bytes as the file has."""
    monkeypatch.setattr(arrays, "MOST_UNPACKED_BYTES", 1 << 20)
    save_observations(tmp_path / "bomb.npz", SEEN)
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (1 << 18, 8)})
    with zipfile.ZipFile(tmp_path / "bomb.npz", "a", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("sigma_mm.npy", header.getvalue() + bytes(1 << 24))
    with pytest.raises(InputError, match="unpacks to"):
        load_observations(tmp_path / "bomb.npz")


def test_a_table_that_unpacks_to_more_than_the_bound(tmp_path, monkeypatch):
    save_observations(tmp_path / "small.parquet", SEEN)
    monkeypatch.setattr(arrays, "MOST_UNPACKED_BYTES", 1000)
    with pytest.raises(InputError, match="unpacks to"):
        load_observations(tmp_path / "small.parquet")


@pytest.mark.parametrize("size", [(100_000, 1), (1, 100_000)])
def test_images_longer_than_any_camera_takes(tmp_path, size):
    for name, shape in (("long.png", size), ("good.png", (20, 30))):
        (tmp_path / name).write_bytes(cv2.imencode(".png", np.zeros(shape, dtype=np.uint8))[1].tobytes())
    with pytest.raises(InputError, match="size"):
        read_image(tmp_path / "long.png")
    assert read_image(tmp_path / "good.png").shape == (20, 30)


@pytest.mark.parametrize("suffix", ["jpg", "tiff", "png", "bmp", "ppm"])
def test_the_size_that_an_image_states_is_known_before_it_is_unpacked(tmp_path, suffix):
    content = cv2.imencode(f".{suffix}", np.zeros((20, 30, 3), dtype=np.uint8))[1].tobytes()
    assert sorted(stated_size(content)) == [20, 30]
    for short in range(0, len(content), 7):
        assert len(stated_size(content[:short])) in (0, 1, 2)
    if suffix == "jpg":
        at = content.index(b"\xff\xc0") + 5
        (tmp_path / "huge.jpg").write_bytes(content[:at] + struct.pack(">HH", 60_000, 60_000) + content[at + 4 :])
        with pytest.raises(InputError, match="60000 x 60000"):
            read_image(tmp_path / "huge.jpg")


def test_a_parquet_of_cells_is_no_table_of_observations(tmp_path):
    pyarrow.parquet.write_table(pyarrow.table({"observation": [0]}), tmp_path / "o.parquet")
    with pytest.raises(InputError, match="vertex"):
        load_observations(tmp_path / "o.parquet")
