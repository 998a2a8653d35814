"""What a fit says about Θ and what it does not: covariance, intervals, regions, and directions left open.

Everything is in the unknowns of :mod:`doo_ti.refinement.parametrisation`, where the landscape is nearest to a parabola;
intervals are carried back from there, so those of positive parameters are factors and never reach zero.
"""

from dataclasses import dataclass
from math import exp, inf

import numpy as np

from doo_ti.errors import InputError
from doo_ti.refinement.confidence import f_quantile
from doo_ti.refinement.linear_density import relative_stiffness
from doo_ti.refinement.parametrisation import LOGARITHMIC, Parametrisation, Theta

LEFT_OPEN = 1.5
"""A direction whose standard error in units of the unknowns' scale is larger is not determined: a factor of 4.5 either way."""
NAMED = 0.2  # components of a unit direction that are worth naming


@dataclass(frozen=True)
class Parameter:
    """One unknown's value with its 95 % interval, in ``unit``: "mm³", "1/mm", "rad" of tilt, or "" for the weight.

    error is the standard error of the unknown itself: a relative one where the parameter is positive.
    """

    name: str
    value: float
    low: float
    high: float
    error: float
    unit: str


@dataclass(frozen=True)
class Estimate:
    """Θ with its covariance.

    theta             the optimum
    parametrisation   what was learned
    covariance        (P, P) of the unknowns
    degrees           degrees of freedom that the noise was estimated from; inf where σ was given and is reached
    """

    theta: Theta
    parametrisation: Parametrisation
    covariance: np.ndarray
    degrees: float

    @property
    def names(self) -> tuple[str, ...]:
        """(P,) the unknowns, in the order of the covariance."""
        return self.parametrisation.names

    @property
    def correlation(self) -> np.ndarray:
        """(P, P)."""
        error = np.sqrt(np.diag(self.covariance))
        return self.covariance / np.outer(error, error)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The unknowns with their 95 % intervals, one by one."""
        reach = np.sqrt(f_quantile(0.95, 1, self.degrees))
        errors = np.sqrt(np.diag(self.covariance))
        low, high = (self._values(sign * reach * errors) for sign in (-1.0, 1.0))
        return tuple(Parameter(name, value, *ends, error, self._unit(name)) for name, value, *ends, error in zip(
            self.names, self._values(0 * errors), low, high, errors.tolist(), strict=True))

    def over_weight(self, name: str) -> tuple[float, float, float]:
        """A stiffness over twice the weight, EI/w or GJ/w of the continuum in mm³, with its 95 % interval: which scale of bend,
        twist and weight together is taken drops out. ``name``: bend, bend_1, bend_2 or twist, learned or not."""
        theta, step = self.theta, np.zeros(len(self.names))
        for unknown, sign in ((name, 1.0), ("weight", -1.0)):
            if unknown in self.names:
                step[self.names.index(unknown)] = sign
        entry = int(name == "bend_2")
        value = float(relative_stiffness(theta.twist if name == "twist" else theta.bend[entry, entry], theta.weight))
        terms = np.outer(step, step) * self.covariance
        # What rounding leaves of terms that cancel, unknowns that are left open together, says nothing.
        variance = terms.sum() if terms.sum() >= 1e-9 * np.abs(terms).sum() else inf
        reach = float(np.sqrt(f_quantile(0.95, 1, self.degrees) * variance))
        return value, value * exp(-reach), value * exp(reach) if reach < 700 else inf

    @property
    def left_open(self) -> tuple[str, ...]:
        """The directions that the observations do not determine, each as a sum of unknowns."""
        scale = self.parametrisation.scale
        values, vectors = np.linalg.eigh(self.covariance / np.outer(scale, scale))
        return tuple(_named(vector, self.names) for vector in vectors.T[values > LEFT_OPEN**2])

    def holds(self, theta: Theta, probability: float = 0.95) -> bool:
        """Whether ``theta`` lies in the joint region of all unknowns that holds the truth with that probability."""
        apart = self._unknowns(theta) - self._unknowns(self.theta)
        squared = apart @ np.linalg.solve(self.covariance, apart)
        return bool(squared <= len(apart) * f_quantile(probability, len(apart), self.degrees))

    def region(self, first: str, second: str, probability: float = 0.95, points: int = 181) -> np.ndarray:
        """(points, 2) the closed outline of the region of two parameters together, in their own units: an ellipse where
        positive ones have logarithmic axes. Raises InputError for parameters that were not learned."""
        for name in (first, second):
            if name not in self.names:
                raise InputError("region", name, "was not learned", f"give two of {', '.join(self.names)}")
        index = [self.names.index(first), self.names.index(second)]
        # Where a direction is left open rounding may make the smaller of two unlike eigenvalues negative.
        values, vectors = np.linalg.eigh(self.covariance[np.ix_(index, index)])
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        angle = np.linspace(0.0, 2 * np.pi, points)
        size = np.sqrt(2 * f_quantile(probability, 2, self.degrees))
        outline = size * np.stack([np.cos(angle), np.sin(angle)], axis=1) @ root.T
        steps = np.zeros((points, len(self.names)))
        steps[:, index] = outline
        return np.array([[self._value(k, step[k]) for k in index] for step in steps])

    def _values(self, step: np.ndarray) -> list[float]:
        return [self._value(k, amount) for k, amount in enumerate(step)]

    def _value(self, k: int, step: float) -> float:
        """The parameter of unknown ``k`` at a distance from the optimum."""
        name, theta = self.names[k], self.theta
        if name in LOGARITHMIC:
            value = {"bend": theta.bend[0, 0], "bend_1": theta.bend[0, 0], "bend_2": theta.bend[1, 1], "twist": theta.twist,
                     "weight": theta.weight}[name]
            return float(value * np.exp(step)) if step < 700 else inf
        if name == "bend_12":
            root = np.sqrt(theta.bend[0, 0] * theta.bend[1, 1])
            return float(root * np.tanh(np.arctanh(theta.bend[0, 1] / root) + step))
        return float(self._unknowns(theta)[k] + step)

    def _unknowns(self, theta: Theta) -> np.ndarray:
        """(P,) the unknowns' values; tilts are from the optimum."""
        parts = []
        for name in self.parametrisation.parameters:
            if name in ("bend", "bend_1", "bend_2"):
                entry = int(name == "bend_2")
                parts.append([np.log(theta.bend[entry, entry])])
            elif name == "bend_12":
                parts.append([np.arctanh(theta.bend[0, 1] / np.sqrt(theta.bend[0, 0] * theta.bend[1, 1]))])
            elif name in ("twist", "weight"):
                parts.append([np.log(getattr(theta, name))])
            elif name == "up":
                parts.append(self.parametrisation.tilt(self.theta, theta))
            else:
                rest = np.zeros(2) if theta.rest_curvature is None else theta.rest_curvature
                size = (2,) if name == "rest_curvature" else (len(self.parametrisation.rest_length) - 1, 2)
                parts.append(np.broadcast_to(rest, size).ravel())
        return np.concatenate(parts)

    def _unit(self, name: str) -> str:
        return "1/mm" if name.startswith("rest") else {"weight": "", "up[0]": "rad", "up[1]": "rad"}.get(name, "mm³")


def _named(direction: np.ndarray, names: tuple[str, ...]) -> str:
    """A unit direction as the sum of its largest components."""
    order = np.argsort(-np.abs(direction))
    order = [k for k in order if abs(direction[k]) >= NAMED] or list(order[:1])
    sign = np.sign(direction[order[0]])
    if len(order) == 1:
        return names[order[0]]
    terms = [f"{'-' if sign * direction[k] < 0 else '+'} {abs(direction[k]):.2f} {names[k]}" for k in order[:4]]
    return " ".join(terms).removeprefix("+ ") + " ..." * (len(order) > 4)
