"""Cross-validation of a refinement: Θ from some of the observations, Eq. 1 on the others (§III-E).

Observations that belong together, such as frames of one recording, are left out together. D observations.
"""

from dataclasses import dataclass, replace

import numpy as np

from doo_ti.refinement.fit import Fit
from doo_ti.refinement.held_rod import POSE, HeldRod
from doo_ti.refinement.refine import Refinement, RefinementOptions, refine, unknowns_of
from doo_ti.refinement.residuals import Comparison
from doo_ti.refinement.rolls import WINDOW, at_all_rolls
from doo_ti.refinement.theta import Theta
from doo_ti.rod.observations import Observations
from doo_ti.rod.types import Clamps
from doo_ti.system.errors import InputError


@dataclass(frozen=True)
class HeldOut:
    """Errors of observations under the Θ of the others."""

    fold: np.ndarray  # (D,) the fold that each observation was left out with
    refinements: tuple[Refinement, ...]  # one for each fold, of all observations but the fold's
    distance: np.ndarray  # (D,) Eq. 1 in mm, each rod relaxed from its observation; NaN for rods that failed
    sound: np.ndarray  # (D,) bool: converged and stable

    @property
    def mean_distance(self) -> float:
        """mm, over the sound rods."""
        return float(self.distance[self.sound].mean()) if self.sound.any() else np.nan

    @property
    def standard_error(self) -> float:
        """mm, of the mean, from the variation of the folds' means: observations of one fold are not independent."""
        means = [self.distance[self.sound & (self.fold == k)].mean() for k in np.unique(self.fold[self.sound])]
        return float(np.std(means, ddof=1) / np.sqrt(len(means))) if len(means) > 1 else np.nan


def folds_of(groups: np.ndarray, count: int) -> np.ndarray:
    """(D,) fold of each observation: ``count`` folds of about the same size that keep every group of ``groups`` (D,) together.

    Groups are placed in order of size, the largest first, each into the smallest fold. Raises InputError for fewer groups than
    folds.
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
        within, beyond = (replace(options, surroundings=options.surroundings.take(rows),
                                  loads=None if options.loads is None else options.loads[rows]) for rows in (inside, outside))
        found = refine(observations.take(inside), clamps.take(inside), theta, within)
        error[outside], sound[outside] = _predicted(found, observations.take(outside), clamps.take(outside), beyond)
        refinements.append(found)
    return HeldOut(fold, tuple(refinements), error, sound)


def _predicted(found: Refinement, observations: Observations, clamps: Clamps, options: RefinementOptions
               ) -> tuple[np.ndarray, np.ndarray]:
    """(D,) Eq. 1 in mm of observations that ``found`` was not fitted to, each rod relaxed from its observation, and (D,) bool
    whether it is converged and stable. What is not known of its clamps is fitted to each observation."""
    edges = 2 * found.mesh_edges if found.mesh_error is not None else found.mesh_edges
    rod = HeldRod(observations, clamps, edges, options.surroundings, options.clamps == "exact", found.swivels, options.loads)
    unknowns = unknowns_of(rod, options)
    if not len(found.estimate.values.curvature):
        unknowns = replace(unknowns, curvature="none")
    unknowns = replace(unknowns, uneven=len(found.estimate.values.stiffness) > 0)
    fit = Fit(Comparison.of(unknowns, options.frame_weight > 0), found.estimate.values, options.solver)
    scales = found.estimate.scales
    if rod.rolled_together and len(unknowns.knots):
        fit, scales = at_all_rolls(fit), scales.given(any_roll=WINDOW)
    rod = fit.unknowns.rod
    values = replace(found.estimate.values, scatter=np.zeros((rod.observations.count, POSE)))
    state = fit.posed(fit.from_marks(values, scales))
    sound, lengths = state.sound, unknowns.lengths(values)
    distance = rod.distance(rod.marks(state.solution, lengths), state.solution, lengths, options.frame_weight)
    least = rod.by_observation(np.where(sound, fit.mean_squares(state.residuals), np.inf)).argmin(axis=1)
    best = np.arange(len(least)) * rod.copies + least
    return distance[best], sound[best]
