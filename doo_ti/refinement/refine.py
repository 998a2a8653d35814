"""Beyond the grid: the continuous optimum of Θ by least squares, and how well the observations determine it (§III-E).

Levenberg–Marquardt on χ² of :mod:`doo_ti.refinement.misfit`, with derivatives by the implicit function theorem. Between steps
every rod is relaxed from where it was, which keeps it on its branch; at the end it is relaxed from its observation, as Eq. 2
has it, and where that leads elsewhere the fit goes on from there.
"""

from dataclasses import dataclass, replace

import numpy as np

from doo_ti.dataset import Observations
from doo_ti.errors import InputError
from doo_ti.metric import distance
from doo_ti.refinement.confidence import chi_square_probability
from doo_ti.refinement.estimate import Estimate
from doo_ti.refinement.least_squares import LeastSquares, Normal, State
from doo_ti.refinement.misfit import misfit
from doo_ti.refinement.parametrisation import Parametrisation, Theta
from doo_ti.relaxation.newton import Newton
from doo_ti.relaxation.relax import relax
from doo_ti.start import choose_hypothesis, start_configuration, turn_hypotheses
from doo_ti.types import Clamp, Clamps, Solution, Status

SAME_BRANCH = 0.02
"""mm, mean over the vertices: two equilibria of a rod that are further apart are on different branches."""
FIRST_TURN = 0.3
"""rad, the turn of the whole rod's rest curvature to begin with where all spins are free: with none a rod has no preferred
side, and with next to none it turns wildly."""
WEAKEST = 1e-8
"""Information about a direction, in units of the unknowns' scale, below which it counts as this much."""
UNLIKELY = 0.01  # probability of a χ² as large, below which the model is said to miss the noise
ODD = 9.0  # times the others' mean square, three times their size: a rod whose residuals are so is a misfit
TOGETHER = 0.3  # correlation of neighbouring residuals above which they are no noise


@dataclass(frozen=True)
class RefinementOptions:
    """How a fit is made.

    parameters        from :data:`doo_ti.refinement.parametrisation.UNKNOWNS`; the others stay. Bend, twist and weight are
                      determined only up to a common factor, so one of them should stay: weight, as a rule
    frame_weight      w_m in mm: how much a frame's m1 counts beside the marks; 0 where frames are not measured
    solver            of the relaxations from the observations
    iterations        steps allowed, refused ones included
    rounds            how often the fit may go on from other branches
    curvature_spread  standard deviation of a joint's rest curvature before anything is seen, 1/mm; None: one over the length
    curvature_range   distance over which neighbouring joints have about the same, mm; None: a tenth of the length
    """

    parameters: tuple[str, ...] = ("bend", "twist")
    frame_weight: float = 0.0
    solver: Newton = Newton()
    iterations: int = 200
    rounds: int = 4
    curvature_spread: float | None = None
    curvature_range: float | None = None

    def parametrisation(self, rest_length: np.ndarray) -> Parametrisation:
        """The unknowns of rods with those edges (E,), mm."""
        length = float(rest_length.sum())
        return Parametrisation(tuple(self.parameters), rest_length, self.curvature_spread or 1 / length,
                               self.curvature_range or length / 10)


@dataclass(frozen=True)
class Refinement:
    """The optimum and how far to trust it. D observations.

    estimate            Θ, its covariance, intervals and regions
    chi_square          at the optimum; where σ is not known the squared residuals over the ``sigma`` estimated from them
    degrees             numbers compared less unknowns
    sigma               mm: estimated from the residuals, or None where the observations have their own
    mean_squares        (D,) weighted squared residuals of each rod over their number; NaN in rods that do not count
    neighbours          correlation of residuals of neighbouring marks: nearly zero if they are noise
    mean_distance       Eq. 1 at the optimum, mm: the mean over rods that are converged and stable
    start_mean_distance the same at the Θ that the fit began with
    distance            (D,) Eq. 1 at the optimum, each rod relaxed from its observation; NaN if it came to nothing
    status, stable      (D,) how those relaxations ended
    used                (D,) bool: rods that determined Θ
    other_branch        (D,) bool: rods of which the fit followed another branch than their observation leads to
    converged           False where the iterations did not do
    iterations          steps tried, of all rounds
    """

    estimate: Estimate
    chi_square: float
    degrees: float
    sigma: float | None
    mean_squares: np.ndarray
    neighbours: float
    mean_distance: float
    start_mean_distance: float
    distance: np.ndarray
    status: np.ndarray
    stable: np.ndarray
    used: np.ndarray
    other_branch: np.ndarray
    converged: bool
    iterations: int

    @property
    def theta(self) -> Theta:
        return self.estimate.theta

    @property
    def reduced_chi_square(self) -> float:
        """χ² over its degrees of freedom: one by construction where σ was estimated."""
        return self.chi_square / self.degrees

    @property
    def reaches_noise(self) -> bool | None:
        """Whether χ² is what the observations' σ leads to expect; None where σ was estimated."""
        if self.sigma is not None:
            return None
        return 1 - chi_square_probability(self.chi_square, self.degrees) > UNLIKELY

    @property
    def misses_something(self) -> bool:
        """The residuals are no noise: χ² is too large for the given σ, or neighbouring marks miss together."""
        return self.reaches_noise is False or (self.sigma is not None and self.neighbours > TOGETHER)

    @property
    def misfits(self) -> np.ndarray:
        """(D,) bool: rods that fit far worse than the median. They may have come to another equilibrium than was observed."""
        return np.nan_to_num(self.mean_squares) > ODD * np.nanmedian(self.mean_squares)

    @property
    def left_out(self) -> dict[str, int]:
        """Why how many rods did not determine Θ."""
        reasons = np.array([kind.name.lower() for kind in Status])[self.status]
        reasons = np.where(self.status == Status.CONVERGED, np.where(self.stable, "lost on the way", "unstable"), reasons)
        names, counts = np.unique(reasons[~self.used], return_counts=True)
        return dict(zip(names.tolist(), counts.tolist(), strict=True))

    @property
    def verdict(self) -> str:
        """What the residuals say about the model, in plain words."""
        reduced = f"reduced chi-square {self.reduced_chi_square:.3g}"
        differ = "intervals are taken from how much observations differ"
        if self.sigma is None:
            return (f"the model explains the marks to their noise ({reduced})" if self.reaches_noise else
                    f"the model does not reach the noise ({reduced}); {differ}")
        if self.misses_something:
            return (f"sigma is estimated ({self.sigma:.3g} mm), but neighbouring marks miss together (correlation "
                    f"{self.neighbours:.2f}): the model lacks something; {differ}")
        return f"sigma is estimated from the residuals ({self.sigma:.3g} mm), so reduced chi-square is one by construction"


def refine(observations: Observations, clamps: Clamps, theta: Theta, options: RefinementOptions = RefinementOptions()
           ) -> Refinement:
    """The Θ of the least χ² that is reached from ``theta``. Gravity's direction is the one of ``theta``.

    Rods that do not converge, are unstable or infeasible do not count; how many there are is told. Raises InputError for
    parameters that do not fit ``theta``, a frame weight without frames, and where no rod is left.
    """
    if options.frame_weight > 0 and observations.frames is None:
        raise InputError(observations.source, "frames", "missing, but a frame weight is given", "use --frame-weight 0")
    unknowns = options.parametrisation(observations.rest_length)
    fit = LeastSquares(observations, misfit(observations, clamps, options.frame_weight), unknowns)
    loose = np.all((np.asarray(clamps.start) < Clamp.FRAME) & (np.asarray(clamps.end) < Clamp.FRAME))
    theta = unknowns.begun(theta, FIRST_TURN if loose else 0.0)
    solution = relax_observations(observations, clamps, theta, options.solver)
    before = _mean_distance(observations, solution, options.frame_weight)
    iterations, converged = 0, False
    for _ in range(options.rounds):
        state, tried, converged = fit.descend(theta, solution, options.iterations - iterations)
        iterations, theta = iterations + tried, state.theta
        solution = relax_observations(observations, clamps, theta, options.solver)
        other = solution.converged & solution.stable & state.used & (_apart(solution, state.solution) > SAME_BRANCH)
        if not other.any() or iterations >= options.iterations:
            break
    return _refinement(fit, state, solution, options.frame_weight, start_mean_distance=before, other_branch=other,
                       converged=converged, iterations=iterations)


def relax_observations(observations: Observations, clamps: Clamps, theta: Theta, solver: Newton) -> Solution:
    """F on each of D observations in f64; of several whole-turn hypotheses the one nearest to what was seen (Eq. 2)."""
    index, turns = turn_hypotheses(observations, clamps)
    held = clamps.take(index)
    starts = start_configuration(observations.take(index), held, turns)
    solution = relax(starts, theta.material, held, solver, up=theta.up)
    if len(index) == observations.count:
        return solution
    error = distance(solution.configuration, observations, index)
    rows = choose_hypothesis(index, error, solution.converged & solution.stable)
    return relax(starts.take(rows), theta.material, held.take(rows), solver, up=theta.up)


def _apart(first: Solution, second: Solution) -> np.ndarray:
    """(R,) mean distance of the vertices, mm."""
    return np.linalg.norm(first.configuration.vertices - second.configuration.vertices, axis=-1).mean(axis=-1)


def _refinement(fit: LeastSquares, state: State, solution: Solution, frame_weight: float, **outcome) -> Refinement:
    """What ``state``, where χ² is least, and the rods relaxed from their observations there, say."""
    normal = fit.normal(state)
    inverse = _inverse(normal.matrix)
    learned = float(np.trace(inverse @ normal.data))  # unknowns less what the prior says about them
    degrees = max(fit.numbers(state) - learned, 1.0)
    given = fit.observations.sigma is not None
    squares = float((state.residuals**2).sum())
    draft = Refinement(
        estimate=Estimate(state.theta, fit.unknowns, inverse, np.inf), chi_square=squares if given else degrees,
        degrees=degrees, sigma=None if given else float(np.sqrt(squares / degrees)), neighbours=_neighbours(fit, state),
        mean_squares=np.where(state.used, (state.residuals**2).sum(axis=1) / np.maximum(fit.misfit.numbers, 1), np.nan),
        mean_distance=_mean_distance(fit.observations, solution, frame_weight),
        distance=distance(solution.configuration, fit.observations, frame_weight=frame_weight),
        status=solution.status, stable=solution.stable, used=state.used, **outcome)
    freedom = np.inf if given else degrees
    if draft.misses_something:
        inverse, freedom = _by_observation(normal, inverse, state.used, draft.reduced_chi_square)
    scale = fit.unknowns.scale
    return replace(draft, estimate=Estimate(state.theta, fit.unknowns, inverse * np.outer(scale, scale), freedom))


def _mean_distance(observations: Observations, solution: Solution, frame_weight: float) -> float:
    good = solution.converged & solution.stable
    error = distance(solution.configuration, observations, frame_weight=frame_weight)
    return float(error[good].mean()) if good.any() else np.nan


def _inverse(matrix: np.ndarray) -> np.ndarray:
    """The inverse of a positive semidefinite matrix, in which directions without information have a large, finite variance."""
    values, vectors = np.linalg.eigh(matrix)
    known = values > max(WEAKEST, 1e-14 * values[-1])  # what is smaller beside the largest is rounding
    return (vectors / np.where(known, values, WEAKEST)) @ vectors.T


def _by_observation(normal: Normal, inverse: np.ndarray, used: np.ndarray, reduced: float) -> tuple[np.ndarray, float]:
    """Covariance and degrees of freedom where the model misses something: marks of a rod then miss together, but rods are
    independent of each other (the sandwich estimate); of few rods the usual one, σ scaled so that χ² is as expected."""
    count, unknowns = int(used.sum()), len(inverse)
    if count < 3 * unknowns:
        return _inverse(normal.matrix + normal.data * (1 / max(reduced, 1.0) - 1)), max(count - 1.0, 1.0)
    spread = normal.scores[used] - normal.scores[used].mean(axis=0)
    sandwich = inverse @ (spread.T @ spread) @ inverse * (count / (count - unknowns))
    # Where nothing is known the scores say nothing either.
    values, vectors = np.linalg.eigh(inverse)
    unknown = (vectors * (values > 0.1 / WEAKEST)) @ vectors.T
    return sandwich + unknown / WEAKEST, float(count - unknowns)


def _neighbours(fit: LeastSquares, state: State) -> float:
    """Correlation of the residuals of neighbouring marks along the rods."""
    size = 3 * (fit.observations.edges + 1)
    marks = state.residuals[:, :size].reshape(len(state.residuals), -1, 3)
    counts = (fit.misfit.vertex_weight > 0) & state.used[:, None]
    pairs = counts[:, 1:] & counts[:, :-1]
    together = (marks[:, 1:] * marks[:, :-1]).sum(axis=-1)[pairs].sum()
    apart = 0.5 * (marks[:, 1:] ** 2 + marks[:, :-1] ** 2).sum(axis=-1)[pairs].sum()
    return float(together / max(apart, 1e-300))
