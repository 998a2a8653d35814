"""A recording that cannot be written, and two of one name."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import rerun
import rerun.blueprint as blueprint
from rerun.chunk import RrdReader

from doo_ti.record.viewer import DESCRIPTORS, recording

ROOT = Path(__file__).resolve().parents[2]
LAYOUT = blueprint.Blueprint(blueprint.Spatial3DView())
# A limit on the size of files stands for a full disk.
FULL = """
import resource, sys
import numpy as np, rerun, rerun.blueprint as blueprint
from doo_ti.record.viewer import recording

resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, 50_000))
try:
    with recording(sys.argv[1], "id", "name", blueprint.Blueprint(blueprint.Spatial3DView())) as stream:
        for step in range(20):
            stream.set_time("step", sequence=step)
            stream.log("points", rerun.Points3D(np.random.default_rng(step).normal(size=(5000, 3))))
except OSError as error:
    print(error.filename)
"""


def logged(stream, value: float) -> None:
    for step in range(10):
        stream.set_time("step", sequence=step)
        stream.log("points", rerun.Points3D(np.full((100, 3), value + step)))


@pytest.mark.thorough
@pytest.mark.skipif(not DESCRIPTORS.is_dir(), reason="rerun writes by itself here")
def test_a_full_disk_ends_a_recording_in_one_error(tmp_path):
    done = subprocess.run([sys.executable, "-c", FULL, str(tmp_path / "run.rrd")], capture_output=True, text=True, timeout=120,
                          env={**os.environ, "PYTHONPATH": str(ROOT)})
    assert (done.returncode, done.stdout, done.stderr) == (0, f"{tmp_path / 'run.rrd'}\n", "")
    assert list(tmp_path.iterdir()) == []


def test_two_recordings_of_one_name_do_not_meet(tmp_path):
    (tmp_path / "elsewhere").write_bytes(b"mine")
    path = tmp_path / "run.rrd"
    (tmp_path / "run.rrd.part").symlink_to(tmp_path / "elsewhere")
    with recording(path, "first", "first", LAYOUT) as first:
        logged(first, 0.0)
        with recording(path, "second", "second", LAYOUT) as second:
            logged(second, 100.0)
        assert [one.recording_id for one in RrdReader(path).recordings()] == ["second"]
        logged(first, 50.0)
    assert [one.recording_id for one in RrdReader(path).recordings()] == ["first"]
    assert (tmp_path / "elsewhere").read_bytes() == b"mine"
    assert sorted(each.name for each in tmp_path.iterdir()) == ["elsewhere", "run.rrd", "run.rrd.part"]


def test_a_recording_that_fails_leaves_nothing(tmp_path):
    with pytest.raises(ValueError, match="trouble"), recording(tmp_path / "run.rrd", "id", "name", LAYOUT) as stream:
        logged(stream, 0.0)
        raise ValueError("trouble")
    assert list(tmp_path.iterdir()) == []
