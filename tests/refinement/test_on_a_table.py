"""Ropes that lie on a table: with the table their parameters are found, without it not."""

import json
from dataclasses import replace

import numpy as np
import pytest

from doo_ti import Axis, Clamp, Grid, InputError, Plane, RefinementOptions, Surroundings, refine, save_observations
from doo_ti.commands.cli import main
from doo_ti.refinement.plan import plan
from doo_ti.rod.start import observation_clamps
from tests.commands.calls import refused, succeeded
from tests.refinement.rods_between_clips import TRUTH, suture
from tools.studies.table_study import GUESS, TABLE, specimen

SIMPLE = RefinementOptions(curvature="none", clamps="exact")
TABLE_FILE = '[[obstacles]]\nkind = "plane"\npoint = [0, 0, 0]\nnormal = [0, 0, 1]\n'


@pytest.fixture(scope="module")
def rope():
    return specimen(2012)


@pytest.mark.thorough
def test_the_intervals_contain_the_truth(rope):
    observations, truth = rope
    found = refine(observations, observation_clamps(observations), GUESS, replace(SIMPLE, surroundings=TABLE))
    assert found.converged and found.used.all() and found.mean_distance < 0.2
    for name, value in truth.items():
        parameter = found.estimate.parameter(name)
        assert parameter.low < value < parameter.high < 1.4 * parameter.low


@pytest.mark.thorough
def test_without_the_table_they_do_not(rope):
    observations, truth = rope
    found = refine(observations, observation_clamps(observations), GUESS, replace(SIMPLE, intervals="covariance"))
    assert found.mean_distance > 2.0 or found.used.sum() < 5


@pytest.mark.thorough
def test_commands_take_the_table_and_the_run_of_a_sweep_keeps_it(rope, tmp_path, capsys):
    observations, truth = rope
    path, run = str(tmp_path / "rope.npz"), str(tmp_path / "run")
    save_observations(tmp_path / "rope.npz", observations)
    (tmp_path / "table.toml").write_text(TABLE_FILE)
    obstacles, radius = ["--obstacles", str(tmp_path / "table.toml")], ["--radius", "2"]
    model = ["--rest-curvature", "none", "--clamps", "exact", "--no-models"]
    assert main(["sweep", path, "--bend", "5e4:2e5:3", "--twist", "5e4", *obstacles, *radius, "--out", run, "--precision",
                 "f64"]) == 0
    of_file, of_run = ["refine", path, "--bend", "3e5", "--twist", "3e5", *model], ["refine", run, "--starts", "1", *model]
    for words in ([*of_file, *obstacles, *radius], of_run):
        capsys.readouterr()
        (found,) = json.loads(succeeded(capsys, [*words, "--json"]))
        bend = next(one for one in found["parameters"] if one["name"] == "bend")
        assert bend["low"] < truth["bend"] < bend["high"]
        assert found["obstacles"]["kinds"] == ["plane"] and found["obstacles"]["radius_mm"] == 2.0
    for words, field in (([*of_file, *radius], "--radius: "), ([*of_file, *obstacles], "--radius: "),
                         ([*of_file, *obstacles, "--radius", "40"], "inside a Plane"),
                         ([*of_run, *obstacles], "--obstacles: ")):
        refused(capsys, tmp_path, words, field)


def test_rods_inside_obstacles_are_refused():
    seen = suture(1)
    deep = Surroundings([Plane((0, 0, 200), (0, 0, 1))], 2.0)
    with pytest.raises(InputError, match=r"rod \d is .* mm inside a Plane"):
        refine(seen, observation_clamps(seen), TRUTH, RefinementOptions(surroundings=deep))


@pytest.mark.thorough
def test_a_plan_with_the_table_is_another(rope):
    observations, truth = rope
    observations = observations.take(np.arange(3))
    grid = Grid((Axis("bend", np.array([0.7, 1.4]) * truth["bend"]), Axis("twist", [truth["twist"]])))
    given = dict(sigma=0.1, picks=2, clamp_start=Clamp.FRAME, clamp_end=Clamp.FRAME)
    on_table, without = plan(observations, grid, surroundings=TABLE, **given), plan(observations, grid, **given)
    assert (on_table.sensed == on_table.cells).all() and on_table.volume[-1] < on_table.volume[0] <= 1.0
    # Without the table the ropes hang: another part of them bends under their weight.
    assert not np.allclose(on_table.strength, without.strength, rtol=0.2)
    first = plan(observations.take(np.array([0])), grid, surroundings=TABLE, **(given | {"picks": 1}))
    np.testing.assert_allclose(first.strength[0], on_table.strength[0], rtol=1e-6)
