"""Whole turns of rods that frames hold at both ends, where nobody measured the total twist.

The frames leave the twist open up to whole turns. F takes, of several, the rod nearest to the marks: under a twist stiffness
that is too low a wrong turn changes the shape little, is taken, and confirms the stiffness. So a fit begins with several twist
stiffnesses, each with the turns that are nearest then, and once with as little twist as the frames leave in all rods, which
marks that are far apart may not tell from a turn more; the posterior decides. At its end each observation's turns are chosen
once more, under what was learned.
"""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from doo_ti.refinement.evidence import integrated
from doo_ti.refinement.fit import POSED, Fit, Fitted, State
from doo_ti.refinement.priors import Scales
from doo_ti.refinement.theta import common_rod
from doo_ti.refinement.unknowns import Values
from doo_ti.system.errors import InputError

RATIOS = (0.25, 0.5, 1.0, 2.0, 4.0)
"""Twist over bend stiffness with which a fit begins."""
TURNS = (-1, 0, 1)
"""Whole turns of an observation that are compared, each with the most probable clamps."""
AGAIN = 3
"""How often each observation is chosen once more, as long as that changes any."""


def twisted(fit: Fit, values: Values, scales: Scales) -> Iterator[State]:
    """Rods relaxed from their observations at ``values``, with each of several twist stiffnesses, and with the least twist."""
    theta = values.theta
    least = fit.posed(fit.from_marks(replace(values, theta=common_rod(theta), scatter=0 * values.scatter), scales, turn=0))
    if least.used.any():
        yield least
    for ratio in RATIOS:
        twisted = replace(theta, twist=ratio * float(np.diag(theta.bend).mean()))
        with suppress(InputError):  # no rod is stable at that twist stiffness
            yield fit.begin(replace(values, theta=twisted, scatter=0 * values.scatter), scales)


def turns_chosen_again(fit: Fit, fitted: Fitted, steps: int) -> list[Fitted]:
    """``fitted``, continued as long as that makes it better. Each time every observation takes the turns that are most probable
    under what was learned: of several, or of those that were measured and those that misfits took instead. All that were
    reached, the best first."""
    turns, reached = TURNS if fit.unknowns.rod.turns_unknown else (None,), [fitted]
    for _ in range(AGAIN):
        state = reached[-1].state
        values = replace(state.values, scatter=0 * state.values.scatter)
        begun = _best_of(fit, [state, *(fit.posed(fit.from_marks(values, state.scales, turn)) for turn in turns)])
        if np.array_equal(begun.values.scatter, state.values.scatter):
            break
        reached.append(fit.run(begun, steps).after(reached[-1]))
        if reached[-1].rank >= reached[-2].rank:
            break
    return sorted(reached, key=lambda one: one.rank)


def _best_of(fit: Fit, states: Sequence[State]) -> State:
    """Of each observation that which is most probable given the others, at the same sizes. What is shared is free to follow to
    first order: it may have adapted to a wrong shape of that observation."""
    best, *others = states
    precision, _ = fit.unknowns.precision(best.scales)
    of_best = own, slope, present = _densities(fit, best)
    used = best.used & np.isfinite(present)
    own, slope = (np.where(used.reshape(-1, *(1,) * (part.ndim - 1)), part, 0.0) for part in (own, slope))
    rest = (precision + own.sum(axis=0) - own,
            slope.sum(axis=0) + precision @ fit.unknowns.offset(best.values, fit.origin) - slope)
    least = _given(rest, *of_best)
    for other in others:
        value = _given(rest, *_densities(fit, other))
        better = value < least - POSED
        if better.any():
            best, least = fit.merged(best, other, better), np.where(better, value, least)
    return best


def _densities(fit: Fit, state: State) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of each observation B and s, and c + q, of :func:`doo_ti.refinement.evidence.integrated`; that is infinite where the rod
    is not sound."""
    sound = state.solution.converged & state.solution.stable
    linear, usable = fit.comparison.linear(state.solution, state.values, sound, leave_out_soft=False)
    own, slope, squares, constant = integrated(fit.unknowns, linear, state.scales)
    return own, slope, np.where(usable, squares + constant, np.inf)


def _given(rest: tuple[np.ndarray, np.ndarray], own: np.ndarray, slope: np.ndarray, value: np.ndarray) -> np.ndarray:
    """(D,) −2 ln of the density of each observation given the ``rest``, B (D, P, P) and s (D, P) of all others."""
    hessian, slope = rest[0] + own, rest[1] + slope
    return value - np.einsum("dp,dp->d", slope, np.linalg.solve(hessian, slope[..., None])[..., 0]) + np.linalg.slogdet(
        hessian)[1]
