"""Where the numbers of contacts lie in scratch, and the numbers that their rounds go by (docs/contact.md)."""

from doo_ti.contact.distance import COLUMNS
from doo_ti.physics.tuples import picked
from doo_ti.physics.view import Layout

# Of a rod: its radius, κ, the tolerance of its gaps, by how much the last round changed a gap, and its phase; how close to an
# obstacle a vertex is where more than its φ counts; κ as it was at first; the work that friction has done; one where a step is
# tried for the second time; of a motion how much of the clamps' way to the next instant is made, and how much at once, the
# multiplier of closure at the last instant, and the largest force; and of steps that viscosity eases, the viscosity now and at
# first, and how many there were.
ROD = Layout(
    radius=1, stiffness=1, tolerance=1, change=1, phase=1, reach=1, first_stiffness=1, work=1, retried=1, way_made=1, way=1,
    multiplier=3, largest=1, viscosity=1, first_viscosity=1, eased=1, given=("radius", 9))
# Sums, which are kept here because a loop over obstacles has no room for them in registers: the energy of all contacts, its
# magnitude, and the part of it that only makes gaps close, which is no energy of the rod; the square of the largest share of
# its way to the middle of an obstacle that a vertex has made in this step; the least φ, the least gap where no clamp holds the
# rod, and by how much the step changed a force by updating forces.
SUMS = Layout(energy=1, magnitude=1, penalty=1, crossing=1, deepest=1, closest=1, force_change=1, sums=("energy", 7))
# Then the κ with which the step updates forces, zero where it does not, and how many steps have done so; 1/κ; one where the
# step before was refused, and one where the derivatives therefore have a contact that does not push
# (:meth:`.ContactEnergy.expect`); that part of the energy at the accepted frames; and, one number each for all rods of the
# pack, whether the step of any was refused, and the longest edge.
STEP = Layout(update_stiffness=1, early=1, compliance=1, expecting=1, expected=1, penalty_kept=1, some_expecting=1,
              longest_edge=1)
# And of one edge the derivatives of the energy of its contacts between its ends, as :meth:`.LoadedElimination.load` returns
# them, and how much of the first two is not of known forces; and those by the place of the vertex where it ends of the energy
# of the contacts there.
EDGE = Layout(
    gradient=3, gradient_s=3, curvatures=6, curvatures_s=9, curvatures_ss=6, between=("gradient", 27), excess=3, excess_s=3,
    excesses=("excess", 6), end_gradient=3, end_curvatures=6, end_excess=3, end=("end_gradient", 12))
CONTACTS = ROD + SUMS + STEP + EDGE
"""Of a rod; its obstacles follow, and then its vertices."""
CARRIED_ON = tuple(map(CONTACTS.at, ("first_stiffness", "stiffness", "largest", "way", "work")))
"""Numbers of a rod that last from one launch of a motion to the next."""
OBSTACLE = COLUMNS + Layout(turn=4, shift=3, pose=("turn", 7), turn_before=4, shift_before=3,
                            pose_before=("turn_before", 7), carry=9, carried=3)
"""An obstacle; of one that moves its turn and its shift from where it was at first, now and at the last instant, and by which
turn, column after column, and shift a place of it has moved since then."""
# Its place; the least room of the edge that ends there, which is how far it is from the middle of an obstacle; both also from
# before the step; the forces on that edge's end and on its start; of a motion the place at the instant before; the least φ of
# all obstacles; and, one number each for all rods of the pack, how far the nearest obstacle is from being close, and whether
# there are forces; and ``odd``, unused: with a power of two of items all vertices would share a few lines of the processor's
# cache.
VERTEX = Layout(place=3, standing=3, room=1, room_standing=1, force_end=3, force_start=3, previous=3, least=1, nearest_of_all=1,
                pushed=1, odd=1)
"""A vertex; its contacts follow."""
# λ of both, and the friction on both; for friction, where a round does not change them, the normal at the vertex, the place on
# the edge and the normal there; one where rounds have the contact of the edge; of the vertex φ, its normal and ∇∇φ; of the edge
# the nearest point s, φ* and its normal, one where it has a contact, and by how much it is nearer there than at its ends; one
# number for all rods of the pack, how far the nearest is from being close; and, of both, one where it has pushed in the last
# trip.
CONTACT = Layout(
    force=1, force_between=1, friction=3, friction_between=3, rubbed_normal=3, rubbed_place=1, rubbed_normal_between=3,
    active=1, value=1, normal=3, curvature=6, place_between=1, value_between=1, normal_between=3, acts=1,
    nearest_point=("place_between", 6), sagging=1, nearest=1, pushes=1, pushes_between=1,
    remembered=("force", 16))
"""The contact of a vertex and the edge that ends there with an obstacle."""
REMEMBERED, REMEMBERED_IN_MOTION = CONTACT.at("friction"), CONTACT.at("value")
"""Numbers of a contact that last from one relaxation to the next, and from one step to the next."""
# Phases of a rod: rounds to a rough tolerance of its moments, and rounds to the final one.
ROUGH, FINE = 1.0, 0.0

SEARCHES = 48
"""Evaluations, at most, to find the point of an edge that is nearest to an obstacle."""
EVEN = 1e-5
"""Of a radius: that times (s − ½)² is added to φ along an edge, s from 0 to 1, so that an edge that lies flat on a face has one
nearest point, which moves continuously. Gaps are off by at most a quarter of it."""
BENDING_LOADS, LOOP_LOADS = 20.0, 200.0
"""The forces to expect are the weight of an edge and so many B/L²; more where rods touch themselves, which are bent to loops.
With 20 there, too, loops are pressed so far into each other that a knot slips over an end of its rod."""
SOFT = 0.1
"""Of a radius: at first κ gives way by that under such a force."""
PRESSED_IN = 0.3
"""Of a radius: the most by which κ gives way under the largest force at the end of a round, so that forces end where contact
does, and what a step may press in beyond a closed gap. Of the way to the middle of an obstacle: the most by which κ first gives
way under the weight of the whole rod."""
EARLY_ROTATION = 3e-2
"""A step in which every edge turns by less than that, rad, and which takes less than that share of gaps, updates forces."""
MOST_TRIES = 12.0
"""At most so many steps of a rod update forces, and so many are eased by viscosity between two instants of a motion."""
STIFFER, SLOW, STIFFEST = 10.0, 0.3, 1e6
"""κ is at least STIFFER times the first one from the first step on that updates forces. It grows by that factor where a round
leaves more than the share SLOW of the change of the round before, and where a refused step is deep inside an obstacle, up to
STIFFEST times the first κ; it shrinks by it where a step is refused a second time elsewhere. A force that is larger than
STIFFEST times the first κ and the radius means that the rod cannot get out of an obstacle. Viscosity that eases a step grows by
STIFFER where a step with it fails, else shrinks by that."""
CLOSE = 4.0
"""Radii: what is further from an obstacle than that, and half an edge, is not close."""
ROUGHER = 3e-3
"""The residual to reach until the forces of contacts have settled."""

SHORTENED, PART, SHIFT_GROWTH = 0.8, 0.3, 10.0
"""A step of which a smaller share than SHORTENED was taken does not make the shift smaller; the part of it that is tried after
it was refused; and by how much the shift then grows."""


@picked
def contact_items(edges, obstacles):
    """Numbers of a rod's contacts in scratch."""
    return len(CONTACTS) + obstacles * len(OBSTACLE) + (edges + 1) * (len(VERTEX) + obstacles * len(CONTACT))
