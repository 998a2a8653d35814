"""The tables as text, Markdown, CSV and JSON: all have the same content."""

import csv
import io
import re
from dataclasses import replace

import numpy as np
import pytest

from doo_ti.learning.cross_validation import cross_validate, partition
from doo_ti.learning.score_table import LISTED, comma_separated, entries, file_stem, markdown, notes, text
from doo_ti.rod.grid import Axis, Grid
from tests.learning.lab import static

LABELS = np.repeat([30.0, 54.0], 4)


@pytest.fixture
def scores(rng):
    """Two materials at two end distances; one rod has no distance, one is no certified minimum."""
    runs = []
    for name, cell in (("nylon", 1), ("silk", 3)):
        runs.append(static(name, 1 + rng.uniform(0, 0.1, (5, 8)) + np.abs(np.arange(5) - cell)[:, None], LABELS))
    runs[1].distance[:, 6] = np.nan
    runs[0] = replace(runs[0], stable=np.tile(np.arange(8) != 2, (5, 1)))
    found, = partition(runs, ("material", "end-distance"))
    return cross_validate(found)


def test_text_has_aligned_columns_and_folds_where_they_do_not_fit(scores):
    wide, narrow = text(scores, 200), text(scores, 60)
    assert max(map(len, narrow.split("\n\n")[1].splitlines())) <= 60 < len(wide.split("\n\n")[1].splitlines()[0])
    lines = wide.split("\n\n")[1].splitlines()
    assert len(lines) == 5 and {line.index("±") for line in lines[1:]} == {lines[1].index("±")}
    figure = f"{scores.mean[0, 0]:.3f} ± {scores.standard_error[0, 0]:.3f}"
    assert lines[1].split("  ")[1].strip() == f"[{figure}]{'*' if scores.is_best[0, 0] else '~'}"
    for part in ("silk 54 mm", f"{scores.mean[3, 1]:.3f} ± {scores.standard_error[3, 1]:.3f}"):
        assert part in wide and part in narrow
    assert wide.count("*") - 1 == scores.is_best.sum() and wide.count("~") - 1 == scores.is_near.sum()


def test_markdown_sets_the_best_bold(scores):
    page = markdown(scores)
    assert file_stem(scores.partition.by) == "by_material_and_end_distance"
    assert page.startswith("**Table II: leave-one-out error by material and end distance; static (Eq. 2);")
    table = [line for line in page.splitlines() if line.startswith("|")][:6]
    cells = np.array([[cell.strip() for cell in line.strip("|").split("|")[1:]] for line in table[2:]])
    assert (np.char.startswith(cells, "**") == scores.is_best).all()
    assert (np.char.startswith(cells, "_") == scores.is_near).all()
    assert ((np.char.find(cells, "[") >= 0) == np.eye(4, dtype=bool)).all()


def test_csv_holds_the_numbers_in_full(scores):
    lines = list(csv.DictReader(io.StringIO(comma_separated([scores, scores]))))
    assert len(lines) == 2 * 16 and lines[:16] == lines[16:]
    for name, values in (("mean_mm", scores.mean), ("standard_error_mm", scores.standard_error), ("n", scores.count)):
        np.testing.assert_array_equal(np.array([float(line[name]) for line in lines[:16]]), values.ravel())
    assert [line["is_best"] for line in lines[:16]] == [str(best) for best in scores.is_best.ravel().tolist()]
    grid = scores.partition.parts[0].landscape.grid
    assert float(lines[0]["bend_1_mm3"]) == grid.cell_values()["bend_1"][scores.best[0]] == float(lines[3]["bend_1_mm3"])
    assert (lines[1]["within"], lines[1]["train"], lines[1]["test"]) == ("static", "nylon 30 mm", "nylon 54 mm")


def test_terms_not_certified_or_left_out_are_listed_below_the_table(scores):
    left_out, uncertified = notes(scores)
    assert re.search(r": nylon 30 mm -> silk 54 mm 1 of 4, .*silk 54 mm -> silk 54 mm 1 of 4$", left_out)
    assert "nylon 54 mm -> nylon 30 mm 1 of 4" in uncertified
    for page in (text(scores, 120), markdown(scores)):
        assert left_out in page and uncertified in page
    assert f" {16 - LISTED} " in notes(replace(scores, left_out=np.ones((4, 4), int)))[0]
    jumped = replace(scores, jumped=np.eye(4, dtype=int), partition=replace(scores.partition, unlabelled=3))
    assert "nylon 30 mm -> nylon 30 mm 1 of 4" in notes(jumped)[-1] and notes(jumped)[0].startswith("3 ")
    certified = [re.findall(r"\d of \d", line) for line in text(scores, 300).split("\n\n")[-1].splitlines()[1:]]
    assert certified == [["3 of 4", "3 of 3"], ["4 of 4", "4 of 4"], ["4 of 4", "4 of 4"], ["3 of 4", "3 of 3"]]


def test_a_training_set_that_chooses_nothing_shows_a_dash():
    found, = partition([static("a", np.full((3, 4), np.nan)), static("b", np.ones((3, 4)))], ("material",))
    table = text(cross_validate(found), 120)
    assert re.search(r"^a +\[–\] +– *$", table, re.MULTILINE)
    assert re.search(r"^a +– +– +– +– +0 of 4 +–$", table, re.MULTILINE)
    assert np.isnan(entries(cross_validate(found))[0]["twist_mm3"])


def test_an_anisotropic_grid_names_both_bends_and_borders():
    grid = Grid((Axis("bend_1", [1e5, 2e5]), Axis("bend_2", [1e4, 2e4, 4e4]), Axis("twist", [3e5])), bend_12=5.0)
    distance = np.full((6, 4), 2.0)
    distance[4] = 1.0
    runs = [replace(static(name, distance), grid=grid) for name in "ab"]
    choices = text(cross_validate(partition(runs, ("material",))[0]), 200).split("\n\n")[-1].splitlines()
    assert re.split(r"  +", choices[0])[1:6] == ["bend_1 [mm³]", "bend_2 [mm³]", "bend_12 [mm³]", "twist [mm³]", "weight"]
    assert re.split(r"  +", choices[1]) == ["a", "2e+05", "2e+04", "5", "3e+05", "1", "1.000", "4 of 4", "4 of 4", "bend_1"]
