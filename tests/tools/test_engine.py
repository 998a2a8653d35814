"""The engine's study on a few rods: every row prints, the table is well-formed, and rows without data are skipped."""

from dataclasses import replace

import numpy as np
import pytest

from doo_ti.bench import workload
from tools import engine
from tools.acceptance import table
from tools.engine import COLD, ONE, ROWS, WARM, Engine, Sizes, at_most, main, measure_rows, proportional, relaxed_in_turn

SMALL = Sizes(observations=3, cells=2, rods=24, repeats=1, hard=2, batches=(4, 16), edges=(16, 33, 48), rods_of_edges=6,
              sweep=2, sweeps=1, calls=4)


@pytest.fixture(autouse=True)
def short(monkeypatch):
    monkeypatch.setattr("doo_ti.bench.cases.ROUND_SECONDS", 0.0)
    monkeypatch.setattr("doo_ti.bench.peak.TRIPS", 1000)


def well_formed(text: str) -> bool:
    return all(line.count("|") == 5 for line in text.splitlines())


@pytest.mark.slow
@pytest.mark.parametrize("row", [row for row in ROWS if row != "speed"])
def test_a_row_prints_on_few_rods(shipped_data, row):
    study = Engine(shipped_data, SMALL)
    measure_rows(study, [row])
    assert study.checks and study.details
    assert all(check.name.startswith(row) and check.bar and check.measured for check in study.checks)
    assert well_formed(table(study.checks))
    if row in ("accuracy", "hard"):
        assert all(check.holds for check in study.checks), study.checks


@pytest.mark.slow
def test_speed_has_every_bar_and_the_peak_on_both_sides(shipped_data):
    study = Engine(shipped_data, SMALL)
    measure_rows(study, ["speed"])
    names = [check.name for check in study.checks]
    assert names == [*(f"speed: {name}" for name in engine.SPEED), f"speed: {ONE}", f"speed: {WARM}, times the cold one"]
    assert well_formed(table(study.checks))
    assert COLD in engine.SPEED and "before and after" in study.details[-1]


def test_rods_start_from_the_lab_s_observations(shipped_data):
    study = Engine(shipped_data, SMALL)
    assert [observations.count for observations in study.rods.sutures] == [3, 3, 3]
    starts, clamps = study.started("nylon")
    np.testing.assert_array_equal(study.rods.many.starts.quaternions[::3], starts.quaternions)
    np.testing.assert_array_equal(study.rods.many.clamps.end_position[::3], clamps.end_position)
    np.testing.assert_array_equal(study.rods.band.starts.quaternions, study.started("ribbon")[0].quaternions)


def test_the_command_prints_machine_table_details_and_a_missed_bar(tmp_path, monkeypatch, capsys):
    def missed(study):
        at_most(study, "memory: much", 1, [2.0, 3.0], "{:.1f} kB")

    monkeypatch.setitem(ROWS, "hard", missed)
    assert main(["hard", "--data", str(tmp_path)]) == 1
    machine, lines, details = capsys.readouterr().out.strip().split("\n\n")
    assert "cores" in machine and "taichi" in machine
    assert well_formed(lines) and lines.splitlines()[2] == "| memory: much | ≤ 1.0 kB | 2.5 kB | **no** |"
    assert details == "- memory: much: median of 2, 2.0 kB … 3.0 kB"


def test_figures_the_system_does_not_report_are_no_missed_bar(tmp_path):
    study = Engine(tmp_path, SMALL)
    at_most(study, "memory", 1, [None], "{:.1f} kB")
    assert study.checks[0].holds is None and not study.details


def test_rows_without_data_are_skipped_and_say_so(tmp_path, capsys):
    rows = [row for row in ROWS if row != "hard"]
    assert main([*rows, "--data", str(tmp_path)]) == 0
    lines = capsys.readouterr().out.strip().split("\n\n")[1].splitlines()[2:]
    assert len(lines) == len(rows) and all("skipped" in line and line.count("|") == 5 for line in lines)


def test_without_a_row_all_are_measured(tmp_path, monkeypatch):
    asked = []
    for name in ROWS:
        monkeypatch.setitem(ROWS, name, lambda study, name=name: asked.append(name))
    monkeypatch.setattr(engine.lab, "TRUTH", {})
    assert main(["--data", str(tmp_path)]) == 0 and asked == list(ROWS)


def test_an_unknown_row_is_refused(capsys):
    with pytest.raises(SystemExit) as stop:
        main(["speeds"])
    assert stop.value.code == 2
    assert "'speeds'" in capsys.readouterr().err


@pytest.mark.parametrize(("last", "holds"), [(1.15, True), (1.16, False), (0.84, False)])
def test_growth_is_judged_by_the_size_farthest_from_the_median(tmp_path, last, holds):
    study = Engine(tmp_path, SMALL)
    proportional(study, "time", "edges", {16: 9.0, 33: 1.0, 48: 1.0, 64: last}, "ns", 33)
    assert study.checks[0].holds is holds
    assert study.checks[0].name == "growth: time, 33 … 64 edges" and "16: 9.000" in study.details[0]
    assert study.checks[0].measured == f"{100 * (last - 1):+.1f} % at 64 edges"


def test_batches_take_turns_and_small_ones_are_repeated(shipped_data):
    called = []

    class Counted(workload.Rods):
        def relaxed(self, solver, precision):
            called.append(self.count)
            return super().relaxed(solver, precision)

    many = Engine(shipped_data, replace(SMALL, rods=8)).rods.many
    batches = [Counted(**vars(many.take(slice(count)))) for count in (2, 8)]
    seconds, converged, iterations = relaxed_in_turn(batches, engine.FINE, "f64", 2)
    assert called == [2, 8] + 2 * ([2] * 4 + [8])
    assert converged.tolist() == [2, 8] and (iterations > converged).all() and (seconds > 0).all()
