"""``doo-ti steer``: a path that predict follows to the target, targets out of reach, refused input."""

import json
from pathlib import Path

import numpy as np
import pytest

from doo_ti import Observations, save_observations
from tests.commands.calls import ended, made, refused, succeeded
from tools.studies.servo_tasks import BEND, tasks


@pytest.fixture(scope="module")
def own():
    return tasks(1, 31)


@pytest.fixture
def folder(tmp_path, own):
    save_observations("start.npz", Observations(
        own.real.vertices, rest_length=own.real.rest_length, total_twist=np.zeros(1), start_frame=own.clamps.start_frame,
        end_frame=own.clamps.end_frame))
    np.savez("target.npz", vertices_mm=own.goal)
    Path("rubbing.toml").write_text(
        'obstacles = [{ kind = "plane", point = [0, 0, -500], normal = [0, 0, 1], friction = 0.3 }]')
    return tmp_path


def material(own) -> str:
    bend, ratio = BEND * own.factors[0, 0], own.factors[1, 0]
    return f"--bend {bend} --twist {bend * ratio}"


def steered(own, more: str = "") -> str:
    return f"steer start.npz --target target.npz {material(own)} --out path.csv {more}"


def test_predict_follows_the_path_to_the_target(folder, own, capsys):
    said = json.loads(succeeded(capsys, steered(own, "--json")))
    assert said["reached"] and said["distance_mm"] < 0.5
    moved = made(f"predict start.npz --motion path.csv {material(own)} --out moved.npz --json")
    assert json.loads(capsys.readouterr().out)["falls"] == [] and moved["followed"].all()
    assert np.linalg.norm(moved["vertices_mm"][-1, 0] - own.goal[0], axis=-1).mean() < 0.5


def test_a_gripper_that_is_not_free_stays(folder, own, capsys):
    """One vertex is asked to move 10 mm, which the other gripper can do."""
    asked = np.full_like(own.rods.vertices[:1], np.nan)
    asked[:, 25] = own.rods.vertices[:1, 25] + [0.0, 10.0, 0.0]
    np.savez("target.npz", vertices_mm=asked)
    succeeded(capsys, steered(own, "--free end-shift,end-turn"))
    path = np.genfromtxt("path.csv", delimiter=",", names=True)
    for name in path.dtype.names:
        assert not name.startswith("start_") or np.ptp(path[name]) == 0, name


@pytest.mark.thorough
def test_a_target_out_of_reach_is_said(folder, own, capsys):
    asked = np.full_like(own.goal, np.nan)
    asked[:, 0], asked[:, -1] = [0.0, 0, 0], [400.0, 0, 0]
    np.savez("target.npz", vertices_mm=asked)
    out, err = ended(capsys, steered(own, "--seconds 1 --json"))
    assert not json.loads(out)["reached"] and "not reached" in err and Path("path.csv").exists()


@pytest.mark.parametrize("wrong, said", [
    ({"vertices": np.zeros((1, 34, 3))}, "vertices_mm: missing"), ({"vertices_mm": np.zeros((1, 5, 3))}, "shape (1, 5, 3)"),
    ({"vertices_mm": np.full((1, 34, 3), np.nan)}, "NaN everywhere"),
    ({"vertices_mm": np.full((1, 34, 3), np.inf)}, "not finite"),
    ({"vertices_mm": np.linspace(0, 1e-4, 102).reshape(1, 34, 3)}, "check the unit"),
    ({"vertices_mm": np.full((1, 34, 3), 9.0), "up": np.array([0, 1.0, 0])}, "but START has 0,0,1"),
    (["--clamp-end", "free"], "--clamp-end"), (["--seconds", "1e9"], "--seconds"), (["--bend", "1e5:1e6:3"], "--bend"),
    (["--out", "path.npz"], "--out"), (["--target", "absent.npz"], "absent.npz"),
    (["--obstacles", "rubbing.toml", "--radius", "1"], "friction")])
def test_wrong_targets_and_options_are_refused(folder, own, capsys, wrong, said):
    if isinstance(wrong, dict):
        np.savez("wrong.npz", **wrong)
    named, more = ("wrong.npz", ["--target", "wrong.npz"]) if isinstance(wrong, dict) else ("", wrong)
    refused(capsys, folder, [*steered(own).split(), *more], named, said)
