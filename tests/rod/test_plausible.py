"""Numbers in another unit than the one asked for: a warning at the caller's line that names argument, value and remedy."""

import re
import warnings

import numpy as np
import pytest

from doo_ti import Clamp, ClampPath, InputError, Material, Observations, hanging, overhand_knot, predict_step, straight_rod

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
    "a turn in degrees": (lambda: predict_step(ROPE, MATERIAL, CLAMPS, CLAMPS, rotation=90), "rotation: 90 rad .* 1.571"),
    "a path in degrees": (lambda: ClampPath([0, 1], end_rotation=[[0], [90]]), "end_rotation: 90 rad .* 1.571"),
    "a twist in degrees": (lambda: Observations(ROPE.vertices, total_twist=[180]), "total_twist: 180 rad .* 3.142")}


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
    (lambda: Material.diagonal(1e5, -1.0, 1e5), "bend_2", "-1 mm³"),
    (lambda: Material(-5.0, 1e5), "bend", "-5 "),
    (lambda: predict_step(ROPE, MATERIAL, CLAMPS, CLAMPS, sub_step=5), "sub_step", "5 rad")])
def test_what_was_given_is_named(call, field, value):
    with pytest.raises(InputError) as caught:
        call()
    assert caught.value.field == field and caught.value.problem.startswith(value)
