"""Rods on their way in as many sub-steps: clamps carried, every rod relaxed after each and kept to its branch (§III-D).

Axes: G materials, N motions, R = G·N rods, material by material, E edges.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from doo_ti.motion.jumps import PARTS, JumpCount
from doo_ti.motion.path import Motion
from doo_ti.relaxation.newton import Newton
from doo_ti.relaxation.relax import relax
from doo_ti.types import Configuration, Solution, lasting

if TYPE_CHECKING:
    from doo_ti.motion.journey import Journey


@dataclass(frozen=True)
class Leg:
    """Those N motions of a journey that take the same number of sub-steps, under each of its G materials.

    journey  whose material, lengths, gravity, solver and precision they share
    motion   what the clamps do
    steps    sub-steps, two at least: with less there is none beside to compare with
    """

    journey: "Journey"
    motion: Motion
    steps: int

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
        if self.journey.precision != self._on_the_way:
            yield self._relaxed(rods, configuration, 1.0, self.journey.precision)

    def _finely(self, rods: np.ndarray, frames: np.ndarray, step: int, steps: int) -> Iterator[Solution]:
        """``rods`` after each part of ``steps`` sub-steps that begin with ``frames``, status and iterations since then."""
        here = Configuration(self.motion.clamps.start_position[rods % self._motions], frames, self.journey.rest_length)
        status, iterations = np.zeros(len(rods), dtype=np.int8), np.zeros(len(rods), dtype=np.int32)
        for part in range(1, PARTS * steps + 1):
            solution = self._relaxed(rods, here, (step + part / PARTS) / self.steps, self._on_the_way)
            status, iterations = lasting(status, solution.status), iterations + solution.iterations
            here = solution.configuration
            yield replace(solution, status=status, iterations=iterations)

    def _relaxed(self, rods: np.ndarray, configuration: Configuration, share: float, precision: str) -> Solution:
        solver = self.journey.solver
        if isinstance(solver, Newton):
            solver = replace(solver, first_shift=0.0)
        clamps = self.motion.at(share).take(rods % self._motions)
        return relax(configuration, self.journey.material, clamps, solver, up=self.journey.up, precision=precision,
                     configuration_index=np.arange(len(rods)), material_index=rods // self._motions)

    @property
    def _on_the_way(self) -> str:
        return "f64" if self.journey.precision == "f64" else "f32"

    @property
    def _motions(self) -> int:
        """N."""
        return len(self.motion.clamps.start_position)
