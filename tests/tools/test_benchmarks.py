"""The benchmarks with a committed baseline, on few rods: each accepts its own baseline, and reports slower cases."""

import json

import pytest

from doo_ti.lab.cases import Measurement
from tools.bench import contact, relaxation, scoring
from tools.bench.baseline import regressions, table

OLD = {"cases": {"newton": {"ratio": 1.0, "converged": 1.0}}}


@pytest.mark.parametrize(("name", "ratio", "converged", "behind"), [
    ("newton", 0.6, 0.999, False), ("newton", 9.0, 0.99, True), ("newton", 0.49, 1.0, True), ("other", 0.1, 0.5, False)])
def test_half_the_ratio_or_fewer_converged_rods_are_a_regression(name, ratio, converged, behind):
    found = {name: Measurement("rods/s", 1.0, ratio, converged, 8.0)}
    assert bool(regressions(found, OLD)) == behind
    assert table(found, OLD).endswith("| new |" if name == "other" else f"| {ratio:.2f} |")


@pytest.mark.slow
@pytest.mark.parametrize(("bench", "items", "few", "case"), [
    (relaxation, "rods", 32, "metric"), (scoring, "hypotheses", 64, "single edges"), (contact, "rods", 32, "alone")])
def test_a_baseline_of_its_own(bench, items, few, case, tmp_path, capsys, monkeypatch):
    """It has the cases of the committed one, is kept to, and is for as many items as it was made with."""
    monkeypatch.setattr("doo_ti.lab.cases.ROUND_SECONDS", 0.0)
    file, options = tmp_path / "baseline.json", [f"--{items}", str(few), "--rounds", "1", "--baseline"]
    assert bench.main([*options, str(file), "--write"]) == 0
    written, committed = json.loads(file.read_text()), json.loads(bench.BASELINE.read_text())
    assert set(written["machine"]) == {"processor", "cores", "threads"} == set(committed["machine"])
    assert set(committed["cases"]) <= set(written["cases"])
    for factor, code in ((1e-6, 0), (1e12, 1)):
        for one in written["cases"].values():
            one["ratio"] *= factor
        file.write_text(json.dumps(written))
        assert bench.main([case, *options, str(file), "--check"]) == code
    assert case in capsys.readouterr().err
    with pytest.raises(SystemExit) as stop:
        bench.main([f"--{items}", str(few // 2), "--baseline", str(file)])
    assert stop.value.code == 2 and f"{few} {items}" in capsys.readouterr().err
