"""The obstacles of many rods as tables, and which of the rods can reach any (docs/contact.md)."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from doo_ti.contact.contacts import Contacts
from doo_ti.contact.distance_grid import DistanceGrid, grid_table
from doo_ti.contact.obstacles import FRICTION, GRID, Obstacle, obstacle_table
from doo_ti.contact.surroundings import Surroundings
from doo_ti.contact.touch import GAP_TOLERANCE, gap_tolerance
from doo_ti.relaxation import tables as of
from doo_ti.relaxation.contact_layout import CARRIED_ON, PAIR_CARRIED, REMEMBERED, REMEMBERED_IN_MOTION
from doo_ti.rod.types import Clamp, Clamps, Configuration
from doo_ti.system.errors import InputError


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
    def known(self) -> frozenset[int]:
        """The kinds that a kernel is to know: all, so that a scene with other obstacles needs no other kernel, but grids only
        where there are any, since kernels with them take longer to compile."""
        return frozenset(range(GRID)) | frozenset(np.minimum(self.kinds, GRID).tolist())

    def arguments(self, forces: np.ndarray, tolerance: float | None, in_motion: bool = False) -> tuple:
        """What a kernel is given of contacts, which writes ``forces``; ``tolerance`` of gaps, None: the usual one."""
        tolerance = gap_tolerance(tolerance, self.itself, in_motion)
        return (self.obstacles, self.kinds, self.grids, self.radius, tolerance, self.memory, forces, self.self_friction)

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
        """Make the rods (R,) of a table with the same obstacles begin with the forces with which they have ended there."""
        if (before is None or before.memory.shape != self.memory.shape or not np.array_equal(before.kinds, self.kinds)
                or not np.array_equal(before.obstacles, self.obstacles)):
            return
        both = rods & self.near & before.near
        rows = slice(None) if both.all() else np.flatnonzero(both)  # a slice copies four times as fast
        self.memory[rows] = before.memory[rows]

    def forget(self, rows: np.ndarray) -> None:
        """Make the rods ``rows`` ones that have touched nothing yet."""
        self.memory[rows[self.near[rows]]] = 0.0


def contact_table(obstacles: Sequence[Obstacle], radius, count: int, edges: int, clamp: np.ndarray, index: np.ndarray,
                  in_motion: bool = False) -> ContactTable:
    """The table of ``count`` rods of ``edges`` edges, whose rows of ``clamp`` are ``index``. ``in_motion``: the memory also
    holds friction, and every rod counts as near.

    Raises InputError where numbers of rows do not match or ``radius`` is missing or not positive.
    """
    surroundings = Surroundings.checked("contact", obstacles, radius, count)
    radius = surroundings.radius
    obstacles = surroundings.bodies
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
                raise InputError(source, "obstacles", f"{what} rod {number[worst[0]]} is {-gap[worst]:.3g} mm inside a "
                                 f"{type(obstacle).__name__}", "correct the obstacle's place, or give a smaller `radius`")


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
