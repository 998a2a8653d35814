"""Recordings of rods in images and of figures, read back: what each step shows; and of rods in one place of space: a predicted
motion, a group, and ribbons as bands of a given width."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from doo_ti import Group, GroupSolution, Material, Observed, Plane, Status, Surroundings, Tie, end_clamps, straight_rod
from doo_ti.perception.growth import GrowthStep, GrowthSteps
from doo_ti.perception.search import Hypotheses
from doo_ti.record.images import record_perception
from doo_ti.record.motions import record_group, record_motion, record_ribbons
from doo_ti.record.sweep import CellsOfRun, Rods, record_cells
from doo_ti.record.viewer import FAILED
from doo_ti.report.canvas import distance_colors, distinct_colors
from doo_ti.report.contact import GroupMotion
from doo_ti.report.figures import Ribbons, SeenRod, reprojections_picture, ribbon_sides, ribbons_picture
from doo_ti.report.motions import MovingRods
from doo_ti.vision.tubes import smooth_curve
from tests.conftest import SEED
from tests.record import runs
from tests.record.runs import read
from tests.vision.scenes import curves, three_cameras

EDGES = 5


@pytest.fixture
def seen(rng) -> SeenRod:
    rod = curves(rng, 1, EDGES)[0]
    fine, rig = smooth_curve(rod, 4), three_cameras()
    images = [np.full((480, 640), 180, dtype=np.uint8) for _ in rig.cameras]
    return SeenRod("silk 42 mm", images, list(rig.project(fine)), fine, rod + [0, 0, 3.0], rod,
                   "likely, next best 0.05 px worse")


def steps(rod: np.ndarray) -> list[GrowthStep]:
    """Three hypotheses of two edges, then five of three, of which two stay each time."""
    return [GrowthStep(np.stack([rod[: edges + 1] + [0, k, 0] for k in range(count)]), np.arange(count) + 1.0,
                       np.arange(count) < 2) for edges, count in ((2, 3), (3, 5))]


def test_recording_shows_growth_and_pruning(tmp_path, seen):
    rig, growth = three_cameras(), steps(seen.truth)
    record_perception(tmp_path / "r.rrd", run_id="r", name="made up", rig=rig, rods=[seen], growth=[growth])
    assert [entry.name for entry in tmp_path.iterdir()] == ["r.rrd"]
    static, moving = read(tmp_path / "r.rrd")
    root = "set0_silk_42_mm"
    world = {name: moving[f"/world/{root}/{name}"]["edges"] for name in ("rods", "kept", "pruned", "runner_up")}
    count = {name: [len(strips or ()) for strips in timeline["LineStrips3D:strips"]] for name, timeline in world.items()}
    assert world["rods"]["edges"] == [2, 3, 4]
    assert count == {"rods": [1, 1, 1], "kept": [1, 1, 0], "pruned": [1, 3, 0], "runner_up": [1]}
    np.testing.assert_allclose(world["pruned"]["LineStrips3D:strips"][1], growth[1].vertices[2:], atol=1e-4)
    energy = moving[f"/curves/{root}/energy_vis"]["edges"]
    assert energy["per_mm"][1] == [1, 2, 3, 4, 5] and energy["kept"][1] == [True, True, False, False, False]
    np.testing.assert_allclose(world["rods"]["LineStrips3D:strips"][2][0], seen.best, atol=1e-4)
    for camera in rig.cameras:
        flat = f"/images/{root}/{camera.name}"
        assert static[flat]["EncodedImage:media_type"] == [["image/jpeg"]]
        found = np.array(static[f"{flat}/detected"]["Points2D:positions"][0])
        # The viewer's pixels have their corners at whole numbers, ours their centres.
        np.testing.assert_allclose(found, camera.project(seen.best) + 0.5, atol=1e-3)
        shown = moving[f"{flat}/rods"]["edges"]["LineStrips2D:strips"]
        np.testing.assert_allclose(shown[2][0], camera.project(seen.best) + 0.5, atol=1e-3)
        pinhole = static[f"/world/{root}/cameras/{camera.name}"]
        np.testing.assert_allclose(np.array(pinhole["Pinhole:image_from_camera"][0]).reshape(3, 3).T, camera.matrix, rtol=1e-6)
        np.testing.assert_allclose(pinhole["Transform3D:translation"][0][0], camera.centre, rtol=1e-5)
    assert "0.05 px" in static[f"/summary/{root}"]["TextDocument:text"][0][0]


@pytest.mark.thorough
def test_picture_has_a_row_for_each_set(tmp_path, seen):
    for name, rods in (("both", [seen, seen]), ("alone", [replace(seen, runner_up=None, truth=None)])):
        reprojections_picture(tmp_path / f"{name}.png", three_cameras(), rods, up=(0, 0, 1), left_out=2)
    both, one = (np.asarray(Image.open(tmp_path / f"{name}.png").convert("RGB")).astype(int) for name in ("both", "alone"))
    assert both.shape[1] == one.shape[1] and both.shape[0] > 1.6 * one.shape[0]

    def colored(picture, color):
        return (np.abs(picture - color).max(axis=-1) < 40).sum()
    for color in ((255, 46, 77), (255, 212, 0)):
        assert colored(both, color) > 500 > 20 > colored(one, color)
    assert colored(one, (47, 123, 255)) > 200


def test_steps_are_taken_down_for_the_first_sets(rng):
    taken, quaternions = GrowthSteps(2), rng.normal(size=(6, 2, 4))
    quaternions /= np.linalg.norm(quaternions, axis=-1, keepdims=True)
    every = Hypotheses(np.array([0, 0, 1, 1, 2, 2]), quaternions, np.arange(6.0))
    taken.add(0, every.take(np.array([0, 2, 4])), every.take(np.array([1, 3, 5])))
    taken.add(5, every, every)  # a later group, none of whose sets is shown
    assert sorted(taken.steps) == [0, 1]
    step, = taken.of(1, np.array([1.0, 2.0, 3.0]), np.array([3.0, 4.0, 5.0]))
    assert step.vertices.shape == (2, 3, 3) and step.energy_vis.tolist() == [2, 3] and step.kept.tolist() == [True, False]
    np.testing.assert_allclose(np.linalg.norm(np.diff(step.vertices, axis=1), axis=-1), [[3, 4], [3, 4]])
    assert taken.of(7, np.zeros(3), np.ones(3)) == []


CELLS, PANELS = 7, 2
LABELS = {"end_distance_mm": np.repeat([30.0, 50.0, 70.0], 2), "end_rotation_deg": np.tile([0.0, 120.0], 3)}
PAIRED = np.array([1, 0, 3, 2, 5, 4, 1])


def figure(rng, names=("silk", "a ribbon, dynamic")) -> dict:
    """What `record_cells` takes: of two runs, the second one with pairs, two of them ending on one observation."""
    observed, several, pieces = runs.observations(rng), [], []
    for number, name in enumerate(names):
        which = np.arange(runs.OBSERVATIONS) if number == 0 else PAIRED
        distance = rng.uniform(0.3, 30, (CELLS, len(which)))
        several.append(CellsOfRun(
            name=name, observed=Observed(observed, LABELS), observation=which, distance=distance,
            picture=rng.integers(0, 255, (90, 120, 3), dtype=np.uint8), boxes=rng.uniform(5, 50, (CELLS, PANELS, 4))))
        sound = rng.random(distance.shape) > 0.2
        rods = observed[which] + rng.normal(0, 3, (CELLS, len(which), runs.VERTICES, 3))
        pieces += [Rods(number, 0, rods[:4], distance[:4], sound[:4]), Rods(number, 4, rods[4:], distance[4:], sound[4:])]
    return {"run_id": "figure-1", "name": "made up", "runs": several, "cells": np.array([0, 3, 4, 8, 11, 15, 19]),
            "rank": rng.permutation(CELLS), "texts": [f"**Cell {k}**" for k in range(CELLS)], "rods": pieces}


def joined(given: dict, run: int, name: str) -> np.ndarray:
    return np.concatenate([getattr(piece, name) for piece in given["rods"] if piece.run == run])


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    path, given = tmp_path_factory.mktemp("cells") / "cells.rrd", figure(np.random.default_rng(SEED))
    record_cells(path, **given)
    assert [entry.name for entry in path.parent.iterdir()] == ["cells.rrd"]
    return given, *read(path)


def test_each_cell_is_a_step_with_its_rods_its_box_and_its_text(recorded):
    given, static, moving = recorded
    assert set(moving) == {"/world/silk/rods", "/landscape/silk/cell", "/world/a_ribbon__dynamic/rods",
                           "/landscape/a_ribbon__dynamic/cell", "/summary"}
    for run, place in enumerate(("silk", "a_ribbon__dynamic")):
        rods, still = moving[f"/world/{place}/rods"], static[f"/world/{place}/rods"]
        assert rods["cell"]["cell"] == given["cells"].tolist()
        assert rods["falling_error"]["cell"] == given["cells"][np.argsort(given["rank"])].tolist()
        offset = np.array(still["offset_mm"][0])
        assert len(still["LineStrips3D:labels"][0]) == len(given["runs"][run].observation)
        strips = np.array(rods["cell"]["LineStrips3D:strips"])
        np.testing.assert_allclose(strips - offset[:, None], joined(given, run, "vertices"), atol=1e-4)
        np.testing.assert_allclose(rods["cell"]["distance_mm"], joined(given, run, "distance"), rtol=1e-6)
        np.testing.assert_allclose(offset, np.array(static[f"/world/{place}/observations"]["offset_mm"][0])[
            given["runs"][run].observation])
        boxes = moving[f"/landscape/{place}/cell"]["cell"]
        centers, half = (np.array(boxes[f"Boxes2D:{name}"]) for name in ("centers", "half_sizes"))
        assert centers.shape == (CELLS, PANELS, 2)
        corner, size = given["runs"][run].boxes[..., :2], given["runs"][run].boxes[..., 2:]
        np.testing.assert_allclose(centers, corner + size / 2, rtol=1e-5)
        np.testing.assert_allclose(half, 0.625 * size, rtol=1e-5)
    assert moving["/summary"]["cell"]["TextDocument:text"] == [[text] for text in given["texts"]]
    assert static["/world/a_ribbon__dynamic/rods"]["LineStrips3D:labels"][0][-1] == "observation 1: 30 mm 120°"


def test_rods_are_coloured_on_one_scale_and_uncertified_ones_red(recorded):
    given, _, moving = recorded
    colors = np.array(moving["/world/silk/rods"]["cell"]["LineStrips3D:colors"])
    np.testing.assert_array_equal(colors >> 8 == int.from_bytes(bytes(FAILED)), ~joined(given, 0, "sound"))
    expected = distance_colors(joined(given, 0, "distance"), given["runs"][0].distance).astype(np.int64)
    packed = (expected[..., 0] << 16) + (expected[..., 1] << 8) + expected[..., 2]
    np.testing.assert_array_equal((colors >> 8)[joined(given, 0, "sound")], packed[joined(given, 0, "sound")])


def test_a_rod_that_is_nan_is_not_drawn(tmp_path, rng):
    given = figure(rng, names=("silk",))
    given["rods"][0].vertices[2, 4, 3] = np.nan
    given["rods"][0].distance[2, 4] = np.nan
    record_cells(tmp_path / "cells.rrd", **given)
    _, moving = read(tmp_path / "cells.rrd")
    counts = [[len(strip) for strip in row] for row in moving["/world/silk/rods"]["cell"]["LineStrips3D:strips"]]
    expected = np.full((CELLS, runs.OBSERVATIONS), runs.VERTICES)
    expected[2, 4] = 0
    np.testing.assert_array_equal(counts, expected)


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
