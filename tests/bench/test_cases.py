"""The cases on a few rods: each runs, counts what it says, and tells how its lanes were used."""

import numpy as np
import pytest

from doo_ti.bench import cases as timed
from doo_ti.bench import clock, peak
from doo_ti.bench.cases import Case, Outcome, Specimens, cases, measure
from doo_ti.relaxation import batch

RODS = 48


@pytest.fixture(scope="module", autouse=True)
def short_rounds():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(timed, "ROUND_SECONDS", 0.0)
        yield


@pytest.fixture(scope="module")
def reference():
    return clock.Reference(1)


@pytest.fixture(scope="module")
def specimens():
    return Specimens(RODS)


@pytest.mark.parametrize("number", range(len(cases(Specimens(RODS)))))
def test_a_case_does_what_it_counts(specimens, reference, number):
    case = cases(specimens)[number]
    found = measure(case, reference, 1)
    assert found.per_second > 0 and found.ratio > 0
    if case.launches:
        assert found.converged == found.stable == 1.0
        assert found.residual <= 1e-6
        assert 0 < found.busy <= 1.001
        assert sum(found.histogram) == RODS
        assert found.iterations == pytest.approx(np.average(np.arange(len(found.histogram)), weights=found.histogram))
        assert found.gflops > 0


def test_names_are_different():
    names = [case.name for case in cases(Specimens(1))]
    assert len(set(names)) == len(names)


def test_only_rods_that_converged_count(specimens):
    solution = specimens.many.relaxed(timed.Newton(max_iterations=6), "f64")
    done = solution.converged
    assert 0 < done.sum() < RODS
    outcome = timed.converged(specimens.many, solution)
    assert (outcome.amount, outcome.converged) == (done.sum(), done.mean())
    assert outcome.residual == solution.residual[done].max()


def test_busy_lanes_are_iterations_over_trips_of_all_lanes(monkeypatch, reference):
    monkeypatch.setattr(batch, "pack_trips", {32: (10, 16), 64: (5, 8)}.__getitem__)
    case = Case("made up", "rods/s", lambda: Outcome(3.0, iterations=np.array([20, 40, 90]), flops=1e9), (32, 64))
    found = measure(case, reference, 1)
    assert found.busy == 150 / (10 * 16 + 5 * 8)
    assert found.gflops == pytest.approx(found.per_second / 3)


def test_the_peak_is_measured_in_both_precisions(monkeypatch):
    monkeypatch.setattr(peak, "TRIPS", 1000)
    found = peak.peak_gflops()
    assert set(found) == {"f32", "f64"} and min(found.values()) > 0
