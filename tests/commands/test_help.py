"""The help: every command in one group with two examples that are valid; wrong words name the right one."""

import shlex
from pathlib import Path

import pytest

from doo_ti.cli import _parser, main
from doo_ti.commands.help_text import EXAMPLES, GROUPS, OTHER_WORDS

DOCS = Path(__file__).resolve().parents[2] / "docs"
COMMANDS = _parser().meanings()


def test_every_command_is_in_one_group():
    grouped = [name for names in GROUPS.values() for name in names]
    assert sorted(grouped) == sorted(COMMANDS) and set(EXAMPLES) == set(COMMANDS) >= set(OTHER_WORDS.values())


@pytest.mark.parametrize("argv", [[], ["help"], ["--help"]])
def test_the_program_alone_shows_its_commands(argv, capsys):
    assert main(argv) == 0
    out, err = capsys.readouterr()
    assert not err and all(f"\n  {name} " in out for name in COMMANDS) and all(f"\n{title}:" in out for title in GROUPS)


@pytest.mark.parametrize("command", COMMANDS)
def test_examples_are_valid(command, capsys):
    page, *lines = EXAMPLES[command]
    assert (DOCS / f"{page}.md").exists() and len(lines) == 2
    for line, _ in lines:
        assert _parser().parse_args(shlex.split(line)).command == command
    for argv in (["help", command], [command, "--help"]):
        assert main(argv) == 0
        out = capsys.readouterr().out
        assert all(f"\n  doo-ti {line}\n" in out for line, _ in lines) and out.endswith(f"More in docs/{page}.md\n")


@pytest.mark.parametrize(("argv", "meant"), [
    (["swep"], "did you mean sweep?"), (["render"], "did you mean synth?"), (["xyzzy"], "see doo-ti help"),
    (["relax", "a.npz", "--out", "b.npz", "--bendd", "1"], "did you mean --bend?"),
    (["help", "relex"], "did you mean relax?")])
def test_wrong_words_name_the_right_one(argv, meant, capsys):
    assert main(argv) == 2
    out, err = capsys.readouterr()
    assert not out and meant in err and err.count("\n") == 1
