"""A batch of rods that is stepped by its grippers, for control loops.

    simulation = Simulation(rods, material, clamps)
    while …:
        state = simulation.step(clamps)            # Solution: B rods at rest
        state.configuration.vertices
    simulation.step(clamps, [Grip.where(state.configuration, 12)])      # a third gripper takes hold of vertex 12

Quasi-static: after every step each rod is at rest on the branch that its clamps have carried it along, or where it has snapped
to. Axes: B rods.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from doo_ti.contact.obstacles import Obstacle
from doo_ti.contact.surroundings import Surroundings
from doo_ti.manipulation.grips import Grip, HeldSolution, Stretches
from doo_ti.manipulation.poses import finite_rods, put_rods
from doo_ti.motion.path import LARGEST_TURN, motion_between
from doo_ti.relaxation.newton import Newton
from doo_ti.rod.types import Clamps, Configuration, Material, Solution, sticky, unit_up
from doo_ti.system.arguments import counted, typed
from doo_ti.system.errors import InputError


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
