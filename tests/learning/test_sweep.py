"""Whole sweeps on a small virtual lab, static and dynamic (Eq. 3): files and rows, resuming, independence of chunks."""

import json
from dataclasses import replace

import numpy as np
import pyarrow.parquet
import pytest

from doo_ti import Axis, Grid, InputError, Material, Observations, SweepOptions, distance, read_landscape, relax, sweep
from doo_ti.learning import sweeps
from doo_ti.learning.experiment import Experiment, relax_cells
from doo_ti.learning.run_folder import read_experiment
from doo_ti.learning.terms import Pairs, pairs_from_labels
from doo_ti.motion.path import Motion, carry
from doo_ti.rod.start import observation_clamps, start_configuration
from tests.conftest import check_refused
from tests.learning.lab import DYNAMIC, GRID, interrupted, small_lab

COLUMNS = {
    "bend_1": "double", "bend_2": "double", "twist": "double", "weight": "double", "observation": "int32", "turns": "int32",
    "end_distance_mm": "double", "end_rotation_deg": "double", "distance_mm": "double", "energy": "double",
    "residual": "double", "iterations": "int32", "status": "int8", "stable": "bool", "precision": "int8"}


@pytest.fixture(scope="module")
def observations() -> Observations:
    return small_lab()


@pytest.fixture
def small_chunks(monkeypatch):
    monkeypatch.setattr(sweeps, "CHUNK_BYTES", 18 * 32 * 33)  # three cells of six observations


def cells(run) -> dict[str, np.ndarray]:
    table = pyarrow.concat_tables([pyarrow.parquet.read_table(path) for path in sorted((run / "cells").glob("*.parquet"))])
    return {name: table.column(name).to_numpy() for name in table.column_names if name != "material"}


def assert_same_rows(first: dict, second: dict) -> None:
    assert first.keys() == second.keys()
    for name in first:
        np.testing.assert_array_equal(first[name], second[name], err_msg=name)


def assert_same_cells(first, second) -> None:
    assert_same_rows(cells(first), cells(second))


def test_written_files(finished_sweeps):
    run, summary = finished_sweeps["static"]
    assert sorted(path.name for path in run.iterdir()) == [
        "cells", "landscape.png", "observations.npz", "run.rrd", "summary.json"]
    assert json.loads((run / "summary.json").read_text()) == json.loads(json.dumps(summary))
    path, = (run / "cells").glob("*.parquet")
    schema = pyarrow.parquet.read_schema(path)
    assert {name: str(schema.field(name).type) for name in COLUMNS} == COLUMNS
    assert "material" in schema.names and len(cells(run)["bend_1"]) == 12 * 6
    landscape, best = read_landscape(run), summary["best"]
    assert (best["bend_1"], best["twist"]) == (4e5, 4e5)
    assert best["mean_distance_mm"] == landscape.mean_distance[landscape.best] < 1
    assert summary["rods"] == {"count": 72, "converged": 72, "stable": 72}
    assert {"command", "seed", "versions", "input_sha256", "sweep_sha256"} <= summary["provenance"].keys()
    assert (run / "landscape.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


@pytest.mark.thorough
@pytest.mark.parametrize(("hint", "last", "error", "kept", "left"), [
    (True, 2, KeyboardInterrupt(), 2, 6 * 6), (False, 4, MemoryError("no more"), 0, 3 * 6 * (GRID.size - 4))])
def test_an_interrupted_sweep_resumes_and_ends_the_same(
        tmp_path, observations, small_chunks, monkeypatch, hint, last, error, kept, left):
    observations = observations if hint else replace(observations, total_twist=None)
    sweep(tmp_path / "whole", observations, GRID)
    interrupted(tmp_path / "run", monkeypatch, last, observations, error=error, said=f"{error}.*doo-ti sweep 'my lab'",
                command=["doo-ti", "sweep", "my lab"])
    assert len(list((tmp_path / "run" / "cells").glob("*.parquet"))) == kept
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


def test_too_large_a_grid_is_reported_before_it_starts_and_a_folder_that_is_no_run(tmp_path, observations):
    wide = Grid((Axis("bend", np.geomspace(1e5, 1e7, 30_000)), Axis("twist_ratio", np.geomspace(0.1, 6, 30_000))))
    check_refused("900,000,000 cells", sweep, tmp_path / "run", observations, wide)
    assert not (tmp_path / "run").exists()
    check_refused("summary.json: file", read_experiment, tmp_path)
    (tmp_path / "summary.json").write_text(json.dumps({"grid": GRID.as_dict()}))
    check_refused("summary.json", read_experiment, tmp_path)


def test_rows_are_what_eq_3_says(observations, finished_sweeps):
    """Each row of a cell computed independently: one end carried in 48 sub-steps in f64."""
    (run, summary), pairs = finished_sweeps["dynamic"], pairs_from_labels(observations)
    assert summary["pairs"] == 4 and summary["rods"] == {"count": 48, "converged": 48, "stable": 48}
    rows = cells(run)
    for cell in (0, 11):
        values = {name: value[cell] for name, value in GRID.cell_values().items()}
        material, clamps = Material(values["bend_1"], values["twist"]), observation_clamps(observations)
        at_rest = relax(start_configuration(observations, clamps), material, clamps).configuration.take(pairs.from_index)
        held = clamps.take(pairs.from_index)
        path = Motion(held, end_turn=pairs.rotation[:, None] * held.end_frame[..., 0]).states(48)
        solution, _ = carry(at_rest, material, path)
        expected = distance(solution.configuration, observations, pairs.to_index)
        off, here = distance(at_rest, observations, pairs.from_index), slice(4 * cell, 4 * cell + 4)
        np.testing.assert_array_equal(rows["from_observation"][here], pairs.from_index)
        np.testing.assert_array_equal(rows["observation"][here], pairs.to_index)
        np.testing.assert_allclose(rows["distance_mm"][here], expected, atol=1e-6)
        np.testing.assert_allclose(rows["start_distance_mm"][here], off, atol=1e-6)
        np.testing.assert_allclose(rows["energy"][here], solution.energy, rtol=1e-9)
        np.testing.assert_array_equal(rows["end_rotation_deg"][here], observations.end_rotation[pairs.to_index])
    assert (rows["jumps"] == 0).all() and (rows["pair_weight"] == 1).all() and (rows["precision"] == 64).all()


@pytest.mark.thorough
def test_the_landscape_is_the_weighted_mean(tmp_path):
    observations = small_lab()
    every, weight = pairs_from_labels(observations), np.array([3.0, 0.0, 1.0, 0.5])
    pairs = Pairs(every.from_index, every.to_index, weight, every.rotation)
    summary = sweep(tmp_path / "run", observations, GRID, options=DYNAMIC, pairs=pairs)
    assert summary["pairs"] == 3 and summary["timing"]["relaxed_rods"] == 36, "a pair of weight zero is not run"
    landscape = read_landscape(tmp_path / "run")
    assert landscape.objective == "dynamic" == summary["objective"]
    kept = weight > 0
    order = np.lexsort((every.to_index[kept], every.from_index[kept]))
    np.testing.assert_array_equal(landscape.from_observation, every.from_index[kept][order])
    np.testing.assert_array_equal(landscape.observation, every.to_index[kept][order])
    np.testing.assert_array_equal(landscape.weight, weight[kept][order])
    np.testing.assert_array_equal(landscape.end_distance, observations.end_distance[landscape.observation])
    rows = cells(tmp_path / "run")
    mean = (rows["distance_mm"] * rows["pair_weight"]).reshape(GRID.size, -1).sum(axis=1) / 4.5
    np.testing.assert_allclose(landscape.mean_distance, mean)
    assert summary["best"]["mean_distance_mm"] == landscape.mean_distance[landscape.best] == np.min(landscape.mean_distance)
    assert summary["jumps"] == {"rods": 0, "rods_at_best": 0} and landscape.jumps.shape == (GRID.size, 3)


@pytest.mark.thorough
@pytest.mark.parametrize("options", [SweepOptions(), DYNAMIC, replace(DYNAMIC, precision="f64", sub_step=0.1)])
@pytest.mark.parametrize("hint", [True, False])
def test_a_folder_is_enough_to_relax_its_cells_again(tmp_path, options, hint):
    observations = small_lab() if hint else replace(small_lab(), total_twist=None)
    sweep(tmp_path / "run", observations, GRID, options=options)
    (tmp_path / "run" / "run.rrd").unlink()
    experiment = read_experiment(tmp_path / "run")
    assert experiment.grid.as_dict() == GRID.as_dict() and experiment.options.as_dict() == Experiment(
        observations, GRID, replace(options, clamp_start=3, clamp_end=3)).options.as_dict()
    columns, rods = relax_cells(experiment, 2, 5)
    stored, terms = cells(tmp_path / "run"), experiment.terms
    assert_same_rows(columns, {name: column[2 * terms : 5 * terms] for name, column in stored.items()})
    np.testing.assert_array_equal(distance(rods, experiment.observations, columns["observation"]), columns["distance_mm"])


@pytest.mark.thorough
def test_another_set_of_pairs_is_another_sweep(tmp_path):
    observations = small_lab()
    sweep(tmp_path / "run", observations, GRID, options=DYNAMIC)
    check_refused("another sweep", sweep, tmp_path / "run", observations, GRID, options=DYNAMIC, pairs=Pairs([0], [4], [1.0]))
    check_refused("another sweep", sweep, tmp_path / "run", observations, GRID, options=replace(DYNAMIC, precision="f64"))
    check_refused("static", sweep, tmp_path / "static", observations, GRID, pairs=Pairs([0], [4], [1.0]))
    with pytest.raises(InputError, match="end_rotation_deg: "):
        sweep(tmp_path / "none", replace(observations, end_rotation=None), GRID, options=DYNAMIC)
    assert not (tmp_path / "static").exists() and not (tmp_path / "none").exists()
