"""Every example runs as it stands, in an empty folder, in this process, where kernels are loaded; it checks its own result.
README and docs: links lead somewhere, commands have the options that pages give them, README's blocks run as written; so do
the examples of docs/reading_runs.md, on a small run."""

import importlib.util
import json
import os
import re
import runpy
import selectors
import shlex
import subprocess
import sys
from contextlib import chdir, redirect_stdout
from functools import cache
from io import StringIO
from pathlib import Path

import numpy as np
import pyarrow.parquet
import pytest
from PIL import Image

import doo_ti
from doo_ti import Status, sweep
from doo_ti.commands.cli import main
from tests.learning.lab import DYNAMIC, GRID, small_lab
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


PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize("page", PAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_links_lead_somewhere(page):
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    links = [link for link in re.findall(r"\]\(([^)\s]+)\)", text) if not re.match(r"https?:", link)]
    missing = [link for link in links if link.partition("#")[0] and not (page.parent / link.partition("#")[0]).exists()]
    assert not missing


def commands() -> list[tuple[str, list[str]]]:
    """(page, words) of every line of a page that begins with ``doo-ti``, without comments."""
    lines = ((page.name, line.strip().removeprefix("$ ")) for page in PAGES
             for line in page.read_text(encoding="utf-8").replace("\\\n", " ").splitlines())
    return [(page, shlex.split(text, comments=True)[1:]) for page, text in lines
            if text.startswith("doo-ti ") and "…" not in text]


@cache
def help_of(command: str) -> str:
    shown = StringIO()
    with redirect_stdout(shown):
        assert main([command, "--help-all"]) == 0
    return shown.getvalue()


def test_commands_have_the_options_that_pages_give_them():
    listed = commands()
    assert len(listed) > 30
    unknown = [(page, words[0], word) for page, words in listed for word in words[1:]
               if word.startswith("--") and word.partition("=")[0] not in re.findall(r"--[\w-]+", help_of(words[0]))]
    assert not unknown


def test_the_reference_has_every_public_name():
    listed = re.findall(r"^::: doo_ti\..*?(\w+)$", (ROOT / "docs" / "reference.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert sorted(listed) == sorted(doo_ti.__all__)


@pytest.mark.thorough
@pytest.mark.filterwarnings("ignore")
def test_readme_runs_as_written(tmp_path, capfd):
    """Its commands in order, without the installation, then its Python, in a folder with what they use of a fresh clone."""
    blocks, ran = BLOCK.findall((ROOT / "README.md").read_text(encoding="utf-8")), 0
    for name in ("scenes", "docs"):
        (tmp_path / name).symlink_to(ROOT / name)
    with chdir(tmp_path):
        for language, text in blocks:
            if language == "python":
                exec(compile(text, "README.md", "exec"), {})
                ran += 1
            for line in text.splitlines() if language == "bash" else ():
                words = shlex.split(line.split("&&")[-1].replace(".venv/bin/", ""), comments=True)
                if words[0] == "doo-ti":
                    assert main(words[1:]) == 0, capfd.readouterr().err
                    ran += 1
    assert ran == 4


@pytest.mark.thorough
@pytest.mark.filterwarnings("ignore")
def test_the_notebook_runs(tmp_path, monkeypatch):
    monkeypatch.setenv("MPLBACKEND", "Agg")
    cells = json.loads((ROOT / "docs" / "examples" / "landscape_and_rods.ipynb").read_text(encoding="utf-8"))["cells"]
    names = {}
    with chdir(tmp_path):
        for cell in (cell for cell in cells if cell["cell_type"] == "code"):
            exec("".join(cell["source"]), names)
    assert 0.3 < names["bend"][names["best"][0]] / 6e5 < 3


@pytest.mark.thorough
@pytest.mark.skipif(importlib.util.find_spec("mkdocs") is None, reason="pip install '.[docs]' to build the pages")
def test_the_site_builds_without_warnings(tmp_path):
    """As .ci/run does; a warning is an error."""
    words = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(tmp_path / "site")]
    done = subprocess.run(words, cwd=ROOT, env=os.environ | {"NO_MKDOCS_2_WARNING": "1"}, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "load_observations" in (tmp_path / "site" / "reference" / "index.html").read_text(encoding="utf-8")


PAGE = (ROOT / "docs" / "reading_runs.md").read_text(encoding="utf-8")
EXAMPLES = dict(re.findall(r"^## ([^\n]+)\n(?:(?!^## ).)*?```python\n(.*?)```", PAGE, re.DOTALL | re.MULTILINE))


@pytest.fixture(scope="module")
def reading(tmp_path_factory):
    reading = tmp_path_factory.mktemp("reading")
    sweep(reading / "runs" / "silk", small_lab(), GRID)
    sweep(reading / "runs" / "moved", small_lab(), GRID, options=DYNAMIC)
    return reading


def printed(reading, word: str) -> str:
    """What the example prints whose heading has that word."""
    example, = (text for heading, text in EXAMPLES.items() if word in heading)
    shown = StringIO()
    with chdir(reading), redirect_stdout(shown):
        exec(example, {})
    return shown.getvalue()


@pytest.mark.thorough
def test_the_example_finds_the_best_cell(reading):
    summary = json.loads((reading / "runs" / "silk" / "summary.json").read_text())
    found, best = [float(number) for number in printed(reading, "pyarrow").split()], summary["best"]
    assert found[:4] == [best[key] for key in ("bend_1", "bend_2", "twist", "weight")]
    assert np.isclose(found[4], best["mean_distance_mm"], rtol=1e-12)


@pytest.mark.thorough
def test_every_column_and_status_is_explained(reading):
    for run in ("silk", "moved"):
        for name in pyarrow.parquet.read_schema(min((reading / "runs" / run / "cells").glob("*.parquet"))).names:
            assert f"`{name}`" in PAGE
    for kind in Status:
        assert f"{int(kind)} {kind.name.lower().replace('_', ' ')}" in PAGE
