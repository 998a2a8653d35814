"""Where the numbers of a group lie in scratch, behind those of a rod that may touch itself (docs/groups.md), and those that a
time step gives to its joints.

The rods of a group are one chain, one after the other. Between two of them one edge more, a break, takes the place in the chain
that an edge has: it has no length, and instead of a rotation its unknowns are the place where the next rod begins.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from doo_ti.physics.number import Layout
from doo_ti.physics.tuples import picked
from doo_ti.relaxation.contact_table import matrix_items
from doo_ti.relaxation.external import ExternalFunctions, Nothing

# Of a group: κ of its ties and ε of the border; by how much the energy would be higher if the forces of ties had not changed,
# now and before the step; one where the next step changes them; their bound; and the unit of length.
GROUP = Layout(stiffness=1, give=1, work=1, work_standing=1, stepping=1, bound=1, unit=1)
# Whether an edge may spin and tilt, and the gradient of its welds; of a break the first two say whether the rod behind it may
# move its first vertex.
EDGE = Layout(spin=1, tilt=1, moment=3)
# Of a vertex its weight, a length that gravity multiplies; one where a clamp holds it; by how much its rod is thicker than the
# thinnest; and the point and the stiffness of a spring.
VERTEX = Layout(weight=1, held=1, thicker=1, spring_point=3, spring=1)
# Where a rod begins, also before the step, the step of that place, and where the rod ends.
MEMBER = Layout(begin=3, begin_standing=3, begin_step=3, tip=3)
# A force or a moment, that before the step, and its step.
FORCE = Layout(now=3, standing=3, step=3)
# Of a tie the place that it holds a vertex at, its force, and one where there is this tie; of a weld the rest rotation, its
# moment, by how much it misses, and its second derivatives by the later edge, by the earlier one, and by both. Then by what κ
# and 1/ε are multiplied.
TIE = Layout(target=3, force=FORCE, active=1, rest=4, moment=FORCE, turned=3, of_late=6, of_early=6, mixed=9, scale=1)
# Of a joint for a time step: u̅ of the left frame and of the right one, and m̅ (:mod:`doo_ti.physics.pair`).
JOINT = Layout(left=2, right=2, twist=1)
TWIST, JOINT_ITEMS = JOINT.at("twist"), len(JOINT)
STIFFNESS_OF_TIES, MOST_TIE_STIFFNESS, STIFFER_TIES = 1e4, 1e7, 10.0
"""κ of ties at first and at most, over B/L³ of the softer rod or what its weight makes of that, and its growth."""
GIVE, NO_BORDER = 1e-8, 1e8
"""ε over 1/κ, and in rounds in which forces do not change: points far apart are drawn together by κ alone."""
MOST_GROWTH, NOTABLE_MISS = 10.0, 1e-2
"""By steps forces of ties grow to at most so many times the largest at the end of such a round, and what κ makes of a miss of
that share of the length."""
TIE_TOLERANCE = 1e-10  # of the longest rod: how far tied points may be apart


@picked
def group_items(edges, rods, ties, borders):
    """Numbers of a group in scratch, with those of its Newton system."""
    return (len(GROUP) + edges * len(EDGE) + (edges + 1) * len(VERTEX) + rods * len(MEMBER) + ties * len(TIE)
            + matrix_items(edges + 1 + borders))


@dataclass(frozen=True)
class JointRest(Nothing):
    """Rest curvature and twist, besides the material's, that damping draws the joints where edges begin towards
    (docs/dynamics.md). They are read in the place that an external energy has, and have no energy by themselves.

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
