"""The least χ² of D rods over Θ: Levenberg–Marquardt with derivatives by the implicit function theorem (§III-E).

Between steps every rod is relaxed from where it was, which keeps it on its branch of equilibria. All matrices are in units of
the unknowns' scale. Axes: D observations, N numbers compared in each, P unknowns.
"""

from dataclasses import dataclass, replace

import numpy as np

from doo_ti.dataset import Observations
from doo_ti.errors import InputError
from doo_ti.refinement.misfit import Misfit
from doo_ti.refinement.parametrisation import Parametrisation, Theta
from doo_ti.refinement.sensitivity import sensitivity
from doo_ti.relaxation.relax import relax_again
from doo_ti.types import Solution

LARGEST_STEP = 1.0  # of any unknown: small steps keep rods on their branches
LEAST = 1e-4  # information about an unknown below which a step leaves it where it is
FIRST_DAMPING, NO_DAMPING, MOST_DAMPING = 1e-4, 1e-9, 1e10
PATIENT = 1e3  # damping above which a step may cost rods
SMALLEST_STEP = 1e-7  # a smaller one that is refused is refused by rounding
FALLEN = 1e-7  # that much χ² may still fall when the fit is done: a standard error is worth one


@dataclass(frozen=True)
class State:
    """Rods at one Θ: their weighted residuals (D, N), zero in rods that do not count, and which do, ``used`` (D,)."""

    theta: Theta
    solution: Solution
    residuals: np.ndarray
    used: np.ndarray


@dataclass(frozen=True)
class Normal:
    """The normal equations at a state: the gradient (P,), what each observation adds to it (D, P), and half the Hessian (P, P)
    of χ² and of χ² with the prior. ``variance`` is the unit of squared residuals: one where σ is known."""

    gradient: np.ndarray
    scores: np.ndarray
    data: np.ndarray
    matrix: np.ndarray
    variance: float

    def step(self, damping: float) -> tuple[np.ndarray, float]:
        """The damped Gauss–Newton step (P,), and by how much it should let χ² fall."""
        damped = self.matrix + np.diag(damping * np.diag(self.matrix) + LEAST)
        step = -np.linalg.solve(damped, self.gradient)
        step *= min(1.0, LARGEST_STEP / max(np.abs(step).max(), 1e-300))
        return step, float(-2 * self.gradient @ step - step @ self.matrix @ step)


@dataclass(frozen=True)
class LeastSquares:
    """What stays the same during a fit."""

    observations: Observations
    misfit: Misfit
    unknowns: Parametrisation

    def state(self, theta: Theta, solution: Solution, used: np.ndarray) -> State:
        """The rods at ``theta``; of those ``used`` (D,) the ones that came to a stable equilibrium count."""
        used = used & solution.converged & solution.stable
        residuals = np.where(used[:, None], self.misfit.residuals(solution.configuration), 0.0)
        return State(theta, solution, residuals, used)

    def numbers(self, state: State) -> int:
        """How many independent numbers are compared."""
        return int(self.misfit.numbers[state.used].sum())

    def normal(self, state: State) -> Normal:
        scale = self.unknowns.scale
        elementary, chain = self.unknowns.chain(state.theta)
        found = sensitivity(state.solution, elementary)
        used = state.used & found.usable
        # No matrix products: they are shared by threads that wait for each other, and round otherwise in each batch.
        slopes = np.einsum("dnq,qp->dnp", self.misfit.derivatives(found), chain * scale)
        slopes = np.where(used[:, None, None], slopes, 0.0)
        scores = np.einsum("dn,dnp->dp", np.where(used[:, None], state.residuals, 0.0), slopes)
        data = np.einsum("dnp,dnq->pq", slopes, slopes)
        variance = 1.0
        if self.observations.sigma is None:
            variance = max((state.residuals**2).sum() / max(self.numbers(state) - len(scale), 1), 1e-30)
        _, slope, half = self.unknowns.prior(state.theta)
        return Normal(scores.sum(axis=0) / variance + scale * slope, scores / variance, data / variance,
                      data / variance + half * np.outer(scale, scale), variance)

    def descend(self, theta: Theta, solution: Solution, most: int) -> tuple[State, int, bool]:
        """(where χ² is least, steps tried, whether it is least there), with no more than ``most`` steps.

        Raises InputError where no rod counts.
        """
        state = self.state(theta, solution, np.ones(self.observations.count, dtype=bool))
        if not state.used.any():
            raise InputError(self.observations.source, "vertices_mm", "no rod is converged and stable at the first Θ",
                             "begin elsewhere, or look at what relax says")
        damping, normal = FIRST_DAMPING, self.normal(state)
        for tried in range(1, most + 1):
            step, gain = normal.step(damping)
            trial = self._trial(state, step)
            complete = trial.used.sum() == state.used.sum() or damping > PATIENT
            if complete and self._fall(state, trial, normal.variance) >= 0.0:
                done = gain <= FALLEN and damping <= FIRST_DAMPING
                state, normal = trial, self.normal(trial)
                damping = 0.0 if damping <= NO_DAMPING else 0.1 * damping
            else:
                # Where rounding decides whether χ² falls, it is at its least.
                done = gain <= FALLEN or np.abs(step).max() < SMALLEST_STEP
                damping = max(10 * damping, FIRST_DAMPING)
            if done or damping > MOST_DAMPING:
                return state, tried, done
        return state, most, False

    def _trial(self, state: State, step: np.ndarray) -> State:
        theta = self.unknowns.moved(state.theta, step * self.unknowns.scale)
        before = state.solution
        tilted = replace(before, tables=replace(before.tables, up=theta.up))
        return self.state(theta, relax_again(tilted, theta.material), state.used)

    def _fall(self, state: State, trial: State, variance: float) -> float:
        """By how much χ² and the prior fall together, over the rods that both states have."""
        both = state.used & trial.used
        if not both.any():
            return -np.inf
        fell = ((state.residuals[both] ** 2).sum() - (trial.residuals[both] ** 2).sum()) / variance
        return fell + self.unknowns.prior(state.theta)[0] - self.unknowns.prior(trial.theta)[0]
