"""Kernels that apply a Taichi function to the columns of a table, for every kind of number."""

import numpy as np
import pytest
import taichi as ti

from doo_ti.physics.number import Number
from tests.vision.device import row_kernel

NUMBERS = [Number(width, bits) for bits in (32, 64) for width in (1, 8, 16)]
ROWS = 48

every_number = pytest.mark.parametrize("number", NUMBERS, ids=lambda number: f"{number.width} x f{number.bits}")


def columns_kernel(number: Number, inputs: int, outputs: int, function):
    """A NumPy function that applies ``function``, from a tuple of ``inputs`` numbers to one of ``outputs``, to its rows."""

    @ti.func
    def alone(scratch: ti.template(), numbers: ti.template(), values: ti.template()):
        return function(scratch)

    run = row_kernel(number, inputs, outputs, alone)
    return lambda rows: run(rows, np.zeros((1, 1, 1)), np.zeros(1))
