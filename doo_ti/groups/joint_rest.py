"""Rest curvature and twist that a joint has for a time step, besides the material's: what damping draws it towards
(docs/dynamics.md)."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from doo_ti.physics.view import Layout
from doo_ti.relaxation.external import ExternalFunctions, Nothing

JOINT = Layout(left=2, right=2, twist=1)
"""u̅ of the left frame and of the right one, and m̅ (:mod:`doo_ti.physics.pair`)."""
TWIST, JOINT_ITEMS = JOINT.at("twist"), len(JOINT)


@dataclass(frozen=True)
class JointRest(Nothing):
    """The numbers of the joints where edges begin, in the place that an external energy has: no energy by themselves.

    rest  (1 or N, E, JOINT_ITEMS)
    """

    rest: np.ndarray
    layout: ClassVar[Layout] = JOINT

    def numbers(self) -> np.ndarray:
        return self.rest

    @staticmethod
    def functions(number) -> ExternalFunctions:
        import taichi as ti

        @ti.func
        def load(own, numbers: ti.template(), row, edge, scale):
            for k in ti.static(range(JOINT_ITEMS)):
                own[k] = numbers[row, edge, k]

        return Nothing.functions(number)._replace(load=load)
