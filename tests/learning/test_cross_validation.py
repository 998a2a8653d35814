"""Leave-one-out against loops over fractions; its tables as text, Markdown, CSV and JSON."""

import csv
import io
import re
import statistics
from dataclasses import replace
from fractions import Fraction
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from doo_ti import InputError, Status
from doo_ti.learning import cross_validation
from doo_ti.learning.cross_validation import Part, Partition, chosen_cells, cross_validate, partition, usual_factors
from doo_ti.learning.landscape import plane_of
from doo_ti.learning.score_table import LISTED, comma_separated, entries, file_stem, markdown, notes, text
from doo_ti.learning.terms import Hypotheses, resolved
from doo_ti.rod.grid import Axis, Grid
from tests.conftest import check_refused
from tests.learning.lab import dynamic, grid_of, static

PAIRS = list(product(range(5), repeat=2))
PAIRS = [(x, y) for x, y in PAIRS if x != y][::2]


def whole(landscape) -> Part:
    return Part(f"{landscape.name} {landscape.objective}", landscape, np.arange(len(landscape.observation)))


def scores(*landscapes) -> cross_validation.Scores:
    return cross_validate(Partition(("material",), "", tuple(map(whole, landscapes))))


def by_loops(training: Part, tested: Part, term: int) -> int | None:
    """The cell for one tested term, by definition, in exact arithmetic."""
    learned, touched = training.landscape, set(tested.ends[term])
    kept = [k for k, ends in zip(training.terms, training.ends, strict=True)
            if not touched & set(ends) and not np.isnan(learned.distance[:, k]).all()]
    best, smallest = None, None
    for cell, row in enumerate(learned.distance):
        if not kept or np.isnan(row[kept]).any():
            continue
        error = sum(Fraction(float(row[k])) * Fraction(float(learned.weight[k])) for k in kept)
        if smallest is None or error < smallest:
            best, smallest = cell, error
    return best


def assert_as_by_loops(found, parts):
    for (row, training), (column, tested) in product(enumerate(parts), repeat=2):
        cells = [by_loops(training, tested, term) for term in range(len(tested.terms))]
        errors = [float(tested.landscape.distance[cell, term]) for cell, term in zip(cells, tested.terms, strict=True)
                  if cell is not None and not np.isnan(tested.landscape.distance[cell, term])]
        assert found.count[row, column] == len(errors) and found.left_out[row, column] == len(cells) - len(errors)
        mean = statistics.fmean(errors) if errors else np.nan
        np.testing.assert_allclose(found.mean[row, column], mean, rtol=1e-14)
        error = statistics.stdev(errors) / len(errors)**0.5 if len(errors) > 1 else np.nan
        np.testing.assert_allclose(found.standard_error[row, column], error, rtol=1e-12, atol=1e-300)
        np.testing.assert_array_equal([-1 if cell is None else cell for cell in cells], chosen_cells(training, tested.ends))


@pytest.mark.sampled(4)
@pytest.mark.parametrize("case", range(20))
def test_loops_choose_the_same_cells_ties_and_gaps_included(rng, case):
    """Eighths tie often; one in twelve is missing, one term everywhere. Of one part a single term is known, of another none."""
    rng = np.random.default_rng(rng.integers(2**32) + case)

    def distances(count):
        values = rng.integers(4, 12, (9, count)) / 8
        values[rng.random(values.shape) < 1 / 12] = np.nan
        values[:, rng.integers(count)] = np.nan
        return values
    landscapes = [static("a", distances(6)), static("b", distances(5)), dynamic("a", distances(len(PAIRS)), PAIRS),
                  static("one", rng.integers(4, 12, (9, 1)) / 8), static("none", distances(1))]
    found = scores(*landscapes)
    assert_as_by_loops(found, list(map(whole, landscapes)))
    assert found.best[-1] == -1, "nothing chooses a cell"


def test_loops_choose_the_same_cells_of_real_numbers_and_few_cells_at_a_time(rng, monkeypatch):
    monkeypatch.setattr(cross_validation, "BLOCK_BYTES", 3 * 8 * 80)
    landscapes = [static("a", rng.uniform(0, 9, (80, 7))), dynamic("a", rng.uniform(0, 9, (80, len(PAIRS))), PAIRS)]
    assert_as_by_loops(scores(*landscapes), list(map(whole, landscapes)))


def test_weights_of_pairs_count_in_training_and_in_the_score(rng):
    weight = rng.choice([0.25, 0.5, 1.0, 4.0], len(PAIRS))
    landscape = dynamic("a", rng.integers(4, 12, (9, len(PAIRS))) / 8, PAIRS, weight)
    part = whole(landscape)
    found = chosen_cells(part, part.ends)
    assert [by_loops(part, part, term) for term in range(len(PAIRS))] == found.tolist()
    mean = np.average(landscape.distance[found, part.terms], weights=weight)
    np.testing.assert_allclose(scores(landscape).mean, [[mean]])
    # Weights count by their ratios; a weight of two is not two observations, but moves mean and error alike.
    for factor in (1e-9, 1e9):
        other = scores(replace(landscape, weight=factor * weight))
        np.testing.assert_allclose(other.mean, [[mean]])
        np.testing.assert_allclose(other.standard_error, scores(landscape).standard_error)


def test_the_order_of_terms_does_not_break_ties(rng):
    """Two cells hold the same distances in another order: their sums are the same, so the first of them is chosen."""
    half = rng.uniform(0, 1, 60)
    part = whole(static("a", np.stack([half + 1, half, half[rng.permutation(60)], half[::-1]])))
    assert chosen_cells(part, np.array([[-1, -1]])).tolist() == [1]


def test_rods_that_fell_to_another_branch_are_counted():
    landscape = dynamic("a", np.ones((2, 3)), [(0, 1), (1, 2), (2, 0)])
    assert scores(landscape).jumped.tolist() == [[0]]
    moved = replace(landscape, jumps=np.array([[0, 2, 1], [0, 0, 0]]))
    assert scores(static("a", np.ones((2, 3))), moved).jumped.tolist() == [[0, 2], [0, 0]]


def test_best_and_near_in_each_column():
    base = scores(*(static(name, np.ones((2, 4))) for name in "abc"))
    found = replace(base, mean=np.array([[1.0, 2.0, 1.0], [1.1, 2.0, 2.0], [1.2, 2.2, 0.5]]),
                    standard_error=np.array([[0.1, 0.1, 0.1], [9.0, 0.3, 0.1], [9.0, 0.1, np.nan]]),
                    count=np.array([[4, 4, 4], [4, 4, 4], [4, 4, 3]]))
    assert found.is_best.tolist() == [[True, True, True], [False, True, False], [False, False, False]]
    assert found.is_near.tolist() == [[False, False, False], [True, False, False], [False, False, False]]


LABELS = np.tile([54.0, 30.0, 78.0], 4)
MOVES = [(0, 3), (3, 0), (1, 4), (4, 7), (2, 5), (5, 8)]


def lab(name: str, labels=LABELS):
    return static(name, np.ones((3, len(labels))), labels)


def moved(name: str, labels=LABELS):
    return dynamic(name, np.ones((3, len(MOVES))), MOVES, end_distance=labels)


def rows(found) -> dict[str, list[int]]:
    return {part.label: part.terms.tolist() for part in found.parts}


def test_by_material_and_end_distance_in_whatever_order_it_is_asked_for():
    labels = np.where(np.arange(12) == 4, np.nan, LABELS)
    found, = partition([lab("silk", labels), lab("nylon")], ("end-distance", "material"), (78.0, 30.0))
    assert found.by == ("material", "end-distance")
    assert rows(found) == {"silk 30 mm": [1, 7, 10], "silk 78 mm": [2, 5, 8, 11],
                           "nylon 30 mm": [1, 4, 7, 10], "nylon 78 mm": [2, 5, 8, 11]}
    assert found.unlabelled == 1


def test_by_objective_the_static_one_keeps_what_occurs_in_pairs():
    """Table III, of each material that was swept under both objectives, static before dynamic."""
    runs = [moved("silk"), lab("nylon"), lab("silk"), moved("nylon"), lab("vicryl")]
    silk, nylon = partition(runs, ("objective", "end-distance"), (30.0, 54.0))
    assert (silk.within, nylon.within) == ("silk", "nylon")
    assert rows(silk) == rows(nylon) == {"static 30 mm": [1, 4, 7], "static 54 mm": [0, 3], "dynamic 30 mm": [2, 3],
                                         "dynamic 54 mm": [0, 1]}
    tables = partition(runs, ("material",))
    assert [(found.within, list(rows(found))) for found in tables] == [
        ("static", ["silk", "nylon", "vicryl"]), ("dynamic", ["silk", "nylon"])]
    assert rows(tables[0])["silk"] == list(range(12)), "restricted beside pairs only"


@pytest.mark.parametrize(("runs", "factors"), [
    ([lab("a")], [("end-distance",)]), ([lab("a", np.full(12, np.nan))], []), ([lab("a", np.arange(12.0))], []),
    ([lab("a"), lab("b")], [("material",), ("material", "end-distance")]),
    ([lab("a", np.full(12, 30.0)), lab("b", np.full(12, 30.0))], [("material",)]),
    ([lab("a"), moved("a")], [("objective", "end-distance")]), ([lab("a"), moved("b")], [("end-distance",)]),
    ([lab("a"), lab("b"), moved("a")], [("material",), ("material", "end-distance"), ("objective", "end-distance")])])
def test_tables_without_being_asked(runs, factors):
    assert usual_factors(runs) == factors
    for by in factors:
        assert all(len(found.parts) > 1 for found in partition(runs, by))


@pytest.mark.parametrize(("runs", "by", "distances", "words"), [
    ([lab("a"), replace(lab("b"), grid=grid_of(4))], ("material",), (), "b_static: grid: another grid than that of a_static"),
    ([lab("a"), replace(lab("a"), run=Path("again"))], ("material",), (), "again: material: static a"),
    ([lab("a"), moved("a", LABELS[::-1])], ("objective",), (), "a_dynamic: observation: other observations of a"),
    ([lab("a", LABELS[:6]), moved("a")], ("objective",), (), "a_dynamic: observation: other observations of a"),
    ([lab("a"), lab("b")], ("colour",), (), "by: 'colour' is no partition; give some of material, objective, end-distance"),
    ([lab("a"), lab("b")], (), (), "by: '' is no partition"),
    ([lab("a"), lab("b")], ("material", "material"), (), "names a factor twice"),
    ([lab("a"), lab("b")], ("objective",), (), "by: objective makes no table of two parts"),
    ([lab("a"), lab("b")], ("end-distance",), (30.0, 31.0), "no observation at 31 mm; choose from 30, 54, 78"),
    ([lab("a", np.nan * LABELS)], ("end-distance",), (), "a_static: end_distance_mm: no observation has")])
def test_runs_that_cannot_be_compared_are_reported(runs, by, distances, words):
    check_refused(re.escape(words), partition, runs, by, distances)


def fooled(name: str = "nylon"):
    """Five cells of four rods, the second the best, except for the fourth, in which a rod stalled close to its observation."""
    landscape = static(name, np.array([3.0, 1.0, 2.0, 0.1, 3.0])[:, None] + np.zeros(4))
    landscape.status[3, 1] = Status.STALLED
    return landscape


def test_a_cell_with_a_rod_that_stalled_does_not_win_and_is_marked_in_the_picture():
    landscape = fooled()
    assert landscape.best == 1 and np.flatnonzero(np.isnan(landscape.mean_distance)).tolist() == [3]
    assert landscape.competition == {"cells_competing": 4, "cells_not_competing": 1, "terms_left_out": 0}
    plane = plane_of(landscape)
    assert plane.minimum == (1, 0) and plane.unfinished.ravel().tolist() == [0, 0, 0, 1, 0]
    assert np.isnan(plane.values[3, 0]) and not plane.valley[3, 0]
    interval, = landscape.intervals
    assert interval.best == landscape.grid.axes[0].values[1] and not interval.high_is_open
    # Nor does one with a saddle.
    landscape = fooled()
    landscape.status[:] = Status.CONVERGED
    stable = np.ones((5, 4), dtype=bool)
    stable[3, 0] = False
    assert replace(landscape, stable=stable).best == 1


def test_a_term_that_is_sound_in_no_cell_is_left_out():
    landscape = fooled()
    landscape.status[:, 2] = Status.ITERATION_LIMIT
    assert landscape.best == 1 and landscape.competition["terms_left_out"] == 1
    landscape = fooled()
    landscape.status[:] = Status.STALLED
    assert landscape.competition == {"cells_competing": 0, "cells_not_competing": 0, "terms_left_out": 4}
    with pytest.raises(InputError, match="certified"):
        landscape.best


def test_a_training_set_does_not_choose_it_nor_does_an_entry_win_a_column_by_rods_that_stalled():
    scores = cross_validate(partition([fooled(), static("silk", fooled().distance)], ("material",))[0])
    assert scores.best.tolist() == [1, 3] and (scores.mean[1] < scores.mean[0]).all()
    assert replace(scores, uncertified=np.array([[0, 0], [1, 0]])).is_best.tolist() == [[True, False], [False, True]]


def test_hypotheses_are_not_resolved_by_such_a_cell():
    """In the first cell the second hypothesis is right, in the other one, where rods stalled, the first."""
    hypotheses = Hypotheses(np.array([0, 0, 1]), np.array([0, 1, 0]))
    distance = np.array([[3.0, 1.0, 1.0], [0.1, 3.0, 0.1]])
    chosen, ambiguous = resolved(distance, np.array([[True, True, True], [False, False, False]]), np.ones(2), hypotheses)
    assert chosen[0].tolist() == [1, 2] and not ambiguous.any()


TWO_DISTANCES = np.repeat([30.0, 54.0], 4)


@pytest.fixture
def scored(rng):
    """Two materials at two end distances; one rod has no distance, one is no certified minimum."""
    runs = []
    for name, cell in (("nylon", 1), ("silk", 3)):
        runs.append(static(name, 1 + rng.uniform(0, 0.1, (5, 8)) + np.abs(np.arange(5) - cell)[:, None], TWO_DISTANCES))
    runs[1].distance[:, 6] = np.nan
    runs[0] = replace(runs[0], stable=np.tile(np.arange(8) != 2, (5, 1)))
    found, = partition(runs, ("material", "end-distance"))
    return cross_validate(found)


def test_text_has_aligned_columns_and_folds_where_they_do_not_fit(scored):
    wide, narrow = text(scored, 200), text(scored, 60)
    assert max(map(len, narrow.split("\n\n")[1].splitlines())) <= 60 < len(wide.split("\n\n")[1].splitlines()[0])
    lines = wide.split("\n\n")[1].splitlines()
    assert len(lines) == 5 and {line.index("±") for line in lines[1:]} == {lines[1].index("±")}
    figure = f"{scored.mean[0, 0]:.3f} ± {scored.standard_error[0, 0]:.3f}"
    assert lines[1].split("  ")[1].strip() == f"[{figure}]{'*' if scored.is_best[0, 0] else '~'}"
    for part in ("silk 54 mm", f"{scored.mean[3, 1]:.3f} ± {scored.standard_error[3, 1]:.3f}"):
        assert part in wide and part in narrow
    assert wide.count("*") - 1 == scored.is_best.sum() and wide.count("~") - 1 == scored.is_near.sum()


def test_markdown_sets_the_best_bold(scored):
    page = markdown(scored)
    assert file_stem(scored.partition.by) == "by_material_and_end_distance"
    assert page.startswith("**Table II: leave-one-out error by material and end distance; static (Eq. 2);")
    table = [line for line in page.splitlines() if line.startswith("|")][:6]
    cells = np.array([[cell.strip() for cell in line.strip("|").split("|")[1:]] for line in table[2:]])
    assert (np.char.startswith(cells, "**") == scored.is_best).all()
    assert (np.char.startswith(cells, "_") == scored.is_near).all()
    assert ((np.char.find(cells, "[") >= 0) == np.eye(4, dtype=bool)).all()


def test_csv_holds_the_numbers_in_full(scored):
    lines = list(csv.DictReader(io.StringIO(comma_separated([scored, scored]))))
    assert len(lines) == 2 * 16 and lines[:16] == lines[16:]
    for name, values in (("mean_mm", scored.mean), ("standard_error_mm", scored.standard_error), ("n", scored.count)):
        np.testing.assert_array_equal(np.array([float(line[name]) for line in lines[:16]]), values.ravel())
    assert [line["is_best"] for line in lines[:16]] == [str(best) for best in scored.is_best.ravel().tolist()]
    grid = scored.partition.parts[0].landscape.grid
    assert float(lines[0]["bend_1_mm3"]) == grid.cell_values()["bend_1"][scored.best[0]] == float(lines[3]["bend_1_mm3"])
    assert (lines[1]["within"], lines[1]["train"], lines[1]["test"]) == ("static", "nylon 30 mm", "nylon 54 mm")


def test_terms_not_certified_or_left_out_are_listed_below_the_table(scored):
    left_out, uncertified = notes(scored)
    assert re.search(r": nylon 30 mm -> silk 54 mm 1 of 4, .*silk 54 mm -> silk 54 mm 1 of 4$", left_out)
    assert "nylon 54 mm -> nylon 30 mm 1 of 4" in uncertified
    for page in (text(scored, 120), markdown(scored)):
        assert left_out in page and uncertified in page
    assert f" {16 - LISTED} " in notes(replace(scored, left_out=np.ones((4, 4), int)))[0]
    jumped = replace(scored, jumped=np.eye(4, dtype=int), partition=replace(scored.partition, unlabelled=3))
    assert "nylon 30 mm -> nylon 30 mm 1 of 4" in notes(jumped)[-1] and notes(jumped)[0].startswith("3 ")
    certified = [re.findall(r"\d of \d", line) for line in text(scored, 300).split("\n\n")[-1].splitlines()[1:]]
    assert certified == [["3 of 4", "3 of 3"], ["4 of 4", "4 of 4"], ["4 of 4", "4 of 4"], ["3 of 4", "3 of 3"]]


def test_a_training_set_that_chooses_nothing_shows_a_dash():
    found, = partition([static("a", np.full((3, 4), np.nan)), static("b", np.ones((3, 4)))], ("material",))
    table = text(cross_validate(found), 120)
    assert re.search(r"^a +\[–\] +– *$", table, re.MULTILINE) and re.search(r"^a +– +– +– +– +0 of 4 +–$", table, re.MULTILINE)
    assert np.isnan(entries(cross_validate(found))[0]["twist_mm3"])


def test_an_anisotropic_grid_names_both_bends_and_borders():
    grid = Grid((Axis("bend_1", [1e5, 2e5]), Axis("bend_2", [1e4, 2e4, 4e4]), Axis("twist", [3e5])), bend_12=5.0)
    distance = np.full((6, 4), 2.0)
    distance[4] = 1.0
    runs = [replace(static(name, distance), grid=grid) for name in "ab"]
    choices = text(cross_validate(partition(runs, ("material",))[0]), 200).split("\n\n")[-1].splitlines()
    assert re.split(r"  +", choices[0])[1:6] == ["bend_1 [mm³]", "bend_2 [mm³]", "bend_12 [mm³]", "twist [mm³]", "weight"]
    assert re.split(r"  +", choices[1]) == ["a", "2e+05", "2e+04", "5", "3e+05", "1", "1.000", "4 of 4", "4 of 4", "bend_1"]
