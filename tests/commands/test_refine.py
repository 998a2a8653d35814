"""``doo-ti refine`` and ``doo-ti plan``: output, files, refused input."""

import csv
import json
from dataclasses import replace
from functools import partialmethod
from pathlib import Path

import numpy as np
import pytest

from doo_ti import Material, Observations, load_observations, relax, save_observations
from doo_ti.commands.refine_text import summary_lines
from tests.commands.calls import ended, refused, succeeded
from tests.processes import ROOT
from tests.references.rods import chain, clamps_at, stacked
from tests.refinement.test_refinement import own_mesh

BEND, TWIST = 3e4, 2.1e4


@pytest.fixture
def observed(rng):
    """A file of rods made with BEND and TWIST, with 0.02 mm of noise, and the groups they belong to."""
    rods, _ = own_mesh(rng, 16, 12, BEND)
    save_observations("rod.npz", replace(rods, vertices=rods.vertices + 0.02 * rng.normal(size=rods.vertices.shape)))


@pytest.mark.thorough
def test_observations_for_a_machine(observed, capsys):
    argv = "refine rod.npz --bend 4e4 --twist 2e4 --sigma 0.02 --linear-density 2 --folds 3 --out new/found.json --json"
    (found,) = json.loads(succeeded(capsys, argv))
    assert found == json.loads(Path("new/found.json").read_text())[0]
    bend, twist, ratio = found["parameters"][:3]
    assert [one["name"] for one in (bend, twist, ratio)] == ["bend", "twist", "twist_ratio"] and bend["unit"] == "mm³"
    for parameter, truth in ((bend, BEND), (twist, TWIST)):
        assert parameter["low"] < parameter["value"] < parameter["high"] and abs(parameter["value"] / truth - 1) < 0.4
    assert found["converged"] and found["rods_used"] == 16 and found["excess"] == pytest.approx(1, abs=0.25)
    assert found["sigma_stated"] and found["mean_distance_mm"] > 0
    assert {score["model"] for score in found["models"]} >= {"straight"}
    value, low, high = found["stiffness"]["EI_Nm2"]
    assert value == pytest.approx(bend["value"] / 2 * 2e-3 * 9.80665e-9) and low < value < high
    assert found["stiffness"]["EI_over_weight_mm3"][0] == pytest.approx(bend["value"] / 2)
    (region,) = found["regions"]
    outline = np.array(region["outline"])
    assert region["parameters"] == ["bend", "twist"] and outline[:, 0].min() < bend["value"] < outline[:, 0].max()
    held = found["held_out"]
    assert len(held["theta"]) == 3 and held["mean_distance_mm"] < 0.2


def test_observations_for_a_person(observed, capsys):
    out = succeeded(capsys, "refine rod.npz --bend 4e4 --twist 2e4 --parameters bend,twist,rest-curvature-per-joint --clip 2 "
                    "--folds 2 --no-models --starts 1")
    for words in ("rod: 16 of 16 observations", "95 % intervals", "rest curvature", "noise", "EI over weight", "held out"):
        assert words in out
    assert "N m²" not in out and "--out F.json" in out


def summary(rivals, difference, curvature, unknowns=("bend", "twist")) -> dict:
    """What the text needs of a fit with bend 1.11e7, its other optima and the model that is straight at rest."""
    theta = {"bend_1": 1.11e7, "up": (0, 0, 1)}
    return {"material": "rod", "rods_used": 3, "observations": 3, "iterations": 2, "converged": True, "of_run": False,
            "theta": theta, "rivals": [theta | {"bend_1": bend} for bend in rivals], "unknowns": unknowns, "stiffness": {},
            "parameters": [{"name": "clip_start", "value": -1.0, "low": -2.0, "high": 4.0, "unit": "mm"}],
            "rest_curvature_per_mm": {"root_mean_square": curvature, "range_mm": 30.0}, "linear_density_g_per_m": None,
            "stiffness_along": {"factor": [1.0, 1.0], "root_mean_square": 0.0},
            "clamp_errors": {"turn_deg": (0, 0), "turn_scatter_deg": 0}, "swivels": False, "obstacles": None, "loaded": False,
            "mean_distance_mm": 0.1, "sigma_mm": 0.1, "sigma_stated": False, "reaches_noise": True, "advice": [],
            "neighbour_correlation": 0.1,
            "other_up": None, "turns_open": False, "left_out": {}, "misfits": [], "mislabelled": [], "sensitive": [],
            "models": [{"model": "straight", "difference": difference, "error": 0.56}], "held_out": None, "roll_kept_deg": None}


def test_what_is_printed_agrees_with_itself():
    text = "\n".join(summary_lines(summary([1.1102e7], -2.28, 1e-3)))
    assert "as probable" not in text and "predicts worse" in text and "negative" in text and "twist" not in text
    text = "\n".join(summary_lines(summary([1.1102e7, 2e7, 2e7], -0.9, 1e-3, ["bend"])))
    assert "with bend 2e+07 mm³" in text and "predicts as well" in text and "--parameters bend,twist" in text
    text = "\n".join(summary_lines(summary([], -2.28, 4.6e-11)))
    assert "e-11" not in text and "straight" in text and "predicts" not in text
    text = "\n".join(summary_lines(summary([], -2.28, 0.0) | {"converged": False, "loaded": True, "long_clips": ["clip_end"]}))
    assert "clip_end ends beyond" in text and "sweeps know no --mass" in text and "doo-ti sweep" not in text
    for high, said in ((2e7, False), (None, True)):
        bend = {"name": "bend", "value": 1e7, "low": 1e6, "high": high, "unit": "mm³"}
        assert ("check --up" in "\n".join(summary_lines(summary([], -2.28, 0.0) | {"parameters": [bend]}))) is said
    for correlation, words in ((0.1, "only noise is left"), (0.7, "off together (correlation 0.7)")):
        assert words in "\n".join(summary_lines(summary([], -2.28, 0.0) | {"neighbour_correlation": correlation}))
    advice = {"option": "--parameters bend-1,bend-2,twist", "meaning": "a section that is not round"}
    for gain, said in ((20.0, False), (120.0, True)):
        text = "\n".join(summary_lines(summary([], -2.28, 0.0) | {"advice": [advice | {"gain": gain}]}))
        assert ("WARNING" in text) == said and "try  " in text


@pytest.mark.thorough
def test_a_fit_that_stopped_says_what_to_do(observed, capsys, monkeypatch):
    from doo_ti.refinement import fit

    monkeypatch.setattr(fit.Fit, "run", partialmethod(_few_steps, fit.Fit.run))
    out = succeeded(capsys, "refine rod.npz --bend 4e5 --twist 2e3 --clip 2 --no-models --rest-curvature none --clamps exact")
    assert "NOT converged" in out and "doo-ti sweep" in out and "--clamps exact" in out
    assert "no interval" in out and ".." not in out and "only noise" not in out


def _few_steps(fit, run, state, steps, held=None):
    return run(fit, state, 1, held)


@pytest.mark.thorough
def test_a_run_s_best_cells(observed, tmp_path, capsys):
    succeeded(capsys, "sweep rod.npz --bend 1e4:1e5:4 --twist-ratio 0.3:3:3 --linear-density 2 --out run")
    run, command = Path("run"), "refine run --sigma 0.02 --starts 2 --no-models"
    (found,) = json.loads(succeeded(capsys, f"{command} --json"))
    assert json.loads((run / "refined.json").read_text()) == [found]
    bend = found["parameters"][0]["value"]
    assert found["stiffness"]["EI_Nm2"][0] == pytest.approx(bend / 2 * 2e-3 * 9.80665e-9), "the sweep's linear density"
    printed = succeeded(capsys, f"{command} --linear-density 4 --out found.json")
    assert all(path in printed for path in ("run/refined.json", "run/refined.png", "found.json"))
    (again,) = json.loads(Path("found.json").read_text())
    assert json.loads((run / "refined.json").read_text()) == [again]
    assert again["stiffness"]["EI_Nm2"][0] == pytest.approx(2 * found["stiffness"]["EI_Nm2"][0])
    assert abs(found["parameters"][0]["value"] / BEND - 1) < 0.4
    assert found["material"] == "rod" and (run / "refined.png").stat().st_size > 10_000
    refused(capsys, tmp_path, "refine run --bend 1e4", "--bend")


@pytest.mark.parametrize("more, message", [
    ("", "--EI: missing"), ("--bend 1e4:1e5:3", "refine the run of a sweep"), ("--bend 1e4,2e4", "give bend_1 and bend_2"),
    ("--EI 1e-6:1e-5:3 --linear-density 1", "--EI: a grid of 3 cells"), ("--bend 1e4 --folds 1", "--folds: 1 is below 2"),
    ("--bend 1e4 --folds 30", "give 2 to 16 folds"), ("--bend 1e4 --out found.txt", "ends in .json")])
def test_wrong_input_is_reported_in_a_line_and_nothing_is_written(observed, tmp_path, capsys, more, message):
    refused(capsys, tmp_path, f"refine rod.npz {more}", message)


def long_outer_edges() -> Observations:
    """Six cables of 960 mm, marks 120 mm apart, clips that hold 5 mm and point far away from each other."""
    s, rods = (np.arange(96) + 0.5) / 96, []
    for k in range(6):
        away = np.radians(65) * (np.exp(-s / 0.06) - (-1) ** k * np.exp(-(1 - s) / 0.06))
        tangents = np.stack([np.cos(away), np.sin(away) * np.cos(k), np.sin(away) * np.sin(k) + 0.25 * (2 * s - 1)], axis=-1)
        rods.append(chain(tangents, np.cross(tangents[0], [0, 0.3, 1]), 10.0))
    rods = stacked(rods)
    clamps = clamps_at(rods)
    marks = relax(rods, Material(4e6, 4e6), clamps).configuration.vertices[:, ::12]
    marks = marks + 0.2 * np.random.default_rng(0).normal(size=marks.shape)
    return Observations(marks, rest_length=np.full(8, 120.0), start_frame=clamps.start_frame, end_frame=clamps.end_frame)


@pytest.mark.thorough
def test_clips_need_not_hold_whole_outer_edges(tmp_path, capsys):
    save_observations("rods.npz", long_outer_edges())
    refused(capsys, tmp_path, "sweep rods.npz --bend 1e6:1e7:2 --out run", "frames hold the whole outer edges, 120 and 120 mm")
    (found,) = json.loads(succeeded(capsys, "refine rods.npz --bend 2e6 --no-models --rest-curvature none --json"))
    bend, twist = found["parameters"][:2]
    assert found["rods_used"] == 6 and found["turns_open"] and bend["low"] < 4e6 < bend["high"]
    assert (twist["low"] or 0) < 4e6 < (twist["high"] or np.inf), "nothing twists these rods much"


@pytest.mark.thorough
def test_data_recorded_y_up_and_read_as_z_up_are_found_out(capsys):
    words = f"{ROOT}/docs/examples/data/cable.csv --unit m --columns observation=pose,vertex=mark --bend 1e6:1e9:4"
    for command in (f"sweep {words} --out run",
                    "refine run --parameters bend,up --no-models --clamps exact --clip 0 --rest-curvature none"):
        out, err = ended(capsys, command)
        assert "--up y" in out and "--up y" in err and "nothing that refine can learn" not in out
    other = json.loads(Path("run/summary.json").read_text())["other_up"]
    assert other["up"] == [0, 1, 0] and other["misfit_mm"] < 0.3 * other["given_misfit_mm"]
    assert json.loads(Path("run/refined.json").read_text())[0]["other_up"]["option"] == "--up y"
    out, err = ended(capsys, f"sweep {words} --up y --out right --json")
    assert json.loads(out)["other_up"] is None and "--up" not in err


@pytest.mark.parametrize("words, up", [("y", [0, 1, 0]), ("Y", [0, 1, 0]), ("-Z", [0, 0, -1]), ("0,0,2", [0, 0, 1])])
def test_up_is_three_numbers_or_an_axis(observed, capsys, words, up):
    succeeded(capsys, f"convert rod.npz turned.npz --up {words}")
    assert load_observations("turned.npz").up.tolist() == up


SCENE = """
name = "cord"
synthesis = { bend = 2e6, twist = 1e6, end_distances_mm = [42.0, 66.0], end_rotations_deg = [0.0, 120.0], fine_edge_mm = 3.0 }
grid = { bend = "2e5:5e6:3", twist_ratio = "0.3:3:2" }
"""


@pytest.fixture(autouse=True)
def scene(written_whole) -> None:
    Path("cord.toml").write_text(SCENE)


def test_a_scene(capsys):
    out = succeeded(capsys, "plan cord.toml --picks 3 --out plan")
    assert "4 configurations" in out and "6 cells" in out
    summary = json.loads(Path("plan/plan.json").read_text())
    assert summary["asked"] == ["bend", "twist"] and len(summary["order"]) == 3 and summary["sigma_mm"] == 0.12
    rows = list(csv.DictReader(Path("plan/plan.csv").read_text().splitlines()))
    assert [row["rank"] for row in rows].count("") == 1 and float(rows[0]["bend_mm"]) > 0
    assert Path("plan/identifiability.png").read_bytes().startswith(b"\x89PNG")


def test_what_is_measured_is_not_ranked(capsys):
    summary = json.loads(succeeded(capsys, "plan cord.toml --measured 1 --json"))
    assert summary["end_distance_mm"] == [42, 66, 42, 66] and sorted(summary["order"]) == [0, 2, 3]


@pytest.mark.parametrize("words, option", [
    ("--sigma 0", "--sigma"), ("--sigma 1e-300", "sigma"), ("--measured 9", "--measured"), ("--measured 1,1", "--measured"),
    ("--bend 1e6 --twist 1e6", "single cell"), ("--weight 1:2:2", "ratios")])
def test_wrong_input_is_one_line(tmp_path, capsys, words, option):
    refused(capsys, tmp_path, f"plan cord.toml {words} --out plan", option)
