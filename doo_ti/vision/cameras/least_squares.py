"""Least squares by Levenberg–Marquardt: P problems of K unknowns each, all at once.

    x ← x − (JᵀJ + λ diag(JᵀJ))⁻¹ Jᵀr,    λ ← λ/10 where |r|² decreased, else the step is undone and λ ← 10 λ
"""

from collections.abc import Callable

import numpy as np

WORST_DAMPING = 1e12  # with more damping steps are too short to lower a sum of squares


def least_squares(start, linearised: Callable, moved: Callable, chosen: Callable, settled: Callable, damping: float,
                  most_steps: int) -> tuple:
    """(the unknowns with the least sums of squares that are reached from ``start``, the (P,) sums, and (P, K, K) JᵀJ there).

    linearised  (unknowns) → (P,) sums of squares, infinite for invalid unknowns, (P, K, K) JᵀJ and (P, K) Jᵀr
    moved       (unknowns, steps (P, K)) → unknowns
    chosen      ((P,) bool, unknowns, other unknowns) → the first where true, else the second
    settled     (steps (P, K), (P,) decrease of the sums, (P,) new sums) → (P,) bool: done
    damping     λ of the first step

    Raises LinAlgError where a damped JᵀJ is singular.
    """
    place = start
    cost, normal, slope = linearised(place)
    identity, damping = np.eye(slope.shape[1]), np.full(len(cost), damping)
    for _ in range(most_steps):
        lost = ~np.isfinite(cost)[:, None]
        damped = np.where(lost[..., None], identity, normal * (1 + damping[:, None, None] * identity))
        step = -np.linalg.solve(damped, np.where(lost, 0.0, slope)[..., None])[..., 0]
        trial = moved(place, step)
        trial_cost, trial_normal, trial_slope = linearised(trial)
        better = trial_cost <= cost
        gain = np.full(len(cost), -np.inf)
        np.subtract(cost, trial_cost, out=gain, where=better & np.isfinite(cost))
        place = chosen(better, trial, place)
        cost = np.where(better, trial_cost, cost)
        normal = np.where(better[:, None, None], trial_normal, normal)
        slope = np.where(better[:, None], trial_slope, slope)
        damping = np.where(better, damping / 10, damping * 10)
        if (settled(step, gain, cost) | (damping >= WORST_DAMPING)).all():
            break
    return place, cost, normal
