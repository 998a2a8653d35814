"""The calibration study: its specimens, its table, and the whole of it on two specimens."""

import numpy as np
import pytest

from tools.studies import calibration_study as study
from tools.studies.calibration.coverage import Count, Interval, coverage, table, wilson


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
