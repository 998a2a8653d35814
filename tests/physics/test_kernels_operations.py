"""Every operation the kernels use on a number per rod, alone: an operation that packs lack aborts the whole process.

One kernel per operation and kind of number, checked to the last bit against NumPy in the same precision.
"""

import numpy as np
import pytest
import taichi as ti

from doo_ti.physics import algebra, angle, tuples
from doo_ti.physics.number import Number
from doo_ti.system import runtime
from tests.physics.columns import ROWS, every_number, table


def lanes_kernel(number: Number, inputs: int, function):
    """A kernel that applies ``function`` (a Taichi function) to ``inputs`` columns of its rows, a lane per row."""
    largest, lane, with_lane, constant, put, get, gather = number.lanes()
    width = number.width

    @ti.kernel
    def apply(source: table, result: table):
        for group in range(source.shape[0] // width):
            a, b, c = (constant(0.0), constant(0.0), constant(0.0))
            for slot in range(width):
                a = with_lane(a, slot, source[group * width + slot, 0])
                if ti.static(inputs > 1):
                    b = with_lane(b, slot, source[group * width + slot, 1])
                if ti.static(inputs > 2):
                    c = with_lane(c, slot, source[group * width + slot, 2])
            value = constant(0.0)
            if ti.static(inputs == 1):
                value = function(a)
            elif ti.static(inputs == 2):
                value = function(a, b)
            else:
                value = function(a, b, c)
            for slot in range(width):
                result[group * width + slot, 0] = lane(value, slot)

    return apply


@ti.func
def zero_minus(a):
    return 0.0 - a


@ti.func
def divided_by_literal(a):
    return 1.0 / a


@ti.func
def plus(a, b):
    return a + b


@ti.func
def minus(a, b):
    return a - b


@ti.func
def times(a, b):
    return a * b


@ti.func
def over(a, b):
    return a / b


@ti.func
def root(a):
    return ti.sqrt(algebra.absolute(a))


@ti.func
def floor(a):
    return ti.floor(a)


@ti.func
def smallest(a, b):
    return ti.min(a, b)


@ti.func
def greatest(a, b):
    return ti.max(a, b)


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
def within(a, b):
    return ti.select((a > 0.0) & (a <= b), a, b)


@ti.func
def outside(a, b):
    return ti.select((a < b) | (a >= 1.0), a, 0.0 * a)


@ti.func
def neither(a, b):
    one = 0.0 * a + 1.0
    return ti.select(((a > 0.0) & (b > 0.0)) | ((a < 0.0) & (b < 0.0)), one, 0.0 * a)


@ti.func
def same(a, b):
    return ti.select(a == b, a + 1.0, b)


@ti.func
def different(a, b):
    return ti.select(a != b, a + 1.0, b)


@ti.func
def negated(a, b):
    return ti.select(~(a > b), a, b)


@ti.func
def and_not(a, b):
    """A condition and the negation of a kept one, as Newton asks whether it is leaving a saddle."""
    kept = (a < b) & (b > 0.0)
    return ti.select((a > 0.0) & ~kept & (b == b), a, 0.0 * b - 3.0)


@ti.func
def flag_sum(a, b):
    """Flags added, and one condition taken from the sum, as the acceptance test of Newton does."""
    one = 0.0 * b + 1.0
    first = ti.select(a > b, one, 0.0 * b)
    second = ti.select(b > 0.0, one, 0.0 * b)
    return ti.select((first + second > 0.5) & (a == a), first - second, 0.0 * b + 7.0)


UNARY = {
    "0 - a": (zero_minus, lambda a: -a),
    "1 / a": (divided_by_literal, lambda a: 1 / a),
    "sqrt |a|": (root, lambda a: np.sqrt(np.abs(a))),
    "floor": (floor, np.floor),
    "loop index": (of_whole_number, lambda a: a * a.dtype.type(-0.5) + a * a.dtype.type(-2.5) + a * a.dtype.type(2.5)),
}
BINARY = {
    "a + b": (plus, np.add),
    "a - b": (minus, np.subtract),
    "a * b": (times, np.multiply),
    "a / b": (over, np.divide),
    "min": (smallest, np.minimum),
    "max": (greatest, np.maximum),
    "reassigned": (reassigned, lambda a, b: b - (a - b)),
    "select and": (within, lambda a, b: np.where((a > 0) & (a <= b), a, b)),
    "select or": (outside, lambda a, b: np.where((a < b) | (a >= 1), a, 0 * a)),
    "select and or and": (neither, lambda a, b: (np.sign(a) * np.sign(b) > 0).astype(a.dtype)),
    "==": (same, lambda a, b: np.where(a == b, a + 1, b)),
    "!=": (different, lambda a, b: np.where(a != b, a + 1, b)),
    "not": (negated, lambda a, b: np.where(~(a > b), a, b)),
    "and not": (and_not, lambda a, b: np.where((a > 0) & ~((a < b) & (b > 0)), a, a.dtype.type(-3))),
    "sum of flags": (
        flag_sum, lambda a, b: np.where((a > b) | (b > 0), (a > b).astype(a.dtype) - (b > 0), a.dtype.type(7))),
}


def sampled(rng, number: Number, columns: int) -> np.ndarray:
    """(ROWS, columns) numbers of either sign and of many sizes, some equal across columns, exact in ``number``."""
    values = rng.choice([-1.0, 1.0], (ROWS, columns)) * 10.0 ** rng.uniform(-6, 6, (ROWS, columns))
    values[::5] = values[::5, :1]
    return values.astype(np.float32).astype(np.float64) if number.bits == 32 else values


def applied(number: Number, function, values: np.ndarray) -> np.ndarray:
    result = np.zeros((len(values), 1))
    lanes_kernel(number, values.shape[1], function)(values, result)
    return result[:, 0]


def in_precision(number: Number, values: np.ndarray) -> list[np.ndarray]:
    return list(values.T.astype(np.float32 if number.bits == 32 else np.float64))


@every_number
@pytest.mark.parametrize("operation", [*UNARY, *BINARY])
def test_operation_is_numpys_to_the_last_bit(rng, number, operation):
    runtime.start()
    function, reference = {**UNARY, **BINARY}[operation]
    values = sampled(rng, number, 1 if operation in UNARY else 2)
    np.testing.assert_array_equal(applied(number, function, values), reference(*in_precision(number, values)))


@ti.func
def unequal_to_itself(a, b):
    return ti.select(a != a, 0.0 * a + 1.0, 0.0)


@ti.func
def not_equal_to_itself(a, b):
    return ti.select(~(a == a), 1.0, 0.0 * a)


@ti.func
def larger(a, b):
    return algebra.larger(a, b)


@ti.func
def largest_of_three(a, b, c):
    return algebra.largest_of(algebra.absolute(a), algebra.largest_of(algebra.absolute(b), algebra.absolute(c)))


@ti.func
def crossed(a, b, c):
    """Tuples in, tuples out, taken apart, through two functions."""
    x, y, z = tuples.cross((a, b, c), (b, c, a))
    return tuples.dot((x, y, z), (c, a, b))


@every_number
def test_tuples_pass_through_functions(rng, number):
    runtime.start()
    values = sampled(rng, number, 3) / 1e3
    a, b, c = parts = in_precision(number, values)
    np.testing.assert_array_equal(applied(number, largest_of_three, values), np.abs(parts).max(axis=0))
    np.testing.assert_array_equal(
        applied(number, crossed, values), (b * a - c * c) * c + (c * b - a * a) * a + (a * c - b * b) * b)


@pytest.mark.sampled(4)
@every_number
def test_nan_is_detected(number):
    """The kernels rely on ``a == a``, on ``larger`` passing NaN on, and NaN comparing false, by ``!=`` too."""
    runtime.start()
    nan = np.nan
    values = np.tile([[1.0, nan], [nan, 1.0], [nan, nan], [2.0, 1.0], [1.0, 2.0], [-1.0, nan]], (ROWS // 6, 1))
    seen = applied(number, larger, values)
    np.testing.assert_array_equal(np.isnan(seen), np.isnan(values).any(axis=1))
    np.testing.assert_array_equal(seen[3::6], 2.0)
    np.testing.assert_array_equal(seen[4::6], 2.0)
    np.testing.assert_array_equal(applied(number, within, values)[1::6], 1.0)
    np.testing.assert_array_equal(applied(number, unequal_to_itself, values), 0.0)
    np.testing.assert_array_equal(applied(number, not_equal_to_itself, values), np.isnan(values[:, 0]))
    np.testing.assert_array_equal(applied(number, flag_sum, values)[1::6], 7.0)


@every_number
def test_lanes_are_read_written_and_compared_one_by_one(rng, number):
    runtime.start()
    largest, lane, with_lane, constant, put, get, gather = number.lanes()
    width = number.width

    @ti.kernel
    def shuffle(source: table, flat: ti.types.ndarray(dtype=ti.f64, ndim=1),
                scratch: ti.types.ndarray(dtype=number.type, ndim=1), result: table):
        for group in range(source.shape[0] // width):
            for slot in range(width):
                put(scratch, group, slot, source[group * width + slot, 0])
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


@every_number
def test_the_largest_lane_is_that_of_the_lanes_which_are_numbers(rng, number):
    runtime.start()
    lanes, width = number.lanes(), number.width

    @ti.func
    def spread(a):
        return lanes.constant(lanes.largest(a))

    values = sampled(rng, number, 1)
    # In every pack one lane stays a number, each in turn.
    nan = rng.random(ROWS) < 0.5
    nan[np.arange(ROWS // width) * width + np.arange(ROWS // width) % width] = False
    values[nan] = np.nan
    largest = np.nanmax(values.reshape(-1, width), axis=1)
    np.testing.assert_array_equal(applied(number, spread, values), np.repeat(largest, width))


LITERALS = (0.1, 1 / 3, 1e-30, 0.7, 2.0 / 7.0, 1e-13, -0.3)


@every_number
def test_literals_are_exact_to_one_unit_in_the_last_place(number):
    """The default precision of Taichi is f32: a literal in f64 must not pass through it."""
    runtime.start()
    largest, lane, with_lane, constant, put, get, gather = number.lanes()
    width, scalar = number.width, number.scalar

    @ti.kernel
    def fill(result: table):
        for _ in range(1):
            for k in ti.static(range(len(LITERALS))):
                value = constant(1.0) * scalar(LITERALS[k])
                for slot in range(width):
                    result[slot, k] = lane(value, slot)

    result = np.zeros((width, len(LITERALS)))
    fill(result)
    exact = np.array(LITERALS, dtype=np.float32 if number.bits == 32 else np.float64)
    units = np.abs(result - exact) / np.spacing(np.abs(exact))
    print(f"literals, {number}: at most {units.max():.2g} units in the last place")
    assert units.max() <= 1


def rounding(number: Number) -> float:
    """Required accuracy of the angles, rad."""
    return 3e-7 if number.bits == 32 else 2e-15


def of_number(number: Number, values) -> np.ndarray:
    """The nearest numbers that ``number`` holds."""
    return np.asarray(values, dtype=np.float32 if number.bits == 32 else np.float64).astype(np.float64)


def largest_error(number: Number, name: str, function, arguments: np.ndarray, expected: np.ndarray) -> float:
    error = np.abs(applied(number, function, arguments) - expected).max()
    print(f"{name}, {number}: largest error {error:.1e} rad")
    return error


@every_number
def test_arctangent(number):
    runtime.start()
    arctangent = angle.arctangent_function(number)

    @ti.func
    def function(a):
        return arctangent(a)

    slope = of_number(number, np.linspace(-1, 1, 10 * ROWS))
    error = largest_error(number, "atan t", function, slope[:, None], np.arctan(slope))
    assert error <= rounding(number)


@every_number
def test_twist_angle(rng, number):
    """m = 2 atan2(q1, q0) for q0 >= 0, all around the circle and next to its ends."""
    runtime.start()
    twist_angle = angle.twist_angle_function(number)

    @ti.func
    def function(a, b):
        return twist_angle((a, b))

    near = 10.0 ** -rng.uniform(1, 8, ROWS)
    half = np.concatenate([rng.uniform(-np.pi / 2, np.pi / 2, ROWS), np.pi / 2 - near, near - np.pi / 2, near])
    q = of_number(number, rng.uniform(0.1, 1, len(half)) * [np.cos(half), np.sin(half)]).T
    expected = 2 * np.arctan2(q[:, 1], q[:, 0])
    error = largest_error(number, "twist", function, q, expected)
    assert error <= 4 * rounding(number)


def check_signed_angle(number: Number, name: str, angles: np.ndarray) -> None:
    """The angle of a cosine and a sine, each rounded on its own: the smaller of them knows it."""
    runtime.start()
    signed_angle = angle.signed_angle_function(number)

    @ti.func
    def function(a, b):
        return signed_angle(a, b)

    values = of_number(number, np.stack([np.cos(angles), np.sin(angles)], axis=1))
    error = largest_error(number, name, function, values, np.arctan2(values[:, 1], values[:, 0]))
    assert error <= 10 * rounding(number)


@every_number
def test_signed_angle(rng, number):
    check_signed_angle(number, "signed angle", rng.uniform(-3, 3, 2 * ROWS))


@every_number
def test_signed_angle_near_a_half_turn(rng, number):
    away = 10.0 ** -rng.uniform(1, 8, ROWS)
    check_signed_angle(number, "signed angle near a half turn", np.concatenate([np.pi - away, away - np.pi]))
