"""Every operation the kernels use on a number per rod: an operation that packs lack aborts the whole process.

For every kind of number, checked to the last bit against NumPy in the same precision.

M = L D Lᵀ of symmetric 3×3 matrices, by products and pivot by pivot.
"""

import numpy as np
import pytest
import taichi as ti

from doo_ti.physics import algebra, quaternion, tuples
from doo_ti.physics.factors import factor, factor_in_turn
from doo_ti.physics.number import Number
from doo_ti.system import runtime
from tests.physics.columns import ROWS, columns_kernel, every_number
from tests.vision.device import table


def applied(number: Number, function, outputs: int, values: np.ndarray) -> np.ndarray:
    """(ROWS, outputs) of a Taichi function from the numbers of a row to a tuple."""
    runtime.start()
    inputs = values.shape[1]

    @ti.func
    def row(v: ti.template()):
        if ti.static(inputs == 1):
            return function(v[0])
        elif ti.static(inputs == 2):
            return function(v[0], v[1])
        else:
            return function(v[0], v[1], v[2])

    return columns_kernel(number, inputs, outputs, row)(values)


def sampled(rng, number: Number, columns: int) -> np.ndarray:
    """(ROWS, columns) numbers of either sign and of many sizes, some equal across columns, exact in ``number``."""
    values = rng.choice([-1.0, 1.0], (ROWS, columns)) * 10.0 ** rng.uniform(-6, 6, (ROWS, columns))
    values[::5] = values[::5, :1]
    return of_number(number, values)


def of_number(number: Number, values) -> np.ndarray:
    """The nearest numbers that ``number`` holds."""
    return np.asarray(values, dtype=np.float32 if number.bits == 32 else np.float64).astype(np.float64)


def in_precision(number: Number, values: np.ndarray) -> list[np.ndarray]:
    return list(values.T.astype(np.float32 if number.bits == 32 else np.float64))


@ti.func
def of_whole_number(a):
    """A loop index enters arithmetic with packs as it does in the elimination's noise."""
    result = 0.0 * a
    for e in range(3):
        result = result + a * ((5 * e + 2) % 7 - 2.5)
    return result


@ti.func
def reassigned(a, b):
    """Packs have no ``-=``; tuples take turns instead."""
    x, y = (a, b)
    for _ in range(3):
        x, y = (y, x - y)
    return x


@ti.func
def arithmetic(a, b):
    return (0.0 - a, 1.0 / a, ti.sqrt(algebra.absolute(a)), ti.floor(a), of_whole_number(a), a + b, a - b, a * b, a / b,
            ti.min(a, b), ti.max(a, b), reassigned(a, b))


@ti.func
def conditions(a, b):
    """Chosen by and, or, and of or, ==, !=, not, and with the negation of a kept condition, by a sum of flags as the acceptance
    test of Newton does."""
    zero, one = 0.0 * a, 0.0 * a + 1.0
    kept = (a < b) & (b > 0.0)
    first, second = ti.select(a > b, one, 0.0 * b), ti.select(b > 0.0, one, 0.0 * b)
    return (ti.select((a > 0.0) & (a <= b), a, b), ti.select((a < b) | (a >= 1.0), a, zero),
            ti.select(((a > 0.0) & (b > 0.0)) | ((a < 0.0) & (b < 0.0)), one, zero), ti.select(a == b, a + 1.0, b),
            ti.select(a != b, a + 1.0, b), ti.select(~(a > b), a, b),
            ti.select((a > 0.0) & ~kept & (b == b), a, 0.0 * b - 3.0),
            ti.select((first + second > 0.5) & (a == a), first - second, 0.0 * b + 7.0))


def numpy_arithmetic(a, b) -> list:
    half = a.dtype.type(0.5)
    return [-a, 1 / a, np.sqrt(np.abs(a)), np.floor(a), -a * half - 5 * a * half + 5 * a * half, a + b, a - b, a * b, a / b,
            np.minimum(a, b), np.maximum(a, b), b - (a - b)]


def numpy_conditions(a, b) -> list:
    flags = (a > b).astype(a.dtype) - (b > 0)
    return [np.where((a > 0) & (a <= b), a, b), np.where((a < b) | (a >= 1), a, 0 * a), np.sign(a) * np.sign(b) > 0,
            np.where(a == b, a + 1, b), np.where(a != b, a + 1, b), np.where(~(a > b), a, b),
            np.where((a > 0) & ~((a < b) & (b > 0)), a, -3), np.where((a > b) | (b > 0), flags, 7)]


@pytest.mark.parametrize(("functions", "expected"), [(arithmetic, numpy_arithmetic), (conditions, numpy_conditions)],
                         ids=["arithmetic", "conditions"])
@every_number
def test_operations_are_numpys_to_the_last_bit(rng, number, functions, expected):
    values = sampled(rng, number, 2)
    reference = np.stack(expected(*in_precision(number, values)), axis=1)
    np.testing.assert_array_equal(applied(number, functions, reference.shape[1], values), reference)


@ti.func
def through_functions(a, b, c):
    """Tuples in, tuples out, taken apart, through two functions."""
    x, y, z = tuples.cross((a, b, c), (b, c, a))
    largest = algebra.largest_of(algebra.absolute(a), algebra.largest_of(algebra.absolute(b), algebra.absolute(c)))
    return (tuples.dot((x, y, z), (c, a, b)), largest)


@every_number
def test_tuples_pass_through_functions(rng, number):
    values = sampled(rng, number, 3) / 1e3
    a, b, c = parts = in_precision(number, values)
    found = applied(number, through_functions, 2, values)
    np.testing.assert_array_equal(found[:, 0], (b * a - c * c) * c + (c * b - a * a) * a + (a * c - b * b) * b)
    np.testing.assert_array_equal(found[:, 1], np.abs(parts).max(axis=0))


@ti.func
def with_nan(a, b):
    return (algebra.larger(a, b), ti.select(a != a, 0.0 * a + 1.0, 0.0), ti.select(~(a == a), 1.0, 0.0 * a))


@every_number
def test_nan_is_detected(number):
    """The kernels rely on ``a == a``, on ``larger`` passing NaN on, and NaN comparing false, by ``!=`` too."""
    nan = np.nan
    values = np.tile([[1.0, nan], [nan, 1.0], [nan, nan], [2.0, 1.0], [1.0, 2.0], [-1.0, nan]], (ROWS // 6, 1))
    larger, unequal, not_equal = applied(number, with_nan, 3, values).T
    np.testing.assert_array_equal(np.isnan(larger), np.isnan(values).any(axis=1))
    np.testing.assert_array_equal(larger[3::6], 2.0)
    np.testing.assert_array_equal(larger[4::6], 2.0)
    np.testing.assert_array_equal(unequal, 0.0)
    np.testing.assert_array_equal(not_equal, np.isnan(values[:, 0]))
    found = applied(number, conditions, 8, values)[1::6]
    np.testing.assert_array_equal(found[:, [0, 7]], [[1.0, 7.0]] * len(found))


@every_number
def test_lanes_are_read_written_and_compared_one_by_one(rng, number):
    runtime.start()
    largest, lane, with_lane, constant, gather = number.lanes()
    width = number.width

    @ti.kernel
    def shuffle(source: table, flat: ti.types.ndarray(dtype=ti.f64, ndim=1),
                scratch: ti.types.ndarray(dtype=number.type, ndim=1), result: table):
        for group in range(source.shape[0] // width):
            for slot in range(width):
                scratch[group] = with_lane(scratch[group], slot, source[group * width + slot, 0])
            value = scratch[group]
            backwards = gather(flat, [group * width + (width - 1 - slot) for slot in ti.static(range(width))])
            flags = constant(0.0)
            for slot in range(width):
                # The lane's own number comes out doubled, whatever its neighbours hold.
                value = with_lane(value, slot, 2.0 * lane(value, slot))
                if lane(value, slot) > 0.0:
                    flags = with_lane(flags, slot, 1.0)
            for slot in range(width):
                result[group * width + slot, 0] = lane(value, slot)
                result[group * width + slot, 1] = largest(flags)
                result[group * width + slot, 2] = lane(backwards, slot)

    values = sampled(rng, number, 1)
    result, scratch = np.zeros((ROWS, 3)), ti.ndarray(number.type, ROWS // width)
    shuffle(values, values[:, 0].copy(), scratch, result)
    np.testing.assert_array_equal(result[:, 0], 2 * values[:, 0])
    positive = (values[:, 0] > 0).reshape(-1, width).any(axis=1)
    np.testing.assert_array_equal(result[:, 1], np.repeat(positive, width))
    np.testing.assert_array_equal(result[:, 2], values[:, 0].reshape(-1, width)[:, ::-1].ravel())


LITERALS = (0.1, 1 / 3, 1e-30, 2.0 / 7.0, 1e-13, -0.3)


@every_number
def test_the_largest_lane_is_that_of_numbers_and_literals_are_exact(rng, number):
    """The default precision of Taichi is f32: a literal in f64 must not pass through it."""
    lanes, width, scalar = number.lanes(), number.width, number.scalar

    @ti.func
    def spread(a):
        one = lanes.constant(1.0)
        return (lanes.constant(lanes.largest(a)), one * scalar(LITERALS[0]), one * scalar(LITERALS[1]),
                one * scalar(LITERALS[2]), one * scalar(LITERALS[3]), one * scalar(LITERALS[4]), one * scalar(LITERALS[5]))

    values = sampled(rng, number, 1)
    # In every pack one lane stays a number, each in turn.
    nan = rng.random(ROWS) < 0.5
    nan[np.arange(ROWS // width) * width + np.arange(ROWS // width) % width] = False
    values[nan] = np.nan
    found = applied(number, spread, 7, values)
    np.testing.assert_array_equal(found[:, 0], np.repeat(np.nanmax(values.reshape(-1, width), axis=1), width))
    exact = np.array(LITERALS, dtype=np.float32 if number.bits == 32 else np.float64)
    assert (np.abs(found[:, 1:] - exact) <= np.spacing(np.abs(exact))).all()


@every_number
def test_angles(rng, number):
    """Arc tangent; m = 2 atan2(q1, q0) for q0 >= 0: all around the circle and next to its ends."""
    functions = quaternion.arctangent_function(number), quaternion.twist_angle_function(number)

    @ti.func
    def every(a, b):
        arctangent, twist_angle = ti.static(functions)
        return (arctangent(b), twist_angle((a, b)))

    near = 10.0 ** -rng.uniform(1, 8, ROWS)
    half = np.concatenate([rng.uniform(-np.pi / 2, np.pi / 2, ROWS), np.pi / 2 - near, near - np.pi / 2, near])
    cosine = of_number(number, [np.cos(half), np.sin(half)])
    rounding = 3e-7 if number.bits == 32 else 2e-15
    for name, values, column, expected, times in (
        ("atan", np.stack([cosine[0], cosine[1]], axis=1), 0, np.arctan(cosine[1]), 1),
        ("twist", of_number(number, rng.uniform(0.1, 1, len(half)) * cosine).T, 1, None, 4),
    ):
        expected = 2 * np.arctan2(values[:, 1], values[:, 0]) if expected is None else expected
        error = np.abs(applied(number, every, 2, values)[:, column] - expected).max()
        print(f"{name}, {number}: largest error {error:.1e} rad")
        assert error <= times * rounding


UPPER = np.triu_indices(3)


def product(f: np.ndarray) -> np.ndarray:
    """(N, 6) entries of L D Lᵀ for factors (N, 7)."""
    lower = np.tile(np.eye(3), (len(f), 1, 1))
    lower[:, 1, 0], lower[:, 2, 0], lower[:, 2, 1] = f[:, 3:6].T
    return np.einsum("nij,nj,nkj->nik", lower, 1.0 / f[:, :3], lower)[:, *UPPER]


@pytest.mark.parametrize("number", [Number(1, 64), Number(8, 64)], ids=lambda number: f"{number.width} x f{number.bits}")
def test_both_factor_and_only_the_second_keeps_small_pivots(rng, number):
    runtime.start()

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
