"""Detection of cases that are slower than the baseline allows."""

from doo_ti.bench.cases import Measurement
from tools.bench.baseline import regressions, table

BASELINE = {"cases": {"newton": {"ratio": 1.0, "converged": 1.0}}}


def test_fewer_converged_rods_are_a_regression_at_any_speed():
    assert not regressions({"newton": Measurement("rods/s", 1.0, 0.6, 0.999, 8.0)}, BASELINE)
    assert regressions({"newton": Measurement("rods/s", 1.0, 9.0, 0.99, 8.0)}, BASELINE)
    assert not regressions({"other": Measurement("rods/s", 1.0, 0.1, 0.5, 8.0)}, BASELINE)


def test_half_the_ratio_is_a_regression():
    assert regressions({"newton": Measurement("rods/s", 1.0, 0.49, 1.0, 8.0)}, BASELINE)


def test_a_case_that_the_baseline_lacks_is_new():
    lines = table({name: Measurement("rods/s", 1.0, 0.5, 1.0, 8.0) for name in ("newton", "other")}, BASELINE).splitlines()
    assert lines[2].endswith("| 0.50 |") and lines[3].endswith("| new |")
