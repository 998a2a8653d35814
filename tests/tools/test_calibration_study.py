"""The calibration study without its fits: specimens, variants, coverage, the CSV; and once with them, on few specimens."""

import math
from dataclasses import asdict, replace

import numpy as np
import pytest

from doo_ti.system.errors import InputError, InterruptedRunError
from tests.conftest import SEED
from tools import calibration_study as study
from tools.calibration import specimens as lab
from tools.calibration.coverage import Count, Interval, coverage, table, wilson
from tools.calibration.picture import calibration_picture
from tools.calibration.rows import Row, load_rows, row_of, save_rows
from tools.calibration.specimens import Specimen, Variant, drawn, specimen

PARAMETERS = [
    {"name": "bend", "value": 4e5, "low": 2e5, "high": None, "unit": "mm³"},
    {"name": "twist", "value": None, "low": None, "high": None, "unit": "mm³"},
    {"name": "clip_start", "value": 2.0, "low": 1.0, "high": 3.0, "unit": "mm"},
]


@pytest.fixture(scope="module")
def whole() -> Specimen:
    return specimen(SEED, Variant())


def row(seed: int, variant: Variant = Variant(), parameters=PARAMETERS, **changed) -> Row:
    return replace(row_of(seed, variant, Specimen(drawn(seed), None, 0), parameters, 1.5), **changed)


# Specimens


def test_recipes_are_the_same_every_time_and_in_range():
    recipes = [drawn(seed) for seed in range(SEED, SEED + 300)]
    assert recipes == [drawn(seed) for seed in range(SEED, SEED + 300)]
    assert drawn(SEED) != drawn(SEED + 1) and drawn(SEED) != drawn(SEED, attempt=1)
    ranges = {
        "bend": lab.BEND, "rest_curvature_rms_per_mm": lab.REST_CURVATURE_RMS,
        "rest_curvature_range_mm": lab.REST_CURVATURE_RANGE, "label_noise_mm": lab.LABEL_NOISE}
    for name, (low, high) in ranges.items():
        values = np.array([getattr(one, name) for one in recipes])
        assert low <= values.min() < low * 1.1 and high / 1.1 < values.max() <= high, name
    ratio = np.array([one.twist / one.bend for one in recipes])
    assert 0.3 <= ratio.min() < 0.35 and 1.4 < ratio.max() <= 1.5
    clips = np.array([one.clips_mm for one in recipes])
    assert set(clips.ravel()) == {1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0} and abs(np.corrcoef(clips.T)[0, 1]) < 0.2
    tilt = np.array([one.clip_tilt_deg for one in recipes])
    assert 0.35 < np.mean(tilt == 0) < 0.65 and 1.3 < tilt.max() <= lab.LARGEST_TILT_DEG
    assert 0.35 < np.mean([one.end_mark_noise for one in recipes]) < 0.65
    for name, sign in (("start_direction", 1), ("end_direction", -1)):
        directions = np.array([getattr(one, name) for one in recipes])
        np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0)
        assert (0.3 <= sign * np.arcsin(directions[:, 2])).all() and (sign * np.arcsin(directions[:, 2]) <= 0.5).all()
    yaw = np.arctan2(directions[:, 1], directions[:, 0])
    assert 0.2 <= yaw.min() and yaw.max() <= 0.4
    assert {(one.weight, one.fine_edge_mm, len(one.end_distances_mm), len(one.end_rotations_deg)) for one in recipes} == {
        (1.0, 0.5, 6, 10)}


def test_a_draw_that_cannot_be_synthesised_is_replaced_and_counted(monkeypatch, whole):
    def synthesise(recipe):
        if recipe != drawn(SEED, 2):
            raise InterruptedRunError("no stable equilibrium")
        return whole.observations

    monkeypatch.setattr(lab, "synthesise", synthesise)
    made = specimen(SEED, Variant())
    assert made.redrawn == 2 and made.recipe == drawn(SEED, 2)
    monkeypatch.setattr(lab, "MOST_DRAWS", 2)
    with pytest.raises(InterruptedRunError, match=f"specimen {SEED}: none of 2"):
        specimen(SEED, Variant())


def test_a_subset_is_of_the_whole(whole):
    few = specimen(SEED, Variant(observations=10)).observations
    assert few.count == 10 and whole.observations.count == 60
    found = [np.flatnonzero((whole.observations.vertices == one).all(axis=(1, 2))) for one in few.vertices]
    assert all(len(rows) == 1 for rows in found) and np.all(np.diff(np.concatenate(found)) > 0)


def test_missing_marks_are_invalid_and_clamps_keep_theirs(whole):
    less = specimen(SEED, Variant(missing=0.2)).observations
    missing = ~less.valid
    assert missing[:, 1:-1].mean() == pytest.approx(0.2, abs=0.03) and not missing[:, [0, -1]].any()
    assert np.isnan(less.vertices[missing]).all()
    np.testing.assert_array_equal(less.vertices[less.valid], whole.observations.vertices[less.valid])


@pytest.mark.thorough
def test_wrong_branches_have_another_shape_or_another_turn(whole):
    """As many as asked for, of both kinds over some seeds; what the clamps hold is not touched."""
    kinds = {"shape": 0, "turn": 0}
    for seed in range(SEED, SEED + 3):
        right, wrong = specimen(seed, Variant()).observations, specimen(seed, Variant(wrong_branch=4)).observations
        moved = np.linalg.norm(wrong.vertices - right.vertices, axis=2).mean(axis=1)
        turned = np.round((wrong.total_twist - right.total_twist) / (2 * np.pi), 9)
        shape, turn = moved > 0, turned != 0
        assert (shape | turn).sum() == 4 and not (shape & turn).any()
        assert (moved[shape] > lab.SAME_SHAPE).all() and (np.abs(turned[turn]) == 1).all()
        np.testing.assert_array_equal(wrong.end_frame, right.end_frame)
        kinds["shape"] += shape.sum()
        kinds["turn"] += turn.sum()
    assert min(kinds.values()) > 0, kinds


@pytest.mark.thorough
def test_variants_do_not_change_which_rods_there_are():
    both = specimen(SEED, Variant(observations=10, missing=0.2)).observations
    few = specimen(SEED, Variant(observations=10)).observations
    np.testing.assert_array_equal(both.vertices[both.valid], few.vertices[both.valid])
    assert Variant().label == "60 observations" and Variant().slug == "60"
    assert Variant(10, 0.2, 2).label == "10 observations, 20% of the marks missing, 2 on a wrong branch"
    assert Variant(10, 0.2, 2).slug == "10-missing-0.2-wrong-2"


# Coverage


@pytest.mark.parametrize(("low", "high", "holds", "bounds"), [
    (0.5, 2.0, True, 2), (1.1, 2.0, False, 2), (0.5, 0.9, False, 2), (1.0, 1.0, True, 2),
    (0.5, None, True, 1), (1.5, None, False, 1), (None, 2.0, True, 1), (None, 0.5, False, 1), (None, None, True, 0),
    (0.0, 2.0, True, 1), (-3.0, None, True, 0), (0.5, math.inf, True, 1),
])
def test_an_interval_holds_the_truth(low, high, holds, bounds):
    interval = Interval(1.0, 1.0, low, high)
    assert (interval.holds, interval.bounds) == (holds, bounds)
    assert math.isinf(interval.width) == (bounds < 2)


def test_counts_by_kind_and_widths():
    intervals = [
        Interval(1.0, 1.1, 0.9, 1.3), Interval(1.0, 1.2, 1.1, 1.3), Interval(1.0, 0.9, 0.3, 1.5), Interval(1.0, 4.0, 2.0, 10.0),
        Interval(1.0, 2.0, 0.5, None), Interval(1.0, 2.0, 1.5, None), Interval(1.0, None, None, None),
        Interval(1.0, 0.8, 0.7, 1.2),
    ]
    found = coverage(intervals)
    assert found.all == Count(5, 8) and found.two_sided == Count(3, 5) and found.wide == Count(1, 2)
    assert found.one_sided == Count(1, 2) and found.unbounded == Count(1, 1)
    logs = np.log([1.1, 1.2, 0.9, 4.0, 2.0, 2.0, 0.8])
    assert found.bias == pytest.approx(np.median(logs)) and found.off == pytest.approx(np.median(np.abs(logs)))
    assert found.width[1] in (one.width for one in intervals) and math.isinf(found.width[2]) and not found.accepted
    assert str(found.unbounded) == "1 of 1" and str(Count(0, 0)) == "none"


@pytest.mark.parametrize(("held", "accepted"), [(89, False), (90, True), (95, True), (99, True), (100, False)])
def test_coverage_is_accepted_between_its_bounds(held, accepted):
    """Intervals that always hold the truth are too wide."""
    some = [Interval(1.0, 1.0, 0.5, 2.0)] * held + [Interval(1.0, 3.0, 2.0, 4.0)] * (100 - held)
    assert coverage(some).accepted == accepted


def test_the_study_says_how_sure_it_is():
    low, high = wilson(Count(95, 100))
    assert (low, high) == (pytest.approx(0.8882, abs=1e-3), pytest.approx(0.9785, abs=1e-3))
    assert wilson(Count(10, 10))[1] == pytest.approx(1.0)


def test_the_table_has_a_line_for_each_parameter():
    found = {"bend": coverage([Interval(1.0, 1.0, 0.5, 2.0)] * 20), "twist_ratio": coverage([])}
    head, rule, bend, ratio = table(found).splitlines()
    columns = rule.count("|")
    assert head.replace("\\|", "").count("|") == bend.count("|") == ratio.count("|") == columns
    assert bend.startswith("| bend | 20 of 20 | 100.0%") and "×4 (×4 … ×4)" in bend and "**no**" in bend
    assert "not reported" in ratio


# Rows and resuming


def test_rows_are_read_as_they_were_written(tmp_path):
    file, variant = tmp_path / "rows.csv", Variant(10, 0.2, 2)
    rows = [row(3, variant), row(2), row(4, parameters=[], failure='doo-ti refine ended with 2: "x", and\nmore')]
    save_rows(file, rows)
    assert load_rows(tmp_path / "none.csv") == []
    read = load_rows(file)
    assert sorted(read, key=lambda one: one.seed) == sorted(rows, key=lambda one: one.seed)
    assert {one.key for one in read} == {(3, variant), (2, Variant()), (4, Variant())}
    back = next(one for one in read if one.seed == 2)
    assert back.interval("bend") == Interval(back.bend, 4e5, 2e5, None) and back.interval("twist").bounds == 0
    assert back.interval("twist_ratio") is None and "clip_start" not in back.fitted


def test_the_ratio_has_the_truth_of_twist_over_bend():
    some = row(5, parameters=[{"name": "twist_ratio", "value": 0.5, "low": 0.4, "high": 0.6, "unit": ""}])
    assert some.interval("twist_ratio").truth == some.twist / some.bend and some.interval("bend") is None


@pytest.mark.parametrize(("text", "said"), [("a,b\n", "columns"), ("", "columns"), ("HEAD1,2\n", "line 2")])
def test_a_file_of_something_else_is_refused(tmp_path, text, said):
    file = tmp_path / "rows.csv"
    save_rows(file, [])
    file.write_text(text.replace("HEAD", file.read_text()))
    with pytest.raises(InputError, match=said):
        load_rows(file)


class Inline:
    """A pool that works at once, in this process, and remembers what it was given."""

    def __init__(self):
        self.seeds = []

    def __enter__(self):
        return self

    def __exit__(self, *error):
        return None

    def submit(self, work, seed, variant):
        from concurrent.futures import Future

        self.seeds.append(seed)
        future = Future()
        future.set_result(row(seed, variant))
        return future


def test_rows_that_are_there_are_not_computed_again(tmp_path, monkeypatch):
    pool = Inline()
    monkeypatch.setattr(study, "process_pool", lambda workers: pool)
    file = tmp_path / "specimens.csv"
    old = row(11, parameters=[], failure="kept as it was")
    save_rows(file, [old, row(12, Variant(10))])
    found = study.completed(file, range(10, 13), Variant(), 1)
    assert pool.seeds == [10, 12] and [one.seed for one in found] == [10, 11, 12] and found[1] == old
    assert {one.key for one in load_rows(file)} == {(10, Variant()), (11, Variant()), (12, Variant()), (12, Variant(10))}
    study.completed(file, range(10, 13), Variant(), 1)
    assert pool.seeds == [10, 12]


@pytest.mark.thorough
def test_a_failed_fit_is_reported_and_fails_the_study(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(study, "specimen", lambda seed, variant: Specimen(drawn(seed), None, 1))

    def fitted(observations, folder):
        raise RuntimeError(f"doo-ti refine ended with 2: {folder}/run: cannot")

    monkeypatch.setattr(study, "fitted", fitted)
    failed = study.studied(SEED, Variant())
    assert failed.failure == "RuntimeError: doo-ti refine ended with 2: /run: cannot"
    assert failed.redrawn == 1 and not failed.fitted
    good = [row(seed, parameters=[{"name": name, "value": 1.0, "low": 1e3 if seed > 3 else None, "high": None}
                                  for name in ("bend", "twist")]) for seed in range(95)]
    bad = [row(seed, parameters=[{"name": name, "value": 1.0, "low": None, "high": 1.0} for name in ("bend", "twist")])
           for seed in range(95, 100)]
    assert study.report(good + bad, Variant(), tmp_path / "picture.png") == 0
    assert study.report([*good, *bad, failed], Variant(), tmp_path / "picture.png") == 1
    text = capsys.readouterr().out
    assert "95 of 100" in text and f"failed: seed {SEED}" in text
    assert (tmp_path / "picture.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.thorough
def test_a_picture_of_every_kind_of_interval(tmp_path):
    kinds = [Interval(1.0, 1.0, 0.5, 2.0), Interval(1.0, 1e9, 1e8, None), Interval(1.0, None, None, None),
             Interval(1.0, 9.0, None, 0.5)]
    calibration_picture(tmp_path / "one.png", {"bend": kinds, "twist": kinds[:1]}, title="intervals")
    assert (tmp_path / "one.png").stat().st_size > 10_000


@pytest.mark.parametrize("words", [
    ["--specimens", "0"], ["--seed", "-1"], ["--observations", "61"], ["--missing", "1"], ["--wrong-branch", "-1"],
    ["--workers", "0"],
])
def test_wrong_arguments_are_refused(words, capsys):
    with pytest.raises(SystemExit) as stop:
        study.main(words)
    assert stop.value.code == 2 and words[0] in capsys.readouterr().err


@pytest.mark.slow
def test_the_whole_study_on_two_specimens(tmp_path, capsys):
    words = ["--specimens", "2", "--observations", "5", "--out", str(tmp_path)]
    study.main(words)
    rows = load_rows(tmp_path / "specimens.csv")
    fitted = [not one.failure and {"bend", "twist"} <= set(one.fitted) for one in rows]
    assert fitted == [True, True], list(map(asdict, rows))
    first = capsys.readouterr().out
    assert "| bend |" in first and (tmp_path / "calibration_5.png").is_file()
    study.main(words)  # nothing is left to do, so the same is printed
    assert capsys.readouterr().out == first
