"""Taichi functions of numbers per rod run over rows of a table, a lane per row."""

from functools import cache

import numpy as np
import pytest
import taichi as ti

from doo_ti.physics.number import Number, Scratch
from doo_ti.system import runtime

NUMBERS = [Number(1, 64), Number(8, 64), Number(1, 32), Number(16, 32)]
every_number = pytest.mark.parametrize("number", NUMBERS, ids=lambda number: f"{number.width} x f{number.bits}")
table = ti.types.ndarray(dtype=ti.f64, ndim=2)


def row_kernel(number: Number, inputs: int, outputs: int, function):
    """A NumPy function (rows (N, inputs), numbers (A, C, K), values (M,)) -> (N, outputs) float64.

    ``function`` (scratch, numbers, values) reads its inputs from scratch, each a number per rod, and returns ``outputs`` of
    them. Rows are repeated to fill the lanes.
    """
    lane, with_lane, width = number.lane, number.with_lane, number.width

    @ti.kernel
    def apply(
        source: table, scratch: ti.types.ndarray(dtype=number.type, ndim=1), numbers: ti.types.ndarray(dtype=ti.f64, ndim=3),
        values: ti.types.ndarray(dtype=ti.f32, ndim=1), result: table):
        for _ in range(1):
            for group in range(source.shape[0] // width):
                for k in range(inputs):
                    for slot in range(width):
                        scratch[k] = with_lane(scratch[k], slot, source[group * width + slot, k])
                found = function(scratch, numbers, values)
                for k in ti.static(range(outputs)):
                    scratch[k] = found[k]
                for k in range(outputs):
                    for slot in range(width):
                        result[group * width + slot, k] = lane(scratch[k], slot)

    def run(rows: np.ndarray, numbers: np.ndarray, values: np.ndarray) -> np.ndarray:
        runtime.start()
        filled = np.resize(rows, (-(-len(rows) // width) * width, inputs)).astype(np.float64)
        result = np.zeros((len(filled), outputs))
        scratch = ti.ndarray(number.type, max(inputs, outputs))
        apply(filled, scratch, np.ascontiguousarray(numbers, dtype=np.float64), np.ascontiguousarray(values, dtype=np.float32),
              result)
        return result[: len(rows)]

    return run


@cache
def edge_kernel(number: Number, external: type):
    """As :func:`row_kernel`: the own numbers of an external energy's edge, its start and end, and whether coarse, to the energy
    and its moments, 1, 3, 3, 6, 9 and 6 numbers."""
    functions, memory, size = external.functions(number), Scratch(number, 1), external.layout.size

    @ti.func
    def function(scratch: ti.template(), numbers: ti.template(), values: ti.template()):
        own = memory.view(scratch, 0, external.layout)
        start = (scratch[size], scratch[size + 1], scratch[size + 2])
        end = (scratch[size + 3], scratch[size + 4], scratch[size + 5])
        e, g, h, k, n, m = functions.evaluate(own, numbers, values, start, end, scratch[size + 6])
        return (e,) + g + h + k + n + m

    return row_kernel(number, size + 7, 28, function)
