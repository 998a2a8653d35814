"""Sutures whose stiffness varies along them, made by a solver of their own (tools/studies/marks_study): their EI, and where
they are stiffer."""

import json

import numpy as np
import pytest

from doo_ti.commands.cli import main
from tools.studies.marks_study.specimens import drawn, mark_lengths, points, specimen, stiffness_along
from tools.studies.marks_study.study import GRIDS

SEED = 9100  # of a suture that varies by 5 % (root mean square)


@pytest.fixture(scope="module")
def suture(tmp_path_factory):
    folder = tmp_path_factory.mktemp("suture")
    recipe = drawn("suture", SEED, ("stiffness",), small=True)
    specimen(recipe, folder)
    grid = ("--EI", GRIDS["suture"], "--twist-ratio", "0.25:4:5", "--linear-density", str(recipe.grams_per_metre))
    assert main(["sweep", str(folder / "marks.npz"), *grid, "--out", str(folder / "run")]) == 0
    return recipe, folder


def refined(folder, *more: str) -> dict:
    assert main(["refine", str(folder / "run"), "--no-models", "--out", str(folder / "found.json"), *more]) == 0
    return json.loads((folder / "found.json").read_text())[0]


@pytest.mark.thorough
def test_its_mean_and_where_it_is_stiffer_are_found(suture):
    (recipe, folder), at = suture, points(60)
    along = np.interp(mark_lengths(recipe)[0] / recipe.free, at.s, stiffness_along(recipe, at.s, at.weights))
    found = refined(folder)
    _, low, high = found["stiffness"]["EI_Nm2"]
    assert low <= recipe.EI <= high and high / low < 1.1 and np.ptp(np.log(along)) > 0.15
    np.testing.assert_allclose(found["stiffness_along"]["factor"][2:-2], along[2:-2], rtol=0.05)  # the last hardly bend


@pytest.mark.thorough
def test_a_uniform_model_is_told_what_it_lacks(suture, capsys):
    recipe, folder = suture
    found = refined(folder, "--stiffness", "uniform")
    assert found["advice"][0]["option"] == "--stiffness field" and found["advice"][0]["gain"] > 30
    assert set(found["stiffness_along"]["factor"]) == {1.0}
