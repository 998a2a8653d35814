"""Scenes of groups: what they state, what is refused, and that those which ship converge."""

import re
from pathlib import Path

import numpy as np
import pytest

from doo_ti import Clamp, Tie, follow_group
from doo_ti.groups.scene import load_group_scene
from tests.conftest import check_refused
from tests.references.rods import certified

SCENES = sorted((Path(__file__).resolve().parents[2] / "scenes" / "groups").glob("*.toml"))
SCENE = """
name = "two rods"
radius_mm = 1.0
rate_hz = 10
duration_s = 0.2
obstacles = [{kind = "plane", point = [0, 0, 0], normal = [0, 0, 1]}]
ties = [
    {first = ["trunk", 5], second = ["ring", 0], weight = 3.0},
    {first = ["ring", 0], second = ["ring", -1], weld = true},
]
[materials]
stiff = {bend = 200000}
ribbon = {bend = [[2e5, 0], [0, 1e5]], twist = 1e5, weight = 0.5}
[rods.trunk]
material = "stiff"
edges = 10
length_mm = 100.0
position_mm = [0, 0, 5]
direction = [0, 2, 0]
start = "frame"
moments = [{time_s = 0.2, start_position_mm = [0, 0, 25], start_turns = 0.25}]
[rods.ring]
material = "ribbon"
edges = 24
points_mm = [[0, 50, 5], [20, 70, 5], [40, 50, 5], [20, 30, 5]]
closed = true
"""


def load(folder, text: str):
    (folder / "scene.toml").write_text(text)
    return load_group_scene(folder / "scene.toml")


def test_a_scene_is_read(tmp_path):
    scene = load(tmp_path, SCENE)
    trunk, ring = scene.group.rods
    assert (scene.name, scene.names, scene.rate) == ("two rods", ("trunk", "ring"), 10.0)
    np.testing.assert_allclose(scene.time, [0.0, 0.1, 0.2])
    np.testing.assert_allclose(trunk.vertices[0, [0, -1]], [[0, 0, 5], [0, 100, 5]], atol=1e-12)
    assert [material.weight[0] for material in scene.group.each_material] == [1.0, 0.5]
    assert [tuple(clamp.start for clamp in moment) for moment in scene.clamps] == [(Clamp.FRAME, Clamp.FREE)] * 3
    np.testing.assert_allclose([moment[0].start_position[0, 2] for moment in scene.clamps], [5.0, 15.0, 25.0])
    first, last = scene.clamps[0][0].start_frame[0], scene.clamps[2][0].start_frame[0]
    np.testing.assert_allclose(last[:, 1], first[:, 2], atol=1e-12)
    assert scene.group.ties == [Tie((0, 5), (1, 0), weight=3.0), Tie((1, 0), (1, -1), weld=True)]
    assert scene.surroundings.radius == 1.0 and len(scene.surroundings.obstacles) == 1


def test_rods_may_differ_in_thickness(tmp_path):
    scene = load(tmp_path, SCENE.replace("edges = 24", "edges = 24\nradius_mm = 2.5"))
    assert scene.surroundings.radius.tolist() == [[1.0, 2.5]]
    bare = SCENE.replace("radius_mm = 1.0\n", "").replace('{kind = "plane", point = [0, 0, 0], normal = [0, 0, 1]}', "")
    thick = bare.replace("edges = 24", "edges = 24\nradius_mm = 2.5")
    check_refused("radius_mm: missing beside that of one rod", load, tmp_path, thick)


def test_scenes_number_vertices_as_without_end_edges(tmp_path):
    """Edges without length at the ends of the trunk."""
    text = SCENE.replace('start = "frame"', 'start = "frame"\nvertex_clamps = true')
    group = load(tmp_path, text).group
    assert group.rods[0].edges == 12 and group.rods[0].rest_length[[0, -1]].tolist() == [0.0, 0.0]
    assert [(tie.first, tie.second) for tie in group.ties] == [((0, 6), (1, 0)), ((1, 0), (1, -1))]
    np.testing.assert_allclose(group.rods[0].vertices[0, 6], [0, 50, 5], atol=1e-9)
    assert load(tmp_path, text.replace('["trunk", 5]', '["trunk", 10]')).group.ties[0].first == (0, -1)
    wrong = text.replace('["trunk", 5]', '["trunk", 11]')
    check_refused("'trunk' has no vertex 11; give one from 0 to 10", load, tmp_path, wrong)


def test_a_closed_curve_goes_smoothly_through_its_points(tmp_path):
    ring = load(tmp_path, SCENE).group.rods[1]
    vertices = ring.vertices[0]
    np.testing.assert_allclose(vertices[0], vertices[-1], atol=1e-9)
    np.testing.assert_allclose(ring.rest_length, ring.rest_length[0], rtol=1e-6)
    # Through four points of a circle a cubic spline keeps to it within 3 %.
    np.testing.assert_allclose(np.linalg.norm(vertices - [20, 50, 5], axis=-1), 20.0, rtol=0.03)
    turned = np.arccos((ring.frames[0, 1:, :, 0] * ring.frames[0, :-1, :, 0]).sum(axis=-1))
    assert turned.max() < 1.5 * 2 * np.pi / 24


@pytest.mark.parametrize(("old", "new", "said"), [
    ('material = "stiff"', "", "rods.trunk.material: missing beside several materials; give one of stiff, ribbon"),
    ('material = "stiff"', 'material = "steel"', "rods.trunk.material: 'steel' is not in the scene"),
    ("length_mm = 100.0", "", "rods.trunk.length_mm: missing"),
    ("closed = true", "closed = true\nlength_mm = 50.0", "rods.ring.length_mm: given beside points_mm"),
    ("length_mm = 100.0", "length_mm = 100.0\nclosed = true", "rods.trunk.closed: given without points_mm"),
    ("[20, 70, 5], ", "[0, 50, 5], ", "rods.ring.points_mm: 0 and 1 are at one place"),
    ("twist = 1e5, ", "", "materials.ribbon.twist: missing beside a matrix"),
    ("[[2e5, 0], [0, 1e5]]", "[[2e5, 9e5], [9e5, 1e5]]", "materials.ribbon.bend: "),
    ("{bend = 200000}\nribbon = {bend = [[2e5, 0], [0, 1e5]], twist = 1e5, weight = 0.5}",
     "{EI = 1e-4, linear_density = 0.1}\nribbon = {EI = [[1e-4, 9e-4], [9e-4, 1e-4]], GJ = 1e-4, linear_density = 0.1}",
     "materials.ribbon.EI: "),
    ("rate_hz = 10", "", "rate_hz: missing beside duration_s"),
    ("duration_s = 0.2", "duration_s = 1e9", "duration_s: 10000000000 moments at rate_hz"),
    ("radius_mm = 1.0", "", "radius_mm: missing beside obstacles"),
    ('first = ["trunk", 5]', 'first = ["trunk", 11]', "ties[0].first: 'trunk' has no vertex 11; give one from 0 to 10"),
    ('first = ["trunk", 5]', 'first = ["branch", 5]', "ties[0].first: 'branch' is not in the scene"),
    ('second = ["ring", -1]', 'second = ["ring", 0]', "ties: tie 1 ties vertex 0 of rod 1 to itself"),
    ("[0, 2, 0]", "[0, 0, 0]", "rods.trunk.direction: no direction"),
    ("[rods.ring]", "[rods.a]\nmaterial = 'stiff'\nedges = 1000\nlength_mm = 9.0\n[rods.b]\nmaterial = 'stiff'\nedges = 1000\n"
     "length_mm = 9.0\n[rods.ring]", "rods: 2034 edges in all; give at most 2,000"),
    ("normal = [0, 0, 1]", "normal = [0, 0, 1], moments = [{time_s = 1.0}]", "obstacles[0].moments: given for an")])
def test_what_is_wrong_is_named(tmp_path, old, new, said):
    assert old in SCENE
    check_refused(re.escape(said), load, tmp_path, SCENE.replace(old, new))


@pytest.mark.parametrize("path", [pytest.param(path, id=path.stem, marks=pytest.mark.slow if path.stem == "reef_knot" else
                                               pytest.mark.thorough) for path in SCENES])
def test_scenes_that_ship_converge(path):
    scene = load_group_scene(path)
    deepest = -1e-3 * np.min(scene.surroundings.radius)
    for solution in follow_group(scene.group, scene.clamps, **scene.surroundings.arguments):
        assert certified(solution).gap[0] > deepest


DRAGGED = """
radius_mm = 2
rate_hz = 4
duration_s = 1
gap_tolerance = 1e-6
obstacles = [{kind = "plane", point = [0, 0, 0], normal = [0, 0, 1], friction = 0.4}]
materials = {rope = {EI = 1e-4, linear_density = 30}}
[rods.rope]
length_mm = 500
edges = 50
position_mm = [0, 0, 2]
start = "position"
moments = [{time_s = 1, start_position_mm = [-60, 0, 2]}]
"""


def test_forces_are_as_exact_as_gaps(tmp_path):
    """Where a rope is dragged along a table, friction at every vertex is 0.4 of the force, by Coulomb."""
    scene = load(tmp_path, DRAGGED)
    for solution in follow_group(scene.group, scene.clamps, **scene.arguments):
        assert solution.converged.all()
    force = solution.contact_force[0][0, 5:-2]
    np.testing.assert_allclose(np.linalg.norm(force[:, :2], axis=1) / force[:, 2], 0.4, rtol=1e-3)
    check_refused("gap_tolerance", load, tmp_path, DRAGGED.replace("1e-6", "0.5"))
