"""Landscapes of more cells than a picture has room for."""

import io

import numpy as np
import pytest

from doo_ti import report
from doo_ti.report.plane import MOST_DRAWN, LandscapePlane, cell_edges
from tests.record import runs
from tests.record.recordings import read


def large(shape: tuple[int, ...]):
    """Axes and a landscape with one minimum, a single low cell beside cells without a value, and cells that do not compete."""
    axes = [("bend", np.geomspace(1e4, 1e7, shape[0]), True, "mm³")]
    if len(shape) > 1:
        axes.append(("twist_ratio", np.linspace(0.1, 6, shape[1]), False, ""))
    places = np.indices(shape)
    values = 2 + sum(((place - 0.4 * size) / size) ** 2 for place, size in zip(places, shape, strict=True))
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
@pytest.mark.parametrize("shape", [(900, 800), (20_000,)])
def test_a_picture_of_many_cells(shape):
    axes, values, minimum, unfinished = large(shape)
    file = io.BytesIO()
    report.landscape_picture(file, LandscapePlane.of(axes, values, minimum, unfinished), title="many")
    assert file.getvalue()[:8] == b"\x89PNG\r\n\x1a\n"


@pytest.mark.thorough
def test_a_recording_of_many_cells(tmp_path, rng):
    from doo_ti.record import record_sweep
    from doo_ti.record.sweep import MOST_POINTS

    axes, values, minimum, unfinished = large((900, 800))
    run = runs.sweep(rng) | {"plane": LandscapePlane.of(axes, values, minimum, unfinished)}
    record_sweep(tmp_path / "run.rrd", **run)
    _, moving = read(tmp_path / "run.rrd")
    trials = moving["/landscape/cells"]["trial"]["trial"]
    assert MOST_POINTS // 4 < len(trials) <= MOST_POINTS + 1 and np.ravel_multi_index(minimum, (900, 800)) in trials
    assert (tmp_path / "run.rrd").stat().st_size < 12e6
