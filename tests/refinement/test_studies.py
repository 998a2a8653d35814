"""The studies of ``tools/refinement.py`` against their bars."""

import pytest

from tools.refinement import ROWS, exact, main


@pytest.mark.thorough
def test_rows_without_data_are_skipped_and_say_so(tmp_path, capsys):
    rows = ["specimens", "lab"]
    assert main([*rows, "--data", str(tmp_path)]) == 1  # what is skipped is not shown
    lines = capsys.readouterr().out.strip().splitlines()
    assert len(lines) == 2 + len(rows) and all("skipped" in line for line in lines[2:])


@pytest.mark.thorough
def test_rods_of_the_model_s_own_mesh_give_their_theta_back(laboratory):
    assert all(check.holds for check in exact(laboratory))


@pytest.mark.slow
@pytest.mark.parametrize("row", [row for row in ROWS if row not in ("speed", "exact")])
def test_bars(shared_data, row):
    assert all(check.holds is not False for check in ROWS[row](shared_data))
