"""Along a rod between its clips: its mesh, where marks are on it, and smooth functions: its rest curvature, and by how much its
bend stiffness varies.

A discrete rod whose first edge is held bends from the middle of that edge on. So the middle of the mesh's first edge is placed
at the end of the clip, ``clip`` mm from the first mark, and likewise at the other end. All edges have the length

    h = (L − c_0 − c_1)/(N − 1)        with both ends clamped, L the length between the outer marks.

A clip that ends before the outer mark has a negative length. Marks lie between the mesh's vertices, by cubic interpolation;
inside a clip the rod is straight.

Each component of a function is a Gaussian process of zero mean with the covariance of Matérn 3/2 (Rasmussen and Williams,
*Gaussian Processes for Machine Learning*, 2006),

    cov(s, s') = d² (1 + r) e^{−r},   r = √3 |s − s'|/ρ,

d its standard deviation and ρ its range in mm. It is the same in all observations; between K knots it is linear.

Axes: M marks, N edges of the mesh, K knots.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from doo_ti.refinement.theta import Scales

GEOMETRY = 3  # columns of derivatives by both clip lengths and by L
MOST_KNOTS = 16
JITTER = 1e-6  # share of the variance that is added on the diagonal, which keeps the covariance of a smooth field invertible


@dataclass(frozen=True)
class Lengths:
    """Where marks and clips are along the rod."""

    clip: np.ndarray  # (2,) mm from the outer marks inwards to where the clips end
    spacing: np.ndarray  # (M − 1,) mm of rod between neighbouring marks

    @cached_property
    def mark_place(self) -> np.ndarray:
        """(M,) arc length of the marks from the first one, mm."""
        return np.concatenate([[0.0], np.cumsum(self.spacing)])

    @property
    def mark_slope(self) -> np.ndarray:
        """(M, M − 1) its derivatives by the logarithms of the spacings, mm."""
        return np.tri(len(self.mark_place), len(self.spacing), -1) * self.spacing


@dataclass(frozen=True)
class Mesh:
    """The mesh for given lengths."""

    edge: float  # h, mm
    place: np.ndarray  # (N + 1,) arc length of its vertices from the first mark, mm
    edge_slope: np.ndarray  # (GEOMETRY,) derivative of ``edge``
    first_slope: np.ndarray  # (GEOMETRY,) derivative of ``place[0]``

    @property
    def joints(self) -> np.ndarray:
        """(N − 1,) mm."""
        return self.place[1:-1]

    @property
    def middles(self) -> np.ndarray:
        """(N,) mm, of the edges."""
        return 0.5 * (self.place[1:] + self.place[:-1])

    def slope(self, place: np.ndarray) -> np.ndarray:
        """(X, GEOMETRY) derivative of arc lengths ``place`` (X,) at the same u = (s − s_0)/h, as of joints and middles."""
        return self.first_slope + ((place - self.place[0]) / self.edge)[:, None] * self.edge_slope

    @classmethod
    def between(cls, clamped: np.ndarray, edges: int, lengths: Lengths) -> "Mesh":
        """The mesh of so many ``edges``; ``clamped`` (2,) bool: ends with a clip, the length of another one is ignored."""
        held = clamped.astype(float)
        count = edges - 0.5 * held.sum()
        edge = (float(lengths.spacing.sum()) - held @ lengths.clip) / count
        slope = np.append(-held, 1.0) / count
        first = held[0] * (lengths.clip[0] - 0.5 * edge)
        first_slope = held[0] * (np.eye(GEOMETRY)[0] - 0.5 * slope)
        return cls(edge, first + edge * np.arange(edges + 1), slope, first_slope)

    def at(self, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(X, N + 1) weights of the vertices at arc lengths ``place`` (X,), and their derivatives by u = (s − s_0)/h: of a
        cubic spline, but linear in the outermost intervals and beyond, which a clip may hold."""
        from scipy.interpolate import CubicSpline

        u, count = (place - self.place[0]) / self.edge, len(self.place)
        low, one = np.clip(np.floor(u).astype(int), 0, count - 2), np.eye(count)
        slopes = one[low + 1] - one[low]
        weights = one[low] + (u - low)[:, None] * slopes
        inner = (u > 1) & (u < count - 2)
        if count >= 6:
            spline = CubicSpline(np.arange(1, count - 1), one[1:-1])
            weights[inner], slopes[inner] = spline(u[inner]), spline(u[inner], 1)
        return weights, slopes

    def at_edges(self, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(X, N) weights of the edges, each at its middle and linear in between, and their derivatives by u."""
        weights, slopes = values_at(place, self.middles)
        return weights, slopes * self.edge

    def slide(self, place: np.ndarray) -> np.ndarray:
        """(X, GEOMETRY) derivative of u = (s − s_0)/h at given arc lengths s."""
        return -self.slope(place) / self.edge


# --- functions along the rod ----------------------------------------------------------------------------------------------

@dataclass(frozen=True)
class Field:
    """A function along the rod, among the unknowns of a fit."""

    name: str  # of its unknowns, and of d in :mod:`doo_ti.refinement.theta`
    range: str  # name of ρ there
    knots: np.ndarray  # (K,) mm
    components: int
    factor: float  # from the function to its unknowns

    def covariance(self, scales: Scales) -> tuple[np.ndarray, np.ndarray]:
        """(K, K) prior covariance of the unknowns of one component, and its derivative by ln ρ."""
        r = np.sqrt(3) * np.abs(self.knots[:, None] - self.knots) / scales[self.range]
        decay, variance = np.exp(-r), (scales[self.name] * self.factor) ** 2
        return variance * ((1 + r) * decay + JITTER * np.eye(len(self.knots))), variance * r**2 * decay


def knots_of(rest_length: np.ndarray) -> np.ndarray:
    """(K,) arc lengths of the knots in mm, for a rod with those edges: its inner marks, or MOST_KNOTS evenly spaced places."""
    place = np.cumsum(rest_length)[:-1]
    if len(place) <= MOST_KNOTS:
        return place
    return np.linspace(place[0], place[-1], MOST_KNOTS)


def values_at(place: np.ndarray, knots: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(X, K) weights of the knots at arc lengths ``place`` (X,), and their derivatives by arc length; constant beyond the
    outermost knots."""
    if len(knots) < 2:
        return np.ones((len(place), len(knots))), np.zeros((len(place), len(knots)))
    low, one = np.clip(np.searchsorted(knots, place, side="right") - 1, 0, len(knots) - 2), np.eye(len(knots))
    share = (place - knots[low]) / (knots[low + 1] - knots[low])
    inside = (share >= 0) & (share <= 1)
    slopes = (inside / (knots[low + 1] - knots[low]))[:, None] * (one[low + 1] - one[low])
    share = np.clip(share, 0.0, 1.0)[:, None]
    return (1 - share) * one[low] + share * one[low + 1], slopes
