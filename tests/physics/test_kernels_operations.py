"""The larger of two numbers, the largest lane of a pack, literals, and M = L D Lᵀ of symmetric 3×3 matrices."""

import numpy as np
import pytest
import taichi as ti

from doo_ti.physics.algebra import factor, factor_in_turn, larger
from doo_ti.physics.number import Number
from tests.physics.columns import ROWS, columns_kernel, every_number

LITERALS = (0.1, 1 / 3, 1e-30, 2.0 / 7.0, 1e-13, -0.3)


@every_number
def test_the_largest_lane_is_that_of_numbers_and_literals_are_exact(rng, number):
    """The default precision of Taichi is f32: a literal in f64 must not pass through it."""
    width, scalar = number.width, number.scalar

    @ti.func
    def spread(v: ti.template()):
        one = number.constant(1.0)
        return (number.constant(number.largest(v[0])), one * scalar(LITERALS[0]), one * scalar(LITERALS[1]),
                one * scalar(LITERALS[2]), one * scalar(LITERALS[3]), one * scalar(LITERALS[4]), one * scalar(LITERALS[5]))

    values = rng.normal(size=(ROWS, 1)).astype(np.float32).astype(float)
    # In every pack one lane stays a number, each in turn.
    nan = rng.random(ROWS) < 0.5
    nan[np.arange(ROWS // width) * width + np.arange(ROWS // width) % width] = False
    values[nan] = np.nan
    found = columns_kernel(number, 1, 7, spread)(values)
    np.testing.assert_array_equal(found[:, 0], np.repeat(np.nanmax(values.reshape(-1, width), axis=1), width))
    exact = np.array(LITERALS, dtype=np.float32 if number.bits == 32 else np.float64)
    assert (np.abs(found[:, 1:] - exact) <= np.spacing(np.abs(exact))).all()


@every_number
def test_the_larger_number_is_nan_where_either_is(number):
    @ti.func
    def function(v: ti.template()):
        return (larger(v[0], v[1]),)

    values = np.tile([[1.0, np.nan], [np.nan, 1.0], [2.0, 1.0], [1.0, 2.0]], (ROWS // 4, 1))
    found = columns_kernel(number, 2, 1, function)(values)[:, 0]
    np.testing.assert_array_equal(found, np.tile([np.nan, np.nan, 2.0, 2.0], ROWS // 4))


UPPER = np.triu_indices(3)


def product(f: np.ndarray) -> np.ndarray:
    """(N, 6) entries of L D Lᵀ for factors (N, 7)."""
    lower = np.tile(np.eye(3), (len(f), 1, 1))
    lower[:, 1, 0], lower[:, 2, 0], lower[:, 2, 1] = f[:, 3:6].T
    return np.einsum("nij,nj,nkj->nik", lower, 1.0 / f[:, :3], lower)[:, *UPPER]


@pytest.mark.parametrize("number", [Number(1, 64), Number(8, 64)], ids=lambda number: f"{number.width} x f{number.bits}")
def test_both_factor_and_only_the_second_keeps_small_pivots(rng, number):
    @ti.func
    def both(v: ti.template()):
        m = (v[0], v[1], v[2], v[3], v[4], v[5])
        return factor(m, 1e-30) + factor_in_turn(m)

    kernel = columns_kernel(number, 6, 14, both)
    matrices = rng.normal(size=(ROWS, 6))
    found = kernel(matrices)
    for own in (found[:, :7], found[:, 7:]):
        np.testing.assert_allclose(product(own), matrices, atol=1e-12)
        full = np.zeros((ROWS, 3, 3))
        full[:, *UPPER] = full.swapaxes(1, 2)[:, *UPPER] = matrices
        np.testing.assert_array_equal(own[:, 6], (np.linalg.eigvalsh(full) < 0).sum(axis=1))
    # A vertex that nothing but a plane holds.
    slippery = np.tile([1e-16, 0.0, 0.0, 1e-16, 0.0, 0.3], (ROWS, 1))
    by_products, in_turn = np.split(kernel(slippery), 2, axis=1)
    np.testing.assert_allclose(in_turn[:, :3], [[1e16, 1e16, 1 / 0.3]] * ROWS, rtol=1e-12)
    assert by_products[0, 2] < 1e-3
