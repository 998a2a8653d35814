"""tools/large_sweep.py on a small grid."""

import pytest

from tools import large_sweep


@pytest.mark.slow
def test_a_sweep_and_its_repetition_are_measured(tmp_path):
    first, again = (large_sweep.swept(tmp_path, 2, 0) for _ in range(2))
    assert (tmp_path / "run" / "summary.json").exists()
    assert 0 < again.processor < first.processor
    # A process that is started begins with the largest memory of the one that starts it, here of all tests.
    assert 50 < again.own <= first.own <= first.largest + 1
