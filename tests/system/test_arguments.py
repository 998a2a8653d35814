"""Wrong arguments of public functions and classes: an InputError in one line, whatever they are, and no array is changed."""

import gc
import json
import weakref
from dataclasses import dataclass
from enum import IntEnum
from typing import Annotated, NewType

import numpy as np
import pytest
from numpy.typing import ArrayLike

import doo_ti
from doo_ti import InputError
from doo_ti.commands.results import plain
from doo_ti.dynamics.theta import save_form
from doo_ti.system import argument_rules
from doo_ti.system.arguments import typed
from tests import hostile_calls
from tests.conftest import check_refused

NOT_CALLED = {"Contacts", "Obstacle", "EndLoads", "GroupSolution", "Hypotheses", "Identified", "Landscape", "Perception",
              "Prediction", "Pullback", "Refinement", "Score", "Sensitivity", "TrackedFrame", "Trajectory", "TwistEstimate",
              "External", "LearnedMaterial", "HeldSolution"}
"""Results, and what obstacles and energies have in common: a program does not make them."""
LONG = {"DistanceGrid.from_mesh", "Tracker.see", "detect", "estimate_twist", "follow_group", "identify",
        "identify_from_guesses", "relax in contact", "simulate in contact",
        "perceive", "plan_manipulation", "predict_moving", "record_sweep", "refine", "relax_group", "score", "sweep"}
"""Functions that take seconds where an argument turns out right, left to the long run."""


def test_every_public_name_is_called():
    called = {name.partition(" ")[0].partition(".")[0] for name in hostile_calls.constructors() | hostile_calls.functions()}
    kinds = {name for name in doo_ti.__all__ if isinstance(getattr(doo_ti, name), type) and issubclass(
        getattr(doo_ti, name), Exception | IntEnum)}
    assert set(doo_ti.__all__) - called == NOT_CALLED | kinds


def test_hostile_calls_are_refused_in_words():
    assert hostile_calls.main(200, 7, without=LONG) == []


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5))
def test_ten_thousand_hostile_calls_are_refused_in_words(seed):
    assert hostile_calls.main(2000, seed) == []


NO_ROPE, NO_CLAMPS = hostile_calls.ROPE.take([]), hostile_calls.CLAMPS.take([])
TOUCHING = {"obstacles": [doo_ti.Plane((0, 0, -150), (0, 0, 1)), doo_ti.Itself()], "radius": 1.0}


@pytest.mark.parametrize("around", [{}, TOUCHING])
def test_no_rods_are_no_error(around):
    material = hostile_calls.MATERIAL
    solution = doo_ti.relax(NO_ROPE, material, NO_CLAMPS, **around)
    assert solution.converged.shape == (0,) and (not around or solution.contact.gap.shape == (0,))
    assert doo_ti.sensitivity(solution).usable.shape == doo_ti.end_loads(solution).end_force[:, 0].shape == (0,)
    still = doo_ti.Grippers.resting(NO_CLAMPS, 3)
    trajectory = doo_ti.simulate(NO_ROPE, material, still, doo_ti.Dynamics(), hostile_calls.STEPPING, **around)
    assert trajectory.positions.shape == (0, 2, 13, 3)


@pytest.mark.parametrize("value", [10**400, "3", True], ids=["hundreds of digits", "text", "a flag"])
@pytest.mark.parametrize("key", ["bend_mm3", "rest_length_mm", "up", "friction"])
def test_what_is_no_number_in_a_file_of_theta_is_refused(tmp_path, key, value):
    path = tmp_path / "THETA.json"
    form = plain(save_form(hostile_calls.theta()))
    path.write_text(json.dumps(form | {key: value}))
    with pytest.raises(InputError) as caught:
        doo_ti.load_theta(path)
    assert caught.value.field == key in form


class Shade(IntEnum):
    DARK = 0
    LIGHT = 1


@typed
@dataclass(frozen=True)
class Several:
    places: Annotated[np.ndarray, "R 3"]
    flags: Annotated[np.ndarray, "1R", bool]
    numbers: Annotated[np.ndarray | None, "R-1", int] = None

    @property
    def count(self) -> int:
        return len(self.places)


@typed
def mixed(several: Annotated[Several, "R"], weight: Annotated[ArrayLike, "() | R"] = 1.0, *, shade: Shade = Shade.DARK,
          names: tuple[str, ...] = (), size: int = 1) -> tuple:
    return weight, shade, names, size


TWO = Several([[0, 0, 0], [1, 1, 1]], [True], [7])


def test_what_stands_for_a_value_is_taken():
    assert isinstance(TWO.places, np.ndarray) and TWO.numbers.tolist() == [7]
    weight, shade, names, size = mixed(TWO, [1, 2], shade=1, names=np.array(["a"]), size=np.array(3))
    assert weight.tolist() == [1, 2] and shade is Shade.LIGHT and names == ("a",) and size == 3
    assert type(doo_ti.ServoOptions(noise_mm=1).noise_mm) is float  # arrays of it take fractions


@pytest.mark.parametrize(("call", "source", "field"), [
    (lambda: Several(np.zeros((2, 2)), [True]), "Several", "places"),
    (lambda: Several([[0, 0, 0], [1, 1]], [True]), "Several", "places"), (lambda: Several(["a"], [True]), "Several", "places"),
    (lambda: Several(np.zeros((2, 3)), [1, 0]), "Several", "flags"),
    (lambda: Several(np.zeros((2, 3)), np.ones(3, bool)), "Several", "flags"),
    (lambda: Several(np.zeros((2, 3)), [True], [0.5]), "Several", "numbers"),
    (lambda: Several(np.zeros((2, 3)), [True], [1, 2]), "Several", "numbers"), (lambda: mixed(1.0), "mixed", "several"),
    (lambda: mixed(TWO, [1, 2, 3]), "mixed", "weight"), (lambda: mixed(TWO, "heavy"), "mixed", "weight"),
    (lambda: mixed(TWO, shade=2), "mixed", "shade"), (lambda: mixed(TWO, names="abc"), "mixed", "names"),
    (lambda: mixed(TWO, names=(1,)), "mixed", "names"), (lambda: mixed(TWO, size=1.5), "mixed", "size"),
    (lambda: mixed(TWO, size=True), "mixed", "size"), (lambda: mixed(TWO, size=10**400), "mixed", "size")])
def test_what_does_not_is_named(call, source, field):
    check_refused(f"^{source}: {field}: ", call)


def test_nothing_of_a_call_outlives_its_result():
    """Not even until the garbage collector comes: fresh memory for every result costs as much as relaxing a rod."""
    start, clamps = doo_ti.hanging(100.0, 6, (0.0, 0.0, 0.0), (80.0, 0.0, 0.0))
    material = doo_ti.Material(1e4, 1e4)
    doo_ti.relax(start, material, clamps)
    gc.collect()
    gc.disable()
    try:
        results = [doo_ti.relax(start, material, clamps, up=[0.0, 0.0, 1.0])]
        results.append(doo_ti.relax(results[0], material))
        results.append(doo_ti.sensitivity(results[0]))
        kept = [weakref.ref(result) for result in results]
        del results
        assert [ref() for ref in kept] == [None, None, None]
    finally:
        gc.enable()


def test_array_like_is_a_name_since_numpy_2_5(monkeypatch):
    named = NewType("ArrayLike", object)  # as opaque as NumPy's ``type ArrayLike = …``, which Python 3.11 cannot write
    monkeypatch.setattr(argument_rules, "ArrayLike", named)
    monkeypatch.setattr(argument_rules, "ARRAY_PARTS", {named})
    for annotation in (named, named | None, Annotated[named | None, "3"]):
        rule = argument_rules.rule_of(annotation)
        assert list(rule.take([1.0, 2.0, 3.0])) == [1.0, 2.0, 3.0]
        with pytest.raises(argument_rules.Mismatch, match="rows of different lengths"):
            rule.take([[1.0], [2.0, 3.0]])
