"""Where a fit begins whose rods are curved at rest, held by clips whose roll is not known.

A straight round rod does not say how it was rolled, and marks hardly say how far it was twisted. In a rod that is curved at
rest by κ(s), rolled by φ and twisted by θ more than the straight fit has it, κ lies as κ(s) turned by φ + θ s/L about the
tangent of the straight rod. To first order the residuals of observation d then change by

    J x + K R(φ_d + θ_d s/L) κ + z θ_d,

J the derivatives by all other shared unknowns x, K those by the rest curvature, z those by the twist, the other errors of the
clamps integrated out. Given φ and θ the best x and κ solve a linear system; given these, φ_d and θ_d are the best of a grid in
each observation. Taken in turns from random rolls, both soon settle. Without that a fit would begin with rolls that are all
wrong, and learn another curvature and stiffness with them.

Axes: D observations, P shared unknowns, of which 2 K are those of the curvature at K knots, A rolls and T twists of the grid.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from doo_ti.refinement.evidence import integrated
from doo_ti.refinement.fit import Fit, Fitted, State
from doo_ti.refinement.held_rod import TWIST
from doo_ti.refinement.priors import ANY_TWIST, Scales
from doo_ti.refinement.turns import chosen_again
from doo_ti.refinement.unknowns import Unknowns, Values
from doo_ti.rod.frames import quaternion_of_turn, rotation_vector

ROLLS = np.linspace(-np.pi, np.pi, 48, endpoint=False)
TWISTS = np.radians(np.arange(-210.0, 211.0, 30.0))
BEGUN = 32
"""Sets of random rolls from which the linear model is solved."""
SIZE, RANGE = 1.0, 0.3
"""Expected while that is done: the curvature times the rod's length, and its range over that length."""
GAP = 3e-4
"""Largest gap then, over the rod's length."""
ROUNDS = 40
FOLLOWED = 3
"""Solutions of the linear model that are fitted, the best of those that differ."""
APART = 1.0
"""−2 ln of the posterior by which solutions of the linear model differ at least."""
TRIED = 6
"""Rolls of each observation that are compared under what was learned."""


@dataclass(frozen=True)
class _Start:
    """A solution of the linear model: −2 ln of its posterior, (2 K,) the curvature times the rod's length, and (D,) each."""

    value: float
    curvature: np.ndarray
    roll: np.ndarray
    twist: np.ndarray


@dataclass(frozen=True)
class _LinearModel:
    """−2 ln of the density of observation d as 2 sᵀv + vᵀBv, v = (x, κ in the frame of the straight rod, θ).

    information  (D, P + 1, P + 1) B
    slope        (D, P + 1) s
    precision    (P, P) of the prior of (x, κ), whose mean is −``offset`` (P,)
    twist        (D,) of the straight fit, rad
    counts       (D,) bool: the observations that x and κ are fitted to
    share        (K,) place of the knots over the rod's length
    """

    information: np.ndarray
    slope: np.ndarray
    precision: np.ndarray
    offset: np.ndarray
    twist: np.ndarray
    counts: np.ndarray
    share: np.ndarray

    def start(self, roll: np.ndarray) -> _Start:
        """The solution that is reached from these rolls (D,)."""
        twist, value = np.zeros(len(roll)), np.inf
        for _ in range(ROUNDS):
            shared = self._shared(roll, twist)
            new_roll, new_twist, each = self._each(shared)
            apart = shared + self.offset
            new = float(each[self.counts].sum() + apart @ self.precision @ apart)
            if new > value - 1e-4:
                break
            roll, twist, value = new_roll, new_twist, new
        return _Start(value, self._shared(roll, twist)[-2 * len(self.share) :], roll, twist)

    def _shared(self, roll: np.ndarray, twist: np.ndarray) -> np.ndarray:
        """(P,) the most probable x and κ, given each observation's roll and twist (D,)."""
        rows, first = self.counts, len(self.offset) - 2 * len(self.share)
        angle, information = roll[rows, None] + twist[rows, None] * self.share, self.information[rows]
        slope = self.slope[rows] + information[:, :, -1] * twist[rows, None]
        information, slope = information[:, :-1, :-1].copy(), slope[:, :-1].copy()
        slope[:, first:] = _turned(slope[:, first:], angle)
        information[:, :, first:] = _turned(information[:, :, first:], angle[:, None])
        information[:, first:] = np.swapaxes(_turned(np.swapaxes(information[:, first:], 1, 2), angle[:, None]), 1, 2)
        return -np.linalg.solve(information.sum(axis=0) + self.precision, slope.sum(axis=0) + self.precision @ self.offset)

    def _each(self, shared: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(D,) the best roll and twist of each observation, given (x, κ), and −2 ln of its density then."""
        count, many = len(shared), len(TWISTS)
        first = count - 2 * len(self.share)
        columns = np.zeros((count + 1, 1 + 3 * many))  # x; κ turned by each twist, and a quarter more; the twists themselves
        columns[:first, 0] = shared[:first]
        angle = TWISTS[:, None] * self.share
        columns[first:count, 1 : 1 + 2 * many] = _turned(shared[first:], -np.concatenate([angle, angle + np.pi / 2])).T
        columns[count, 1 + 2 * many :] = TWISTS
        product = columns.T @ self.information @ columns
        slope = self.slope @ columns
        at_cos, at_sin, at_twist = (np.arange(1, 1 + many) + part * many for part in range(3))

        def diagonal(a, b):
            return product[:, a, b]

        fixed = 2 * (slope[:, :1] + slope[:, at_twist]) + product[:, :1, 0] + diagonal(at_twist, at_twist) + 2 * product[
            :, 0, at_twist] + ((self.twist[:, None] + TWISTS) / ANY_TWIST) ** 2
        by_cos, by_sin = (2 * (slope[:, at] + product[:, 0, at] + diagonal(at, at_twist)) for at in (at_cos, at_sin))
        c, s = np.cos(ROLLS), np.sin(ROLLS)
        parts = ((fixed, 1.0), (by_cos, c), (by_sin, s), (diagonal(at_cos, at_cos), c * c),
                 (diagonal(at_sin, at_sin), s * s), (2 * diagonal(at_cos, at_sin), c * s))
        value = sum(part[..., None] * by for part, by in parts).reshape(len(slope), -1)
        best = value.argmin(axis=1)
        return ROLLS[best % len(ROLLS)], TWISTS[best // len(ROLLS)], value.min(axis=1)


def _turned(rows: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """(…, 2 K) ``rows`` R, R the rotations by ``angle`` (…, K) of each pair of columns."""
    pairs, c, s = rows.reshape(*rows.shape[:-1], -1, 2), np.cos(angle), np.sin(angle)
    both = np.stack([c * pairs[..., 0] + s * pairs[..., 1], c * pairs[..., 1] - s * pairs[..., 0]], axis=-1)
    return both.reshape(*both.shape[:-2], -1)


def rolled(fit: Fit, fitted: Fitted, curvature: str) -> tuple[Fit, list[State]]:
    """The fit with that kind of rest curvature, and where it may begin, from a finished fit of straight rods."""
    curved = replace(fit, comparison=replace(fit.comparison, unknowns=replace(fit.unknowns, curvature=curvature)))
    unknowns, state = curved.unknowns, fitted.state
    values = replace(state.values, curvature=np.zeros((len(unknowns.knots), 2)))
    scales = expected(state.scales, unknowns)
    model, sound = _linear_model(curved, replace(state, values=values), scales)
    random = np.random.default_rng(0)
    starts = sorted((model.start(roll) for roll in random.uniform(-np.pi, np.pi, (BEGUN, len(model.slope)))),
                    key=lambda one: one.value)
    chosen: list[_Start] = []
    for one in starts:
        if len(chosen) < FOLLOWED and all(one.value > other.value + APART for other in chosen):
            chosen.append(one)
    found = []
    for one in chosen:
        roll, scatter = np.zeros(len(sound)), state.values.scatter.copy()
        roll[sound] = one.roll
        scatter[sound, TWIST] += one.twist
        scatter = _rolled_further(scatter, roll)
        begun = replace(values, scatter=scatter, curvature=one.curvature.reshape(-1, 2) / unknowns.rod.length)
        found.append(curved.posed(curved.from_marks(begun, scales)))
    return curved, found


def expected(scales: Scales, unknowns: Unknowns) -> Scales:
    """``scales`` with those of a curved rod to begin with. What a straight rod leaves unexplained is not the gap of a curved
    one."""
    length = unknowns.rod.length
    scales = scales.learning(unknowns.scale_names)
    return scales.given(curvature=SIZE / length, range=RANGE * length, gap=min(scales["gap"], GAP * length))


def _linear_model(fit: Fit, state: State, scales: Scales) -> tuple[_LinearModel, np.ndarray]:
    """The linear model around straight rods, and (D,) bool the observations that it has."""
    unknowns, sound = fit.unknowns, state.solution.converged & state.solution.stable
    linear, sound = fit.comparison.linear(state.solution, state.values, sound, leave_out_soft=False)
    own = unknowns.columns("curvature")
    order = np.concatenate([np.setdiff1d(np.arange(len(unknowns.names)), own), own])
    twisted = tuple(replace(kind, shared=np.concatenate([kind.shared[..., order], kind.effects[..., [TWIST]]], axis=-1),
                            effects=kind.effects * (np.arange(kind.effects.shape[-1]) != TWIST)) for kind in linear)
    information, slope, _, _ = integrated(unknowns, twisted, scales)
    precision, _ = unknowns.precision(scales)
    counts = state.used[sound] if (state.used & sound).any() else np.ones(int(sound.sum()), dtype=bool)
    return _LinearModel(information[sound], slope[sound], precision[np.ix_(order, order)],
                        unknowns.offset(state.values, fit.origin)[order], state.values.scatter[sound, TWIST], counts,
                        unknowns.knots / unknowns.rod.length), sound


def _other_rolls(fit: Fit, values: Values, scales: Scales) -> Iterator[State]:
    """All observations rolled further by each of TRIED rolls, with the most probable clamps then."""
    for extra in np.linspace(0.0, 2 * np.pi, TRIED, endpoint=False)[1:]:
        scatter = _rolled_further(values.scatter, extra)
        yield fit.posed(fit.from_marks(replace(values, scatter=scatter), scales))


def _rolled_further(scatter: np.ndarray, extra) -> np.ndarray:
    """``scatter`` (D, POSE) with the start rolled by ``extra`` more, without whole turns, which its prior would count."""
    scatter = scatter.copy()
    scatter[:, 0] += extra
    scatter[:, :3] = rotation_vector(quaternion_of_turn(scatter[:, :3]))
    return scatter


def rolls_chosen_again(fit: Fit, fitted: Fitted, steps: int) -> list[Fitted]:
    """``fitted``, continued with the rolls that are most probable under what was learned, as long as that helps. All that were
    reached, the best first."""
    return chosen_again(fit, fitted, steps, lambda state: _other_rolls(fit, state.values, state.scales))
