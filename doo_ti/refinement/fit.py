"""The most probable unknowns: Gauss–Newton on the posterior, with the sizes fitted anew at every step (§III-E).

    x ← x − s H⁻¹ g        H and g of the linear model (:mod:`doo_ti.refinement.evidence`), s = 1, 1/3, 1/9, …

The prior makes H positive definite, and steps are shortened, not damped, because each trial relaxes all rods: every rod from
its last equilibrium, which keeps it on its branch. Rods that fit far worse than the others are relaxed once more from their
observations, also with a whole turn more and less, and are left out where that does not help.

Axes: D observations, P unknowns. Where rolls are not known several rows stand for each observation, and D is that of the rows
(:mod:`doo_ti.refinement.rolls`).
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp, softmax, xlogy

from doo_ti.refinement.evidence import Evidence, Posterior, best_effects, densities
from doo_ti.refinement.held_rod import POSE
from doo_ti.refinement.residuals import Comparison, Residuals
from doo_ti.refinement.theta import Scales
from doo_ti.refinement.unknowns import Unknowns, Values
from doo_ti.relaxation.newton import Newton
from doo_ti.rod.types import Solution
from doo_ti.system.errors import InputError

LARGEST_STEP = 1.0  # of an unknown of Θ or a clip: small steps keep rods on their branches
LARGEST_TURN = 0.3  # rad, of a clamp
POSE_STEPS, POSED = 12, 0.1  # of an observation's clamps alone, and by how much −2 ln of its posterior falls at least, also
# where another turn or roll is taken
FOLLOWED = 3  # steps of the clamps after each of the shared unknowns, which they follow
LARGEST_ROLL = 1.0  # rad, of a clamp in one observation
SHORTENED = 1 / 3  # factor by which a step that does not help is shortened
MOST_SHORTENED = 8
TURNED = 0.5  # factor of a step that leads back by more than this share of the last
LEAST_SHARE = 2e-3  # share of a step: if no longer step helps, the fit stops, but not at a kink
FINE, OF_INTERVALS, ROUGH = (0.03, 0.01), (0.1, 0.1), (0.1, 0.5)  # a fit is done when a whole step would move Θ by fewer
# standard errors and the last one lowered −2 ln of the posterior by less; ROUGH while several fits compete
AT_KINK = 0.5  # standard errors of a whole step, where shorter ones no longer help: contacts that begin or end make kinks
STOPPED = 30.0  # what F of a fit that stopped before an optimum counts more than that of one at its optimum
SCALE_STEPS = 10  # of the search for the sizes, in each step
EXACT, IMPROBABLE = 1e-12, 1e9  # mean square of residuals that is rounding; −ln of the density of a rod that does not count
ODD = 9.0  # times the others' mean square, three times their size: a rod with such residuals is a misfit
REFITTED = 0.5  # a misfit relaxed again is better if its squares are below this share of those before


@dataclass(frozen=True)
class State:
    """Rods at one set of values."""

    values: Values  # of the unknowns
    scales: Scales  # sizes
    solution: Solution  # the rods, on the mesh
    residuals: tuple[np.ndarray, ...]  # of each kind, (D, N), with the clamps' errors but without the gap
    used: np.ndarray  # (D,) bool: sound, and no misfit

    @property
    def sound(self) -> np.ndarray:
        """(D,) bool: converged and stable."""
        return self.solution.converged & self.solution.stable


@dataclass(frozen=True)
class Fitted:
    """Where a fit ended, and the linear model there."""

    fit: "Fit"  # the model
    state: State
    evidence: Evidence
    posterior: Posterior  # at the sizes of ``state``
    linear: tuple[Residuals, ...]  # the residuals of each kind around ``state``
    # (D,) −2 ln of the density of each row less that part of it that the line search computes: among rows that stand for one
    # observation it decides with it which is the most probable
    rest: np.ndarray
    converged: bool  # False where the allowed steps did not suffice
    steps: int  # number of steps tried

    @property
    def counted(self) -> np.ndarray:
        """(D,) bool: the observations that determine the unknowns."""
        return self.evidence.unknowns.rod.by_observation(self.state.used).any(axis=1)

    @property
    def rank(self) -> tuple[int, float]:
        """Smaller for a better fit: one in which more rods count or, if as many do, a more probable one."""
        return -int(self.counted.sum()), self.value

    @property
    def value(self) -> float:
        """F, and STOPPED above it where the fit reached no optimum: there its linear model is no guide, least of all beside a
        shape that is about to snap."""
        return self.posterior.value + STOPPED * (not self.converged)

    @property
    def level(self) -> float:
        """F without what integrating directions adds: what intervals go by."""
        return self.posterior.value - self.evidence.of_directions(self.state.scales)

    def after(self, before: "Fitted") -> "Fitted":
        """The same, with the steps of the fit that it continues counted too."""
        return replace(self, steps=before.steps + self.steps)


@dataclass(frozen=True)
class Fit:
    """What stays the same while the unknowns of one model are fitted."""

    comparison: Comparison  # the compared quantities and the unknowns
    origin: Values  # the values that the wide prior of Θ is centred on
    solver: Newton  # of the relaxations
    rods: np.ndarray | None = None  # (D,) bool: rods that count, however large their residuals become; None: all except misfits
    tolerance: tuple[float, float] = FINE  # FINE, OF_INTERVALS or ROUGH

    @property
    def unknowns(self) -> Unknowns:
        return self.comparison.unknowns

    def begin(self, values: Values, scales: Scales) -> State:
        """Rods relaxed from their observations. Raises InputError where none is converged and stable."""
        state, rod = self.from_marks(values, scales), self.unknowns.rod
        if rod.direction_unknown:
            state = self.posed(state)
        guessed = ~rod.observations.valid[:, [0, -1]].all(axis=1)
        if rod.turns_unknown and guessed.any():
            # A clamp without the outer mark is at a guess, and so is the turn nearest to the marks until it is posed.
            state = self.posed(state, guessed)
            for other in (self.posed(self.from_marks(values, scales, turn), guessed) for turn in (-1, 0, 1)):
                nearer = other.sound & guessed & (self._of_rods(other, scales) < self._of_rods(state, scales))
                state = self.merged(state, other, nearer)
        if not state.used.any():
            raise InputError(self.unknowns.rod.observations.source, "vertices_mm",
                             "no rod is converged and stable at the first Θ",
                             "begin with another Θ, or inspect the rods with relax")
        return state

    def from_marks(self, values: Values, scales: Scales, turn: int | None = None) -> State:
        """Rods relaxed from their observations, with as many whole turns as :meth:`HeldRod.relaxed` says."""
        return self._state(values, scales, self.unknowns.rod.relaxed(*self.unknowns.model(values), self.solver, turn=turn))

    def at(self, values: Values, scales: Scales, solution: Solution) -> State:
        """``values`` with rods relaxed from ``solution``, which is on the same mesh."""
        rods, model = solution.configuration, self.unknowns.model(values)
        return self._state(values, scales, self.unknowns.rod.followed(rods.start, rods.quaternions, *model, self.solver))

    def posed(self, state: State, rows: np.ndarray | None = None, steps: int = POSE_STEPS) -> State:
        """``state`` with the most probable clamps of the observations ``rows`` (D,) bool, or of all. The shared unknowns stay.

        Gauss–Newton, each observation with steps of its own. Where no frame was reported, marks alone say how a rod is held:
        the line through the outer two of them is only a first guess."""
        if self.unknowns.rod.exact:
            return state
        rows = np.ones(len(state.used), dtype=bool) if rows is None else rows
        share, before = np.ones(len(rows)), self._of_rods(state, state.scales)
        latest, begin, moved = state, state, rows  # the rods relaxed last, the best so far, and which of the last are the best
        step, usable = np.zeros_like(state.values.scatter), np.zeros_like(rows)
        for _ in range(steps):
            if moved.any():  # the others' linear model is as before
                linear, sound = self.comparison.linear(latest.solution, latest.values, moved & latest.sound,
                                                       leave_out_soft=False, shared=False)
                wanted = best_effects(self.unknowns, linear, state.scales)[:, :POSE]
                turn = wanted - latest.values.scatter
                turn *= np.minimum(1.0, LARGEST_ROLL / np.maximum(np.abs(turn[:, :6]).max(axis=1), 1e-300))[:, None]
                step[moved] = np.where(sound[:, None], turn, 0.0)[moved]
                usable = np.where(moved, sound, usable)
            latest = self.at(replace(begin.values, scatter=begin.values.scatter + share[:, None] * step), state.scales,
                             begin.solution)
            after = self._of_rods(latest, state.scales)
            moved = usable & latest.sound & (after < before)
            share = np.where(moved, np.minimum(1.0, share / SHORTENED), share * SHORTENED)
            begin = self._mixed(begin, latest, moved) if moved.any() else begin
            gained = np.where(moved, before - after, 0.0)
            before = np.where(moved, after, before)
            if not ((gained > POSED) | (usable & ~moved & (share > LEAST_SHARE))).any():
                break
        if begin is state:  # no observation has become more probable
            return state
        if (moved | ~usable).all():
            return latest
        return self.at(begin.values, begin.scales, begin.solution)

    @staticmethod
    def _mixed(state: State, other: State, rows: np.ndarray) -> State:
        """The poses and shapes of ``other`` in the observations ``rows``, of ``state`` elsewhere: where rods begin, not yet
        relaxed."""
        quaternions, start, scatter = (np.where(rows[(slice(None),) + (None,) * (new.ndim - 1)], new, old) for new, old in (
            (other.solution.configuration.quaternions, state.solution.configuration.quaternions),
            (other.solution.configuration.start, state.solution.configuration.start),
            (other.values.scatter, state.values.scatter)))
        shape = replace(state.solution.configuration, quaternions=quaternions, start=start)
        values, solution = replace(state.values, scatter=scatter), replace(state.solution, configuration=shape)
        return replace(state, values=values, solution=solution)

    def merged(self, state: State, other: State, rows: np.ndarray) -> State:
        """``other`` in the observations ``rows``, ``state`` elsewhere."""
        mixed = self._mixed(state, other, rows)
        return self.at(mixed.values, mixed.scales, mixed.solution)

    def run(self, state: State, steps: int, held: tuple[np.ndarray, float] | None = None) -> Fitted:
        """The best values that are reached from ``state``; with ``held`` = (v, a), those whose v·x is larger by a than that of
        ``state``, x being the unknowns."""
        direction, left = held or (None, 0.0)
        done, tried, before, kinked = False, 0, np.zeros(self.unknowns.theta_count), None
        among = bool(self.unknowns.rod.surroundings)
        snapping = np.zeros(len(state.used), dtype=bool)  # stay out: the fit would pull them in and lose them again for ever
        for tried in range(1, steps + 1):
            fitted = kinked or self._linear(state, direction, left)
            if done:
                break
            snapping |= state.used & ~fitted.state.used
            found, count = fitted.posterior, self.unknowns.theta_count
            change = found.step[:count] / np.maximum(np.sqrt(np.diag(found.covariance)[:count]), 1e-9)
            turned = np.sum(change * before) < -TURNED * np.sum(before**2) and left == 0.0  # sizes and Θ chase each other
            trial, share, gained = self._stepped(fitted, self._share(found.step) * (TURNED if turned else 1.0), left != 0.0)
            before = change
            settled = left == 0.0 and gained < self.tolerance[1] and bool((np.abs(change) <= self.tolerance[0]).all())
            left *= 1 - share
            at_kink = among and share < SHORTENED and gained < self.tolerance[1] and left == 0.0
            if done := at_kink and bool((np.abs(change) <= AT_KINK).all()):
                break
            if share < LEAST_SHARE and (settled or left or not among):  # rods snap, or rounding decides whether F rises
                done = settled
                break
            kinked = self._with_other_side(fitted, trial) if share == 0.0 else None
            if kinked:
                continue
            if share == 0.0:
                break
            now = settled or tried == 1 or self.unknowns.rod.rolls_known  # others would spend most of the time on it
            trial, again = self._misfits_relaxed_again(trial) if now else (trial, False)
            state = replace(trial, used=trial.used & ~snapping)
            done = settled and not again and bool((state.used == fitted.state.used).all())
        else:
            fitted = self._linear(state, direction, left)
        return replace(fitted, converged=done, steps=tried)

    def _state(self, values: Values, scales: Scales, solution: Solution) -> State:
        good = solution.converged & solution.stable
        residuals = tuple(np.where(good[:, None], kind, 0.0) for kind in self.comparison.values(solution, values))
        state = State(values, scales, solution, residuals, good & (self.comparison.count > 0))
        if self.rods is not None:
            return replace(state, used=state.used & self.rods)
        return replace(state, used=state.used & ~self.far(state))

    def far(self, state: State) -> np.ndarray:
        """(D,) bool: rods whose marks' residuals are those of a misfit, beside those of the rods that are ``used``."""
        least, usual = self._least(state, state.sound), self._least(state, state.used)
        odd = least > ODD * max(np.median(usual[np.isfinite(usual)]), EXACT) if state.used.any() else least > 0
        return np.repeat(odd, self.unknowns.rod.copies)

    def mean_squares(self, residuals: tuple[np.ndarray, ...]) -> np.ndarray:
        """(D,) of the marks' residuals."""
        return (residuals[0] ** 2).sum(axis=1) / np.maximum(self.comparison.count, 1)

    def _linear(self, state: State, direction: np.ndarray | None, left: float) -> Fitted:
        """The linear model around ``state``, its sizes fitted; a step along a held ``direction`` goes by what is ``left``."""
        linear, used = self.comparison.linear(state.solution, state.values, state.used, self.rods is None)
        share, entropy, rest = self.shares(replace(state, used=used), linear)
        evidence = Evidence.of(self.unknowns, linear, self.unknowns.offset(state.values, self.origin), share, entropy)
        if direction is not None:
            evidence = evidence.holding(direction, left)
        scales = evidence.best(state.scales, SCALE_STEPS)
        state = replace(state, scales=scales, used=used)
        return Fitted(self, state, evidence, evidence.posterior(scales), linear, rest, False, 0)

    def _with_other_side(self, fitted: Fitted, trial: State) -> Fitted | None:
        """``fitted`` with the linear model around ``trial`` too, just beyond a kink; None where other rods count there."""
        linear, used = self.comparison.linear(trial.solution, trial.values, trial.used, self.rods is None)
        if not np.array_equal(used, fitted.state.used):
            return None
        ahead = self.unknowns.offset(trial.values, self.origin) - fitted.evidence.offset
        evidence = fitted.evidence.with_other_side(linear, ahead, fitted.state.scales)
        return replace(fitted, evidence=evidence, posterior=evidence.posterior(fitted.state.scales))

    def shares(self, state: State, linear: tuple[Residuals, ...]) -> tuple[np.ndarray, float, np.ndarray]:
        """(D,) the probability of each row among those that stand for the same observation, given the present unknowns; what
        −2 ln of the evidence rises by because it is not known; and (D,) ``rest`` of :class:`Fitted`."""
        rod = self.unknowns.rod
        if rod.copies == 1:
            return np.ones(len(state.used)), 0.0, np.zeros(len(state.used))
        density = densities(self.unknowns, linear, state.scales)
        share = softmax(rod.by_observation(np.where(state.used, -0.5 * density, -IMPROBABLE)), axis=1).ravel()
        share = np.where(state.used, share, 0.0)
        return share, 2.0 * float(xlogy(share, share * rod.copies).sum()), density - self._of_rods(state, state.scales)

    def _share(self, step: np.ndarray) -> float:
        names = self.unknowns.names
        limits = np.full(len(names), LARGEST_STEP)
        outer = self.unknowns.rod.observations.rest_length[[0, -1]]
        for prefix, size in (("clamps", LARGEST_TURN), ("curvature", np.inf), ("clip_start", outer[0]), ("clip_end", outer[1])):
            limits[self.unknowns.columns(prefix)] = size
        return float(min(1.0, 1 / max((np.abs(step) / limits).max(), 1e-300)))

    def _stepped(self, fitted: Fitted, share: float, moving: bool) -> tuple[State, float, float]:
        """The state after a step that lowers −2 ln of the posterior and loses no rod, its share of the whole step, and by how
        much it lowers it; share 0 where no step does. A step ``moving`` a held combination of unknowns may raise it."""
        state, found, unknowns = fitted.state, fitted.posterior, self.unknowns
        effects = 0 * state.values.scatter if unknowns.rod.exact else found.effects[:, :POSE]
        effects = np.where(state.used[:, None], effects, state.values.scatter)
        largest = np.abs(effects - state.values.scatter)[:, :6].max()
        share = min(share, LARGEST_ROLL / max(largest, 1e-300))
        before, counted = self._objective(state, state.used, fitted.rest), fitted.counted
        for _ in range(MOST_SHORTENED):
            values = unknowns.moved(state.values, share * found.step, share * (effects - state.values.scatter))
            trial = self.at(values, state.scales, state.solution)
            if unknowns.rod.direction_unknown:
                trial = self.posed(trial, state.used, FOLLOWED)
            kept = state.used & trial.sound
            gained = before - self._objective(trial, kept, fitted.rest)
            if unknowns.rod.by_observation(kept).any(axis=1)[counted].all() and (moving or gained >= 0):
                return trial, share, gained
            share *= SHORTENED
        return trial, 0.0, 0.0

    def _objective(self, state: State, used: np.ndarray, rest: np.ndarray) -> float:
        """−2 ln of the posterior without its constant, the gap integrated out, over the rods ``used``; ``rest`` (D,) as in
        :class:`Fitted`."""
        precision, _ = self.unknowns.precision(state.scales)
        offset = self.unknowns.offset(state.values, self.origin)
        each, rod = self._of_rods(state, state.scales) + rest, self.unknowns.rod
        if rod.copies > 1:
            each = -2.0 * logsumexp(rod.by_observation(np.where(used, -0.5 * each, -np.inf)), axis=1)
            used = np.isfinite(each)
        return float(each[used].sum() + offset @ precision @ offset)

    def _of_rods(self, state: State, scales: Scales) -> np.ndarray:
        """(D,) the part of that of each observation: its residuals, and the errors of its clamps."""
        return self.comparison.squares(state.residuals, state.values.scatter, scales)

    def _misfits_relaxed_again(self, state: State) -> tuple[State, bool]:
        """``state`` with its misfits relaxed from their observations, where that halves their squares, and whether any was."""
        lost = ~np.repeat(self.unknowns.rod.by_observation(state.used).any(axis=1), self.unknowns.rod.copies)
        misfits = np.flatnonzero(lost & (self.comparison.count > 0))
        if not len(misfits) or self.rods is not None:
            return state, False
        unknowns, values = self.unknowns, state.values
        values = replace(values, scatter=np.where(state.used[:, None], values.scatter, 0.0))
        anew = unknowns.rod.relaxed(*unknowns.model(values), self.solver, misfits, any_turn=True)
        quaternions = state.solution.configuration.quaternions.copy()
        quaternions[misfits] = anew.configuration.quaternions
        moved = replace(state.solution, configuration=replace(state.solution.configuration, quaternions=quaternions))
        trial = self.posed(self.at(values, state.scales, moved), lost)
        halved = self._least(trial, trial.sound) < REFITTED * self._least(state, state.sound)
        nearer = np.repeat(halved, unknowns.rod.copies) & lost & trial.sound
        if not nearer.any():
            return state, False
        return self.merged(state, trial, nearer), True

    def _least(self, state: State, rods: np.ndarray) -> np.ndarray:
        """(D,) the least mean square of the marks' residuals among those of the ``rods`` that stand for each observation."""
        return self.unknowns.rod.by_observation(np.where(rods, self.mean_squares(state.residuals), np.inf)).min(axis=1)
