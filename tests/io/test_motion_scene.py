"""Scenes of motion: the shipped ones with their results, and errors in others."""

from pathlib import Path

import numpy as np
import pytest

from doo_ti import Clamp, Configuration, predict
from doo_ti.dynamics.scene import load_motion_scene
from tests.conftest import check_refused

SCENES = Path(__file__).resolve().parents[2] / "scenes" / "motion"
GOOD = """
[rod]
length_mm = 60.0
edges = 20
[materials.cord]
bend = 1e6
twist = 5e5
[[moments]]
end_position_mm = [50, 0, 0]
[[moments]]
time_s = 1
end_rotation_deg = 30
"""


def carried(name: str):
    scene = load_motion_scene(SCENES / f"{name}.toml")
    prediction = predict(scene.start, scene.material, scene.clamps, scene.path, between=scene.between)
    assert prediction.followed.all()
    return scene, prediction


@pytest.mark.thorough
def test_one_start_and_three_materials():
    """Fig. 1: the same clamps, different shapes."""
    scene, prediction = carried("three_materials")
    assert scene.names == ("nylon", "vicryl", "silk")
    ends = prediction.vertices[-1]
    np.testing.assert_allclose(ends[:, [0, -1]], np.broadcast_to(ends[0, [0, -1]], (3, 2, 3)), atol=1e-6)
    apart = [np.linalg.norm(ends[i] - ends[j], axis=1).max() for i, j in ((0, 1), (0, 2), (1, 2))]
    assert min(apart) > 10


@pytest.mark.thorough
def test_a_loop_is_thrown_and_pops_out():
    """The loop forms while the ends come together, persists while most of the twist is removed, and pops out at the end."""
    scene, prediction = carried("loop_pop_out")
    jumps = np.flatnonzero(prediction.jumps[:, 0])
    assert len(jumps) == 2
    thrown, popped = prediction.time[jumps]
    rotation = np.degrees(prediction.end_rotation[:, 0])
    assert 2 < thrown <= 4 < popped < 7
    # While the loop is there a turn of writhe is, too: twist is a whole turn short of what the clamp did.
    short = rotation - np.degrees(prediction.total_twist[:, 0])
    inside = slice(jumps[0], jumps[1])
    assert (short[inside] > 300).all() and np.abs(short[-1]) < 10 and np.abs(short[: jumps[0] - 40]).max() < 90


@pytest.mark.thorough
def test_a_suture_is_pulled_straight():
    scene, prediction = carried("pulled_straight")
    ends = prediction.vertices[-1]
    assert np.abs(ends[..., 1:]).max() < 3 and prediction.jumps.sum() == 0


def test_omitted_quantities_stay_as_they_were(tmp_path):
    file = tmp_path / "scene.toml"
    file.write_text(GOOD, encoding="utf-8")
    scene = load_motion_scene(file)
    assert scene.name == "scene" and scene.between == 1 and scene.start.edges == 20
    np.testing.assert_allclose(scene.path.end_position[:, 0], [[50, 0, 0], [50, 0, 0]])
    np.testing.assert_allclose(scene.clamps.end_position, [[60, 0, 0]])
    np.testing.assert_allclose(np.degrees(scene.path.end_rotation[:, 0]), [0, 30])


def test_one_scene_is_for_predict_and_simulate(tmp_path):
    """At the instants of a rate, smooth between moments; without one the moments themselves, which simulate does not take."""
    file = tmp_path / "scene.toml"
    file.write_text("rate_hz = 4\nduration_s = 1\n" + GOOD.replace("end_rotation_deg = 30", "end_turns = 0.25"))
    scene = load_motion_scene(file)
    np.testing.assert_allclose(np.degrees(scene.path.end_rotation[:, 0]), 90 * np.array([0, 0.25, 0.5, 0.75, 1]), atol=1e-9)
    np.testing.assert_array_equal(scene.path.end_frame[:, 0], scene.grippers.end_frame[0])
    assert scene.clamps.end == Clamp.FREE and scene.stepping.rate == 4 and scene.dynamics.density == 1
    file.write_text(GOOD, encoding="utf-8")
    assert load_motion_scene(file).stepping is None and load_motion_scene(file).clamps.end == Clamp.FRAME


def test_a_clamp_that_turns_along_the_material_has_a_frame(tmp_path):
    """Its first direction is where m1 of the rod pointed."""
    file = tmp_path / "scene.toml"
    m1 = Configuration.straight((0, 0, 0), (1, 0, 0), 60.0, 20).frames[0, -1, :, 1]
    file.write_text(GOOD.replace("[50, 0, 0]", f"[50, 0, 0]\nend_direction = {m1.tolist()}"), encoding="utf-8")
    frame = load_motion_scene(file).path.end_frame[0, 0]
    np.testing.assert_allclose(frame[:, :2], np.stack([m1, [-1, 0, 0]], axis=-1), atol=1e-12)


@pytest.mark.parametrize("old, new, word", [
    ("[rod]", "[rods]", "rod"), ("edges = 20", "edges = 2", "rod.edges"), ("= 60.0", "= -1", "rod.length_mm"),
    ("[materials.cord]", "[materials]", "materials"), ("bend = 1e6", "bend = [1, 2]", "bend"),
    ("bend = 1e6", "bend = -1e6", "positive definite"), ("time_s = 1", "", "time_s"), ("time_s = 1", "time_s = 0", "rise"),
    ("[50, 0, 0]", "[50, 0]", "end_position_mm"), ("end_rotation_deg = 30", "end_direction = [0, 0, 0]", "end_direction"),
    ("end_rotation_deg = 30", "colour = 3", "moments\\[1\\].colour"), ("length_mm", "length = [", "TOML"),
])
def test_wrong_scenes_are_named(tmp_path, old, new, word):
    file = tmp_path / "scene.toml"
    assert old in GOOD
    file.write_text(GOOD.replace(old, new, 1), encoding="utf-8")
    check_refused(f"scene.toml: .*{word}", load_motion_scene, file)


def test_names_of_several_lines_take_one(tmp_path):
    (tmp_path / "scene.toml").write_text('name = "a\\nb"\n' + GOOD.replace("[materials.cord]", '[materials."c\\nd"]'))
    scene = load_motion_scene(tmp_path / "scene.toml")
    assert scene.name == r"a\nb" and scene.names == (r"c\nd",)
