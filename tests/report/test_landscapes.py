"""Landscapes: several in one picture, ribbons and their regimes, and more cells than a picture has room for.
Pictures and recordings of what has no extent: a line along a direction of view, a point, a rod without places."""

import io
import re

import numpy as np
import pytest
from PIL import Image

from doo_ti import Plane, Surroundings
from doo_ti.report import landscapes
from doo_ti.report.canvas import Observed, box, deviations, facing, grid_view, landscape_colors, limits_around, pixels, widest
from doo_ti.report.contact import Touched
from doo_ti.report.figures import Ribbons, SeenRod, reprojections_picture, ribbons_picture
from doo_ti.report.landscapes import LandscapePanel, draw_panels, landscapes_picture
from doo_ti.report.motions import MovingRods, motions_picture, save_animation, save_rollout
from doo_ti.report.plane import MOST_DRAWN, LandscapePlane, cell_edges, regime
from tests.record import runs
from tests.record.runs import read
from tests.vision.scenes import three_cameras


def plane(rng) -> LandscapePlane:
    grid = runs.grid()
    values = rng.uniform(1, 9, grid.shape)
    return LandscapePlane.of(grid.picture_axes, values, np.unravel_index(np.argmin(values), grid.shape))


def ribbon(count: int = 6, twist=(5e5,)) -> tuple[list, np.ndarray]:
    bends = np.geomspace(5e4, 1e7, count)
    axes = [("bend_1", bends, True, "mm³"), ("bend_2", bends, True, "mm³"), ("twist", np.array(twist), True, "mm³"),
            ("weight", np.ones(1), True, "")]
    return axes, np.arange(1.0, count * count * len(twist) + 1).reshape(count, count, len(twist), 1)


@pytest.mark.thorough
@pytest.mark.parametrize("relative", [False, True])
def test_boxes_lie_on_the_cells_they_are_of(relative, rng):
    panels = [LandscapePanel("one", plane(rng)), LandscapePanel("two", plane(rng), (("", (0, 0)), ("x", (4, 3)))),
              LandscapePanel("three", plane(rng))]
    index = np.unravel_index(np.arange(runs.BENDS * runs.RATIOS), runs.grid().shape)
    image, boxes = landscapes.cells_image([panels[:2], panels[2:]], index, relative=relative)
    assert boxes.shape == (runs.BENDS * runs.RATIOS, 3, 4)
    for panel, places in zip(panels, boxes.swapaxes(0, 1), strict=True):
        values = panel.plane.values / (np.nanmin(panel.plane.values) if relative else 1.0)
        corner = np.floor(places[:, :2] + 0.25 * places[:, 2:]).astype(int)  # aside of stars, marks and their lines
        seen = image[corner[:, 1], corner[:, 0]].astype(int).reshape(runs.BENDS, runs.RATIOS, 3)
        if relative:  # one scale: the larger of two cells is not darker in any panel
            brightness = seen.sum(axis=-1)
            assert brightness.flat[np.argmax(values)] > brightness.flat[np.argmin(values)]
        else:
            right = np.abs(seen - landscape_colors(values, values).astype(int)).max(axis=-1) <= 2
            assert right.mean() > 0.8
        assert (places[:, 2:] > 3).all()


def test_a_line_s_boxes_are_as_high_as_its_axes(rng):
    axes = [("bend", np.geomspace(1e5, 1e7, 5), True, "mm³"), ("weight", np.ones(1), True, "")]
    line = LandscapePlane.of(axes, rng.uniform(1, 2, (5, 1)), (0, 0))
    _, boxes = landscapes.cells_image([[LandscapePanel("line", line)]], (np.arange(5), np.zeros(5, int)), relative=True)
    np.testing.assert_array_equal(line.places(([3, 1], [0, 0])), [[3, 1], [0, 0]])
    np.testing.assert_allclose(boxes[1:, 0, 0], boxes[:-1, 0, 0] + boxes[:-1, 0, 2], atol=1e-6)
    assert np.ptp(boxes[..., 3]) < 1e-9 and boxes[0, 0, 3] > 100


def test_regimes_are_the_paper_s():
    for bend_1, bend_2, twist, number in ((1, 2, 3, 1), (2, 1, 3, 1), (2, 3, 1, 2), (3, 2, 1, 3), (3, 1, 2, 0),
                                          (1, 3, 2, 0), (1, 1, 1, 0), (2, 2, 1, 0)):
        assert regime(bend_1, bend_2, twist) == number
    axes, values = ribbon()
    assert LandscapePlane.of(axes, values).twist == 5e5
    axes, values = ribbon(twist=(1e5, 5e5))
    assert LandscapePlane.of(axes, values).twist is None
    grid = runs.grid()
    assert LandscapePlane.of(grid.picture_axes, np.ones(grid.shape)).twist is None


@pytest.mark.thorough
def test_regimes_and_region_are_drawn():
    axes, values = ribbon()

    def image(axes, region=None):
        return pixels(landscapes.draw_landscape(LandscapePlane.of(axes, values, (0, 0, 0, 0)), "made up", region))
    plain, angle = image(axes), np.linspace(0, 2 * np.pi, 60, endpoint=False)
    ellipse = np.stack([1e6 * np.exp(np.cos(angle)), 1e6 * np.exp(0.5 * np.sin(angle))], axis=-1)
    region = image(axes, ellipse)
    orange = (np.abs(region.astype(int) - (255, 159, 28)).max(axis=-1) < 8).sum()
    assert orange > 500 > 20 > (np.abs(plain.astype(int) - (255, 159, 28)).max(axis=-1) < 8).sum()
    without, _ = ribbon()
    without[2] = ("twist_ratio", np.ones(1), True, "")
    assert (image(without) != plain).mean() > 0.001
    buffer = io.BytesIO()
    landscapes.landscape_picture(buffer, LandscapePlane.of(axes, values, (0, 0, 0, 0)), title="made up", region=ellipse)
    assert buffer.getvalue().startswith(b"\x89PNG")


@pytest.mark.thorough
def test_every_panel_and_key_is_inside_the_picture(rng):
    axes, values = ribbon(twist=(5e5,))
    counts = np.zeros(values.shape, int)
    counts[1, 1], values[2, 2] = 4, np.nan
    whole = LandscapePlane.of(axes, values, (0, 0, 0, 0), counts)
    rows = [[LandscapePanel(f"ribbon {k}", whole, (("30, 42", (5, 5)), ("54", (4, 5)))) for k in range(5)],
            [LandscapePanel("nothing", LandscapePlane.of(axes, np.full(values.shape, np.nan)))]]
    for relative in (False, True):
        figure, drawn = draw_panels(rows, "made up", "others", relative)
        figure.canvas.draw()
        width, height = figure.canvas.get_width_height()
        boxes = [one.title.get_window_extent() for one, _ in drawn] + [key.get_window_extent() for key in figure.legends]
        assert len(drawn) == 6
        for one in boxes:
            assert 0 <= one.x0 < one.x1 <= width and 0 <= one.y0 < one.y1 <= height
        numbers = [re.findall(r"\d+", text.get_text()) for text in figure.legends[0].get_texts()]
        assert ["5", "20"] in numbers and ["41"] in numbers, "cells that do not compete, their rods, and cells not evaluated"


def large(shape: tuple[int, ...]):
    """Axes and a landscape with one minimum, a single low cell beside cells without a value, and cells that do not compete."""
    axes = [("bend", np.geomspace(1e4, 1e7, shape[0]), True, "mm³")]
    if len(shape) > 1:
        axes.append(("twist_ratio", np.linspace(0.1, 6, shape[1]), False, ""))
    values = 2 + sum(((place - 0.4 * size) / size) ** 2 for place, size in zip(np.indices(shape), shape, strict=True))
    minimum = tuple(size // 3 for size in shape)
    values[minimum] = 1.0
    unfinished = np.zeros(shape, int)
    unfinished[:shape[0] // 10] = 3
    values[unfinished > 0] = np.nan
    return axes, values, minimum, unfinished


@pytest.mark.parametrize("shape", [(1300, 700), (5, 2000), (3000,)])
def test_blocks_keep_what_matters_and_a_small_landscape_stays_as_it_is(shape):
    axes, values, minimum, unfinished = large(shape)
    plane = LandscapePlane.of(axes, values, minimum, unfinished)
    drawn, borders = plane.blocks()
    assert max(drawn.values.shape) <= MOST_DRAWN
    assert drawn.values[drawn.minimum] == 1.0 == np.nanmin(drawn.values) and drawn.valley[drawn.minimum]
    assert drawn.valley.sum() == 1, "one cell within 5 %, one block"
    np.testing.assert_array_equal(np.isnan(drawn.values), drawn.unfinished > 0)
    for edges, small, whole in zip(borders, drawn.axes, plane.axes, strict=True):
        fine = cell_edges(whole)
        assert (edges[0], edges[-1]) == (fine[0], fine[-1]) and np.isin(edges, fine).all()
        assert ((edges[:-1] < small[1]) & (small[1] < edges[1:])).all()
    plane = LandscapePlane.of(*large((MOST_DRAWN, 7)))
    drawn, borders = plane.blocks()
    assert drawn is plane
    np.testing.assert_array_equal(borders[1], cell_edges(plane.axes[1]))


@pytest.mark.thorough
def test_a_recording_of_many_cells(tmp_path, rng):
    from doo_ti.record.sweep import MOST_POINTS, record_sweep

    axes, values, minimum, unfinished = large((900, 800))
    run = runs.sweep(rng) | {"plane": LandscapePlane.of(axes, values, minimum, unfinished)}
    record_sweep(tmp_path / "run.rrd", **run)
    _, moving = read(tmp_path / "run.rrd")
    trials = moving["/landscape/cells"]["trial"]["trial"]
    assert MOST_POINTS // 4 < len(trials) <= MOST_POINTS + 1 and np.ravel_multi_index(minimum, (900, 800)) in trials
    assert (tmp_path / "run.rrd").stat().st_size < 12e6


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
