"""What a fit says about Θ and what it does not: values, intervals, and regions of two parameters together.

Positive parameters are estimated by their logarithms, so their intervals are factors and never reach zero. An end of an
interval is None where the observations do not bound the parameter on that side.
"""

from dataclasses import dataclass

import numpy as np
from scipy.stats import f as f_distribution

from doo_ti.errors import InputError
from doo_ti.physical_units import relative_stiffness
from doo_ti.refinement.fit import Fit, Fitted
from doo_ti.refinement.profile import FARTHEST, Interval, interval
from doo_ti.refinement.scales import Scales
from doo_ti.refinement.unknowns import LOGARITHMIC, Theta, Values

PROBABILITY = 0.95
WIDE_FACTOR = 4.0
"""An interval whose ends are such a factor apart is called wide."""
UNITS = {"weight": "", "twist_ratio": "", "clip_start": "mm", "clip_end": "mm", "up[0]": "rad", "up[1]": "rad"}


@dataclass(frozen=True)
class Parameter:
    """One parameter with its 95 % interval, None where it is open.

    unit   "mm³", "mm", "rad" of tilt, or "" for the weight and for ratios
    error  standard deviation by the covariance: a relative one where the parameter is positive
    """

    name: str
    value: float
    low: float | None
    high: float | None
    error: float
    unit: str

    @property
    def determined(self) -> bool:
        """Bounded on one side at least."""
        return self.low is not None or self.high is not None


@dataclass(frozen=True)
class Estimate:
    """Θ, what goes with it, and how well both are known.

    theta            with the rest curvature at the joints between the marks' edges
    parameters       of Θ, the ratio of twist to bend, and the clips
    over_weight      bend and twist over twice the weight: EI/w and GJ/w of the continuum in mm³
    values           of all unknowns
    scales           noise, curvature and the clamps' errors
    names            of Θ's unknowns
    covariance       (T, T) of these
    degrees          degrees of freedom of the intervals: observations less parameters of Θ
    """

    theta: Theta
    parameters: tuple[Parameter, ...]
    over_weight: tuple[Parameter, ...]
    values: Values
    scales: Scales
    names: tuple[str, ...]
    covariance: np.ndarray
    degrees: float

    @property
    def correlation(self) -> np.ndarray:
        """(T, T)."""
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
        """Parameters that the observations bound on no side."""
        return tuple(one.name for one in self.parameters if not one.determined)

    def region(self, first: str, second: str, points: int = 181) -> np.ndarray:
        """(points, 2) the closed outline of the region that holds both parameters of Θ with 95 %, in their own units.

        An ellipse of the covariance, along whose long axis each half is stretched as the first parameter's interval is; where
        that is open it goes as far as a factor of a thousand. Raises InputError for parameters that were not learned.
        """
        index = []
        for name in (first, second):
            if name not in self.names:
                raise InputError("region", name, "was not learned", f"give two of {', '.join(self.names)}")
            index.append(self.names.index(name))
        values, vectors = np.linalg.eigh(self.covariance[np.ix_(index, index)])
        spread = np.sqrt(np.maximum(values, 0.0))
        size = np.sqrt(2 * f_distribution.ppf(PROBABILITY, 2, self.degrees))
        angle = np.linspace(0.0, 2 * np.pi, points)
        along = np.stack([np.cos(angle), np.sin(angle)]) * size * spread[:, None]
        sign = 1.0 if vectors[0, 1] >= 0 else -1.0
        below, above = self._stretch(self.parameter(first))
        along[1] *= np.where(sign * along[1] < 0, below, above)
        steps = np.clip(vectors @ along, -FARTHEST, FARTHEST)
        middle = [self.parameter(name).value for name in (first, second)]
        return np.stack([_moved(name, value, step, self.theta.bend) for name, value, step in zip(
            (first, second), middle, steps, strict=True)], axis=1)

    def _stretch(self, parameter: Parameter) -> tuple[float, float]:
        """How much longer each half of its interval is than the covariance has it."""
        reach = np.sqrt(f_distribution.ppf(PROBABILITY, 1, self.degrees)) * parameter.error
        ends = []
        for end, sign in ((parameter.low, -1.0), (parameter.high, 1.0)):
            if end is None:
                ends.append(FARTHEST / reach)
            elif parameter.name in LOGARITHMIC:
                ends.append(sign * np.log(end / parameter.value) / reach)
            else:
                ends.append(sign * (end - parameter.value) / reach)
        return ends[0], ends[1]


def estimated(fit: Fit, fitted: Fitted, profiled: bool = True) -> Estimate:
    """The estimate of a fit that has come to its end; ``profiled``: intervals of Θ from the marginal likelihood's profile."""
    unknowns, values, scales = fit.unknowns, fitted.state.values, fitted.state.scales
    count = unknowns.theta_count
    # Marks of one rod are not independent where the rod's clamps are off: what counts is how many rods there are.
    degrees = max(float(fitted.state.used.sum()) - count, 1.0)
    theta = unknowns.theta_at(values)
    names = unknowns.names[:count]
    found = {}
    for name, direction in _directions(unknowns.names, count).items():
        if profiled and not name.startswith("up"):
            found[name] = interval(fit, fitted, direction, degrees, PROBABILITY)
        else:
            found[name] = _by_covariance(fitted.posterior.covariance, direction, degrees)
    for k, name in enumerate(unknowns.names):
        if name.startswith("clip"):
            found[name] = _by_covariance(fitted.posterior.covariance, np.eye(len(unknowns.names))[k], degrees)
    stiffness = {name.removesuffix("/weight"): one for name, one in found.items() if name.endswith("/weight")}
    weightless = "weight" not in names
    over = {name: found.get(name) if weightless else stiffness.get(name) for name in ("bend", "bend_1", "bend_2", "twist")}
    return Estimate(
        theta=theta,
        parameters=tuple(_parameter(name, _value(name, theta, values), one, theta.bend)
                         for name, one in found.items() if "/" not in name),
        over_weight=tuple(_parameter(name, float(relative_stiffness(_value(name, theta, values), theta.weight)), one)
                          for name, one in over.items() if one is not None),
        values=values, scales=scales, names=names, covariance=fitted.posterior.covariance[:count, :count], degrees=degrees)


def _directions(names: tuple[str, ...], count: int) -> dict[str, np.ndarray]:
    """Combinations of unknowns that intervals are asked for: each of Θ's, the ratio of twist to bend, and, where the weight is
    learned too, stiffness over weight."""
    identity = {name: row for name, row in zip(names[:count], np.eye(len(names)), strict=False)}
    found = dict(identity)
    for bend in ("bend", "bend_1"):
        if bend in identity and "twist" in identity:
            found["twist_ratio"] = identity["twist"] - identity[bend]
    if "weight" in identity:
        for name in ("bend", "bend_1", "bend_2", "twist"):
            if name in identity:
                found[f"{name}/weight"] = identity[name] - identity["weight"]
    return found


def _by_covariance(covariance: np.ndarray, direction: np.ndarray, degrees: float) -> Interval:
    error = float(np.sqrt(direction @ covariance @ direction))
    reach = float(np.sqrt(f_distribution.ppf(PROBABILITY, 1, degrees))) * error
    return Interval(-reach, reach, error) if reach < FARTHEST else Interval(None, None, error)


def _value(name: str, theta: Theta, values: Values) -> float:
    bend = theta.bend
    known = {"bend": bend[0, 0], "bend_1": bend[0, 0], "bend_2": bend[1, 1], "bend_12": bend[0, 1], "twist": theta.twist,
             "weight": theta.weight, "twist_ratio": theta.twist / bend[0, 0], "clip_start": values.clip[0],
             "clip_end": values.clip[1]}
    return float(known.get(name, 0.0))


def _parameter(name: str, value: float, found: Interval, bend: np.ndarray | None = None) -> Parameter:
    ends = [None if step is None else float(_moved(name, value, step, bend)) for step in (found.low, found.high)]
    return Parameter(name, value, *ends, found.error, UNITS.get(name, "mm³"))


def _moved(name: str, value: float, step, bend: np.ndarray | None = None):
    """The parameter where its unknown is ``step`` from what it is; ``bend`` is B, for B₁₂."""
    if name == "bend_12":
        root = np.sqrt(bend[0, 0] * bend[1, 1])
        return root * np.tanh(np.arctanh(value / root) + step)
    if name in LOGARITHMIC or name == "twist_ratio":
        return value * np.exp(step)
    return value + step
