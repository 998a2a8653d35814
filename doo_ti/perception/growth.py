"""The stages of Algorithm 1 that need no physics: which edges a hypothesis may grow, and which hypotheses to keep (§IV-A).

Everything is over all image sets at once; no stage knows how many there are.

Axes: A image sets, N hypotheses of all sets, M sampled directions, K kept ones, H hypotheses of a set.
"""

import numpy as np

LARGEST_ANGLE = np.pi / 2
"""Sampled edges have e^i · e^{i+1} > 0."""


def sampled_directions(count: int) -> np.ndarray:
    """(M, 3) unit vectors evenly over the half sphere around the first axis, the ones nearest to it first."""
    number = np.arange(count)
    along = 1 - (number + 0.5) / count * (1 - np.cos(LARGEST_ANGLE))
    around = number * np.pi * (3 - np.sqrt(5))  # the golden angle leaves no two of them close
    across = np.sqrt(1 - along**2)
    return np.stack([along, across * np.cos(around), across * np.sin(around)], axis=-1)


def suppress_similar(error: np.ndarray, directions: np.ndarray, separation: float, most: int) -> np.ndarray:
    """(N, K) columns of ``error`` (N, M), the smallest first, no two directions within ``separation`` rad; −1 where none is.

    Greedy, as the paper: the best is taken, all within the angle are removed, and so on. Equal errors go to the first column;
    infinite ones are never taken.
    """
    left = np.array(error, dtype=np.float64)
    near = directions @ directions.T > np.cos(separation)
    rows = np.arange(len(left))
    chosen = np.full((len(left), most), -1)
    for place in range(most):
        best = np.argmin(left, axis=1)
        found = np.isfinite(left[rows, best])
        if not found.any():
            return chosen[:, :place]
        chosen[found, place] = best[found]
        left[near[best]] = np.inf
    return chosen


def select_hypotheses(
    score: np.ndarray, tip: np.ndarray, direction: np.ndarray, of_set: np.ndarray, most: int, distance: float, angle: float
) -> np.ndarray:
    """(N', ) rows of the hypotheses to keep, at most ``most`` of each set, set by set and the best first.

    score      (N,) E_vis; NaN and infinite ones are never kept
    tip        (N, 3) last vertex, mm
    direction  (N, 3) direction of the last edge
    of_set     (N,) image set, in increasing order
    distance, angle   mm and rad: of two hypotheses that are within both, the better one suppresses the other (Alg. 1)
    """
    sets, first, count = np.unique(of_set, return_index=True, return_counts=True)
    width = count.max()
    column = np.arange(len(of_set)) - np.repeat(first, count)
    place = (np.repeat(np.arange(len(sets)), count), column)
    left = np.full((len(sets), width), np.inf)
    left[place] = np.where(np.isfinite(score), score, np.inf)
    tips, directions = (_padded(values, place, left.shape) for values in (tip, direction))
    kept = np.full((len(sets), most), -1)
    rows = np.arange(len(sets))
    cosine = np.cos(angle)
    for turn in range(most):
        best = np.argmin(left, axis=1)
        found = np.isfinite(left[rows, best])
        if not found.any():
            break
        kept[found, turn] = (first + best)[found]
        apart = np.sum((tips - tips[rows, best][:, None]) ** 2, axis=-1)
        aligned = np.sum(directions * directions[rows, best][:, None], axis=-1)
        left[(apart < distance**2) & (aligned > cosine)] = np.inf
        left[rows, best] = np.inf
    return kept[kept >= 0]


def rank_distinct(
    score: np.ndarray, vertices: np.ndarray, of_set: np.ndarray, most: int, distance: float, certified: np.ndarray | None = None
) -> np.ndarray:
    """(A, K) rows of each set's rods, the best first, without those that run along a better one; then −1.

    score      (N,) E_vis; NaN and infinite ones are never taken
    vertices   (N, V, 3) mm
    of_set     (N,) image set, in increasing order, at least one rod of each
    most       K
    distance   mm: rods whose vertices are nearer than this on average are one
    certified  (N,) bool: these rank before all others of their set, since the score of a rod that is no minimum says little;
               None: all alike
    """
    certified = np.ones(len(score), dtype=bool) if certified is None else certified
    sets, first, count = np.unique(of_set, return_index=True, return_counts=True)
    ranked = np.full((len(sets), most), -1)
    taken = np.zeros(len(sets), dtype=np.int64)
    finite = np.isfinite(score)
    order = np.lexsort((np.where(finite, score, np.inf), ~certified, of_set))
    # Round by round the next best of every set, unless a better one runs along it.
    for turn in range(count.max()):
        here = np.flatnonzero((turn < count) & (taken < most))
        rows = order[first[here] + turn]
        better = ranked[here]
        apart = np.linalg.norm(vertices[rows][:, None] - vertices[better], axis=-1).mean(axis=-1)
        new = finite[rows] & ~((apart < distance) & (better >= 0)).any(axis=1)
        ranked[here[new], taken[here[new]]] = rows[new]
        taken[here[new]] += 1
    return ranked


def _padded(values: np.ndarray, place, shape) -> np.ndarray:
    """``values`` (N, 3) as a table (sets, width, 3)."""
    table = np.zeros((*shape, 3))
    table[place] = values
    return table
