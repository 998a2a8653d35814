"""Cross-validation of a refinement: Θ from some of the observations, Eq. 1 on the others (§III-E).

Observations that belong together, frames of one recording, are left out together.
"""

from dataclasses import dataclass, replace

import numpy as np

from doo_ti.errors import InputError
from doo_ti.io.observations import Observations
from doo_ti.refinement.refine import Refinement, RefinementOptions, predicted, refine
from doo_ti.refinement.unknowns import Theta
from doo_ti.types import Clamps


@dataclass(frozen=True)
class HeldOut:
    """Errors of observations under the Θ of the others.

    fold         (D,) which fold left each observation out
    refinements  one for each fold
    distance     (D,) Eq. 1 in mm, each rod relaxed from its observation; NaN if it came to nothing
    sound        (D,) bool: converged and stable
    """

    fold: np.ndarray
    refinements: tuple[Refinement, ...]
    distance: np.ndarray
    sound: np.ndarray

    @property
    def mean_distance(self) -> float:
        """mm, over the sound rods."""
        return float(self.distance[self.sound].mean()) if self.sound.any() else np.nan

    @property
    def standard_error(self) -> float:
        """mm, of the mean, from how the folds' means differ: observations of one fold are not independent."""
        means = [self.distance[self.sound & (self.fold == k)].mean() for k in np.unique(self.fold[self.sound])]
        return float(np.std(means, ddof=1) / np.sqrt(len(means))) if len(means) > 1 else np.nan


def folds_of(groups: np.ndarray, count: int) -> np.ndarray:
    """(D,) fold of each observation: ``count`` folds of about the same size that cut no group (D,) apart.

    The largest group goes first, each to the smallest fold. Raises InputError for fewer groups than folds.
    """
    names, of_group, sizes = np.unique(groups, return_inverse=True, return_counts=True)
    if not 2 <= count <= len(names):
        raise InputError("refine", "folds", f"{count} folds of {len(names)} groups", f"give 2 to {len(names)} folds")
    filled, fold = np.zeros(count, dtype=int), np.zeros(len(names), dtype=int)
    for group in np.argsort(-sizes, kind="stable"):
        fold[group] = np.argmin(filled)
        filled[fold[group]] += sizes[group]
    return fold[of_group]


def refine_held_out(observations: Observations, clamps: Clamps, theta: Theta, fold: np.ndarray,
                    options: RefinementOptions = RefinementOptions()) -> HeldOut:
    """Refine from ``theta`` without each fold (D,) in turn, and compare the observations of that fold."""
    error, sound = np.full(observations.count, np.nan), np.zeros(observations.count, dtype=bool)
    options, refinements = replace(options, intervals="covariance", models=False), []
    for k in np.unique(fold):
        inside, outside = np.flatnonzero(fold != k), np.flatnonzero(fold == k)
        found = refine(observations.take(inside), clamps.take(inside), theta, options)
        error[outside], sound[outside] = predicted(found, observations.take(outside), clamps.take(outside), options)
        refinements.append(found)
    return HeldOut(fold, tuple(refinements), error, sound)
