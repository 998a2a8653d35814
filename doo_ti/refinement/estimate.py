"""Θ with its intervals: values, 95 % intervals by the profile of the marginal likelihood, and joint regions (§III-E).

    interval of v·x = {t : F(t) − min F ≤ quantile of F(1, n)},    F(t) = −2 ln p(marks | v·x = t),

with all else integrated out or fitted again at every t (:mod:`doo_ti.refinement.evidence`). F is followed from its minimum
both ways. Other optima whose F is below that bound too (:mod:`doo_ti.refinement.search`) have intervals by their covariances:
the interval is from the lowest to the highest t of them all. Where Θ enters nearly linearly this is the interval by the
covariance. An end of an interval is None where the observations do not bound the parameter on that side.

Positive parameters are estimated by their logarithms, so their intervals are factors and never reach zero.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import fdtri  # scipy.stats takes as long to import as the whole package

from doo_ti.refinement.fit import OF_INTERVALS, Fit, Fitted
from doo_ti.refinement.search import behind
from doo_ti.refinement.theta import Scales, Theta
from doo_ti.refinement.unknowns import LOGARITHMIC, Unknowns, Values
from doo_ti.rod.material import relative_stiffness
from doo_ti.system.errors import InputError

PROBABILITY = 0.95
WIDE_FACTOR = 4.0  # an interval whose ends differ by more than this factor is called wide
UNITS = {"weight": "", "twist_ratio": "", "clip_start": "mm", "clip_end": "mm", "up[0]": "rad", "up[1]": "rad"}
FARTHEST = np.log(1000.0)  # a parameter that can be moved by this much is not bounded on that side
LEAST = 1e-5  # an end of an interval that is nearer than this to the estimate is open: a fit that has stopped reaches nothing
LARGEST_FIRST_TRIAL = 2.5  # change of a logarithm
STEPS = 20  # of each fit with the parameter held
TRIALS = 6
CLOSE = 0.1  # relative error of the root of F's rise that is small enough to interpolate


@dataclass(frozen=True)
class Parameter:
    """One parameter with its 95 % interval; an end is None where it is open."""

    name: str
    value: float
    low: float | None
    high: float | None
    error: float  # standard deviation by the covariance, relative where the parameter is positive
    unit: str  # "mm³", "mm", "rad" of tilt, or "" for the weight and for ratios

    @property
    def determined(self) -> bool:
        """Bounded on at least one side."""
        return self.low is not None or self.high is not None


@dataclass(frozen=True)
class Estimate:
    """Θ, the other unknowns, and how well they are known."""

    theta: Theta  # with the rest curvature at the joints between the marks' edges
    parameters: tuple[Parameter, ...]  # of Θ, the ratio of twist to bend, and the clips
    over_weight: tuple[Parameter, ...]  # bend and twist over twice the weight: EI/w and GJ/w of the continuum in mm³
    stiffness_along: np.ndarray  # (M,) bend stiffness at each mark over that of Θ, its geometric mean; ones of a uniform rod
    values: Values  # of all unknowns
    scales: Scales  # noise, curvature and the clamps' errors
    names: tuple[str, ...]  # of Θ's unknowns
    covariance: np.ndarray  # (T, T) of these
    degrees: float  # degrees of freedom of the intervals: observations less parameters of Θ
    rivals: tuple[Theta, ...]  # Θ of other optima that the observations hardly tell from this one; the intervals contain them

    @property
    def correlation(self) -> np.ndarray:
        error = np.sqrt(np.diag(self.covariance))
        return self.covariance / np.outer(error, error)

    def parameter(self, name: str) -> Parameter:
        """Raises InputError for one that was not learned."""
        for one in self.parameters:
            if one.name == name:
                return one
        raise InputError("estimate", name, "was not learned", f"give one of {', '.join(p.name for p in self.parameters)}")

    @property
    def left_open(self) -> tuple[str, ...]:
        """Parameters that the observations bound on neither side."""
        return tuple(one.name for one in self.parameters if not one.determined)

    def region(self, first: str, second: str, points: int = 181) -> np.ndarray:
        """(points, 2) the closed outline of the joint 95 % region of two parameters of Θ, in their own units.

        An ellipse of the covariance, each half of its long axis scaled as the first parameter's interval is; an open side
        extends to a factor of a thousand. Raises InputError for parameters that were not learned.
        """
        index = []
        for name in (first, second):
            if name not in self.names:
                raise InputError("region", name, "was not learned", f"give two of {', '.join(self.names)}")
            index.append(self.names.index(name))
        values, vectors = np.linalg.eigh(self.covariance[np.ix_(index, index)])
        spread = np.sqrt(np.maximum(values, 0.0))
        size = np.sqrt(2 * fdtri(2, self.degrees, PROBABILITY))
        angle = np.linspace(0.0, 2 * np.pi, points)
        along = np.stack([np.cos(angle), np.sin(angle)]) * size * spread[:, None]
        sign = 1.0 if vectors[0, 1] >= 0 else -1.0
        below, above = self._stretch(self.parameter(first))
        along[1] *= np.where(sign * along[1] < 0, below, above)
        steps = np.clip(vectors @ along, -FARTHEST, FARTHEST)
        return np.stack([_moved(name, self.parameter(name).value, step, self.theta.bend)
                         for name, step in zip((first, second), steps, strict=True)], axis=1)

    def _stretch(self, parameter: Parameter) -> tuple[float, float]:
        """Length of each half of the parameter's interval over that by the covariance."""
        reach = np.sqrt(fdtri(1, self.degrees, PROBABILITY)) * parameter.error

        def half(end: float | None) -> float:
            if end is None:
                return FARTHEST / reach
            return abs(np.log(end / parameter.value) if parameter.name in LOGARITHMIC else end - parameter.value) / reach
        return half(parameter.low), half(parameter.high)


def degrees_of(one: Fitted) -> float:
    """n of F(1, n). Marks of one rod are not independent where the rod's clamps are off: what counts is the number of rods."""
    return max(float(one.counted.sum()) - one.fit.unknowns.theta_count, 1.0)


def within_reach(optima: list[Fitted], margin: float = 0.0) -> list[Fitted]:
    """The best of ``optima``, then the others whose evidence is so near to its that they count in the intervals, and those by
    ``margin`` further behind."""
    first = optima[0]
    apart = np.array([0.0, *(behind(one, first) for one in optima[1:])])
    reach = apart.min() + fdtri(1, degrees_of(first), PROBABILITY) + margin
    return [optima[k] for k in np.argsort(apart, kind="stable") if apart[k] <= reach]


def estimated(best: Fitted, rivals: Sequence[Fitted] = (), profiled: bool = True) -> Estimate:
    """The estimate of a finished fit. ``rivals``: optima of which the observations can hardly say that they are not the best;
    ``profiled``: intervals of Θ by the profile of the marginal likelihood, else by the covariance."""
    unknowns, values, scales = best.fit.unknowns, best.state.values, best.state.scales
    count, degrees = unknowns.theta_count, degrees_of(best)
    theta = unknowns.theta_at(values)
    found = _intervals(best, degrees, 0.0, profiled)
    for rival in rivals:
        others = _intervals(rival, degrees, max(behind(rival, best), 0.0), profiled=False)
        shifts = _shifts(best, rival)
        found = {name: one.widened(others[name], shifts[name]) if name in others else one for name, one in found.items()}
    suffix = "/weight" if "weight" in unknowns.names else ""
    known = theta.entries | {"twist_ratio": theta.twist / theta.bend[0, 0], "clip_start": values.clip[0],
                             "clip_end": values.clip[1], "up[0]": 0.0, "up[1]": 0.0}
    return Estimate(
        theta=theta,
        parameters=tuple(_parameter(name, float(known[name]), one, theta.bend)
                         for name, one in found.items() if "/" not in name),
        over_weight=tuple(_parameter(name, float(relative_stiffness(float(known[name]), theta.weight)), found[name + suffix],
                                     theta.bend)
                          for name in ("bend", "bend_1", "bend_2", "twist") if name + suffix in found),
        stiffness_along=np.exp(unknowns.stiffness_at(values, unknowns.lengths(values).mark_place)),
        values=values, scales=scales, names=unknowns.names[:count], covariance=best.posterior.covariance[:count, :count],
        degrees=degrees, rivals=tuple(one.fit.unknowns.theta_at(one.state.values) for one in rivals))


def _intervals(one: Fitted, degrees: float, above: float, profiled: bool) -> dict[str, "Interval"]:
    """The intervals around an optimum whose F is by ``above`` larger than the least."""
    unknowns, found = one.fit.unknowns, {}
    wanted = float(np.sqrt(max(fdtri(1, degrees, PROBABILITY) - above, 0.0)))
    for name, direction in _directions(unknowns).items():
        assumed = name.startswith("twist") and unknowns.rod.twist_unknown  # to be that of a common rod
        by_profile = profiled and wanted > 0 and not assumed and not name.startswith(("up", "clip"))
        # A clip's end is a length, not a logarithm.
        farthest = 0.0 if assumed else np.inf if name.startswith("clip") else FARTHEST
        found[name] = (interval(one, direction, wanted) if by_profile
                       else _by_covariance(one, direction, wanted, farthest))
    return found


def _shifts(best: Fitted, rival: Fitted) -> dict[str, float]:
    """By how much each combination of unknowns is larger in ``rival``."""
    before, after = ({name: float(direction @ one.fit.unknowns.offset(one.state.values, one.fit.origin))
                      for name, direction in _directions(one.fit.unknowns).items()} for one in (best, rival))
    return {name: after[name] - value for name, value in before.items() if name in after}


def _directions(unknowns: Unknowns) -> dict[str, np.ndarray]:
    """Combinations of unknowns that get an interval: each of Θ's, the ratio of twist to bend, stiffness over weight where the
    weight is learned too, and the clips."""
    identity = dict(zip(unknowns.names, np.eye(len(unknowns.names)), strict=True))
    of_theta = {name: identity[name] for name in unknowns.names[: unknowns.theta_count]}
    found = dict(of_theta)
    for bend in ("bend", "bend_1"):
        if bend in of_theta and "twist" in of_theta:
            found["twist_ratio"] = of_theta["twist"] - of_theta[bend]
    if "weight" in of_theta:
        found |= {f"{name}/weight": of_theta[name] - of_theta["weight"]
                  for name in ("bend", "bend_1", "bend_2", "twist") if name in of_theta}
    return found | {name: identity[name] for name in unknowns.names if name.startswith("clip")}


def _parameter(name: str, value: float, found: "Interval", bend: np.ndarray) -> Parameter:
    ends = [None if step is None else float(_moved(name, value, step, bend)) for step in (found.low, found.high)]
    return Parameter(name, value, *ends, found.error, UNITS.get(name, "mm³"))


def _moved(name: str, value: float, step, bend: np.ndarray):
    """The parameter after its unknown has changed by ``step``; ``bend`` is B, for B₁₂."""
    if name == "bend_12":
        root = np.sqrt(bend[0, 0] * bend[1, 1])
        return root * np.tanh(np.arctanh(value / root) + step)
    if name in LOGARITHMIC or name == "twist_ratio":
        return value * np.exp(step)
    return value + step


# --- intervals ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Interval:
    """The 95 % interval of a combination of unknowns around its fitted value: ``low`` ≤ 0 ≤ ``high``, None where open."""

    low: float | None
    high: float | None
    error: float  # standard deviation by the covariance

    def widened(self, other: "Interval", shift: float) -> "Interval":
        """So that it contains ``other``, around a value that is larger by ``shift``."""
        low = None if None in (self.low, other.low) else min(self.low, shift + other.low)
        high = None if None in (self.high, other.high) else max(self.high, shift + other.high)
        return replace(self, low=low, high=high)


def _by_covariance(fitted: Fitted, direction: np.ndarray, wanted: float, farthest: float) -> Interval:
    """The interval of ``direction`` (P,) · x by the covariance, ``wanted`` standard deviations each way, open where it reaches
    ``farthest``."""
    error = float(np.sqrt(direction @ fitted.posterior.covariance @ direction))
    reach = wanted * error
    return Interval(-reach, reach, error) if reach < farthest else Interval(None, None, error)


def interval(fitted: Fitted, direction: np.ndarray, wanted: float) -> Interval:
    """The interval of ``direction`` (P,) · x by the profile: where the root of F's rise becomes ``wanted``."""
    error = float(np.sqrt(direction @ fitted.posterior.covariance @ direction))
    held = replace(fitted, posterior=fitted.evidence.holding(direction).posterior(fitted.state.scales))
    fit = replace(fitted.fit, rods=fitted.state.used, tolerance=OF_INTERVALS)
    low, high = (_reach(fit, fitted, sign * direction, wanted, error, held.level) for sign in (-1.0, 1.0))
    return Interval(None if low is None else -low, high, error)


def _reach(fit: Fit, fitted: Fitted, direction: np.ndarray, wanted: float, error: float, least: float) -> float | None:
    """How far along ``direction`` the root of F's rise above ``least`` becomes ``wanted``; None beyond FARTHEST."""
    places, roots, states = [0.0], [0.0], [fitted.state]
    place = min(wanted * error, LARGEST_FIRST_TRIAL)
    for _ in range(TRIALS):
        near = int(np.argmin(np.abs(np.array(places) - place)))
        begun = fit.unknowns.offset(states[near].values, fit.origin)
        found = fit.run(states[near], STEPS, held=(direction, place - places[near]))
        reached = places[near] + float(direction @ (fit.unknowns.offset(found.state.values, fit.origin) - begun))
        root = float(np.sqrt(max(found.level - least, 0.0)))
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
        place, last = _crossing(places, roots, wanted, 0.15), max(places)
        place = place if place <= last else min(FARTHEST, float(np.clip(place, 1.2 * last, 2.5 * last)))
    reach = _crossing(places, roots, wanted)
    if reach >= 1.1 * max(places):  # too far beyond the trials: at least the value by the covariance
        reach = max(wanted * error, reach)
    return reach if LEAST < reach < FARTHEST else None


def _crossing(places: list[float], roots: list[float], wanted: float, margin: float = 0.0) -> float:
    """Where the root is ``wanted``: on the line between the last trial below and the first above, ``margin`` of their distance
    away from both at least; or beyond the trials, in proportion."""
    order = np.argsort(places)
    places, roots = np.array(places)[order], np.array(roots)[order]
    above = np.flatnonzero(roots >= wanted)
    if not len(above):
        return float(places[-1] * wanted / max(roots[-1], 1e-12))
    low, high = above[0] - 1, above[0]
    share = np.clip((wanted - roots[low]) / max(roots[high] - roots[low], 1e-12), margin, 1 - margin)
    return float(places[low] + share * (places[high] - places[low]))
