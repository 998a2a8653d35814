"""Rods of a tenth of a millimetre and of a kilometre: the same shapes, statuses and iterations; limp rods are exact."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from doo_ti import Clamp, Clamps, Configuration, Material, Newton, Springs, relax
from tests.references.rods import clamps_at, jiggled
from tests.relaxation.rods import wandering, with_kinds

EDGES, COUNT = 20, 24
SIZES = (1e-3, 0.1, 3.0, 1e3, 1e4)
SAME = 2e-4
"""Of the length."""


def sized(rods: Configuration, clamps: Clamps, size: float) -> tuple[Configuration, Clamps]:
    """The same rods and clamps with all lengths times ``size``."""
    grown = Configuration(rods.start * size, rods.quaternions, rods.rest_length * size)
    ends = (clamps.start_position * size, clamps.end_position * size)
    return grown, replace(clamps, start_position=ends[0], end_position=ends[1])


def problem(rng, kinds=None):
    """Rods of 60 mm, clamps and materials."""
    rods = wandering(rng, COUNT, EDGES, 3.0, wander=0.2, twist=0.1)
    clamps = clamps_at(rods) if kinds is None else with_kinds(clamps_at(rods), kinds)
    return jiggled(rods, rng, 0.05), clamps, np.exp(rng.uniform(np.log(1e4), np.log(1e6), (2, COUNT)))


@pytest.mark.parametrize("precision", ["f32", "mixed", "f64"])
def test_shapes_do_not_depend_on_size(rng, precision):
    rods, clamps, (bend, twist) = problem(rng)
    exact = relax(rods, Material(bend, twist), clamps)
    length = rods.rest_length.sum()
    for size in SIZES:
        start, held = sized(rods, clamps, size)
        solution = relax(start, Material(bend * size**3, twist * size**3), held, precision=precision)
        assert (solution.converged == exact.converged).all() and (solution.stable == exact.stable).all()
        off = np.abs(solution.configuration.vertices / size - exact.configuration.vertices).max() / length
        assert off < SAME, size
        np.testing.assert_allclose(solution.energy / size**2, exact.energy, rtol=1e-4)
        scale = np.abs(exact.end_force).max()
        np.testing.assert_allclose(solution.end_force / size, exact.end_force, atol=3e-3 * scale)


def test_a_power_of_two_changes_no_bit(rng):
    rods, clamps, (bend, twist) = problem(rng)
    one = relax(rods, Material(bend, twist), clamps, precision="f32")
    start, held = sized(rods, clamps, 1024.0)
    other = relax(start, Material(bend * 1024.0**3, twist * 1024.0**3), held, precision="f32")
    np.testing.assert_array_equal(one.configuration.quaternions, other.configuration.quaternions)
    np.testing.assert_array_equal(one.residual, other.residual)
    np.testing.assert_array_equal(one.iterations, other.iterations)


@pytest.mark.parametrize("size", [10.0, 100.0])
def test_long_limp_rods_are_right_in_f32_or_left_to_f64(rng, size):
    """The same stiffness over longer rods: rounding limits the residual moments, and f64 finishes the rods."""
    rods, clamps, (bend, twist) = problem(rng)
    start, held = sized(rods, clamps, size)
    exact, single = (relax(start, Material(bend, twist), held, precision=precision) for precision in ("f64", "f32"))
    both = exact.converged & exact.stable & single.converged & single.stable
    apart = np.abs(single.configuration.vertices - exact.configuration.vertices).max(axis=(1, 2)) / start.rest_length.sum()
    same = np.isclose(single.energy, exact.energy, rtol=1e-5)
    print(f"{size:g} times as long: {np.sum(single.precision == 64)} of {COUNT} left to f64, {np.sum(~same)} in another basin")
    assert both.all() and (apart[same] < SAME).all() and same.mean() > 0.8


@pytest.mark.thorough
def test_springs_of_any_size_and_any_ends(rng):
    kinds = [pair for pair in product(Clamp, Clamp)] + [(Clamp.FRAME, Clamp.FRAME)] * (COUNT - 16)
    rods, clamps, (bend, twist) = problem(rng, kinds)
    points = rods.vertices + rng.normal(size=rods.vertices.shape)
    stiffness = rng.uniform(1.0, 100.0, rods.vertices.shape[:2])
    one = relax(rods, Material(bend, twist), clamps, Newton.careful(), external=Springs(points, stiffness))
    for size in (0.05, 300.0):
        start, held = sized(rods, clamps, size)
        other = relax(start, Material(bend * size**3, twist * size**3), held, Newton.careful(),
                      external=Springs(points * size, stiffness))
        assert one.converged.all() and other.converged.all()
        off = np.abs(other.configuration.vertices / size - one.configuration.vertices).max() / rods.rest_length.sum()
        assert off < 1e-6
        np.testing.assert_allclose(other.energy / size**2, one.energy, rtol=1e-9)
