"""`doo-ti figures` on small sweeps of the virtual lab: files, messages, refused input."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from doo_ti import Axis, Grid, SweepOptions, read_landscape, sweep
from doo_ti.commands.cli import main
from doo_ti.io.scene import Synthesis
from doo_ti.lab.synthesis import synthesise
from tests.commands.calls import refused
from tests.record.recordings import read

BENDS = np.geomspace(1e5, 4e6, 4)
RIBBON = Grid((Axis("bend_1", BENDS), Axis("bend_2", BENDS), Axis("twist", [6e5])))
ROUND = Grid((Axis("bend", BENDS), Axis("twist_ratio", [0.5, 1.0, 2.0])))


FEW = {"end_distances_mm": (42.0, 66.0), "end_rotations_deg": (0.0, 60.0, 120.0, 180.0)}


@pytest.fixture(scope="module")
def silk():
    return synthesise(Synthesis(bend=2e5, twist=1e5, name="silk", **FEW))


@pytest.fixture(scope="module")
def one_run(silk, tmp_path_factory):
    """A folder with a finished sweep of a round rod, silk."""
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


def names(folder) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.thorough
def test_round_rods(lab, tmp_path, capsys):
    out = tmp_path / "new" / "out"
    assert main(["figures", str(lab / "silk"), str(lab / "nylon"), "--by", "end-distance", "--cells", "all", "--out",
                 str(out)]) == 0
    assert names(out) == ["cells.rrd", "end_distances.png", "landscapes.png"]
    printed = capsys.readouterr().out
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
    argv = ["figures", str(lab / "static"), str(lab / "dynamic"), "--out", str(tmp_path), "--observation", "2", "--json"]
    assert main(argv) == 0
    stems = ["regimes_ribbon_dynamic", "regimes_ribbon_static"]
    assert names(tmp_path) == ["cells.rrd", "landscapes.png", *(f"{stem}{end}" for stem in stems for end in (".png", ".rrd"))]
    summary = json.loads(capsys.readouterr().out)
    assert summary["runs"] == ["ribbon, static", "ribbon, dynamic"] and summary["recorded_cells"] == 16
    assert [file["path"] for file in summary["files"]][:2] == [str(tmp_path / "landscapes.png"), str(tmp_path / "cells.rrd")]
    dynamic = read_landscape(lab / "dynamic")
    static, moving = read(tmp_path / "cells.rrd")
    rods = moving["/world/ribbon__dynamic/rods"]["cell"]
    np.testing.assert_allclose(rods["distance_mm"], dynamic.distance, rtol=1e-6)
    labels = static["/world/ribbon__dynamic/rods"]["LineStrips3D:labels"][0]
    assert [int(label.split()[1].rstrip(":")) for label in labels] == dynamic.observation.tolist()
    still, bands = read(tmp_path / "regimes_ribbon_static.rrd")
    assert bands["/summary"]["observation"]["observation"] == list(range(8))
    assert bands["/summary"]["difference"]["observation"][-1] == 2
    assert [still[f"/world/ribbons/{k}/borders"]["LineStrips3D:labels"][0][0].split("\n")[0] for k in range(4)] == [
        "observed", "1: β > B₁₁ and B₂₂", "2: B₂₂ > B₁₁ > β", "3: B₁₁ > B₂₂ > β"]


def test_a_large_grid_is_thinned_and_that_is_reported(one_run, tmp_path, capsys):
    assert main(["figures", str(one_run / "silk"), "--cells", "6", "--out", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert "recorded    6 cells: " in printed and "of 4 values of bend" in printed and "--cells all" in printed
    landscape = read_landscape(one_run / "silk")
    _, moving = read(tmp_path / "cells.rrd")
    rods = moving["/world/silk/rods"]["cell"]
    assert len(rods["cell"]) == 6 and landscape.best in rods["cell"]
    np.testing.assert_allclose(rods["distance_mm"], landscape.distance[rods["cell"]], rtol=1e-6)


def refused_runs(folder, out, capsys, words: list[str], problem: str) -> None:
    runs = [str(folder / word) if (folder / word).exists() or word == "nowhere" else word for word in words]
    refused(capsys, out.parent, ["figures", *runs, "--out", str(out)], problem)


@pytest.mark.parametrize(("words", "problem"), [
    (["silk", "silk"], "static silk"), (["missing"], "finished sweep"), (["silk", "--observation", "8"], "observation"),
    (["silk", "--observation", "x"], "--observation"), (["silk", "--cells", "some"], "--cells"),
    (["silk", "--by", "colour"], "--by"), ([], "RUN"),
])
def test_wrong_input_is_one_line_and_nothing_is_written(one_run, tmp_path, capsys, words, problem):
    refused_runs(one_run, tmp_path / "out", capsys, words, problem)


@pytest.mark.thorough
@pytest.mark.parametrize(("words", "problem"), [
    (["silk", "static"], "grid"), (["unlabelled", "--by", "end-distance"], "end_distance_mm"),
])
def test_runs_that_do_not_go_together(lab, tmp_path, capsys, words, problem):
    refused_runs(lab, tmp_path / "out", capsys, words, problem)


@pytest.mark.thorough
def test_pairs_that_are_not_those_of_the_cells(lab, tmp_path, capsys):
    run = tmp_path / "dynamic"
    shutil.copytree(lab / "dynamic", run)
    (run / "pairs.csv").write_text("".join((run / "pairs.csv").read_text().splitlines(keepends=True)[:-1]))
    assert main(["figures", str(run), "--out", str(tmp_path / "out")]) == 2
    assert "the cells hold" in capsys.readouterr().err and not (tmp_path / "out").exists()


@pytest.mark.thorough
def test_a_failure_on_the_way_keeps_finished_files(one_run, tmp_path, capsys, monkeypatch):
    from doo_ti.learning import figures

    def fail(*args):
        raise RuntimeError("the disk is full")

    monkeypatch.setattr(figures, "relax_cells", fail)
    assert main(["figures", str(one_run / "silk"), "--out", str(tmp_path / "out")]) == 1
    assert "the disk is full" in capsys.readouterr().err.splitlines()[-1]
    assert names(tmp_path / "out") == ["landscapes.png"]
