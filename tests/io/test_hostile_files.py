"""Small files that would cost much, pipes and devices: each is read or refused in one line, in bounded memory."""

import io
import multiprocessing
import os
import struct
import time
import zipfile
import zlib
from pathlib import Path

import cv2
import numpy as np
import pyarrow
import pyarrow.parquet
import pytest

from doo_ti import InputError, Observations, load_observations, save_observations
from doo_ti.io import arrays
from doo_ti.io.observation_files import read_recording
from doo_ti.system.files import read_content
from doo_ti.vision.images import _stated, load_sets, read_image
from tests.conftest import check_refused
from tests.io.test_formats import MARKS
from tests.processes import ROOT

resource = pytest.importorskip("resource", reason="the memory of a process is limited on Unix only")
MOST_BYTES, MOST_ADDRESSES, MOST_SECONDS = 1 << 30, 8 << 30, 300
MOST_SECONDS_EACH = 10.0


def npz(shape: str, content: bytes = bytes(192), method: int = zipfile.ZIP_STORED) -> bytes:
    header = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}}}".ljust(117) + "\n"
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", method) as archive:
        archive.writestr("vertices_mm.npy", b"\x93NUMPY\1\0" + struct.pack("<H", len(header)) + header.encode() + content)
    return file.getvalue()


def parquet(rows: int) -> bytes:
    """Points that are all alike, any number of which take no space."""
    file = io.BytesIO()
    pyarrow.parquet.write_table(pyarrow.table(dict.fromkeys("xyz", np.ones(rows))), file, compression="zstd",
                                row_group_size=rows, data_page_size=1 << 30, max_rows_per_page=rows)
    return file.getvalue()


def scene(**changed) -> str:
    keys = {"rate_hz": "10.0", "duration_s": "1.0", "rod": "{ length_mm = 100.0, edges = 20 }", "obstacles": "[]",
            "materials": "{ a = { bend = 1e5 } }", "moments": "[]"} | changed
    return "\n".join(f"{key} = {value}" for key, value in keys.items() if value)


SPHERES = "[" + ", ".join(['{ kind = "sphere", centre = [0, 0, 0], radius = 1.0, moments = [{ time_s = 0.0 }] }'] * 80) + "]"
RODS = "{" + ", ".join(f"r{n} = {{ edges = 4, length_mm = 9.0 }}" for n in range(200)) + "}"
LONG = '<composite type="cable" prefix="{}" count="100000"/>'
MODEL = "<mujoco><worldbody>{}</worldbody></mujoco>"
ENTITIES = "".join(f'<!ENTITY a{n} "{f"&a{n - 1};" * 9}">' for n in range(1, 10))
HEAVY = b"ply\nformat binary_little_endian 1.0\nelement vertex 2000000000\nproperty float x\nelement face 2000000000\n" \
        b"property list uint int vertex_indices\nend_header\n"
THIN = "{ length_mm = 9.0, edges = 4, radius_mm = 1.0 }"


def small() -> dict[str, bytes]:
    large, times = bytes(60_000_000), "[" + ", ".join(f"{{ time_s = {n}.0 }}" for n in range(90)) + "]"
    texts = {
        "wide.csv": ",".join(f"c{n}" for n in range(2000)) + "\n", "keys.toml": "a." * 4000 + "a = 1",
        "sparse.csv": "observation,vertex,x,y,z\n" + "".join(f"{n},{9 ** (n % 15)},0,0,{n}\n" for n in range(500)),
        "sparse_marks.csv": "observation,camera,mark,u_px,v_px\n" + "".join(f"{n},left,{n},1,1\n" for n in range(600)),
        "cables.xml": MODEL.format("".join(LONG.format(n) for n in range(180))), "deep.xml": "<mujoco>" + "<body>" * 1600,
        "deep_bodies.xml": MODEL.format("<body>" * 700 + LONG.format(1) + "</body>" * 700), "lines.txt": "1 2 3\n\n" * 1400,
        "deep.toml": "a = " + "[" * 9000, "deep.json": "[" * 9000, "deep.yaml": "a: " + "[" * 9000,
        "digits.json": '{"bend_mm3": ' + "9" * 9000 + "}", "points.obj": "v 0 0 0\nv 1 0 0\nv 0 1 0\n",
        "index.obj": "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 2000000000\n", "frames.toml": scene(duration_s="100000.0"),
        "moving.toml": scene(duration_s="100000.0", obstacles=SPHERES, rod=THIN),
        "group.toml": scene(duration_s="9999.0", rod="", moments="", obstacles="", rods=RODS),
        "between.toml": "between = 100000\n" + scene(rate_hz="", duration_s="", obstacles=SPHERES, rod=THIN, moments=times,
                                                     materials="{ a = { bend = 1e5, twist = 1e5 } }")}
    return {name: text.encode() for name, text in texts.items()} | {
        "shape.npz": npz("(3000000000, 4, 3)"), "bzip2.npz": npz("(625000, 4, 3)", large, zipfile.ZIP_BZIP2),
        "lzma.npz": npz("(625000, 4, 3)", large, zipfile.ZIP_LZMA), "rows.parquet": parquet(10_000_000),
        "damaged.stl": b"solid \xe9\xff" + bytes(range(256)),
        "entities.xml": f'<!DOCTYPE m [<!ENTITY a0 "{"x" * 900}">{ENTITIES}]><mujoco>&a9;</mujoco>'.encode("utf-16"),
        "count.stl": bytes(80) + b"\xff" * 4 + bytes(50), "elements.ply": HEAVY + b"\xff" * 40,
        "charset.obj": b"v 0 0 \xff\xfe\x81\n", "points.xyz": b"1 2 3\n\n" * 1400, **images()}


def images() -> dict[str, bytes]:
    """Images whose few bytes state many pixels, of every format that OpenCV knows, some under another one's name."""
    size, most = 30_000, 9_900

    def png(width: int, height: int) -> bytes:
        parts = (b"IHDR" + struct.pack(">IIBBBBB", width, height, 16, 6, 0, 0, 0),
                 b"IDAT" + zlib.compress(bytes(9_000_000))[:9000], b"IEND")
        return b"\x89PNG\r\n\x1a\n" + b"".join(
            struct.pack(">I", len(part) - 4) + part + struct.pack(">I", zlib.crc32(part)) for part in parts)

    def bmp(side: int) -> bytes:
        return b"BM" + struct.pack("<IHHI", 1080, 0, 0, 1078) + struct.pack(
            "<IiiHHIIiiII", 40, side, side, 1, 8, 1, 4, 0, 0, 256, 0) + bytes(1024) + b"\0\1"
    gif = b"GIF89a" + struct.pack("<HHBBB", size, size, 0x80, 0, 0) + bytes(6) + b"\x2c" + struct.pack(
        "<HHHHB", 0, 0, size, size, 0) + b"\x02\x02\x44\x01\x00\x3b"
    tags = ((256, 4, most), (257, 4, most), (258, 3, 8), (259, 3, 8), (262, 3, 1), (273, 4, 8), (277, 3, 1), (278, 4, most),
            (279, 4, 9))
    tiff = struct.pack("<2sHIH", b"II", 42, 8, len(tags)) + b"".join(
        struct.pack("<HHII", tag, kind, 1, value) for tag, kind, value in tags) + bytes(4)
    radiance = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y %d +X %d\n" % (size, size)
    return {"large.png": png(size, size), "most.png": png(most, most), "gif.png": gif, "large.gif": gif, "large.bmp": bmp(size),
            "most.bmp": bmp(most), "most.tif": tiff, "sunk.ras": struct.pack(">8I", 0x59A66A95, size, size, 8, 0, 2, 0, 0),
            "large.pgm": b"P5 %d %d 255\n" % (size, size), "most.pgm": b"P2\n# a\n%d %d\n255\n0 0" % (most, most),
            "most.pfm": b"Pf\n%d %d\n-1.0\n" % (most, most), "large.hdr": radiance}


def readers() -> dict[str, list]:
    from doo_ti.commands.loading import read_rest_length
    from doo_ti.commands.track import load_frames
    from doo_ti.contact.distance_grid import DistanceGrid
    from doo_ti.contact.obstacle_file import load_obstacles
    from doo_ti.dynamics.scene import load_motion_scene
    from doo_ti.dynamics.theta import load_theta
    from doo_ti.groups.scene import load_group_scene
    from doo_ti.io.motion_file import load_path
    from doo_ti.io.scene import load_scene
    from doo_ti.learning.chunks import read_columns, read_table
    from doo_ti.learning.terms import load_pairs
    from doo_ti.perception.twist_curves import load_offsets
    from doo_ti.vision.board import read_views
    from doo_ti.vision.marks import read_labels, read_marks
    from doo_ti.vision.rig_files import load_rig

    def read_motion_scene(path):
        found = load_motion_scene(path)
        assert found.path.count and found.surroundings(found.between) is not None
    rig, seen = load_rig(ROOT / "scenes/rig.yaml"), Observations(MARKS, rest_length=np.ones(3))
    curves = [load_observations, lambda path: read_recording(path, rate=10.0)]
    mesh = [lambda path: DistanceGrid.from_mesh(path, 3.0)]
    return {
        ".csv": [*curves, load_path, lambda path: read_marks(path, rig), lambda path: read_labels(path, ("a",)), read_views,
                 lambda path: load_sets(path, rig), lambda path: load_frames(path, rig), lambda path: load_pairs(path, seen),
                 lambda path: load_offsets(path, seen)],
        ".npz": [*curves, load_path, lambda path: read_rest_length(str(path)), lambda path: load_offsets(path, seen)],
        **dict.fromkeys((".png", ".jpg", ".gif", ".bmp", ".tif", ".ras", ".pgm", ".pfm", ".hdr"), [read_image]),
        ".json": [load_theta, read_table], ".yaml": [load_rig],
        ".toml": [load_scene, read_motion_scene, load_group_scene, load_obstacles],
        ".stl": mesh, ".ply": mesh, ".obj": mesh, ".xml": curves,
        ".parquet": [*curves, lambda path: read_columns(path, ["x"])], ".xyz": curves,
        ".txt": [*curves, lambda path: read_rest_length(str(path))]}


def read_all(folder: Path, answers) -> None:
    by_suffix = readers()
    most = MOST_ADDRESSES + resource.getpagesize() * int(Path("/proc/self/statm").read_text().split()[0])
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    resource.setrlimit(resource.RLIMIT_CPU, (MOST_SECONDS, MOST_SECONDS))
    wrong, before = [], resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for path in sorted(folder.iterdir()):
        for number, read in enumerate(by_suffix[path.suffix]):
            began = time.process_time()
            try:
                read(path)
            except InputError as error:
                if "\n" in str(error):
                    wrong.append((path.name, number, str(error)))
            except BaseException as error:
                wrong.append((path.name, number, repr(error)[:300]))
            if (spent := time.process_time() - began) > MOST_SECONDS_EACH:
                wrong.append((path.name, number, f"{spent:.1f} s"))
            most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
            if 1024 * (most - before) > MOST_BYTES:
                wrong.append((path.name, number, f"{most - before} KiB"))
                before = most
    answers.send(wrong)


@pytest.mark.thorough
def test_files_are_read_or_refused_in_bounded_memory(tmp_path):
    pytest.importorskip("trimesh")
    for name, content in small().items():
        assert len(content) <= 20_000, name
        (tmp_path / name).write_bytes(content)
    process = multiprocessing.get_context("spawn")
    answers, theirs = process.Pipe(duplex=False)
    child = process.Process(target=read_all, args=(tmp_path, theirs))
    child.start()
    theirs.close()
    try:
        wrong = answers.recv()
    except EOFError:
        wrong = "the process ended"
    child.join()
    assert not wrong and not child.exitcode


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no pipes in folders")
def test_pipes_and_devices_are_no_files(tmp_path):
    pytest.importorskip("trimesh")
    for suffix, reads in readers().items():
        os.mkfifo(tmp_path / f"pipe{suffix}")
        (tmp_path / f"zero{suffix}").symlink_to("/dev/zero")
        for name, problem in (("pipe", "a device or a pipe"), ("zero", "a device or a pipe"), ("none", "")):
            for read in reads:
                check_refused(f"{name}.*: .*{problem}", read, tmp_path / f"{name}{suffix}")


def test_a_file_beyond_its_bound_is_not_read(tmp_path):
    with open(tmp_path / "large", "wb") as file:
        file.truncate(1 << 40)
    check_refused("at most", read_content, tmp_path / "large")


def test_files_that_unpack_to_more_than_the_bound_are_refused(tmp_path, monkeypatch):
    """An npz of zeros, a thousand times as many bytes as the file has; and a table."""
    monkeypatch.setattr(arrays, "MOST_UNPACKED_BYTES", 1 << 20)
    save_observations(tmp_path / "bomb.npz", Observations(MARKS))
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (1 << 18, 8)})
    with zipfile.ZipFile(tmp_path / "bomb.npz", "a", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("sigma_mm.npy", header.getvalue() + bytes(1 << 24))
    check_refused("unpacks to", load_observations, tmp_path / "bomb.npz")
    save_observations(tmp_path / "small.parquet", Observations(MARKS))
    monkeypatch.setattr(arrays, "MOST_UNPACKED_BYTES", 1000)
    check_refused("unpacks to", load_observations, tmp_path / "small.parquet")


@pytest.mark.parametrize("size", [(100_000, 1), (1, 100_000)])
def test_images_longer_than_any_camera_takes(tmp_path, size):
    for name, shape in (("long.png", size), ("good.png", (20, 30))):
        (tmp_path / name).write_bytes(cv2.imencode(".png", np.zeros(shape, dtype=np.uint8))[1].tobytes())
    check_refused("size", read_image, tmp_path / "long.png")
    assert read_image(tmp_path / "good.png").shape == (20, 30)


@pytest.mark.parametrize("suffix", ["jpg", "tiff", "png", "bmp", "ppm"])
def test_the_size_that_an_image_states_is_known_before_it_is_unpacked(tmp_path, suffix):
    content = cv2.imencode(f".{suffix}", np.zeros((20, 30, 3), dtype=np.uint8))[1].tobytes()
    assert sorted(_stated(content)[0]) == [20, 30]
    for short in range(0, len(content), 7):
        assert len(_stated(content[:short])[0]) in (0, 1, 2)
    if suffix == "jpg":
        at = content.index(b"\xff\xc0") + 5
        (tmp_path / "huge.jpg").write_bytes(content[:at] + struct.pack(">HH", 60_000, 60_000) + content[at + 4 :])
        check_refused("60000 x 60000", read_image, tmp_path / "huge.jpg")
