"""Rods on their way in as many sub-steps: clamps carried, every rod relaxed after each and kept to its branch (§III-D).

Axes: G materials, N motions, R = G·N rods, material by material, E edges.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from doo_ti.motion.jumps import PARTS, JumpCount
from doo_ti.motion.path import Motion
from doo_ti.relaxation.descent import Descent
from doo_ti.relaxation.newton import Newton
from doo_ti.relaxation.relax import relax
from doo_ti.types import Configuration, Material, Solution, lasting


@dataclass(frozen=True)
class Leg:
    """Each of N motions under each of G materials, all in the same number of sub-steps.

    motion       what the clamps do
    steps        sub-steps, two at least: with less there is none beside to compare with
    rest_length  (E,) mm
    up           (3,) direction against gravity
    solver       as :func:`doo_ti.relaxation.relax.relax` takes it; Newton goes without its first shift, closest to the branch
    precision    where a rod ends; on the way f64 if that is asked for, else f32, with f64 for what f32 cannot finish
    """

    motion: Motion
    material: Material
    steps: int
    rest_length: np.ndarray
    up: np.ndarray = (0.0, 0.0, 1.0)
    solver: Newton | Descent = Newton()
    precision: str = "mixed"

    def end(self, begin: Configuration, watch: bool = True) -> tuple[Solution, np.ndarray]:
        """Where the R rods end, and how often each jumped on the way (R,), if that is watched.

        A rod that does not converge in some sub-step keeps that status, whatever becomes of it. Iterations are those of all.
        """
        jumps = JumpCount(begin.quaternions, self._finely, watch)
        status, iterations = np.zeros(begin.count, dtype=np.int8), np.zeros(begin.count, dtype=np.int32)
        for solution in self._follow(begin, jumps):
            status, iterations = lasting(status, solution.status), iterations + solution.iterations
        return replace(solution, status=status, iterations=iterations), jumps.count

    def follow(self, begin: Configuration) -> Iterator[Solution]:
        """The R rods after each sub-step, and once more at the end where the precision asked for is another."""
        yield from self._follow(begin, JumpCount(begin.quaternions, self._finely))

    def _follow(self, configuration: Configuration, jumps: JumpCount) -> Iterator[Solution]:
        rods, steps = np.arange(configuration.count), self.steps
        for step in range(steps):
            solution = self._relaxed(rods, configuration, (step + 1) / steps, self._on_the_way)
            configuration = solution.configuration
            jumps.see(solution)
            yield solution
        if self.precision != self._on_the_way:
            yield self._relaxed(rods, configuration, 1.0, self.precision)

    def _finely(self, rods: np.ndarray, frames: np.ndarray, step: int, steps: int) -> Iterator[Solution]:
        """``rods`` after each part of ``steps`` sub-steps that begin with ``frames``, status and iterations since then."""
        here = Configuration(self.motion.clamps.start_position[rods % self._motions], frames, self.rest_length)
        status, iterations = np.zeros(len(rods), dtype=np.int8), np.zeros(len(rods), dtype=np.int32)
        for part in range(1, PARTS * steps + 1):
            solution = self._relaxed(rods, here, (step + part / PARTS) / self.steps, self._on_the_way)
            status, iterations = lasting(status, solution.status), iterations + solution.iterations
            here = solution.configuration
            yield replace(solution, status=status, iterations=iterations)

    def _relaxed(self, rods: np.ndarray, configuration: Configuration, share: float, precision: str) -> Solution:
        solver = replace(self.solver, first_shift=0.0) if isinstance(self.solver, Newton) else self.solver
        clamps = self.motion.at(share).take(rods % self._motions)
        return relax(configuration, self.material, clamps, solver, up=self.up, precision=precision,
                     configuration_index=np.arange(len(rods)), material_index=rods // self._motions)

    @property
    def _on_the_way(self) -> str:
        return "f64" if self.precision == "f64" else "f32"

    @property
    def _motions(self) -> int:
        """N."""
        return len(self.motion.clamps.start_position)
