"""``doo-ti view`` on an unfinished sweep: the stored cells are shown, and its folder is only read."""

import hashlib
import shutil
import sys
from dataclasses import replace

import pytest

from doo_ti import InterruptedRunError, sweep
from doo_ti.commands.cli import main
from doo_ti.learning import sweeps
from tests.learning.lab import DYNAMIC, GRID, small_lab


def interrupted(run, monkeypatch, chunks: int, observations=None, **options):
    """A sweep with a given number of stored chunks."""
    work, calls = sweeps.relax_hypotheses, []

    def stopping(*arguments):
        calls.append(arguments)
        if len(calls) > chunks:
            raise KeyboardInterrupt
        return work(*arguments)

    with monkeypatch.context() as patched:
        patched.setattr(sweeps, "CHUNK_BYTES", 18 * 32 * 33)  # three cells of six rods
        patched.setattr(sweeps, "relax_hypotheses", stopping)
        with pytest.raises(InterruptedRunError):
            sweep(run, small_lab() if observations is None else observations, GRID, **options)
    return run


def content(folder) -> dict:
    return {path: (hashlib.sha256(path.read_bytes()).hexdigest(), path.stat().st_mtime_ns)
            for path in folder.rglob("*") if path.is_file()}


def entities(recording) -> set[str]:
    from rerun.chunk import RrdReader

    return {chunk.entity_path for chunk in RrdReader(recording).stream()}


@pytest.mark.thorough
@pytest.mark.parametrize(("case", "cells"), [("static", 6), ("dynamic", 8), ("hypotheses", 2)])
def test_stored_cells_are_drawn_and_nothing_in_the_folder_changes(tmp_path, capsys, monkeypatch, case, cells):
    """Under both objectives, and with three hypotheses for each observation."""
    given = {"dynamic": {"options": DYNAMIC}, "hypotheses": {"observations": replace(small_lab(), total_twist=None)}}
    run = interrupted(tmp_path / "run", monkeypatch, 2, **given.get(case, {}))
    before = content(run)
    capsys.readouterr()
    assert main(["view", str(run), "--out", str(tmp_path / "new" / "seen")]) == 0
    out = capsys.readouterr().out
    assert f"{cells} of 12 cells" in out and f"{100 * cells // 12} %" in out
    assert content(run) == before
    assert sorted(path.name for path in (tmp_path / "new" / "seen").iterdir()) == ["landscape.png", "run.rrd"]
    assert {"/world/rods", "/world/observations", "/landscape/picture", "/landscape/cells"} <= entities(
        tmp_path / "new" / "seen" / "run.rrd")


@pytest.mark.thorough
def test_a_window_shows_it_and_its_files_go_afterwards(tmp_path, capsys, monkeypatch):
    from doo_ti import record

    run, seen = interrupted(tmp_path / "run", monkeypatch, 1), []
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(record, "open_viewer", lambda folder: seen.append((folder, entities(f"{folder}/run.rrd"))))
    before = content(run)
    assert main(["view", str(run)]) == 0
    (folder, shown), = seen
    assert "/landscape/cells" in shown and content(run) == before
    assert not (tmp_path / folder).exists()


def test_what_cannot_be_shown(tmp_path, capsys, monkeypatch):
    run, nothing = interrupted(tmp_path / "run", monkeypatch, 1), interrupted(tmp_path / "nothing", monkeypatch, 0)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.delenv("DISPLAY", raising=False)
    finished, damaged = tmp_path / "finished", tmp_path / "damaged"
    shutil.copytree(run, finished)
    (finished / "run.rrd").touch()
    shutil.copytree(run, damaged)
    (damaged / "cells" / "plan.json").write_text("{}")
    for argv, code, words in (([nothing, "--out", tmp_path / "x"], 1, "none of 12 cells is stored yet"),
                              ([run, "--out", run / "x"], 2, "inside the run"),
                              ([finished, "--out", tmp_path / "x"], 2, "there is a recording"),
                              ([damaged, "--out", tmp_path / "x"], 2, "plan.json: file: does not describe a sweep"),
                              ([run], 1 if sys.platform == "linux" else 0, "--out FOLDER" if sys.platform == "linux" else "")):
        capsys.readouterr()
        assert main(["view", *map(str, argv)]) == code
        assert words in capsys.readouterr().err
    assert not (tmp_path / "x").exists() and not (run / "x").exists()
