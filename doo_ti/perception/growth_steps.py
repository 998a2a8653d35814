"""How hypotheses grew, step by step, kept to be shown (Alg. 1). Axes: n hypotheses of a set, i edges."""

from dataclasses import dataclass, field

import numpy as np

from doo_ti.perception.search import Hypotheses
from doo_ti.types import Configuration


@dataclass(frozen=True)
class GrowthStep:
    """The hypotheses of one set after a step.

    vertices    (n, i + 1, 3) mm
    energy_vis  (n,) 1/mm, heights from v⁰
    kept        (n,) bool: those that grow on; the others were pruned. The best comes first
    """

    vertices: np.ndarray
    energy_vis: np.ndarray
    kept: np.ndarray


@dataclass(frozen=True)
class GrowthSteps:
    """Takes down the growth of the first ``sets`` sets."""

    sets: int
    steps: dict = field(default_factory=dict)

    def add(self, first: int, kept: Hypotheses, pruned: Hypotheses) -> None:
        """A step of sets that are numbered from ``first`` on, as ``perceive`` tells of it."""
        for row in range(first, self.sets):
            ours = [group.take(np.flatnonzero(group.of_set == row - first)) for group in (kept, pruned)]
            if not len(ours[0].of_set) + len(ours[1].of_set):
                break
            self.steps.setdefault(row, []).append(ours)

    def of(self, row: int, point: np.ndarray, rest_length: np.ndarray) -> list[GrowthStep]:
        """The steps of one set, whose rod sets out from ``point`` (3,) mm with edges of ``rest_length`` (E,) mm."""
        found = []
        for kept, pruned in self.steps.get(row, ()):
            quaternions = np.concatenate([kept.quaternions, pruned.quaternions])
            start = np.broadcast_to(point, (len(quaternions), 3))
            vertices = Configuration(start, quaternions, rest_length[: quaternions.shape[1]]).vertices
            energy = np.concatenate([kept.energy_vis, pruned.energy_vis])
            found.append(GrowthStep(vertices, energy, np.arange(len(energy)) < len(kept.of_set)))
        return found
