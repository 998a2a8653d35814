"""Studies at small sizes, pickles of public data; and every command and file that documents name exists."""

import os
import pickle
import re
import shlex
import subprocess
import sys
from importlib import import_module

import numpy as np
import pytest

from doo_ti import Material, load_observations
from doo_ti.commands.help_text import EXAMPLES
from tests.conftest import check_refused
from tests.perception.test_twist import MATERIAL, TWIST
from tests.processes import ROOT
from tests.references.rods import at_rest, bows, observed
from tests.relaxation.rods import lab
from tools.studies import picture_study, reproduce
from tools.studies.cables import read_recordings
from tools.studies.prediction_study import predict_steps
from tools.studies.replication.criteria import CRITERIA
from tools.studies.replication.landscapes import figure_1
from tools.studies.replication.twist import SUCCESS, twist_trials


def test_trials_of_eq_4_rotate_known_frames_and_find_the_angle():
    made = observed(at_rest(bows(0.5, 0.7, 0.9, 0.6, 0.8, twist=TWIST), MATERIAL))
    trials, again = (twist_trials(made, made.total_twist, MATERIAL, 3, 5, seed=4) for _ in range(2))
    assert trials.configurations.shape == (5, 3) and (np.diff(np.sort(trials.configurations)) > 0).all()
    assert np.ptp(trials.truth) > 1 and trials.error.max() < np.radians(1.5)
    np.testing.assert_array_equal(again.estimate.phi, trials.estimate.phi)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2016, 2021])
def test_ten_photographs_tell_the_stiffness(seed, capsys):
    """One pose of either is seen along its end: it is ambiguous, or a hairpin 5 px wide."""
    assert picture_study.main(["--specimens", "1", "--seed", f"{seed}"]) == 0, capsys.readouterr().out


@pytest.mark.thorough
def test_fig_7_on_the_lab(laboratory):
    """A part of the study: success within a quarter turn, whole turns counted, under the lab's own Θ."""
    observations = load_observations(laboratory / "lab_a" / "vicryl.npz")
    truth = np.radians(np.load(laboratory / "lab_a" / "vicryl_truth.npz")["total_twist_deg"])
    for together, least in ((1, 0.9), (6, 0.99)):
        assert np.mean(twist_trials(observations, truth, Material(6e5, 8e5), together, 40, seed=1).error <= SUCCESS) >= least


@pytest.mark.sampled(1)
@pytest.mark.parametrize("name", ["ribbon", "nylon", "vicryl", "silk"])
def test_rotation_steps_of_the_lab_are_predicted(laboratory, name):
    """Where the ribbon's prediction ends on another branch than the observation, that is known."""
    rods = lab(laboratory, name)
    steps = predict_steps(rods.observations, rods.material)
    assert len(steps.error) == 54
    if name == "ribbon":
        assert np.median(steps.error) <= 0.8 and (np.abs(steps.error - steps.own_error)[steps.same_branch] < 0.5).all()
    else:
        assert steps.error.mean() <= 1.0 and steps.same_branch.all()


@pytest.mark.parametrize("protocol", range(2, pickle.HIGHEST_PROTOCOL + 1))
def test_a_folder_of_pickles_becomes_one_array(tmp_path, monkeypatch, protocol):
    class Calls:  # a pickle that runs a command where it is unpickled as usual
        def __reduce__(self):
            return os.system, ("touch trace",)

    monkeypatch.chdir(tmp_path)
    frames = np.arange(5 * 3 * 4, dtype=np.float64).reshape(5, 3, 4) / 100
    for number in (9, 10):
        (tmp_path / f"{number}.pkl").write_bytes(pickle.dumps([number * frame for frame in frames], protocol))
    positions, names = read_recordings(tmp_path)
    assert positions.shape == (2, 5, 4, 3) and names.tolist() == [9, 10]
    np.testing.assert_allclose(positions[1, 2, 3], 1e4 * frames[2, :, 3], rtol=1e-6)
    (tmp_path / "11.pkl").write_bytes(pickle.dumps([frames[0], Calls()], protocol))
    check_refused("names", read_recordings, tmp_path)
    assert not (tmp_path / "trace").exists()


@pytest.mark.thorough
@pytest.mark.parametrize("words", [
    "angle_study --curves 1 --angles 40", "detection_study --rods 1", "group_study --groups 4", "perception_study lab --sets 1",
    "planner_study same --goals 1", "servo_study own --tasks 2 --steps 2", "servo_study own --cameras --tasks 1 --steps 1"])
def test_studies_run(words, monkeypatch):
    name, *options = words.split()
    monkeypatch.setattr(sys, "argv", [name, *options])
    assert import_module(f"tools.studies.{name}").main() in (None, 0, 1)


def test_cables_for_pictures_hang(rng):
    length = np.linalg.norm(np.diff(picture_study.pose(rng, -30.0, 0.7), axis=0), axis=-1).sum()
    assert length == pytest.approx(picture_study.LENGTH, rel=1e-6)


DOCUMENTS = [*sorted((ROOT / "docs").rglob("*.md")),
             *(ROOT / name for name in ("doo_ti/PAPER.md", "tools/README.md", "README.md", "CONTRIBUTING.md"))]
MEASURED = [command for page in DOCUMENTS for last in re.findall(r"\*\*Measured with\*\* .*", page.read_text(encoding="utf-8"),
            re.DOTALL) for command in re.findall(r"`([^`]+)`", last)]


def test_every_tool_that_documents_name_exists():
    for document in DOCUMENTS:
        for name in re.findall(r"(?<!/)\btools/[\w/]+\.py\b", document.read_text(encoding="utf-8")):
            assert (ROOT / name).is_file(), f"{document.name} names {name}"


def test_every_module_that_documents_name_exists_and_has_what_is_named_beside_it():
    modules = {path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8")
               for room in ("doo_ti", "tests", "tools") for path in (ROOT / room).rglob("*.py")}
    for document in DOCUMENTS:
        for name, beside in re.findall(r"`([\w/]+\.py)`(?: `(\w+)`)?", document.read_text(encoding="utf-8")):
            found = [text for path, text in modules.items() if path.endswith(f"/{name}") or path == name]
            assert found or "NN" in name, f"{document.name} names {name}"
            there = any(re.search(rf"\b{beside}\b", text) for text in found)
            assert there or not beside, f"{document.name}: {beside} in {name}"


def test_every_page_with_a_picture_has_a_command():
    for page in (ROOT / "docs").rglob("*.md"):
        text = page.read_text(encoding="utf-8")
        drawn = page.parent.name != "examples" and "![" in text
        assert not drawn or re.search(r"\bdoo-ti [a-z]|\bpython tools/", text), f"{page.name} has pictures without a command"


def test_every_command_that_measured_a_page_exists():
    assert len(MEASURED) > 25
    for words in map(shlex.split, MEASURED):
        if words[0] == "doo-ti":
            assert words[1] in EXAMPLES, words
        else:
            named = words[3:4] if words[1] == "-m" else words[1:2]
            assert words[0] == "python" and all((ROOT / name).exists() for name in named), words
        assert all((ROOT / word).is_file() for word in words if word.startswith("scenes/")), words


@pytest.mark.thorough
@pytest.mark.parametrize("command", sorted({words for words in MEASURED if " --" in words and " -m " not in words}))
def test_every_command_takes_its_options(command):
    words = shlex.split(command)
    program = [sys.executable, *(["-m", "doo_ti", words[1]] if words[0] == "doo-ti" else words[1:2])]
    asked = "--help-all" if words[0] == "doo-ti" else "--help"
    told = subprocess.run([*program, asked], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    for option in (word for word in words if word.startswith("--")):
        assert option in told, f"{command}: {option}"


@pytest.mark.thorough
def test_items_are_measured_and_reported(tmp_path, capsys):
    names, report = ["Table I", "Table II", "Fig. 1", "Fig. 3", "Fig. 4"], tmp_path / "REPLICATION.md"
    reproduce.main([*names, "--size", "tiny", "--report", str(report)])
    text = report.read_text(encoding="utf-8")
    for name in names:
        assert f"\n## {name}\n" in text
        assert text.count(f"\n| {name} | ") >= len(CRITERIA[name])
    assert "did not run" not in text and "1.40 / 0." in text and figure_1()[0] == {"apart": [True]}
