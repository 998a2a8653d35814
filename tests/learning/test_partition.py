"""The terms of each row and column, and landscapes that cannot be compared."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from doo_ti.learning.cross_validation import partition, usual_factors
from doo_ti.system.errors import InputError
from tests.learning.landscapes import dynamic, grid_of, static

LABELS = np.tile([54.0, 30.0, 78.0], 4)
PAIRS = [(0, 3), (3, 0), (1, 4), (4, 7), (2, 5), (5, 8)]


def lab(name: str, labels=LABELS):
    return static(name, np.ones((3, len(labels))), labels)


def moved(name: str, labels=LABELS):
    return dynamic(name, np.ones((3, len(PAIRS))), PAIRS, end_distance=labels)


def rows(found) -> dict[str, list[int]]:
    return {part.label: part.terms.tolist() for part in found.parts}


def test_by_material():
    found, = partition([lab("silk"), lab("nylon")], ("material",))
    assert (found.by, found.within, found.unlabelled) == (("material",), "static", 0)
    assert rows(found) == {"silk": list(range(12)), "nylon": list(range(12))}


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
    ([lab("a")], [("end-distance",)]),
    ([lab("a", np.full(12, np.nan))], []),
    ([lab("a", np.arange(12.0))], []),
    ([lab("a"), lab("b")], [("material",), ("material", "end-distance")]),
    ([lab("a", np.full(12, 30.0)), lab("b", np.full(12, 30.0))], [("material",)]),
    ([lab("a"), moved("a")], [("objective", "end-distance")]),
    ([lab("a"), moved("b")], [("end-distance",)]),
    ([lab("a"), lab("b"), moved("a")], [("material",), ("material", "end-distance"), ("objective", "end-distance")]),
])
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
    ([lab("a", np.nan * LABELS)], ("end-distance",), (), "a_static: end_distance_mm: no observation has"),
])
def test_runs_that_cannot_be_compared_are_reported(runs, by, distances, words):
    with pytest.raises(InputError) as problem:
        partition(runs, by, distances)
    assert words in str(problem.value)
