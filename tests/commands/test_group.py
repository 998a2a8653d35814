"""``doo-ti group``: from a scene to files, and what it refuses."""

import json

import numpy as np
import pytest

from doo_ti import Status, follow_group
from tests.commands.calls import ended, refused, succeeded, written

SCENE = """
name = "two rods"
radius_mm = 1.0
rate_hz = 10
duration_s = 0.2
materials.rope = { bend = 1e5, weight = 0.5 }
[rods]
trunk = { edges = 8, length_mm = 80.0, start = "frame", moments = [{ time_s = 0.2, start_position_mm = [0, 0, 10] }] }
branch = { edges = 4, length_mm = 40.0, position_mm = [50, 5, 0], direction = [0, 1, 0] }
[[ties]]
first = ["trunk", -1]
second = ["branch", 0]
weight = 2.0
"""
PULLED = SCENE.replace('start = "frame"', 'start = "frame", end = "position"').replace(
    "start_position_mm = [0, 0, 10]", "start_position_mm = [-10, 0, 0]")
"""Its trunk is too short for both of its clamps in the end."""


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(SCENE)
    return path


DRAWN = "group scene.toml --out f.npz --picture f.png --recording f.rrd"


def test_places_forces_and_pictures_are_written(scene, tmp_path, capsys):
    summary = json.loads(succeeded(capsys, f"{DRAWN} --json"))
    assert (summary["rods"], summary["edges"], summary["ties"], summary["moments"]) == (2, 12, 1, 3)
    assert summary["status"] == {"converged": 3} and summary["stable"] == 3
    found = written("f.npz")
    assert found["positions_mm"].shape == found["contact_force"].shape == (3, 14, 3)
    assert found["rod"].tolist() == [0] * 9 + [1] * 5 and found["edge_rod"].tolist() == [0] * 8 + [1] * 4
    assert found["rod_names"].tolist() == ["trunk", "branch"] and not found["status"].any()
    np.testing.assert_allclose(found["positions_mm"][:, 8], found["positions_mm"][:, 9], atol=1e-8)
    np.testing.assert_allclose(found["positions_mm"][:, 0], [[0, 0, 0], [0, 0, 5], [0, 0, 10]], atol=1e-8)
    # The clamp bears the weight: 2 w per mm of rods with the weight w = 0.5, and the tie's.
    np.testing.assert_allclose(found["start_force"][:, 0], [[0, 0, 2 * 0.5 * 120 + 2.0]] * 3, rtol=1e-6, atol=1e-6)
    for name in ("f.png", "f.rrd"):
        assert (tmp_path / name).stat().st_size > 10_000
    text = succeeded(capsys, "group scene.toml --out f.npz")
    assert "two rods: 2 rods of 12 edges in all, 1 tie, 3 moments in 0.2 s" in text and "trunk, start 122 mm²/mm" in text


def test_forces_are_in_newton_where_masses_are_known(scene, tmp_path, capsys):
    """The clamp bears rods of 2 g/m and 4 g/m and a connector of 5 g, whichever material comes first."""
    own = ["materials.light = { EI = 1e-6, linear_density = 2.0 }", "materials.rope = { EI = 1e-5, linear_density = 4.0 }"]
    for materials in (own, own[::-1]):
        scene.write_text(SCENE.replace("materials.rope = { bend = 1e5, weight = 0.5 }", "\n".join(materials)).replace(
            "edges = 8", 'edges = 8, material = "rope"').replace("edges = 4", 'edges = 4, material = "light"').replace(
            "weight = 2.0", "mass_g = 5.0"))
        text = succeeded(capsys, "group scene.toml --out f.npz")
        found, weight = written("f.npz"), 9.80665e-3 * (0.08 * 4.0 + 0.04 * 2.0 + 5.0)
        np.testing.assert_allclose(found["start_force_N"][-1, 0], [0, 0, weight], atol=1e-8)
        np.testing.assert_allclose(np.linalg.norm(found["tie_force_N"][-1]), 9.80665e-3 * 0.04 * 2.0, rtol=1e-6)
        assert f"trunk, start {weight:.4g} N" in text and found["end_force_N"].shape == (3, 2, 3)
    scene.write_text(SCENE.replace("weight = 2.0", "mass_g = 5.0"))
    refused(capsys, tmp_path, "group scene.toml --out g.npz", "ties[0].mass_g")


def test_what_does_not_converge_is_said_and_written_and_where_nothing_has_a_place_not_drawn(scene, tmp_path, capsys):
    scene.write_text(PULLED)
    summary, found = json.loads(ended(capsys, "group scene.toml --out f.npz --json", 1)[0]), written("f.npz")
    assert found["status"][-1] == Status.INFEASIBLE and np.isnan(found["positions_mm"][-1]).all()
    assert summary["status"]["infeasible"] >= 1 and 0.2 in summary["failed_s"]
    scene.write_text(PULLED.replace("time_s = 0.2", "time_s = 0.0"))
    out, err = ended(capsys, DRAWN, 1)
    assert "note: " in err and "3 infeasible" in out
    assert sorted(path.name for path in tmp_path.iterdir()) == ["f.npz", "scene.toml"]


def test_rods_that_begin_in_each_other_are_named(scene, tmp_path, capsys):
    scene.write_text("""
radius_mm = 1.0
materials.m = { bend = 1e5, twist = 1e5 }
[rods]
one = { length_mm = 100, edges = 10, position_mm = [0, 0, 0], direction = [1, 0, 0], start = "frame" }
other = { length_mm = 100, edges = 10, position_mm = [50, -50, 0.05], direction = [0, 1, 0], start = "frame" }
""")
    assert "one and other begin 0.05 mm apart" in ended(capsys, "group scene.toml --out f.npz", 1)[0]
    scene.write_text(scene.read_text().replace("0.05]", "1.9]"))
    assert "forces on one" in succeeded(capsys, "group scene.toml --out f.npz")


def test_what_is_done_before_an_interruption_stays(scene, tmp_path, capsys, monkeypatch):
    def interrupted(*arguments, **options):
        yield next(follow_group(*arguments, **options))
        raise KeyboardInterrupt
    monkeypatch.setattr("doo_ti.groups.follow.follow_group", interrupted)
    assert "interrupted: 1 of 3 moments are in" in ended(capsys, "group scene.toml --out f.npz", 1)[1]
    found = written("f.npz")
    assert found["time_s"].shape == found["status"].shape == (1,) and found["positions_mm"].shape == (1, 14, 3)


@pytest.mark.parametrize(("words", "said"), [
    ("--out f.csv", "--out: suffix '.csv' of f.csv; name a file that ends in .npz"), ("", "--out: missing"),
    ("--out f.npz --picture f.gif", "--picture: suffix '.gif'"), ("--out f.npz --up 0,0,0", "up: ")])
def test_wrong_input_is_one_line(scene, tmp_path, capsys, words, said):
    refused(capsys, tmp_path, f"group scene.toml {words}", said)
