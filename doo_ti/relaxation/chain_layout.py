"""What scratch holds of a chain of frames (:mod:`doo_ti.physics.view`): of each rod, and then of each of its edges.

State is what a step changes, constants are what a rod is given, the rest is scratch proper: what a trip leaves for its own
later sweeps.
"""

from functools import cache

from doo_ti.physics.view import Layout

# Of an edge: the frame, and that before the step, restored where the step is rejected.
STATE = Layout(frame=4, standing=4)
CONSTANTS = Layout(length=1, inverse_length=1)  # 1/l̄, β and ω̄ are those of the vertex where the edge begins
GENERAL = Layout(bend=3, twist=1, rest=2, shift_shares=2)  # of a spin and of a tilt
# ``rotation`` is the right-hand side while eliminating and the step after back-substitution, ``neighbour`` the columns W_U,
# ``border`` those of W_A or W_Z; before eliminating their place has ``bent``, curvature and twist where the edge ends.
SCRATCH = Layout(rotation=3, neighbour=9, border=9, bent=("border", 8), pivots=6)
# Of the columns of the multiplier under an external energy.
FORCE = Layout(force_border=9)

# Of a rod (see :class:`doo_ti.relaxation.chain.Chain`).
ROD = Layout(target=3, closed=1, free=5, released=1, total=1, longest=1, energy_unit=1, stiffness=2, gravity=3, anchor=3,
             scale=1, length_unit=1, softest=1, shift_shares=2)
# And of one whose vertex 0 may move: the flag, how far it has moved, its place before the step, its step, and what the
# substitution needs of its elimination.
LOOSE = Layout(loose=1, drift=3, drift_standing=3, drift_step=3, drift_border=9, drift_pivots=6)


@cache
def edge_layout(isotropic: bool, outer: Layout | None = None, force: bool = False) -> Layout:
    """What scratch holds of an edge, with the numbers ``outer`` of an external energy and, with ``force``, the columns of the
    multiplier under it."""
    own = STATE + CONSTANTS + SCRATCH + (Layout() if isotropic else GENERAL)
    return own + (Layout() if outer is None else Layout(outer=outer)) + (FORCE if force else Layout())


@cache
def rod_layout(outer_start: Layout | None = None) -> Layout:
    """What scratch holds of a rod, whose vertex 0 may move if there are numbers ``outer_start`` of an external energy there."""
    return ROD if outer_start is None else ROD + LOOSE + Layout(outer=outer_start)
