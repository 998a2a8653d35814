"""Grids over Θ: the text of an option, the order of cells, and the range within 5 % of the minimum."""

import json

import numpy as np
import pytest

from doo_ti.rod.grid import Axis, Grid, parse_axis, parse_bend, valley
from tests.conftest import check_refused


def test_text_of_an_axis():
    axis = parse_axis("--twist-ratio", "0.1:6:25")
    assert axis.name == "twist_ratio" and axis.log and len(axis) == 25
    assert (axis.values[0], axis.values[-1]) == (0.1, 6.0)
    np.testing.assert_allclose(np.diff(np.log(axis.values)), np.log(60) / 24)
    linear = parse_axis("--weight", "0:2:5:lin")
    np.testing.assert_allclose(linear.values, [0, 0.5, 1, 1.5, 2])
    assert not linear.log and parse_axis("--bend", " 1e5:2e5:2:log ").label == "bend [mm³]"
    assert parse_axis("--weight", "0").values.tolist() == [0.0]
    assert parse_axis("--bend-1", "3e6").label == "bend_1 [mm³]"


def test_text_of_bend():
    (axis,), mixed = parse_bend("6e5")
    assert (axis.name, axis.values.tolist(), mixed) == ("bend", [6e5], 0)
    (first, second), mixed = parse_bend("3, 2")
    assert (first.name, second.name, first.values[0], second.values[0], mixed) == ("bend_1", "bend_2", 3, 2, 0)
    axes, mixed = parse_bend("3,2,-1")
    bend = Grid(axes, mixed).materials().bend
    np.testing.assert_array_equal(bend, [[[[3, -1], [-1, 2]]]])
    assert len(parse_bend("1e5:1e8:13")[0][0]) == 13


@pytest.mark.parametrize("text", [
    "", "x", "1e5:1e6", "1e5:1e6:3:cubic", "1e5:1e6:3:log:log", "1e5:1e6:2.5", "1e5:1e6:0", "1e5:1e6:-3", "1e6:1e5:3",
    "0:1e5:3", "-1e5:1e5:3", "nan", "inf:inf:2", "1e5:nan:2", "1e5:1e5:3", "1e5:1e6:1", "0", "-3",
    "1e5:1e6:99999999999", "1,2", "1e5;2e5"])
def test_text_that_is_no_axis(text):
    check_refused(": --bend: ", parse_axis, "--bend", text)


@pytest.mark.parametrize("text", ["1,2,3", "1,2,1.5", "-1,2", "1,0", "1,2,3,4", "1,x", "1,", "1e5:1e6:0"])
def test_text_that_is_no_bend(text):
    check_refused(": bend: ", parse_bend, text)


def test_cells_run_in_the_order_of_the_axes():
    grid = Grid((Axis("twist_ratio", [0.5, 2, 3]), Axis("bend", [10, 100])))
    assert grid.shape == (2, 3, 1) and grid.size == 6
    assert [axis.name for axis in grid.axes] == ["bend", "twist_ratio", "weight"]
    cells = grid.cell_values()
    bend, twist = [10, 10, 10, 100, 100, 100], [5, 20, 30, 50, 200, 300]
    found = [cells[name] for name in ("bend_1", "bend_2", "twist", "weight")]
    np.testing.assert_array_equal(found, [bend, bend, twist, np.ones(6)])
    material = grid.materials()
    assert material.is_isotropic and material.count == 6
    np.testing.assert_array_equal(material.twist[:, 0], cells["twist"])
    assert [axis.name for axis in grid.varying] == ["bend", "twist_ratio"]


def test_anisotropic_cells_take_the_ratio_from_bend_1():
    axes = (Axis("bend_2", [1, 2]), Axis("bend_1", [10, 20, 30]), Axis("twist_ratio", 0.5), Axis("weight", [1, 3]))
    grid = Grid(axes)
    assert grid.shape == (3, 2, 1, 2) and not grid.is_isotropic
    cells, material = grid.cell_values(), grid.materials()
    np.testing.assert_array_equal(cells["twist"], 0.5 * cells["bend_1"])
    np.testing.assert_array_equal(material.bend[:, 0, 0, 0], cells["bend_1"])
    np.testing.assert_array_equal(material.bend[:, 0, 1, 1], cells["bend_2"])
    np.testing.assert_array_equal(cells["bend_2"].reshape(grid.shape)[0, :, 0, 0], [1, 2])


def test_a_chunk_of_cells_is_a_chunk_of_the_whole(rng):
    grid = Grid((Axis("bend_1", [10, 20, 30]), Axis("bend_2", [1, 2, 4]), Axis("twist", [5, 6])), bend_12=1.0)
    whole = grid.materials()
    some = rng.permutation(grid.size)[:7]
    for cells in (slice(4, 11), some):
        np.testing.assert_array_equal(grid.materials(cells).bend, whole.bend[cells])
        np.testing.assert_array_equal(grid.materials(cells).twist, whole.twist[cells])


def test_defaults_and_replaced_axes():
    grid = Grid((Axis("bend", [1, 2, 3]),))
    assert grid.cell_values()["twist"].tolist() == [1, 2, 3] and grid.shape == (3, 1, 1)
    changed = grid.with_axes((Axis("twist", 7.0), Axis("bend_1", 4.0), Axis("bend_2", 2.0)), 1.0)
    assert [axis.name for axis in changed.axes] == ["bend_1", "bend_2", "twist", "weight"] and changed.bend_12 == 1.0
    assert changed.with_axes((Axis("weight", 2.0),)).bend_12 == 1.0
    assert changed.with_axes((Axis("bend", 2.0),)).is_isotropic
    check_refused("bend_2", grid.with_axes, (Axis("bend_1", 4.0),))


@pytest.mark.parametrize("axes, bend_12, field", [
    ((), 0, "bend"), ((Axis("twist", 1.0),), 0, "bend"), ((Axis("bend_1", 1.0),), 0, "bend_2"),
    ((Axis("bend", 1.0), Axis("bend_1", 1.0)), 0, "bend_1"), ((Axis("bend", 1.0), Axis("bend", 2.0)), 0, "bend"),
    ((Axis("bend", 1.0), Axis("twist", 1.0), Axis("twist_ratio", 1.0)), 0, "twist_ratio"),
    ((Axis("stretch", 1.0),), 0, "stretch"), ((Axis("bend", []),), 0, "bend"), ((Axis("bend", [2, 1]),), 0, "bend"),
    ((Axis("bend", [1, 1]),), 0, "bend"), ((Axis("bend", [0.0, 1]),), 0, "bend"),
    ((Axis("bend", 1.0), Axis("weight", -1.0)), 0, "weight"),
    ((Axis("bend_1", [1, 2.0]), Axis("bend_2", [1, 2.0])), 1.0, "bend"), ((Axis("bend", np.nan),), 0, "bend")])
def test_invalid_grids(axes, bend_12, field):
    check_refused(f": {field}: ", Grid, axes, bend_12)


def test_a_grid_comes_back_from_json_exactly():
    axes = (parse_axis("--bend-1", "5e4:1e7:25"), parse_axis("--bend-2", "5e4:1e7:3:lin"), Axis("twist", 5e5))
    grid = Grid(axes, 7.0)
    again = Grid.from_dict(json.loads(json.dumps(grid.as_dict())))
    assert again.as_dict() == grid.as_dict() and again.shape == grid.shape
    for wrong in (None, {}, {"axes": 3, "bend_12": 0}, {"axes": [{"name": "bend"}], "bend_12": 0},
                  {"axes": [{"name": ["bend"], "values": [1e5], "log": True}], "bend_12": 0}, {"axes": [], "bend_12": 10**400}):
        check_refused(": ", Grid.from_dict, wrong)


def test_valley_is_the_range_within_five_per_cent():
    grid = Grid((Axis("bend", [1, 2, 4, 8]), Axis("twist_ratio", [0.5, 1, 2])))
    mean = np.full((4, 3), 2.0)
    mean[1, 1], mean[2, 1], mean[2, 2], mean[0, 0], mean[3, 1] = 1.0, 1.05, 1.02, 1.06, np.nan
    bend, ratio = valley(grid, mean.ravel())
    assert (bend.name, bend.best, bend.low, bend.high) == ("bend", 2, np.sqrt(1 * 2), np.sqrt(4 * 8))
    assert not (bend.low_is_open or bend.high_is_open)
    assert (ratio.best, ratio.low, ratio.high) == (1, np.sqrt(0.5), 2) and ratio.high_is_open and not ratio.low_is_open
    assert str(ratio) == "twist_ratio = 1 in 0.707 .. >=2" and "mm³" in str(bend) and not ratio.at_border
    (wide, _) = valley(grid, mean.ravel(), 0.1)
    assert (wide.low, wide.low_is_open) == (1, True)
    check_refused("no cell", valley, grid, np.full(12, np.nan))
