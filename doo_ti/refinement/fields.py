"""Smooth functions along a rod: its rest curvature, and by how much its bend stiffness varies.

Each component is a Gaussian process of zero mean with the covariance of Matérn 3/2 (Rasmussen and Williams, *Gaussian Processes
for Machine Learning*, 2006),

    cov(s, s') = d² (1 + r) e^{−r},   r = √3 |s − s'|/ρ,

d its standard deviation and ρ its range in mm. It is the same in all observations; between K knots it is linear.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from doo_ti.refinement.theta import Scales

MOST_KNOTS = 16
JITTER = 1e-6  # share of the variance that is added on the diagonal, which keeps the covariance of a smooth field invertible


@dataclass(frozen=True)
class Field:
    """One of them, among the unknowns of a fit."""

    name: str  # of its unknowns, and of d in :mod:`doo_ti.refinement.theta`
    range: str  # name of ρ there
    knots: np.ndarray  # (K,) mm
    components: int
    factor: float  # from the function to its unknowns

    def covariance(self, scales: "Scales") -> tuple[np.ndarray, np.ndarray]:
        """(K, K) prior covariance of the unknowns of one component, and its derivative by ln ρ."""
        return covariance(self.knots, scales[self.name] * self.factor, scales[self.range])


def knots_of(rest_length: np.ndarray) -> np.ndarray:
    """(K,) arc lengths of the knots in mm, for a rod with those edges: its inner marks, or MOST_KNOTS evenly spaced places."""
    place = np.cumsum(rest_length)[:-1]
    if len(place) <= MOST_KNOTS:
        return place
    return np.linspace(place[0], place[-1], MOST_KNOTS)


def values_at(place: np.ndarray, knots: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(X, K) weights of the knots at arc lengths ``place`` (X,), and their derivatives by arc length; constant beyond the
    outermost knots."""
    weights, slopes = np.zeros((2, len(place), len(knots)))
    rows = np.arange(len(place))
    if len(knots) == 1:
        weights[:] = 1.0
        return weights, slopes
    low = np.clip(np.searchsorted(knots, place, side="right") - 1, 0, len(knots) - 2)
    span = knots[low + 1] - knots[low]
    share = (place - knots[low]) / span
    inside = (share >= 0) & (share <= 1)
    share = np.clip(share, 0.0, 1.0)
    weights[rows, low], weights[rows, low + 1] = 1 - share, share
    slopes[rows, low], slopes[rows, low + 1] = np.where(inside, -1 / span, 0.0), np.where(inside, 1 / span, 0.0)
    return weights, slopes


def covariance(knots: np.ndarray, spread: float, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """(K, K) covariance of one component at the knots for d = ``spread`` and ρ = ``reach``, and its derivative by ln ρ."""
    r = np.sqrt(3) * np.abs(knots[:, None] - knots) / reach
    decay = np.exp(-r)
    matrix = spread**2 * ((1 + r) * decay + JITTER * np.eye(len(knots)))
    return matrix, spread**2 * r**2 * decay
