"""Invalid arguments: one sentence for each, no crash; and results do not share memory with inputs."""

from dataclasses import replace
from threading import Thread

import numpy as np
import pytest

from doo_ti.dynamics.parameters import Stepping
from doo_ti.relaxation.descent import Descent
from doo_ti.relaxation.external import Springs
from doo_ti.relaxation.newton import Newton
from doo_ti.relaxation.relax import relax
from doo_ti.rod.metric import distance
from doo_ti.rod.observations import Observations
from doo_ti.rod.types import Configuration, Material
from doo_ti.system.errors import InputError
from tests.references.rods import clamps_at
from tests.relaxation.rods import wandering

MATERIAL = Material(2e5, 1e5)


@pytest.fixture
def rods(rng):
    return wandering(rng, 6, 9)


OPTIONS = {
    "iterations beyond 32 bits": lambda: Newton(max_iterations=2**31), "fractions of escapes": lambda: Newton(max_escapes=1.5),
    "no escapes": lambda: Newton(max_escapes=None), "escapes below zero": lambda: Newton(max_escapes=-1),
    "a flag of iterations": lambda: Newton(max_iterations=True), "text": lambda: Newton(tolerance="x"),
    "no shift": lambda: Newton(first_shift=None), "an endless shift": lambda: Newton(first_shift=np.inf),
    "gaps without tolerance": lambda: Newton(gap_tolerance=0.0), "gaps of a radius": lambda: Stepping(100.0, gap_tolerance=1.0),
    "descent without end": lambda: Descent(max_iterations=2**31), "descent to nothing": lambda: Descent(tolerance=None),
    "no materials": lambda: Material([], 1.0), "a number too large": lambda: Material(10**400, 1.0),
    "twist of three axes": lambda: Material(1.0, np.ones((2, 3, 2))),
    "unlike rows": lambda: Material.diagonal([1.0, 2.0], [1.0, 2.0, 3.0], 4.0),
    "imaginary bend": lambda: Material(1e5 + 1j, 1.0), "a flag for twist": lambda: Material(1e5, True),
    "springs of text": lambda: Springs("a", "b"),
}


@pytest.mark.parametrize("case", OPTIONS)
def test_options_and_materials_that_are_none(case):
    with pytest.raises(InputError):
        OPTIONS[case]()


def test_arguments_that_do_not_match(rods):
    clamps = clamps_at(rods)
    wrong = {
        "text": {"quaternions": np.full(rods.quaternions.shape, "a")},
        "imaginary": {"start": rods.start + 0j},
        "imaginary lengths": {"rest_length": rods.rest_length + 0j},
        "whole quaternions": {"quaternions": rods.quaternions.round().astype(int)},
        "flags as positions": {"start": rods.start > 0},
        "ragged lengths": {"rest_length": [[1.0], [1.0, 2.0]]},
        "up beyond floating point": {"up": [10**400, 0, 0]},
        "unlike indices": {"configuration_index": np.arange(3), "material_index": np.zeros(2, int)},
        "ragged index": {"configuration_index": [[0], [1, 2]]},
    }
    for name, changed in wrong.items():
        of_rods = {key: value for key, value in changed.items() if hasattr(rods, key)}
        others = {key: value for key, value in changed.items() if key not in of_rods}
        with pytest.raises(InputError):
            relax(replace(rods, **of_rods), MATERIAL, clamps, **others)
            pytest.fail(name)


@pytest.mark.parametrize("precision", ["f64", "f32", "mixed"])
def test_no_rods_at_all(rods, precision):
    none = np.arange(0)
    solution = relax(rods.take(none), MATERIAL, clamps_at(rods).take(none), precision=precision)
    assert solution.configuration.quaternions.shape == (0, 9, 4) and len(solution.status) == 0


def test_a_result_shares_no_memory_with_what_the_caller_keeps(rods):
    lengths, clamps = rods.rest_length.copy(), clamps_at(rods)
    solution = relax(replace(rods, rest_length=lengths), MATERIAL, clamps)
    vertices = solution.configuration.vertices.copy()
    lengths *= 2
    np.testing.assert_array_equal(solution.configuration.vertices, vertices)
    again = relax(solution, MATERIAL)
    np.testing.assert_allclose(again.energy, solution.energy, rtol=1e-9)
    stiffness = np.ones((1, 10))
    springs = Springs(np.zeros((1, 10, 3)), stiffness)
    stiffness[:] = -5
    assert (springs.stiffness == 1).all()


def test_distances_of_rods_that_are_not_whole(rods):
    observations = Observations(rods.vertices)
    shape = Configuration(rods.start, rods.quaternions, rods.rest_length)
    for wrong in ({"rest_length": np.ones(3)}, {"start": shape.start[:1]}, {"rest_length": np.ones((2, 9))}):
        with pytest.raises(InputError, match="start|quaternions|rest_length"):
            distance(replace(shape, **wrong), observations)
    for index in (np.zeros((2, 3), int), 3):
        with pytest.raises(InputError, match="index"):
            distance(shape, observations, index)
    for weight in (-1.0, np.nan, "a"):
        with pytest.raises(InputError, match="frame_weight"):
            distance(shape, observations, frame_weight=weight)


def test_threads_take_turns(rods):
    """Taichi compiles for one thread only, and calls share the kernels' memory."""
    clamps, found = clamps_at(rods), {}

    def work(number: int) -> None:
        found[number] = [relax(rods, MATERIAL, clamps, precision=precision).energy for precision in ("f32", "mixed", "f64")]

    threads = [Thread(target=work, args=(number,)) for number in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 4
    for energies in found.values():
        for own, first in zip(energies, found[0], strict=True):
            np.testing.assert_array_equal(own, first)


def test_materials_as_many_as_before_take_their_places(rods):
    clamps, index = clamps_at(rods), np.array([0, 1, 0, 1, 1, 0])
    before = relax(rods, Material([2e5, 3e5], 1e5), clamps, configuration_index=np.arange(6), material_index=index)
    after = relax(before, Material([2.2e5, 2.7e5], 1.1e5))
    again = relax(before, Material([2.2e5, 2.7e5], 1.1e5), material_index=index)
    np.testing.assert_array_equal(after.energy, again.energy)
