"""Rest curvature and twist that a joint has for a time step, besides the material's: what damping draws it towards
(docs/dynamics.md)."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from doo_ti.relaxation.external import ExternalFunctions, Nothing

LEFT, RIGHT, TWIST, JOINT_ITEMS = 0, 2, 4, 5
"""u̅ of the left frame and of the right one, and m̅ (:mod:`doo_ti.physics.pair`)."""


@dataclass(frozen=True)
class JointRest(Nothing):
    """The numbers of the joints where edges begin, in the place that an external energy has: no energy by themselves.

    rest  (1 or N, E, JOINT_ITEMS)
    """

    rest: np.ndarray
    items: ClassVar[int] = JOINT_ITEMS

    def numbers(self) -> np.ndarray:
        return self.rest

    @staticmethod
    def functions(number, stride: int, first: int) -> ExternalFunctions:
        import taichi as ti

        put = number.lanes().put

        @ti.func
        def load(scratch: ti.template(), at, slot, numbers: ti.template(), row, edge, scale):
            for k in ti.static(range(JOINT_ITEMS)):
                put(scratch, at + (first + k) * stride, slot, numbers[row, edge, k])

        return Nothing.functions(number, stride, first)._replace(load=load)
