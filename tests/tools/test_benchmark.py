"""The benchmark's tool on a few rods: it accepts its own baseline, and reports slower cases."""

import json

import pytest

from doo_ti.bench.cases import Specimens
from tools.bench.cases import cases
from tools.bench.relaxation import BASELINE, main


@pytest.fixture(scope="module", autouse=True)
def short_rounds():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("doo_ti.bench.cases.ROUND_SECONDS", 0.0)
        yield


@pytest.fixture(scope="module")
def small(short_rounds, tmp_path_factory):
    """A baseline of few rods, written by the benchmark itself."""
    path = tmp_path_factory.mktemp("bench") / "baseline.json"
    assert main(["--rods", "32", "--rounds", "1", "--baseline", str(path), "--write"]) == 0
    return path


def rescaled(path, target, factor):
    content = json.loads(path.read_text())
    for case in content["cases"].values():
        case["ratio"] *= factor
    target.write_text(json.dumps(content))
    return str(target)


@pytest.mark.slow
def test_a_baseline_names_the_machine_and_every_case(small):
    written, committed = json.loads(small.read_text()), json.loads(BASELINE.read_text())
    assert set(written["machine"]) == {"processor", "cores", "threads"} == set(committed["machine"])
    assert list(written["cases"]) == [case.name for case in cases(Specimens(8))]
    assert set(committed["cases"]) <= set(written["cases"])


@pytest.mark.slow
def test_check_fails_only_behind_the_baseline(small, tmp_path, capsys):
    options = ["metric", "--rods", "32", "--rounds", "1", "--check", "--baseline"]
    assert main([*options, rescaled(small, tmp_path / "slow.json", 1e-6)]) == 0
    assert main([*options, rescaled(small, tmp_path / "fast.json", 1e6)]) == 1
    assert "metric" in capsys.readouterr().err


@pytest.mark.slow
def test_another_size_than_the_baseline_s_is_refused(small, capsys):
    with pytest.raises(SystemExit) as stop:
        main(["--rods", "16", "--baseline", str(small)])
    assert stop.value.code == 2
    assert "32 rods" in capsys.readouterr().err
