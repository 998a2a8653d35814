"""Where the numbers of a rod's contact with itself lie in scratch, behind those of its contacts with obstacles
(docs/contact.md)."""

from doo_ti.physics.tuples import picked
from doo_ti.physics.view import Layout
from doo_ti.relaxation.contact_layout import contact_items

# Its coefficient of friction on itself; of the two edges that are looked at the weights of their four ends, and the mixed
# derivatives of their distance by these and by the places on both edges; and the least gap of two edges that clamps hold.
ROD = Layout(coefficient=1, weights=4, slopes=24, ends=("weights", 28), pinched=1)
# Of every vertex the gradient of all energies of places, the part of it from the rod's contact with itself, the displacement
# that the next step means, and the length of the rod before.
VERTEX = Layout(load=3, pull=3, move=3, arc=1)
# Of a pair of edges i < j, number j (j − 1)/2 + i: the force; the friction, the normal of its plane and the places on both
# edges at which it acts; the distance of the edges, or a bound below it, now and before the step; the nearest places on both
# and the gradient of the distance; and, in a group, one where they may touch.
PAIR = Layout(force=1, friction=3, rubbed_normal=3, rubbed_places=2, remembered=("force", 9), distance=1, distance_standing=1,
              places=2, normal=3, nearest=("places", 5), may_touch=1)
REMEMBERED, CARRIED = PAIR.at("distance"), PAIR.at("places")
"""Numbers of a pair that last from one step to the next, and from one launch to the next."""
# Then the dense matrix of the Newton system, the rows of its lower triangle one after the other; three rows that are being
# eliminated, place by place; the inverse pivots; and the right-hand side with the three columns of closure, row by row.

ROUNDED = 2e-3
"""Squared radii by which a place on an edge is drawn to the middle of the edge, so that the nearest places of parallel edges
are unique: a distance of two radii becomes larger by at most 2.5e-4 of a radius."""
REACH = 3.0
"""Radii between centrelines: within them the nearest places of two edges are computed."""
DEEPEST_STEP = 0.1
"""Radii between centrelines: no step brings two edges nearer."""
LEAST_DISTANCE = 1e-3
"""Radii: a start whose centreline is nearer to itself does not say which side is which."""


@picked
def pair_items(edges):
    """Numbers of a rod's contact with itself in scratch, without the matrix."""
    return len(ROD) + (edges + 1) * len(VERTEX) + edges * (edges - 1) // 2 * len(PAIR)


@picked
def matrix_items(lines):
    """Numbers of a dense Newton system of so many ``lines`` of 3×3 blocks."""
    size = 3 * lines
    return size * (size + 1) // 2 + 3 * size + size + 4 * size


@picked
def self_contact_items(edges, obstacles):
    """Numbers of all contacts of a rod that may touch itself in scratch, with those of its dense Newton system."""
    return contact_items(edges, obstacles) + pair_items(edges) + matrix_items(edges + 1)
