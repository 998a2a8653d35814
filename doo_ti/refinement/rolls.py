"""Rods that are curved at rest, held by clips whose roll is not known: every roll is tried, and counts with its probability; or
all have the same; or they roll freely. The evidence decides (:mod:`doo_ti.refinement.search`).

A straight round rod does not say how it was rolled, and marks of a slightly curved one hardly do. So each observation has
COPIES rows, held at evenly spaced rolls φ_k with a window about each. The density of its marks is that of a mixture,

    p(marks_d | x) = Σ_k p(marks_d | x, φ_k)/COPIES,

whose maximum is found by expectation and maximisation (Dempster, Laird and Rubin, 1977): the share of each row is its
probability at the present x; the step is Newton's, with the information that is missing taken off (Louis, 1982). Fits that
choose one roll for each observation have dozens of optima, and take the coincidences of the best for what they learned.

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

Axes: D observations, R rows, P unknowns, K knots.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from doo_ti.refinement.evidence import Evidence
from doo_ti.refinement.fit import Fit, Fitted, State
from doo_ti.refinement.held_rod import POSE
from doo_ti.refinement.theta import NAMES, Scales
from doo_ti.refinement.unknowns import Unknowns, Values
from doo_ti.rod.frames import angle_about, rotation_vector, smallest_rotation, some_frames, transported, unit_vectors

SIZE, RANGE = 1.0, 0.3  # expected of curved rods: the curvature times the rod's length, and its range over that length
COPIES = 6  # rolls of each observation that are relaxed, evenly spaced
NODES = np.linspace(0.0, 2 * np.pi, COPIES, endpoint=False)
WINDOW = 0.5  # rad, standard deviation of a roll about each of them: together they are uniform to 5 %
CURVED = (1.0, 0.3, 2.0)  # curvatures times the rod's length with which fits begin, the same all along the rod
KEPT, KEPT_FACTOR = 0.1, 0.5  # rad, by how much a kept roll varies: median, and standard deviation of its logarithm
FACTOR = 0.7
"""Standard deviation of the logarithm of such a rod's curvature, about SIZE. Far smaller ones are straight rods, of which there
is a fit already: to that this one would shrink, past what fits as well."""
STRAIGHT = 0.1
"""That below which a rod counts as straight: it rolls freely to anywhere, and the held rod of unknown roll contains it."""


def rolled(fitted: Fitted, curvature: str) -> Iterator[tuple[Fit, State]]:
    """The fit in which every observation has COPIES rows, with that kind of rest curvature, and where it may begin: at a
    finished fit of straight rods."""
    fit, state = at_all_rolls(_curved(fitted, curvature)), fitted.state
    scatter = in_turned_frames(np.repeat(state.values.scatter, COPIES, axis=0), fit.unknowns.rod.rolled)
    return _begun(fit, replace(state.values, scatter=scatter), expected(state.scales, fit.unknowns).given(any_roll=WINDOW))


def _curved(fitted: Fitted, curvature: str) -> Fit:
    """A fit of straight rods as one with that kind of rest curvature."""
    return fitted.fit.learning(replace(fitted.fit.unknowns, curvature=curvature))


def _begun(fit: Fit, values: Values, scales: Scales, sizes: tuple[float, ...] = CURVED) -> Iterator[tuple[Fit, State]]:
    """``fit``, and its rods relaxed from their observations with rest curvatures of each of the ``sizes``, the same all along
    the rod."""
    unknowns = fit.unknowns
    for size in sizes:
        field = np.tile([size / unknowns.rod.length, 0.0], (len(unknowns.knots), 1))
        yield fit, fit.posed(fit.from_marks(replace(values, curvature=field), scales))


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
    found, c, s = scatter.reshape(-1, POSE // 3, 3).copy(), np.cos(roll)[:, None], np.sin(roll)[:, None]
    found[..., 1], found[..., 2] = c * found[..., 1] + s * found[..., 2], c * found[..., 2] - s * found[..., 1]
    found[:, 0, 0] = 0.0
    return found.reshape(scatter.shape)


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
    length, gap = unknowns.rod.length, min(scales["gap"], scales.typical[NAMES.index("gap")])
    return scales.learning(unknowns.scale_names).given(curvature=SIZE / length, range=RANGE * length, gap=gap)


# --- rods that keep their roll --------------------------------------------------------------------------------------------


def kept(fitted: Fitted, curvature: str) -> Iterator[tuple[Fit, State]]:
    """The fits in which all observations have nearly one roll, and where each begins: at a finished fit of straight rods, and
    one for each meaning of one roll that the observations tell apart."""
    straight, values = _curved(fitted, curvature), fitted.state.values
    own = np.array(NAMES) == "any_roll"
    scales = expected(fitted.state.scales, straight.unknowns)
    scales = replace(scales, typical=np.where(own, KEPT, scales.typical), factor=np.where(own, KEPT_FACTOR, scales.factor),
                     learned=scales.learned | own, hessian=None).given(any_roll=KEPT)
    frames = next(straight.unknowns.rod.ends(straight.unknowns.pose(values)))[-1]
    for roll in common_rolls(frames, values.theta.up):
        yield from _begun(_of_rows(straight, np.arange(len(roll)), roll),
                          replace(values, scatter=in_turned_frames(values.scatter, roll)), scales, (0.0,))


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


def swivelling(fitted: Fitted, curvature: str) -> Iterator[tuple[Fit, State]]:
    """The fit with ends that roll freely and that kind of rest curvature, and where it may begin, from a finished fit of
    straight rods whose ends are held."""
    fit, state, rod = fitted.fit, fitted.state, replace(fitted.fit.unknowns.rod, swivels=True)
    free = fit.learning(replace(fit.unknowns, rod=rod, curvature=curvature))
    scales, own = expected(state.scales, free.unknowns), np.array(NAMES) == "curvature"
    scales = replace(scales, typical=np.where(own, SIZE / rod.length, scales.typical),
                     factor=np.where(own, FACTOR, scales.factor))
    return _begun(free, replace(state.values, scatter=_without_roll(fit, state)), scales)


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
