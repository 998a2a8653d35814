"""Where the numbers of a group lie in scratch, behind those of a rod that may touch itself (docs/groups.md).

The rods of a group are one chain, one after the other. Between two of them one edge more, a break, takes the place in the chain
that an edge has: it has no length, and instead of a rotation its unknowns are the place where the next rod begins.
"""

from doo_ti.physics.tuples import picked

# Items of a group: κ of its ties, the largest miss of a tie after the last round, and the unit of length.
TIE_STIFFNESS, TIE_MISS, UNIT, GROUP_HEAD = 0, 1, 2, 3
# Of an edge, whether it may spin and tilt, and the gradient of its welds; of a break the first two say whether the rod behind
# it may move its first vertex.
SPIN, TILT, MOMENT, GROUP_EDGE_ITEMS = 0, 1, 2, 5
# Of a vertex its weight, a length that gravity multiplies; one where a clamp holds it; by how much its rod is thicker than the
# thinnest; and the point and the stiffness of a spring.
WEIGHT, HELD, THICKER, SPRING_POINT, SPRING, GROUP_VERTEX_ITEMS = 0, 1, 2, 3, 6, 7
# Of a rod where it begins, also before the step, the step of that place, and where the rod ends.
BEGIN, BEGIN_STANDING, BEGIN_STEP, TIP, GROUP_ROD_ITEMS = 0, 3, 6, 9, 12
# Of a tie the place that it holds a vertex at, its force, and one where there is this tie; of a weld the rest rotation, its
# moment, by how much it misses, and its second derivatives by the later edge, by the earlier one, and by both.
TARGET, TIE_FORCE, ACTIVE, REST, TIE_MOMENT, TURNED, OF_LATE, OF_EARLY, MIXED, TIE_ITEMS = 0, 3, 6, 7, 11, 14, 17, 23, 29, 38
FIRST_TIE_STIFFNESS, MOST_TIE_STIFFNESS = 1e4, 1e7
"""κ of ties at first and at most, over B/L³."""
SLOW_TIES, STIFFER_TIES = 0.05, 10.0
"""Where a round leaves more than that share of the miss before, κ grows by so much."""
TIE_TOLERANCE = 1e-10
"""Of the longest rod: how far tied points may be apart."""


@picked
def group_items(edges, rods, ties):
    """Numbers of a group in scratch."""
    return (GROUP_HEAD + edges * GROUP_EDGE_ITEMS + (edges + 1) * GROUP_VERTEX_ITEMS + rods * GROUP_ROD_ITEMS
            + ties * TIE_ITEMS)
