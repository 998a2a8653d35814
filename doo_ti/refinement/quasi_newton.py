"""Minimum of a smooth function of a few bounded variables from its gradient: BFGS with Powell's damping and projected steps
(Nocedal and Wright, *Numerical Optimization*, 2006, §6.1 and procedure 18.2). Unlike SciPy's L-BFGS-B
it begins with a known Hessian, and returns the one it has learned: the next of many similar searches then takes one or two
evaluations."""

from collections.abc import Callable

import numpy as np

LONGEST = 1.5
"""Largest change of a variable in one step."""
SHORTENED, SHORTEST = 0.3, 1e-3
"""Factor by which a step that does not lower the function enough is shortened, and the smallest share that is tried."""
ARMIJO = 1e-4
"""Least decrease over that which the gradient promises."""
DAMPED = 0.2
"""Least curvature along a step over that of the present Hessian."""


def minimised(function: Callable[[np.ndarray], tuple[float, np.ndarray]], x: np.ndarray, bounds: tuple[np.ndarray, np.ndarray],
              hessian: np.ndarray, steps: int, enough: float) -> tuple[np.ndarray, np.ndarray]:
    """``x`` (N,) where ``function``, which returns its value and gradient, is least within ``bounds``, and its Hessian there.

    Ends after ``steps``, or where the next step promises, or the last one gained, less than ``enough``."""
    value, gradient = function(x)
    for _ in range(steps):
        step = _newton_step(x, gradient, bounds, hessian)
        if -gradient @ step < enough:
            break
        step = step * min(1.0, LONGEST / np.abs(step).max())
        share, lower = 1.0, False
        while not lower and share > SHORTEST:
            trial = np.clip(x + share * step, *bounds)
            its_value, its_gradient = function(trial)
            lower = its_value <= value + ARMIJO * gradient @ (trial - x)
            share *= SHORTENED
        if not lower:
            break
        hessian = _updated(hessian, trial - x, its_gradient - gradient)
        gained, x, value, gradient = value - its_value, trial, its_value, its_gradient
        if gained < enough:
            break
    return x, hessian


def _newton_step(x: np.ndarray, gradient: np.ndarray, bounds: tuple[np.ndarray, np.ndarray], hessian: np.ndarray) -> np.ndarray:
    """−H⁻¹ g of the variables that are not held by their bounds."""
    free = np.where(gradient > 0, x > bounds[0], x < bounds[1])
    step = np.zeros_like(x)
    step[free] = -np.linalg.solve(hessian[np.ix_(free, free)], gradient[free])
    return step


def _updated(hessian: np.ndarray, step: np.ndarray, change: np.ndarray) -> np.ndarray:
    """The Hessian with ``change`` of the gradient along ``step``, damped so that it stays positive definite."""
    along = hessian @ step
    curvature, present = step @ change, step @ along
    if curvature < DAMPED * present:
        share = (1 - DAMPED) * present / (present - curvature)
        change = share * change + (1 - share) * along
        curvature = step @ change
    return hessian - np.outer(along, along) / present + np.outer(change, change) / curvature
