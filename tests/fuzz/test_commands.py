"""Commands on damaged files and wrong options: they succeed, or refuse in one line and write nothing, whatever is wrong."""

import os
import re
import shutil
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from doo_ti.commands.cli import main
from tests.fuzz import corpus
from tests.fuzz.commands import RECIPES, changed, words_changed

QUICK = {"relax", "convert", "plan"}  # commands that the default run tries: their kernels compile in seconds
FREE = {"suppress_health_check": list(HealthCheck), "deadline": None, "derandomize": True, "database": None}
PROGRESS = re.compile(r"━|\d+/\d+ \w+ .*:")


@pytest.fixture(scope="module")
def quick_corpus(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("corpus")
    corpus.make(folder, quick=True)
    return folder


@pytest.fixture(scope="module")
def whole_corpus(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("corpus")
    corpus.make(folder)
    return folder


def files(folder: Path) -> dict[str, tuple]:
    """Kind, size and time of everything below a folder."""
    return {str(path): (path.lstat().st_mode, path.lstat().st_size * path.is_file(), path.lstat().st_mtime_ns * path.is_file())
            for path in folder.rglob("*")}


def judged(code: int, out: str, err: str) -> None:
    lines = [line for line in err.splitlines() if not PROGRESS.search(line) and not line.startswith("doo-ti: warning: ")]
    assert code in (0, 1, 2) and "Traceback" not in err
    assert all(line.startswith("doo-ti: ") for line in lines), err
    assert (out + err).replace("\n", "").isprintable()
    if code == 2:
        assert len(lines) == 1 and "; " in lines[0] and not out


def one_case(data, names: set[str] | None, source: Path, folder: Path, capfd) -> None:
    """A command of those ``names`` with one thing wrong about its files or its words, run in ``folder``."""
    usable = [recipe for recipe in RECIPES if (names is None or recipe.words[0] in names)
              and all((source / name).exists() for name in recipe.names)]
    recipe = data.draw(st.sampled_from(usable))
    for name in recipe.names:
        place = folder / ("out/run" if name == recipe.held else name)
        place.parent.mkdir(parents=True, exist_ok=True)
        shutil.copytree(source / name, place, dirs_exist_ok=True) if (source / name).is_dir() else shutil.copyfile(
            source / name, place)
    targets = sorted(path for path in folder.rglob("*") if path.is_file())
    words = recipe.words
    if targets and data.draw(st.booleans()):
        target = data.draw(st.sampled_from(targets))
        target.write_bytes(data.draw(changed(target.read_bytes(), target.suffix)))
    else:
        words = data.draw(words_changed(words))
    before = files(folder)
    try:
        code = main(list(words))
    finally:
        out, err = capfd.readouterr()
    judged(code, out, err)
    if code == 2:
        assert files(folder) == before, "written though refused"


def trial(data, names, source, tmp_path_factory, capfd) -> None:
    folder, here = tmp_path_factory.mktemp("case"), Path.cwd()
    os.chdir(folder)
    try:
        one_case(data, names, source, folder, capfd)
    finally:
        os.chdir(here)
        shutil.rmtree(folder, ignore_errors=True)


@settings(max_examples=60, **FREE)
@given(data=st.data())
def test_quick_commands_refuse_in_one_line(data, quick_corpus, tmp_path_factory, capfd):
    trial(data, QUICK, quick_corpus, tmp_path_factory, capfd)


@pytest.mark.slow
@settings(max_examples=2000, **FREE)
@given(data=st.data())
def test_all_commands_refuse_in_one_line(data, whole_corpus, tmp_path_factory, capfd):
    trial(data, None, whole_corpus, tmp_path_factory, capfd)
