"""Θ of a rod in motion: material, rest shape, mass of its markers, damping and drag, as a vector to fit and as a file."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial import legendre

from doo_ti.dynamics.parameters import Dynamics
from doo_ti.types import Material

UNITS = {"bend": "mm³", "twist": "mm³", "bend_damping": "s", "drag": "1/s", "quadratic_drag": "1/mm", "marker_share": "",
         "rest_curvature": "1/mm"}


@dataclass(frozen=True)
class MotionTheta:
    """What moves a rod as it was seen to move; all stiffness relative to the weight per length of rod and markers together.

    bend            α, mm³ (weight 1)
    twist_ratio     β/α
    bend_damping    τ, s; twist_damping is the same
    drag            1/s
    quadratic_drag  1/mm
    marker_share    of the mass that is in the markers, one at every vertex, in [0, 1)
    rest            (2, K) Legendre coefficients of the rest curvature about m2 and −m1 along the rod, 1/mm
    rest_length     (E,) mm
    reference       (3,) towards which m1 of the first edge points where a recording begins
    """

    bend: float
    twist_ratio: float
    bend_damping: float
    drag: float
    quadratic_drag: float
    marker_share: float
    rest: np.ndarray
    rest_length: np.ndarray
    reference: np.ndarray

    @property
    def rest_curvature(self) -> np.ndarray:
        """(E − 1, 2) ω̄ at the inner vertices, 1/mm."""
        along = 2.0 * np.cumsum(self.rest_length)[:-1] / np.sum(self.rest_length) - 1.0
        return np.stack([legendre.legval(along, coefficients) if len(coefficients) else 0.0 * along
                         for coefficients in self.rest], axis=-1)


def simulated(thetas: list[MotionTheta]) -> tuple[Material, Dynamics]:
    """The rows of several Θ for :func:`doo_ti.dynamics.simulate.simulate`."""
    def column(name):
        return np.array([getattr(theta, name) for theta in thetas])
    bend, own = column("bend"), 1.0 - column("marker_share")
    rest = np.stack([theta.rest_curvature for theta in thetas])
    length = thetas[0].rest_length.sum()
    marker = column("marker_share") / own * length / (len(thetas[0].rest_length) + 1)
    material = Material(bend, bend * column("twist_ratio"), own, rest)
    dynamics = Dynamics(bend_damping=column("bend_damping"), twist_damping=column("bend_damping"), drag=column("drag") / own,
                        quadratic_drag=column("quadratic_drag") / own, point_mass=marker)
    return material, dynamics


class Unknowns:
    """Θ as a vector p: log α, and the others in units in which a tenth is a small change."""

    SIZES = {"bend_damping": 0.03, "drag": 0.3, "quadratic_drag": 1e-4, "marker_share": 0.3, "twist_ratio": 1.0}
    CURVATURE = 1e-3
    """1/mm"""

    def __init__(self, begin: MotionTheta, modes: int, fitted: tuple[str, ...]):
        self.begin, self.modes, self.fitted = begin, modes, tuple(fitted)
        unbounded = 2 * modes
        self.lower = np.array([-np.inf, *[0.02 if name == "twist_ratio" else 0.0 for name in fitted], *[-np.inf] * unbounded])
        self.upper = np.array([np.inf, *[3.0 if name == "marker_share" else np.inf for name in fitted], *[np.inf] * unbounded])

    @property
    def names(self) -> list[str]:
        """Of the entries of p."""
        return ["bend", *self.fitted, *(f"rest_curvature_{1 + k // self.modes}_{k % self.modes}" for k in range(2 * self.modes))]

    def vector(self, theta: MotionTheta) -> np.ndarray:
        """(P,) p of Θ."""
        rest = np.zeros((2, self.modes))
        common = min(self.modes, theta.rest.shape[1])
        rest[:, :common] = theta.rest[:, :common]
        return np.array([np.log(theta.bend), *(getattr(theta, name) / self.SIZES[name] for name in self.fitted),
                         *(rest / self.CURVATURE).ravel()])

    def theta(self, p: np.ndarray) -> MotionTheta:
        """Θ of p."""
        values = {name: float(self.SIZES[name] * entry) for name, entry in zip(self.fitted, p[1:], strict=False)}
        rest = p[1 + len(self.fitted) :].reshape(2, self.modes) * self.CURVATURE
        return replace(self.begin, bend=float(np.exp(p[0])), rest=rest, **values)
