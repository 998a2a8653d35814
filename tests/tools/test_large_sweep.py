"""tools/large_sweep.py on a small grid: what it measures."""

from tools import large_sweep


def test_a_sweep_and_its_repetition_are_measured(tmp_path):
    first, again = (large_sweep.swept(tmp_path, 2, 0) for _ in range(2))
    assert (tmp_path / "run" / "summary.json").exists()
    assert 0 < again.processor < first.processor and 50 < again.own < first.own <= first.largest + 1 < large_sweep.MOST_MB
