"""Least squares by Gauss-Newton steps with Levenberg-Marquardt damping: P problems of K unknowns each, all at once."""

from collections.abc import Callable

import numpy as np

WORST_DAMPING = 1e12
"""Steps so short lower nothing any more."""


def least_squares(start, linearised: Callable, moved: Callable, chosen: Callable, settled: Callable, damping: float,
                  most_steps: int) -> tuple:
    """(where the sums of squares are least, their (P,) values, and (P, K, K) JᵀJ there), found from ``start``.

    linearised  of a place: (P,) sums of squares, infinite where there is none, (P, K, K) JᵀJ and (P, K) Jᵀr
    moved       of a place and steps (P, K): another place
    chosen      of (P,) bool and two places: the first where it holds, else the second
    settled     of steps (P, K), by how much (P,) they lowered the sums, and the new sums (P,): (P,) bool, done
    damping     of the first step, relative to the diagonal of JᵀJ

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
