"""Results have arrays of their own: what a caller does to the arrays that were given changes nothing afterwards."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import doo_ti as d
from tests.dynamics.recordings import RATE, recorded
from tests.dynamics.test_identify import OPTIONS, TRUE
from tests.first_use import CLAMPS, MATERIAL, ROPE, arrays, seen
from tests.hostile_calls import constructors, functions


def writable(value: object) -> object:
    """``value``, or an array of its numbers that a caller could change."""
    numbers = isinstance(value, list | tuple) and value and all(isinstance(part, int | float) for part in value)
    return np.array(value) if numbers or isinstance(value, np.ndarray) else value


KEEPING = {"relax again", "Servo", "Simulation", "relax_held", "identify_from_guesses"}
"""Functions whose results keep what they were given, to go on from it; the last one is given what it makes nothing of."""
OWNING = ("Camera", "Capsule", "ClampPath", "Dynamics", "Grippers", "ManipulationPath", "Material", "MotionTheta",
          "Observations", "PointLoads", "Sphere", "Springs", "Axis")
RELAX = {"x0": ROPE, "material": MATERIAL, "clamps": CLAMPS}


def calls() -> dict[str, tuple]:
    known, made, one = functions(), constructors(), np.zeros(1, int)
    found = {name: call for name, call in known.items()
             if name not in KEEPING and not any(isinstance(value, Path) for value in call[1].values())}
    return found | {name: made[name] for name in OWNING} | {
        "by rows": (d.relax, RELAX | {
            "x0": replace(ROPE, rest_length=ROPE.rest_length[None].copy()), "material_index": [0, 0]}),
        "by descent": (d.relax, RELAX | {"solver": d.Descent(max_iterations=50)}),
        "in f32": (d.relax, RELAX | {"precision": "f32 only"}),
        "on springs": (d.relax, RELAX | {
            "external": d.Springs(np.zeros((1, 13, 3)), np.zeros((1, 13))), "external_index": [0]}),
        "under loads": (d.relax, RELAX | {"external": d.PointLoads(np.zeros((1, 13, 3)), np.ones((1, 13)))}),
        "on a plane": (d.relax, RELAX | {"obstacles": [d.Plane((0, 0, -150), (0, 0, 1)), d.Itself()], "radius": np.ones(1)}),
        "take": (d.Solution.take, {"self": known["pullback"][1]["solution"], "index": slice(0, 1)}),
        "in motion": (d.simulate, known["simulate"][1] | {
            "start": d.MovingStart(ROPE, np.zeros((1, 13, 3))), "pairs": (one, one)}),
        "of a group": (d.relax_group, known["relax_group"][1] | {"radius": np.ones(1)}),
        "total twist": (d.estimate_twist, {"observations": seen(), "material": MATERIAL, "group": one, "offset": np.zeros(1)}),
        "identify": (d.identify, {"motion": d.RecordedMotion.of(recorded(np.random.default_rng(1), TRUE, 1, 20, 0.0), RATE),
                                  "begin": TRUE, "options": OPTIONS}),
        "moving": (d.Moving, {"obstacle": d.Sphere((0, 0, 0), 1.0), "shift": np.zeros((3, 3)), "pivot": np.zeros(3)})}


@pytest.mark.parametrize("names", [("relax", "Observations"), pytest.param(None, marks=pytest.mark.thorough)])
def test_a_result_shares_no_array_that_can_be_changed_with_what_was_given(names):
    every = calls()
    for case in names or every:
        function, given = every[case][0], {name: writable(value) for name, value in every[case][1].items()}
        before = [(name, array) for name, array in arrays(given) if array.flags.writeable and array.size]
        for name, array in arrays(function(**given)):
            for other, own in before:
                assert not np.shares_memory(array, own), f"{case}: result{name} is given{other}"


def test_a_failed_rod_starts_again_from_where_it_was_given():
    start = replace(ROPE, quaternions=ROPE.quaternions.copy())
    first = d.relax(start, MATERIAL, CLAMPS, d.Newton(max_iterations=1))
    assert not first.converged.any()
    expected = d.relax(first, MATERIAL).configuration.vertices
    start.quaternions[...] = [1.0, 0.0, 0.0, 0.0]
    np.testing.assert_array_equal(d.relax(first, MATERIAL).configuration.vertices, expected)
