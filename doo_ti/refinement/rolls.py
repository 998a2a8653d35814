"""Rods that are curved at rest, held by clips whose roll is not known: every roll is tried, and counts with its probability; or
all have the same; or they roll freely. The evidence decides (:mod:`doo_ti.refinement.search`).

A straight round rod does not say how it was rolled, and marks of a slightly curved one hardly do. So each observation has
COPIES rows, held at evenly spaced rolls φ_k with a window about each. The density of its marks is that of a mixture,

    p(marks_d | x) = Σ_k p(marks_d | x, φ_k)/COPIES,

whose maximum is found by expectation and maximisation (Dempster, Laird and Rubin, 1977): the share of each row is its
probability at the present x; the step is Newton's, with the information that is missing taken off (Louis, 1982). Fits that
choose one roll for each observation have dozens of optima, and take the coincidences of the best for what they learned.

A linear model says where it begins. In a rod that is curved at rest by κ(s), rolled by φ and twisted by θ more than the
straight fit has it, κ lies as κ(s) turned by φ + θ s/L about the tangent of the straight rod. To first order the residuals of
observation d then change by

    J x + K R(φ_d + θ_d s/L) κ + z θ_d,

J the derivatives by all other shared unknowns x, K those by the rest curvature, z those by the twist, the other errors of the
clamps integrated out. Given φ and θ the best x and κ solve a linear system; given these, φ_d and θ_d are the best of a grid in
each observation. Taken in turns from random rolls, both soon settle.

Rods that stay in the same clips all have one roll. If the roll of each observation were unknown by itself, equal rolls would be
a coincidence, and would count against the fit in every one. So they have a fit of their own, with one row for each observation
and start frames that differ by no roll. Two ways to move a clip without rolling it are usual: its side stays level, as on a
tripod that pans and tilts; or it is carried by the shortest rotations (parallel transport) from the mean of its directions, as
by an arm that does not turn its last axis. The latter also has a meaning about the vertical. Both are tried (:func:`kept`).
What the common roll is, κ says. Each observation's own is off it by a normal error, whose size is learned with a prior about
KEPT; how far the rod is twisted stays free.

A curved rod that rolls freely in what holds it turns to where it has the least energy: its rest curvature then lies as it is
bent, in all observations alike, and makes it look like a softer straight rod. A fit with rolls that are unknown but held takes
each of them for a coincidence, so such rods have a fit of their own, without the roll (:func:`swivelling`).

Axes: D observations, R rows, P shared unknowns, of which 2 K are those of the curvature at K knots.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from doo_ti.refinement.evidence import Evidence, integrated
from doo_ti.refinement.fit import Fit, Fitted, State
from doo_ti.refinement.held_rod import POSE, TWIST
from doo_ti.refinement.theta import ANY_TWIST, NAMES, Scales
from doo_ti.refinement.unknowns import Unknowns
from doo_ti.rod.frames import angle_about, rotation_vector, smallest_rotation, some_frames, transported, unit_vectors

ROLLS = np.linspace(-np.pi, np.pi, 48, endpoint=False)
TWISTS = np.radians(np.arange(-210.0, 211.0, 30.0))
BEGUN = 32  # sets of random rolls from which the linear model is solved
SIZE, RANGE = 1.0, 0.3  # expected of curved rods: the curvature times the rod's length, and its range over that length
GAP = 3e-4  # largest gap then, over the rod's length
ROUNDS = 40  # most turns of that solution
COPIES = 6  # rolls of each observation that are relaxed, evenly spaced
NODES = np.linspace(0.0, 2 * np.pi, COPIES, endpoint=False)
WINDOW = 0.5  # rad, standard deviation of a roll about each of them: together they are uniform to 5 %
CURVED = (1.0, 0.3, 2.0)  # curvatures times the rod's length with which a rod that rolls freely begins, the likeliest first
KEPT, KEPT_FACTOR = 0.1, 0.5  # rad, by how much a kept roll varies: median, and standard deviation of its logarithm
FACTOR = 0.7
"""Standard deviation of the logarithm of such a rod's curvature, about SIZE. Far smaller ones are straight rods, of which there
is a fit already: to that this one would shrink, past what fits as well."""
STRAIGHT = 0.1
"""That below which a rod counts as straight: it rolls freely to anywhere, and the held rod of unknown roll contains it."""


@dataclass(frozen=True)
class _Start:
    """A solution of the linear model: −2 ln of its posterior, (2 K,) the curvature times the rod's length, and (D,) each."""

    value: float
    curvature: np.ndarray
    roll: np.ndarray
    twist: np.ndarray


@dataclass(frozen=True)
class LinearModel:
    """−2 ln of the density of observation d as 2 sᵀv + vᵀBv, v = (x, κ in the frame of the straight rod, θ)."""

    information: np.ndarray  # (D, P + 1, P + 1) B
    slope: np.ndarray  # (D, P + 1) s
    precision: np.ndarray  # (P, P) of the prior of (x, κ), whose mean is −``offset`` (P,)
    offset: np.ndarray
    twist: np.ndarray  # (D,) of the straight fit, rad
    counts: np.ndarray  # (D,) bool: the observations that x and κ are fitted to
    share: np.ndarray  # (K,) place of the knots over the rod's length
    rows: np.ndarray  # (D,) which observations these are

    def start(self, roll: np.ndarray, of_roll: np.ndarray | float = 0.0) -> _Start:
        """The solution that is reached from these rolls (D,); ``of_roll`` (D, 1, ROLLS): −2 ln of their prior."""
        twist, value = np.zeros(len(roll)), np.inf
        for _ in range(ROUNDS):
            shared = self._shared(roll, twist)
            new_roll, new_twist, each = self._each(shared, of_roll)
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
        slope[:, first:] = turned(slope[:, first:], angle)
        information[:, :, first:] = turned(information[:, :, first:], angle[:, None])
        information[:, first:] = np.swapaxes(turned(np.swapaxes(information[:, first:], 1, 2), angle[:, None]), 1, 2)
        return -np.linalg.solve(information.sum(axis=0) + self.precision, slope.sum(axis=0) + self.precision @ self.offset)

    def _each(self, shared: np.ndarray, of_roll: np.ndarray | float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(D,) the best roll and twist of each observation, given (x, κ), and −2 ln of its density then."""
        count, many = len(shared), len(TWISTS)
        first = count - 2 * len(self.share)
        columns = np.zeros((count + 1, 1 + 3 * many))  # x; κ turned by each twist, and a quarter more; the twists themselves
        columns[:first, 0] = shared[:first]
        angle = TWISTS[:, None] * self.share
        columns[first:count, 1 : 1 + 2 * many] = turned(shared[first:], -np.concatenate([angle, angle + np.pi / 2])).T
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
        value = (sum(part[..., None] * by for part, by in parts) + of_roll).reshape(len(slope), -1)
        best = value.argmin(axis=1)
        return ROLLS[best % len(ROLLS)], TWISTS[best // len(ROLLS)], value.min(axis=1)


Curved = tuple[Fit, State, Scales, LinearModel]  # what :func:`curved` returns, and fits of curved rods begin with


def turned(rows: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """(…, 2 K) ``rows`` R, R the rotations by ``angle`` (…, K) of each pair of columns."""
    pairs, c, s = rows.reshape(*rows.shape[:-1], -1, 2), np.cos(angle), np.sin(angle)
    both = np.stack([c * pairs[..., 0] + s * pairs[..., 1], c * pairs[..., 1] - s * pairs[..., 0]], axis=-1)
    return both.reshape(*both.shape[:-2], -1)


def rolled(begun: Curved) -> tuple[Fit, State]:
    """The fit in which every observation has COPIES rows, and where it begins."""
    straight, state, scales, model = begun
    random = np.random.default_rng(0)
    best = min((model.start(roll) for roll in random.uniform(-np.pi, np.pi, (BEGUN, len(model.slope)))),
               key=lambda one: one.value)
    all_rolls = at_all_rolls(straight)
    scatter = np.repeat(state.values.scatter, COPIES, axis=0)
    values = replace(state.values, scatter=in_turned_frames(scatter, all_rolls.unknowns.rod.rolled),
                     curvature=best.curvature.reshape(-1, 2) / straight.unknowns.rod.length)
    return all_rolls, all_rolls.posed(all_rolls.from_marks(values, scales.given(any_roll=WINDOW)))


def curved(fitted: Fitted, curvature: str) -> Curved:
    """A finished fit of straight rods as one with that kind of rest curvature, of which there is none yet; the sizes that it
    begins with, and its linear model."""
    fit = fitted.fit
    straight = replace(fit, comparison=replace(fit.comparison, unknowns=replace(fit.unknowns, curvature=curvature)))
    unknowns = straight.unknowns
    state = replace(fitted.state, values=replace(fitted.state.values, curvature=np.zeros((len(unknowns.knots), 2))))
    scales = expected(state.scales, unknowns)
    return straight, state, scales, _linear_model(straight, state, scales)


def at_all_rolls(fit: Fit) -> Fit:
    """``fit`` with COPIES rows for each observation, rolled by NODES."""
    count = fit.unknowns.rod.observations.count
    return _of_rows(fit, np.repeat(np.arange(count), COPIES), np.tile(NODES, count), COPIES)


def _of_rows(fit: Fit, rows: np.ndarray, roll: np.ndarray, copies: int = 1) -> Fit:
    """The fit whose rows are those ``rows`` of ``fit``, each at its ``roll``."""
    comparison, unknowns = fit.comparison, replace(fit.unknowns, rod=fit.unknowns.rod.take(rows, roll, copies))
    return replace(fit, rods=None if fit.rods is None else fit.rods[rows], comparison=replace(
        comparison, unknowns=unknowns, weight=comparison.weight[rows],
        directors=None if comparison.directors is None else comparison.directors[rows],
        correction=comparison.correction[rows]))


def in_turned_frames(scatter: np.ndarray, roll: np.ndarray) -> np.ndarray:
    """``scatter`` (R, POSE) of the same clamps, not rolled, in frames that are rolled by ``roll`` (R,)."""
    found, across = scatter.copy(), [column for column in range(POSE) if column % 3]
    found[:, 0] = 0.0
    found[:, across] = turned(scatter[:, across], roll[:, None])
    return found


def most_probable(fitted: Fitted) -> Fitted:
    """The same fit with one row for each observation, that of its most probable roll."""
    fit, rod, state = fitted.fit, fitted.fit.unknowns.rod, fitted.state
    if rod.copies == 1:
        return fitted
    likely = rod.by_observation(fitted.evidence.share + state.used).argmax(axis=1)
    rows = likely + rod.copies * np.arange(len(likely))
    one, values = _of_rows(fit, rows, rod.rolled[rows]), replace(state.values, scatter=state.values.scatter[rows])
    state = replace(one.at(values, state.scales, state.solution.take(rows)), used=state.used[rows])
    linear = tuple(replace(kind, values=kind.values[rows], shared=kind.shared[rows], effects=kind.effects[rows],
                           count=kind.count[rows]) for kind in fitted.linear)
    evidence = Evidence.of(one.unknowns, linear, fitted.evidence.offset)
    return replace(fitted, fit=one, state=state, evidence=evidence, posterior=evidence.posterior(state.scales), linear=linear,
                   rest=np.zeros(len(rows)))


def expected(scales: Scales, unknowns: Unknowns) -> Scales:
    """``scales`` with those of a curved rod to begin with. What a straight rod leaves unexplained is not the gap of a curved
    one."""
    length = unknowns.rod.length
    scales = scales.learning(unknowns.scale_names)
    return scales.given(curvature=SIZE / length, range=RANGE * length, gap=min(scales["gap"], GAP * length))


def _linear_model(fit: Fit, state: State, scales: Scales) -> LinearModel:
    """The linear model around straight rods, of the observations whose rods are sound."""
    unknowns = fit.unknowns
    linear, sound = fit.comparison.linear(state.solution, state.values, state.sound, leave_out_soft=False)
    own = unknowns.columns("curvature")
    order = np.concatenate([np.setdiff1d(np.arange(len(unknowns.names)), own), own])
    twisted = tuple(replace(kind, shared=np.concatenate([kind.shared[..., order], kind.effects[..., [TWIST]]], axis=-1),
                            effects=kind.effects * (np.arange(kind.effects.shape[-1]) != TWIST)) for kind in linear)
    information, slope, _, _ = integrated(unknowns, twisted, scales)
    precision, _ = unknowns.precision(scales)
    counts = state.used[sound] if (state.used & sound).any() else np.ones(int(sound.sum()), dtype=bool)
    return LinearModel(information[sound], slope[sound], precision[np.ix_(order, order)],
                        unknowns.offset(state.values, fit.origin)[order], state.values.scatter[sound, TWIST], counts,
                        unknowns.knots / unknowns.rod.length, np.flatnonzero(sound))


# --- rods that keep their roll --------------------------------------------------------------------------------------------


def kept(begun: Curved) -> Iterator[tuple[Fit, State]]:
    """The fits in which all observations have nearly one roll, and where each begins: one for each meaning of one roll that the
    observations tell apart."""
    straight, state, scales, model = begun
    own = np.array(NAMES) == "any_roll"
    scales = replace(scales, typical=np.where(own, KEPT, scales.typical), factor=np.where(own, KEPT_FACTOR, scales.factor),
                     learned=scales.learned | own, hessian=None).given(any_roll=KEPT)
    frames = next(straight.unknowns.rod.ends(straight.unknowns.pose(state.values)))[-1]
    for roll in common_rolls(frames, state.values.theta.up):
        apart = np.angle(np.exp(1j * (ROLLS - roll[model.rows, None])))
        best = model.start(roll[model.rows], ((apart / KEPT) ** 2)[:, None])
        fit = _of_rows(straight, np.arange(len(roll)), roll)
        values = replace(state.values, scatter=in_turned_frames(state.values.scatter, roll),
                         curvature=best.curvature.reshape(-1, 2) / straight.unknowns.rod.length)
        yield fit, fit.posed(fit.from_marks(values, scales))


def common_rolls(frames: np.ndarray, up: np.ndarray) -> Iterator[np.ndarray]:
    """(D,) by how much start frames (D, 3, 3) turn about their tangents until m1 is level; and, where that is not the same but
    for a common turn, until they are that of their mean direction carried to each."""
    tangent, side = frames[..., 0], frames[..., 1]
    mean = unit_vectors(tangent.mean(axis=0))
    carried = transported(some_frames(mean), tangent)[..., 1]
    level, other = (angle_about(tangent, side, wanted) for wanted in (unit_vectors(np.cross(up, tangent)), carried))
    yield level
    apart = np.exp(1j * (level - other))
    if np.abs(np.angle(apart / apart.mean())).max() > KEPT:
        yield other


# --- rods that roll freely ------------------------------------------------------------------------------------------------


def swivelling(fitted: Fitted, curvature: str) -> tuple[Fit, Iterator[State]]:
    """The fit with ends that roll freely and that kind of rest curvature, and where it may begin, from a finished fit of
    straight rods whose ends are held."""
    fit, state, rod = fitted.fit, fitted.state, replace(fitted.fit.unknowns.rod, swivels=True)
    unknowns = replace(fit.unknowns, rod=rod, curvature=curvature)
    free = replace(fit, comparison=replace(fit.comparison, unknowns=unknowns))
    values = replace(state.values, scatter=_without_roll(fit, state))
    scales, own = expected(state.scales, unknowns), np.array(NAMES) == "curvature"
    scales = replace(scales, typical=np.where(own, SIZE / rod.length, scales.typical),
                     factor=np.where(own, FACTOR, scales.factor))
    fields = (np.tile([size / rod.length, 0.0], (len(unknowns.knots), 1)) for size in CURVED)
    return free, (free.posed(free.from_marks(replace(values, curvature=field), scales)) for field in fields)


def bent(fitted: Fitted) -> bool:
    """Whether the rod is not straight at rest."""
    size = np.sqrt((fitted.state.values.curvature**2).sum(axis=1).mean())
    return bool(size >= STRAIGHT / fitted.fit.unknowns.rod.length)


def _without_roll(fit: Fit, state: State) -> np.ndarray:
    """(D, POSE) the errors of the clamps, which point as before but are not rolled."""
    scatter = state.values.scatter.copy()
    for end, (_, frame, _, now) in enumerate(fit.unknowns.rod.ends(fit.unknowns.pose(state.values))):
        tangent = np.einsum("dji,dj->di", frame, now[..., 0])
        scatter[:, 3 * end : 3 * end + 3] = rotation_vector(smallest_rotation(np.array([1.0, 0.0, 0.0]), tangent))
    return scatter
