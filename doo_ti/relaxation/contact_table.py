"""The obstacles of many rods as tables, and which of the rods can reach any; where the numbers of contacts lie in scratch, and
those that their rounds go by (docs/contact.md)."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from doo_ti.contact.distance import COLUMNS
from doo_ti.contact.distance_grid import DistanceGrid, grid_table
from doo_ti.contact.obstacles import FRICTION, GRID, Obstacle, obstacle_table
from doo_ti.contact.surroundings import Surroundings
from doo_ti.contact.touch import GAP_TOLERANCE, Contacts, gap_tolerance
from doo_ti.physics.number import Layout
from doo_ti.physics.tuples import picked
from doo_ti.relaxation import tables as of
from doo_ti.rod.types import Clamp, Clamps, Configuration
from doo_ti.system.errors import InputError

# --- contacts with obstacles: those of a rod, then its obstacles, then its vertices, each followed by its contacts ---

ROD = Layout(
    radius=1, stiffness=1, tolerance=1, change=1, phase=1, reach=1, first_stiffness=1, work=1, retried=1, way_made=1, way=1,
    multiplier=3, largest=1, slipped=1, viscosity=1, first_viscosity=1, eased=1)
"""stiffness, first_stiffness       κ, and as it was at first
tolerance, change, phase         of gaps; by how much the last round changed one; ROUGH or FINE
reach                            how close to an obstacle a vertex is where more than its φ counts
work, retried                    of friction since the motion began; one where a step is tried for the second time
way_made, way                    of the clamps' way to the next instant, what is made and what is made at once
multiplier, largest, slipped     of closure at the last instant; the largest force; by how much the last round changed the sum
                                 of all friction that slips
viscosity, first_viscosity, eased  of a step that viscosity helps along: now, at first, and how many such steps there were"""
SUMS = Layout(energy=1, magnitude=1, penalty=1, crossing=1, least_phi=1, least_gap=1, force_change=1, sums=("energy", 7))
"""Kept here because a loop over obstacles has no registers for them.

energy, magnitude  of all contacts, and the sum of its absolute terms
penalty            the part of the energy that only makes gaps close, which is no energy of the rod
crossing           the square of the largest share of its way to the middle of an obstacle that a vertex has made in this step
least_phi, least_gap  the least φ, and the least gap where no clamp holds the rod
force_change       by how much the step changed a force by updating forces"""
STEP = Layout(update_stiffness=1, updates=1, compliance=1, refused=1, has_met=1, penalty_kept=1, some_refused=1,
              longest_edge=1, gap_kept=1)
"""update_stiffness, updates   κ with which the step updates forces, zero where it does not; how many steps have done so
compliance                 1/κ
refused, has_met        one where the step before was refused; one where the derivatives therefore have a contact that does
                           not push (:meth:`.ContactEnergy.take_met`)
penalty_kept, gap_kept     ``penalty`` and ``least_gap`` at the accepted frames
some_refused, longest_edge  one number for all rods of the pack: whether any is ``refused``; the longest edge"""
EDGE = Layout(
    gradient=3, gradient_s=3, curvatures=6, curvatures_s=9, curvatures_ss=6, between=("gradient", 27), excess=3, excess_s=3,
    excesses=("excess", 6), end_gradient=3, end_curvatures=6, end_excess=3, end=("end_gradient", 12))
"""Of the edge at hand: a rod has one such area.

between  derivatives of the energy of the contacts of one edge between its ends, as :meth:`.LoadedElimination.load` has them
excesses  of its first two, how much κ g has to do with: the gradient less that of the known forces λ
end       derivatives by the place of the vertex where the edge ends of the energy of the contacts there"""
CONTACTS = ROD + SUMS + STEP + EDGE  # of a rod; its obstacles follow, and then its vertices
CARRIED_ON = tuple(map(CONTACTS.at, ("first_stiffness", "stiffness", "largest", "way", "work")))
"""Numbers of a rod that last from one launch of a motion to the next."""
OBSTACLE = COLUMNS + Layout(turn=4, shift=3, pose=("turn", 7), turn_before=4, shift_before=3,
                            pose_before=("turn_before", 7), carry=9, carried=3)
"""An obstacle; of one that moves its turn and its shift from where it was at first, now and at the last instant, and by which
turn, column after column, and shift a place of it has moved since then."""
VERTEX = Layout(place=3, standing=3, room=1, room_standing=1, force_end=3, force_start=3, previous=3, least=1, nearest_of_all=1,
                pushed=1, odd=1)
"""place, previous             now, and at the last instant of a motion
room                        of the edge that ends there: how far it is from the middle of an obstacle, at least
standing, room_standing     place and room before the step
force_end, force_start      on that edge's end and on its start
least                       φ, of all obstacles
nearest_of_all, pushed      one number for all rods of the pack: how far the nearest obstacle is from being close; whether there
                            are forces
odd                         unused: with a power of two of numbers all vertices would share a few lines of the cache"""
CONTACT = Layout(
    force=1, force_between=1, friction=3, friction_between=3, rubbed_normal=3, rubbed_place=1, rubbed_normal_between=3,
    kept_between=1, value=1, normal=3, curvature=6, place_between=1, value_between=1, normal_between=3, acts_between=1,
    nearest_point=("place_between", 6), sagging=1, nearest=1, pushes=1, pushes_between=1,
    remembered=("force", 16))
"""The contact of a vertex and of the edge that ends there (``_between``) with an obstacle.

force, friction        λ and q
rubbed_normal, rubbed_place  for friction, where a round does not change them: the normals, and the place on the edge
kept_between           one where the edge has a contact until the round ends, wherever its nearest point goes
value, normal, curvature  φ, ∇φ and ∇∇φ at the vertex
nearest_point          of the edge: s, φ* and its normal, and ``acts_between``, one where it has a contact
sagging                by how much the edge is nearer there than at its ends
nearest                one number for all rods of the pack: how far the nearest is from being close
pushes                 one where the contact pushed in the last trip (:meth:`.ContactEnergy.take_met`)"""
REMEMBERED, FORCES, REMEMBERED_IN_MOTION = (CONTACT.at(first) for first in ("friction", "rubbed_normal", "value"))
"""Numbers of a contact that last from one relaxation to the next, those that are forces, those that last from step to step."""

# --- the contact of a rod with itself, after those with obstacles: of the rod, of its vertices, of pairs of its edges, and the
# dense Newton system (:class:`.DenseFactors`) ---

ITSELF = Layout(coefficient=1, weights=4, slopes=24, ends=("weights", 28), pinched=1)
"""coefficient  of friction on itself
ends         of the two edges that are looked at: the weights of their four ends, and the mixed derivatives of their distance by
             these and by the places on both edges
pinched      the least gap of two edges that clamps hold"""
ITSELF_VERTEX = Layout(load=3, pull=3, move=3, arc=1)
"""The gradient of all energies of places, the part of it from the rod's contact with itself, the displacement that the next
step means, and the length of the rod before."""
PAIR = Layout(force=1, friction=3, rubbed_normal=3, rubbed_places=2, remembered=("force", 9), distance=1, distance_standing=1,
              places=2, normal=3, nearest=("places", 5), may_touch=1)
"""Of edges i < j, number j (j − 1)/2 + i.

remembered          force and friction, the normal of its plane and the places on both edges at which it acts
distance            of the edges, or a bound below it, now and before the step
nearest             the places on both, and the gradient of the distance
may_touch           in a group, one where they may"""
PAIR_FORCES, PAIR_REMEMBERED, PAIR_CARRIED = (PAIR.at(first) for first in ("rubbed_normal", "distance", "places"))
"""Numbers of a pair that are forces, that last from one step to the next, and from one launch to the next."""

ROUNDED = 2e-3
"""Squared radii by which a place on an edge is drawn to the middle of the edge, so that the nearest places of parallel edges
are unique: a distance of two radii becomes larger by at most 2.5e-4 of a radius."""
REACH = 3.0  # radii between centrelines: within them the nearest places of two edges are computed
DEEPEST_STEP = 0.1  # radii between centrelines: no step brings two edges nearer
LEAST_DISTANCE = 1e-3  # radii: a start whose centreline is nearer to itself does not say which side is which

# --- the numbers that rounds and steps go by ---

ROUGH, FINE = 1.0, 0.0  # phases of a rod: rounds to a rough tolerance of its moments, and rounds to the final one

SEARCHES = 48  # evaluations, at most, to find the point of an edge that is nearest to an obstacle
EVEN = 1e-5
"""Of a radius: that times (s − ½)² is added to φ along an edge, s from 0 to 1, so that an edge that lies flat on a face has one
nearest point, which moves continuously. Gaps are off by at most a quarter of it."""
BENDING_LOADS, LOOP_LOADS = 20.0, 200.0
"""The forces to expect are the weight of an edge and so many B/L²; more where rods touch themselves, which are bent to loops.
With 20 there, too, loops are pressed so far into each other that a knot slips over an end of its rod."""
SOFT = 0.1  # of a radius: at first κ gives way by that under such a force
FAINT = 1e-3  # of such a force: friction of a rod whose forces are all smaller is as exact as one of that
PRESSED_IN = 0.3
"""Of a radius: the most by which κ gives way under the largest force at the end of a round, so that forces end where contact
does. In a step, which is as large as its share of each gap plus that (:meth:`.ContactRounds.approach`): at a closed gap 0.6
of it may be pressed in. Of the way to the middle of an obstacle: the most by which κ first gives
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
CLOSE = 4.0  # radii: what is further from an obstacle than that, and half an edge, is not close
ROUGHER = 3e-3  # the residual to reach until the forces of contacts have settled

SHORTENED, PART, SHIFT_GROWTH = 0.8, 0.3, 10.0
"""A step of which a smaller share than SHORTENED was taken does not make the shift smaller; the part of it that is tried after
it was refused; and by how much the shift then grows."""


@picked
def contact_items(edges, obstacles):
    """Numbers of a rod's contacts in scratch."""
    return len(CONTACTS) + obstacles * len(OBSTACLE) + (edges + 1) * (len(VERTEX) + obstacles * len(CONTACT))

@picked
def pair_items(edges):
    """Numbers of a rod's contact with itself in scratch, without the matrix."""
    return len(ITSELF) + (edges + 1) * len(ITSELF_VERTEX) + edges * (edges - 1) // 2 * len(PAIR)


@picked
def matrix_items(lines):
    """Numbers of a dense Newton system of so many ``lines`` of 3×3 blocks: the lower triangle of the matrix, row by row; three
    rows that are being eliminated, column by column; the inverse pivots; the right-hand side with the three columns of closure,
    row by row."""
    size = 3 * lines
    return size * (size + 1) // 2 + 3 * size + size + 4 * size


@dataclass(frozen=True)
class ContactTable:
    """What the kernels read of contacts, and what they leave.

    obstacles  (1 or R, M, OBSTACLE_COLUMNS)
    kinds      (M,) int32, and grids, see :func:`.grid_table`
    radius     (1 or R,) of the rods, mm
    near       (R,) bool: rods that can reach an obstacle
    memory     (R, V, M, REMEMBERED) forces of the contacts of vertices and edges, in and out; no rows while no rod is near
    forces     (R, V, 3) on the vertices, energy per mm, out; read-only zeros while no rod is near
    surroundings  as they were given
    self_friction  (1 or R,) the rods' coefficients of friction on themselves
    itself     whether the kernel is the one for rods that touch themselves
    pair_memory  (R, P, PAIR_CARRIED) of their P pairs of edges, from launch to launch; one number where there is one launch
    rod_memory  (R, CARRIED_ON) other numbers of the rods, from launch to launch of a motion
    """

    obstacles: np.ndarray
    kinds: np.ndarray
    grids: np.ndarray
    radius: np.ndarray
    near: np.ndarray
    memory: np.ndarray
    forces: np.ndarray
    surroundings: Surroundings
    self_friction: np.ndarray
    itself: bool = False
    pair_memory: np.ndarray = field(default_factory=lambda: np.zeros((1, 1, 1)))
    rod_memory: np.ndarray = field(default_factory=lambda: np.zeros((1, 1)))

    @property
    def rubs(self) -> bool:
        """Whether there is any friction."""
        return bool((self.obstacles[..., FRICTION] > 0).any()) or self.itself and bool((self.self_friction > 0).any())

    @property
    def has_grid(self) -> bool:
        """Whether an obstacle is a grid."""
        return bool((self.kinds >= GRID).any())

    def arguments(self, forces: np.ndarray, tolerance: float | None, in_motion: bool = False) -> dict:
        """What a kernel is given of contacts, which writes ``forces``; ``tolerance`` of gaps, None: the usual one."""
        return {"obstacles": self.obstacles, "kinds": self.kinds, "grids": self.grids, "radius": self.radius,
                "tolerance": gap_tolerance(tolerance, self.itself, in_motion), "memory": self.memory, "forces": forces,
                "self_friction": self.self_friction}

    def copy(self) -> "ContactTable":
        """The table with a memory and forces of its own, which a launch changes."""
        forces = self.forces.copy() if self.forces.flags.writeable else self.forces
        return replace(self, memory=self.memory.copy(), forces=forces)

    def touching(self, rows: np.ndarray) -> "ContactTable":
        """The table as the kernel of rods that touch themselves takes it; the rods ``rows`` have touched nothing yet."""
        if not len(self.memory):
            return replace(self, itself=True, memory=np.zeros((len(self.near), *self.memory.shape[1:])),
                           forces=np.zeros(self.forces.shape))
        self.memory[rows] = 0.0
        return replace(self, itself=True)

    @property
    def for_launches(self) -> "ContactTable":
        """The table of rods that touch themselves, for a motion in several launches."""
        edges = self.memory.shape[1] - 1
        return replace(self, pair_memory=np.zeros((len(self.near), edges * (edges - 1) // 2, PAIR_CARRIED)))

    @property
    def smooth(self) -> "ContactTable":
        """The table without friction."""
        obstacles = self.obstacles.copy()
        obstacles[..., FRICTION] = 0.0
        return replace(self, obstacles=obstacles, self_friction=np.zeros_like(self.self_friction))

    def contacts(self, vertices: np.ndarray, force: np.ndarray) -> Contacts:
        """The contacts of rods at ``vertices`` (R, V, 3) that bear ``force`` (R, V, 3)."""
        return Contacts(force, vertices, self.surroundings)

    def begin_with(self, before: "ContactTable | None", rods: np.ndarray) -> None:
        """Make the rods (R,) of a table with the same obstacles, friction apart, begin with the forces with which they have
        ended there."""
        if (before is None or before.memory.shape != self.memory.shape or not np.array_equal(before.kinds, self.kinds)
                or not np.array_equal(before.obstacles[..., :FRICTION], self.obstacles[..., :FRICTION])):
            return
        both = rods & self.near & before.near
        rows = slice(None) if both.all() else np.flatnonzero(both)  # a slice copies four times as fast
        self.memory[rows] = before.memory[rows]
        if self.pair_memory.shape == before.pair_memory.shape and len(self.pair_memory) == len(both):
            self.pair_memory[rows] = before.pair_memory[rows]

    def forget(self, rows: np.ndarray) -> None:
        """Make the rods ``rows`` ones that have touched nothing yet."""
        self.memory[rows[self.near[rows]]] = 0.0


def contact_table(surroundings: Surroundings, count: int, edges: int, clamp: np.ndarray, index: np.ndarray,
                  in_motion: bool = False) -> ContactTable:
    """The table of ``count`` rods of ``edges`` edges, whose rows of ``clamp`` are ``index``. ``in_motion``: the memory also
    holds friction, and every rod counts as near. Raises InputError as :func:`require_margin` does."""
    radius, obstacles = surroundings.radius, surroundings.bodies
    require_margin(obstacles, radius.max())
    # Grippers may carry any rod to an obstacle.
    near = np.ones(count, dtype=bool) if in_motion else _near(obstacles, radius, clamp, index)
    # Where no rod is near, nothing is written to either before rods touch themselves.
    rows = count if near.any() else 0
    memory = np.zeros((rows, edges + 1, max(1, len(obstacles)), REMEMBERED_IN_MOTION if in_motion else REMEMBERED))
    forces = np.broadcast_to(0.0, (count, edges + 1, 3)) if not rows else np.zeros((count, edges + 1, 3))
    kinds, grids = grid_table(obstacles)
    return ContactTable(
        obstacles=obstacle_table(obstacles), kinds=kinds, grids=grids, radius=radius, near=near, memory=memory, forces=forces,
        surroundings=surroundings, rod_memory=np.zeros((rows, len(CARRIED_ON))),
        self_friction=np.zeros(1) if surroundings.itself is None else surroundings.itself.friction)


def require_margin(obstacles: Sequence[Obstacle], radius: float) -> None:
    """Raise InputError where a grid ends nearer to its obstacle than the diameter of a rod of that ``radius``."""
    for obstacle in obstacles:
        if isinstance(obstacle, DistanceGrid) and obstacle.border < 2 * radius:
            raise InputError("contact", "obstacles", f"a grid ends {obstacle.border:g} mm from its obstacle, less than a rod's "
                             f"diameter of {2 * radius:g} mm", "give a grid with a larger margin")


def require_clear(source: str, surroundings: Surroundings, clamps: Clamps, start: Configuration, number: np.ndarray) -> None:
    """Raise InputError, naming ``source`` and the ``number`` (R,) of a rod, unless all rods can begin at ``start``: the clamps
    hold them outside the obstacles with their radius, and no vertex is inside one."""
    x = start.vertices
    ends = np.stack([clamps.start_position, clamps.end_position], axis=1)
    inner = ends + np.diff(x, axis=1)[:, [0, -1]] * [[1.0], [-1.0]]
    kinds = np.stack([np.broadcast_to(kind, len(x)) for kind in (clamps.start, clamps.end)], axis=1)
    radius = np.reshape(surroundings.radius, (-1, 1)) * (1.0 - GAP_TOLERANCE)
    for what, places, used, least in (
            ("the clamp of", ends, kinds >= Clamp.POSITION, radius), ("the clamp of", inner, kinds >= Clamp.TANGENT, radius),
            ("the centreline of", x[:, 1:-1], True, 0.0)):
        for obstacle in surroundings.bodies:
            gap = np.where(used, obstacle.distance(places)[0] - least, np.inf)
            worst = np.unravel_index(np.argmin(gap), gap.shape)
            if gap[worst] < 0:
                lies = np.any(used) and gap[worst] > -np.max(surroundings.radius)
                raise InputError(source, "obstacles", f"{what} rod {number[worst[0]]} is {-gap[worst]:.3g} mm inside a "
                                 f"{type(obstacle).__name__}", "correct the obstacle's place, or give a smaller `radius`"
                                 + ", or a free end (`clamp_end`) where the rod only lies" * bool(lies))


def _near(obstacles: Sequence[Obstacle], radius: np.ndarray, clamps: np.ndarray, index: np.ndarray) -> np.ndarray:
    """(R,) whether a rod can reach an obstacle: no part of it is further from where it is held than its length, or from the
    middle of where both its ends are held than half of that."""
    if not obstacles:
        return np.zeros(len(index), dtype=bool)
    anchor, total = clamps[:, of.ANCHOR : of.ANCHOR + 3], clamps[:, of.TOTAL]
    near = (clamps[:, of.LOOSE] > 0)[index]
    if len(anchor):
        # First all rods at once, as one ball. (A reduction along the first axis would take seven times as long.)
        low, high = (np.array([least(column) for column in anchor.T]) for least in (np.min, np.max))
        middle, whole = 0.5 * (low + high), 0.5 * np.linalg.norm(high - low) + 1.001 * total.max() + radius.max()
        obstacles = [obstacle for obstacle in obstacles if not (obstacle.distance(middle[None, None])[0] > whole).all()]
    if not obstacles:
        return near
    both = (clamps[:, of.CLOSED] > 0) | (clamps[:, of.TILT_INNER] == 0)
    centre = anchor + np.where(both[:, None], 0.5 * clamps[:, of.TARGET : of.TARGET + 3], 0.0)
    reach = 1.001 * np.where(both, 0.5 * total, total)
    centre, reach = centre[index], reach[index] + radius
    for obstacle in obstacles:
        if near.all():
            break
        # Of an obstacle that all rods share, all points at once.
        points = centre[None] if obstacle.count == 1 else centre[:, None]
        near = near | ~(obstacle.distance(points)[0].reshape(-1) > reach)
    return near
