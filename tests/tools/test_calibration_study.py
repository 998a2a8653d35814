"""The calibration study: its specimens, its table, and the whole of it on two specimens."""

import math

import numpy as np
import pytest

from doo_ti.system.errors import InterruptedRunError
from tests.conftest import SEED
from tools.studies import calibration_study as study
from tools.studies.calibration import specimens as lab
from tools.studies.calibration.coverage import Count, Interval, coverage, table, wilson


def test_recipes_are_the_same_every_time_and_in_range():
    recipes = [lab.drawn(seed) for seed in range(SEED, SEED + 300)]
    assert recipes == [lab.drawn(seed) for seed in range(SEED, SEED + 300)]
    assert lab.drawn(SEED) != lab.drawn(SEED + 1) and lab.drawn(SEED) != lab.drawn(SEED, attempt=1)
    for name, (low, high) in {
            "bend": lab.BEND, "rest_curvature_rms_per_mm": lab.REST_CURVATURE_RMS,
            "rest_curvature_range_mm": lab.REST_CURVATURE_RANGE, "label_noise_mm": lab.LABEL_NOISE}.items():
        values = np.array([getattr(one, name) for one in recipes])
        assert low <= values.min() < low * 1.1 and high / 1.1 < values.max() <= high, name
    ratio = np.array([one.twist / one.bend for one in recipes])
    assert 0.3 <= ratio.min() < 0.35 and 1.4 < ratio.max() <= 1.5
    assert {clip for one in recipes for clip in one.clips_mm} == {1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0}


def test_a_draw_that_cannot_be_synthesised_is_replaced_and_counted(monkeypatch):
    def synthesise(recipe):
        if recipe != lab.drawn(SEED, 2):
            raise InterruptedRunError("no stable equilibrium")

    monkeypatch.setattr(lab, "synthesise", synthesise)
    made = lab.specimen(SEED)
    assert made.redrawn == 2 and made.recipe == lab.drawn(SEED, 2)
    monkeypatch.setattr(lab, "MOST_DRAWS", 2)
    with pytest.raises(InterruptedRunError, match=f"specimen {SEED}: none of 2"):
        lab.specimen(SEED)


@pytest.mark.parametrize(("low", "high", "holds", "bounds"), [
    (0.5, 2.0, True, 2), (1.1, 2.0, False, 2), (0.5, 0.9, False, 2), (1.0, 1.0, True, 2),
    (0.5, None, True, 1), (1.5, None, False, 1), (None, 2.0, True, 1), (None, 0.5, False, 1), (None, None, True, 0),
    (0.0, 2.0, True, 1), (-3.0, None, True, 0), (0.5, math.inf, True, 1),
])
def test_an_interval_holds_the_truth(low, high, holds, bounds):
    interval = Interval(1.0, 1.0, low, high)
    assert (interval.holds, interval.bounds, math.isinf(interval.width)) == (holds, bounds, bounds < 2)


def test_counts_by_kind_and_widths():
    some = [Interval(1.0, 1.1, 0.9, 1.3), Interval(1.0, 1.2, 1.1, 1.3), Interval(1.0, 0.9, 0.3, 1.5),
            Interval(1.0, 4.0, 2.0, 10.0), Interval(1.0, 2.0, 0.5, None), Interval(1.0, 2.0, 1.5, None),
            Interval(1.0, None, None, None), Interval(1.0, 0.8, 0.7, 1.2)]
    found = coverage(some)
    assert found.all == Count(5, 8) and found.two_sided == Count(3, 5) and found.wide == Count(1, 2)
    assert found.one_sided == Count(1, 2) and found.unbounded == Count(1, 1)
    assert found.bias == pytest.approx(np.median(np.log([1.1, 1.2, 0.9, 4.0, 2.0, 2.0, 0.8]))) and not found.accepted
    assert wilson(Count(95, 100)) == pytest.approx((0.8882, 0.9785), abs=1e-3)
    lines = table({"bend": found, "twist_ratio": coverage([])}).splitlines()
    assert len({line.replace("\\|", "").count("|") for line in lines}) == 1 and "5 of 8" in lines[2]


@pytest.mark.parametrize(("held", "accepted"), [(89, False), (90, True), (95, True), (99, True), (100, False)])
def test_coverage_is_accepted_between_its_bounds(held, accepted):
    """Intervals that always hold the truth are too wide."""
    some = [Interval(1.0, 1.0, 0.5, 2.0)] * held + [Interval(1.0, 3.0, 2.0, 4.0)] * (100 - held)
    assert coverage(some).accepted == accepted


@pytest.mark.slow
def test_the_whole_study_on_two_specimens(tmp_path, capsys):
    """A second run has nothing left to do and prints the same; a failed fit fails the study."""
    words = ["--specimens", "2", "--workers", "2", "--out", str(tmp_path)]
    study.main(words)
    first = capsys.readouterr().out
    assert "| bend |" in first and "failed" not in first and (tmp_path / "calibration.png").stat().st_size > 10_000
    study.main(words)
    assert capsys.readouterr().out == first
    file = tmp_path / "specimens.jsonl"
    file.write_text(file.read_text().replace('"failure": ""', '"failure": "torn"'))
    assert study.main(words) == 1 and "torn" in capsys.readouterr().out
