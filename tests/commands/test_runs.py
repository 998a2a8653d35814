"""Finished sweeps: ``doo-ti learn`` and ``doo-ti figures``; and ``doo-ti view`` of an unfinished one, which is only read."""

import csv
import hashlib
import json
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from doo_ti import Axis, Grid, SweepOptions, read_landscape, sweep
from doo_ti.commands import runs as finished
from doo_ti.commands.cli import main
from doo_ti.io.scene import Synthesis
from doo_ti.lab.synthesis import synthesise
from tests.commands.calls import ended, refused, succeeded
from tests.commands.test_commands import write_run
from tests.learning.lab import DYNAMIC, dynamic, grid_of, interrupted, small_lab, static
from tests.record.runs import read

LABELS = np.repeat([30.0, 54.0, 78.0], 6)
PAIRS = [(6 * group + one, 6 * group + other) for group in range(3) for one in range(6) for other in range(6) if one != other]


def names(folder) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.fixture
def runs(monkeypatch, rng) -> None:
    """Runs by name: each material's bowl is lowest at its own cell, silk's pairs at another."""
    def bowl(cell, count):
        return 1 + rng.uniform(0, 0.2, (9, count)) + 0.5 * np.abs(np.arange(9) - cell)[:, None]
    built = {name: static(name, bowl(cell, 18), LABELS) for name, cell in (("nylon", 2), ("silk", 4), ("vicryl", 7))}
    built["silk_moved"] = dynamic("silk", bowl(6, len(PAIRS)), PAIRS, end_distance=LABELS)
    monkeypatch.setattr(finished, "read_landscape", lambda run: built[run.name])


def test_tables_of_the_paper(capsys, runs):
    out = succeeded(capsys, "learn nylon silk vicryl silk_moved --out new/tables")
    for words in ("Table I: leave-one-out error by material; static (Eq. 2)", "Table II: leave-one-out",
                  "Table III: leave-one-out error by objective and end distance; silk;",
                  "[ ] trained and tested on the same part", "What each training set chooses as a whole",
                  "every scored rod is a certified minimum"):
        assert words in out
    stems = ("by_material", "by_material_and_end_distance", "by_objective_and_end_distance")
    files = [f"{stem}.{suffix}" for stem in stems for suffix in ("csv", "md")]
    assert names(Path("new/tables")) == sorted([*files, "learn.json"])
    for stem, parts in zip(stems, (3, 9, 6), strict=True):
        lines = list(csv.DictReader(Path(f"new/tables/{stem}.csv").read_text().splitlines()))
        assert len(lines) == parts**2
        # Bowls differ by objective and material, so the diagonal's block holds each column's best.
        for line in lines:
            if line["is_best"] == "True":
                assert line["train"].split()[0] == line["test"].split()[0]


def test_json_says_what_the_files_say(capsys, runs):
    printed = json.loads(succeeded(capsys, "learn nylon silk --by material --out tables --json"))
    assert printed == json.loads(Path("tables/learn.json").read_text())
    assert [run["material"] for run in printed["runs"]] == ["nylon", "silk"]
    table, = printed["tables"]
    assert (table["by"], table["within"], len(table["entries"])) == (["material"], "static", 4)
    assert table["training_error_mm"]["nylon"] == pytest.approx(printed["runs"][0]["mean_distance_mm"])
    before = Path("tables/by_material.csv").read_bytes()
    succeeded(capsys, "learn nylon silk --by material --out tables --json")
    assert Path("tables/by_material.csv").read_bytes() == before


def test_partitions_are_chosen(capsys, runs):
    out = succeeded(capsys, ["learn", "nylon", "silk", "--by", "end-distance, material", "--by", "material",
                             "--end-distances", "78,30"])
    assert "nylon 30 mm" in out and "nylon 78 mm" in out and "54 mm" not in out
    assert out.index("Table II:") < out.index("Table I:")
    assert "end distance; silk static" in succeeded(capsys, ["learn", "silk"])


def test_refused_runs(capsys, tmp_path, runs):
    for argv, words in (("--by colour", ("by", "'colour' is no partition", "material, objective, end-distance")),
                        ("--end-distances near", ("--end-distances", "'near'")),
                        ("--by material --end-distances 30", ("--end-distances", "--by end-distance")),
                        (f"--out {__file__}", ("--out", "is a file"))):
        refused(capsys, tmp_path, f"learn nylon silk --out tables {argv}", *words)


def test_runs_in_folders(capsys, tmp_path, rng):
    for name in ("nylon", "silk"):
        write_run(tmp_path / name, grid_of(4), rng.uniform(1, 2, (4, 5)), name)
    out = succeeded(capsys, "learn nylon silk")
    assert "Table I:" in out and "Table II:" not in out, "without labels no table by end distance"


BENDS = np.geomspace(1e5, 4e6, 4)
RIBBON = Grid((Axis("bend_1", BENDS), Axis("bend_2", BENDS), Axis("twist", [6e5])))
ROUND = Grid((Axis("bend", BENDS), Axis("twist_ratio", [0.5, 1.0, 2.0])))
FEW = {"end_distances_mm": (42.0, 66.0), "end_rotations_deg": (0.0, 60.0, 120.0, 180.0)}


@pytest.fixture(scope="module")
def silk():
    return synthesise(Synthesis(bend=2e5, twist=1e5, name="silk", **FEW))


@pytest.fixture(scope="module")
def one_run(silk, tmp_path_factory):
    folder = tmp_path_factory.mktemp("lab")
    sweep(folder / "silk", silk, ROUND)
    return folder


@pytest.fixture(scope="module")
def lab(silk, one_run):
    """That folder with a second round rod, a ribbon under both objectives, and a sweep without end distances."""
    ribbon = synthesise(Synthesis(bend=((4e6, 0.0), (0.0, 2e5)), twist=6e5, frames=True, name="ribbon", **FEW))
    sweep(one_run / "nylon", synthesise(Synthesis(bend=1e6, twist=1e6, name="nylon", **FEW)), ROUND)
    sweep(one_run / "unlabelled", replace(silk, end_distance=None, name="unlabelled"), ROUND)
    for objective in ("static", "dynamic"):
        sweep(one_run / objective, ribbon, RIBBON, options=SweepOptions(frame_weight=6.7, objective=objective))
    return one_run


@pytest.mark.thorough
def test_round_rods(lab, capsys):
    out = Path("new/out")
    printed = succeeded(capsys, f"figures {lab}/silk {lab}/nylon --by end-distance --cells all --out {out}")
    assert names(out) == ["cells.rrd", "end_distances.png", "landscapes.png"]
    assert printed.startswith("silk; nylon: 12 cells\n") and "recorded" not in printed and str(out / "cells.rrd") in printed
    _, moving = read(out / "cells.rrd")
    for name in ("silk", "nylon"):
        landscape, rods = read_landscape(lab / name), moving[f"/world/{name}/rods"]
        assert rods["cell"]["cell"] == list(range(12))
        # The rods are those of the sweep, relaxed again.
        np.testing.assert_allclose(rods["cell"]["distance_mm"], landscape.distance, rtol=1e-6)
        # Two end distances and both together.
        assert np.array(moving[f"/landscape/{name}/cell"]["cell"]["Boxes2D:centers"]).shape == (12, 3, 2)
    mean = np.stack([read_landscape(lab / name).mean_distance for name in ("silk", "nylon")])
    relative = (mean / mean.min(axis=1, keepdims=True)).mean(axis=0)
    assert moving["/summary"]["falling_error"]["cell"] == np.argsort(-relative, kind="stable").tolist()
    assert "| silk | **" in moving["/summary"]["cell"]["TextDocument:text"][3][0]


@pytest.mark.slow
def test_a_ribbon_under_both_objectives_and_its_regimes(lab, tmp_path, capsys):
    summary = json.loads(succeeded(capsys, f"figures {lab}/static {lab}/dynamic --out {tmp_path} --observation 2 --json"))
    stems = ["regimes_ribbon_dynamic", "regimes_ribbon_static"]
    assert names(tmp_path) == ["cells.rrd", "landscapes.png", *(f"{stem}{end}" for stem in stems for end in (".png", ".rrd"))]
    assert summary["runs"] == ["ribbon, static", "ribbon, dynamic"] and summary["recorded_cells"] == 16
    assert [Path(file["path"]).name for file in summary["files"]][:2] == ["landscapes.png", "cells.rrd"]
    static, moving = read(tmp_path / "cells.rrd")
    dynamic, rods = read_landscape(lab / "dynamic"), moving["/world/ribbon__dynamic/rods"]["cell"]
    np.testing.assert_allclose(rods["distance_mm"], dynamic.distance, rtol=1e-6)
    labels = static["/world/ribbon__dynamic/rods"]["LineStrips3D:labels"][0]
    assert [int(label.split()[1].rstrip(":")) for label in labels] == dynamic.observation.tolist()
    still, bands = read(tmp_path / "regimes_ribbon_static.rrd")
    assert bands["/summary"]["observation"]["observation"] == list(range(8))
    assert bands["/summary"]["difference"]["observation"][-1] == 2
    assert [still[f"/world/ribbons/{k}/borders"]["LineStrips3D:labels"][0][0].split("\n")[0] for k in range(4)] == [
        "observed", "1: β > B₁₁ and B₂₂", "2: B₂₂ > B₁₁ > β", "3: B₁₁ > B₂₂ > β"]


@pytest.mark.thorough
def test_a_large_grid_is_thinned_and_that_is_reported(one_run, tmp_path, capsys):
    printed = succeeded(capsys, f"figures {one_run}/silk --cells 6 --out {tmp_path}")
    assert "recorded    6 cells: " in printed and "of 4 values of bend" in printed and "--cells all" in printed
    landscape = read_landscape(one_run / "silk")
    _, moving = read(tmp_path / "cells.rrd")
    rods = moving["/world/silk/rods"]["cell"]
    assert len(rods["cell"]) == 6 and landscape.best in rods["cell"]
    np.testing.assert_allclose(rods["distance_mm"], landscape.distance[rods["cell"]], rtol=1e-6)


@pytest.mark.parametrize(("runs_of", "words", "problem"), [
    ("one", "static static", "static rod"), ("one", "missing", "finished sweep"), ("one", "", "RUN"),
    ("one", "static --observation 6", "observation"), ("one", "static --observation x", "--observation"),
    ("one", "static --cells some", "--cells"), ("one", "static --by colour", "--by"),
    pytest.param("lab", "silk static", "grid", marks=pytest.mark.thorough),
    pytest.param("lab", "unlabelled --by end-distance", "end_distance_mm", marks=pytest.mark.thorough)])
def test_wrong_input_is_one_line_and_nothing_is_written(request, tmp_path, capsys, monkeypatch, runs_of, words, problem):
    folder = request.getfixturevalue("finished_sweeps" if runs_of == "one" else runs_of)
    monkeypatch.chdir(folder["static"][0].parent if runs_of == "one" else folder)
    refused(capsys, tmp_path, f"figures {words} --out {tmp_path}/out", problem)


@pytest.mark.thorough
def test_pairs_that_are_not_those_of_the_cells(lab, tmp_path, capsys):
    pairs = shutil.copytree(lab / "dynamic", "dynamic") + "/pairs.csv"
    Path(pairs).write_text("".join(Path(pairs).read_text().splitlines(keepends=True)[:-1]))
    refused(capsys, tmp_path, "figures dynamic --out out", "the cells hold")


@pytest.mark.thorough
def test_a_failure_on_the_way_keeps_finished_files(one_run, capsys, monkeypatch):
    from doo_ti.learning import figures

    def fail(*args):
        raise RuntimeError("the disk is full")
    monkeypatch.setattr(figures, "relax_cells", fail)
    assert "the disk is full" in ended(capsys, f"figures {one_run}/silk --out out", 1)[1].splitlines()[-1]
    assert names(Path("out")) == ["landscapes.png"]


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
    before, out = content(run), succeeded(capsys, f"view {run} --out new/seen")
    assert f"{cells} of 12 cells" in out and f"{100 * cells // 12} %" in out and content(run) == before
    assert names(Path("new/seen")) == ["landscape.png", "run.rrd"]
    assert {"/world/rods", "/world/observations", "/landscape/picture", "/landscape/cells"} <= entities("new/seen/run.rrd")


@pytest.mark.thorough
def test_a_window_shows_it_and_its_files_go_afterwards(tmp_path, capsys, monkeypatch):
    from doo_ti.record import viewer

    run, seen = interrupted(tmp_path / "run", monkeypatch, 1), []
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(viewer, "open_viewer", lambda folder: seen.append((folder, entities(f"{folder}/run.rrd"))))
    before = content(run)
    assert main(["view", str(run)]) == 0
    (folder, shown), = seen
    assert "/landscape/cells" in shown and content(run) == before and not (tmp_path / folder).exists()


def test_what_cannot_be_shown(tmp_path, capsys, monkeypatch):
    run, nothing = interrupted(tmp_path / "run", monkeypatch, 1), interrupted(tmp_path / "nothing", monkeypatch, 0)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.delenv("DISPLAY", raising=False)
    finished, damaged = (shutil.copytree(run, tmp_path / name) for name in ("finished", "damaged"))
    (finished / "run.rrd").touch()
    (damaged / "cells" / "plan.json").write_text("{}")
    for argv, code, words in (([nothing, "--out", tmp_path / "x"], 1, "none of 12 cells is stored yet"),
                              ([run, "--out", run / "x"], 2, "inside the run"),
                              ([finished, "--out", tmp_path / "x"], 2, "there is a recording"),
                              ([damaged, "--out", tmp_path / "x"], 2, "plan.json: file: does not describe a sweep"),
                              ([run], 1 if sys.platform == "linux" else 0, "--out FOLDER" if sys.platform == "linux" else "")):
        assert words in ended(capsys, ["view", *argv], code)[1]
    assert not (tmp_path / "x").exists() and not (run / "x").exists()
