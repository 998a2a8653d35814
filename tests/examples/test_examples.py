"""Every example runs as it stands, in an empty folder, in this process, where kernels are loaded; it checks its own result."""

import os
import runpy
import selectors
import subprocess
import sys
from contextlib import chdir
from pathlib import Path

import pytest
from PIL import Image

from doo_ti.commands.cli import main
from tests.processes import ROOT
from tools.maintenance.gallery import DRAWN_BY, digest

SCRIPTS = [path for path in sorted((ROOT / "docs" / "examples").glob("[0-9][0-9]_*.*")) if path.suffix in (".py", ".sh")]
MARKS = {"01_hang_a_rope.py": (), "10_cluster.py": pytest.mark.slow}
"""Others belong to the full run. The slow one starts a cluster of processes, as tests of the full run do too."""
NEEDED = {"16_gradients_jax.py": "jax", "17_gradients_torch.py": "torch"}
"""What some examples use that the package does not depend on."""
SHIM = """#!/bin/bash
printf '%s\\0' "$PWD" "$@" > {requests}
read -r code < {answers}
exit "$code"
"""
"""The doo-ti of shell scripts: asks this process to run the command, and takes its exit code."""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    programs, empty = tmp_path / "bin", tmp_path / "empty"
    for path in (programs, empty):
        path.mkdir()
    for name in ("requests", "answers"):
        os.mkfifo(tmp_path / name)
    (programs / "python").write_text(f"#!/bin/sh\nexec '{sys.executable}' \"$@\"\n")
    (programs / "doo-ti").write_text(SHIM.format(requests=tmp_path / "requests", answers=tmp_path / "answers"))
    for path in programs.iterdir():
        path.chmod(0o755)
    monkeypatch.setenv("PATH", f"{programs}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.setenv("MPLBACKEND", "Agg")
    return empty


def run_shell(script: Path, folder: Path) -> int:
    """The exit code of a script, whose ``doo-ti`` commands this process carries out."""
    requests, answers = (os.open(folder.parent / name, os.O_RDWR) for name in ("requests", "answers"))
    with subprocess.Popen(["bash", str(script)], cwd=folder) as process, selectors.DefaultSelector() as selector:
        selector.register(requests, selectors.EVENT_READ)
        while process.poll() is None:
            if selector.select(timeout=0.05):
                where, *words = os.read(requests, 1 << 16).decode().split("\0")[:-1]
                code = 1
                try:
                    with chdir(where):
                        code = main(words)
                finally:  # else the script would wait for ever
                    os.write(answers, f"{code}\n".encode())
    for pipe in (requests, answers):
        os.close(pipe)
    return process.returncode


@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize("script", [
    pytest.param(path, id=path.name, marks=MARKS.get(path.name, pytest.mark.thorough)) for path in SCRIPTS])
def test_example(script, folder, monkeypatch):
    if script.name in NEEDED:
        pytest.importorskip(NEEDED[script.name])
    monkeypatch.setattr(sys, "argv", [str(script)])
    if script.suffix == ".sh":
        assert run_shell(script, folder) == 0
    elif script.stem.endswith("cluster"):  # its workers are processes that import it
        pytest.importorskip("distributed", reason="no cluster without Dask")
        subprocess.run([sys.executable, str(script)], cwd=folder, check=True)
    else:
        with chdir(folder):
            runpy.run_path(str(script), run_name="__main__")
        sys.modules["matplotlib.pyplot"].close("all")


def test_every_example_has_a_page_in_the_gallery_and_a_picture_of_the_script_as_it_is():
    """Else ``python tools/maintenance/gallery.py NUMBER`` draws it again."""
    gallery = (ROOT / "docs" / "examples" / "index.md").read_text(encoding="utf-8")
    for script in SCRIPTS:
        page, picture = script.with_suffix(".md"), script.with_suffix(".png")
        assert all(path.is_file() and f"({path.name})" in gallery for path in (page, picture)), script
        assert f"{script.name}\"" in page.read_text(encoding="utf-8"), f"{page} does not show its code"
        with Image.open(picture) as image:
            assert image.text.get(DRAWN_BY) == digest(script), f"{picture} is of another script"
    assert [int(path.name[:2]) for path in SCRIPTS] == list(range(1, len(SCRIPTS) + 1))
