"""``doo-ti servo`` and ``doo-ti steer``: rods come to their targets, files, targets out of reach, refused input."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from doo_ti import Camera, Clamp, Material, Newton, Rig, hanging, load_path, relax, save_observations
from doo_ti.manipulation.model import moved
from doo_ti.rod.material import stiffness
from doo_ti.system.terminal import has_recorder
from doo_ti.vision.rig_files import save_rig
from tests.commands.calls import ended, made, refused, succeeded, written
from tests.references.rods import observed
from tests.vision.scenes import looking
from tools.studies import servo_tasks

BEND, DENSITY = 6e5, 10.0
EI = stiffness(BEND / 2, DENSITY)
FACTOR = 1.4
VIEWS = {"front": (0.0, 1.0, -0.4), "beside": (-0.8, 0.5, -0.6)}


@pytest.fixture(scope="module")
def places():
    """(rod at the start, its clamps, (1, V, 3) the true rod's shape after a move of both grippers)."""
    rods, clamps = hanging(150.0, 15, np.zeros((1, 3)), np.array([[100.0, 0.0, 0.0]]), clamp=Clamp.FRAME)
    start, true = relax(rods, Material(BEND, BEND), clamps, Newton.careful()), Material(FACTOR * BEND, FACTOR * BEND)
    ends = moved(clamps, np.array([[0, 5, 0, 0.1, 0, 0, 8, 0, 10, 0, 0.2, 0.1]]))
    goal = relax(relax(rods, true, clamps, Newton.careful()).configuration, true, ends, Newton.careful())
    assert start.converged.all() and goal.converged.all()
    return start.configuration, clamps, goal.configuration.vertices


@pytest.fixture
def folder(tmp_path, places):
    rod, _, goal = places
    save_observations("start.npz", observed(rod))
    np.savez("target.npz", vertices_mm=goal)
    _rig("rig.yaml", 400.0)
    _rig("near.yaml", 100.0)
    return tmp_path


def _rig(path, distance: float, views: dict = VIEWS) -> None:
    matrix = np.array([[500.0, 0.0, 159.5], [0.0, 500.0, 119.5], [0.0, 0.0, 1.0]])
    save_rig(path, Rig(tuple(Camera(name, 320, 240, matrix, np.zeros(5), *looking(
        np.array(view) / np.linalg.norm(view), distance, (50.0, 0.0, -25.0))) for name, view in views.items())))


MATERIAL = f"--EI {EI!r} --GJ {EI!r} --linear-density {DENSITY!r}"
STIFFER = f"--true-EI {FACTOR * EI!r} --true-GJ {FACTOR * EI!r}"
SERVO = f"servo start.npz --target target.npz --rig rig.yaml {MATERIAL} --out run"


def test_a_rod_comes_nearer_and_everything_is_written(folder, capsys):
    out, err = ended(capsys, f"{SERVO} {STIFFER} --steps 2 --reached 0.001 --no-recording --json")
    said, rows = json.loads(out), list(csv.DictReader(Path("run/steps.csv").read_text().splitlines()))
    start, target = (written(name)["vertices_mm"] for name in ("start.npz", "target.npz"))
    first = np.sqrt(np.sum((start - target) ** 2, axis=-1).mean())
    assert len(rows) == said["steps"] == 2 and said["distance_mm"] == float(rows[-1]["distance_mm"]) < 0.6 * first
    assert said["frames"]["lost"] == 0 and all(int(row["vertices_seen"]) > 10 for row in rows)
    assert said["EI"]["low"] < said["EI"]["value"] < said["EI"]["high"]
    assert said["EI"]["true"] == pytest.approx(FACTOR * EI) and float(rows[-1]["EI_Nm2"]) == said["EI"]["value"]
    assert load_path("run/path.csv").moments == 1 + len(rows) and Path("run/servo.png").stat().st_size > 10_000
    assert not said["reached"] and "the target is not reached" in err and err.count("doo-ti: ") == 1


@pytest.mark.thorough
def test_the_target_is_reached_though_a_camera_is_covered_now_and_then(folder, capsys):
    _rig("three.yaml", 400.0, {**VIEWS, "above": (0.2, 0.2, -1.0)})
    out, err = ended(capsys, f"{SERVO} {STIFFER} --occlude front:0.33 --noise 4 --seed 3 --rig three.yaml --json")
    said = json.loads(out)
    assert said["reached"] and said["distance_mm"] < 1.5 and 0 < said["covered"] < said["steps"] and "not reached" not in err
    assert said["frames"]["lost"] == 0 and (not has_recorder() or Path("run/servo.rrd").stat().st_size > 100_000)
    material = f"--EI {FACTOR * EI!r} --GJ {FACTOR * EI!r} --linear-density {DENSITY!r}"
    moved_rod = made(f"predict start.npz --motion run/path.csv {material} --out moved.npz")
    apart = moved_rod["vertices_mm"][-1] - written("target.npz")["vertices_mm"]
    assert np.sqrt(np.sum(apart**2, axis=-1).mean()) == pytest.approx(said["distance_mm"], abs=0.05)


@pytest.mark.thorough
def test_with_every_camera_covered_the_rod_moves_as_the_model_says(folder, capsys):
    command = f"{SERVO} --occlude front:1 --occlude beside:1 --steps 4 --no-recording"
    assert "target not reached" in succeeded(capsys, command)
    said = json.loads(succeeded(capsys, f"{command} --json"))
    assert said["frames"]["lost"] == said["steps"] and said["EI"]["value"] == pytest.approx(EI)


@pytest.mark.parametrize("more, said", [
    (["--true-EI", "0"], "--true-EI"), (["--steps", "0"], "--steps"), (["--noise", "1e9"], "noise"),
    (["--occlude", "left:0.5"], "--occlude"), (["--occlude", "front:2"], "--occlude"), (["--diameter", "1e9"], "--diameter"),
    (["--clamp-end", "free"], "--clamp-end"), (["--rig", "absent.yaml"], "absent.yaml"), (["--bend", "1e5:1e6:3"], "--bend"),
    (["--rig", "near.yaml"], "near.yaml: cameras: 0 of 2 see all of the rod")])
def test_wrong_options_are_refused(folder, capsys, more, said):
    refused(capsys, folder, [*SERVO.split(), *more], said)


def test_true_stiffness_needs_the_density(folder, capsys):
    refused(capsys, folder, f"{SERVO.replace(MATERIAL, '--bend 6e5')} {STIFFER}", "--linear-density", "--true-EI")


@pytest.fixture(scope="module")
def own():
    return servo_tasks.tasks(1, 31)


@pytest.fixture
def steered_folder(tmp_path, own):
    save_observations("start.npz", observed(own.real))
    np.savez("target.npz", vertices_mm=own.goal)
    Path("rubbing.toml").write_text(
        'obstacles = [{ kind = "plane", point = [0, 0, -500], normal = [0, 0, 1], friction = 0.3 }]')
    return tmp_path


def material(own) -> str:
    bend, ratio = servo_tasks.BEND * own.factors[0, 0], own.factors[1, 0]
    return f"--bend {bend} --twist {bend * ratio}"


def steered(own, more: str = "") -> str:
    return f"steer start.npz --target target.npz {material(own)} --out path.csv {more}"


def test_predict_follows_the_path_to_the_target(steered_folder, own, capsys):
    said = json.loads(succeeded(capsys, steered(own, "--json")))
    assert said["reached"] and said["distance_mm"] < 0.5
    moved = made(f"predict start.npz --motion path.csv {material(own)} --out moved.npz --json")
    assert json.loads(capsys.readouterr().out)["falls"] == [] and moved["followed"].all()
    assert np.linalg.norm(moved["vertices_mm"][-1, 0] - own.goal[0], axis=-1).mean() < 0.5


@pytest.mark.thorough
def test_how_near_a_path_comes_to_obstacles_is_said(steered_folder, own, capsys):
    """A floor a millimetre below the rod."""
    lowest = min(own.goal[..., 2].min(), own.real.vertices[..., 2].min()) - 1.5
    Path("floor.toml").write_text(f'obstacles = [{{ kind = "plane", point = [0, 0, {lowest - 1.0}], normal = [0, 0, 1] }}]')
    out, err = ended(capsys, steered(own, "--obstacles floor.toml --radius 1.5 --json"))
    said = json.loads(out)
    assert said["reached"] and 0.5 < said["smallest_gap_mm"] < 1.1 and 5 < said["smallest_radius_mm"] < 300
    assert ("beside them" in err) == (said["smallest_gap_mm"] < said["mesh_error_mm"] + said["clamp_error_mm"])


def test_a_gripper_that_is_not_free_stays(steered_folder, own, capsys):
    """One vertex is asked to move 10 mm, which the other gripper can do."""
    asked = np.full_like(own.rods.vertices[:1], np.nan)
    asked[:, 25] = own.rods.vertices[:1, 25] + [0.0, 10.0, 0.0]
    np.savez("target.npz", vertices_mm=asked)
    succeeded(capsys, steered(own, "--free end-shift,end-turn"))
    path = np.genfromtxt("path.csv", delimiter=",", names=True)
    for name in path.dtype.names:
        assert not name.startswith("start_") or np.ptp(path[name]) == 0, name


@pytest.mark.thorough
def test_a_target_that_no_path_reaches_is_said(steered_folder, own, capsys):
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
def test_wrong_targets_and_options_are_refused(steered_folder, own, capsys, wrong, said):
    if isinstance(wrong, dict):
        np.savez("wrong.npz", **wrong)
    named, more = ("wrong.npz", ["--target", "wrong.npz"]) if isinstance(wrong, dict) else ("", wrong)
    refused(capsys, steered_folder, [*steered(own).split(), *more], named, said)
