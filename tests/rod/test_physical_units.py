"""Physical units, against a weighed cantilever and each other; numbers in another unit are doubted at the caller's line."""

import re
import warnings

import numpy as np
import pytest

from doo_ti import Clamp, ClampPath, Material, Observations, predict_step, relax
from doo_ti.commands.cli import _Parser
from doo_ti.commands.given import add_material, grid
from doo_ti.rod.grid import parse_axis
from doo_ti.rod.material import stiffness, weight_per_length
from doo_ti.rod.shapes import end_clamps, hanging, overhand_knot, straight_rod
from tests.conftest import check_refused

EI, GJ, DENSITY = 2e-6, 1.5e-6, 1.2  # N m², g/m: a suture
LENGTH, EDGES = 60.0, 40


def test_a_cantilever_sags_as_beam_theory_says():
    weight, rod = weight_per_length(DENSITY), straight_rod(LENGTH, EDGES)
    stiff = 50 * EI  # sags little, where w L⁴/(8 EI) holds
    solution = relax(rod, Material.from_physical(stiff, stiff, weight), end_clamps(rod))
    free = LENGTH - LENGTH / EDGES / 2  # the held edge clamps at its middle
    expected = weight * (free / 1e3) ** 4 / (8 * stiff) * 1e3
    assert -solution.configuration.vertices[0, -1, 2] == pytest.approx(expected, rel=0.01)


def test_there_and_back():
    material = Material.from_physical([EI, 2 * EI], GJ, weight_per_length(DENSITY))
    np.testing.assert_allclose(stiffness(material.bend[:, 0, 0, 0] / 2, DENSITY), [EI, 2 * EI])
    np.testing.assert_allclose(stiffness(material.twist[0, 0] / 2, DENSITY), GJ)
    rows = Material.from_physical([1e-6, 2e-6], 1e-6, [1e-2, 3e-2])
    np.testing.assert_array_equal(rows.take([1]).weight_per_length, [3e-2])


def options(**given):
    parser = _Parser()
    add_material(parser, "")
    return parser.parse_args([part for name, value in given.items() for part in (f"--{name.replace('_', '-')}", value)])


def test_ranges_in_newton_square_metres_are_axes_of_bend_and_twist():
    found = grid(options(EI="1e-6:1e-5:4", GJ="1.5e-6", linear_density="1.2"))
    factor = 2e9 / weight_per_length(1.2)
    axes = {axis.name: axis.values for axis in found.axes}
    np.testing.assert_allclose(axes["bend"], parse_axis("--bend", "1e-6:1e-5:4").values * factor)
    np.testing.assert_allclose(axes["twist"], [1.5e-6 * factor])


@pytest.mark.parametrize(("given", "field"), [
    (dict(weight=np.ones((1, 33))), "weight"), (dict(weight_per_length=np.ones((2, 2))), "weight_per_length"),
    (dict(weight_per_length=-1.0), "weight_per_length"), (dict(weight=0.0, weight_per_length=1.0), "weight_per_length")])
def test_a_weight_is_one_number_per_rod(given, field):
    check_refused(f"material: {field}: ", Material, 1e5, 1e5, **given)


@pytest.mark.parametrize(("given", "field"), [
    (dict(EI="1e-6", GJ="1e-6"), "--linear-density"), (dict(EI="1e-6", bend="1e5", linear_density="1"), "--EI"),
    (dict(EI="1e-6", GJ="x", linear_density="1"), "--GJ"), (dict(EI="1e-6", GJ="1e-6", weight="2", linear_density="1"), "--EI"),
    (dict(EI="1e-6", GJ="1e-6", linear_density="0"), "--linear-density")])
def test_wrong_units_are_one_line(given, field):
    check_refused(field, lambda: grid(options(**given)))


ROPE, CLAMPS = hanging(500.0, 12, (0, 0, 0), (300, 0, 0), clamp=Clamp.FRAME)
MATERIAL = Material(1e6, 1e6)
DOUBTFUL = {
    "a rope in metres": (lambda: hanging(1.0, 20, (0, 0, 0), (0.6, 0, 0)), "hanging: length: .* 1 mm .* 1000"),
    "one of several ropes in metres": (lambda: hanging([500.0, 0.5], 20, (0, 0, 0), (0.6, 0, 0)), "length: .* 0.5 mm .* 500"),
    "a rod in metres": (lambda: straight_rod(0.3, 20), "straight_rod: length: .* 0.3 mm .* 300"),
    "a rod in micrometres": (lambda: straight_rod(3e5, 20), "straight_rod: length: .* 3e.05 mm"),
    "a knot in metres": (lambda: overhand_knot(0.5, 150, radius=1e-3, loop=0.012), "overhand_knot: length"),
    "kg/m of a heavy cable in mg/m": (lambda: Material.from_physical(1e-3, 1e-3, 5e4), "weight_per_length: 50000 N/m; .* kg/m"),
    "N mm²": (lambda: Material.from_physical(2e6, 2e6, 0.5), "EI, weight_per_length: .* N m²"),
    "a path in degrees": (lambda: ClampPath([0, 1], end_rotation=[[0], [90]]), "end_rotation: 90 rad .* 1.571"),
    "a twist in degrees": (lambda: Observations(ROPE.vertices, total_twist=[180]), "total_twist: 180 rad .* 3.142"),
    "a turn in degrees": (lambda: predict_step(ROPE, MATERIAL, CLAMPS, CLAMPS, rotation=90), "rotation: 90 rad .* 1.571")}


@pytest.mark.sampled(len(DOUBTFUL) - 1)  # the last one relaxes
@pytest.mark.parametrize("case", DOUBTFUL)
def test_another_unit_is_doubted_at_the_callers_line(case):
    call, words = DOUBTFUL[case]
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        call()
    doubts = [one for one in caught if one.category is UserWarning]
    assert len(doubts) == 1 and re.search(words, str(doubts[0].message)) and doubts[0].filename == __file__


def test_usual_numbers_raise_no_doubt():
    straight_rod(10.0, 9)
    straight_rod(20_000.0, 9)
    ClampPath([0, 1], end_rotation=[[0], [20 * np.pi]])
    ClampPath([0, 1], end_rotation=[[0], [6.0]])
    Material.from_physical([1e-9, 2.5e4], 1.0, [2e-5, 97.0])


@pytest.mark.parametrize(("call", "field", "value"), [
    (lambda: Material.from_physical(-1e-3, 1e-3, 0.5), "EI", "-0.001 N m²"),
    (lambda: Material.from_physical([1e-3, 1e-3], [1e-3, -2e-3], 0.5), "GJ", "-0.002 N m²"),
    (lambda: Material.from_physical(1e-3, 1e-3, -0.5), "weight_per_length", "-0.5 N/m"),
    pytest.param(lambda: Material.from_physical(EI, GJ, 0.0), "weight_per_length", "", id="a rod without weight"),
    (lambda: Material.diagonal(1e5, -1.0, 1e5), "bend_2", "-1 mm³"), (lambda: Material(-5.0, 1e5), "bend", "-5 "),
    (lambda: relax(ROPE, MATERIAL, CLAMPS, up="y"), "up", "'y'"),
    (lambda: predict_step(ROPE, MATERIAL, CLAMPS, CLAMPS, sub_step=5), "sub_step", "5 rad")])
def test_what_was_given_is_named(call, field, value):
    check_refused(f": {field}: {value}", call)
