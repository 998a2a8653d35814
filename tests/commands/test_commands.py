"""Commands on good input: what they write, print and pass on; sweeps under both objectives."""

import json
import re
import sys
import types
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow
import pyarrow.parquet
import pytest

from doo_ti import Clamp, Grid, InterruptedRunError, Status, load_observations, save_observations
from doo_ti.commands.cli import main
from doo_ti.learning.landscape import gather_landscape
from doo_ti.rod.frames import bishop_frames, unit_vectors
from tests.commands.calls import MATERIAL, made, refused, succeeded, write_good, written
from tests.learning.lab import small_lab

SCENE = """
name = "silk"
frame_weight_mm = 6.7
clamp_start = "tangent"
precision = "f64"
observations.file = "good.npz"
grid = { bend = "1e5:1e7:3", twist_ratio = 0.5 }
"""


def write_run(run, grid: Grid, distance: np.ndarray, name: str = "silk") -> None:
    """A run's folder as a sweep leaves it, in two shards, for distances (G, D)."""
    (run / "cells").mkdir(parents=True)
    cells, count = distance.shape
    columns = {key: np.repeat(value, count) for key, value in grid.cell_values().items()}
    columns |= {**dict.fromkeys(("end_distance_mm", "end_rotation_deg"), np.full(cells * count, np.nan)),
                "observation": np.tile(np.arange(count), cells), "distance_mm": distance.ravel(),
                "status": np.full(distance.size, Status.CONVERGED), "stable": np.ones(distance.size, dtype=bool)}
    table = pyarrow.table(columns).take(np.random.default_rng(1).permutation(distance.size))
    half = distance.size // 2
    pyarrow.parquet.write_table(table.slice(half), run / "cells" / "a.parquet")
    pyarrow.parquet.write_table(table.slice(0, half), run / "cells" / "b.parquet")
    (run / "summary.json").write_text(json.dumps({"grid": grid.as_dict(), "material": name}))


@pytest.fixture
def swept(monkeypatch) -> list:
    calls = []

    def sweep(run, observations, grid, *, options, pairs, command, linear_density):
        calls.append((run, observations, grid, options, command))
        write_run(run, grid, np.linspace(2, 1, grid.size)[:, None] + np.zeros(observations.count), observations.name)
        return {**gather_landscape(run, grid, observations.name, None).as_dict(), "gaps": [np.nan], "hypotheses": None,
                "timing": {"relaxed_rods": 50, "loading_s": 0.2, "relaxation_s": 0.5}}
    monkeypatch.setitem(sys.modules, "doo_ti.learning.sweeps", types.SimpleNamespace(sweep=sweep))
    return calls


def ribbon(folder: Path) -> None:
    """good.npz with measured frames, which a frame weight needs."""
    write_good(folder)
    observations, way = load_observations(folder / "good.npz"), np.array([0.31, 0.52, 0.79])
    tangents = unit_vectors(np.diff(observations.vertices, axis=1))
    across = way - np.sum(way * tangents, axis=-1, keepdims=True) * tangents
    save_observations(folder / "good.npz", replace(observations, frames=bishop_frames(tangents, across[:, 0])))


def test_sweep_of_a_file(capsys, tmp_path, swept):
    ribbon(tmp_path)
    argv = ("sweep good.npz --bend 1e5:1e7:3 --twist-ratio 0.5:2:2 --out new/run --clamp-end tangent --up -1,0,0 --workers 2 "
            "--frame-weight 1")
    out = succeeded(capsys, argv)
    (run, observations, grid, options, command), = swept
    assert run == Path("new/run") and command == ["doo-ti", *argv.split()]
    assert grid.shape == (3, 2, 1) and observations.name == "good"
    np.testing.assert_array_equal(observations.up, [-1, 0, 0])
    assert (options.clamp_start, options.clamp_end) == (None, Clamp.TANGENT)
    assert (options.frame_weight, options.precision, options.objective) == (1.0, "mixed", "static")
    assert (options.seed, options.workers) == (0, 2)
    assert "6 cells x 3 observations" in out and "1 mm" in out and "18 converged" in out
    assert "bend = 1e+07 mm³ in 3.16e+06 .. >=1e+07" in out


def test_sweep_of_several_sources(capsys, tmp_path, swept):
    ribbon(tmp_path)
    Path("scene.toml").write_text(SCENE)
    argv = "sweep good.npz scene.toml --bend 1e5:1e7:3 --out"
    out = succeeded(capsys, f"{argv} runs")
    assert [call[0] for call in swept] == [Path("runs/good"), Path("runs/silk")]
    assert "100 rods in" in out and "0.4 s to load" in out and "100 rods/s" in out
    assert len(json.loads(succeeded(capsys, f"{argv} again --json"))) == 2
    refused(capsys, tmp_path, f"{argv.replace('scene.toml', 'good.npz')} runs", "two of the name 'good'")


def test_sweep_of_a_scene_and_what_overrides_it(capsys, tmp_path, swept):
    ribbon(tmp_path)
    Path("scene.toml").write_text(SCENE)
    succeeded(capsys, "sweep scene.toml --out run")
    _, observations, grid, options, _ = swept[0]
    assert observations.name == "silk" and grid.shape == (3, 1, 1)
    assert (options.clamp_start, options.frame_weight, options.precision) == (Clamp.TANGENT, 6.7, "f64")
    out = succeeded(capsys, "sweep scene.toml --out other --bend-1 2e5 --bend-2 1e5:2e5:4 --twist 3e5 --precision mixed "
                    "--clamp-start position --frame-weight 0 --json")
    _, _, grid, options, _ = swept[1]
    assert [axis.name for axis in grid.varying] == ["bend_2"] and grid.cell_values()["twist"][0] == 3e5
    assert (options.clamp_start, options.frame_weight, options.precision) == (Clamp.POSITION, 0.0, "mixed")
    assert json.loads(out)["gaps"] == [None]


def test_view_opens_the_recording(monkeypatch):
    opened = []

    def open_viewer(path, *more):
        opened.append(path.name)
        if path.name == "broken":
            raise InterruptedRunError("no window")
    monkeypatch.setitem(sys.modules, "doo_ti.record.viewer", types.SimpleNamespace(
        **dict.fromkeys(("open_viewer", "save_screenshot", "serve_viewer"), open_viewer)))
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setenv("DISPLAY", ":0")
    for name in ("run", "broken"):
        Path(name).mkdir()
    Path("good.npz").write_bytes(b"")
    for words, code in (("run", 0), ("broken", 1), ("run --web", 0), ("run --screenshot new/f.png", 0),
                        ("run --screenshot f.jpg", 2), ("run --web --screenshot f.png", 2), ("good.npz", 2)):
        assert main(["view", *words.split()]) == code
    assert opened == ["run", "broken", "run", "run"]
    monkeypatch.delenv("DISPLAY")
    assert main(["view", "run"]) == (1 if sys.platform == "linux" else 0)


@pytest.mark.parametrize("command, work, way", [
    ("refine", "refine.run", "starts from the beginning"), ("sweep", "sweep.run_sweep", "resumes with the unfinished cells")])
@pytest.mark.parametrize("failure", [
    OSError(28, "No space left on device"), KeyboardInterrupt(), RuntimeError("no\nmemory"), MemoryError()])
def test_a_command_that_is_stopped_says_whether_it_starts_from_the_beginning(capsys, monkeypatch, command, work, way, failure):
    def fail(*args):
        raise failure
    monkeypatch.setattr(f"doo_ti.commands.{work}", fail)
    assert main([command, "source", "--out", "F.json"]) == 1
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1 and f"; the same command {way}" in err


def test_relax_writes_every_key(capsys, tmp_path):
    write_good(tmp_path)
    argv = ["relax", "good.npz", *MATERIAL, "--out", "new/F.npz"]
    text, found = succeeded(capsys, argv), written("new/F.npz")
    assert "3 rods of 8 edges" in text and "new/F.npz" in text
    assert (found["status"] == Status.CONVERGED).all() and found["stable"].all()
    np.testing.assert_allclose(np.linalg.det(found["frames"]), 1, atol=1e-9)
    per_rod = dict.fromkeys(("energy", "distance_mm", "status", "iterations", "residual", "stable"), (3,))
    assert {key: value.shape for key, value in found.items()} == {
        "vertices_mm": (3, 9, 3), "frames": (3, 8, 3, 3), "rest_length_mm": (8,), "start_force": (3, 3), "end_force": (3, 3),
        **per_rod}
    summary = json.loads(succeeded(capsys, [*argv, "--json"]))
    assert summary["status"] == {"converged": 3} and summary["bend_1"] == 6e5
    np.testing.assert_array_equal(written("new/F.npz")["vertices_mm"], found["vertices_mm"])


def test_relax_picks_the_turn_that_was_seen(tmp_path):
    write_good(tmp_path)
    np.savez("unknown.npz", **{name: key for name, key in written("good.npz").items() if name != "total_twist_deg"})
    good, unknown = (made(["relax", f"{name}.npz", *MATERIAL, "--out", "F.npz"]) for name in ("good", "unknown"))
    assert (unknown["distance_mm"] <= good["distance_mm"] + 1e-9).all()


GRID = ["--bend", "2e5:8e5:3", "--twist-ratio", "0.5:2:3"]


def written_lab(folder, **changes) -> str:
    save_observations(folder / "lab.npz", replace(small_lab(), **changes))
    return str(folder / "lab.npz")


@pytest.mark.thorough
def test_a_dynamic_sweep_reports_pairs_and_jumps(capsys, tmp_path):
    argv = ["sweep", written_lab(tmp_path), *GRID, "--objective", "dynamic", "--out", "run"]
    out = succeeded(capsys, argv)
    assert "9 cells x 4 pairs" in out and "Eq. 3" in out and "0 of 4 rods" in out and "hypotheses" not in out
    summary = json.loads(succeeded(capsys, [*argv, "--json"]))
    assert (summary["objective"], summary["pairs"], summary["jumps"]["rods"]) == ("dynamic", 4, 0)
    assert (tmp_path / "run" / "pairs.csv").read_text().startswith("from,to,weight,rotation_deg\n0,4,")


@pytest.mark.thorough
def test_pairs_of_a_file_and_of_a_scene(capsys, tmp_path):
    written_lab(tmp_path)
    Path("pairs.csv").write_text("from,to,weight\n0,2,1\n2,4,0.5\n5,1,0\n")
    Path("other.csv").write_text("from,to\n3,5\n")
    Path("scene.toml").write_text('objective = "dynamic"\npairs = "pairs.csv"\n[observations]\nfile = "lab.npz"\n'
                                  '[grid]\nbend = "2e5:8e5:3"\n')
    for more, said in (("a", "2 pairs"), ("b --objective static", "6 observations"), ("c --pairs other.csv", "1 pairs")):
        assert f"3 cells x {said}" in succeeded(capsys, f"sweep scene.toml --out {more}")


@pytest.mark.thorough
def test_settled_hypotheses_are_reported(capsys, tmp_path):
    named = [f"trial {d}" for d in range(6)]
    out = succeeded(capsys, ["sweep", written_lab(tmp_path, total_twist=None, labels=named), *GRID, "--out", "run"])
    assert re.search(r"hypotheses +18\b.*\b6 observations.*\b0\b", out)
    unknown = written_lab(tmp_path, total_twist=None, end_frame=None)
    out = succeeded(capsys, ["sweep", unknown, *GRID, "--spins", "6", "--out", "spins"])
    assert "hypotheses  108;" in out and "twist is not determined" not in out
    assert "twist is not" in succeeded(capsys, ["sweep", unknown, *GRID, "--out", "free"])


@pytest.mark.parametrize("words, expected", [
    (["--pairs", "pairs.csv"], ["--pairs", "the objective is static"]),
    (["--objective", "dynamic", "--pairs", "absent.csv"], ["absent.csv", "no such file"]),
    (["--objective", "both"], ["--objective", "'both'"]), (["--spins", "9999"], ["--roll-hypotheses", "9999"]),
    (["--spins", "12"], ["lab.npz", "spins", "no end is held by its tangent alone"])])
def test_what_makes_no_sense_is_refused(capsys, tmp_path, words, expected):
    refused(capsys, tmp_path, ["sweep", written_lab(tmp_path), *GRID, "--out", "run", *words], *expected)
