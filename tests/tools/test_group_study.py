"""The study of random groups runs at small size."""

import pytest

from tools.studies import group_study


@pytest.mark.slow
def test_a_few_groups(capsys):
    assert group_study.main(["--groups", "4"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 6 and all("converge" in line and "iterations" in line for line in lines)
