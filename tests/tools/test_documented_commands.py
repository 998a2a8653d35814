"""What the documents measured and drew has a command, where it stands: each exists, and takes its options."""

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from doo_ti.commands.help_text import EXAMPLES
from tools.maintenance import mutations
from tools.studies import compare_peers, detection_study, reproduce
from tools.studies.replication import specimens
from tools.studies.replication.criteria import CRITERIA, Verdict, verdict
from tools.studies.replication.study import ITEMS

ROOT = Path(__file__).resolve().parents[2]
DOCUMENTS = [*sorted((ROOT / "docs").rglob("*.md")),
             *(ROOT / name for name in ("doo_ti/PAPER.md", "tools/README.md", "README.md", "CONTRIBUTING.md"))]
MEASURED = [command for page in DOCUMENTS for last in re.findall(r"\*\*Measured with\*\* .*", page.read_text(encoding="utf-8"),
            re.DOTALL) for command in re.findall(r"`([^`]+)`", last)]


def test_every_tool_that_documents_name_exists():
    for document in DOCUMENTS:
        for name in re.findall(r"(?<!/)\btools/[\w/]+\.py\b", document.read_text(encoding="utf-8")):
            assert (ROOT / name).is_file(), f"{document.name} names {name}"


def test_every_page_with_a_picture_has_a_command():
    for page in (ROOT / "docs").rglob("*.md"):
        text = page.read_text(encoding="utf-8")
        drawn = page.parent.name != "examples" and "![" in text
        assert not drawn or re.search(r"\bdoo-ti [a-z]|\bpython tools/", text), f"{page.name} has pictures without a command"


def test_every_command_that_measured_a_page_exists():
    assert len(MEASURED) > 25
    for words in map(shlex.split, MEASURED):
        if words[0] == "doo-ti":
            assert words[1] in EXAMPLES, words
        else:
            named = words[3:4] if words[1] == "-m" else words[1:2]
            assert words[0] == "python" and all((ROOT / name).exists() for name in named), words
        assert all((ROOT / word).is_file() for word in words if word.startswith("scenes/")), words


@pytest.mark.thorough
@pytest.mark.parametrize("command", sorted({words for words in MEASURED if " --" in words and " -m " not in words}))
def test_every_command_takes_its_options(command):
    """The options that a documented command names are those of its help."""
    words = shlex.split(command)
    program = [sys.executable, *(["-m", "doo_ti", words[1]] if words[0] == "doo-ti" else words[1:2])]
    asked = "--help-all" if words[0] == "doo-ti" else "--help"
    told = subprocess.run([*program, asked], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    for option in (word for word in words if word.startswith("--")):
        assert option in told, f"{command}: {option}"


@pytest.mark.thorough
def test_items_are_measured_and_reported(tmp_path, capsys):
    names = ["Table I", "Table II", "Fig. 1", "Fig. 3", "Fig. 4"]
    report = tmp_path / "REPLICATION.md"
    reproduce.main([*names, "--size", "tiny", "--report", str(report)])
    text = report.read_text(encoding="utf-8")
    for name in names:
        assert f"\n## {name}\n" in text
        assert text.count(f"\n| {name} | ") >= len(CRITERIA[name])
    assert "did not run" not in text and "1.40 / 0." in text


def test_a_missing_scene_fails_the_run(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(specimens, "SCENES", tmp_path)
    report = tmp_path / "REPLICATION.md"
    assert reproduce.main(["Table I", "--size", "tiny", "--report", str(report)]) == 1
    assert "did not run" in report.read_text(encoding="utf-8") and "nylon.toml" in capsys.readouterr().err


def test_a_scene_that_a_small_run_leaves_out_is_missed(tmp_path, monkeypatch, capsys):
    for scene in specimens.SCENES.glob("*.*"):
        if scene.name != "loops_silk.toml":
            (tmp_path / scene.name).write_bytes(scene.read_bytes())
    monkeypatch.setattr(specimens, "SCENES", tmp_path)
    assert reproduce.main(["Fig. 6", "--size", "tiny", "--report", str(tmp_path / "REPLICATION.md")]) == 1
    assert "loops_silk.toml" in capsys.readouterr().err


def test_criteria_are_those_of_the_items():
    assert set(CRITERIA) < set(ITEMS)
    assert [verdict(held) for held in ([True] * 4 + [False], [True, False], [False] * 5)] == [
        Verdict.REPRODUCED, Verdict.PARTLY, Verdict.NOT]


@pytest.mark.thorough
def test_detection_is_measured(capsys, monkeypatch):
    monkeypatch.setattr(detection_study, "ROWS", detection_study.ROWS[:2])
    assert detection_study.main(["--rods", "1"]) == 0
    assert len(capsys.readouterr().out.strip().splitlines()) == 2 + len(detection_study.ROWS)


def test_a_closer_or_missing_peer_gives_no_ratio():
    def row(name, microseconds, continuum):
        return compare_peers.Row(name, microseconds, "", 0.0, continuum, continuum)

    here = row("this package", 2.0, 0.03)
    assert compare_peers.ratio([here, row("MuJoCo", 8e4, 0.07), row("MuJoCo", 2e5, 0.04)]) == 4e4
    assert compare_peers.ratio([here, row("MuJoCo", 8e4, 0.07), row("MuJoCo", 2e5, 0.01)]) == 0
    assert compare_peers.ratio([here]) == 0


@pytest.mark.parametrize("fault", mutations.FAULTS.values(), ids=mutations.FAULTS)
def test_faults_still_apply(fault):
    """Each fault changes one line, and its tests exist."""
    assert (ROOT / fault.file).read_text(encoding="utf-8").count(fault.old) == 1
    assert len(mutations.FAULTS) >= 10 and all((ROOT / path).exists() for path in fault.tests)
