"""Kernels that apply a Taichi function to the columns of a table, for every kind of number."""

import numpy as np
import pytest
import taichi as ti

from doo_ti.physics.number import Number

NUMBERS = [Number(width, bits) for bits in (32, 64) for width in (1, 8, 16)]
ROWS = 48  # a multiple of every width

every_number = pytest.mark.parametrize("number", NUMBERS, ids=lambda number: f"{number.width} x f{number.bits}")
table = ti.types.ndarray(dtype=ti.f64, ndim=2)


def columns_kernel(number: Number, inputs: int, outputs: int, function):
    """A kernel that applies ``function``, from a tuple of ``inputs`` numbers to a tuple of ``outputs``, to its rows."""
    put, lane = number.lanes().put, number.lanes().lane
    width = number.width
    pack = ti.types.ndarray(dtype=number.type, ndim=1)

    @ti.kernel
    def apply(source: table, scratch: pack, result: table):
        for _ in range(1):
            for group in range(source.shape[0] // width):
                for k in range(inputs):
                    for slot in range(width):
                        put(scratch, k, slot, source[group * width + slot, k])
                values = function(scratch)
                for k in ti.static(range(outputs)):
                    scratch[k] = values[k]
                for k in range(outputs):
                    for slot in range(width):
                        result[group * width + slot, k] = lane(scratch[k], slot)

    def run(values: np.ndarray) -> np.ndarray:
        result = np.zeros((len(values), outputs))
        apply(np.ascontiguousarray(values), ti.ndarray(number.type, max(inputs, outputs)), result)
        return result

    return run
