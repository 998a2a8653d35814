"""Pictures and recordings of what has no extent: a line along a direction of view, a point, a rod without places."""

import io

import numpy as np
import pytest
from PIL import Image

from doo_ti import LandscapePlane, Plane, Surroundings
from doo_ti.report.canvas import Observed, box, deviations, facing, grid_view, limits_around, widest
from doo_ti.report.contact import Touched
from doo_ti.report.figures import Ribbons, SeenRod, reprojections_picture, ribbons_picture
from doo_ti.report.landscapes import LandscapePanel, landscapes_picture
from doo_ti.report.motions import MovingRods, motions_picture, save_animation, save_rollout
from tests.vision.scenes import three_cameras

UP = np.array([0.0, 0.0, 1.0])
S = np.linspace(0.0, 100.0, 7)[:, None]
RODS = {
    "upright": S * [0, 0, 1], "across": S * [1, 0, 0], "into the picture": S * [0, 1, 0], "a point": 0 * S * [1, 1, 1],
    "a far point": 0 * S * [1, 1, 1] + 1e6, "one mark": np.where(S == 100.0, S * [1, 0, 0], np.nan),
    "nowhere": np.full((7, 3), np.nan)}
ARCH = S * [1, 0, 0] + 30 * np.sin(np.pi * S / 100) * UP
pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning", "error::UserWarning")


def alone_and_beside_another(rod: np.ndarray) -> list[np.ndarray]:
    return [rod[None], np.stack([ARCH, rod])]


def moving(positions: np.ndarray) -> MovingRods:
    count, moments = positions.shape[:2]
    return MovingRods(np.arange(1.0 * moments), positions.swapaxes(0, 1), [str(row) for row in range(count)],
                      np.zeros((moments, count), int), np.ones((moments, count), bool))


@pytest.fixture(params=RODS)
def rod(request) -> np.ndarray:
    return RODS[request.param]


def test_a_box_is_finite_and_has_a_side(rod):
    low, high = box(rod)
    assert np.isfinite([low, high]).all() and (high >= low).all() and widest(low, high) > 0
    assert widest(*box(np.empty((0, 2)))) == 1.0
    np.testing.assert_allclose(deviations(rod).sum(axis=0), 0.0, atol=1e-9)
    assert (np.ptp(limits_around(rod[:, :2], 0.55, 0.1), axis=-1) > 0).all()


def test_each_has_a_place_in_the_grid_view(rod):
    for rods in alone_and_beside_another(rod):
        sheet = grid_view(Observed(rods, up=facing(rods, UP)[0]))
        assert np.isfinite(sheet.offset).all() and np.isfinite(sheet.centre).all()
        assert np.isfinite(sheet.extent).all() and (sheet.extent > 0).all()
        np.testing.assert_allclose(sheet.basis @ sheet.basis.T, np.eye(3), atol=1e-9)


def test_upright_rods_stand_side_by_side():
    rods = np.stack([S * [0, 0, 1]] * 5)
    placed = rods + grid_view(Observed(rods)).offset[:, None]
    low, high = placed.min(axis=1), placed.max(axis=1)
    apart = ((low[:, None] > high[None]) | (low[None] > high[:, None]))[..., [0, 2]].any(axis=-1)
    assert (apart | np.eye(5, dtype=bool)).all()


@pytest.mark.thorough
def test_motions_are_drawn(tmp_path, rod):
    for rods in alone_and_beside_another(rod):
        names, positions = [str(row) for row in range(len(rods))], np.repeat(rods[:, None], 3, axis=1)
        around = Surroundings([Plane([0.0, 0.0, -5.0], UP).take(np.zeros(len(rods), int))], radius=1.0)
        touched = Touched(around, positions, np.where(np.isfinite(positions), UP, 0.0))
        save_rollout(tmp_path / "rods.png", "rods", names, positions, positions, 10.0, UP, None, touched)
        save_animation(tmp_path / "rods.gif", "rods", names, positions, positions, 10.0, UP, touched)
        motions_picture(tmp_path / "moments.png", moving(positions), title="rods")
        ribbons = [Ribbons("a", (255, 0, 0), np.stack([rods, rods], axis=1))]
        ribbons_picture(tmp_path / "ribbons.png", ribbons, len(rods) - 1, basis=np.eye(3), title="ribbons")
        for name in ("rods.png", "rods.gif", "moments.png", "ribbons.png"):
            with Image.open(tmp_path / name) as picture:
                assert min(picture.size) > 50 and max(picture.size) < 5000


@pytest.mark.thorough
def test_motions_are_recorded(tmp_path, rod):
    rerun = pytest.importorskip("rerun")
    from doo_ti.record.motions import record_motion, record_ribbons, record_rollout
    from doo_ti.record.sweep import record_sweep
    from tests.record import runs
    from tests.record.runs import read

    rerun.set_strict_mode(True)
    for rods in alone_and_beside_another(rod):
        count, positions = len(rods), np.repeat(rods[:, None], 3, axis=1)
        record_rollout(tmp_path / "rods.rrd", "rods", ["a", "b"][:count], positions, positions, 10.0, UP)
        record_motion(tmp_path / "motion.rrd", run_id="m", name="rods", rods=moving(positions), curves={}, text="")
        run = runs.relaxation(np.random.default_rng(1))
        trajectory = type(run["trajectory"])(positions.swapaxes(0, 1), *np.ones((2, 3, count)), *np.ones((2, count)))
        record_sweep(tmp_path / "sweep.rrd", **run | {"observed": Observed(rods), "trajectory": trajectory})
        record_ribbons(tmp_path / "ribbons.rrd", run_id="r", name="ribbons", basis=np.eye(3), texts=[""] * count,
                       ribbons=[Ribbons("a", (255, 0, 0), np.stack([rods, rods], axis=1))], observation=np.arange(count),
                       rank=np.arange(count))
        for name in ("rods", "motion", "sweep", "ribbons"):
            assert read(tmp_path / f"{name}.rrd")
    rerun.set_strict_mode(False)


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["upright", "across", "a point"])
def test_rods_in_images_without_a_detection_are_drawn(tmp_path, name):
    from doo_ti.record.images import record_perception

    rig = three_cameras()
    images = [np.full((camera.height, camera.width), 180, np.uint8) for camera in rig.cameras]
    seen = SeenRod("none", images, [np.empty((0, 2))] * len(images), RODS[name], None, None, "not found")
    reprojections_picture(tmp_path / "rods.png", rig, [seen], up=UP)
    record_perception(tmp_path / "rods.rrd", run_id="r", name="none", rig=rig, rods=[seen], growth=[[]])
    assert (tmp_path / "rods.rrd").stat().st_size > 0


@pytest.mark.thorough
@pytest.mark.parametrize("values", [np.zeros((3, 2)), np.arange(6.0).reshape(3, 2), np.full((3, 2), np.nan), np.ones((3, 2))])
def test_landscapes_whose_smallest_error_is_zero_share_a_scale(values):
    axes = [("bend", np.geomspace(1e5, 1e7, 3), True, "mm³"), ("twist_ratio", np.geomspace(0.5, 2, 2), True, "")]
    plane = LandscapePlane.of(axes, values, None if np.isnan(values).all() else (0, 0))
    landscapes_picture(io.BytesIO(), [[LandscapePanel("a", plane), LandscapePanel("b", plane)]], title="", relative=True)
