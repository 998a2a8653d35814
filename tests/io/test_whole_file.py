"""Files that are complete or absent: the part files beside them while they are written, and after; and all that write so."""

import os
from pathlib import Path

import numpy as np
import pytest

from doo_ti import Observations, relax_group, save_observations
from doo_ti.commands.results import save_arrays, save_json
from doo_ti.record.motions import record_motion
from doo_ti.report.contact import GroupMotion, save_group
from doo_ti.report.motions import MovingRods, motions_picture, save_animation, save_rollout
from doo_ti.system.files import whole_file, write_whole
from tests.first_use import group
from tests.processes import python

NAMES, UP = ["one", "other"], np.array([0.0, 0.0, 1.0])
RODS = np.cumsum(np.random.default_rng(3).normal(size=(2, 4, 9, 3)) + [3.0, 0, 0], axis=2)
MOVING = MovingRods(np.arange(4) / 10, RODS.swapaxes(0, 1), NAMES, np.zeros((4, 2)), np.ones((4, 2), dtype=bool))
OBSERVATIONS = Observations(RODS.reshape(-1, 9, 3), rest_length=np.full(8, 3.0))


def test_a_file_takes_its_place_when_it_is_whole(tmp_path):
    path = tmp_path / "F.npz"
    write_whole(path, lambda file: file.write(b"first"))
    with whole_file(path) as file:
        file.write(b"second")
        file.flush()
        assert path.read_bytes() == b"first" and Path(file.name).read_bytes() == b"second"
    assert path.read_bytes() == b"second" and list(tmp_path.iterdir()) == [path]


def test_what_fails_leaves_the_file_before_it(tmp_path):
    path = tmp_path / "F.npz"
    write_whole(path, lambda file: file.write(b"first"))
    with pytest.raises(OSError, match="full"), whole_file(path) as file:
        file.write(b"sec")
        raise OSError("full")
    assert path.read_bytes() == b"first" and list(tmp_path.iterdir()) == [path]


def test_two_write_one_file_beside_each_other(tmp_path):
    path = tmp_path / "F.npz"
    with whole_file(path) as first, whole_file(path) as second:
        first.write(b"first")
        second.write(b"second")
    assert path.read_bytes() == b"first" and list(tmp_path.iterdir()) == [path]


def test_a_link_of_the_files_name_is_replaced_and_not_followed(tmp_path):
    (tmp_path / "other").write_bytes(b"other")
    path = tmp_path / "F.npz"
    path.symlink_to(tmp_path / "other")
    write_whole(path, lambda file: file.write(b"mine"))
    assert path.read_bytes() == b"mine" and not path.is_symlink() and (tmp_path / "other").read_bytes() == b"other"


@pytest.mark.skipif(os.name != "posix", reason="Windows does not say whether a process still fills a file")
def test_what_a_killed_process_left_goes_and_what_another_fills_stays(tmp_path):
    path, beside = tmp_path / "F[1].npz", tmp_path / ".F2.npz.00.part"
    beside.write_bytes(b"another file's")
    script = ("import os, pathlib, sys; from doo_ti.system.files import whole_file\n"
              "with whole_file(pathlib.Path(sys.argv[1])) as file: os.kill(os.getpid(), 9)")
    python("-c", script, path)
    assert len(list(tmp_path.iterdir())) == 2
    with whole_file(path) as file:
        write_whole(path, lambda other: other.write(b"whole"))
        assert sorted(tmp_path.iterdir()) == sorted([path, beside, Path(file.name)])


WRITERS = {
    "picture.png": lambda path: save_rollout(path, "rods", NAMES, RODS, None, 10.0, UP),
    "motions.png": lambda path: motions_picture(path, MOVING, title="rods"),
    "group.png": lambda path: save_group(path, GroupMotion.of([relax_group(group())] * 2, "group", NAMES[:1], rate=5.0)),
    "animation.gif": lambda path: save_animation(path, "rods", NAMES, RODS, None, 10.0, UP),
    "animation.webp": lambda path: save_animation(path, "rods", NAMES, RODS, None, 10.0, UP),
    "recording.rrd": lambda path: record_motion(path, run_id="a", name="rods", rods=MOVING, curves={}, text="rods"),
    **dict.fromkeys(("rods.npz", "rods.csv", "rods.parquet"), lambda path: save_observations(path, OBSERVATIONS)),
    "result.csv": lambda path: save_arrays(path, {"vertices_mm": RODS}, ("rod", "frame")),
    "result.json": lambda path: save_json(path, {"rods": RODS})}


@pytest.mark.thorough
@pytest.mark.parametrize("kind", WRITERS)
def test_a_writer_that_is_stopped_at_the_end_leaves_the_file_before_it(tmp_path, monkeypatch, kind):
    def stopped(part, path):
        raise OSError("stopped")

    path = tmp_path / kind
    WRITERS[kind](path)
    before = path.read_bytes()
    monkeypatch.setattr(os, "replace", stopped)
    with pytest.raises(OSError, match="stopped"):
        WRITERS[kind](path)
    assert path.read_bytes() == before and list(tmp_path.iterdir()) == [path]
