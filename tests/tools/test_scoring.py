"""The benchmark of E_vis on a few hypotheses: it accepts its own baseline, and reports slower cases."""

import json

import pytest

from tools.bench.scoring import BASELINE, main


@pytest.fixture(scope="module", autouse=True)
def short_rounds():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("doo_ti.bench.cases.ROUND_SECONDS", 0.0)
        yield


@pytest.fixture(scope="module")
def small(short_rounds, tmp_path_factory):
    """A baseline of few hypotheses, written by the benchmark itself."""
    path = tmp_path_factory.mktemp("bench") / "scoring.json"
    assert main(["--hypotheses", "64", "--rounds", "1", "--baseline", str(path), "--write"]) == 0
    return path


@pytest.mark.slow
def test_all_converge_and_the_committed_baseline_has_the_same_cases(small):
    written, committed = json.loads(small.read_text()), json.loads(BASELINE.read_text())
    assert list(written["cases"]) == list(committed["cases"])
    assert all(case["converged"] == 1 for case in (*written["cases"].values(), *committed["cases"].values()))


@pytest.mark.slow
def test_check_fails_only_behind_the_baseline(small, tmp_path, capsys):
    for name, factor in (("slow", 1e-6), ("fast", 1e6)):
        content = json.loads(small.read_text())
        for case in content["cases"].values():
            case["ratio"] *= factor
        (tmp_path / name).write_text(json.dumps(content))
    options = ["single", "--hypotheses", "64", "--rounds", "1", "--check", "--baseline"]
    assert main([*options, str(tmp_path / "slow")]) == 0
    assert main([*options, str(tmp_path / "fast")]) == 1
    assert "single edges" in capsys.readouterr().err


@pytest.mark.slow
def test_another_size_than_the_baseline_s_is_refused(small, capsys):
    with pytest.raises(SystemExit) as stop:
        main(["--hypotheses", "16", "--baseline", str(small)])
    assert stop.value.code == 2 and "64 hypotheses" in capsys.readouterr().err
