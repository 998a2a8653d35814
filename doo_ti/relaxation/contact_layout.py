"""Where the numbers of contacts lie in scratch, and the numbers that their rounds go by (docs/contact.md)."""

from doo_ti.contact.obstacles import OBSTACLE_COLUMNS
from doo_ti.physics.tuples import picked

# Items of a rod: its radius, κ, the tolerance of its gaps, by how much the last round changed a gap, and its phase; of the
# barrier what it adds to gaps, its strength μ and how many strengths it has had; how close to an obstacle a vertex is where
# more than its φ counts; κ as it was at first; the work that friction has done; one where a step is tried for the second time;
# μ as it was at first; of a motion how much of the clamps' way to the next instant is behind the rod, how much of it is made at
# once, the multiplier of closure at the last instant, and the largest force; and of steps that viscosity eases, the viscosity
# now and at first, and how many there were. The obstacles follow.
RADIUS, STIFFNESS, TOLERANCE, CHANGE, PHASE, OFFSET, STRENGTH, STAGE, REACH = 0, 1, 2, 3, 4, 5, 6, 7, 8
FIRST_STIFFNESS, WORK, RETRIED, FIRST_STRENGTH, WAY_MADE, WAY, MULTIPLIER, LARGEST, VISCOSITY, FIRST_VISCOSITY, EASED = (
    9, 10, 11, 12, 13, 14, 15, 18, 19, 20, 21)
# And sums, which are kept here because a loop over obstacles has no room for them in registers: the energy of all contacts, its
# magnitude, and the part of it that only makes gaps close, which is no energy of the rod; the square of the largest share of
# its way to the middle of an obstacle that a vertex has made in this step; the least φ, the least gap where no clamp holds the
# rod, and by how much the step changed a force by settling forces. Then the κ with which the step settles forces, zero where it
# does not, and how many steps have done so; 1/κ; one where the step before was refused, and one where the derivatives therefore
# have a contact that does not push (:meth:`.ContactEnergy.expect`); that part of the energy at the accepted frames; and, one
# number each for all rods of the pack, whether a barrier keeps any away from obstacles, whether the
# step of any was refused, and the length of the longest edge. And of one edge the derivatives of the energy of its contacts
# between its ends, as :meth:`.LoadedElimination.load` returns them, and how much of the first two is not of known forces; and
# those by the place of the vertex where it ends of the energy of the contacts there.
ENERGY, MAGNITUDE, PENALTY, CROSSING, DEEPEST, CLOSEST, SETTLED, SETTLING, EARLY, COMPLIANCE, EXPECTING, EXPECTED = (
    22, 23, 24, 25, 26, 27, 28, 29, 30, 31, 32, 33)
PENALTY_KEPT, SOME_BEHIND, SOME_EXPECTING, LONGEST_EDGE = 34, 35, 36, 37
GRADIENT, GRADIENT_S, CURVATURES, CURVATURES_S, CURVATURES_SS, EXCESS, EXCESS_S = 38, 41, 44, 50, 59, 65, 68
END_GRADIENT, END_CURVATURES, END_EXCESS, HEAD = 71, 74, 80, 83
# Phases of a rod: it has just been loaded and begins with a barrier; this keeps it away from obstacles and finds out where it
# will touch them; rounds to a rough tolerance of its moments; rounds to the final one.
LOADED, BARRIER, ROUGH, FINE = 3.0, 2.0, 1.0, 0.0
# Items of a vertex: its place; the least room of the edge that ends there, which is how far it is from the middle of an
# obstacle; both also from before the step; the forces on that edge's end and on its start; of a motion the place at the
# instant before; the least φ of all obstacles; and, one number each for all rods of the pack, how far the nearest obstacle is
# from being close, and whether there are forces. Its contacts follow. The number of items of a vertex with its contacts is odd:
# with a power of two all vertices would share a few lines of the processor's cache.
PLACE, STANDING, ROOM, ROOM_STANDING, FORCE_END, FORCE_START, PREVIOUS, LEAST, NEAREST_OF_ALL, PUSHED, VERTEX_ITEMS = (
    0, 3, 6, 7, 8, 11, 14, 17, 18, 19, 21)
# Items of the contact of a vertex and the edge that ends there with an obstacle: λ of both, and the friction on both; for
# friction, where a round does not change them, the normal at the vertex, the place on the edge and the normal there; one where
# rounds have the contact of the edge; of the vertex φ, its normal and ∇∇φ; of the edge the nearest point s, φ* and its normal,
# the weight of its contact, and by how much it is nearer there than at its ends; one number for all rods of the pack, how far
# the nearest is from being close; and, of both, one where it has pushed in the last trip.
FORCE, FORCE_BETWEEN, FRICTION, FRICTION_BETWEEN, RUBBED_NORMAL, RUBBED_PLACE, RUBBED_NORMAL_BETWEEN, ACTIVE = (
    0, 1, 2, 5, 8, 11, 12, 15)
VALUE, NORMAL, CURVATURE, PLACE_BETWEEN, VALUE_BETWEEN, NORMAL_BETWEEN, WEIGHT, SAGGING, NEAREST = (
    16, 17, 20, 26, 27, 28, 31, 32, 33)
PUSHES, PUSHES_BETWEEN, CONTACT_ITEMS = 34, 35, 36
# Items of an obstacle: its columns; and of one that moves its turn and its shift from where it was at first, now and at the
# last instant, and by which turn, column after column, and shift a place of it has moved since then.
TURN, SHIFT, TURN_BEFORE, SHIFT_BEFORE, CARRY, CARRIED, OBSTACLE_ITEMS = (
    OBSTACLE_COLUMNS + k for k in (0, 4, 7, 11, 14, 23, 26))
REMEMBERED, REMEMBERED_IN_MOTION = 2, 16
"""Items of a contact that last from one relaxation to the next, and from one step to the next."""

SEARCHES = 24
"""Evaluations, at most, to find the point of an edge that is nearest to an obstacle."""
SAG = 0.1
"""Of a radius: where an edge is nearer to an obstacle than its ends by so much, its nearest point has half its weight."""
BENDING_LOADS = 20.0
"""The forces to expect are the weight of an edge and so many B/L²."""
SOFT = 0.1
"""Of a radius: at first κ gives way by that under such a force."""
THROUGH = 0.4
"""Of the way to the middle of an obstacle: at first κ gives way by that, at most, under the weight of the whole rod."""
TIGHT, SOFTEST = 0.3, 1.0
"""Of a radius: the most by which κ gives way under the largest force, so that forces end where contact does; and where a step
was refused, so that the rod does not slip into the obstacle."""
EARLY_ROTATION, EARLY_SHIFT, EARLY_STIFFER, MOST_EARLY = 3e-2, 1e-3, 7.0, 12.0
"""A step in which every edge turns by less than that, rad, settles forces, unless a larger shift, over H's largest diagonal
entry, makes it small; κ is from then on at least so many times the first; and at most so many steps of a rod do so."""
ALMOST, ALMOST_STIFFER = 5e-3, 40.0
"""Of a radius: once such a step has changed gaps by less, κ is in f64 at least so many times the first."""
FOLLOWED = 0.7
"""If such a step leaves a residual above ROUGHER and changes gaps by more than that share of what the one before did, the rod
has not followed its forces yet, and the next step settles none."""
DEEP = 0.5
"""Of a radius: if a vertex is so deep inside an obstacle, such a step leaves κ as it is; at half that depth κ may double."""
STIFFER, SLOW, STIFFEST = 5.0, 0.3, 1e6
"""κ grows by so much where a round leaves more than that share of the change of the round before, up to so many times the
first."""
HOPELESS, HOPELESS_32 = 1e11, 1e7
"""Times the first κ and the radius: larger contact forces mean that the rod cannot get out of an obstacle. In f32 the limit is
lower, and f64 continues."""
OPEN = 0.01
"""Of a radius: a round that changes a gap by more has left it open."""
SECANT = 0.3
"""After the barrier κ is that share of the barrier's largest force over its gap."""
BARRIER_SHARE = 1 / 16
"""The barrier at a quarter of a radius pushes at first like such a force."""
WALL = 1e29
"""More energy than a rod has: behind the barrier."""
WEAKER, STAGES = 1 / 30, 2
"""The barrier becomes weaker by that, until it has had so many stages."""
NEAR_ENOUGH = 0.03
"""Of a radius: or until it leaves so small a gap."""
CLOSE = 4.0
"""Radii: what is further from an obstacle than that, and half an edge, is not close."""
LEAST_OFFSET = 0.05
"""Of a radius: the smallest gap of a rod's start, as the barrier sees it."""
APPROACH = 0.75
"""A step is taken whole if it shortens no gap by more than that gap times max_rotation over this: by 0.8 of it by default."""
SLACK, SLACK_OF_SHARP = 0.3, 0.1
"""Of a radius: what is added to a gap for that in rounds, in which a rod may be pressed into an obstacle; and where the
obstacle has edges, past which the rod could slip."""
ROUGHEST, ROUGHER = 1e-2, 3e-3
"""The residual to reach under the barrier, and until the forces of contacts have settled."""

VISCOUS, THICKER, THINNER, LEAST_VISCOSITY, MOST_VISCOSITY, MOST_EASED = 30.0, 8.0, 1 / 4, 1 / 100, 1e5, 48.0
"""Viscosity that eases a step is at first so many times the expected forces over the rod's length at every vertex, larger by
THICKER where a step with it fails, else smaller by THINNER, none below a share of the first; at most so much, and so often."""
LEAST_BLOCKED = 1 / 64
"""Of the shortest way otherwise: that of a step which would begin inside an obstacle."""
HELD = 0.999
"""A contact sticks while its friction is below that share of the coefficient times its force."""
INERT = 10.0
"""In a motion κ is larger by so many times the inertia of a vertex."""


@picked
def contact_items(edges, obstacles):
    """Numbers of a rod's contacts in scratch."""
    return HEAD + obstacles * OBSTACLE_ITEMS + (edges + 1) * (VERTEX_ITEMS + obstacles * CONTACT_ITEMS)
