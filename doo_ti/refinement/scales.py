"""Sizes that a fit learns besides its unknowns: noise, the spread of rest curvature, how far clamps are off.

Each is positive and has a log-normal prior, wide, about what is typical of a rod with such marks. They are chosen by marginal
likelihood (:mod:`doo_ti.refinement.evidence`).

    marks           σ of a mark's coordinate, mm; one, and fixed, where the observations state their own
    frames          σ of a measured m1, for each of its components
    curvature       spread d of the rest curvature, 1/mm
    range           range ρ of the rest curvature, mm
    turn, shift     spread of a clamp's constant error, rad and mm
    turn_scatter, shift_scatter   how far a clamp is off in one observation besides, rad and mm
    gap             what the model misses in each observation: amplitude of smooth displacements, mm
"""

from dataclasses import dataclass, replace

import numpy as np

NAMES = ("marks", "frames", "curvature", "range", "turn", "shift", "turn_scatter", "shift_scatter", "gap")
REACH, REACH_OF_RANGE = 9.0, 2.5
"""A size stays within this many factors e of what is typical; the range of the rest curvature between about a hundredth of the
rod's length and the whole."""


@dataclass(frozen=True)
class Scales:
    """The sizes of one fit. All arrays follow NAMES.

    value    what they are now
    typical  medians of the priors
    factor   standard deviations of their logarithms under the priors
    learned  bool: which of them are learned; the others stay
    """

    value: np.ndarray
    typical: np.ndarray
    factor: np.ndarray
    learned: np.ndarray

    def __getitem__(self, name: str) -> float:
        return float(self.value[NAMES.index(name)])

    @property
    def free(self) -> np.ndarray:
        """(H,) logarithms of those that are learned."""
        return np.log(self.value[self.learned])

    @property
    def bounds(self) -> list[tuple[float, float]]:
        middle = np.log(self.typical)
        reach = np.where(np.array(NAMES) == "range", REACH_OF_RANGE, REACH)
        return list(zip((middle - reach)[self.learned], (middle + reach)[self.learned], strict=True))

    def at(self, free: np.ndarray) -> "Scales":
        """These sizes with the learned ones' logarithms at ``free`` (H,)."""
        value = self.value.copy()
        value[self.learned] = np.exp(free)
        return replace(self, value=value)

    def learning(self, names: set[str]) -> "Scales":
        """The same, those of ``names`` that have stayed at what is typical learned too."""
        new = np.array([name in names for name in NAMES]) & (self.value == self.typical)
        return replace(self, learned=self.learned | new)

    def prior(self) -> tuple[float, np.ndarray]:
        """−2 ln of the priors of the learned sizes but for a constant, and its gradient (H,) by their logarithms."""
        apart = (np.log(self.value / self.typical) / self.factor)[self.learned]
        return float(apart @ apart), 2 * apart / self.factor[self.learned]


def typical_scales(length: float, spacing: float, learned: set[str], fixed: dict[str, float]) -> Scales:
    """Sizes to begin with, of rods of ``length`` mm with marks ``spacing`` mm apart.

    learned  names of those that are learned
    fixed    values of others; what is neither stays at what is typical
    """
    typical = {"marks": 0.1 * spacing, "frames": 0.1, "curvature": 0.1 / length, "range": 0.1 * length, "turn": 0.01,
               "shift": 0.01 * spacing, "turn_scatter": 0.003, "shift_scatter": 0.003 * spacing, "gap": 3e-4 * length}
    factor = {"marks": 5.0, "frames": 2.0, "curvature": 1.5, "range": 1.0}
    value = np.array([fixed.get(name, typical[name]) for name in NAMES])
    return Scales(value, np.array([typical[name] for name in NAMES]), np.array([factor.get(name, 1.5) for name in NAMES]),
                  np.array([name in learned for name in NAMES]))
