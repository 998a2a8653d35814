"""Rods on their way, each in as many sub-steps as its own motion needs, whatever its company (§III-D).

Axes: G materials, N motions, R = G·N rods, material by material, E edges.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from doo_ti.motion.leg import Leg
from doo_ti.motion.path import Motion
from doo_ti.relaxation.descent import Descent
from doo_ti.relaxation.newton import Newton
from doo_ti.types import Configuration, Material, Solution

FEWEST_STEPS = 2
"""What :class:`doo_ti.motion.leg.Leg` takes at least."""


@dataclass(frozen=True)
class Journey:
    """Each of N motions under each of G materials.

    motion       what the clamps do
    sub_step     rad that a clamp turns at most in a sub-step; its shift is bound in proportion
    rest_length  (E,) mm
    up           (3,) direction against gravity
    solver       as :func:`doo_ti.relaxation.relax.relax` takes it; Newton goes without its first shift, closest to the branch
    precision    where a rod ends; on the way f64 if that is asked for, else f32, with f64 for what f32 cannot finish
    """

    motion: Motion
    material: Material
    sub_step: float
    rest_length: np.ndarray
    up: np.ndarray = (0.0, 0.0, 1.0)
    solver: Newton | Descent = Newton()
    precision: str = "mixed"

    @property
    def sub_steps(self) -> np.ndarray:
        """(N,) of each motion: powers of two, so that few numbers occur, and those who share one go together."""
        need = np.maximum(self.motion.needed_steps(self.rest_length, self.sub_step), FEWEST_STEPS)
        return 2 ** np.ceil(np.log2(need)).astype(np.int64)

    def legs(self) -> Iterator[tuple[np.ndarray, Leg]]:
        """Motions (n,) that take as many sub-steps, in order, and their leg."""
        need = self.sub_steps
        for steps in np.unique(need) if len(need) else [FEWEST_STEPS]:
            rows = np.flatnonzero(need == steps)
            yield rows, Leg(self, self.motion.take(rows), int(steps))

    def end(self, begin: Configuration, watch: bool = True) -> tuple[Solution, np.ndarray]:
        """Where the R rods end, and how often each jumped on the way (R,); see :meth:`doo_ti.motion.leg.Leg.end`."""
        rods, legs = self._split(begin)
        ends, jumps = zip(*(leg.end(begin.take(own), watch) for own, leg in zip(rods, legs, strict=True)), strict=True)
        order = np.argsort(np.concatenate(rods))
        return _together(ends, order), np.concatenate(jumps)[order]

    def follow(self, begin: Configuration) -> Iterator[Solution]:
        """The R rods after each sub-step of those that take most, the others being shown at the nearest of theirs ahead; and
        at last in the precision asked for."""
        rods, legs = self._split(begin)
        order, most = np.argsort(np.concatenate(rods)), max(leg.steps for leg in legs)
        ways = [list(leg.follow(begin.take(own))) for own, leg in zip(rods, legs, strict=True)]
        for step in range(1, most + 1):
            yield _together([way[-(-step * leg.steps // most) - 1] for way, leg in zip(ways, legs, strict=True)], order)
        if any(len(way) > leg.steps for way, leg in zip(ways, legs, strict=True)):
            yield _together([way[-1] for way in ways], order)

    def _split(self, begin: Configuration) -> tuple[list[np.ndarray], list[Leg]]:
        """The rods (r,) of each leg, and the legs."""
        rows, legs = zip(*self.legs(), strict=True)
        motions = len(self.motion.clamps.start_position)
        first = motions * np.arange(self.material.count)[:, None]
        return [(first + own).ravel() for own in rows], list(legs)


def _together(parts: list[Solution], order: np.ndarray) -> Solution:
    """One solution of several, its rods in ``order``."""
    return parts[0] if len(parts) == 1 else Solution.concatenate(parts).take(order)
