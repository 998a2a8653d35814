"""Newton's method on all groups at once: its kernel and its launch (docs/groups.md)."""

from dataclasses import dataclass
from functools import cache, partial

import numpy as np
import taichi as ti

from doo_ti.groups.group_contacts import GroupContacts
from doo_ti.groups.group_elimination import GroupElimination
from doo_ti.groups.ties import JointRest
from doo_ti.physics.number import Number
from doo_ti.relaxation import tables as of
from doo_ti.relaxation.batch import launch, layout_for, policy_row
from doo_ti.relaxation.contact_table import ContactTable
from doo_ti.relaxation.kernel_factory import INDEX1, INDEX2, TABLE1, TABLE3, loop_kernel
from doo_ti.relaxation.newton import EXTERNAL, NEWTON, OBSTACLES, Newton, NewtonLoop
from doo_ti.relaxation.newton_policy import LARGE_TRACE
from doo_ti.system import runtime


@dataclass(frozen=True)
class GroupTables:
    """What the kernel reads of N groups as chains of E edges, breaks included, and V = E + 1 vertices, all C-contiguous.

    start        (N, E, 4) frames; of a break any
    rest_length  (1 or N, E) mm, zero of a break
    clamp        (N, CLAMP_COLUMNS), material (1 or N, STIFFNESS + E · STIFFNESS_COLUMNS), see :mod:`.relaxation.tables`
    up           (3,)
    contact      obstacles, and the radius of the thinnest rod
    touching     whether anything may touch
    begins       (E,) int32: of a break the number of the rod behind it, else zero
    begins_at    (N, G, 3) mm, where the rods begin at the start
    ties         (K, 4) int32: the vertex that a tie holds, and the one before it that it is held at, or -1 for a place; and of
                 a weld the edges at both, the later first, else -1
    targets      (N, K, 9) the place, mm; one where there is this tie; the rest rotation of a weld, a quaternion; and the
                 stiffness, mm³, of the softer of its rods
    free         (N, E, 2) one where an edge may spin, and tilt; of a break twice whether the rod behind it may leave its begin
    burden       (N, V, 7) weight of a vertex as the length that the material's weight multiplies, mm; one where it is held; by
                 how much its rod is thicker than the thinnest, mm of radius; and of a spring its point, mm, and its stiffness,
                 energy over mm²
    rest         (1 or N, E, JOINT_ITEMS) rest curvature and twist besides the material's, of the joint where an edge begins
    apart        (1 or N, pairs) int32: one where two edges are so far apart along the rods that they may touch, pair
                 j (j − 1)/2 + i of i < j
    radii        (1 or N, G) mm
    feasible     (N,) bool
    """

    start: np.ndarray
    rest_length: np.ndarray
    clamp: np.ndarray
    material: np.ndarray
    up: np.ndarray
    contact: ContactTable
    touching: bool
    begins: np.ndarray
    begins_at: np.ndarray
    ties: np.ndarray
    targets: np.ndarray
    free: np.ndarray
    burden: np.ndarray
    rest: np.ndarray
    apart: np.ndarray
    radii: np.ndarray
    feasible: np.ndarray

    @property
    def borders(self) -> np.ndarray:
        """(-, 2) int32: the ties that there are in any group, and once more, with a one, those that are welds."""
        used = (self.targets[..., 3] > 0).any(axis=0)
        held, welds = np.flatnonzero(used), np.flatnonzero(used & (self.ties[:, 2] >= 0))
        return np.array([*((tie, 0) for tie in held), *((tie, 1) for tie in welds)], dtype=np.int32).reshape(-1, 2)


GROUPS = {
    "touching": ti.i32,
    "begins": INDEX1, "ties": INDEX2, "borders": INDEX2, "targets": TABLE3, "free": TABLE3, "burden": TABLE3, "apart": INDEX2,
    "places": TABLE3,  # [group, rod, 3] mm: where the rods begin, the first left out, in and out
    "tie_forces": TABLE3,  # [group, tie, 6] force, energy per mm, and moment in the axes of the later edge, in and out
    "previous": TABLE3,  # [group, vertex, 3] mm, at the moment before
    "touches": INDEX2,  # [group, vertex] out
    "pair_memory": TABLE3,  # [group, pair of edges, PAIR_CARRIED] in and out
    "works": TABLE1,  # [group] of friction, out
}
"""What the kernel is given besides what Newton's among obstacles is, as :class:`GroupTables` says."""


@cache
def group_kernel(number: Number, stride: int, block: int, has_grid: bool):
    """The kernel, compiled on first use, for one kind of number, with ``has_grid`` for grids."""
    loop = NewtonLoop(GroupElimination(number, stride, GroupContacts(number, has_grid, rub=True)))
    loop.trace = LARGE_TRACE
    return loop_kernel("newton_of_groups", number, NEWTON | EXTERNAL | OBSTACLES | GROUPS, loop, block, brief=True)


@dataclass(frozen=True)
class GroupState:
    """All that a launch changes, in place, N rows each: ``frames`` (N, E, 4) and ``results`` (N, LOADED_RESULTS), NaN and
    UNTOUCHED of infeasible groups; ``places`` (N, G, 3) mm, where the rods begin; ``tie_forces`` (N, K, 6); the ``forces``
    (N, V, 3) of contacts, those of the table; the :class:`.Touch` of vertices (N, V); and the work of friction
    (N,), energy in mm²."""

    frames: np.ndarray
    results: np.ndarray
    places: np.ndarray
    tie_forces: np.ndarray
    forces: np.ndarray
    touch: np.ndarray
    friction_work: np.ndarray


@runtime.exclusive
def run_groups(table: GroupTables, options: Newton, state: GroupState, previous: np.ndarray, rows: np.ndarray) -> None:
    """Relax the groups ``rows``, in place; friction acts from ``previous`` (N, V, 3) mm on, the vertices a moment before."""
    if not len(rows):
        return
    rods = of.rod_rows(rows, rows % len(table.material), rows, rows, rows % len(table.rest))
    contact = table.contact
    launch(layout_for(len(rows), 64, True), partial(group_kernel, has_grid=contact.has_grid),
           start=table.start.reshape(-1), rest_length=table.rest_length, clamp=table.clamp, material=table.material, rods=rods,
           policy=policy_row(table.up, options, 64), frames=state.frames.reshape(-1), results=state.results,
           numbers=table.rest, field=JointRest().field(), **contact.arguments(state.forces, options.gap_tolerance),
           touching=int(table.touching), begins=table.begins, ties=table.ties, borders=table.borders, targets=table.targets,
           free=table.free, burden=table.burden, apart=table.apart, places=state.places, tie_forces=state.tie_forces,
           previous=previous, touches=state.touch, pair_memory=contact.pair_memory, works=state.friction_work)
