"""Obstacles in TOML files, and the gaps and meshes of what they state; and obstacles given by their distances on a grid."""

import re
import sys
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import special_ortho_group

from doo_ti import Clamps, Configuration, InputError, Material, Surroundings, load_obstacles, relax, straight_rod
from doo_ti.contact.distance_grid import DistanceGrid, mesh
from doo_ti.contact.obstacles import Box, Capsule, Cylinder, Plane, Ring, Sphere
from doo_ti.dynamics.scene import load_motion_scene
from tests.conftest import check_refused
from tests.contact.clutter import differences
from tests.references.rods import certified, clamps_at

ALL = """
obstacles = [
    {kind = "plane", point = [0, 0, 0], normal = [0, 0, 2], friction = 0.3},
    {kind = "sphere", centre = [1, 2, 30], radius = 5},
    {kind = "capsule", start = [0, 0, 0], end = [10, 0, 40], radius = 2.0},
    {kind = "cylinder", start = [0, 0, 0], end = [0, 10, 0], radius = 2.0},
    {kind = "ring", centre = [0, 0, 5], axis = [0, 1, 1], radius = 4.0, thickness = 1.0},
    {kind = "box", centre = [0, 0, 0], size = [2, 4, 6], rotation = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]},
]
"""
BAD = {
    "an unknown kind": ('kind = "plane"', 'kind = "cone"', "obstacles[0].kind", "plane, sphere"),
    "no kind": ('kind = "plane", ', "", "obstacles[0].kind", "missing"),
    "an unknown key": ("friction = 0.3", "grip = 0.3", "obstacles[0].grip", "the keys are kind, point, normal"),
    "a missing key": (", radius = 5", "", "obstacles[1].radius", "missing"),
    "a negative radius": ("radius = 5", "radius = -5", "obstacles[1].radius", "number > 0"),
    "a negative friction": ("friction = 0.3", "friction = -1", "obstacles[0].friction", "number >= 0"),
    "a plane without direction": ("[0, 0, 2]", "[0, 0, 0]", "obstacles[0].normal", "not all zero"),
    "a closed ring": ("thickness = 1.0", "thickness = 4.0", "obstacles[4].thickness", "less than the radius"),
    "no rotation": ("[[0, -1, 0]", "[[0, -2, 0]", "obstacles[5].rotation", "rotation matrix"),
    "not a matrix": ("[[0, -1, 0], [1, 0, 0], [0, 0, 1]]", "[0, 1, 0]", "obstacles[5].rotation", "three rows"),
    "nothing": (ALL, "", "obstacles", "missing"), "no table": (ALL, "obstacles = [3]", "obstacles[0].kind", "missing")}


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
    check_refused("^" + re.escape(f"{path}: {key}: ") + ".*" + re.escape(remedy), load_obstacles, path)


@pytest.mark.parametrize("kind", ["rate_hz = 10\nduration_s = 1\n", "moments = [{}, {time_s = 1.0}]\n"],
                         ids=["with a rate", "without"])
def test_scenes_have_obstacles_and_the_radius_of_the_rod(tmp_path, kind):
    path, scene = tmp_path / "scene.toml", kind + ALL + "[rod]\nlength_mm = 100\nedges = 5\n[materials.a]\nbend = 1e5\n"
    path.write_text(scene)
    check_refused(r"rod\.radius_mm: missing beside obstacles", load_motion_scene, path)
    path.write_text(scene.replace("edges = 5", "edges = 5\nradius_mm = 30"))  # more than an edge is allowed
    found = load_motion_scene(path).surroundings()
    assert found.radius == 30 and len(found.obstacles) == 6
    path.write_text(scene.replace("edges = 5", "edges = 5\nradius_mm = 0"))
    check_refused(r"rod\.radius_mm: 0 is not allowed; give a number > 0", load_motion_scene, path)


def test_gaps_are_those_of_edges_too_and_the_axis_of_a_ring_is_far_from_it():
    rods = np.array([[[-30.0, 0, 12], [30, 0, 12]], [[-30, 0, 40], [30, 0, 5]], [[np.nan] * 3] * 2])
    around = Surroundings([Sphere((0, 0, 0), 10.0), Plane((0, 0, -1), (0, 0, 1))], 2.0)
    gap = around.smallest_gap(rods)
    assert gap[:2] == pytest.approx([0.0, 4.0], abs=1e-9) and np.isnan(gap[2])  # ends are further than 20 from the sphere
    assert (around.take(np.array([1])).smallest_gap(rods[1:2]) == gap[1]).all()
    each = Surroundings([Sphere([[0, 0, 0], [0, 0, 100]], [10.0, 1.0])], np.array([2.0, 3.0]))
    assert each.take(np.array([1])).smallest_gap(rods[1:2]) == pytest.approx(each.smallest_gap(rods[:2])[1])
    value, normal = Ring((0, 0, 0), (0, 0, 1), 6.0, 1.5).distance(np.zeros((1, 1, 3)))
    assert value == pytest.approx(4.5) and np.linalg.norm(normal) == pytest.approx(1.0)


def test_meshes_lie_on_the_surfaces(tmp_path):
    (tmp_path / "all.toml").write_text(ALL)
    for obstacle in load_obstacles(tmp_path / "all.toml"):
        vertices, triangles = mesh(obstacle, 0, np.array([5.0, 5.0, 50.0]), 100.0)
        value = obstacle.distance(vertices[None])[0]
        assert np.abs(value).max() < 1e-9 and triangles.min() == 0 and triangles.max() == len(vertices) - 1


RADIUS, BALL = 1.0, 15.0


def sampled(obstacle, spacing: float, low, high, **pose) -> DistanceGrid:
    """An obstacle on a grid."""
    counts = np.round((np.array(high) - low) / spacing).astype(int) + 1
    points = np.array(low) + spacing * np.indices(counts).reshape(3, -1).T
    return DistanceGrid(obstacle.distance(points[None])[0].reshape(counts), spacing, low, **pose)


def ball(spacing: float, **pose) -> DistanceGrid:
    return sampled(Sphere((0, 0, 0), BALL), spacing, [-24.0] * 3, [24.0] * 3, **pose)


def test_the_normal_is_the_gradient_of_the_distance_inside_the_grid_and_outside(rng):
    grid = ball(2.0, rotation=special_ortho_group.rvs(3, random_state=rng), position=(1, 2, 3))
    points = rng.normal(scale=20.0, size=(1, 2000, 3)) + [1, 2, 3]
    value, normal = grid.distance(points)
    # A difference may straddle the border.
    assert np.quantile(np.abs(differences(grid, points) - normal).max(axis=-1), 0.998) < 1e-7
    exact = np.linalg.norm(points - [1, 2, 3], axis=-1) - BALL
    outside = np.abs((points - [1, 2, 3]) @ grid.rotation[0]).max(axis=-1) > 24
    assert outside.mean() > 0.2 and (value[outside] < exact[outside] + 1e-3).all(), "never more than the distance"
    assert (value[outside] > 0.7 * exact[outside]).all()
    assert np.isnan(grid.distance(np.full((1, 1, 3), np.nan))[0]).all()


def over_a_ball(count: int) -> tuple[Configuration, Clamps]:
    """Rods of 120 mm across a ball, bent upwards between their clamps."""
    rods = straight_rod(120.0, 30, (-58.0, 0.0, 13.0)).take([0] * count)
    ends = [60.5, -3.0, 11.0] + np.linspace(0.0, 1.0, count)[:, None] * [-1.0, 6.0, 4.0]
    clamps = replace(clamps_at(rods), end_position=ends)
    return relax(rods, Material(1e5, 1e5), clamps, up=(0, 0, -1)).configuration, clamps


@pytest.mark.slow
def test_rods_on_a_ball_given_by_a_grid_are_as_on_the_ball(rng):
    rods, clamps = over_a_ball(16)
    fine, coarse = (ball(spacing, rotation=special_ortho_group.rvs(3, random_state=rng)) for spacing in (1.0, 4.0))
    exact, found, rough = (relax(rods, Material(1e5, 1e5), clamps, obstacles=[obstacle], radius=RADIUS)
                           for obstacle in (Sphere((0, 0, 0), BALL), fine, coarse))
    assert certified(found).contact.touching.any(axis=1).all()
    off, more = (np.abs(one.configuration.vertices - exact.configuration.vertices).max() for one in (found, rough))
    assert off < 3e-5
    assert more > 30 * off, "more than second order in the spacing"
    assert np.allclose(found.contact_force.sum(axis=1), exact.contact_force.sum(axis=1), rtol=1e-2, atol=1.0)
    assert found.contact.gap.min() > -1e-3 * RADIUS


def test_the_drawn_surface_is_that_of_the_obstacle():
    vertices, triangles = mesh(ball(2.0, position=(5, 0, 0)), 0, np.zeros(3), 100.0)
    assert np.abs(np.linalg.norm(vertices - [5, 0, 0], axis=1) - BALL).max() < 0.3
    assert triangles.min() == 0 and triangles.max() == len(vertices) - 1
    corners = vertices[triangles]
    outward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (np.einsum("na,na->n", outward, corners.mean(axis=1) - [5, 0, 0]) > 0).all()
    assert len(vertices) - 3 * len(triangles) / 2 + len(triangles) == 2, "closed"


TABLE = '[[obstacles]]\nkind = "grid"\nfile = "ball.npz"\nposition = [0, 0, 10]\nfriction = 0.2\n'


@pytest.fixture
def folder(tmp_path):
    grid = ball(4.0)
    values = grid.values
    for name, stored, spacing in (("ball", values, 4.0), ("flat", values[0], 4.0), ("half", values[6:], 4.0),
                                  ("hole", np.where(values < 0, np.nan, values), 4.0), ("dense", values, 0.0)):
        np.savez(tmp_path / f"{name}.npz", values=stored, spacing=spacing, origin=grid.origin[0])
    np.savez(tmp_path / "bare.npz", values=values)
    (tmp_path / "table.toml").write_text(TABLE)
    return tmp_path


def test_a_grid_is_read_from_a_file_beside_the_scene(folder):
    (grid,) = load_obstacles(folder / "table.toml")
    assert grid.friction == 0.2 and grid.values.shape == (13, 13, 13) and "values (13, 13, 13)" in repr(grid)
    assert grid.distance(np.array([[[0.0, 0, 30]]]))[0] == pytest.approx(5.0, abs=0.02)
    assert grid != ball(4.0) and grid.take([0]).coefficients is grid.coefficients


WRONG = {
    "a file that is not there": ("ball.npz", "none.npz", "none.npz: file: no such file"),
    "values of two axes": ("ball.npz", "flat.npz", "flat.npz: values: shape (13, 13); give (X, Y, Z)"),
    "NaN": ("ball.npz", "hole.npz", "hole.npz: values: not finite"),
    "an obstacle that is cut": ("ball.npz", "half.npz", "half.npz: values: -15 mm at the border"),
    "no spacing": ("ball.npz", "dense.npz", "dense.npz: spacing: 0; give a positive length"),
    "arrays that are missing": ("ball.npz", "bare.npz", "bare.npz: spacing: missing; store values, spacing, origin"),
    "file and mesh": ("file", 'mesh = "ball.stl"\nfile', "obstacles[0].file: given beside mesh; give file or mesh"),
    "neither": ('file = "ball.npz"', "", "obstacles[0].file: missing; give file or mesh"),
    "a mesh without spacing": ("file", "mesh", "obstacles[0].spacing: missing beside mesh"),
    "a file with spacing": ("file", "spacing = 1\nfile", "obstacles[0].spacing: given beside file; leave it out"),
    "a negative spacing": ("file", "spacing = -1\nmesh", "obstacles[0].spacing: -1 is not allowed; give a number > 0"),
    "no rotation": ("friction", "rotation = [[1, 0, 0], [0, 2, 0], [0, 0, 1]]\nfriction", "obstacles[0].rotation: off a")}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_files_are_named_in_one_line(folder, case):
    old, new, message = WRONG[case]
    (folder / "table.toml").write_text(TABLE.replace(old, new, 1))
    check_refused(re.escape(message), load_obstacles, folder / "table.toml")


def test_a_grid_that_ends_near_its_obstacle_is_refused():
    rods, clamps = over_a_ball(1)
    check_refused("a grid ends 9 mm from its obstacle, less than a rod's diameter of 10 mm", relax, rods, Material(1e5, 1e5),
                  clamps, obstacles=[ball(4.0)], radius=5.0)


def test_without_trimesh_a_mesh_is_refused_in_one_line(monkeypatch):
    monkeypatch.setitem(sys.modules, "trimesh", None)
    check_refused(re.escape("mesh: trimesh is not installed; pip install 'doo_ti[mesh]'"),
                  DistanceGrid.from_mesh, "part.stl", 1.0)


def test_distances_from_a_tube_of_long_triangles():
    """Its wall is thinner than the spacing in places: 192 sides, whose middles are 0.003 mm inside of the circles."""
    trimesh = pytest.importorskip("trimesh")
    tube = trimesh.creation.annulus(18.0, 20.0, 90.0, sections=192)
    grid = DistanceGrid.from_mesh((tube.vertices, tube.faces), 3.0)
    place = grid.origin[0] + 3.0 * np.moveaxis(np.indices(grid.values.shape), 0, -1)
    across = np.stack([np.abs(np.hypot(place[..., 0], place[..., 1]) - 19.0) - 1.0, np.abs(place[..., 2]) - 45.0])
    expected = np.linalg.norm(np.maximum(across, 0.0), axis=0) + np.minimum(across.max(axis=0), 0.0)
    assert np.abs(grid.values - expected).max() < 0.004 and (grid.values < 0).any()


def test_a_grid_of_a_mesh(folder):
    trimesh = pytest.importorskip("trimesh")
    surface = trimesh.creation.icosphere(subdivisions=3, radius=BALL)
    surface.export(folder / "ball.stl")
    (folder / "table.toml").write_text(TABLE.replace('file = "ball.npz"', 'mesh = "ball.stl"\nspacing = 4\nmargin = 9'))
    (grid,) = load_obstacles(folder / "table.toml")
    points = np.random.default_rng(3).normal(scale=9.0, size=(1, 200, 3))
    assert np.abs(grid.values - DistanceGrid.from_mesh((surface.vertices, surface.faces), 4.0, 9.0).values).max() < 1e-5
    near = np.abs(np.linalg.norm(points, axis=-1) - BALL) < 3
    off = grid.distance(points + [0, 0, 10])[0] - np.linalg.norm(points, axis=-1) + BALL
    assert np.abs(off[near]).max() < 0.1, "the mesh is that far inside the ball"
    whole = (folder / "ball.stl").read_bytes()
    for name, content, message in (
            ("broken.stl", b"solid nothing\n", "broken.stl: "), ("ball.zip", b"PK", "suffix '.zip' is not"),
            ("half.stl", whole[: len(whole) // 2], "half.stl: file: 32,042 bytes where its header says"),
            ("text.obj", b"v 0 0 \xff\xfe\x81", "text.obj: file: no mesh ("),
            ("none.stl", None, "none.stl: file: no such file")):
        if content:
            (folder / name).write_bytes(content)
        with pytest.raises(InputError, match=re.escape(message)) as caught:
            DistanceGrid.from_mesh(folder / name, 1.0)
        assert "charset" not in str(caught.value)
    check_refused("mesh: not a closed surface", DistanceGrid.from_mesh, (surface.vertices, surface.faces[1:]), 4.0)
    for arguments, message in (((0.0,), "spacing: 0; give"), ((1e-3,), "spacing: 0.001 mm makes"), ((4.0, -1.0), "margin: -1")):
        check_refused(re.escape(message), DistanceGrid.from_mesh, (surface.vertices, surface.faces), *arguments)
