"""Columns of the tables that host and kernels share, and the numbers in them (§III-B)."""

from doo_ti.types import Clamp

# As plain numbers, which NumPy compares ten times faster than members of an enumeration.
FREE, POSITION, TANGENT, FRAME = (int(kind) for kind in Clamp)

# Columns of a clamp: the far point from vertex 0, and flags that are one or zero (see doo_ti.relaxation.chain); then what the
# rod between its clamps measures in mm: its length, its longest edge, its shortest two neighbours, and the largest moment arm
# of gravity on an edge (a length times a length); the point the chain hangs from, vertex 0 or, where that is free, the far end;
# one where nothing holds vertex 0 and an external energy moves it; and the first frame and the last as the clamps hold them.
TARGET, CLOSED, SPIN_START, SPIN_END, TILT_START, TILT_END, TILT_INNER, RELEASED = 0, 3, 4, 5, 6, 7, 8, 9
TOTAL, LONGEST, SHORTEST_PAIR, HANGING, ANCHOR, LOOSE, ENDS, CLAMP_COLUMNS = 10, 11, 12, 13, 14, 17, 18, 26

# Columns of a material: weight μ, the largest eigenvalue of B, that or β where it is more, one where the rod looks the same
# from all sides, so that it may spin about itself at no cost; and its stiffness, once or edge by edge: B as (11, 22, 12), and
# of the inner vertex where the edge begins β and ω̄.
WEIGHT, LARGEST_BEND, STIFFEST, ROUND, STIFFNESS = 0, 1, 2, 3, 4
BEND, TWIST, REST, STIFFNESS_COLUMNS = 0, 3, 4, 6

# Columns of a rod: its row of the clamps, of the materials, of the results, of the starts, or FROM_RESULTS where it starts
# from the frames in its row of the results, and of the external energy.
OF_CLAMP, OF_MATERIAL, OF_RESULT, OF_START, OF_EXTERNAL, ROD_COLUMNS = 0, 1, 2, 3, 4, 5
FROM_RESULTS = -1

# Columns of a rod's results; the force −λ that holds its far end has three. Under an external energy there are three more, how
# far vertex 0 has moved from the anchor, mm: in where a rod starts, and out.
ENERGY, RESIDUAL, CLOSURE, ITERATIONS, STATUS, STABLE, FORCE, RESULTS = 0, 1, 2, 3, 4, 5, 6, 9
DRIFT, LOADED_RESULTS = RESULTS, RESULTS + 3

MOST_NUMBERS = 2**31 - 1
"""A table has no more entries: the kernels count them with 32 bits."""
