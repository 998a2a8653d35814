"""Landscapes: several in one picture, ribbons and their regimes, and more cells than a picture has room for."""

import io
import re

import numpy as np
import pytest

from doo_ti.report import landscapes
from doo_ti.report.canvas import landscape_colors, pixels
from doo_ti.report.landscapes import LandscapePanel, draw_panels
from doo_ti.report.plane import MOST_DRAWN, LandscapePlane, cell_edges, regime
from tests.record import runs
from tests.record.runs import read


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
        for box in boxes:
            assert 0 <= box.x0 < box.x1 <= width and 0 <= box.y0 < box.y1 <= height
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
def test_blocks_keep_what_matters(shape):
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


def test_a_small_landscape_stays_as_it_is():
    axes, values, minimum, unfinished = large((MOST_DRAWN, 7))
    plane = LandscapePlane.of(axes, values, minimum, unfinished)
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
