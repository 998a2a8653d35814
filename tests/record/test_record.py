"""The recording, read back: entities, timelines and counts as docs/recording.md states them; without rerun none is made."""

import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import rerun
import rerun.blueprint as blueprint
from rerun.chunk import RrdReader

from doo_ti import InterruptedRunError, LandscapePlane, Observed, Status, record_sweep
from doo_ti.record import viewer
from doo_ti.record.viewer import DESCRIPTORS, FAILED, open_viewer, recording
from tests.commands.test_synth import SCENE
from tests.conftest import SEED, check_refused
from tests.processes import python
from tests.record import runs
from tests.record.runs import read

ROOT = {"/world", "/world/observations", "/world/observations/marks", "/world/headings", "/world/rods", "/summary",
        "/curves/energy/mean", "/curves/energy/median", "/curves/residual/median", "/curves/residual/largest"}
LANDSCAPE = {"/landscape/picture", "/landscape/surface", "/landscape/surface/axes", "/landscape/surface/axes/labels",
             "/landscape/surface/minimum", "/landscape/cells"}


def written(tmp_path, run) -> tuple[dict, dict]:
    record_sweep(tmp_path / "run.rrd", **run)
    assert [entry.name for entry in tmp_path.iterdir()] == ["run.rrd"]
    return read(tmp_path / "run.rrd")


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    folder, run = tmp_path_factory.mktemp("sweep"), runs.sweep(np.random.default_rng(SEED))
    return run, folder / "run.rrd", *written(folder, run)


@pytest.mark.thorough
def test_sweep_holds_the_documented_entities(swept):
    _, path, static, moving = swept
    assert set(static) | set(moving) == ROOT | LANDSCAPE | {"/__properties", "/__properties/run"}
    assert {entity: set(timelines) for entity, timelines in moving.items()} == {
        "/world/rods": {"iteration", "trial"}, "/landscape/cells": {"trial"},
        **{entity: {"iteration"} for entity in ROOT if entity.startswith("/curves")}}
    reader = RrdReader(path)
    (recording,), blueprints = reader.recordings(), reader.blueprints()
    assert (recording.application_id, recording.recording_id, len(blueprints)) == ("doo_ti", "run-1", 1)
    assert static["/__properties"]["RecordingInfo:name"] == [["made up"]]
    assert static["/__properties/run"]["seed"] == [[7]] and static["/__properties/run"]["shape"] == [["(5, 4)"]]
    text = static["/summary"]["TextDocument:text"][0][0]
    for part in ("| bend α | **10⁶ mm³** | 5.62×10⁵ … 1.78×10⁶ mm³ |", "mean distance (Eq. 1) **0.65 mm** over 6 of 6 rods",
                 "Rods: 6 converged.", "a\\|b"):
        assert part in text


@pytest.mark.thorough
def test_rods_are_instances_of_one_entity_and_lie_on_their_observations(swept):
    run, _, static, moving = swept
    rods, still = moving["/world/rods"]["iteration"], static["/world/rods"]
    assert rods["iteration"] == list(range(runs.ITERATIONS))
    strips = np.array(rods["LineStrips3D:strips"])
    assert strips.shape == (runs.ITERATIONS, runs.OBSERVATIONS, runs.VERTICES, 3)
    offset = np.array(still["offset_mm"][0])
    assert offset.shape == (runs.OBSERVATIONS, 3) and (offset[0] == 0).all()
    np.testing.assert_allclose(strips - offset[:, None], run["trajectory"].vertices, atol=1e-4)
    observed = np.array(static["/world/observations"]["LineStrips3D:strips"][0])
    assert static["/world/observations"]["offset_mm"] == still["offset_mm"]
    np.testing.assert_allclose(observed - offset[:, None], run["observed"].vertices, atol=1e-4)
    assert len(static["/world/observations/marks"]["Points3D:positions"][0]) == runs.OBSERVATIONS * runs.VERTICES
    assert len(still["LineStrips3D:colors"][0]) == runs.OBSERVATIONS
    assert still["LineStrips3D:labels"][0][3] == "observation 3: 50 mm 120°: 0.7 mm, converged"
    np.testing.assert_array_equal(moving["/world/rods"]["trial"]["LineStrips3D:strips"][0], strips[-1])


@pytest.mark.thorough
def test_a_rod_that_is_nan_is_not_drawn_and_keeps_its_place(tmp_path, rng):
    run = runs.sweep(rng)
    rods = run["trajectory"]
    rods.vertices[4:, 2, 5] = np.nan
    rods.vertices[:, 3] = np.nan
    rods.distance[[2, 3]] = np.nan
    rods.energy[4:, 2], rods.residual[4:, 2] = np.nan, np.nan
    rods.energy[:, 3], rods.residual[:, 3] = np.nan, np.nan
    rods.status[[2, 3]] = Status.NOT_FINITE, Status.INFEASIBLE
    run["observed"].vertices[1, 4] = np.nan
    static, moving = written(tmp_path, run)
    counts = np.array([[len(strip) for strip in row] for row in moving["/world/rods"]["iteration"]["LineStrips3D:strips"]])
    expected = np.full(counts.shape, runs.VERTICES)
    expected[4:, 2], expected[:, 3] = 0, 0
    np.testing.assert_array_equal(counts, expected)
    failed, colors = int.from_bytes(bytes(FAILED)), static["/world/rods"]["LineStrips3D:colors"][0]
    assert [color >> 8 == failed for color in colors] == [False, False, True, True, False, False]
    assert [len(strip) for strip in static["/world/observations"]["LineStrips3D:strips"][0]] == [9, 8, 9, 9, 9, 9]
    for entity in (name for name in ROOT if name.startswith("/curves")):
        assert np.isfinite(np.array(moving[entity]["iteration"]["Scalars:scalars"])).all()
    assert "1 not finite" in static["/summary"]["TextDocument:text"][0][0]


@pytest.mark.thorough
def test_curves_are_statistics_over_the_rods(tmp_path, rng):
    run = runs.sweep(rng)
    rods = run["trajectory"]
    rods.energy[0], rods.residual[0] = np.nan, np.nan
    rods.residual[1:, 2] *= 100
    rods.energy[9:, 4] = np.nan
    held = rods.energy.copy()
    held[9:, 4] = held[8, 4]
    static, moving = written(tmp_path, run)
    expected = {
        "energy/mean": held[1:].mean(axis=1), "energy/median": np.median(held[1:], axis=1),
        "residual/median": np.log10(np.median(rods.residual[1:], axis=1)), "residual/largest": np.log10(rods.residual[1:, 2])}
    for entity, values in expected.items():
        curve = moving[f"/curves/{entity}"]["iteration"]
        assert curve["iteration"] == list(range(1, runs.ITERATIONS))
        np.testing.assert_allclose(np.array(curve["Scalars:scalars"])[:, 0], values, rtol=1e-12)
        unit = "log10" if entity.startswith("residual") else "mm"
        assert unit in static[f"/curves/{entity}"]["SeriesLines:names"][0][0]


@pytest.mark.thorough
def test_landscape_picture_surface_and_cells(swept):
    run, _, static, moving = swept
    landscape = run["plane"].grid
    (picture,) = static["/landscape/picture"]["Image:format"][0]
    assert (picture["width"], picture["height"]) == (1600, 1200)
    assert len(static["/landscape/picture"]["Image:buffer"][0][0]) == 3 * 1600 * 1200
    evaluated, quads = runs.BENDS * runs.RATIOS - 1, (runs.BENDS - 1) * (runs.RATIOS - 1) - 1
    surface = static["/landscape/surface"]
    points = np.array(surface["Mesh3D:vertex_positions"][0])
    assert points.shape == (evaluated, 3) and np.isfinite(points).all()
    triangles = np.array(surface["Mesh3D:triangle_indices"][0])
    assert triangles.shape == (2 * quads, 3) and triangles.max() == evaluated - 1
    cells, missing = moving["/landscape/cells"]["trial"], int(np.flatnonzero(np.isnan(landscape.reshape(-1)))[0])
    assert cells["trial"] == [trial for trial in range(runs.BENDS * runs.RATIOS) if trial != missing]
    places, values = np.array(cells["Points3D:positions"])[:, 0], landscape.reshape(-1)[cells["trial"]]
    np.testing.assert_allclose(places[:, 2], 0.6 * values / np.nanmax(landscape), rtol=1e-6)
    first, second, _ = np.unravel_index(cells["trial"], landscape.shape)
    np.testing.assert_allclose(places[:, 0], first / (runs.BENDS - 1), atol=1e-6)
    np.testing.assert_allclose(places[:, 1], second / (runs.RATIOS - 1), atol=1e-6)
    assert static["/landscape/surface/minimum"]["Points3D:labels"] == [["0.5 mm"]]


def test_a_relaxation_has_no_landscape_and_one_free_axis_cells_on_a_line_and_no_surface(tmp_path, rng):
    run = runs.relaxation(rng)
    static, moving = written(tmp_path, run | {"observed": Observed(run["observed"].vertices), "properties": {}})
    assert set(static) | set(moving) == ROOT | {"/__properties"} and set(moving["/world/rods"]) == {"iteration"}
    run, cells = runs.sweep(rng), runs.Grid((runs.Axis("bend", np.geomspace(1e5, 1e7, runs.BENDS)),))
    run |= {"plane": LandscapePlane.of(cells.picture_axes, run["plane"].grid[:, 1:2], (2, 0, 0)), "intervals": ()}
    static, moving = written(tmp_path, run)
    assert "/landscape/surface" not in static and len(moving["/landscape/cells"]["trial"]["trial"]) == runs.BENDS


@pytest.mark.thorough
def test_same_run_same_recording(tmp_path, swept):
    run, _, first, moving = swept
    second, moving_again = written(tmp_path, run)
    for entity, columns in first.items():
        for name in columns.keys() - {"RecordingInfo:start_time", "rerun.controls.RowId"}:
            assert columns[name] == second[entity][name]
    assert moving.keys() == moving_again.keys()


@pytest.mark.parametrize("path", ["", "missing"])
def test_viewing_a_folder_without_recording_is_an_input_error(tmp_path, path):
    check_refused("run.rrd: there is no recording", open_viewer, tmp_path / path)


def test_viewer_listens_on_this_machine_only_and_reports_nothing(tmp_path, monkeypatch):
    calls = []

    def started(command, *, env, stderr):
        calls.append((command, env))
        return SimpleNamespace(wait=lambda timeout=None: 0, poll=lambda: 0, terminate=lambda: None)
    monkeypatch.setattr(viewer.subprocess, "Popen", started)
    (tmp_path / "run.rrd").touch()
    viewer.open_viewer(tmp_path)
    ((command, environment),) = calls
    assert command[command.index("--bind") + 1] == "127.0.0.1" and command[-1] == str(tmp_path / "run.rrd")
    assert environment["CI"] == "true" and environment["HTTPS_PROXY"].startswith("http://127.0.0.1:")


@pytest.mark.thorough
@pytest.mark.skipif(sys.platform != "linux", reason="other systems have one display, which is there")
def test_a_viewer_without_a_window_is_an_error(tmp_path, rng, monkeypatch, capfd):
    record_sweep(tmp_path / "run.rrd", **runs.sweep(rng))
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setenv("DISPLAY", ":4242")
    with pytest.raises(InterruptedRunError, match="DISPLAY"):
        open_viewer(tmp_path)
    assert capfd.readouterr().err == ""


LAYOUT = blueprint.Blueprint(blueprint.Spatial3DView())
# A limit on the size of files stands for a full disk.
FULL = """
import resource, sys
import numpy as np, rerun, rerun.blueprint as blueprint
from doo_ti.record.viewer import recording

resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, 50_000))
try:
    with recording(sys.argv[1], "id", "name", blueprint.Blueprint(blueprint.Spatial3DView())) as stream:
        for step in range(20):
            stream.set_time("step", sequence=step)
            stream.log("points", rerun.Points3D(np.random.default_rng(step).normal(size=(5000, 3))))
except OSError as error:
    print(error.filename)
"""


def logged(stream, value: float) -> None:
    for step in range(10):
        stream.set_time("step", sequence=step)
        stream.log("points", rerun.Points3D(np.full((100, 3), value + step)))


@pytest.mark.thorough
@pytest.mark.skipif(not DESCRIPTORS.is_dir(), reason="rerun writes by itself here")
def test_a_full_disk_ends_a_recording_in_one_error(tmp_path):
    done = python("-c", FULL, tmp_path / "run.rrd")
    assert (done.returncode, done.stdout, done.stderr) == (0, f"{tmp_path / 'run.rrd'}\n", "")
    assert list(tmp_path.iterdir()) == []


def test_two_recordings_of_one_name_do_not_meet(tmp_path):
    (tmp_path / "elsewhere").write_bytes(b"mine")
    path = tmp_path / "run.rrd"
    (tmp_path / "run.rrd.part").symlink_to(tmp_path / "elsewhere")
    with recording(path, "first", "first", LAYOUT) as first:
        logged(first, 0.0)
        with recording(path, "second", "second", LAYOUT) as second:
            logged(second, 100.0)
        assert [one.recording_id for one in RrdReader(path).recordings()] == ["second"]
        logged(first, 50.0)
    assert [one.recording_id for one in RrdReader(path).recordings()] == ["first"]
    assert (tmp_path / "elsewhere").read_bytes() == b"mine"
    assert sorted(each.name for each in tmp_path.iterdir()) == ["elsewhere", "run.rrd", "run.rrd.part"]


def test_a_recording_that_fails_leaves_nothing(tmp_path):
    with pytest.raises(ValueError, match="trouble"), recording(tmp_path / "run.rrd", "id", "name", LAYOUT) as stream:
        logged(stream, 0.0)
        raise ValueError("trouble")
    assert list(tmp_path.iterdir()) == []


WITHOUT = """
import importlib.metadata as metadata, sys
installed = metadata.version
def version(package):
    if package == "rerun-sdk":
        raise metadata.PackageNotFoundError(package)
    return installed(package)
metadata.version = version
sys.modules["rerun"] = None
from doo_ti.commands.cli import main
sys.exit(main(sys.argv[1:]))
"""


def without_rerun(folder: Path, *words: str) -> subprocess.CompletedProcess:
    return python("-c", WITHOUT, *words, folder=folder)


@pytest.mark.thorough
def test_a_sweep_leaves_its_recording_out_and_says_so(tmp_path):
    (tmp_path / "silk.toml").write_text(SCENE)
    done = without_rerun(tmp_path, "sweep", "silk.toml", "--out", "run")
    assert done.returncode == 0, done.stderr
    said = [line for line in done.stderr.splitlines() if "rerun" in line]
    assert len(said) == 1 and "pip install rerun-sdk" in said[0]
    assert (tmp_path / "run" / "summary.json").is_file() and not (tmp_path / "run" / "run.rrd").exists()


@pytest.mark.sampled(1)
@pytest.mark.parametrize("words", [
    ("simulate", "pendulum", "--out", "a.npz", "--recording", "a.rrd"),
    ("predict", "three_materials", "--out", "a.npz", "--recording", "a.rrd"),
    ("group", "reef_knot", "--out", "a.npz", "--recording", "a.rrd"), ("view", "run"), ("figures", "run", "--out", "pictures")])
def test_a_recording_that_is_asked_for_is_refused_in_a_line(tmp_path, words):
    (tmp_path / "run").mkdir()
    done = without_rerun(tmp_path, *words)
    assert done.returncode == 2 and "rerun" in done.stderr and len(done.stderr.splitlines()) == 1, done.stderr
    assert [path.name for path in tmp_path.rglob("*")] == ["run"]
