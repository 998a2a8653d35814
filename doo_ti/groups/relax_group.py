"""F for groups: rods that touch each other or are tied together, relaxed to one minimum of their joint energy
(docs/groups.md). Axes: N groups, G rods in each, K ties, V vertices of a rod.

    group = Group([first, second], material, [first_clamps, second_clamps], [Tie((0, 20), (1, 0))])
    solution = relax_group(group, radius=2.0)
    solution.rods[0].vertices       # (N, V, 3) mm
    solution.tie_force              # (N, K, 3)
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from doo_ti.contact.obstacles import Obstacle
from doo_ti.contact.surroundings import Surroundings
from doo_ti.groups.group import Group
from doo_ti.groups.group_newton import GroupState, GroupTables, run_groups
from doo_ti.groups.group_tables import evened_group, group_tables, smallest_gap
from doo_ti.relaxation import tables as of
from doo_ti.relaxation.batch import UNTOUCHED
from doo_ti.relaxation.contact_table import ContactTable
from doo_ti.relaxation.input_tables import RATIOS
from doo_ti.relaxation.newton import MOST_IN_CONTACT, Newton
from doo_ti.rod.frames import matrix_from_quaternion
from doo_ti.rod.types import Configuration, Status, unit_up
from doo_ti.system import runtime
from doo_ti.system.arguments import typed
from doo_ti.system.errors import InputError


@dataclass(frozen=True)
class GroupSolution:
    """The result of :func:`relax_group`: one entry per group. Forces are energy (mm²) per mm, as those of ``Solution``; times
    ``group.newton`` they are in N, where weights per length are known, and moments times 1e-3 ``group.newton`` in N m.

    group          the input, with the relaxed rods for its starts
    energy         (N,) of all rods, and of what ties carry, gravity measured from z = 0
    kinetic        (N,) their kinetic energy, zero without inertia
    residual       (N,) the largest moment left on a free edge times the length of the longest rod, over the largest eigenvalue
                   of B (no unit)
    closure        (N,) the most by which a tie or the end of a rod misses its place, over that length, or a weld its rotation,
                   rad
    iterations     (N,) of the solver
    status         (N,) Status
    stable         (N,) True where the pivots of the Newton matrix, ties and contacts included, certify a minimum. Motions at no
                   cost, such as that of a loop about a nail, count as stable
    tie_force      (N, K, 3) of each tie on its ``first`` vertex; on the other the opposite
    tie_moment     (N, K, 3) the same of welds' moments on the edge at ``first``, energy (mm²)
    start_force    (N, G, 3) of the clamps on the rods' starts; zero where these are free
    end_force      (N, G, 3) the same of the far ends
    contact_force  G arrays (N, V, 3): of obstacles and of other edges on the vertices
    touch          G arrays (N, V): the :class:`.Touch` of each vertex and the edge that ends there
    friction_work  (N,) energy that friction has taken since ``before``, mm²
    gap            (N,) mm, the smallest between surfaces that may touch; infinite where there are none
    """

    group: Group
    energy: np.ndarray
    kinetic: np.ndarray
    residual: np.ndarray
    closure: np.ndarray
    iterations: np.ndarray
    status: np.ndarray
    stable: np.ndarray
    tie_force: np.ndarray
    tie_moment: np.ndarray
    start_force: np.ndarray
    end_force: np.ndarray
    contact_force: tuple[np.ndarray, ...]
    touch: tuple[np.ndarray, ...]
    friction_work: np.ndarray
    gap: np.ndarray

    @property
    def rods(self) -> Sequence[Configuration]:
        """G relaxed rods, with N rows each."""
        return self.group.rods

    @property
    def converged(self) -> np.ndarray:
        """(N,) bool: whether each group has converged."""
        return self.status == Status.CONVERGED

    def __repr__(self) -> str:
        return (f"GroupSolution({self.group!r}: {int(self.converged.sum())} converged; {int(self.stable.sum())} certified "
                f"stable)")


@typed
def relax_group(group: Group, solver: Newton | None = None, *, up: ArrayLike | None = None,
                obstacles: Sequence[Obstacle] = (), radius: ArrayLike | None = None, contact: bool = True,
                before: GroupSolution | None = None) -> GroupSolution:
    """Relax the rods of N groups, in f64, each group to a minimum of the energy of all its rods.

    solver     Newton(max_iterations=1000) unless given: points far apart are drawn together in many steps
    up         (3,) direction against gravity, (0, 0, 1) unless given
    obstacles  what the rods may touch but not enter, each with one row or N. ``Itself(friction=…)`` among them is the friction
               of the rods on each other and on themselves
    radius     of the rods, mm: one, (N,), or (1 or N, G) where those of a group differ. With it the rods touch each other and
               themselves, and never pass through each other; without it they only do what their ties mean
    contact    False: they do not touch each other nor themselves, only obstacles
    before     the solution of these groups at the moment before. Friction acts on the way from there, and only then. Its forces
               of ties and clamps are those to begin with, which also takes fewer iterations

    Beside a tie rods do not touch each other: where both are within π mean radii of it along them. Ties whose points are
    apart at the start are closed. Starts whose centrelines are inside obstacles or within a tenth of the smallest radius of
    each other, and clamps further apart than a rod, or rods and ties between them, are long, are INFEASIBLE, and NaN everywhere
    else.

    Raises InputError for inputs that do not match.
    """
    return relaxed(group, solver, up, obstacles, radius, contact, before)[0]


@runtime.exclusive
def relaxed(group: Group, solver: Newton | None, up: ArrayLike | None, obstacles: Sequence[Obstacle], radius: ArrayLike | None,
            contact: bool, before: GroupSolution | None, motion=None, follows: bool = False,
            contacts_before: ContactTable | None = None) -> tuple[GroupSolution, ContactTable]:
    """:func:`relax_group`, or the first moment or a time step of groups in ``motion`` (:class:`.MovingGroups`), and its
    contacts. Where another moment ``follows``, that may begin with them."""
    with np.errstate(all="ignore"):  # a group that is not finite has a status; NumPy need not warn
        up = unit_up((0.0, 0.0, 1.0) if up is None else up, "relax_group")
        table = group_tables(group if motion is None else motion.stiffened(group), up, obstacles, radius, contact,
                             motion is not None and motion.moves)
        table = table if motion is None else motion.into(table)
        table = replace(table, contact=table.contact.for_launches) if follows else table
        tie_forces = np.zeros((group.count, len(table.ties), 6)) if before is None else _forces(group, before)
        results, edges = np.zeros((group.count, of.LOADED_RESULTS)), table.start.shape[1]
        results[~table.feasible, : of.RESULTS] = UNTOUCHED
        state = GroupState(np.full((group.count, edges, 4), np.nan), results, table.begins_at.copy(), tie_forces,
                           table.contact.forces, np.zeros((group.count, edges + 1), dtype=np.int32), np.zeros(group.count))
        if before is None:  # friction acts on the way from there
            table, previous = replace(table, contact=table.contact.smooth), np.zeros_like(state.forces)
        else:
            # Where the vertices were at the moment before or, where there was no place for them, where they start.
            then, now = (np.concatenate([rod.vertices for rod in rods], axis=1) for rods in (before.rods, group.rods))
            previous = np.ascontiguousarray(np.where(np.isfinite(then), then, now))
            table.contact.begin_with(contacts_before, before.converged)
        solver = Newton(max_iterations=MOST_IN_CONTACT) if solver is None else solver
        _through_ratios(table, solver, state, previous, RATIOS if before is None else ())
        solution = _solution(group, table, state)
        return solution if motion is None else motion.reached(solution, table), table.contact


def _through_ratios(table: GroupTables, solver: Newton, state: GroupState, previous: np.ndarray,
                    ratios: Sequence[float]) -> None:
    """Relax all feasible groups, in place; those with uneven rods, as :func:`.relax` does, with these made even to one of the
    ``ratios`` after the other first."""
    rows = table.feasible
    for ratio in (*ratios, np.inf):
        even, later = evened_group(table, ratio) if ratio < np.inf else (table, np.zeros(len(rows), dtype=bool))
        spent = state.results[:, of.ITERATIONS].copy()
        run_groups(even, solver, state, previous, np.flatnonzero(rows))
        state.results[rows, of.ITERATIONS] += spent[rows]
        rows = later & np.isin(state.results[:, of.STATUS], (Status.CONVERGED, Status.STALLED, Status.ITERATION_LIMIT))
        if not rows.any():
            return
        table = replace(table, start=np.where(rows[:, None, None], state.frames, table.start))


def weights_at_vertices(table: GroupTables) -> np.ndarray:
    """(N, V) energy per mm by which the weight pulls at each vertex."""
    return table.material[:, of.WEIGHT, None] * table.burden[..., 0]


def _forces(group: Group, before: GroupSolution) -> np.ndarray:
    """(N, -, 3) forces of the kernel's ties in a solution. Raises InputError where that is of other groups."""
    if before.tie_force.shape[:2] != (group.count, len(group.ties)) or (
            before.end_force.shape[1] != len(group.rods)):
        raise InputError("relax_group", "before", f"{before!r}", f"give a solution of {group!r}")
    forces = np.zeros((group.count, len(group.ties) + 2 * len(group.rods), 6))
    forces[..., :3] = np.concatenate([before.tie_force * _sign(group), -before.end_force, -before.start_force], axis=1)
    for number, frames in _welded_frames(before.group).items():
        forces[:, number, 3:] = -_sign(group)[number] * np.einsum("nji,nj->ni", frames[0], before.tie_moment[:, number])
    return np.nan_to_num(forces)


def _welded_frames(group: Group) -> dict[int, tuple[np.ndarray, np.ndarray]]:
    """The frames (N, 3, 3) of both edges of each weld, the later first."""
    frames = [part for rod in group.rods for part in (rod.frames, np.zeros((group.count, 1, 3, 3)))]  # and of breaks any
    chain = np.concatenate(frames, axis=1)
    return {number: (chain[:, late], chain[:, early]) for number, (late, early) in group.welded.items()}


def _sign(group: Group) -> np.ndarray:
    """(K, 1) of the force on the first vertex of a tie: the kernel's acts on the later of both."""
    return np.where(group.tied[:, :1] > group.tied[:, 1:], -1.0, 1.0)


def _solution(group: Group, table: GroupTables, state: GroupState) -> GroupSolution:
    clamp, up, places, tie_forces = table.clamp, table.up, state.places, state.tie_forces
    frames, results = state.frames, state.results
    status = results[:, of.STATUS].astype(np.int8)
    lost = (status == Status.INFEASIBLE) | (status == Status.NOT_FINITE)
    places[:, 0] = clamp[:, of.ANCHOR : of.ANCHOR + 3] + results[:, of.DRIFT:]
    places[lost], tie_forces[lost], frames[lost] = np.nan, np.nan, np.nan
    first = group.first_vertices
    rods = []
    for number, rod in enumerate(group.rods):
        own = np.ascontiguousarray(frames[:, first[number] : first[number] + rod.edges])
        rods.append(Configuration(places[:, number].copy(), own, np.array(rod.rest_length, dtype=np.float64)))
    vertices = np.concatenate([rod.vertices for rod in rods], axis=1)
    contact_force = np.where(lost[:, None, None], np.nan, state.forces)
    weight = weights_at_vertices(table)
    height = (clamp[:, of.ANCHOR : of.ANCHOR + 3] * up).sum(axis=1)
    ties, far = table.ties, len(group.ties)
    starts = far + len(rods)
    springs = table.burden[..., 6:] * (table.burden[..., 3:6] - vertices)  # of inertia and drag
    pull = contact_force - weight[..., None] * up + springs
    miss = np.zeros((group.count, len(ties)))
    for number, (vertex, other) in enumerate(ties[:, :2]):
        force = tie_forces[:, number, :3] * table.targets[:, number, 3:4]
        pull[:, vertex] -= force if number < starts else 0.0
        held_at = table.targets[:, number, :3]
        if other >= 0:
            pull[:, other] += force
            held_at = vertices[:, other]
        miss[:, number] = np.linalg.norm(vertices[:, vertex] - held_at, axis=1) * table.targets[:, number, 3]
    held_so = tuple(clamps.take(np.arange(group.count)) for clamps in group.clamps)
    result, moment = replace(group, rods=tuple(rods), clamps=held_so), np.zeros((group.count, far, 3))
    for number, (late, early) in _welded_frames(result).items():
        moment[:, number] = -_sign(group)[number] * np.einsum("nij,nj->ni", late, tie_forces[:, number, 3:])
        rest = matrix_from_quaternion(table.targets[:, number, 4:8])
        apart = np.einsum("nji,njk->nik", late, early) - rest
        miss[:, number] = np.maximum(miss[:, number], np.linalg.norm(apart, axis=(1, 2)) / np.sqrt(2.0) * clamp[:, of.TOTAL])
    held = np.stack([np.broadcast_to(np.asarray(clamps.start) > 0, (group.count,)) for clamps in group.clamps], axis=1)
    start_force = -np.stack([own.sum(axis=1) for own in group.by_rod(pull)], axis=1) * held[..., None]
    gap = smallest_gap(vertices, table.apart, group.at_vertices(table.radii))
    for rod, radius in zip(rods, table.radii.T, strict=True):
        gap = np.minimum(gap, Surroundings(table.contact.surroundings.bodies, radius).smallest_gap(rod.vertices))
    return GroupSolution(
        group=result, energy=results[:, of.ENERGY] + weight.sum(axis=1) * height, kinetic=np.where(lost, np.nan, 0.0),
        residual=results[:, of.RESIDUAL], closure=np.where(lost, np.nan, miss.max(axis=1) / clamp[:, of.TOTAL]),
        iterations=results[:, of.ITERATIONS].astype(np.int32), status=status,
        stable=(results[:, of.STABLE] == 1) & (status == Status.CONVERGED),
        tie_force=tie_forces[:, :far, :3] * _sign(group), tie_moment=moment, start_force=start_force,
        end_force=-tie_forces[:, far:starts, :3], contact_force=group.by_rod(contact_force),
        touch=group.by_rod(np.where(lost[:, None], 0, state.touch).astype(np.int8)),
        friction_work=np.where(lost, np.nan, state.friction_work), gap=np.where(lost, np.nan, gap))
