"""Names with escape sequences and markup: shown as text in printouts, in bars of progress and in messages."""

import io
import sys
import time

import numpy as np
import pytest

from doo_ti.commands.cli import main
from doo_ti.system import runtime
from doo_ti.system import terminal as terminal_module
from doo_ti.system.terminal import busy, in_line, progress, visible
from tests.commands.calls import MATERIAL, write_good

NAME = "a\x1b[2J\x9b1m\u202e[red]b[/red]"
SHOWN = r"a\x1b[2J\x9b1m\u202e[red]b[/red]"


class Terminal(io.StringIO):
    """A terminal's output; rich asks whether the stream is one."""

    encoding = "utf-8"

    def isatty(self) -> bool:
        return True


def wide_terminal(monkeypatch) -> Terminal:
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.setattr(sys, "stderr", terminal := Terminal())
    return terminal


def test_visible_text():
    assert visible(NAME) == SHOWN
    assert visible("Θ ± 5 mm³\n  φ = 3°\n") == "Θ ± 5 mm³\n  φ = 3°\n" and visible("a\rb\x00") == r"a\rb\x00"


@pytest.mark.parametrize("shown", ["bar", "busy"])
def test_progress(monkeypatch, shown):
    terminal = wide_terminal(monkeypatch)
    if shown == "bar":
        with progress() as bar:
            bar.advance(bar.add_task(NAME, total=2, unit="cells"))
            bar.refresh()
    else:
        with busy(f"refining {NAME}"):
            pass
    assert SHOWN in terminal.getvalue() and "\u202e" not in terminal.getvalue()


@pytest.mark.parametrize("keep", [False, True])
def test_long_work_reports_in_lines_without_a_terminal(monkeypatch, capsys, keep):
    monkeypatch.setattr(terminal_module, "LINE_SECONDS", 0.05)
    with progress(keep=keep) as bar:
        task = bar.add_task(NAME, total=200, unit="cells")
        bar.advance(task, 1)
        time.sleep(0.06)
        bar.advance(task, 119)
        bar.advance(task, 1)
    lines = capsys.readouterr().err.splitlines()
    assert sum(f"{SHOWN}: 120 of 200 cells" in line for line in lines) == 1 and not any(": 121 of" in line for line in lines)
    with busy(f"refining {NAME}"):
        time.sleep(0.12)
    lines = capsys.readouterr().err.splitlines()
    assert lines[0].startswith(f"refining {SHOWN}: 0 s so far") and len(lines) < 4
    monkeypatch.setattr(terminal_module, "COMPILING_SECONDS", 0.05)
    with progress(keep=keep):
        for seconds in (0.0, 0.1, 0.1):
            with terminal_module.compiling():
                time.sleep(seconds)
    assert capsys.readouterr().err.count("compiling") == 1


@pytest.mark.parametrize("shown", ["bar", "busy"])
def test_a_kernel_s_first_launch_says_that_it_is_compiled(monkeypatch, shown):
    import taichi as ti

    runtime.start()

    @runtime.kernel
    def twice(values: ti.types.ndarray(dtype=ti.f32, ndim=1)):
        for k in values:
            values[k] *= 2.0
    values, terminal = np.ones(3, dtype=np.float32), wide_terminal(monkeypatch)
    with progress() if shown == "bar" else busy("growth") as bar:
        if shown == "bar":
            bar.add_task("growth", total=2, unit="edges")
        for said in (True, False):
            terminal.truncate(0)
            runtime.exclusive(twice)(values)
            assert ("compiling" in terminal.getvalue()) == said
    assert values.tolist() == [4, 4, 4] and not terminal_module._shown


@pytest.mark.parametrize("code", [0, 2])
def test_printouts_and_messages(tmp_path, capsys, code):
    folder = tmp_path / "\x1b[2J[bold]"
    folder.mkdir()
    write_good(folder)
    argv = ["relax", str(folder / ("good.npz" if code == 0 else "absent.npz")), *MATERIAL, "--out", str(folder / "out.npz")]
    assert main(argv) == code
    out, err = capsys.readouterr()
    assert r"\x1b[2J[bold]" in (err if code else out) and "\x1b" not in out + err


@pytest.mark.thorough
def test_a_name_of_several_lines_takes_one(tmp_path, capsys):
    assert in_line("a\nb\x1b") == r"a\nb\x1b"
    (tmp_path / "a\nb").mkdir()
    write_good(tmp_path / "a\nb")
    source, out = tmp_path / "a\nb" / "c\nd.npz", tmp_path / "a\nb" / "f\ng"
    (tmp_path / "a\nb" / "good.npz").rename(source)
    for argv in (["relax", str(source), *MATERIAL, "--out", f"{out}.npz"], ["convert", str(source), f"{out}.csv"],
                 ["sweep", str(source), "--bend", "6e5", "--out", str(out)], ["learn", str(out), "--out", f"{out}.tables"],
                 ["plan", str(source), "--bend", "4e5:8e5:2", "--twist", "6e5", "--out", f"{out}.plan"],
                 ["twist", str(source), *MATERIAL, "--out", f"{out}.npz"]):
        assert main(argv) == 0
        printed, err = capsys.readouterr()
        assert r"a\nb" in printed and not any(line.startswith(("b/", "d", "g")) and not line.startswith("doo-ti: ")
                                             for line in (printed + err).splitlines())
