"""``--obstacles`` of the commands, and scenes of rods that touch themselves: what is written, and what is refused."""

import json
from pathlib import Path

import numpy as np
import pytest

from doo_ti import Cylinder, Observations, Surroundings, save_observations
from doo_ti.commands import loading
from doo_ti.commands.cli import main
from doo_ti.commands.doubts import inside_doubt, mesh_doubt
from tests.commands.calls import ended, refused, succeeded, written

PLANE = '[[obstacles]]\nkind = "plane"\npoint = [0, 0, 0]\nnormal = [0, 0, 1]\n'
MATERIAL = "--bend 6e5 --precision f64 --clamp-end free"
SCENE = """
rate_hz = 50
duration_s = 0.3
rod = { length_mm = 200.0, edges = 10, position_mm = [0, 0, 20], radius_mm = 2.0 }
materials.rope = { bend = 4e5, bend_damping_s = 0.02, drag_per_s = 5.0 }
moments = [{ time_s = 0.3, start_position_mm = [-20, 0, 20] }]
"""
GROUP = "radius_mm = 2.0\nmaterials.rope.bend = 4e5\nrods.one = { edges = 10, length_mm = 200.0 }\n"
THIN = 'obstacles = [{ kind = "cylinder", start = [9, -40, -9], end = [9, 40, -9], radius = 16 }]'


def test_doubts_about_obstacles_are_said():
    """Marks inside one, and edges that cannot lie on it."""
    seen = Observations(np.stack([np.linspace(0.0, 100.0, 6), np.zeros(6), np.full(6, 3.0)], axis=1)[None], labels=["low"])
    beside = Surroundings([Cylinder((50, -40, -9), (50, 40, -9), 4.0)], 1.0)
    assert inside_doubt(seen, beside) is None and "edges of 20 mm are too long" in mesh_doubt(seen.rest_length, beside)
    assert inside_doubt(seen, Surroundings([Cylinder((40, -40, 0), (40, 40, 0), 10.0)], 1.0)).startswith(
        "the axis of observation low is 7 mm inside an obstacle")


@pytest.mark.parametrize("command", ["simulate", "predict", "group"])
def test_scenes_too_coarse_for_an_obstacle_are_warned_of(monkeypatch, command):
    said = []

    def warn(text):
        said.append(text)
        raise KeyboardInterrupt  # nothing need be computed
    monkeypatch.setattr(loading.terminal, "warn", warn)
    Path("thin.toml").write_text((GROUP if command == "group" else SCENE) + THIN)
    assert main([command, "thin.toml", "--out", "f.npz"]) == 1
    assert all(words in said[0] for words in ("edges of 20 mm", "give 12 edges", "thin.toml"))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Rods 10 and 60 mm above a table, below it and through it; the table, without friction and with it; a motion."""
    folder, x = tmp_path_factory.mktemp("contact"), np.linspace(0, 100, 11)
    rods = np.stack([np.stack([x, 0 * x, height + 0 * x], axis=1) for height in (10.0, 60.0, -10.0)])
    steep = np.array([10.0, 10, 6, 1, -4, -9, -14, -19, -24, -29, -34])
    rods = np.concatenate([rods, np.stack([np.cumsum(np.r_[0, 10, np.full(9, 8.7)]), 0 * x, steep], axis=1)[None]])
    save_observations(folder / "rods.npz", Observations(rods, rest_length=np.full(10, 10.0)))
    save_observations(folder / "low.npz", Observations(rods[:1], rest_length=np.full(10, 10.0)))
    (folder / "table.toml").write_text(PLANE)
    (folder / "single.toml").write_text(PLANE.replace("[[obstacles]]", "[obstacles]"))
    (folder / "grid.toml").write_text('[[obstacles]]\nkind = "grid"\nfile = "none.npz"\n')
    (folder / "rough.toml").write_text(PLANE + "friction = 0.3\n")
    np.savez(folder / "move.npz", start_position_mm=np.array([[0.0, 0, 10], [0, 0, 10], [-10, 0, 10]]), time_s=[0.0, 1.0, 3.0])
    (folder / "scene.toml").write_text(SCENE + PLANE + "friction = 0.4\n")
    return folder


def test_relax_writes_forces_and_gaps_and_counts_infeasible_rods(folder, capsys):
    words = f"relax {folder}/rods.npz {MATERIAL} --obstacles {folder}/table.toml --radius 2 --out f.npz"
    (printed, warned), found = ended(capsys, words), written("f.npz")
    assert "inside an obstacle" in warned and "contact     2 of 4 rods touch an obstacle; smallest gap " in printed
    assert "mm; 1 infeasible" in printed and "3 converged, 1 infeasible" in printed
    assert "infeasible  the c" in printed and "mm inside a Plane" in printed
    assert found["contact_force"].shape == (4, 11, 3) and found["status"].tolist() == [0, 0, 4, 0]
    assert np.isnan(found["distance_mm"]).tolist() == [False, False, True, False]
    assert (found["contact_force"][[0, 3], :, 2].max(axis=1) > 1).all() and not found["contact_force"][[1, 2]].any()
    assert abs(found["smallest_gap_mm"][0]) < 5e-4 and found["smallest_gap_mm"][1] > 10
    summary = json.loads(succeeded(capsys, f"{words} --json"))["contact"]
    assert summary["touching"] == 2 and summary["infeasible"] == 1 and abs(summary["smallest_gap_mm"]) < 5e-4


@pytest.mark.parametrize("table", ["table.toml", pytest.param("rough.toml", marks=pytest.mark.slow)])
def test_predict_carries_rods_over_a_table(folder, capsys, table):
    printed = succeeded(capsys, f"predict {folder}/low.npz --motion {folder}/move.npz {MATERIAL} --obstacles "
                        f"{folder}/{table} --radius 2 --out f.npz --picture f.png --recording f.rrd")
    assert "contact     1 of 1 rods touch" in printed and ("quasi-static steps" in printed) == (table == "rough.toml")
    found = written("f.npz")
    assert found["followed"].all() and found["time_s"].tolist() == [0, 1, 3]
    assert found["contact_force"].shape == (3, 1, 11, 3) and (found["contact_force"][..., 2].max(axis=-1) > 1).all()
    assert np.abs(found["smallest_gap_mm"]).max() < 5e-4
    assert (np.abs(found["contact_force"][-1, ..., :2]).max() > 1e-3) == (table == "rough.toml")


RELAX = f"relax rods.npz {MATERIAL} --out f.npz"
SEEN = "--rig rig.yaml --rest-length 3:9 --bend 6e5 --out f.npz"


@pytest.mark.parametrize("words, message", [
    (f"{RELAX} --obstacles table.toml --radius 0", "--radius: '0' is not a positive number"),
    (f"{RELAX} --radius 1", "--radius: given without --obstacles"), (f"{RELAX} --obstacles no.toml --radius 1", "no.toml"),
    (f"{RELAX} --obstacles table.toml --radius 1 --solver descent", "--solver: descent given beside"),
    (f"{RELAX} --obstacles single.toml --radius 1", "obstacles: one table, in single brackets; write [[obstacles]]"),
    (f"{RELAX} --obstacles grid.toml --radius 2", "none.npz: file: no such file"),
    ("simulate scene.toml --out f.npz --obstacles table.toml --radius 2", "the scene has its own"),
    *((f"{command} --obstacles table.toml", "--radius: missing beside --obstacles") for command in (
        RELAX, "sweep rods.npz --bend 1e5:1e6:3 --out run", f"perceive a.png {SEEN}", f"track --frames frames.csv {SEEN}"))])
def test_wrong_options_are_refused_in_one_line(folder, capsys, monkeypatch, words, message):
    monkeypatch.chdir(folder)
    refused(capsys, folder, words, message)
