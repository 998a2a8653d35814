"""Rods in images: the picture and the recording contain the detection, the hypotheses, the pruned ones and the result."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from doo_ti.perception.growth import GrowthStep, GrowthSteps
from doo_ti.perception.search import Hypotheses
from doo_ti.record.images import record_perception
from doo_ti.report.figures import SeenRod, reprojections_picture
from doo_ti.vision.tubes import smooth_curve
from tests.record.runs import read
from tests.vision.scenes import curves, three_cameras

EDGES = 5


@pytest.fixture
def seen(rng) -> SeenRod:
    rod = curves(rng, 1, EDGES)[0]
    fine = smooth_curve(rod, 4)
    rig = three_cameras()
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
    taken = GrowthSteps(2)
    quaternions = rng.normal(size=(6, 2, 4))
    quaternions /= np.linalg.norm(quaternions, axis=-1, keepdims=True)
    every = Hypotheses(np.array([0, 0, 1, 1, 2, 2]), quaternions, np.arange(6.0))
    taken.add(0, every.take(np.array([0, 2, 4])), every.take(np.array([1, 3, 5])))
    taken.add(5, every, every)  # a later group, none of whose sets is shown
    assert sorted(taken.steps) == [0, 1]
    step, = taken.of(1, np.array([1.0, 2.0, 3.0]), np.array([3.0, 4.0, 5.0]))
    assert step.vertices.shape == (2, 3, 3) and step.energy_vis.tolist() == [2, 3] and step.kept.tolist() == [True, False]
    np.testing.assert_allclose(np.linalg.norm(np.diff(step.vertices, axis=1), axis=-1), [[3, 4], [3, 4]])
    assert taken.of(7, np.zeros(3), np.ones(3)) == []
