"""Groups whose clamps move: one relaxation after the other, each from where the one before ended (docs/groups.md).

With inertia each is a time step: as for single rods (:mod:`doo_ti.relaxation.time_sweep`), what it adds to the energy is a
spring at every vertex and, with damping, stiffer joints with a rest curvature and twist of their own. Axes: N groups, G rods,
V vertices of all rods, E edges of their chain, breaks included.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from doo_ti.contact.obstacles import Obstacle
from doo_ti.dynamics.energies import Losses, damping_shares, joint_strains, stiffened, vertex_numbers
from doo_ti.dynamics.parameters import GRAVITY, RATES, Dynamics, Stepping
from doo_ti.groups.group import Group
from doo_ti.groups.group_newton import GroupTables
from doo_ti.groups.relax_group import GroupSolution, relaxed, weights_at_vertices
from doo_ti.groups.ties import JOINT_ITEMS, TWIST
from doo_ti.relaxation import tables as of
from doo_ti.relaxation.newton import Newton
from doo_ti.relaxation.time_sweep import DRAG, DRAG_BY_SPEED, INERTIA, LOAD
from doo_ti.rod.types import Clamps, Configuration, Status, put_rods, sticky
from doo_ti.system.arguments import typed
from doo_ti.system.errors import InputError

FORCES = ("tie_force", "tie_moment", "start_force", "end_force")
"""Those of a solution that the next moment begins with."""


@typed
def follow_group(group: Group, clamps: Sequence[Sequence[Clamps]], solver: Newton | None = None, *, up: ArrayLike | None = None,
                 obstacles: Sequence[Obstacle] = (), radius: ArrayLike | None = None, contact: bool = True,
                 dynamics: Dynamics | Sequence[Dynamics] | None = None, rate: float | None = None,
                 scheme: str | None = None
                 ) -> Iterator[GroupSolution]:
    """The solutions of groups at every moment of a motion, as they are found.

    clamps    of every moment those of G rods, with N rows each; how they hold an end may change, too
    dynamics  mass, damping and drag of the rods, one for all or one for each: they have inertia then, and begin at rest at
              their minimum at the first moment. None: every moment is a minimum
    rate      moments per second, where the rods have inertia. The way from each to the next is one time step
    scheme    "bdf2", of second order, or "euler"; None: the first, but "euler" among obstacles, off which groups else bounce
    the others as :func:`.relax_group` has them

    Friction acts from the first moment on, at which there is none. The rods of a group are drawn from one moment to the next
    and pass through nothing on the way, but frames of clamps turn at once: give moments between which they turn by less than
    the rods bend. A group that has not converged at a moment, where its rods may be inside each other, goes on from the last
    one at which it had; one with inertia keeps that status from then on.

    Raises InputError as :func:`.relax_group` does, and for ``dynamics`` that do not match.
    """
    if (dynamics is None) != (rate is None):
        missing, other = ("rate", "dynamics") if rate is None else ("dynamics", "rate")
        raise InputError("follow_group", missing, f"missing beside {other}", "give both, or neither")
    scheme = scheme or ("euler" if len(obstacles) else "bdf2")
    motion = None if dynamics is None else MovingGroups(group, dynamics, Stepping(rate, scheme=scheme).step, scheme)
    before, contacts = None, None
    for held in clamps:
        group = replace(group, clamps=held)
        found, contacts = relaxed(group, solver, up, obstacles, radius, contact, before, motion, follows=True,
                                  contacts_before=contacts)
        yield found
        lost = np.flatnonzero(~found.converged)
        group = replace(group, rods=[put_rods(now, lost, last.take(lost))
                                     for now, last in zip(found.rods, group.rods, strict=True)])
        before = replace(found, group=replace(found.group, rods=group.rods), **{
            name: np.where(found.converged[:, None, None], getattr(found, name), 0.0) for name in FORCES})


class MovingGroups:
    """N groups at their last two instants. The first that they remember is one at rest; before that they do not move.

    group     the groups, with their own materials
    dynamics  one for all rods, or G of them, whose densities are relative to the weight of their own material
    step      h, s
    scheme    "bdf2" or "euler"

    Raises InputError where numbers of rows do not match, or a rod has no mass.
    """

    def __init__(self, group: Group, dynamics: Dynamics | Sequence[Dynamics], step: float, scheme: str):
        factor = RATES[scheme]
        self.rate, self.extrapolation = factor / step, (factor - 1.0) / factor
        self.group = group
        self.dynamics = _each(dynamics, group)
        numbers, self.losses = [], []
        rows = np.arange(group.count)
        for rod, (start, material, own) in enumerate(zip(group.rods, group.each_material, self.dynamics, strict=True)):
            lengths = np.broadcast_to(start.rest_length, (group.count, start.edges))
            of_rod = vertex_numbers(f"follow_group: rod {rod}", material, own, lengths, rows % material.count, self.rate)
            numbers.append(of_rod)
            self.losses.append(Losses.of(material, own, rows % material.count, lengths, of_rod, self.rate, np.zeros(3)))
        self.numbers = np.concatenate(numbers, axis=1)
        for tie, (vertex, _) in zip(group.ties, group.tied, strict=True):
            self.numbers[:, vertex, 0] += tie.weight / GRAVITY * self.rate**2
        self.moves, self.status = False, np.full(group.count, Status.CONVERGED, dtype=np.int8)
        place, bent = self._seen(group.rods)
        self._rest_at(place, bent)

    def _rest_at(self, place: np.ndarray, bent: list[np.ndarray]) -> None:
        """Make both instants those of groups at rest there, with these strains."""
        self.places, self.velocities = (place, place), (np.zeros_like(place), np.zeros_like(place))
        self.strains = [(own, own) for own in bent]

    def stiffened(self, group: Group) -> Group:
        """These groups with the stiffness that damping adds."""
        if not self.moves:
            return group
        parts = zip(group.each_material, self.dynamics, strict=True)
        return replace(group, materials=[stiffened(material, own, self.rate) for material, own in parts])

    def _springs(self) -> tuple[np.ndarray, np.ndarray]:
        """(point (N, V, 3) mm, stiffness (N, V) energy over mm²) of the next step."""
        last, before = self.velocities
        carried = self._extrapolated(self.places)
        ahead = carried + self._extrapolated(self.velocities) / self.rate
        speed = np.linalg.norm(2.0 * last - before, axis=-1)
        inertia = self.numbers[..., 0]
        drag = self.numbers[..., DRAG - INERTIA] + self.numbers[..., DRAG_BY_SPEED - INERTIA] * speed
        stiffness = inertia + drag
        massless = stiffness == 0  # vertices at the far side of edges without length
        pull = inertia[..., None] * ahead + drag[..., None] * carried
        return pull / np.where(massless, 1.0, stiffness)[..., None], stiffness

    def _extrapolated(self, values: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
        """y(u) of the values at the last instant and at the one before."""
        return values[0] + self.extrapolation * (values[0] - values[1])

    def _rest(self) -> np.ndarray:
        """(N, E, JOINT_ITEMS) that damping adds to the joints where edges begin."""
        rest = np.zeros((self.group.count, self.numbers.shape[1] - 1, JOINT_ITEMS))
        parts = zip(self.group.first_vertices[:-1], self.strains, self.group.each_material, self.dynamics, strict=True)
        for first, bent, material, own in parts:
            bend, twist = damping_shares(own, material.count, self.rate).T[..., None, None]
            joints = rest[:, first + 1 : first + 1 + bent[0].shape[1]]
            joints[...] = self._extrapolated(bent)
            joints[..., :TWIST] *= bend
            joints[..., TWIST:] *= twist
        return rest

    def into(self, table: GroupTables) -> GroupTables:
        """The tables of the stiffened groups with the weight of point masses and what the next step adds."""
        load = self.numbers[..., LOAD - INERTIA]
        weight = np.broadcast_to(table.material[:, of.WEIGHT, None], load.shape)
        burden = table.burden.copy()
        burden[..., 0] += np.divide(load, weight, out=np.zeros_like(load), where=load > 0)
        if not self.moves:
            return replace(table, burden=burden)
        burden[..., 3:6], burden[..., 6] = self._springs()
        return replace(table, burden=burden, rest=self._rest())

    def remember(self, rods: Sequence[Configuration]) -> None:
        """Make ``rods`` the last instant. Groups that have failed stay where they were, at rest."""
        place, bent = self._seen(rods)
        lost = (self.status != Status.CONVERGED)[:, None, None]
        velocity = np.where(lost, 0.0, self.rate * (place - self._extrapolated(self.places)))
        last, place = self.places[0], np.where(lost, self.places[0], place)
        bent = [np.where(lost, own[0], now) for own, now in zip(self.strains, bent, strict=True)]
        if self.moves:
            self.places, self.velocities = (place, last), (velocity, np.where(lost, 0.0, self.velocities[0]))
            self.strains = [(now, own[0]) for own, now in zip(self.strains, bent, strict=True)]
        else:
            self._rest_at(place, bent)
        self.moves = True

    def reached(self, solution: GroupSolution, table: GroupTables) -> GroupSolution:
        """The solution of a time step, which becomes the last instant, with the energies of the rods alone. Groups that have
        failed keep the status of the step at which they did."""
        self.status = sticky(self.status, solution.status)
        solution = replace(solution, status=self.status, stable=solution.stable & (self.status == Status.CONVERGED))
        self.remember(solution.rods)
        elastic = sum(own.elastic(bent[0]).sum(axis=(1, 2)) for own, bent in zip(self.losses, self.strains, strict=True))
        square = (self.velocities[0] ** 2).sum(axis=-1)
        kinetic = 0.5 * (self.numbers[..., 0] * square).sum(axis=-1) / self.rate**2
        gravity = (weights_at_vertices(table) * (self.places[0] @ table.up)).sum(axis=1)
        lost = np.isnan(solution.kinetic)
        return replace(solution, energy=np.where(lost, np.nan, elastic + gravity), kinetic=np.where(lost, np.nan, kinetic))

    def _seen(self, rods: Sequence[Configuration]) -> tuple[np.ndarray, list[np.ndarray]]:
        """((N, V, 3) places, the strains of each rod)."""
        return (np.concatenate([rod.vertices for rod in rods], axis=1),
                [joint_strains(np.asarray(rod.quaternions, dtype=np.float64)) for rod in rods])


def _each(dynamics: Dynamics | Sequence[Dynamics], group: Group) -> list[Dynamics]:
    """G of them. Raises InputError for anything else."""
    found = [dynamics] * len(group.rods) if isinstance(dynamics, Dynamics) else dynamics
    if len(found) != len(group.rods):
        raise InputError("follow_group", "dynamics", f"{len(found)} for {len(group.rods)} rods",
                         "give one, or one for each rod")
    for rod, (own, material) in enumerate(zip(found, group.each_material, strict=True)):
        if own.count not in (1, material.count):
            raise InputError("follow_group", "dynamics", f"{own.count} rows for rod {rod}, its material has {material.count}",
                             "give one, or as many")
    return [own if own.density is None else replace(own, density=own.density * unit)
            for own, unit in zip(found, group.units, strict=True)]
