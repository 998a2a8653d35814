"""Ropes that lie on a table, whose parameters are found with the table."""

import json

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import fsolve
from scipy.spatial.transform import Rotation

import doo_ti as d
from doo_ti.commands.cli import main
from doo_ti.refinement.plan import plan
from doo_ti.rod.start import observation_clamps
from tests.commands.calls import refused, succeeded
from tools.studies.table_study import TABLE, specimen


def lifted(rigidity: float, height: float, angle: float, marks: int, length: float) -> np.ndarray:
    """(marks, 3) along a smooth rod that lies on z = 0 and is lifted at its start: EI/w θ″ = (R − s) cos θ, EI/w being its
    ``rigidity``, over arc length from where it leaves the table; θ and the moment are zero there, and R is the reaction."""
    def shape(free, reaction):
        def slope(s, y):
            return [y[1], (reaction - s) / rigidity * np.cos(y[0]), np.cos(y[0]), np.sin(y[0])]
        return solve_ivp(slope, (0.0, free), [0.0] * 4, rtol=1e-10, atol=1e-10, dense_output=True)

    def miss(unknowns):
        end = shape(*unknowns).y[:, -1]
        return [100.0 * (end[0] - angle), end[3] - height]

    guess = (72.0 * rigidity * height) ** 0.25
    (free, reaction), _, good, _ = fsolve(miss, [guess, guess / 3.0], full_output=True)
    assert good == 1 and free < length
    off = free - np.linspace(0.0, length, marks)
    x, z = np.where(off > 0, shape(free, reaction).sol(np.maximum(off, 0.0))[2:], [off, np.zeros(marks)])
    return np.stack([x[0] - x, np.zeros(marks), z], axis=-1)


@pytest.mark.thorough
@pytest.mark.parametrize("seed", [1, 2])
def test_ropes_that_somebody_lifts_at_one_end(seed):
    """Smooth ropes by shooting, whose far end lies free, as marks alone: nothing says how the lifted end is held."""
    random = np.random.default_rng(seed)
    bend, length, radius, marks = 10 ** random.uniform(5.3, 6.0), 500.0, 3.0, []
    while len(marks) < 8:
        rope = lifted(bend / 2, random.uniform(40, 120), random.uniform(-0.1, 0.5), 31, length)
        marks.append(Rotation.from_euler("z", random.uniform(0, 2 * np.pi)).apply(rope) + (0, 0, radius))
    seen = d.Observations(np.array(marks) + random.normal(0, 0.3, (8, 31, 3)))
    options = d.RefinementOptions(surroundings=d.Surroundings([d.Plane((0, 0, 0), (0, 0, 1))], radius))
    found = d.refine(seen, observation_clamps(seen, end=d.Clamp.FREE), d.Theta(2 * bend * np.eye(2), 2 * bend), options)
    one = found.estimate.parameter("bend")
    assert found.converged and found.used.all() and one.low < bend < one.high < 1.2 * one.low


@pytest.mark.thorough
def test_commands_take_the_table_and_the_run_of_a_sweep_keeps_it(tmp_path, capsys):
    observations, truth = specimen(2012)
    path, run = str(tmp_path / "rope.npz"), str(tmp_path / "run")
    d.save_observations(tmp_path / "rope.npz", observations)
    (tmp_path / "table.toml").write_text('[[obstacles]]\nkind = "plane"\npoint = [0, 0, 0]\nnormal = [0, 0, 1]\n')
    obstacles, radius = ["--obstacles", str(tmp_path / "table.toml")], ["--radius", "2"]
    model = ["--rest-curvature", "none", "--clamps", "exact", "--no-models"]
    assert main(["sweep", path, "--bend", "5e4:2e5:3", "--twist", "5e4", *obstacles, *radius, "--out", run, "--precision",
                 "f64"]) == 0
    of_file, of_run = ["refine", path, "--bend", "3e5", "--twist", "3e5", *model], ["refine", run, "--starts", "1", *model]
    for words in ([*of_file, *obstacles, *radius], of_run):
        capsys.readouterr()
        (found,) = json.loads(succeeded(capsys, [*words, "--json"]))
        assert found["converged"] and found["rods_used"] == observations.count and found["mean_distance_mm"] < 0.2
        for one in found["parameters"]:
            assert one["name"] not in truth or one["low"] < truth[one["name"]] < one["high"] < 1.4 * one["low"]
        assert found["obstacles"]["kinds"] == ["plane"] and found["obstacles"]["radius_mm"] == 2.0
    for words, field in (([*of_file, *radius], "--radius: "), ([*of_file, *obstacles], "--radius: "),
                         ([*of_file, *obstacles, "--radius", "40"], "inside a Plane"),
                         ([*of_run, *obstacles], "--obstacles: ")):
        refused(capsys, tmp_path, words, field)


@pytest.mark.thorough
def test_a_plan_with_the_table_is_another():
    observations, truth = specimen(2012)
    observations = observations.take(np.arange(3))
    grid = d.Grid((d.Axis("bend", np.array([0.7, 1.4]) * truth["bend"]), d.Axis("twist", [truth["twist"]])))
    given = dict(sigma=0.1, picks=2, clamp_start=d.Clamp.FRAME, clamp_end=d.Clamp.FRAME)
    on_table, without = plan(observations, grid, surroundings=TABLE, **given), plan(observations, grid, **given)
    assert (on_table.sensed == on_table.cells).all() and on_table.volume[-1] < on_table.volume[0] <= 1.0
    # Without the table the ropes hang: another part of them bends under their weight.
    assert not np.allclose(on_table.strength, without.strength, rtol=0.2)
    first = plan(observations.take(np.array([0])), grid, surroundings=TABLE, **(given | {"picks": 1}))
    np.testing.assert_allclose(first.strength[0], on_table.strength[0], rtol=1e-6)
