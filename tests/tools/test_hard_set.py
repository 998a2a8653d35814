"""The hard set on a few rods: it runs, its rods are always the same, and its exit code reports misses."""

from dataclasses import replace

import numpy as np
import pytest

from doo_ti import Newton
from doo_ti.relaxation.newton import TOLERANCES
from tools import hard_set
from tools.hard_set import PRECISIONS, ROWS, Line, Rods, main, measured, percent, rods_of


@pytest.mark.thorough
def test_every_row_has_a_line_for_each_precision(capsys):
    assert main(["--rods", "4"]) == 0
    head, rule, *lines = capsys.readouterr().out.strip().splitlines()
    assert head.startswith("| rods | precision | converged | certified stable | feasible | worst residual | worst edge")
    assert len(lines) == len(ROWS) * len(PRECISIONS)
    assert all(line.count("|") == head.count("|") == rule.count("|") for line in lines)
    assert [line.split("|")[1].strip() for line in lines[::3]] == [f"{row}, 4" for row in ROWS]


def test_rows_can_be_named_by_a_part(capsys):
    assert main(["turns", "98.95", "--rods", "2"]) == 0
    lines = capsys.readouterr().out.strip().splitlines()[2:]
    assert [line.split("|")[1].split(",")[0].strip() for line in lines[::3]] == ["ends 98.95 of 99 mm apart", "10 whole turns"]


def test_a_row_that_mixed_does_not_finish_fails(monkeypatch, capsys):
    monkeypatch.setattr(hard_set, "Newton", lambda: Newton(max_iterations=2))
    assert main(["free end", "--rods", "4"]) == 1
    mixed = capsys.readouterr().out.strip().splitlines()[3]
    assert "| mixed | **0.0 %** | 0.0 % | 100.0 % |" in mixed


def test_only_mixed_is_held_to_the_bar():
    line = Line("row", "mixed", 1000, 0.989, 0.989, 1.0, 1e-9, 1e-15, 9.0, 30, 1000)
    assert line.falls_short and not replace(line, precision="f64").falls_short
    assert not replace(line, converged=0.99).falls_short and replace(line, converged=np.nan).falls_short


def test_rods_that_no_solver_could_close_count_as_infeasible_only(monkeypatch):
    def torn(random, count: int) -> Rods:
        rods = ROWS["ends 98.95 of 99 mm apart"](random, count)
        farther = np.where(np.arange(count) % 2, 1.0, 2.0)[:, None] * rods.clamps.end_position
        return replace(rods, clamps=replace(rods.clamps, end_position=farther))

    monkeypatch.setitem(ROWS, "torn", torn)
    line = measured("torn", 6, "mixed")
    assert line.feasible == 0.5 and line.converged == 1.0 and line.in_doubles == 3
    assert line.residual <= TOLERANCES[64] and line.edge_error < 1e-10 and not line.falls_short


def test_rods_are_the_same_every_time_and_not_alike():
    for row in ROWS:
        first, again = rods_of(row, 3), rods_of(row, 3)
        np.testing.assert_array_equal(first.start.quaternions, again.start.quaternions)
        np.testing.assert_array_equal(first.material.bend, again.material.bend)
        np.testing.assert_array_equal(first.clamps.end_position, again.clamps.end_position)
        assert np.abs(first.start.quaternions[0] - first.start.quaternions[1]).max() > 1e-2
        np.testing.assert_allclose(np.linalg.norm(first.start.quaternions, axis=-1), 1.0, atol=1e-12)


def test_what_the_rows_say_of_their_rods_is_so():
    chord = np.linalg.norm(rods_of("ends 98.95 of 99 mm apart", 4).clamps.end_position, axis=1)
    np.testing.assert_allclose(chord, 98.95, rtol=1e-12)
    for row in ("collinear clamps", "collinear clamps, no weight"):
        clamps = rods_of(row, 4).clamps
        along = clamps.end_position - clamps.start_position
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        for frames in (clamps.start_frame, clamps.end_frame):
            np.testing.assert_allclose(frames[..., 0], along, atol=1e-12)
    tangents = rods_of("joints of 1.5 rad", 4).start.frames[..., 0]
    np.testing.assert_allclose(np.arccos(np.sum(tangents[:, 1:] * tangents[:, :-1], axis=2)), 1.5, rtol=1e-9)
    lengths = rods_of("rest lengths 1:50", 4).start.rest_length
    np.testing.assert_allclose(lengths.max(axis=1) / lengths.min(axis=1), 50.0)
    np.testing.assert_allclose(lengths.sum(axis=1), 99.0)
    bend = np.linalg.eigvalsh(rods_of("anisotropy 100:1", 4).material.bend[:, 0])
    np.testing.assert_allclose(bend[:, 1] / bend[:, 0], 100.0)


@pytest.mark.parametrize(("arguments", "said"), [(["--rods", "0"], "1 or more"), (["knots"], "no row is named knots")])
def test_wrong_arguments_are_refused(arguments, said, capsys):
    with pytest.raises(SystemExit) as stop:
        main(arguments)
    assert stop.value.code == 2 and said in capsys.readouterr().err


def test_a_share_is_never_rounded_up_to_all():
    assert percent(0.99999) == "99.9 %" and percent(1.0) == "100.0 %" and percent(0.99) == "99.0 %"
