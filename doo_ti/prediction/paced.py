"""Journeys of unlike length: how many sub-steps a rod takes depends on its own motion, not on its company (§III-D).

Axes: G materials, N motions, R = G·N rods, material by material.
"""

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace

import numpy as np

from doo_ti.motion.journey import FEWEST_STEPS, Journey
from doo_ti.motion.path import Motion
from doo_ti.types import Configuration, Solution


@dataclass(frozen=True)
class PacedJourney(Journey):
    """A journey in ``pace`` sub-steps, whoever else is on it."""

    pace: int = FEWEST_STEPS

    @property
    def steps(self) -> int:
        return self.pace


def journeys(journey: Journey) -> Iterator[tuple[np.ndarray, PacedJourney]]:
    """The motions (n,) that take as many sub-steps, and their journey. There are powers of two of them, so few journeys."""
    need = sub_steps_of(journey.motion, journey.rest_length, journey.sub_step)
    own = {field.name: getattr(journey, field.name) for field in fields(Journey)}
    for pace in np.unique(need):
        rows = np.flatnonzero(need == pace)
        yield rows, PacedJourney(**own | {"motion": motion_of(journey.motion, rows)}, pace=int(pace))


def travel(journey: Journey, begin: Configuration) -> tuple[Solution, np.ndarray]:
    """Where the R rods end, and how often each fell (R,), as :meth:`Journey.end`, each at its own pace."""
    motions, places, ends, falls = len(journey.motion.clamps.start_position), [], [], []
    for rows, paced in journeys(journey):
        places.append((motions * np.arange(begin.count // motions)[:, None] + rows).ravel())
        solution, jumps = paced.end(begin.take(places[-1]))
        ends.append(solution)
        falls.append(jumps)
    order = np.argsort(np.concatenate(places))
    return joined(ends, order), np.concatenate(falls)[order]


def joined(parts: list[Solution], order: np.ndarray) -> Solution:
    """One solution of several, its rods in ``order``; it cannot be relaxed again."""
    names = [field.name for field in fields(Solution) if field.name not in ("configuration", "tables")]
    shapes = [part.configuration for part in parts]
    together = Configuration(np.concatenate([shape.start for shape in shapes])[order],
                             np.concatenate([shape.quaternions for shape in shapes])[order], shapes[0].rest_length)
    return Solution(configuration=together, **{
        name: np.concatenate([getattr(part, name) for part in parts])[order] for name in names})


def sub_steps_of(motion: Motion, rest_length: np.ndarray, sub_step: float) -> np.ndarray:
    """(N,) sub-steps of each motion, powers of two, that keep its turns below ``sub_step`` (rad), its shifts in proportion."""
    need = np.maximum(motion.needed_steps(rest_length, sub_step), FEWEST_STEPS)
    return 2 ** np.ceil(np.log2(need)).astype(np.int64)


def motion_of(motion: Motion, rows: np.ndarray) -> Motion:
    """The motions named by ``rows``, in that order."""
    parts = ("start_shift", "end_shift", "start_turn", "end_turn", "end_spin")
    return replace(motion, clamps=motion.clamps.take(rows), **{
        name: getattr(motion, name)[rows] for name in parts if getattr(motion, name) is not None})
