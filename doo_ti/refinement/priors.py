"""Priors of a fit whose sizes are learned: noise, errors of the clamps, and rest curvature as a random field along the rod.

Each component of the rest curvature in the material frame is a Gaussian process of zero mean with the covariance of Matérn 3/2
(Rasmussen and Williams, *Gaussian Processes for Machine Learning*, 2006),

    cov(s, s') = d² (1 + r) e^{−r},   r = √3 |s − s'|/ρ,

d the standard deviation in 1/mm and ρ the range in mm. It is the same in all observations; between K knots it is linear.

All sizes are positive and have a wide log-normal prior around values typical of a rod with such marks. They are chosen by
marginal likelihood (:mod:`doo_ti.refinement.evidence`).

    marks           σ of a mark's coordinate, mm; fixed at one where the observations state their own σ
    frames          σ of each component of a measured m1
    curvature       d of the rest curvature, 1/mm
    range           ρ of the rest curvature, mm
    turn            standard deviation of the constant error of a reported frame, rad
    turn_scatter    standard deviation of its additional error in one observation, rad
    gap             amplitude of the smooth displacements that the model does not explain, mm
    any_turn, any_roll, any_twist, any_shift   what is not reported of a clamp's pose in one observation: its direction, its
                    roll, the angle by which the rod is twisted, rad, and its place, mm. So wide that the marks decide; not
                    learned
"""

from dataclasses import dataclass, replace

import numpy as np

NAMES = ("marks", "frames", "curvature", "range", "turn", "turn_scatter", "gap", "any_turn", "any_roll", "any_twist",
         "any_shift")
ANY_TURN, ANY_ROLL, ANY_TWIST, ANY_SHIFT = 0.5, 3.0, 3.0, 0.1
"""rad, rad, rad, and over the rod's length: of the direction of two marks, a parallel frame, no twist, the outermost mark."""
BOUND, BOUND_OF_RANGE = 9.0, 2.5
"""Largest |ln| of a size over its typical value; for the range: from about a hundredth of the rod's length to all of it."""
MOST_KNOTS = 16
JITTER = 1e-6  # share of the variance that is added on the diagonal, which keeps the covariance of a smooth field invertible


@dataclass(frozen=True)
class Scales:
    """The sizes of one fit. All arrays follow NAMES."""

    value: np.ndarray  # present values
    typical: np.ndarray  # medians of the priors
    factor: np.ndarray  # standard deviations of the logarithms under the priors
    learned: np.ndarray  # bool: which of them are learned; the others are fixed
    # (H, H) of F (:mod:`doo_ti.refinement.evidence`) by the logarithms of the H learned sizes, as the last search for them left
    # it: where the next one begins. None before the first
    hessian: np.ndarray | None = None

    def __getitem__(self, name: str) -> float:
        return float(self.value[NAMES.index(name)])

    @property
    def free(self) -> np.ndarray:
        """(H,) logarithms of the learned sizes."""
        return np.log(self.value[self.learned])

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """(H,) least and largest logarithms of the learned sizes."""
        middle, reach = np.log(self.typical), np.where(np.array(NAMES) == "range", BOUND_OF_RANGE, BOUND)
        return (middle - reach)[self.learned], (middle + reach)[self.learned]

    def at(self, free: np.ndarray) -> "Scales":
        """These sizes with logarithms ``free`` (H,) of the learned ones."""
        value = self.value.copy()
        value[self.learned] = np.exp(free)
        return replace(self, value=value)

    def given(self, **value: float) -> "Scales":
        """These sizes with other present values of some."""
        return replace(self, value=np.array([value.get(name, now) for name, now in zip(NAMES, self.value, strict=True)]))

    def learning(self, names: set[str]) -> "Scales":
        """The same, but ``names`` are learned too if they still have their typical values."""
        new = np.array([name in names for name in NAMES]) & (self.value == self.typical)
        return replace(self, learned=self.learned | new, hessian=None if new.any() else self.hessian)

    def prior(self) -> tuple[float, np.ndarray]:
        """−2 ln of the priors of the learned sizes, without its constant, and its gradient (H,) by their logarithms."""
        apart = (np.log(self.value / self.typical) / self.factor)[self.learned]
        return float(apart @ apart), 2 * apart / self.factor[self.learned]


def typical_scales(length: float, spacing: float, learned: set[str], fixed: dict[str, float]) -> Scales:
    """Initial sizes for rods of ``length`` mm with marks ``spacing`` mm apart.

    learned  names of the learned sizes
    fixed    values of others; sizes in neither stay at their typical values
    """
    typical = {"marks": 0.1 * spacing, "frames": 0.1, "curvature": 0.1 / length, "range": 0.1 * length, "turn": 0.01,
               "turn_scatter": 0.003, "gap": 3e-4 * length, "any_turn": ANY_TURN, "any_roll": ANY_ROLL, "any_twist": ANY_TWIST,
               "any_shift": ANY_SHIFT * length}
    factor = {"marks": 5.0, "frames": 2.0, "curvature": 1.5, "range": 1.0}
    value = np.array([fixed.get(name, typical[name]) for name in NAMES])
    return Scales(value, np.array([typical[name] for name in NAMES]), np.array([factor.get(name, 1.5) for name in NAMES]),
                  np.array([name in learned for name in NAMES]))


# --- the field of rest curvature ------------------------------------------------------------------------------------------


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
