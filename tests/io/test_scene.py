"""Scenes: the meaning of a TOML file and errors in it; those of the package, by name, from any folder; scenes of motion."""

import re
from pathlib import Path

import numpy as np
import pytest

from doo_ti import Clamp, Configuration, predict
from doo_ti.dynamics.scene import load_motion_scene
from doo_ti.groups.scene import load_group_scene
from doo_ti.io.scene import Synthesis, load_scene
from doo_ti.io.toml_file import NotNegative, Table, Vector, interpolated, scene_file
from doo_ti.rod.material import STANDARD_GRAVITY
from tests.conftest import check_refused
from tests.processes import ROOT

SCENES = ROOT / "scenes"
GOOD = {
    "top": 'name = "silk"\nframe_weight_mm = 6.7\nclamp_end = "tangent"\nprecision = "f64"\n',
    "data": "[synthesis]\nbend = 1.5e5\ntwist = 50000\n", "grid": '[grid]\nbend = "5e4:1e7:5"\ntwist_ratio = 0.5\n'}


def write(folder: Path, **parts: str) -> Path:
    path = folder / "scene.toml"
    path.write_text("".join((GOOD | parts).values()), encoding="utf-8")
    return path


@pytest.mark.parametrize("name", ["vicryl", "nylon", "silk", "ribbon"])
def test_shipped_scenes(name):
    scene = load_scene(SCENES / f"{name}.toml")
    assert scene.name == name and scene.grid.size == 625 and isinstance(scene.observations, Synthesis)
    assert (scene.clamp_start, scene.clamp_end) == (Clamp.FRAME, Clamp.FRAME)
    assert len(scene.observations.end_distances_mm) * len(scene.observations.end_rotations_deg) == 60
    material = scene.observations.material()
    assert material.is_isotropic == (name != "ribbon") and scene.frame_weight == (6.7 if name == "ribbon" else 0)
    for axis, truth in zip(scene.grid.axes, (material.bend[0, 0, 0, 0], material.bend[0, 0, 1, 1]), strict=False):
        if axis.name.startswith("bend"):
            assert axis.values[0] < truth < axis.values[-1]


def test_seeds_of_shipped_scenes_differ():
    seeds = [load_scene(path).observations.seed for path in sorted(SCENES.glob("*.toml"))]
    assert len(set(seeds)) == len(seeds)


def test_a_scene_with_a_synthesis_or_a_file(tmp_path):
    scene = load_scene(write(tmp_path))
    assert (scene.name, scene.frame_weight, scene.precision, scene.objective) == ("silk", 6.7, "f64", "static")
    assert (scene.clamp_start, scene.clamp_end) == (None, Clamp.TANGENT)
    assert scene.grid.shape == (5, 1, 1) and scene.observations.name == "silk" and len(scene.sha256) == 64
    assert scene.observations.twist == 50000.0 and scene.observations.marks == 34
    scene = load_scene(write(tmp_path, top="", data='[observations]\nfile = "data/silk.npz"\n'))
    assert scene.observations == tmp_path / "data" / "silk.npz" and scene.name == "scene" and scene.precision == "mixed"


def test_a_dynamic_scene(tmp_path):
    scene = load_scene(write(tmp_path, top='objective = "dynamic"\npairs = "data/pairs.csv"\nroll_hypotheses = 12\n'))
    assert (scene.objective, scene.pairs, scene.roll_hypotheses) == ("dynamic", tmp_path / "data" / "pairs.csv", 12)
    scene = load_scene(write(tmp_path, top='objective = "dynamic"\n'))
    assert (scene.pairs, scene.roll_hypotheses) == (None, 0)
    assert load_scene(write(tmp_path, top="spins = 7\n")).roll_hypotheses == 7  # as scenes used to call it


def test_an_anisotropic_scene(tmp_path):
    ribbon = "[synthesis]\nbend = [[6e6, 1e5], [1e5, 1.2e5]]\ntwist = 5e5\nframes = true\n"
    scene = load_scene(write(tmp_path, data=ribbon, grid='[grid]\nbend = "3e6,2e6,-1e6"\n'))
    np.testing.assert_array_equal(scene.observations.material().bend[0, 0], [[6e6, 1e5], [1e5, 1.2e5]])
    assert scene.grid.bend_12 == -1e6 and scene.observations.frames


RECIPE = "[synthesis]\nbend = {}\ntwist = {}\n"


@pytest.mark.parametrize("part, text, field", [
    ("top", "name = silk\n", "file"), ("top", f"x={'[' * 20_000}", "file"), ("top", 'name = "../../x"\n', "name"),
    ("top", 'name = "a\\u0000b"\n', "name"), ("top", "colour = 3\n", "colour"), ("data", "", "observations"),
    ("grid", "[grid]\nbend = 3\nstretch = 3\n", "grid.stretch"), ("data", "[observations]\n", "observations.file"),
    ("data", GOOD["data"] + '[observations]\nfile = "x.npz"\n', "observations"), ("grid", "", "grid"),
    ("grid", '[grid]\nbend = "1e5:1e6:0"\n', "bend"), ("grid", "[grid]\ntwist = 3\n", "bend"),
    ("grid", "[grid]\nbend = [1, 2]\n", "grid.bend"), ("top", 'clamp_start = "glued"\n', "clamp_start"),
    ("top", 'objective = "both"\n', "objective"), ("top", 'pairs = "pairs.csv"\n', "pairs"), ("top", "spins = -1\n", "spins"),
    ("top", "precision = 64\n", "precision"), ("top", "frame_weight_mm = -1\n", "frame_weight_mm"),
    ("data", "[synthesis]\nbend = 1e5\n", "synthesis.twist"), ("data", RECIPE.format(1, -1), "synthesis.twist"),
    *(("data", RECIPE.format(bend, 1), "synthesis.bend") for bend in (
        "[[1, 2], [2, 1]]", "[[1, 0.5], [0, 1]]", "[[1], [2, 3]]", "nan")),
    *(("data", f"{GOOD['data']}{line}\n", f"synthesis.{line.split(' = ')[0]}") for line in (
        "stretch = 3", "seed = -1", "marks = 2", "marks = 30", f"marks = {'9' * 400}", "clip_mm = 2.5", "clip_mm = 50",
        "clip_mm = [3, 2.5]", "clip_mm = nan", "clip_mm = [3, 3, 3]", "clip_mm = [0, 3]", "rest_curvature_range_mm = 100",
        "clip_tilt_deg = 180", "clip_offset_mm = nan", "end_distances_mm = [30, 120]", "end_distances_mm = []",
        "end_rotations_deg = [0, 0]", "end_rotations_deg = [1e18]", "start_direction = [0, 0, 0]"))])
def test_wrong_scenes_are_named(tmp_path, part, text, field):
    path = write(tmp_path, **{part: text})
    remedy = "; .*label_noise_mm" if field == "synthesis.stretch" else ""
    check_refused("^" + re.escape(f"{path}: {field}: ") + f".*{remedy}", load_scene, path)


@pytest.mark.parametrize(("name", "file"), [
    ("vicryl", "vicryl.toml"), ("vicryl.toml", "vicryl.toml"), ("scenes/vicryl.toml", "vicryl.toml"),
    ("whip", "motion/whip.toml"), ("groups/reef_knot", "groups/reef_knot.toml"),
    ("scenes/motion/whip.toml", "motion/whip.toml"), ("rig.yaml", "rig.yaml")])
def test_a_scene_is_found_in_any_folder(name, file, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert Path(scene_file(name)).read_bytes() == (SCENES / file).read_bytes()


@pytest.mark.parametrize("name", ["silk", "", "no_such", "../scenes/vicryl.toml", "/vicryl.toml", "scenes", ".", "motion"])
def test_files_of_that_name_come_first_and_other_names_stay_as_they_are(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "silk").touch()
    assert scene_file(name) == name


EI, GJ, DENSITY = 2e-5, 1.5e-5, 4.0
WEIGHT = 1e-3 * DENSITY * STANDARD_GRAVITY  # N/m
SHARED = {
    load_motion_scene: "rod = { length_mm = 60.0, edges = 20 }\nrate_hz = 10.0\nduration_s = 1.0\n",
    load_group_scene: "".join(f'rods.{name} = {{ material = "{name}", edges = 10, length_mm = 90.0 }}\n' for name in "ab")}


def loaded(folder, load, *materials: str):
    text = SHARED[load] + "".join(f"[materials.{name}]\n{one}\n" for name, one in zip("ab", materials, strict=False))
    (folder / "scene.toml").write_text(text)
    return load(folder / "scene.toml")


def test_stiffness_in_newton(tmp_path):
    scene = loaded(tmp_path, load_motion_scene, f"EI = {EI}\nGJ = {GJ}\nlinear_density = {DENSITY}",
                   f"bend = 3e5\ntwist = 2e5\nweight = 2.0\nlinear_density = {2 * DENSITY}")
    np.testing.assert_allclose(np.squeeze(scene.material.bend[0]) / 2e9 * WEIGHT, EI * np.eye(2))
    np.testing.assert_allclose(scene.material.twist[:, 0], [2e9 * GJ / WEIGHT, 2e5])
    assert scene.material.weight.tolist() == [1.0, 2.0]
    # A rod lying on the ground is held by twice its weight for each mm of it, in the units of the package, or its weight in N.
    np.testing.assert_allclose(scene.newtons * 2 * scene.material.weight * 60, 60e-3 * WEIGHT * np.array([1.0, 2.0]))
    scene = loaded(tmp_path, load_motion_scene, "bend = 3e5\ntwist = 2e5", f"EI = {EI}\nGJ = {GJ}\nlinear_density = 3")
    assert scene.newtons is None


def test_rods_of_a_group_share_one_unit(tmp_path):
    """Stiffness over the unit of weight per length, that of the first material, and weights in proportion."""
    scene = loaded(tmp_path, load_group_scene, f"EI = {EI}\nlinear_density = {DENSITY}",
                   f"EI = [[{EI}, 0], [0, {2 * EI}]]\nGJ = {GJ}\nlinear_density = {3 * DENSITY}")
    first, second = scene.group.materials
    np.testing.assert_allclose(second.bend[0], first.bend[0] * np.diag([1.0, 2.0]))
    np.testing.assert_allclose([first.twist.item(), second.twist.item()], 2e9 * np.array([EI, GJ]) / WEIGHT)
    assert [one.weight.item() for one in scene.group.materials] == [1.0, 3.0] and np.isclose(scene.newton, 5e-4 * WEIGHT)
    relative = loaded(tmp_path, load_group_scene, f"bend = 1e5\nlinear_density = {DENSITY}",
                      f"bend = 1e5\nweight = 3.0\nlinear_density = {3 * DENSITY}")
    assert np.isclose(relative.newton, 5e-4 * WEIGHT)


@pytest.mark.parametrize("load, tables, said", [
    (load_motion_scene, ["EI = 1e-5"], "materials.a.linear_density: missing"),
    (load_motion_scene, ["EI = 1e-5\nbend = 1e5\nlinear_density = 3"], "materials.a.bend: given beside EI"),
    (load_motion_scene, ["EI = 1e-5\nweight = 1\nlinear_density = 3"], "materials.a.weight: given beside EI"),
    (load_motion_scene, ["bend = 1e5\nGJ = 1e-5\nlinear_density = 3"], "materials.a.GJ: given beside bend"),
    (load_motion_scene, ["linear_density = 3"], "materials.a.bend: missing"),
    (load_motion_scene, ["EI = -1e-5\nlinear_density = 3"], "materials.a.EI"),
    (load_motion_scene, ["bend = [[1e5, 0], [0, 1e5]]\ntwist = 1e5"], "materials.a.bend: a matrix"),
    (load_group_scene, ["EI = 1e-5\nlinear_density = 3", "bend = 1e5"], "materials.b: in other units"),
    (load_group_scene, ["bend = 1e5\nlinear_density = 3", "bend = 1e5\nlinear_density = 4"], "not proportional"),
    (load_group_scene, ["EI = [[1e-5, 0], [0, 1e-5]]\nlinear_density = 3", "bend = 1e5"], "materials.b")])
def test_what_does_not_fit_is_named(tmp_path, load, tables, said):
    check_refused(said, loaded, tmp_path, load, *tables)


class Moment(Table):
    time_s: NotNegative
    shift: Vector | None = None


@pytest.mark.parametrize(("moments", "first"), [
    ([], [0, 0, 0, 0, 0]), ([(0.0, 3.0)], [3, 3, 3, 3, 3]),
    ([(0.0, 1.0), (1.0, 2.0), (1.5, None)], [1, None, 2, 2, 2])])  # what is left out stays as it was
def test_quantities_between_moments(moments, first):
    rows = [{"time_s": time} | ({} if shift is None else {"shift": [shift, 0.0, 0.0]}) for time, shift in moments]
    found = interpolated("scene.toml", "moments", rows, Moment, {"shift": np.zeros(3)}, np.linspace(0.0, 2.0, 5))
    for value, expected in zip(found["shift"][:, 0], first, strict=True):
        assert 1.0 < value < 2.0 if expected is None else np.isclose(value, expected)


MOTION = """
rod = { length_mm = 60.0, edges = 20 }
materials.cord = { bend = 1e6, twist = 5e5 }
[[moments]]
end_position_mm = [50, 0, 0]
[[moments]]
time_s = 1
end_rotation_deg = 30
"""


@pytest.mark.thorough
def test_a_loop_is_thrown_and_pops_out():
    """The loop forms while the ends come together, persists while most of the twist is removed, and pops out at the end."""
    scene = load_motion_scene(SCENES / "motion" / "loop_pop_out.toml")
    prediction = predict(scene.start, scene.material, scene.clamps, scene.path, between=scene.between)
    assert prediction.followed.all()
    jumps = np.flatnonzero(prediction.jumps[:, 0])
    assert len(jumps) == 2
    thrown, popped = prediction.time[jumps]
    rotation = np.degrees(prediction.end_rotation[:, 0])
    assert 2 < thrown <= 4 < popped < 7
    # While the loop is there a turn of writhe is, too: twist is a whole turn short of what the clamp did.
    short, inside = rotation - np.degrees(prediction.total_twist[:, 0]), slice(jumps[0], jumps[1])
    assert (short[inside] > 300).all() and np.abs(short[-1]) < 10 and np.abs(short[: jumps[0] - 40]).max() < 90


def test_omitted_quantities_stay_as_they_were_and_names_of_several_lines_take_one(tmp_path):
    (tmp_path / "scene.toml").write_text(MOTION, encoding="utf-8")
    scene = load_motion_scene(tmp_path / "scene.toml")
    assert scene.name == "scene" and scene.between == 1 and scene.start.edges == 20
    np.testing.assert_allclose(scene.path.end_position[:, 0], [[50, 0, 0], [50, 0, 0]])
    np.testing.assert_allclose(scene.clamps.end_position, [[60, 0, 0]])
    np.testing.assert_allclose(np.degrees(scene.path.end_rotation[:, 0]), [0, 30])
    (tmp_path / "scene.toml").write_text('name = "a\\nb"\n' + MOTION.replace("materials.cord", 'materials."c\\nd"'))
    scene = load_motion_scene(tmp_path / "scene.toml")
    assert scene.name == r"a\nb" and scene.names == (r"c\nd",)


def test_one_scene_is_for_predict_and_simulate(tmp_path):
    """At the instants of a rate, smooth between moments; without one the moments themselves, which simulate does not take."""
    file = tmp_path / "scene.toml"
    file.write_text("rate_hz = 4\nduration_s = 1\n" + MOTION.replace("end_rotation_deg = 30", "end_turns = 0.25"))
    scene = load_motion_scene(file)
    np.testing.assert_allclose(np.degrees(scene.path.end_rotation[:, 0]), 90 * np.array([0, 0.25, 0.5, 0.75, 1]), atol=1e-9)
    np.testing.assert_array_equal(scene.path.end_frame[:, 0], scene.grippers.end_frame[0])
    assert scene.clamps.end == Clamp.FREE and scene.stepping.rate == 4 and scene.dynamics.density == 1
    file.write_text(MOTION, encoding="utf-8")
    assert load_motion_scene(file).stepping is None and load_motion_scene(file).clamps.end == Clamp.FRAME


def test_a_clamp_that_turns_along_the_material_has_a_frame(tmp_path):
    """Its first direction is where m1 of the rod pointed."""
    file = tmp_path / "scene.toml"
    m1 = Configuration.straight((0, 0, 0), (1, 0, 0), 60.0, 20).frames[0, -1, :, 1]
    file.write_text(MOTION.replace("[50, 0, 0]", f"[50, 0, 0]\nend_direction = {m1.tolist()}"), encoding="utf-8")
    frame = load_motion_scene(file).path.end_frame[0, 0]
    np.testing.assert_allclose(frame[:, :2], np.stack([m1, [-1, 0, 0]], axis=-1), atol=1e-12)


@pytest.mark.parametrize("old, new, word", [
    ("rod = ", "rods = ", "rod"), ("edges = 20", "edges = 2", "rod.edges"), ("= 60.0", "= -1", "rod.length_mm"),
    ("materials.cord", "materials", "materials"), ("bend = 1e6", "bend = [1, 2]", "bend"),
    ("bend = 1e6", "bend = -1e6", "positive definite"), ("time_s = 1", "", "time_s"), ("time_s = 1", "time_s = 0", "rise"),
    ("[50, 0, 0]", "[50, 0]", "end_position_mm"), ("end_rotation_deg = 30", "end_direction = [0, 0, 0]", "end_direction"),
    ("end_rotation_deg = 30", "colour = 3", "moments\\[1\\].colour"),
    ("end_rotation_deg = 30", 'end_turns = "two"', "end_turns"),
    ("edges = 20", "edges = 45, radius_mm = 0.8, knot_loop_mm = 10.0", "rod.length_mm: 60 mm"),
    ("length_mm", "length = [", "TOML")])
def test_wrong_scenes_of_motion_are_named(tmp_path, old, new, word):
    file = tmp_path / "scene.toml"
    assert old in MOTION
    file.write_text(MOTION.replace(old, new, 1), encoding="utf-8")
    check_refused(f"scene.toml: .*{word}", load_motion_scene, file)
