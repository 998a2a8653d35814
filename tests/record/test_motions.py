"""Recordings of rods in one place of space: a predicted motion, a group, and ribbons as bands of a given width."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from doo_ti import Group, GroupSolution, Material, Plane, Status, Surroundings, Tie, end_clamps, straight_rod
from doo_ti.record.motions import record_group, record_motion, record_ribbons
from doo_ti.record.viewer import FAILED
from doo_ti.report.canvas import distinct_colors
from doo_ti.report.contact import GroupMotion
from doo_ti.report.figures import Ribbons, ribbon_sides, ribbons_picture
from doo_ti.report.motions import MovingRods
from tests.record.runs import read


def moving_rods(rng, moments: int = 4, count: int = 9) -> MovingRods:
    vertices = rng.normal(size=(moments, count, 6, 3))
    jumps, sound = np.zeros((moments, count), int), np.ones((moments, count), bool)
    jumps[2, 1], sound[3, 4] = 1, False
    grippers = np.full((moments, count, 4, 2, 3), np.nan)
    grippers[:, :, :2] = rng.normal(size=(moments, count, 2, 2, 3))  # the far end is free
    marks = vertices[0].copy()
    marks[0, 2] = np.nan
    return MovingRods(np.arange(moments, dtype=float), vertices, [f"rod {k}" for k in range(count)], jumps, sound,
                      grippers=grippers, marks=marks)


def test_grippers_and_marks_are_shown(tmp_path, rng):
    rods = moving_rods(rng)
    curves = {"Energy [mm²]": rng.normal(size=(4, 9)), "Force [mm]": rng.normal(size=(4, 9))}
    record_motion(tmp_path / "r.rrd", run_id="r", name="made up", rods=rods, curves=curves, text="words")
    static, moving = read(tmp_path / "r.rrd")
    assert {"/world", "/world/rods", "/world/grippers", "/world/observations/marks", "/summary"} <= set(static)
    assert set(moving) == {"/world/rods", "/world/grippers", "/curves/Energy__mm²_", "/curves/Force__mm_", "/log"}
    drawn = moving["/world/grippers"]["time"]["LineStrips3D:strips"]
    assert len(drawn) == 4 and [len(line) for line in drawn[0]] == [2, 2, 0, 0] * 9
    np.testing.assert_allclose(drawn[3][0], rods.grippers[3, 0, 0], rtol=1e-5)
    assert len(static["/world/observations/marks"]["Points3D:positions"][0]) == 9 * 6 - 1
    colors = np.array(moving["/world/rods"]["time"]["LineStrips3D:colors"]) >> 8
    assert len(set(colors[0].tolist())) == 9 and colors[3, 4] == int.from_bytes(bytes(FAILED))
    assert len(set(static["/curves/Force__mm_"]["SeriesLines:colors"][0])) == 9
    assert moving["/log"]["time"]["TextLog:text"] == [["rod 1 jumps to another branch"]]


@pytest.mark.parametrize("count", [1, 6, 7, 60])
def test_colours_do_not_repeat(count):
    colors = distinct_colors(count).astype(int)
    assert len(np.unique(colors, axis=0)) == count
    assert (np.abs(colors - np.array(FAILED)).max(axis=1) > 60).all() and (colors.max(axis=1) > 100).all()


def test_rods_ties_and_forces_are_shown(tmp_path, rng):
    rods = [straight_rod(60.0, 6), straight_rod(40.0, 4, start=(0.0, 20.0, 0.0), direction=(0.0, 1.0, 0.0))]
    group = Group(rods, Material(1e5, 1e5), [end_clamps(rod) for rod in rods], [Tie((0, 3), (1, 0))])
    none, forces = np.zeros((1, 2, 3)), tuple(rng.normal(size=rod.vertices.shape) for rod in rods)
    good = GroupSolution(group, *np.zeros((4, 1)), np.ones(1, int), np.zeros(1, int), np.ones(1, bool), np.zeros((1, 1, 3)),
                         np.zeros((1, 1, 3)), none, none, forces, tuple(np.zeros((1, len(each[0]))) for each in forces),
                         np.zeros(1), np.zeros(1))
    moments = [good, replace(good, status=np.array([Status.STALLED]))]
    table, names = Surroundings([Plane((0, 0, -5), (0, 0, 1))], 1.5), ["trunk", "a branch"]
    record_group(tmp_path / "bare.rrd", GroupMotion.of(moments, "without thickness", names))
    assert "/world/ties" in read(tmp_path / "bare.rrd")[1]
    record_group(tmp_path / "g.rrd", GroupMotion.of(moments, "made up", names, table, rate=2.0))
    static, moving = read(tmp_path / "g.rrd")
    places = ["/world/rods/0_trunk", "/world/rods/1_a_branch"]
    assert "/world/obstacles/0/0" in static and set(moving) == {*places, "/world/ties", "/world/forces"}
    drawn = [moving[place]["time"] for place in places]
    assert [len(rod["LineStrips3D:strips"][1][0]) for rod in drawn] == [7, 5]
    np.testing.assert_allclose(drawn[1]["LineStrips3D:strips"][0][0], rods[1].vertices[0], rtol=1e-6)
    colors = np.array([rod["LineStrips3D:colors"] for rod in drawn])[:, :, 0] >> 8
    assert len(set(colors[:, 0].tolist())) == 2 and set(colors[:, 1].tolist()) == {int.from_bytes(bytes(FAILED))}
    np.testing.assert_allclose(moving["/world/ties"]["time"]["Points3D:positions"][0], [[30.0, 0.0, 0.0]], atol=1e-5)
    assert len(moving["/world/forces"]["time"]["Arrows3D:vectors"][0]) == 12


def helices(count: int, marks: int = 20) -> tuple[np.ndarray, np.ndarray]:
    """(D, V, 3) and m1 (D, E, 3), across each edge and level."""
    along, radius = np.linspace(0, 3, marks), np.linspace(5, 12, count)[:, None]
    vertices = np.stack([20 * along + 0 * radius, radius * np.cos(along), radius * np.sin(along)], axis=-1)
    across = np.cross(np.diff(vertices, axis=1), [0.0, 0.0, 1.0])
    return vertices, across / np.linalg.norm(across, axis=-1, keepdims=True)


def kinds(count: int) -> list[Ribbons]:
    vertices, across = helices(count)
    return [Ribbons("observed", (120, 120, 120), ribbon_sides(vertices, across, 6.7), filled=False),
            Ribbons("1: red", (214, 57, 57), ribbon_sides(vertices + [0, 0, 9.0], across, 6.7)),
            Ribbons("3: blue", (48, 105, 205), ribbon_sides(vertices - [0, 0, 9.0], across, 6.7))]


def test_bands_have_the_given_width_and_lie_along_m1():
    vertices, across = helices(3)
    sides = ribbon_sides(vertices, across, 6.7)
    assert sides.shape == (3, 2, 20, 3)
    np.testing.assert_allclose(sides.mean(axis=1), vertices, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(sides[:, 1] - sides[:, 0], axis=-1), 6.7)
    np.testing.assert_allclose((sides[:, 1, 0] - sides[:, 0, 0]) / 6.7, across[:, 0], atol=1e-12)


@pytest.mark.thorough
def test_picture_shows_each_kind_in_its_colour(tmp_path):
    ribbons_picture(tmp_path / "ribbons.png", kinds(2), 1, basis=np.eye(3), title="made up")
    picture = np.asarray(Image.open(tmp_path / "ribbons.png").convert("RGB")).astype(int)
    red = (picture[..., 0] > 1.8 * picture[..., 1]) & (picture[..., 0] > 90)
    blue, half = (picture[..., 2] > 1.8 * picture[..., 0]) & (picture[..., 2] > 90), picture.shape[1] // 2
    for color, inside, outside in ((red, slice(None, half), slice(half, None)), (blue, slice(half, None), slice(None, half))):
        assert color[:, inside].sum() > 5000 > 50 > color[:, outside].sum()


def test_recording_holds_a_band_per_kind_and_step(tmp_path):
    shown = kinds(4)
    lost = shown[1].sides.copy()
    lost[2, :, 5] = np.nan
    shown[1] = Ribbons("1: red", (214, 57, 57), lost)
    record_ribbons(tmp_path / "r.rrd", run_id="r", name="made up", ribbons=shown, observation=np.array([3, 5, 6, 9]),
                   rank=np.array([2, 0, 1, 3]), texts=[f"text {k}" for k in range(4)], basis=np.eye(3))
    assert [entry.name for entry in tmp_path.iterdir()] == ["r.rrd"]
    static, moving = read(tmp_path / "r.rrd")
    assert set(moving) == {"/world/ribbons/0/borders", "/world/ribbons/1", "/world/ribbons/1/borders", "/world/ribbons/2",
                           "/world/ribbons/2/borders", "/summary"}
    band = moving["/world/ribbons/2"]
    assert set(band) == {"observation", "difference"}
    assert band["observation"]["observation"] == [3, 5, 6, 9] and band["difference"]["difference"] == [0, 1, 2, 3]
    assert band["difference"]["observation"] == [5, 6, 3, 9]
    points = np.array(band["observation"]["Mesh3D:vertex_positions"]).reshape(4, 2, 20, 3)
    np.testing.assert_allclose(points, shown[2].sides, atol=1e-4)
    triangles = np.array(static["/world/ribbons/2"]["Mesh3D:triangle_indices"][0])
    assert triangles.shape == (2 * 19, 3) and triangles.max() == 39
    corners = points.reshape(4, 40, 3)[:, triangles]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, :, 1] - corners[:, :, 0], corners[:, :, 2] - corners[:, :, 0]), axis=-1)
    length = np.linalg.norm(np.diff(shown[2].sides.mean(axis=1), axis=1), axis=-1).sum(axis=1)
    np.testing.assert_allclose(area.sum(axis=1), 6.7 * length, rtol=0.1)
    np.testing.assert_allclose(np.linalg.norm(np.array(band["observation"]["Mesh3D:vertex_normals"]), axis=-1), 1, atol=1e-5)
    red = moving["/world/ribbons/1"]["observation"]["Mesh3D:vertex_positions"]
    assert np.isfinite(red).all() and (np.array(red)[2] == 0).all()
    assert [len(strip) for strip in moving["/world/ribbons/1/borders"]["observation"]["LineStrips3D:strips"][2]] == [0, 0]
    assert moving["/summary"]["observation"]["TextDocument:text"][1] == ["text 1"]
