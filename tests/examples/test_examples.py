"""Every example runs as it stands, in an empty folder; each ends with a check of its own result."""

import os
import shlex
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = sorted((ROOT / "docs" / "examples").glob("[0-9][0-9]_*.*"))
SCRIPTS = [path for path in EXAMPLES if path.suffix in (".py", ".sh")]
DEFAULT = ("01_hang_a_rope.py",)
"""Of the default run; the full run has all."""
SECONDS = 300


@pytest.fixture(scope="module")
def started(tmp_path_factory, request):
    """Name: the finished process of each example that was collected; two run at a time."""
    folder = tmp_path_factory.mktemp("examples")
    programs = folder / "bin"
    programs.mkdir()
    for name, words in (("python", [sys.executable]), ("doo-ti", [sys.executable, "-m", "doo_ti"])):
        (programs / name).write_text(f"#!/bin/sh\nexec {shlex.join(words)} \"$@\"\n")
        (programs / name).chmod(0o755)
    paths = filter(None, [str(ROOT), os.environ.get("PYTHONPATH")])
    environment = os.environ | {"PATH": f"{programs}{os.pathsep}{os.environ['PATH']}", "PYTHONPATH": os.pathsep.join(paths),
                                "MPLBACKEND": "Agg"}

    def done(script: Path):
        own = folder / script.stem
        own.mkdir()
        program = "bash" if script.suffix == ".sh" else "python"
        return subprocess.run([program, str(script)], cwd=own, env=environment, capture_output=True, text=True, timeout=SECONDS)

    chosen = {item.callspec.params["script"] for item in request.session.items if "script" in getattr(
        getattr(item, "callspec", None), "params", {})}
    with ThreadPoolExecutor(2) as threads:
        yield dict(zip(sorted(chosen), threads.map(done, sorted(chosen)), strict=True))


@pytest.mark.parametrize("script", [
    pytest.param(path, marks=() if path.name in DEFAULT else pytest.mark.thorough, id=path.name) for path in SCRIPTS])
def test_example(script, started):
    if script.stem.endswith("cluster"):
        pytest.importorskip("distributed", reason="no cluster without Dask")
    done = started[script]
    assert done.returncode == 0, f"{done.stdout}\n{done.stderr}"


def test_every_example_has_a_page_in_the_gallery_and_a_picture():
    gallery = (ROOT / "docs" / "examples" / "index.md").read_text(encoding="utf-8")
    for script in SCRIPTS:
        page = script.with_suffix(".md")
        assert page.is_file() and f"({page.name})" in gallery, script
        assert f"{script.name}\"" in page.read_text(encoding="utf-8"), f"{page} does not show its code"
        assert (picture := script.with_suffix(".png")).is_file() and f"({picture.name})" in gallery, script
    assert [int(path.name[:2]) for path in SCRIPTS] == list(range(1, len(SCRIPTS) + 1))
