"""Without rerun, which is large, everything but recordings works: they are left out in a line, or refused where asked for."""

import subprocess
from pathlib import Path

import pytest

from tests.commands.test_synth import SCENE
from tests.processes import python

WITHOUT = """
import importlib.metadata as metadata, sys
installed = metadata.version
def version(package):
    if package == "rerun-sdk":
        raise metadata.PackageNotFoundError(package)
    return installed(package)
metadata.version = version
sys.modules["rerun"] = None
from doo_ti.commands.cli import main
sys.exit(main(sys.argv[1:]))
"""


def without_rerun(folder: Path, *words: str) -> subprocess.CompletedProcess:
    return python("-c", WITHOUT, *words, folder=folder)


@pytest.mark.thorough
def test_a_sweep_leaves_its_recording_out_and_says_so(tmp_path):
    (tmp_path / "silk.toml").write_text(SCENE)
    done = without_rerun(tmp_path, "sweep", "silk.toml", "--out", "run")
    assert done.returncode == 0, done.stderr
    said = [line for line in done.stderr.splitlines() if "rerun" in line]
    assert len(said) == 1 and "pip install rerun-sdk" in said[0]
    assert (tmp_path / "run" / "summary.json").is_file() and not (tmp_path / "run" / "run.rrd").exists()


@pytest.mark.sampled(1)
@pytest.mark.parametrize("words", [
    ("simulate", "pendulum", "--out", "a.npz", "--recording", "a.rrd"),
    ("predict", "three_materials", "--out", "a.npz", "--recording", "a.rrd"),
    ("group", "reef_knot", "--out", "a.npz", "--recording", "a.rrd"),
    ("view", "run"),
    ("figures", "run", "--out", "pictures")])
def test_a_recording_that_is_asked_for_is_refused_in_a_line(tmp_path, words):
    (tmp_path / "run").mkdir()
    done = without_rerun(tmp_path, *words)
    assert done.returncode == 2 and "rerun" in done.stderr and len(done.stderr.splitlines()) == 1, done.stderr
    assert [path.name for path in tmp_path.rglob("*")] == ["run"]
