"""``doo-ti bench``: the table, the files, and options that are wrong."""

import json
import re
import sys
import types
from dataclasses import asdict, make_dataclass

import numpy as np
import pytest

from doo_ti.bench import cases, peak, process, scaling, study
from doo_ti.cli import main
from tests.cli.test_bad_input import refused

PNG = b"\x89PNG"


@pytest.fixture(autouse=True)
def small(monkeypatch):
    """The whole command in seconds."""
    monkeypatch.setattr(cases, "ROUND_SECONDS", 0.0)
    monkeypatch.setattr(peak, "TRIPS", 1000)
    monkeypatch.setattr(process, "CALLS", 10)
    monkeypatch.setattr(scaling, "RODS", (2, 8, 32))
    monkeypatch.setattr(scaling, "EDGES", (8, 16))
    monkeypatch.setattr(scaling, "EDGES_TOGETHER", 128)


@pytest.fixture
def jax_elsewhere(monkeypatch):
    """The comparison with JAX, without JAX: a solver that is made up."""
    rate = make_dataclass("JaxRate", ["rods_per_second", "converged", "iterations", "compile_seconds"])
    module = types.ModuleType("doo_ti.bench.newton_in_jax")
    module.rate = lambda rods, bits, rounds, derivatives: rate(10.0 * bits, 1.0, 7.0, 2.0)
    monkeypatch.setitem(sys.modules, "doo_ti.bench.newton_in_jax", module)
    monkeypatch.setattr("doo_ti.options.find_spec", lambda name: object())


def test_everything_goes_into_one_table_and_one_folder(capsys, tmp_path, jax_elsewhere):
    out = tmp_path / "new" / "bench"
    assert main(["bench", "--rods", "64", "--rounds", "1", "--scaling", "--jax", "--out", str(out)]) == 0
    text, progress = capsys.readouterr()
    assert sorted(path.name for path in out.iterdir()) == ["bench.json", "histogram.png", "scaling.png"]
    assert all((out / name).read_bytes().startswith(PNG) for name in ("histogram.png", "scaling.png"))
    found = json.loads((out / "bench.json").read_text(encoding="utf-8"))
    for name, case in found["cases"].items():
        assert f"\n| {name} " in text
        assert (case["busy"] is None) == (case["gflops"] is None or "batches" in name or "one rod" in name)
    assert [(row["derivatives"], row["beside"]) for row in found["jax"]] == [
        (derivatives, row) for derivatives in ("explicit", "automatic") for row in ("newton f32", "newton f64")]
    assert found["jax"][1]["times"] == found["cases"]["newton f64"]["per_second"] / 640
    assert "JAX, derivatives written out" in text and "JAX, derivatives by autodiff" in text
    assert found["machine"]["processor"] in text
    assert [point["rods"] for point in found["scaling"]["rods"]] == [2, 8, 32]
    assert [point["edges"] for point in found["scaling"]["edges"]] == [8, 16]
    assert found["process"]["threads"][0]["threads"] == 1
    assert re.search(r"(\d+)/\1 ", progress)


def test_for_machines_it_is_one_object_and_nothing_is_written(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(study, "measured", lambda plan: {**asdict(plan), "per_second": np.float64(np.nan)})
    assert main(["bench", "--rods", "32", "--rounds", "2", "--threads", "1", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found == {"rods": 32, "rounds": 2, "threads": 1, "scaling": False, "jax": False, "per_second": None}
    assert not list(tmp_path.iterdir())


WRONG = {
    "rods no number": (["--rods", "many"], "--rods", "'many'"),
    "no rods": (["--rods", "0"], "--rods", "below 1"),
    "more rods than memory": (["--rods", "1000000000000"], "--rods", "above"),
    "no threads": (["--threads", "0"], "--threads", "below 1"),
    "more threads than cores": (["--threads", "100000"], "--threads", "above"),
    "no rounds": (["--rounds", "0"], "--rounds", "below 1"),
    "rounds without end": (["--rounds", "1000001"], "--rounds", "above 1000"),
    "unknown option": (["--fast"], "--fast", "unknown option"),
    "an argument": (["scenes"], "scenes", "unexpected argument"),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_options(capsys, tmp_path, case):
    words, *expected = WRONG[case]
    refused(capsys, tmp_path, ["bench", "--out", str(tmp_path / "new"), *words], *expected)


def test_jax_that_is_not_installed(capsys, tmp_path, monkeypatch):
    monkeypatch.setattr("doo_ti.options.find_spec", lambda name: None)
    argv = ["bench", "--jax", "--out", str(tmp_path / "new")]
    refused(capsys, tmp_path, argv, "--jax", "not installed", "pip install")


def test_a_folder_that_cannot_be(capsys, tmp_path):
    (tmp_path / "file").write_text("")
    refused(capsys, tmp_path, ["bench", "--out", str(tmp_path / "file" / "bench")], "--out", "below it")
