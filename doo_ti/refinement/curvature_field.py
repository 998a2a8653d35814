"""Rest curvature as a random field along the rod: unknown, the same in all observations, smooth over some range.

Each of its two components in the material frame is a Gaussian process of zero mean with the covariance of Matérn 3/2,

    cov(s, s') = d² (1 + r) e^{−r},   r = √3 |s − s'|/ρ,

d the spread in 1/mm and ρ the range in mm, both learned. Between knots the field is linear.
"""

import numpy as np

MOST_KNOTS = 40
JITTER = 1e-6
"""Of the variance, on the diagonal: keeps the covariance of a smooth field invertible."""


def knots_of(rest_length: np.ndarray) -> np.ndarray:
    """(K,) arc lengths of the field's knots in mm: the inner marks of a rod with those edges, or fewer places evenly spread."""
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
    """(K, K) covariance of one component at the knots, and its derivative by the logarithm of the range ``reach``."""
    r = np.sqrt(3) * np.abs(knots[:, None] - knots) / reach
    decay = np.exp(-r)
    matrix = spread**2 * ((1 + r) * decay + JITTER * np.eye(len(knots)))
    return matrix, spread**2 * r**2 * decay
