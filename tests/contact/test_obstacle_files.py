"""Obstacles in TOML files, and the gaps and meshes of what they state."""


import numpy as np
import pytest

from doo_ti import Box, Capsule, Cylinder, InputError, Plane, Ring, Sphere, Surroundings, load_obstacles
from doo_ti.contact.meshes import mesh
from doo_ti.dynamics.scene import load_motion_scene

ALL = """
[[obstacles]]
kind = "plane"
point = [0, 0, 0]
normal = [0, 0, 2]
friction = 0.3
[[obstacles]]
kind = "sphere"
centre = [1, 2, 30]
radius = 5
[[obstacles]]
kind = "capsule"
start = [0, 0, 0]
end = [10, 0, 40]
radius = 2.0
[[obstacles]]
kind = "cylinder"
start = [0, 0, 0]
end = [0, 10, 0]
radius = 2.0
[[obstacles]]
kind = "ring"
centre = [0, 0, 5]
axis = [0, 1, 1]
radius = 4.0
thickness = 1.0
[[obstacles]]
kind = "box"
centre = [0, 0, 0]
size = [2, 4, 6]
rotation = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
"""
BAD = {
    "an unknown kind": ('kind = "plane"', 'kind = "cone"', "obstacles[0].kind", "plane, sphere"),
    "no kind": ('kind = "plane"', "", "obstacles[0].kind", "missing"),
    "an unknown key": ("friction = 0.3", "grip = 0.3", "obstacles[0].grip", "the keys are kind, point, normal"),
    "a missing key": ("radius = 5", "", "obstacles[1].radius", "missing"),
    "a negative radius": ("radius = 5", "radius = -5", "obstacles[1].radius", "number > 0"),
    "a negative friction": ("friction = 0.3", "friction = -1", "obstacles[0].friction", "number >= 0"),
    "a plane without direction": ("[0, 0, 2]", "[0, 0, 0]", "obstacles[0].normal", "not all zero"),
    "a closed ring": ("thickness = 1.0", "thickness = 4.0", "obstacles[4].thickness", "less than the radius"),
    "no rotation": ("[[0, -1, 0]", "[[0, -2, 0]", "obstacles[5].rotation", "rotation matrix"),
    "not a matrix": ("[[0, -1, 0], [1, 0, 0], [0, 0, 1]]", "[0, 1, 0]", "obstacles[5].rotation", "three rows"),
    "nothing": (ALL, "", "obstacles", "missing"),
    "no table": (ALL, "obstacles = [3]", "obstacles[0].kind", "missing"),
}


def test_all_kinds_are_read(tmp_path):
    (tmp_path / "all.toml").write_text(ALL)
    found = load_obstacles(tmp_path / "all.toml")
    assert [type(one) for one in found] == [Plane, Sphere, Capsule, Cylinder, Ring, Box]
    assert found[0].friction == 0.3 and found[1].friction == 0 and (found[1].centre == [[1, 2, 30]]).all()
    assert found[5].rotation[0, 0, 1] == -1


@pytest.mark.parametrize("case", BAD)
def test_bad_files_name_file_key_and_remedy(tmp_path, case):
    before, after, key, remedy = BAD[case]
    assert before in ALL
    path = tmp_path / "bad.toml"
    path.write_text(ALL.replace(before, after, 1))
    with pytest.raises(InputError) as error:
        load_obstacles(path)
    text = str(error.value)
    assert text.startswith(f"{path}: {key}: ") and remedy in text and "\n" not in text


SCENES = {
    "with a rate": "rate_hz = 10\nduration_s = 1\n[rod]\nlength_mm = 100\nedges = 5\n[materials.a]\nbend = 1e5\n",
    "without": "[rod]\nlength_mm = 100\nedges = 5\n[materials.a]\nbend = 1e5\n[[moments]]\n[[moments]]\n"
                       "time_s = 1.0\n",
}


@pytest.mark.parametrize("kind", SCENES)
def test_scenes_have_obstacles_and_the_radius_of_the_rod(tmp_path, kind):
    path = tmp_path / "scene.toml"
    path.write_text(SCENES[kind] + ALL)
    with pytest.raises(InputError, match=r"rod\.radius_mm: missing beside obstacles"):
        load_motion_scene(path)
    path.write_text((SCENES[kind] + ALL).replace("edges = 5", "edges = 5\nradius_mm = 30"))  # more than an edge is allowed
    found = load_motion_scene(path).surroundings()
    assert found.radius == 30 and len(found.obstacles) == 6
    path.write_text((SCENES[kind] + ALL).replace("edges = 5", "edges = 5\nradius_mm = 0"))
    with pytest.raises(InputError, match=r"rod\.radius_mm: 0 is not allowed; give a number > 0"):
        load_motion_scene(path)


def test_gaps_are_those_of_edges_too():
    rods = np.array([[[-30.0, 0, 12], [30, 0, 12]], [[-30, 0, 40], [30, 0, 5]], [[np.nan] * 3] * 2])
    around = Surroundings([Sphere((0, 0, 0), 10.0), Plane((0, 0, -1), (0, 0, 1))], 2.0)
    gap = around.smallest_gap(rods)
    assert 0 < gap[0] < 1.0 and gap[1] == pytest.approx(4.0) and np.isnan(gap[2])  # ends are further than 20 from the sphere
    assert (around.take(np.array([1])).smallest_gap(rods[1:2]) == gap[1]).all()
    each = Surroundings([Sphere([[0, 0, 0], [0, 0, 100]], [10.0, 1.0])], np.array([2.0, 3.0]))
    assert each.take(np.array([1])).smallest_gap(rods[1:2]) == pytest.approx(each.smallest_gap(rods[:2])[1])


def test_on_the_axis_of_a_ring_is_far_from_it():
    value, normal = Ring((0, 0, 0), (0, 0, 1), 6.0, 1.5).distance(np.zeros((1, 1, 3)))
    assert value == pytest.approx(4.5) and np.linalg.norm(normal) == pytest.approx(1.0)


def test_meshes_lie_on_the_surfaces(tmp_path):
    (tmp_path / "all.toml").write_text(ALL)
    for obstacle in load_obstacles(tmp_path / "all.toml"):
        vertices, triangles = mesh(obstacle, 0, np.array([5.0, 5.0, 50.0]), 100.0)
        value = obstacle.distance(vertices[None])[0]
        assert np.abs(value).max() < 1e-9 and triangles.min() == 0 and triangles.max() == len(vertices) - 1
