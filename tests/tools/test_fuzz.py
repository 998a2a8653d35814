"""Damaged inputs and wrong options: which cases are drawn, how they are judged, a short campaign, and a long one."""

import os
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

from doo_ti.io.observations import load_observations, save_observations
from tests.commands.test_bad_input import npz_bytes
from tools import fuzz
from tools.fuzzing.commands import COMMANDS, RECIPES
from tools.fuzzing.worker import judged, prepare

ROOT = Path(__file__).resolve().parents[2]
pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="measures memory with Linux' /proc")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A corpus of observations and what goes with them, made without relaxing a rod."""
    folder = tmp_path_factory.mktemp("fuzz")
    corpus = folder / "corpus"
    corpus.mkdir()
    (corpus / "rods.npz").write_bytes(npz_bytes(corpus))
    (corpus / "good.npz").unlink()
    for name in ("rods.csv", "rods.parquet"):
        save_observations(corpus / name, load_observations(corpus / "rods.npz"))
    (corpus / "loop.toml").write_text(fuzz.corpus.LOOP)
    return folder


def test_every_command_is_in_it():
    from doo_ti.commands import __path__

    sources = [path.read_text() for path in Path(__path__[0]).glob("*.py")]
    declared = {name for source in sources for name in re.findall(r'given\.command\(add, "(\w+)"', source)}
    declared -= {"warm"}  # it reads nothing
    assert set(COMMANDS) == declared and {option for recipe in RECIPES for option in recipe.words} >= {"--out", "--rig"}


def test_cases_follow_the_seed(folder, tmp_path, monkeypatch):
    def drawn(name: str, seed: str) -> list[dict]:
        found = []
        for number in range(12):
            place = tmp_path / name / str(number)
            place.mkdir(parents=True)
            monkeypatch.chdir(place)
            found.append(
                prepare(folder / "corpus", seed, number)
                | {"files": {str(path): path.read_bytes() for path in sorted(Path().rglob("*")) if path.is_file()}}
            )
        return found

    first = drawn("first", "5")
    with monkeypatch.context() as later:
        later.setattr(time, "time", lambda: 2e9)  # a member of a zip file has a time
        assert first == drawn("again", "5")
    assert first != drawn("other", "6")
    assert len({case["change"] for case in first}) > 6


LINE = "doo-ti: a.npz: vertices_mm: missing; give it\n"


@pytest.mark.parametrize(
    ("code", "out", "err", "problem"),
    [
        (0, "done\n", "", ""),
        (2, "", LINE, ""),
        (1, "", LINE, ""),
        (1, "no rod converged\n", "", ""),
        (0, "", "silk ━━━━ 6/6 cells\n", ""),
        (0, "", "doo-ti: warning: path.csv: far away\n", ""),
        (2, "", "doo-ti: warning: path.csv: far away\n", "0 lines"),
        (3, "", LINE, "exit code 3"),
        (-11, "", "", "exit code -11"),
        (2, "", LINE + LINE, "2 lines at exit 2"),
        (2, "", "", "0 lines"),
        (2, "", "libpng warning\n" + LINE, "another line"),
        (0, "", "libpng warning\n", "another line"),
        (1, "", "", "0 lines"),
        (2, "printed\n", LINE, "stdout"),
        (0, "a\x1b[2J\n", "", "control"),
        (0, "[NaN]\n", "", "JSON"),
        (2, "", "Traceback (most recent call last):\nX\n", "traceback"),
        (2, "", "doo-ti: no\n", "no remedy"),
    ],
)
def test_how_a_command_ends_is_judged(code, out, err, problem):
    found = judged(code, out, err, "JSON" in problem)
    assert problem in found and bool(found) == bool(problem)


@pytest.mark.thorough
def test_a_short_campaign(folder):
    results = fuzz.campaign(folder, 2011, range(16), verbose=False)
    assert [each["problem"] for each in results if each["problem"]] == []
    assert {each["code"] for each in results} >= {0, 2} and len({each["recipe"] for each in results}) > 3
    printed = fuzz.report(results)
    assert "16 cases, 0 failures" in printed and "| convert |" in printed


SPOILT = """
import sys
from doo_ti import cli
def command(*words):
    WHAT
cli.main = command
import runpy
sys.argv = sys.argv[1:]
runpy.run_module("tools.fuzzing.worker", run_name="__main__")
"""


@pytest.mark.sampled(1)
@pytest.mark.parametrize(
    ("what", "problem"),
    [
        ("import os; os.kill(os.getpid(), 11)", "signal 11"),
        ("import time; time.sleep(99)", "hangs"),
        ("held = b'x' * (1 << 29); import time; time.sleep(99)", "GB"),
        ("raise KeyError('x')", "KeyError"),
        ("open('beside.txt', 'w'); return 0", "written outside"),
        ("import os; os.write(2, b'libpng\\n'); return 0", "another line"),
    ],
)
def test_what_goes_wrong_is_found(folder, monkeypatch, what, problem):
    """A worker whose command does something of the kind."""
    popen = subprocess.Popen
    monkeypatch.setattr(fuzz, "MOST_SECONDS", 1.0)
    monkeypatch.setattr(fuzz, "MOST_WAITING", 1)
    monkeypatch.setattr(fuzz, "START_SECONDS", 1.0 if problem == "hangs" else 20.0)
    monkeypatch.setattr(fuzz, "MOST_BYTES", 1 << 29)
    monkeypatch.setattr(
        subprocess,
        "Popen",
        lambda words, **options: popen([words[0], "-c", SPOILT.replace("WHAT", what), *words[2:]], **options),
    )
    worker = fuzz.Worker(folder, 2011)
    try:
        assert problem in worker.run(3)["problem"]
    finally:
        worker.stop()


@pytest.mark.slow
def test_a_long_campaign(tmp_path):
    done = subprocess.run(
        [sys.executable, "tools/fuzz.py", "--cases", "2000", "--seed", "7", "--folder", str(tmp_path)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    print(done.stdout)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr
