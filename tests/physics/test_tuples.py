"""What of tuples may be assigned again, on every kind of number. Scratch memory by name: the same numbers for all lanes, for
one lane, by name and by place."""

import numpy as np
import pytest
import taichi as ti

from doo_ti.physics import algebra, tuples
from doo_ti.physics.number import Layout, Number, Scratch, in_f64
from doo_ti.physics.tuples import add, choose
from doo_ti.system import runtime
from tests.physics.columns import ROWS, columns_kernel, every_number


def sampled(rng, number: Number, columns: int) -> np.ndarray:
    """(ROWS, columns) of about one, exact in ``number``."""
    values = rng.uniform(-1, 1, (ROWS, columns))
    return values.astype(np.float32).astype(np.float64) if number.bits == 32 else values


@every_number
def test_a_variable_takes_its_own_items_in_another_order(rng, number):
    """All are read before the first is changed, written out or by a function of the algebra, and in loops."""
    runtime.start()

    @ti.func
    def function(v: ti.template()):
        a = tuples.variable((v[0], v[1], v[2]))
        b = tuples.variable((v[0], v[1], v[2]))
        m = tuples.variable((v[0], v[1], v[2], v[3], v[4], v[5], v[6], v[7], v[8]))
        for _ in range(2):
            a = (a[1], a[2], a[0])
            b = tuples.plus((b[1], b[2], b[0]), b)
        m = algebra.transposed(m)
        c = tuples.variable((v[0], v[1], v[2]))
        c = tuples.itemwise(c[0] + c[0], c[1], 3.0 * c[2])
        return a + b + m + c

    x = sampled(rng, number, 9)
    turned = x[:, :3] + x[:, [1, 2, 0]]
    expected = np.hstack([x[:, [2, 0, 1]], turned + turned[:, [1, 2, 0]], x[:, [0, 3, 6, 1, 4, 7, 2, 5, 8]],
                          x[:, :3] * [2, 1, 3]])
    rounding = np.finfo(np.float32 if number.bits == 32 else np.float64).eps
    np.testing.assert_allclose(columns_kernel(number, 9, 18, function)(x), expected, rtol=0, atol=4 * rounding)


@every_number
def test_values_stay_when_what_they_came_from_changes(rng, number):
    """What a function returned is computed in its place; a second name of a variable is no copy, ``variable`` makes one."""
    runtime.start()

    @ti.func
    def function(v: ti.template()):
        a = tuples.variable((v[0], v[1], v[2]))
        same, copy = a, tuples.variable(a)
        double = tuples.plus(a, a)
        squared = tuples.dot(a, a)
        a = tuples.negated(a)
        return same + copy + double + (squared,)

    x = sampled(rng, number, 3)
    found = columns_kernel(number, 3, 10, function)(x)
    np.testing.assert_array_equal(found[:, :9], np.hstack([-x, x, 2 * x]))
    np.testing.assert_allclose(found[:, 9], (x**2).sum(axis=1), rtol=1e-6)


@every_number
def test_a_function_changes_the_record_it_is_given(rng, number):
    """Numbers, tuples and arrays by name, through functions and loops; the array is the kernel's own."""
    runtime.start()

    @ti.func
    def take(state):
        state.total = state.total + state.place[0] * state.source[1]
        state.place = (state.place[1], state.place[2], state.place[0])

    @ti.func
    def function(v: ti.template()):
        state = tuples.record(total=0.0 * v[0], place=(v[0], v[1], v[2]))
        longer = tuples.extended(state, source=v)
        for _ in range(3):
            take(longer)
        return (state.total,) + state.place

    x = sampled(rng, number, 3)
    found = columns_kernel(number, 3, 4, function)(x)
    np.testing.assert_array_equal(found[:, 1:], x)
    np.testing.assert_allclose(found[:, 0], x.sum(axis=1) * x[:, 1], atol=1e-6)


@every_number
def test_fields_are_assigned_by_name(rng, number):
    """Where a condition holds, and in one lane; the others keep their values."""
    runtime.start()
    with_lane = number.lanes().with_lane

    @ti.func
    def function(v: ti.template()):
        state = tuples.record(total=v[0], kept=v[1], place=(v[0], v[1], v[2]))
        tuples.choose(state, v[2] > 0.0, total=v[1], kept=v[0] + v[1])
        tuples.put_lane(state, with_lane, 0, kept=7.0, place=(1.0, 2.0, 3.0))
        return (state.total, state.kept) + state.place

    x = sampled(rng, number, 3)
    first, yes = np.arange(ROWS) % number.width == 0, x[:, 2] > 0
    kept = np.where(first, 7.0, np.where(yes, x[:, 0] + x[:, 1], x[:, 1]))
    place = np.where(first[:, None], [1.0, 2.0, 3.0], x)
    expected = np.column_stack([np.where(yes, x[:, 1], x[:, 0]), kept, place])
    np.testing.assert_allclose(columns_kernel(number, 3, 5, function)(x), expected, rtol=1e-6)


def test_a_variable_takes_as_many_numbers_as_it_has():
    runtime.start()

    @ti.func
    def function(v: ti.template()):
        a = tuples.variable((v[0], v[1], v[2]))
        a = (v[0], v[1])
        return a

    with pytest.raises(Exception, match="2 numbers for a variable of 3"):
        columns_kernel(Number(1, 64), 3, 3, function)(np.zeros((ROWS, 3)))


PAIR = Layout(first=2, second=2)
ROD = Layout(length=1, place=3, pair=PAIR, both=("length", 4))
EDGES = 3


def test_layouts_say_where_numbers_are():
    assert (len(PAIR), len(ROD), ROD.at("place"), ROD.at("pair"), ROD.at("both")) == (4, 8, 1, 4, 0)
    joined = PAIR + Layout(third=2, fourth=("third", 1))
    assert (len(joined), joined.at("third"), joined.at("fourth")) == (6, 4, 4)


@pytest.mark.parametrize("stride", [1, 4])
@pytest.mark.parametrize("number", [Number(1, 64), Number(8, 64), Number(16, 32)], ids=str)
def test_numbers_are_read_and_written_by_name(number, stride):
    runtime.start()
    memory, width = Scratch(number, stride), number.width

    @ti.kernel
    def work(array: ti.types.ndarray(dtype=number.type, ndim=1), seen: ti.types.ndarray(dtype=ti.f64, ndim=1)):
        for thread in range(1):
            head = memory.of_thread(array, thread, ROD, EDGES * ROD.size)
            for e in range(EDGES):
                edge = head.part(ROD, e * ROD.size)
                for slot in range(width):
                    lane = edge.lane(slot)
                    lane.length, lane.place = 1.0 + e, (2.0, 3.0 + e, 4.0)
                    lane[4], lane.pair.first[1], lane.pair.second = 5.0, 6.0, (7.0, 8.0)
                edge.pair.first = edge.pair.second  # what is on the right is read first
                add(edge, length=0.0 * edge.length + 10.0, place=edge.place)
                choose(edge.pair, edge.length > 11.5, second=edge.pair.first)
                before = edge.place
                edge.place = (before[2], before[0], before[1])
            last = head.part(ROD, (EDGES - 1) * ROD.size).lane(width - 1)
            for k in range(ROD.size):
                seen[k] = last[k]
            place = in_f64(last.place)
            for k in ti.static(range(3)):
                seen[ROD.size + k] = place[k]

    array = ti.ndarray(number.type, EDGES * len(ROD) * stride)
    seen = np.zeros(len(ROD) + 3)
    work(array, seen)
    assert seen.tolist() == [13.0, 8.0, 4.0, 10.0, 7.0, 8.0, 7.0, 8.0, 8.0, 4.0, 10.0]
