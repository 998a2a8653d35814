"""Scratch memory by name: the same numbers for all lanes, for one lane, by name and by place."""

import numpy as np
import pytest
import taichi as ti

from doo_ti.physics.number import Number
from doo_ti.physics.tuples import add, choose
from doo_ti.physics.view import Layout, Scratch, in_f64
from doo_ti.system import runtime

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
