"""What the documents measured and drew has a command, where it stands: each exists, and takes its options."""

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from doo_ti.commands.help_text import EXAMPLES
from tools.studies import reproduce
from tools.studies.replication.criteria import CRITERIA
from tools.studies.replication.landscapes import figure_1

ROOT = Path(__file__).resolve().parents[2]
DOCUMENTS = [*sorted((ROOT / "docs").rglob("*.md")),
             *(ROOT / name for name in ("doo_ti/PAPER.md", "tools/README.md", "README.md", "CONTRIBUTING.md"))]
MEASURED = [command for page in DOCUMENTS for last in re.findall(r"\*\*Measured with\*\* .*", page.read_text(encoding="utf-8"),
            re.DOTALL) for command in re.findall(r"`([^`]+)`", last)]


def test_every_tool_and_module_that_documents_name_exists_and_has_what_is_named_beside_it():
    modules = {path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8")
               for room in ("doo_ti", "tests", "tools") for path in (ROOT / room).rglob("*.py")}
    for document in DOCUMENTS:
        written = document.read_text(encoding="utf-8")
        for name in re.findall(r"(?<!/)\btools/[\w/]+\.py\b", written):
            assert name in modules, f"{document.name} names {name}"
        for name, beside in re.findall(r"`([\w/]+\.py)`(?: `(\w+)`)?", written):
            found = [text for path, text in modules.items() if path.endswith(f"/{name}") or path == name]
            assert found or "NN" in name, f"{document.name} names {name}"
            there = any(re.search(rf"\b{beside}\b", text) for text in found)
            assert there or not beside, f"{document.name}: {beside} in {name}"


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
    names, report = ["Table I", "Table II", "Fig. 1", "Fig. 3", "Fig. 4"], tmp_path / "REPLICATION.md"
    reproduce.main([*names, "--size", "tiny", "--report", str(report)])
    text = report.read_text(encoding="utf-8")
    for name in names:
        assert f"\n## {name}\n" in text and text.count(f"\n| {name} | ") >= len(CRITERIA[name])
    assert "did not run" not in text and "1.40 / 0." in text
    assert figure_1()[0] == {"apart": [True]}
