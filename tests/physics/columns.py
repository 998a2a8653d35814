"""Kernels that apply a Taichi function to the columns of a table, for every kind of number."""

import numpy as np
import pytest
import taichi as ti

from doo_ti.physics.number import Number
from doo_ti.system import runtime
from tests.vision.device import row_kernel

NUMBERS = [Number(8, 64), Number(16, 32), Number(1, 64), Number(1, 32), Number(8, 32), Number(16, 64)]
"""Those that a CPU runs come first; of these alone a test is in the default tier."""
ROWS = 48


def every_number(test):
    """``test`` for every kind of number."""
    ids = [f"{number.width} x f{number.bits}" for number in NUMBERS]
    return pytest.mark.sampled(2)(pytest.mark.parametrize("number", NUMBERS, ids=ids)(test))


def columns_kernel(number: Number, inputs: int, outputs: int, function):
    """A NumPy function that applies ``function``, from a tuple of ``inputs`` numbers to one of ``outputs``, to its rows."""
    runtime.start()

    @ti.func
    def alone(scratch: ti.template(), numbers: ti.template(), values: ti.template()):
        return function(scratch)

    run = row_kernel(number, inputs, outputs, alone)
    return lambda rows: run(rows, np.zeros((1, 1, 1)), np.zeros(1))
