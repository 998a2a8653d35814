"""Results have arrays of their own: what a caller does to the arrays that were given changes nothing afterwards."""

from collections.abc import Iterator
from dataclasses import replace
from enum import Enum
from types import FunctionType

import numpy as np
import pytest

import doo_ti as d
from tests.dynamics.recordings import RATE, recorded
from tests.dynamics.test_identify import OPTIONS, TRUE
from tests.first_use import CLAMPS, MATERIAL, ROPE, STEPPING, detection, group, path, picture, seen

BESIDE, STILL = np.array([[0, 0, -150.0]]), d.Grippers.resting(CLAMPS, 4)


def arrays(value: object, name: str = "", met: set | None = None) -> Iterator[tuple[str, np.ndarray]]:
    """Every array in ``value``, by where it is."""
    met = set() if met is None else met
    if value is None or id(value) in met or isinstance(value, str | bytes | int | float | type | Enum | FunctionType):
        return
    met.add(id(value))
    if isinstance(value, np.ndarray):
        yield name, value
    elif isinstance(value, dict | list | tuple):
        for key, part in value.items() if isinstance(value, dict) else enumerate(value):
            yield from arrays(part, f"{name}[{key!r}]", met)
    elif type(value).__module__.startswith("doo_ti"):
        for key, part in vars(value).items():
            yield from arrays(part, f"{name}.{key}", met)


def solution(**options) -> d.Solution:
    return d.relax(ROPE, MATERIAL, CLAMPS, **options)


CALLS = {
    "relax": lambda: (d.relax, ROPE, MATERIAL, CLAMPS),
    "by rows": lambda: (d.relax, replace(ROPE, rest_length=ROPE.rest_length[None].copy()), MATERIAL, CLAMPS, None,
                        {"configuration_index": np.zeros(2, int), "material_index": np.zeros(2, int),
                         "up": np.array([0, 0, 1.0])}),
    "by descent": lambda: (d.relax, ROPE, MATERIAL, CLAMPS, d.Descent(max_iterations=50)),
    "in f32": lambda: (d.relax, ROPE, MATERIAL, CLAMPS, {"precision": "f32 only"}),
    "on springs": lambda: (d.relax, ROPE, MATERIAL, CLAMPS, {
        "external": d.Springs(np.zeros((1, 13, 3)), np.zeros((1, 13))), "external_index": np.zeros(1, int)}),
    "under loads": lambda: (d.relax, ROPE, MATERIAL, CLAMPS, {
        "external": d.PointLoads(np.zeros((1, 13, 3)), np.ones((1, 13)))}),
    "on a plane": lambda: (d.relax, ROPE, MATERIAL, CLAMPS, {
        "obstacles": [d.Plane(BESIDE, np.array([0, 0, 1.0])), d.Itself()], "radius": np.ones(1)}),
    "sensitivity": lambda: (d.sensitivity, solution(), ("bend", "modes"), np.zeros((1, 11, 2))),
    "pullback": lambda: (d.pullback, solution(), np.ones((1, 13, 3)), ("bend", "modes"), np.zeros((1, 11, 2)),
                         np.ones((1, 12, 3, 3))),
    "end_loads": lambda: (d.end_loads, solution()),
    "take": lambda: (d.Solution.take, solution(), slice(0, 1)),
    "simulate": lambda: (d.simulate, d.MovingStart(ROPE, np.zeros((1, 13, 3))), MATERIAL, STILL, d.Dynamics(drag=np.ones(1)),
                         replace(STEPPING, detailed=True), {"pairs": (np.zeros(1, int), np.zeros(1, int))}),
    "on a plane in time": lambda: (d.simulate, ROPE, MATERIAL, STILL, d.Dynamics(), STEPPING, {
        "obstacles": [d.Plane(BESIDE, np.array([0, 0, 1.0]))], "radius": np.ones(1)}),
    "predict": lambda: (d.predict, ROPE, MATERIAL, CLAMPS, path()),
    "predict_step": lambda: (d.predict_step, ROPE, MATERIAL, CLAMPS, path().at(1, CLAMPS)),
    "predict_moving": lambda: (d.predict_moving, ROPE, MATERIAL, CLAMPS, path(), d.Dynamics(), STEPPING),
    "relax_group": lambda: (d.relax_group, group(), {"radius": np.ones(1)}),
    "observations": lambda: (d.Observations, ROPE.vertices, {
        "rest_length": ROPE.rest_length.copy(), "start_frame": CLAMPS.start_frame, "end_frame": CLAMPS.end_frame,
        "total_twist": np.zeros(1), "valid": np.ones((1, 13), bool), "up": np.array([0, 0, 1.0]), "sigma": np.ones((1, 13))}),
    "observation_clamps": lambda: (d.observation_clamps, seen()),
    "start_configuration": lambda: (d.start_configuration, seen(), CLAMPS, np.zeros(1)),
    "end_clamps": lambda: (d.end_clamps, ROPE),
    "hanging": lambda: (d.hanging, np.array([500.0]), 12, np.zeros(3), np.array([300.0, 0, 0])),
    "distance": lambda: (d.distance, ROPE, seen(), np.zeros(1, int)),
    "estimate_twist": lambda: (d.estimate_twist, seen(), MATERIAL, {"group": np.zeros(1, int), "offset": np.zeros(1)}),
    "refine": lambda: (d.refine, seen(), CLAMPS, d.Theta(1e6 * np.eye(2), 1e6)),
    "identify": lambda: (d.identify, d.RecordedMotion.of(recorded(np.random.default_rng(1), TRUE, 1, 20, 0.0), RATE), TRUE,
                         OPTIONS),
    "a recording": lambda: (d.RecordedMotion.of, recorded(np.random.default_rng(1), TRUE, 1, 20, 0.0), RATE),
    "score": lambda: (d.score, picture()[1], picture()[2], np.zeros(1, int), picture()[0], 5e-3, MATERIAL),
    "distance_maps": lambda: (d.distance_maps, [[detection()]]),
    "tracked": lambda: (lambda *given: d.Tracker(*given), picture()[0], np.full(6, 3.0), MATERIAL),
    "point loads": lambda: (d.PointLoads, np.zeros((1, 13, 3)), np.ones((1, 13))),
    "springs": lambda: (d.Springs, np.zeros((1, 13, 3)), np.zeros((1, 13))),
    "grippers": lambda: (d.Grippers, np.full(1, 3), np.full(1, 3), *(getattr(STILL, name) for name in (
        "start_position", "end_position", "start_frame", "end_frame"))),
    "a path": lambda: (d.ClampPath, np.arange(2.0), {"end_position": np.zeros((2, 1, 3))}),
    "materials": lambda: (d.Material, np.ones(2), np.ones(2), np.ones(2), np.zeros((2, 2)), np.ones(2)),
    "dynamics": lambda: (d.Dynamics, np.ones(2), np.ones(2), np.ones(2), np.ones(2), np.ones(2), np.ones((2, 3))),
    "moving": lambda: (d.Moving, d.Sphere(np.zeros(3), 1.0), np.zeros((3, 3)), np.tile(np.eye(3), (3, 1, 1)), np.zeros(3)),
    "an axis": lambda: (d.Axis, "bend", np.array([1.0, 2.0])),
}


@pytest.mark.sampled(1)
@pytest.mark.parametrize("case", CALLS)
def test_a_result_shares_no_array_that_can_be_changed_with_what_was_given(case):
    function, *given = CALLS[case]()
    options = given.pop() if isinstance(given[-1], dict) else {}
    before = [(name, array) for name, array in arrays((given, options)) if array.flags.writeable and array.size]
    for name, array in arrays(function(*given, **options)):
        for other, own in before:
            assert not np.shares_memory(array, own), f"result{name} is given{other}"


def test_a_failed_rod_starts_again_from_where_it_was_given():
    start = replace(ROPE, quaternions=ROPE.quaternions.copy())
    first = d.relax(start, MATERIAL, CLAMPS, d.Newton(max_iterations=1))
    assert not first.converged.any()
    expected = d.relax(first, MATERIAL).configuration.vertices
    start.quaternions[...] = [1.0, 0.0, 0.0, 0.0]
    np.testing.assert_array_equal(d.relax(first, MATERIAL).configuration.vertices, expected)
