"""Where the numbers of a group lie in scratch, behind those of a rod that may touch itself (docs/groups.md).

The rods of a group are one chain, one after the other. Between two of them one edge more, a break, takes the place in the chain
that an edge has: it has no length, and instead of a rotation its unknowns are the place where the next rod begins.
"""

from doo_ti.physics.tuples import picked
from doo_ti.relaxation.pair_layout import matrix_items

# Items of a group: κ of its ties and ε of the border; by how much the energy would be higher if the forces of ties had not
# changed, now and before the step; one where the next step changes them; their bound; and the unit of length.
TIE_STIFFNESS, TIE_GIVE, TIE_WORK, TIE_WORK_STANDING, STEPPING, TIE_BOUND, UNIT, GROUP_HEAD = 0, 1, 2, 3, 4, 5, 6, 7
# Of an edge, whether it may spin and tilt, and the gradient of its welds; of a break the first two say whether the rod behind
# it may move its first vertex.
SPIN, TILT, MOMENT, GROUP_EDGE_ITEMS = 0, 1, 2, 5
# Of a vertex its weight, a length that gravity multiplies; one where a clamp holds it; by how much its rod is thicker than the
# thinnest; and the point and the stiffness of a spring.
WEIGHT, HELD, THICKER, SPRING_POINT, SPRING, GROUP_VERTEX_ITEMS = 0, 1, 2, 3, 6, 7
# Of a rod where it begins, also before the step, the step of that place, and where the rod ends.
BEGIN, BEGIN_STANDING, BEGIN_STEP, TIP, GROUP_ROD_ITEMS = 0, 3, 6, 9, 12
# Of a tie the place that it holds a vertex at, its force, and one where there is this tie; of a weld the rest rotation, its
# moment, by how much it misses, and its second derivatives by the later edge, by the earlier one, and by both. Then by what κ
# and 1/ε are multiplied. Behind a force and a moment lie the same before the step, and their step.
TARGET, TIE_FORCE, ACTIVE, REST, TIE_MOMENT, TURNED, OF_LATE, OF_EARLY, MIXED, TIE_SCALE, TIE_ITEMS = (
    0, 3, 12, 13, 17, 26, 29, 35, 41, 50, 51)
FORCE_STANDING, FORCE_STEP = 3, 6
STIFFNESS_OF_TIES, MOST_TIE_STIFFNESS, STIFFER_TIES = 1e4, 1e7, 10.0
"""κ of ties at first and at most, over B/L³ of the softer rod or what its weight makes of that, and its growth."""
GIVE, NO_BORDER = 1e-8, 1e8
"""ε over 1/κ, and in rounds in which forces do not change: points far apart are drawn together by κ alone."""
MOST_GROWTH, NOTABLE_MISS = 10.0, 1e-2
"""By steps forces of ties grow to at most so many times the largest at the end of such a round, and what κ makes of a miss of
that share of the length."""
TIE_TOLERANCE = 1e-10
"""Of the longest rod: how far tied points may be apart."""


@picked
def group_items(edges, rods, ties, borders):
    """Numbers of a group in scratch, with those of its Newton system."""
    return (GROUP_HEAD + edges * GROUP_EDGE_ITEMS + (edges + 1) * GROUP_VERTEX_ITEMS + rods * GROUP_ROD_ITEMS
            + ties * TIE_ITEMS + matrix_items(edges + 1 + borders))
