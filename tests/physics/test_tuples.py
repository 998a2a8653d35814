"""What of tuples may be assigned again, on every kind of number; scratch memory by name and by place."""

import numpy as np
import pytest
import taichi as ti

from doo_ti.physics import algebra, tuples
from doo_ti.physics.number import Layout, Number, Scratch, in_f64
from doo_ti.physics.tuples import add, choose
from doo_ti.system import runtime
from tests.physics.columns import ROWS, columns_kernel, every_number


@every_number
def test_a_variable_takes_its_own_items_in_another_order(rng, number):
    """All are read before the first is changed, written out or by a function of the algebra, and in loops."""
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

    x = rng.uniform(-1, 1, (ROWS, 9)).astype(np.float32).astype(np.float64)
    turned = x[:, :3] + x[:, [1, 2, 0]]
    expected = np.hstack([x[:, [2, 0, 1]], turned + turned[:, [1, 2, 0]], x[:, [0, 3, 6, 1, 4, 7, 2, 5, 8]],
                          x[:, :3] * [2, 1, 3]])
    rounding = np.finfo(np.float32 if number.bits == 32 else np.float64).eps
    np.testing.assert_allclose(columns_kernel(number, 9, 18, function)(x), expected, rtol=0, atol=4 * rounding)


PAIR = Layout(first=2, second=2)
ROD = Layout(length=1, place=3, pair=PAIR, both=("length", 4))
EDGES = 3


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
