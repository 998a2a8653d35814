"""The study of the engine's speed on few rods: its table, its files, and finer rods."""

import json

import numpy as np
import pytest

from doo_ti import Newton
from doo_ti.bench import cases, peak, workload
from tools.bench import process, scaling, study
from tools.bench.cases import cases as study_cases

PNG = b"\x89PNG"


@pytest.fixture(autouse=True)
def small(monkeypatch):
    """The whole study in seconds."""
    monkeypatch.setattr(cases, "ROUND_SECONDS", 0.0)
    monkeypatch.setattr(peak, "TRIPS", 1000)
    monkeypatch.setattr(process, "CALLS", 10)
    monkeypatch.setattr(scaling, "RODS", (2, 8, 32))
    monkeypatch.setattr(scaling, "EDGES", (8, 16))
    monkeypatch.setattr(scaling, "EDGES_TOGETHER", 128)


@pytest.mark.slow
def test_everything_goes_into_one_table_and_one_folder(capsys, tmp_path):
    out = tmp_path / "new" / "bench"
    assert study.main(["--rods", "64", "--rounds", "1", "--scaling", "--out", str(out)]) == 0
    text = capsys.readouterr().out
    assert sorted(path.name for path in out.iterdir()) == ["bench.json", "histogram.png", "scaling.png"]
    assert all((out / name).read_bytes().startswith(PNG) for name in ("histogram.png", "scaling.png"))
    found = json.loads((out / "bench.json").read_text(encoding="utf-8"))
    assert list(found["cases"]) == [case.name for case in study_cases(cases.Specimens(1))]
    assert all(f"\n| {name} " in text for name in found["cases"])
    assert [point["rods"] for point in found["scaling"]["rods"]] == [2, 8, 32]
    assert [point["edges"] for point in found["scaling"]["edges"]] == [8, 16]
    assert found["process"]["threads"][0]["threads"] == 1


@pytest.mark.parametrize("words", [["--rods", "0"], ["--rounds", "0"]])
def test_wrong_options(capsys, words):
    with pytest.raises(SystemExit) as stop:
        study.main(words)
    assert stop.value.code == 2 and words[0] in capsys.readouterr().err


def test_names_are_different():
    names = [case.name for case in study_cases(cases.Specimens(1))]
    assert len(set(names)) == len(names)


@pytest.fixture(scope="module")
def sutures():
    return workload.in_turn([workload.started(seen) for seen in workload.observed(*workload.SUTURES)])


@pytest.mark.slow
@pytest.mark.parametrize("edges", [8, 33, 100])
def test_refined_starts_keep_the_length_and_nearly_the_end(sutures, edges):
    starts, clamps = sutures
    fine = scaling.refined(starts, edges)
    assert fine.edges == edges
    np.testing.assert_allclose(fine.rest_length.sum(axis=-1), starts.rest_length.sum(axis=-1))
    np.testing.assert_allclose(np.linalg.norm(fine.quaternions, axis=-1), 1.0)
    np.testing.assert_allclose(np.abs((fine.quaternions[:, 0] * starts.quaternions[:, 0]).sum(axis=-1)), 1.0, atol=0.1)
    assert np.linalg.norm(fine.vertices[:, -1] - clamps.end_position, axis=-1).max() < 10.0
    solution = workload.paired(fine, clamps, workload.isotropic_materials(60)).relaxed(Newton(), "f64")
    assert solution.converged.all()
