"""Intervals that hold: how much the marginal likelihood falls when a parameter is moved and all else is fitted anew.

Along a combination v·x of the unknowns F(t), −2 ln of the posterior with everything else integrated out (:mod:`.evidence`), is
followed from its least until it has risen by the quantile of F(1, n). Where Θ enters nearly linearly that is the interval of
the covariance; where data bound a parameter on one side only, it is open on the other.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import f as f_distribution

from doo_ti.refinement.fit import Fit, Fitted, State

FARTHEST = np.log(1000.0)
"""A parameter that can be moved by such a factor is not bounded on that side."""
FIRST = 2.5  # of the logarithm: the first trial goes no further
STEPS = 6  # of a fit with the parameter held
TRIALS = 6
CLOSE = 0.04  # share of the wanted rise's root that is close enough to interpolate


@dataclass(frozen=True)
class Interval:
    """The 95 % interval of a combination of unknowns, from where the fit ended: ``low`` ≤ 0 ≤ ``high``, None where open.

    error  standard deviation by the covariance
    """

    low: float | None
    high: float | None
    error: float


def interval(fit: Fit, fitted: Fitted, direction: np.ndarray, degrees: float, probability: float = 0.95) -> Interval:
    """The interval of ``direction`` (P,) · x; ``degrees`` of freedom: of F(1, n)."""
    wanted = float(np.sqrt(f_distribution.ppf(probability, 1, degrees)))
    error = float(np.sqrt(direction @ fitted.posterior.covariance @ direction))
    least = fitted.evidence.holding(direction).posterior(fitted.state.scales).value
    fit = replace(fit, rods=fitted.state.used)
    low, high = (_reach(fit, fitted, sign * direction, wanted, error, least) for sign in (-1.0, 1.0))
    return Interval(None if low is None else -low, high, error)


def _reach(fit: Fit, fitted: Fitted, direction: np.ndarray, wanted: float, error: float, least: float) -> float | None:
    """How far along ``direction`` the root of F's rise above ``least`` gets to ``wanted``; None beyond FARTHEST."""
    places, roots, states = [0.0], [0.0], [fitted.state]
    place = min(wanted * error, FIRST)
    for _ in range(TRIALS):
        near = int(np.argmin(np.abs(np.array(places) - place)))
        found, reached = _held(fit, fitted, states[near], direction, place - places[near])
        reached += places[near]
        root = float(np.sqrt(max(found.posterior.value - least, 0.0)))
        places.append(reached)
        roots.append(root)
        states.append(found.state)
        stuck = abs(reached - place) > 1e-6 * max(place, 1.0)
        if abs(root / wanted - 1) < CLOSE or (stuck and reached <= max(places[:-1])):
            break
        if root < wanted and reached >= FARTHEST:
            return None
        if stuck and root < wanted:
            break
        place = _next(np.array(places), np.array(roots), wanted)
    reach = _crossing(np.array(places), np.array(roots), wanted, wanted * error)
    return reach if reach < FARTHEST else None


def _held(fit: Fit, fitted: Fitted, state: State, direction: np.ndarray, amount: float) -> tuple[Fitted, float]:
    """The best fit ``amount`` further along ``direction`` than ``state``, and how far it got."""
    origin = fit.unknowns.offset(state.values, fit.origin)
    found = fit.run(state, STEPS, held=(direction, amount))
    moved = fit.unknowns.offset(found.state.values, fit.origin) - origin
    return found, float(direction @ moved)


def _next(places: np.ndarray, roots: np.ndarray, wanted: float) -> float:
    """Where to look next: between the last below and the first above, or further out."""
    above = places[roots >= wanted]
    if len(above):
        high = above.min()
        low = places[(roots < wanted) & (places < high)].max()
        a, b = roots[places == low].max(), roots[places == high].min()
        share = np.clip((wanted - a) / max(b - a, 1e-12), 0.15, 0.85)
        return float(low + share * (high - low))
    last = int(np.argmax(places))
    slope = roots[last] / max(places[last], 1e-12)
    return float(min(FARTHEST, places[last] * np.clip(wanted / max(slope * places[last], 1e-12), 1.2, 2.5)))


def _crossing(places: np.ndarray, roots: np.ndarray, wanted: float, expected: float) -> float:
    """Where the root is ``wanted``, between the trials or a little beyond them; at least what the covariance expects where the
    trials came to an end before."""
    order = np.argsort(places)
    places, roots = places[order], roots[order]
    above = np.flatnonzero(roots >= wanted)
    if len(above):
        k = above[0]
        share = (wanted - roots[k - 1]) / max(roots[k] - roots[k - 1], 1e-12)
        return float(places[k - 1] + share * (places[k] - places[k - 1]))
    grown = places[-1] * wanted / max(roots[-1], 1e-12)
    return float(grown if grown < 1.1 * places[-1] else max(expected, grown))
