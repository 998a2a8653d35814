"""Θ, the parameters of one rod, and the sizes that a fit learns beside it: of noise, of errors of the clamps, and of the rest
curvature (§III-E).

All sizes are positive and have a wide log-normal prior around values typical of a rod with such marks. They are chosen by
marginal likelihood (:mod:`doo_ti.refinement.evidence`).

    marks           σ of a mark's coordinate, mm; fixed at one where the observations state their own σ
    frames          σ of each component of a measured m1
    curvature       d of the rest curvature, 1/mm (:class:`doo_ti.refinement.mesh.Field`)
    range           ρ of the rest curvature, mm
    stiffness       d of ln of the bend stiffness along the rod
    stiffness_range  its ρ, mm
    turn            standard deviation of the constant error of a reported frame, rad
    turn_scatter    standard deviation of its additional error in one observation, rad
    gap             amplitude of the smooth displacements that the model does not explain, mm
    any_turn, any_roll, any_twist, any_shift   what is not reported of a clamp's pose in one observation: its direction, its
                    roll, the angle by which the rod is twisted, rad, and its place, mm. So wide that the marks decide; not
                    learned, except the roll's where it is kept (:func:`doo_ti.refinement.rolls.kept`)

The sizes are found by BFGS with Powell's damping and projected steps (Nocedal and Wright, *Numerical Optimization*, 2006, §6.1
and procedure 18.2). Unlike SciPy's L-BFGS-B it begins with a known Hessian, and returns the one it has learned: the next of
many similar searches then takes one or two evaluations. With L-BFGS-B a fit takes twice as long.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated

import numpy as np
from numpy.typing import ArrayLike

from doo_ti.rod.types import Material
from doo_ti.system.arguments import short_repr, typed
from doo_ti.system.errors import InputError, require_whole

LONGEST = 1.5  # largest change of a variable in one step
SHORTENED, SHORTEST = 0.3, 1e-3
"""Factor by which a step that does not lower the function enough is shortened, and the smallest share that is tried."""
ARMIJO = 1e-4  # least decrease over that which the gradient promises
DAMPED = 0.2  # least curvature along a step over that of the present Hessian
RATIO = 0.8  # twist over bend stiffness of a common rod


@typed
@dataclass(frozen=True)
class Theta:
    """One material and the direction of gravity.

    bend (2, 2) mm³, twist mm³, weight μ, rest_curvature None, (2,) or (E−1, 2) in 1/mm, up (3,) unit vector
    """

    __repr__ = short_repr

    bend: Annotated[np.ndarray, "2 2"]
    twist: float
    weight: float = 1.0
    rest_curvature: Annotated[np.ndarray | None, "2 | J 2"] = None
    up: Annotated[np.ndarray, "3"] = (0.0, 0.0, 1.0)

    if TYPE_CHECKING:  # what it takes; the fields are the arrays that it makes of them
        def __init__(self, bend: ArrayLike, twist: float, weight: float = 1.0, rest_curvature: ArrayLike | None = None,
                     up: ArrayLike = (0.0, 0.0, 1.0)) -> None: ...

    def __post_init__(self) -> None:
        for name in ("bend", "rest_curvature", "up"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, np.array(getattr(self, name), dtype=np.float64))

    @classmethod
    @typed
    def of(cls, material: Material, row: int = 0, up: ArrayLike = (0.0, 0.0, 1.0)) -> "Theta":
        """Row ``row`` of ``material``. Raises InputError where bend or twist vary along the rod."""
        if material.bend.shape[1] > 1 or material.twist.shape[1] > 1:
            raise InputError("refine", "material", "bend or twist vary along the rod", "give one value for the whole rod")
        require_whole("Theta.of", "row", row, 0, material.count - 1)
        rest = material.rest_curvature
        rest = None if rest is None else rest[row, 0] if rest.shape[1] == 1 else rest[row]
        return cls(material.bend[row, 0], float(material.twist[row, 0]), float(material.weight[row]), rest, np.asarray(up))

    @property
    def entries(self) -> dict[str, float]:
        """Parameter: value, in mm³, the weight μ without unit; ``bend`` is α of a round rod."""
        return {"bend": self.bend[0, 0], "bend_1": self.bend[0, 0], "bend_2": self.bend[1, 1], "bend_12": self.bend[0, 1],
                "twist": self.twist, "weight": self.weight}

    @property
    def material(self) -> Material:
        """The same as a table of one row."""
        rest = self.rest_curvature
        return Material(self.bend, self.twist, self.weight, None if rest is None else rest[None])

    @property
    def correlation(self) -> float:
        """B₁₂/√(B₁₁B₂₂)."""
        return float(self.bend[0, 1] / np.sqrt(self.bend[0, 0] * self.bend[1, 1]))


def common_rod(theta: Theta) -> Theta:
    """``theta`` with the twist stiffness of a common rod of its bend stiffness."""
    return replace(theta, twist=RATIO * float(np.sqrt(np.linalg.det(theta.bend))))


def slopes_of_entries(bend: np.ndarray) -> np.ndarray:
    """(3, 3) derivatives of B₁₁, B₂₂ and B₁₂ by ln B₁₁, ln B₂₂ and artanh B₁₂/√(B₁₁B₂₂)."""
    first, second, mixed = bend[0, 0], bend[1, 1], bend[0, 1]
    root = np.sqrt(first * second)
    return np.array([[first, 0.0, 0.0], [0.0, second, 0.0], [0.5 * mixed, 0.5 * mixed, root - mixed**2 / root]])


# --- sizes -----------------------------------------------------------------------------------------------------------------

NAMES = ("marks", "frames", "curvature", "range", "stiffness", "stiffness_range", "turn", "turn_scatter", "gap", "any_turn",
         "any_roll", "any_twist", "any_shift")
ANY_TWIST = 3.0  # rad, typical twist where no frame says it
BOUND, BOUND_OF_RANGE = 9.0, 2.5
"""Largest |ln| of a size over its typical value; for ranges: from about a hundredth of the rod's length to all of it."""


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
        ranges = np.char.endswith(np.array(NAMES), "range")
        middle, reach = np.log(self.typical), np.where(ranges, BOUND_OF_RANGE, BOUND)
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
    typical = {"marks": 0.1 * spacing, "frames": 0.1, "curvature": 0.1 / length, "range": 0.1 * length, "stiffness": 0.05,
               "stiffness_range": 0.1 * length, "turn": 0.01, "turn_scatter": 0.003, "gap": 3e-4 * length,
               # of the direction of two marks, a parallel frame, no twist, the outermost mark
               "any_turn": 0.5, "any_roll": 3.0, "any_twist": ANY_TWIST, "any_shift": 0.1 * length}
    factor = {"marks": 5.0, "frames": 2.0, "curvature": 1.5, "range": 1.0, "stiffness_range": 1.0}
    value = np.array([fixed.get(name, typical[name]) for name in NAMES])
    return Scales(value, np.array([typical[name] for name in NAMES]), np.array([factor.get(name, 1.5) for name in NAMES]),
                  np.array([name in learned for name in NAMES]))


# --- the search for the sizes ---------------------------------------------------------------------------------------------


def minimised(function: Callable[[np.ndarray], tuple[float, np.ndarray]], x: np.ndarray, bounds: tuple[np.ndarray, np.ndarray],
              hessian: np.ndarray, steps: int, enough: float) -> tuple[np.ndarray, np.ndarray]:
    """``x`` (N,) where ``function``, which returns its value and gradient, is least within ``bounds``, and its Hessian there.

    Ends after ``steps``, or where the next step promises, or the last one gained, less than ``enough``."""
    value, gradient = function(x)
    for _ in range(steps):
        free = np.where(gradient > 0, x > bounds[0], x < bounds[1])  # not held by its bound
        step = np.zeros_like(x)
        step[free] = -np.linalg.solve(hessian[np.ix_(free, free)], gradient[free])
        if -gradient @ step < enough:
            break
        step = step * min(1.0, LONGEST / np.abs(step).max())
        share, lower = 1.0, False
        while not lower and share > SHORTEST:
            trial = np.clip(x + share * step, *bounds)
            its_value, its_gradient = function(trial)
            lower = its_value <= value + ARMIJO * gradient @ (trial - x)
            share *= SHORTENED
        if not lower:
            break
        hessian = _updated(hessian, trial - x, its_gradient - gradient)
        gained, x, value, gradient = value - its_value, trial, its_value, its_gradient
        if gained < enough:
            break
    return x, hessian


def _updated(hessian: np.ndarray, step: np.ndarray, change: np.ndarray) -> np.ndarray:
    """The Hessian with ``change`` of the gradient along ``step``, damped so that it stays positive definite."""
    along = hessian @ step
    curvature, present = step @ change, step @ along
    if curvature < DAMPED * present:
        share = (1 - DAMPED) * present / (present - curvature)
        change = share * change + (1 - share) * along
        curvature = step @ change
    return hessian - np.outer(along, along) / present + np.outer(change, change) / curvature
