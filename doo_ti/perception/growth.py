"""The stages of Algorithm 1 that need no physics: which edges a hypothesis may grow, and which hypotheses are kept (§IV-A).

    error(e) = Σ_c E_proj^c of a sampled edge e, e·e^{i−1} > 0: the best edges, no two within ``separation``     (grow)
    E_vis: the best hypotheses, no two within ``similar_distance`` and ``similar_angle`` of each other           (keep)

Every stage handles all image sets at once.

Axes: A image sets, N hypotheses of all sets, n of one set, M sampled directions, K kept ones, i edges of a hypothesis.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from doo_ti.rod.types import Configuration

LARGEST_ANGLE = np.pi / 2  # sampled edges have e^i · e^{i+1} > 0


@dataclass(frozen=True)
class Hypotheses:
    """Growing rods of i edges each, and their scores.

    of_set       (N,) image set, in increasing order
    quaternions  (N, i, 4) frames
    energy_vis   (N,) E_vis, 1/mm, infinite for finished rods that failed; while growing, heights are measured from v⁰
    """

    of_set: np.ndarray
    quaternions: np.ndarray
    energy_vis: np.ndarray

    def take(self, rows: np.ndarray) -> "Hypotheses":
        """The hypotheses named by ``rows``, in that order."""
        return Hypotheses(self.of_set[rows], self.quaternions[rows], self.energy_vis[rows])


def sampled_directions(count: int) -> np.ndarray:
    """(M, 3) unit vectors evenly over the half sphere around the first axis, those nearest to it first."""
    number = np.arange(count)
    along = 1 - (number + 0.5) / count * (1 - np.cos(LARGEST_ANGLE))
    around = number * np.pi * (3 - np.sqrt(5))  # with the golden angle no two of them are close
    across = np.sqrt(1 - along**2)
    return np.stack([along, across * np.cos(around), across * np.sin(around)], axis=-1)


def suppress_similar(error: np.ndarray, directions: np.ndarray, separation: float, most: int) -> np.ndarray:
    """(N, K) columns of ``error`` (N, M), the smallest first, no two directions within ``separation`` rad; then −1.

    Greedy, as in the paper: the best is taken, all within the angle are removed, and so on. Of equal errors the first column is
    taken; infinite ones are never taken.
    """
    near = directions @ directions.T > np.cos(separation)
    return _best_that_differ(np.array(error, dtype=np.float64), most, lambda best: near[best])


def select_hypotheses(
    score: np.ndarray, tip: np.ndarray, direction: np.ndarray, of_set: np.ndarray, most: int, distance: float, angle: float
) -> np.ndarray:
    """(N',) rows of the hypotheses to keep, at most ``most`` of each set, set by set and the best first.

    score      (N,) E_vis; NaN and infinite ones are never kept
    tip        (N, 3) last vertex, mm
    direction  (N, 3) direction of the last edge
    of_set     (N,) image set, in increasing order
    distance, angle   mm and rad: of two hypotheses that are within both, the better one suppresses the other (Alg. 1)
    """
    def alike(one: np.ndarray, others: np.ndarray) -> np.ndarray:
        apart = np.sum((tip[others] - tip[one]) ** 2, axis=-1)
        return (apart < distance**2) & (np.sum(direction[others] * direction[one], axis=-1) > np.cos(angle))

    kept = _of_each_set(np.where(np.isfinite(score), score, np.inf), of_set, most, alike)
    return kept[kept >= 0]


def rank_distinct(
    score: np.ndarray, vertices: np.ndarray, of_set: np.ndarray, most: int, distance: float,
    certified: np.ndarray | None = None,
) -> np.ndarray:
    """(A, K) rows of each set's rods, the best first, without those that are close to a better one; then −1.

    score      (N,) E_vis; NaN and infinite ones are never taken
    vertices   (N, V, 3) mm
    of_set     (N,) image set, in increasing order, at least one rod of each
    most       K
    distance   mm: rods whose vertices are nearer than this on average are the same rod
    certified  (N,) bool: these rank before all others of their set, because the score of a rod that is no minimum has little
               meaning; None: all
    """
    certified = np.ones(len(score), dtype=bool) if certified is None else certified
    rank = np.where(np.isfinite(score), np.argsort(np.lexsort((score, ~certified))), np.inf)
    return _of_each_set(rank, of_set, most, lambda one, others: np.linalg.norm(
        vertices[others] - vertices[one], axis=-1).mean(axis=-1) < distance)


def _of_each_set(score: np.ndarray, of_set: np.ndarray, most: int, alike: Callable[[np.ndarray, np.ndarray], np.ndarray]
                 ) -> np.ndarray:
    """(A, K) rows of each set, those of least ``score`` (N,) first; then −1. Left out are rows ``others`` (A, W) that are
    ``alike`` to a better ``one`` (A, 1)."""
    _, first, count = np.unique(of_set, return_index=True, return_counts=True)
    column = np.arange(count.max())
    rows = np.minimum(first[:, None] + column, len(of_set) - 1)
    left = np.where(column < count[:, None], score[rows], np.inf)
    chosen = _best_that_differ(left, most, lambda best: alike(np.take_along_axis(rows, best[:, None], axis=1), rows))
    return np.where(chosen >= 0, np.take_along_axis(rows, np.maximum(chosen, 0), axis=1), -1)


def _best_that_differ(left: np.ndarray, most: int, alike: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """(N, K) columns of ``left`` (N, M), which is changed, the smallest first; then −1. When columns (N,) are taken, those
    ``alike`` (N, M) are removed."""
    rows, chosen = np.arange(len(left)), np.full((len(left), most), -1)
    for place in range(most):
        best = np.argmin(left, axis=1)
        found = np.isfinite(left[rows, best])
        if not found.any():
            break
        chosen[found, place] = best[found]
        left[alike(best)] = np.inf
        left[rows, best] = np.inf
    return chosen


# --- the steps, recorded for pictures -------------------------------------------------------------------------------------

@dataclass(frozen=True)
class GrowthStep:
    """The hypotheses of one set after a step, the best first."""

    vertices: np.ndarray  # (n, i + 1, 3) mm
    energy_vis: np.ndarray  # (n,) 1/mm, heights from v⁰
    kept: np.ndarray  # (n,) bool: kept for the next step; the others were pruned


@dataclass(frozen=True)
class GrowthSteps:
    """A record of the growth of the first ``sets`` sets."""

    sets: int
    steps: dict = field(default_factory=dict)

    def add(self, first: int, kept: Hypotheses, pruned: Hypotheses) -> None:
        """Record a step of ``perceive``, whose set 0 is set ``first`` here."""
        for row in range(first, self.sets):
            ours = [group.take(np.flatnonzero(group.of_set == row - first)) for group in (kept, pruned)]
            if not len(ours[0].of_set) + len(ours[1].of_set):
                break
            self.steps.setdefault(row, []).append(ours)

    def of(self, row: int, point: np.ndarray, rest_length: np.ndarray) -> list[GrowthStep]:
        """The steps of one set, whose rod starts at ``point`` (3,) mm and has edges of ``rest_length`` (E,) mm."""
        found = []
        for kept, pruned in self.steps.get(row, ()):
            quaternions = np.concatenate([kept.quaternions, pruned.quaternions])
            start = np.broadcast_to(point, (len(quaternions), 3))
            vertices = Configuration(start, quaternions, rest_length[: quaternions.shape[1]]).vertices
            energy = np.concatenate([kept.energy_vis, pruned.energy_vis])
            found.append(GrowthStep(vertices, energy, np.arange(len(energy)) < len(kept.of_set)))
        return found
