"""Identification: the Θ under which rods move as they were recorded (Eq. 3 for rods in motion).

Σ ρ(x_simulated − x_recorded) over markers and frames, each recording rolled out open loop from its first two frames, is made
small by Levenberg–Marquardt; ρ(r) = δ (√(δ² + r²) − δ) grows linearly beyond δ, so that glitches of the capture do not decide.
Marks of still frames join the sum with the weight σ²_motion/σ²_still, σ_motion being the scatter of the recordings' residuals.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from doo_ti.contact.surroundings import Surroundings
from doo_ti.dynamics.parameters import Stepping
from doo_ti.dynamics.recorded import RecordedMotion
from doo_ti.dynamics.rollouts import HALVINGS_AMONG_OBSTACLES, Rollouts, require_smoothing, roll_reference
from doo_ti.dynamics.theta import LinearStills, MotionTheta, Stills, Unknowns
from doo_ti.rod.observations import Observations, median_of_seen
from doo_ti.rod.types import Clamp, Status
from doo_ti.system.arguments import short_repr, typed
from doo_ti.system.errors import InputError, require_whole

STEP = 1e-6  # of an entry of p, for differences of material and dynamics
LONG_STEP = 5e-3
"""The same for differences of rollouts: they are off by the tolerance of gaps and average over contacts that begin."""
BENDS = (3e-4, 3e-3, 3e-2, 0.3)  # bend stiffness over weight and the cube of the length, to begin with
FRICTIONS = (0.1, 0.3, 0.6)  # coefficients to begin with
SETTLED = 1e-5  # of the cost, by which the last iteration may lower it
FARTHEST = 0.5  # change of ln of the rate, beyond which it does not explain what recordings are off by
CORRECTIONS = HALVINGS_AMONG_OBSTACLES
LEFT = 1 / 4  # of what corrections changed: the standard error that they leave


@typed
@dataclass(frozen=True)
class IdentifyOptions:
    """How Θ is found.

    modes         Legendre modes of the rest curvature in each direction
    fitted        parameters besides bend and the rest curvature; friction only with obstacles
    horizons      frames that are rolled out, one fit after the other: short ones find the region, long ones the parameters
    delta         mm, beyond which a difference counts linearly
    substeps      time steps between frames
    scheme        of :func:`.simulate`
    iterations    most of each fit
    end           what the far gripper holds, where the recordings have one
    surroundings  what the rods touch, with one row for all recordings or one for each; nothing that moves
    smoothing     odd number of frames through which parabolas are fitted for the start and the grippers; 1: as recorded; None:
                  among obstacles those of 0.09 s, else 1
    clip          mm of the rod that a gripper holds, from its outer marker on: there the rod begins to bend; None: half of the
                  way to the inner marker

    Raises InputError for numbers out of range, unknown parameters, obstacles that move, friction without any, and an even
    number of frames.
    """

    modes: int = 7
    fitted: tuple[str, ...] = ("bend_damping", "drag", "quadratic_drag", "twist_ratio")
    horizons: tuple[int, ...] = (60, 200, 10**6)
    delta: float = 5.0
    substeps: int = 1
    scheme: str = "bdf2"
    iterations: int = 20
    end: Clamp = Clamp.FRAME
    surroundings: Surroundings = Surroundings()
    smoothing: int | None = None
    clip: float | None = None

    def __post_init__(self) -> None:
        require_whole("IdentifyOptions", "modes", self.modes, 0)
        require_whole("IdentifyOptions", "iterations", self.iterations, 1)
        if unknown := [name for name in self.fitted if name not in Unknowns.SIZES]:
            raise InputError("IdentifyOptions", "fitted", f"{unknown[0]!r} is unknown",
                             f"give some of {', '.join(Unknowns.SIZES)}")
        if not self.horizons or min(self.horizons) < 1:
            raise InputError("IdentifyOptions", "horizons", f"{self.horizons}", "give numbers of frames, 1 or more")
        if not self.delta > 0:
            raise InputError("IdentifyOptions", "delta", f"{self.delta}", "give mm above zero")
        if self.clip is not None and not self.clip >= 0:
            raise InputError("IdentifyOptions", "clip", f"{self.clip}", "give mm, zero or more")
        if self.surroundings.moves:
            raise InputError("IdentifyOptions", "surroundings", "a Moving obstacle", "give obstacles that rest")
        if "friction" in self.fitted and not self.surroundings.bodies:
            raise InputError("IdentifyOptions", "fitted", "friction without obstacles", "give `surroundings`, or leave it out")
        if self.smoothing is not None:
            require_smoothing("IdentifyOptions", "smoothing", self.smoothing)

    @property
    def rounds(self) -> int:
        """Most iterations of all fits."""
        return self.iterations * (len(self.horizons) + CORRECTIONS)

    def rollouts(self, motion: RecordedMotion, theta: MotionTheta, halvings: int | None = None) -> Rollouts:
        """How recordings of the rod of ``theta`` are rolled out; ``halvings`` as of :meth:`.Rollouts.of`."""
        stepping = Stepping(motion.rate, self.substeps, self.scheme)
        return Rollouts.of(motion, theta, stepping, self.end, self.surroundings, self.smoothing, halvings)


@dataclass(frozen=True)
class Identified:
    """What :func:`identify` found.

    theta       Θ
    unknowns    what the entries of p are
    vector      (P,) p
    covariance  (P, P) of p, recordings taken as independent, and of what corrections of mesh and steps leave
    error       (R,) mm, the mean over frames from 2 on of :func:`mean_error`; NaN for recordings that failed
    failed      (R,) bool: some step of the recording did not converge, and it was left out
    cost        Σ ρ, mm²
    iterations  in all
    converged   whether the last fit ended before its iterations did
    still_error (S,) mm, the mean distance of the marks of each still, of all sets one after the other; NaN for those left out
    rate        frames per second at which the recordings would fit best, the other unknowns changing with it, to first order
    rate_gain   share of the squared residuals that this would save
    """

    __repr__ = short_repr

    theta: MotionTheta
    unknowns: Unknowns
    vector: np.ndarray
    covariance: np.ndarray
    error: np.ndarray
    failed: np.ndarray
    cost: float
    iterations: int
    converged: bool
    still_error: np.ndarray
    rate: float
    rate_gain: float

    def parameters(self) -> list[dict]:
        """Name, value, 95 % interval and unit of every parameter."""
        used = int((~self.failed).sum() + np.isfinite(self.still_error).sum())
        return self.unknowns.intervals(self.vector, self.covariance, used - 1)


@typed
def identify(motion: RecordedMotion, begin: MotionTheta, options: IdentifyOptions = IdentifyOptions(),
             report: Callable[[int, int, float], None] | None = None, stills: Sequence[Stills] = ()) -> Identified:
    """The Θ of the rod that all recordings of ``motion`` show, from ``begin`` on.

    report  called with the horizon, the iteration and the mean error in mm
    stills  sets of shapes of the same rod at rest, which count as well
    """
    if "friction" in options.fitted and begin.friction is None:
        raise InputError("identify", "begin", "no friction, which is to be fitted", "give a MotionTheta with `friction`")
    require_clear_grippers(motion, begin, options)
    unknowns = Unknowns(begin, options.modes, options.fitted)
    p = unknowns.vector(begin)
    made, frames = 0, motion.positions.shape[1]
    for horizon in sorted({min(h + 2, frames) for h in options.horizons}):
        fit = _Fit(motion.until(horizon), unknowns, options, stills)
        p, cost, iterations, _ = fit.minimise(p, lambda k, error, horizon=horizon: report and report(horizon, k, error))
        made += iterations
    left = np.zeros_like(p)
    for correction in range(1, CORRECTIONS + 1):
        before, fit = p, fit.corrected(p, correction)
        p, cost, iterations, converged = fit.minimise(p, lambda k, error: report and report(frames, k, error))
        made += iterations
        # Among obstacles a mesh is right to first order: further halvings change as much again as the last one.
        left = p - before if options.surroundings else left + LEFT * (p - before)
    residual, slopes, status = fit.linearised(p)
    failed = (status != Status.CONVERGED).any(axis=1)
    theta = unknowns.theta(p)
    error = np.where(failed, np.nan, np.abs(residual).mean(axis=(1, 2, 3)) * (residual.shape[2] / motion.positions.shape[2]))
    still = fit.linearised_stills(p, fit.variance(residual, ~failed))
    covariance = fit.covariance(residual, slopes, ~failed, still) + np.outer(left, left)
    return Identified(theta, unknowns, p, covariance, error, failed, cost, made, converged,
                      np.concatenate([np.zeros(0), *(part.error for part in still)]),
                      *fit.best_rate(p, residual, slopes, ~failed))


def guesses(motion: RecordedMotion, options: IdentifyOptions, bend: float | None, up: ArrayLike) -> list[MotionTheta]:
    """Θ to begin with: several values of bend stiffness, or ``bend``, with several of friction where that is fitted."""
    lengths, reference, up = motion.rest_length(options.clip), roll_reference(motion), np.asarray(up, dtype=np.float64)
    bends = [bend] if bend is not None else [share * lengths.sum() ** 3 for share in BENDS]
    frictions = FRICTIONS if "friction" in options.fitted else (None,)
    return [MotionTheta(guess, 1.0, 0.03, 0.2, 1e-5, 0.0, np.zeros((2, 0)), lengths, reference, up, friction)
            for guess, friction in product(bends, frictions)]


def require_clear_grippers(motion: RecordedMotion, theta: MotionTheta, options: IdentifyOptions) -> None:
    """Raise InputError where, in every recording, the grippers hold the rod of ``theta`` inside an obstacle."""
    if not options.surroundings:
        return
    depth = options.rollouts(motion, theta, 0).depth
    if (depth > 0).all():
        raise InputError("identify", "surroundings", f"the grippers of all recordings hold the rod up to {depth.max():.3g} mm "
                         "inside an obstacle", "correct the obstacle's place, or give a smaller radius")


@typed
def identify_from_guesses(motion: RecordedMotion, options: IdentifyOptions, bend: float | None = None,
                          up: ArrayLike = (0.0, 0.0, 1.0), report: Callable[[int, int, float], None] | None = None,
                          stills: Sequence[Observations] = ()) -> Identified:
    """:func:`identify` from the best of the :func:`guesses` on the shortest horizon."""
    thetas = guesses(motion, options, bend, up)
    length = float(motion.edge_lengths().sum())
    at_rest = [Stills.of(one, thetas[0].reference, length, options.surroundings) for one in stills]
    best = int(np.argmin(first_errors(motion, options, thetas))) if len(thetas) > 1 else 0
    return identify(motion, thetas[best], options, report, at_rest)


def first_errors(motion: RecordedMotion, options: IdentifyOptions, thetas: Sequence[MotionTheta]) -> np.ndarray:
    """(G,) mm by which each Θ is off on the shortest horizon, the median over recordings; infinite where all fail."""
    part = motion.until(min(options.horizons) + 2)
    positions, _ = options.rollouts(part, thetas[0], 0).predicted(thetas)
    error = np.abs(positions - part.positions[:, None]).mean(axis=(2, 3, 4))
    return np.nan_to_num(median_of_seen(error), nan=np.inf)


class _Fit:
    """Levenberg–Marquardt over the recordings of one horizon, and all stills."""

    def __init__(self, motion: RecordedMotion, unknowns: Unknowns, options: IdentifyOptions, stills: Sequence[Stills] = (),
                 halvings: int = 0):
        self.motion, self.unknowns, self.options, self.stills = motion, unknowns, options, stills
        self.seen = motion.positions[:, 2:, motion.predicted]
        self.rollouts = options.rollouts(motion, unknowns.begin, halvings)

    def corrected(self, p, correction: int) -> "_Fit":
        """The same with less of the error of the markers' mesh and of the steps. Among obstacles both are halved so many times.
        Else that error under p, from what halving changes (Richardson), is added to what is seen."""
        if self.options.surroundings:
            return _Fit(self.motion, self.unknowns, self.options, self.stills, correction)
        theta = self.unknowns.theta(p)
        coarse, fine = (one.predicted([theta])[0] for one in (self.rollouts, self.options.rollouts(self.motion, theta, 1)))
        apart = (coarse - fine)[:, 0, 2:, self.motion.predicted]
        whole = np.isfinite(apart).all(axis=(1, 2, 3), keepdims=True)
        self.seen = self.motion.positions[:, 2:, self.motion.predicted] + np.where(whole, 4.0 / 3.0 * apart, 0.0)
        return self

    def residuals(self, vectors) -> tuple[np.ndarray, np.ndarray]:
        """((R, G, T − 2, W, 3) mm of the W vertices that are predicted, (R, G, T) status) under each p."""
        positions, status = self.rollouts.predicted([self.unknowns.theta(p) for p in vectors])
        return positions[:, :, 2:, self.motion.predicted] - self.seen[:, None], status

    def linearised(self, p):
        """(residuals (R, …) at p, their slopes (R, P, …), status (R, T − 2))."""
        directions = [self.direction(p, k) for k in range(len(p))]
        positions, slopes, status = self.rollouts.differentiated(self.unknowns.theta(p), directions)
        return positions - self.seen, slopes, status

    @staticmethod
    def variance(residual: np.ndarray, used: np.ndarray) -> float:
        """mm², of a coordinate of the recordings; squared median-based deviation, which glitches do not change."""
        return float((1.4826 * np.median(np.abs(residual[used]))) ** 2) if used.any() else 1.0

    def linearised_stills(self, p, variance: float) -> list[LinearStills]:
        """The stills near p, weighted against recordings of that ``variance``."""
        return [stills.linearised(self.unknowns.theta(p), self.unknowns, variance) for stills in self.stills]

    def still_cost(self, p, linear: list[LinearStills]) -> float:
        """Σ ρ of the stills that ``linear`` uses, at another p; infinite where one of them fails."""
        theta, total = self.unknowns.theta(p), 0.0
        for part in linear:
            apart, used = part.stills.residuals(part.stills.rested(theta))
            if (part.used & ~used).any():
                return np.inf
            total += self.cost(np.sqrt(part.weight) * apart[part.used, None]).sum()
        return total

    def direction(self, p, entry: int) -> tuple[MotionTheta, MotionTheta, float]:
        """Two values of Θ along one entry of p, within its bounds, and how far apart they are."""
        before, after, step = p.copy(), p.copy(), STEP if self.rollouts.through_steps else LONG_STEP
        before[entry] = max(p[entry] - step, self.unknowns.lower[entry])
        after[entry] = min(p[entry] + step, self.unknowns.upper[entry])
        return self.unknowns.theta(before), self.unknowns.theta(after), after[entry] - before[entry]

    def cost(self, residual: np.ndarray) -> np.ndarray:
        """(R,) Σ ρ of each recording, mm²; infinite where it failed."""
        delta = self.options.delta
        value = (delta * (np.sqrt(delta**2 + residual**2) - delta)).sum(axis=(1, 2, 3))
        return np.where(np.isfinite(value), value, np.inf)

    def normal(self, residual, slopes, used):
        """((R, P, P), (R, P) gradients) of the recordings, or of the stills: the normal equations of the reweighted squares,
        zero where a rod is not ``used``."""
        weight = 1.0 / np.sqrt(1.0 + (residual / self.options.delta) ** 2)
        count, p = slopes.shape[:2]
        a, gradients = np.zeros((count, p, p)), np.zeros((count, p))
        for r in np.flatnonzero(used):
            j, w = slopes[r].reshape(p, -1), weight[r].ravel()
            a[r] = (j * w) @ j.T
            gradients[r] = (j * w) @ residual[r].ravel()
        return a, gradients

    def joint_normal(self, residual, slopes, used, still: list[LinearStills]):
        """The same of recordings and stills together, without those that are not used."""
        parts = [self.normal(residual, slopes, used), *(self.normal(one.residual, one.slopes, one.used) for one in still)]
        chosen = np.concatenate([used, *(one.used for one in still)])
        return tuple(np.concatenate(arrays)[chosen] for arrays in zip(*parts, strict=True))

    def covariance(self, residual, slopes, used, still: list[LinearStills]) -> np.ndarray:
        """(P, P) of p: of the values it takes, to first order, where one recording or still is left out after the other (the
        jackknife), whose errors are as one each."""
        a, gradients = self.joint_normal(residual, slopes, used, still)
        number = len(a)
        if number < 2:
            return np.full(a.shape[1:], np.inf)
        changes = np.stack([np.linalg.pinv(a.sum(axis=0) - own) @ g for own, g in zip(a, gradients, strict=True)])
        return changes.T @ changes * ((number - 1) / number)

    def best_rate(self, p, residual, slopes, used) -> tuple[float, float]:
        """``rate`` and ``rate_gain`` of :class:`Identified`: a step of Gauss and Newton in ln of the rate and in p at once."""
        fast, slow = (_Fit(replace(self.motion, rate=self.motion.rate * (1 + step)), self.unknowns, self.options)
                      .residuals([p])[0][:, 0] for step in (LONG_STEP, -LONG_STEP))
        by_rate = (fast - slow) / (2 * LONG_STEP)
        used = used & np.isfinite(by_rate).all(axis=(1, 2, 3))
        a, gradient = (part.sum(axis=0) for part in self.normal(residual, np.append(slopes, by_rate[:, None], axis=1), used))
        own = a[-1, -1] - a[-1, :-1] @ np.linalg.pinv(a[:-1, :-1]) @ a[:-1, -1]
        weighted = residual[used] ** 2 / np.sqrt(1.0 + (residual[used] / self.options.delta) ** 2)
        change = -gradient[-1] / own if own > 0 else 0.0
        if not 0 < abs(change) < FARTHEST:  # nothing moves, or something else is wrong
            return self.motion.rate, 0.0
        return self.motion.rate * float(np.exp(change)), float(gradient[-1] ** 2 / own / weighted.sum())

    def minimise(self, p, report) -> tuple[np.ndarray, float, int, bool]:
        """(p, cost, iterations, whether it was reached within those allowed) of the minimum."""
        damping, lower, upper = 1e-3, self.unknowns.lower, self.unknowns.upper
        for k in range(self.options.iterations):
            residual, slopes, status = self.linearised(p)
            used = (status == Status.CONVERGED).all(axis=1)
            if not used.any():
                return p, np.inf, k + 1, False
            still = self.linearised_stills(p, self.variance(residual, used))
            cost = self.cost(residual)[used].sum() + self.still_cost(p, still)
            report(k, float(np.abs(residual[used]).mean()))
            a, gradients = self.joint_normal(residual, slopes, used, still)
            a, g = a.sum(axis=0), gradients.sum(axis=0)
            free = ~((p <= lower) & (g > 0) | (p >= upper) & (g < 0))
            a, g = a[np.ix_(free, free)], g[free]
            improved = np.inf
            while damping < 1e6:
                step = np.zeros_like(p)
                step[free] = -np.linalg.solve(a + damping * (np.diag(np.diag(a)) + 1e-3 * np.trace(a) * np.eye(len(a))), g)
                trial = np.clip(p + np.clip(step, -1.0, 1.0), lower, upper)
                improved = self.cost(self.residuals([trial])[0][:, 0])[used].sum() + self.still_cost(trial, still)
                if improved < cost:
                    break
                damping *= 4.0
            if not improved < cost:
                return p, cost, k + 1, True
            p, damping = trial, max(damping / 4.0, 1e-7)
            if cost - improved < SETTLED * cost:
                return p, improved, k + 1, True
        return p, improved, self.options.iterations, False
