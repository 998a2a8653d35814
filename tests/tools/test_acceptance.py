"""The acceptance study on a few rods: it runs, reports missed bars, and skips rows without data."""

from dataclasses import replace

import numpy as np
import pytest

from doo_ti import Material
from doo_ti.relaxation.relax import relax
from tests.references.rods import chain, clamps_at
from tools.acceptance import ROWS, Sizes, Study, identical, main, measure, percent, table

SMALL = Sizes(
    observations=3, search=2, cells=2, cable_cells=2, descent_iterations=20, rods=24, repeats=2, batch=24, probes=2)


def measured(folder, row: str) -> Study:
    study = Study(folder, SMALL)
    measure(study, [row])
    assert study.checks and study.details
    assert all(check.holds in (True, False) and check.measured and check.bar for check in study.checks)
    return study


@pytest.mark.thorough
def test_the_cables_are_measured_on_few_rods(shared_data):
    measured(shared_data, "cables")


@pytest.mark.thorough
@pytest.mark.parametrize("row", [row for row in ROWS if row not in ("sutures", "cables")])
def test_a_row_measures_its_bars_on_few_rods(laboratory, row):
    study = measured(laboratory, row)
    if row in ("newton", "independence"):
        assert all(check.holds for check in study.checks), study.checks


def test_descent_that_is_cut_short_is_listed(laboratory):
    study = Study(laboratory, SMALL)
    measure(study, ["descent"])
    assert not any(check.holds for check in study.checks)
    assert sum("iteration limit, not certified" in line for line in study.details) >= 4 * 3
    assert "| **no** |" in table(study.checks)


def test_rows_without_data_are_skipped_and_say_so(tmp_path, capsys):
    assert main(["--data", str(tmp_path)]) == 1
    lines = capsys.readouterr().out.strip().splitlines()
    assert len(lines) == 2 + len(ROWS) - 1  # cables only where they are named
    assert all("skipped" in line and line.count("|") == 5 for line in lines[2:])


def test_an_unknown_row_is_refused(capsys):
    with pytest.raises(SystemExit) as stop:
        main(["newtons"])
    assert stop.value.code == 2
    assert "no row 'newtons'" in capsys.readouterr().err


def test_a_single_bit_makes_a_difference():
    start = chain([[1.0, 0.1 * k, 0.0] for k in range(5)], [0, 0, 1], 3.0)
    solution = relax(start, Material(1e5, 1e5), clamps_at(start))
    assert identical(solution, [0], solution, [0]).all()
    moved = replace(solution, energy=np.nextafter(solution.energy, np.inf))
    assert not identical(solution, [0], moved, [0]).any()


def test_a_share_is_never_rounded_up_to_all():
    assert percent(np.arange(100_000) > 0) == "99.99 %"
    assert percent(np.ones(3, bool)) == "100 %"
    assert percent(np.zeros(0, bool)) == "0.00 %"
