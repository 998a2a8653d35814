"""Rods that grippers hold, between their ends as well (§VI): relaxed once, or as a batch that is stepped, for control loops.

    grip = Grip.where(rods, 12)                                     # vertex 12, where it is now
    held = relax_held(rods, material, clamps, [replace(grip, position=grip.position + [0, 0, 20])])
    held.solution.configuration, held.grip_loads().force            # R rods, (R, 1, 3)

    simulation = Simulation(rods, material, clamps)
    while …:
        state = simulation.step(clamps)                             # Solution: B rods at rest
    simulation.step(clamps, [Grip.where(state.configuration, 12)])  # a third gripper takes hold of vertex 12

A gripper holds a vertex, with the tangent and the roll there: its frame. The rod on either side is then a rod of its own that
ends in a clamp at this vertex, and nothing else connects both. A simulation is quasi-static: after every step each rod is at
rest on the branch that its clamps have carried it along, or where it has snapped to.

Axes: R or B rods, E edges, K grips, which are the same vertices of all rods.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from doo_ti.contact.obstacles import Obstacle
from doo_ti.contact.surroundings import Itself, Surroundings
from doo_ti.motion.path import LARGEST_TURN, motion_between
from doo_ti.relaxation.newton import Newton
from doo_ti.relaxation.relax import relax
from doo_ti.relaxation.sensitivity import end_loads
from doo_ti.rod.frames import (
    conjugate,
    is_rotation,
    quaternion_from_matrix,
    quaternion_product,
    rotation_matrix,
    rotation_vector,
)
from doo_ti.rod.types import Clamp, Clamps, Configuration, Material, Rows, Solution, finite_rods, put_rods, sticky, unit_up
from doo_ti.system.arguments import counted, short_repr, typed
from doo_ti.system.errors import InputError

LEAST_EDGES = 2  # between two places that are held


@typed
@dataclass(frozen=True)
class Grip:
    """A gripper that holds a vertex of R rods.

    vertex    which, from 1 to E − 1
    position  (R, 3) mm
    frame     (R, 3, 3) columns t, m1, m2: tangent and material directors there

    Raises InputError for numbers that are not finite and frames that are no rotations.
    """

    __repr__ = short_repr

    vertex: int
    position: Annotated[np.ndarray, "R 3", float]
    frame: Annotated[np.ndarray, "R 3 3", float]

    def __post_init__(self) -> None:
        if not np.isfinite(self.position).all():
            raise InputError("Grip", "position", "not finite", "give mm")
        if not np.isfinite(self.frame).all() or not is_rotation(self.frame).all():
            raise InputError("Grip", "frame", "no rotations", "give unit, orthogonal columns t, m1, m2")

    @classmethod
    def where(cls, rods: Configuration, vertex: int) -> "Grip":
        """The gripper that takes hold of ``vertex`` where it is, so that nothing moves: its frame is between those of both
        edges there, nearer to that of the shorter one."""
        if not 0 < vertex < rods.edges:
            raise InputError("Grip.where", "vertex", f"{vertex}", f"give a vertex between the ends, 1 to {rods.edges - 1}")
        before, after = rods.quaternions[:, vertex - 1], rods.quaternions[:, vertex]
        lengths = np.broadcast_to(rods.rest_length, (rods.count, rods.edges))[:, vertex - 1 : vertex + 1]
        turn = rotation_vector(quaternion_product(conjugate(before), after))
        share = lengths[:, :1] / lengths.sum(axis=1, keepdims=True)
        return cls(vertex, rods.vertices[:, vertex], rods.frames[:, vertex - 1] @ rotation_matrix(share * turn))

    def take(self, rows: Rows) -> "Grip":
        """The gripper of the rods named by ``rows``, in that order."""
        return replace(self, position=self.position[rows], frame=self.frame[rows])


@dataclass(frozen=True)
class GripLoads:
    """Forces and moments of the grippers on the rods, in the axes of the world; moments about the vertex that is held.

    force, moment  (R, K, 3), in N and N m where the material has a weight per length, else mm and mm² (:class:`.EndLoads`)
    physical       whether in N and N m
    """

    __repr__ = short_repr

    force: np.ndarray
    moment: np.ndarray
    physical: bool


@dataclass(frozen=True)
class HeldSolution:
    """Rods at rest that are held between their ends.

    parts     K + 1 solutions, of the stretches of the rods from one held place to the next, with an edge of length zero at each
              end that a grip holds
    solution  of the whole rods; without ``tables`` where there are grips, so that functions that need its input take ``parts``
    """

    parts: tuple[Solution, ...]
    solution: Solution

    def grip_loads(self) -> GripLoads:
        """What each gripper exerts; NaN in rods that have not converged. Raises InputError as :func:`.end_loads`."""
        loads = [end_loads(part) for part in self.parts]
        pairs = list(zip(loads[:-1], loads[1:], strict=True))
        force = [before.end_force + after.start_force for before, after in pairs]
        moment = [before.end_moment + after.start_moment for before, after in pairs]
        shape = (len(self.solution.status), len(pairs), 3)
        return GripLoads(*(np.stack(all_, axis=1) if pairs else np.zeros(shape) for all_ in (force, moment)), loads[0].physical)


@typed
def relax_held(rods: Configuration, material: Material, clamps: Clamps, grips: Sequence[Grip], solver: Newton | None = None, *,
               up: ArrayLike | None = None, precision: str = "f64", obstacles: Sequence[Obstacle] = (),
               radius: ArrayLike | None = None) -> HeldSolution:
    """F for R rods that grippers hold between their ends, too: the other arguments as :func:`doo_ti.relaxation.relax.relax` has
    them, with clamps and a start for each rod, and one material or one for each.

    A rod has the worst status of its stretches, and is certified stable where all of them are. Stretches do not touch each
    other. Raises InputError for grips that are not in the order of their vertices, or closer to each other or to an end than
    two edges, and for ``Itself`` among the obstacles.
    """
    stretches = Stretches.between("relax_held", rods, grips, obstacles)
    own = stretches.clamps(clamps, grips)
    return stretches.relaxed(rods, stretches.material(material), own, solver, up=up, precision=precision, obstacles=obstacles,
                             radius=radius)


@dataclass(frozen=True)
class Stretches:
    """The stretches of rods between the held ``vertices``: those of the grips, and both ends."""

    vertices: tuple[int, ...]

    @classmethod
    def between(cls, function: str, rods: Configuration, grips: Sequence[Grip], obstacles: Sequence[Obstacle]) -> "Stretches":
        """Raises InputError, of ``function``, for grips that do not suit the rods, and for ``Itself`` beside grips."""
        held = (0, *(grip.vertex for grip in grips), rods.edges)
        for before, after in zip(held[:-1], held[1:], strict=True):
            if grips and after - before < LEAST_EDGES:
                raise InputError(function, "grips", f"vertices {list(held[1:-1])} of rods of {rods.edges} edges",
                                 f"give grips in the order of their vertices, {LEAST_EDGES} edges or more between them and to "
                                 "the ends")
        for grip in grips:
            if len(grip.position) != rods.count:
                raise InputError(function, "grips", f"{len(grip.position)} rows for {rods.count} rods", "give one for each rod")
        if grips and any(isinstance(body, Itself) for body in obstacles):
            raise InputError(function, "obstacles", "Itself beside grips", "leave it out: stretches do not touch each other")
        return cls(held)

    @property
    def _spans(self) -> list[tuple[int, int, int, int]]:
        """Of each stretch: the vertices where it begins and ends, and how many edges of length zero are added at both."""
        inner = (0, *(1 for _ in self.vertices[1:-1]), 0)
        return list(zip(self.vertices[:-1], self.vertices[1:], inner[:-1], inner[1:], strict=True))

    def rods(self, rods: Configuration, clamps: Sequence[Clamps]) -> list[Configuration]:
        """Those of each stretch, which begin where the clamps hold them."""
        found = []
        for (first, last, before, after), own in zip(self._spans, clamps, strict=True):
            frames = [quaternion_from_matrix(own.start_frame)[:, None]] * before + [rods.quaternions[:, first:last]]
            frames += [quaternion_from_matrix(own.end_frame)[:, None]] * after
            lengths = np.pad(rods.rest_length[..., first:last], [(0, 0)] * (rods.rest_length.ndim - 1) + [(before, after)])
            found.append(Configuration(own.start_position if before else rods.start, np.concatenate(frames, axis=1),
                                       lengths))
        return found

    def lengths(self, rods: Configuration) -> list[np.ndarray]:
        """The ``rest_length`` of each stretch."""
        return [rods.rest_length[..., first:last] for first, last, *_ in self._spans]

    def clamps(self, clamps: Clamps, grips: Sequence[Grip]) -> list[Clamps]:
        """Those of each stretch: the clamps of the rod's ends, and the grips between."""
        starts = [(clamps.start, clamps.start_position, clamps.start_frame),
                  *((Clamp.FRAME, grip.position, grip.frame) for grip in grips)]
        ends = [*starts[1:], (clamps.end, clamps.end_position, clamps.end_frame)]
        return [Clamps(start, end, start_position, end_position, start_frame, end_frame)
                for (start, start_position, start_frame), (end, end_position, end_frame) in zip(starts, ends, strict=True)]

    def material(self, material: Material) -> list[Material]:
        """That of each stretch: what varies along the rod is cut, and an edge of length zero has what its vertex has."""
        found = []
        for first, last, before, after in self._spans:
            edges = [first] * before + list(range(first, last)) + [last - 1] * after
            inner = np.arange(first + 1 - before, last + after) - 1  # the first inner vertex of a rod is vertex 1
            rest = material.rest_curvature
            found.append(Material(
                material.bend[:, edges] if material.bend.shape[1] > 1 else material.bend,
                material.twist[:, inner] if material.twist.shape[1] > 1 else material.twist, material.weight,
                rest[:, inner] if rest is not None and rest.shape[1] > 1 else rest, material.weight_per_length))
        return found

    def relaxed(self, rods: Configuration, materials: Sequence[Material], clamps: Sequence[Clamps],
                solver: Newton | None = None, **options) -> HeldSolution:
        """The rods at rest, each stretch from where it is to its clamps. ``options`` go to :func:`.relax`."""
        parts = tuple(relax(part, material, own, solver, **options) for part, material, own in zip(
            self.rods(rods, clamps), materials, clamps, strict=True))
        return HeldSolution(parts, parts[0] if len(parts) == 1 else self._joined(rods, parts))

    def _joined(self, rods: Configuration, parts: Sequence[Solution]) -> Solution:
        """The whole rods of ``parts``."""
        frames = [part.configuration.quaternions[:, before : before + last - first]
                  for part, (first, last, before, _) in zip(parts, self._spans, strict=True)]
        whole = Configuration(parts[0].configuration.start, np.concatenate(frames, axis=1), rods.rest_length)
        length = np.sum(rods.rest_length, axis=-1)
        misses = [part.closure * np.sum(part.configuration.rest_length, axis=-1) / length for part in parts]
        forces = None
        if parts[0].contact_force is not None:
            forces = np.zeros(whole.vertices.shape)
            for part, (first, last, before, after) in zip(parts, self._spans, strict=True):
                own = part.contact_force
                forces[:, first : last + 1] += own[:, before : before + last - first + 1]
                forces[:, first] += before * own[:, 0]  # both ends of an edge of length zero are one vertex
                forces[:, last] += after * own[:, -1]
        return Solution(
            whole, energy=np.sum([part.energy for part in parts], axis=0),
            residual=np.max([part.residual for part in parts], axis=0), closure=np.max(misses, axis=0),
            iterations=np.sum([part.iterations for part in parts], axis=0, dtype=np.int32),
            status=reduce(sticky, (part.status for part in parts)),
            stable=np.all([part.stable for part in parts], axis=0), end_force=parts[-1].end_force,
            precision=np.min([part.precision for part in parts], axis=0), contact_force=forces)


class Simulation:
    """B rods between their grippers.

    rods       B rods, at or near rest under ``clamps``
    material   one row for all, or B
    sub_step   rad: largest rotation of a clamp between two relaxations; its shift is limited in proportion
    obstacles, radius  as in :func:`doo_ti.relaxation.relax.relax`, at rest and without friction

    Attributes: ``state``, the Solution of the B rods after the last step; ``clamps`` and ``grips``, where their grippers are;
    ``held``, the same as a :class:`.HeldSolution`, with the forces of grips.

    Raises InputError where numbers of rods do not match.
    """

    @typed
    def __init__(self, rods: Configuration, material: Material, clamps: Clamps, *, sub_step: float = LARGEST_TURN,
                 up: ArrayLike = (0.0, 0.0, 1.0), obstacles: Sequence[Obstacle] = (), radius: ArrayLike | None = None):
        if material.count not in (1, rods.count) or clamps.count != rods.count:
            raise InputError("Simulation", "clamps, material", f"{clamps.count} and {material.count} rows for "
                             f"{rods.count} rods", "give clamps for each rod, and one material or one for each")
        if not 0 < sub_step <= np.pi:
            raise InputError("Simulation", "sub_step", f"{sub_step:g} rad", "give radians, at most pi")
        surroundings = Surroundings.checked("Simulation", obstacles, radius, rods.count)
        if surroundings.rub or surroundings.moves:
            raise InputError("Simulation", "obstacles", "with friction, or moving", "give obstacles at rest without friction")
        self._around, self._up, self._sub_step = surroundings, unit_up(up, "Simulation"), sub_step
        self._material, self._begin = material, (rods, clamps)
        self.reset()

    def __repr__(self) -> str:
        return f"Simulation({counted(self.clamps.count, 'rod')})"

    def reset(self) -> Solution:
        """All rods back at their first clamps, at rest, without other grippers."""
        rods, self.clamps = self._begin
        self.grips: tuple[Grip, ...] = ()
        whole = Stretches.between("Simulation", rods, (), self._around.obstacles)
        self.held = self._relaxed(whole, rods, [self._material], [self.clamps], np.arange(rods.count))
        self.state = self.held.solution
        self._last = finite_rods(self.state.configuration, rods)
        return self.state

    @typed
    def step(self, grippers: Clamps, grips: Sequence[Grip] = ()) -> Solution:
        """The rods after their grippers have moved to ``grippers``, of B rods and the kinds of clamps that they have, and to
        ``grips``, B rows each: along straight lines, frames turning the shortest way. A vertex that was not held before is
        taken where it is; one that is in ``grips`` no more is let go first. A rod that fails in a sub-step keeps that status in
        the result, and goes on from where it was last at rest."""
        if grippers.count != self.clamps.count:
            raise InputError("Simulation.step", "grippers", f"{grippers.count} rows", f"give {self.clamps.count}")
        for end in ("start", "end"):
            if (np.asarray(getattr(grippers, end)) != getattr(self.clamps, end)).any():
                raise InputError("Simulation.step", f"grippers.{end}", "another kind of clamp", "give the kind they have")
        stretches = Stretches.between("Simulation.step", self._last, grips, self._around.obstacles)
        known = {grip.vertex: grip for grip in self.grips}
        taken = [known.get(grip.vertex) or Grip.where(self._last, grip.vertex) for grip in grips]
        motions = [motion_between(*ends) for ends in zip(
            stretches.clamps(self.clamps, taken), stretches.clamps(grippers, grips), strict=True)]
        steps = np.max([motion.needed_steps(length, self._sub_step) for motion, length in zip(
            motions, stretches.lengths(self._last), strict=True)], axis=0)
        materials = stretches.material(self._material) if grips else [self._material]
        most, status = int(np.max(steps, initial=1)), np.zeros(len(steps), dtype=np.int8)
        # A rod takes as many sub-steps as its own grippers need; all take their last one together.
        for step in range(1, most + 1):
            late = step - most + steps
            rods = np.flatnonzero(late > 0)
            clamps = [motion.take(rods).at(late[rods] / steps[rods]) for motion in motions]
            held = self._relaxed(stretches, self._last.take(rods), materials, clamps, rods)
            self._last = put_rods(self._last, rods, finite_rods(held.solution.configuration, self._last.take(rods)))
            status[rods] = sticky(status[rods], held.solution.status)
        self.clamps, self.grips, self.held = grippers, tuple(grips), held
        self.state = replace(held.solution, status=status)
        return self.state

    def _relaxed(self, stretches: Stretches, rods: Configuration, materials: Sequence[Material], clamps: Sequence[Clamps],
                 rows: np.ndarray) -> HeldSolution:
        own = [material if material.count == 1 else material.take(rows) for material in materials]
        return stretches.relaxed(rods, own, clamps, Newton.careful(), up=self._up, **self._around.take(rows).arguments)
