"""The benchmark on a few rods: what it writes it accepts, and what falls behind or converges less often it reports."""

import json

import numpy as np
import pytest

from doo_ti import Newton
from tools.bench import workload
from tools.bench.relaxation import BASELINE, Measurement, cases, main, observed, regressions


@pytest.fixture(scope="module", autouse=True)
def short_rounds():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("tools.bench.relaxation.ROUND_SECONDS", 0.0)
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


def test_a_baseline_names_the_machine_and_every_case(small):
    written, committed = json.loads(small.read_text()), json.loads(BASELINE.read_text())
    assert set(written["machine"]) == {"processor", "cores", "threads"} == set(committed["machine"])
    names = [case.name for case in cases(8)]
    assert list(written["cases"]) == names == list(committed["cases"])


def test_check_fails_only_behind_the_baseline(small, tmp_path, capsys):
    options = ["metric", "--rods", "32", "--rounds", "1", "--check", "--baseline"]
    assert main([*options, rescaled(small, tmp_path / "slow.json", 1e-6)]) == 0
    assert main([*options, rescaled(small, tmp_path / "fast.json", 1e6)]) == 1
    assert "metric" in capsys.readouterr().err


def test_fewer_converged_rods_are_a_regression_at_any_speed():
    baseline = {"cases": {"newton": {"ratio": 1.0, "converged": 1.0}}}
    assert not regressions({"newton": Measurement("rods/s", 1.0, 0.6, 0.999, 8.0)}, baseline)
    assert regressions({"newton": Measurement("rods/s", 1.0, 9.0, 0.99, 8.0)}, baseline)
    assert not regressions({"other": Measurement("rods/s", 1.0, 0.1, 0.5, 8.0)}, baseline)


def test_another_size_than_the_baseline_s_is_refused(small, capsys):
    with pytest.raises(SystemExit) as stop:
        main(["--rods", "16", "--baseline", str(small)])
    assert stop.value.code == 2
    assert "32 rods" in capsys.readouterr().err


def test_starts_take_turns_and_rods_alone_are_the_same_rods():
    tables = [workload.started(observations) for observations in observed("nylon", "silk")]
    starts, clamps = workload.in_turn(tables)
    assert starts.count == 120
    for place, (table, held) in enumerate(tables):
        np.testing.assert_array_equal(starts.quaternions[place::2], table.quaternions)
        np.testing.assert_array_equal(clamps.end_position[place::2], held.end_position)
    rods = workload.paired(starts, clamps, workload.isotropic_materials(130))
    together, alone = rods.relaxed(Newton(), "f64"), rods.alone([125, 3]).relaxed(Newton(), "f64")
    np.testing.assert_array_equal(together.energy[[125, 3]], alone.energy)
