"""A whole sweep on a small virtual lab: its files, resuming, and independence of the division into chunks."""

import json
from dataclasses import replace

import numpy as np
import pyarrow.parquet
import pytest

from doo_ti import Axis, Grid, InputError, InterruptedRunError, Observations, SweepOptions, read_landscape, sweep
from doo_ti.learning import sweeps
from tests.learning.lab import DYNAMIC, GRID, small_lab

COLUMNS = {
    "bend_1": "double", "bend_2": "double", "twist": "double", "weight": "double", "observation": "int32",
    "turns": "int32", "end_distance_mm": "double", "end_rotation_deg": "double", "distance_mm": "double",
    "energy": "double", "residual": "double", "iterations": "int32", "status": "int8", "stable": "bool",
    "precision": "int8",
}


@pytest.fixture(scope="module")
def observations() -> Observations:
    return small_lab()


@pytest.fixture
def small_chunks(monkeypatch):
    monkeypatch.setattr(sweeps, "CHUNK_BYTES", 18 * 32 * 33)  # three cells of six observations


def cells(run) -> dict[str, np.ndarray]:
    table = pyarrow.concat_tables([pyarrow.parquet.read_table(path) for path in sorted((run / "cells").glob("*.parquet"))])
    return {name: table.column(name).to_numpy() for name in table.column_names if name != "material"}


def assert_same_cells(first, second):
    one, other = cells(first), cells(second)
    assert one.keys() == other.keys()
    for name in one:
        np.testing.assert_array_equal(one[name], other[name], err_msg=name)


def test_written_files(tmp_path, observations):
    run = tmp_path / "run"
    summary = sweep(run, observations, GRID, command=["doo-ti", "sweep", "lab"])
    assert sorted(path.name for path in run.iterdir()) == [
        "cells", "landscape.png", "observations.npz", "run.rrd", "summary.json"]
    assert json.loads((run / "summary.json").read_text()) == json.loads(json.dumps(summary))
    path, = (run / "cells").glob("*.parquet")
    schema = pyarrow.parquet.read_schema(path)
    assert {name: str(schema.field(name).type) for name in COLUMNS} == COLUMNS
    assert "material" in schema.names and len(cells(run)["bend_1"]) == 12 * 6
    landscape = read_landscape(run)
    best = summary["best"]
    assert (best["bend_1"], best["twist"]) == (4e5, 4e5)
    assert best["mean_distance_mm"] == landscape.mean_distance[landscape.best] < 1
    assert summary["rods"] == {"count": 72, "converged": 72, "stable": 72}
    assert {"command", "seed", "versions", "input_sha256", "sweep_sha256"} <= summary["provenance"].keys()
    assert (run / "landscape.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


@pytest.mark.thorough
@pytest.mark.parametrize(("hint", "last", "error", "kept", "left"), [
    (True, 3, KeyboardInterrupt(), 2, 6 * 6), (False, 5, MemoryError("no more"), 0, 3 * 6 * (GRID.size - 4))])
def test_an_interrupted_sweep_resumes_and_ends_the_same(
        tmp_path, observations, small_chunks, monkeypatch, hint, last, error, kept, left):
    """Also while the hypotheses of unknown turns are tried."""
    observations = observations if hint else replace(observations, total_twist=None)
    sweep(tmp_path / "whole", observations, GRID)
    work, calls = sweeps.relax_hypotheses, []

    def interrupted(*arguments):
        calls.append(arguments)
        if len(calls) == last:
            raise error
        return work(*arguments)

    monkeypatch.setattr(sweeps, "relax_hypotheses", interrupted)
    with pytest.raises(InterruptedRunError, match=f"{error}.*doo-ti sweep 'my lab'"):
        sweep(tmp_path / "run", observations, GRID, command=["doo-ti", "sweep", "my lab"])
    assert len(list((tmp_path / "run" / "cells").glob("*.parquet"))) == kept
    monkeypatch.setattr(sweeps, "relax_hypotheses", work)
    summary = sweep(tmp_path / "run", observations, GRID)
    assert summary["timing"]["relaxed_rods"] == left
    assert_same_cells(tmp_path / "whole", tmp_path / "run")
    assert sweep(tmp_path / "run", observations, GRID) == json.loads(json.dumps(summary)), "a finished sweep is left alone"


@pytest.mark.thorough
@pytest.mark.parametrize("options", [SweepOptions(), DYNAMIC], ids=["static", "dynamic"])
def test_chunks_and_workers_change_nothing(tmp_path, observations, monkeypatch, options):
    observations = observations if options is not DYNAMIC else replace(observations, total_twist=None)
    sweep(tmp_path / "one", observations, GRID, options=options)
    monkeypatch.setattr(sweeps, "CHUNK_BYTES", 18 * 32 * 33)
    sweep(tmp_path / "chunks", observations, GRID, options=options)
    sweep(tmp_path / "workers", observations, GRID, options=replace(options, workers=2))
    assert len(list((tmp_path / "chunks" / "cells").glob("*.parquet"))) > 3
    assert_same_cells(tmp_path / "one", tmp_path / "chunks")
    assert_same_cells(tmp_path / "one", tmp_path / "workers")
    assert (tmp_path / "one" / "landscape.png").read_bytes() == (tmp_path / "workers" / "landscape.png").read_bytes()


def test_too_large_a_grid_is_reported_before_it_starts(tmp_path, observations):
    wide = Grid((Axis("bend", np.geomspace(1e5, 1e7, 30_000)), Axis("twist_ratio", np.geomspace(0.1, 6, 30_000))))
    with pytest.raises(InputError, match="900,000,000 cells"):
        sweep(tmp_path / "run", observations, wide)
    assert not (tmp_path / "run").exists()


@pytest.mark.thorough
def test_rods_that_stall_at_their_observation_do_not_win(tmp_path, capsys):
    from doo_ti.commands.cli import main
    from doo_ti.io.observation_files import save_observations

    save_observations(tmp_path / "o.npz", small_lab())
    argv = ["sweep", str(tmp_path / "o.npz"), "--bend", "4e5", "--weight", "1:1e20:5", "--out", str(tmp_path / "run")]
    assert main(argv) == 0
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert summary["best"]["weight"] == 1.0 and summary["rods_at_best"] == {"converged": 6, "stable": 6}
    out = capsys.readouterr().out
    assert summary["cells_not_competing"] > 0
    assert f"competing   {summary['cells_competing']} of 5" in out
