"""A process that is killed while it writes leaves under a file's name what was there before, or the whole file."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

pytestmark = [pytest.mark.slow, pytest.mark.skipif(os.name != "posix", reason="takes a signal that cannot be caught")]

ROOT = Path(__file__).resolve().parents[2]
KILLS = 4
"""Of each kind of file, at random instants, every other one as soon as the process writes."""
SECONDS = 1.0
"""Of writing, within which the process is killed."""
WRITERS = '''
import pickle
import sys
from pathlib import Path

import numpy as np

from doo_ti import Observations, save_observations
from doo_ti.commands.results import save_arrays, save_json
from doo_ti.record import record_motion
from doo_ti.report import MovingRods, landscape_picture, motions_picture
from doo_ti.report.motions import save_animation, save_rollout

random = np.random.default_rng(3)
frames, vertices = 40, 30
rods = np.cumsum(random.normal(size=(2, frames, vertices, 3)) + [3.0, 0, 0], axis=2)
names, up = ["one", "other"], np.array([0.0, 0.0, 1.0])
moving = MovingRods(np.arange(frames) / 10, rods.swapaxes(0, 1), names, np.zeros((frames, 2)), np.ones((frames, 2), dtype=bool))
observations = Observations(rods.reshape(-1, vertices, 3), rest_length=np.full(vertices - 1, 3.0))


def group(path):
    from doo_ti.report.contact import save_group

    save_group(path, pickle.loads(Path(sys.argv[2]).read_bytes()), name="group", names=names, rate=5.0)


WRITE = {
    "picture.png": lambda path: save_rollout(path, "rods", names, rods, None, 10.0, up),
    "motions.png": lambda path: motions_picture(path, moving, title="rods"),
    "group.png": group,
    "animation.gif": lambda path: save_animation(path, "rods", names, rods, None, 10.0, up),
    "animation.webp": lambda path: save_animation(path, "rods", names, rods, None, 10.0, up),
    "recording.rrd": lambda path: record_motion(path, run_id="a", name="rods", rods=moving, curves={}, text="rods"),
    "rods.npz": lambda path: save_observations(path, observations),
    "rods.csv": lambda path: save_observations(path, observations),
    "rods.parquet": lambda path: save_observations(path, observations),
    "result.csv": lambda path: save_arrays(path, {"vertices_mm": rods}, ("rod", "frame")),
    "result.json": lambda path: save_json(path, {"rods": rods}),
}
path = Path(sys.argv[1])
WRITE[path.name](path)
print("written", flush=True)
while True:
    WRITE[path.name](path)
'''
KINDS = ("picture.png", "motions.png", "group.png", "animation.gif", "animation.webp", "recording.rrd", "rods.npz", "rods.csv",
         "rods.parquet", "result.csv", "result.json")


@pytest.fixture(scope="module")
def moments(tmp_path_factory) -> Path:
    """Two moments of a group of rods, pickled."""
    import pickle

    from doo_ti.groups.relax_group import relax_group
    from doo_ti.groups.scene import load_group_scene

    scene = load_group_scene(ROOT / "scenes/groups/hooked_slings.toml")
    path = tmp_path_factory.mktemp("group") / "moments.pickle"
    path.write_bytes(pickle.dumps([relax_group(scene.group)] * 2))
    return path


def wait(folder: Path, path: Path, seconds: float, first_part: bool) -> None:
    """Wait for so long, or until the process next begins to write, which of a drawing is the shortest part of its time."""
    deadline = time.monotonic() + (20.0 if first_part else seconds)
    while time.monotonic() < deadline and not (first_part and any(other != path for other in folder.iterdir())):
        time.sleep(0.0 if first_part else 0.01)


def read(path: Path) -> None:
    """Read the file to its end. Raises whatever its reader raises for half a file."""
    if path.suffix in (".png", ".gif", ".webp"):
        from PIL import Image

        with Image.open(path) as image:
            for frame in range(getattr(image, "n_frames", 1)):
                image.seek(frame)
                image.load()
    elif path.suffix == ".rrd":
        from rerun.chunk import RrdReader

        assert len(list(RrdReader(path).stream())) > 4
    elif path.suffix == ".npz":
        with np.load(path) as arrays:
            assert all(arrays[name] is not None for name in arrays)
    elif path.suffix == ".parquet":
        import pyarrow.parquet

        assert pyarrow.parquet.read_table(path).num_rows


@pytest.mark.parametrize("kind", KINDS)
def test_a_killed_writer_leaves_whole_files(tmp_path, rng, moments, kind):
    path, whole, parts = tmp_path / kind, None, 0
    for attempt in range(KILLS):
        writer = subprocess.Popen([sys.executable, "-c", WRITERS, str(path), str(moments)], stdout=subprocess.PIPE, text=True,
                                  env={**os.environ, "PYTHONPATH": str(ROOT)})
        try:
            assert writer.stdout.readline() == "written\n"
            size = path.stat().st_size
            wait(tmp_path, path, SECONDS * rng.random(), first_part=attempt % 2 == 1)
        finally:
            writer.send_signal(signal.SIGKILL)
            writer.communicate()
        read(path)
        if kind != "recording.rrd":  # its chunks have names of their own in each process
            whole = whole or path.read_bytes()
            assert path.read_bytes() == whole
        assert path.stat().st_size > 0.9 * size
        others = [other for other in tmp_path.iterdir() if other != path]
        assert all(other.name.startswith(f".{kind}.") and other.suffix == ".part" for other in others) and len(others) <= 1
        parts += len(others)
    print(f"{kind}: {parts} of {KILLS} were killed while they wrote")
