"""Whether the model explains the marks, and whether another model would do better (§III-E).

A model that explains its marks leaves residuals that are noise: as large as σ, if one is stated, and independent from mark to
mark. Errors of the model displace neighbouring marks together (the gap of :mod:`doo_ti.refinement.residuals`).

Extensions of the model are rated on the linear model at the end of the fit, by the rise of the evidence. Bend stiffness that
varies along the rod is fitted at once where the marks are for it: a uniform rod would be too stiff or too soft by as much as it
varies, with an interval that is too narrow.

Other models are fitted, and each observation is predicted from all others (leave-one-out); the score of a model is the sum of
the logarithms of the predicted probability densities of the observations:

    straight        no rest curvature
    curved          with a field of rest curvature
    ribbon          different bend stiffness about m1 and m2, for ends whose whole frames are held

Misfits, rods that the model does not explain, are tried with their marks in reverse order, with two of them swapped, and
without one of them: relaxed at the Θ of the others, and posed as they are. Where one of these fits as the others do, the misfit
is named for it; it stays left out.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from doo_ti.refinement.evidence import Evidence
from doo_ti.refinement.fit import EXACT, ODD, Fit, Fitted, State
from doo_ti.refinement.held_rod import POSE
from doo_ti.refinement.residuals import Comparison
from doo_ti.refinement.rolls import WINDOW, most_probable
from doo_ti.refinement.search import behind
from doo_ti.refinement.unknowns import LOGARITHMIC, Unknowns, Values
from doo_ti.rod.observations import Observations
from doo_ti.rod.start import observation_clamps, reachable
from doo_ti.rod.types import Clamp

NOTABLE = 0.5  # times the noise: smaller gaps are not reported
TOGETHER = 0.5  # correlation of neighbours' residuals: in photographs -0.1 to 0.3, with a rig half a pixel off 0.6 to 0.8
EXCESS = 1.5  # times the stated σ: if residuals are larger, σ is too small or the model is wrong
WORTH = 6.0  # −2 ln of the evidence: an extension that lowers it by more is worth trying
SEARCH_STEPS = 15  # for the sizes of an extension
UNROUND = "a section that is not round"
STEPS = 10
ERRORS = 2.0  # standard errors by which a parameter moves without an observation that it is said to rest on
MOST_MISFITS = 8  # misfits that are tried, the first of them
POSED_ORDERS = 12
"""Orders of each misfit with all its marks that are posed, and as many without one: those nearest to their marks before."""
NO_FARTHER = 1.02  # marks in another order may be farther apart than in the given one by this factor, which noise explains
FEWEST = 5  # marks, without one of which a rod may be tried


@dataclass(frozen=True)
class Advice:
    """An extension of the model: the argument for it, as ``name=value``, its meaning, and by how much it raises twice the
    logarithm of the evidence."""

    option: str
    meaning: str
    gain: float


@dataclass(frozen=True)
class Influence:
    """An observation without which a parameter would move by more than ERRORS standard errors."""

    observation: int  # its row
    parameter: str  # the name of the parameter, a positive one
    factor: float  # of the parameter without that observation


@dataclass(frozen=True)
class Adequacy:
    """What the residuals say about the model."""

    noise: float  # σ in mm: learned, or the mean of the stated ones
    stated: bool  # whether it was stated
    excess: float  # root mean square residual over σ; near one where σ and the model are right
    gap: float  # mm: root mean square of smooth displacements that the model does not explain
    correlation: float  # of the residuals of neighbouring marks
    advice: tuple[Advice, ...]  # extensions worth trying, the best first
    influences: tuple[Influence, ...]  # observations that a parameter rests on, the most influential first

    @property
    def reaches_noise(self) -> bool:
        """Whether the residuals are nothing but noise."""
        return self.gap <= NOTABLE * self.noise and (not self.stated or self.excess <= EXCESS)


def adequacy(fitted: Fitted) -> Adequacy:
    """The residuals of a finished fit, examined."""
    fit, state, comparison = fitted.fit, fitted.state, fitted.fit.comparison
    rows = state.residuals[0][state.used].reshape(int(state.used.sum()), -1, 3)
    counts = comparison.weight[state.used] > 0
    stated = fit.unknowns.rod.observations.sigma is not None
    sigma = state.scales["marks"]
    noise = float(np.nanmean(fit.unknowns.rod.observations.sigma)) if stated else sigma
    gap = state.scales["gap"] * float(np.sqrt((comparison.gap_modes**2).sum(axis=1).mean()))
    degrees = max(3.0 * counts.sum() - len(fit.unknowns.names), 1.0)
    return Adequacy(noise, stated, float(np.sqrt((rows**2).sum() / degrees) / sigma), gap,
                    _correlation(rows, counts), advice(fitted), _influences(fitted))


def _correlation(rows: np.ndarray, counts: np.ndarray) -> float:
    both = counts[:, 1:] & counts[:, :-1]
    crossed = (rows[:, 1:] * rows[:, :-1]).sum(axis=-1)[both]
    sizes = np.sqrt((rows[:, 1:] ** 2).sum(axis=-1)[both].sum() * (rows[:, :-1] ** 2).sum(axis=-1)[both].sum())
    return float(crossed.sum() / sizes) if sizes > 0 else 0.0


def _influences(fitted: Fitted) -> tuple[Influence, ...]:
    found, unknowns, names = fitted.posterior, fitted.fit.unknowns, fitted.fit.unknowns.names
    if fitted.counted.sum() < 2:  # all rests on it
        return ()
    moved = fitted.evidence.without_each(fitted.linear, fitted.state.scales) - found.step
    errors = np.sqrt(np.diag(found.covariance))
    pairs = [(row, k) for k, name in enumerate(names[: unknowns.theta_count]) if name in LOGARITHMIC
             if not (name == "twist" and unknowns.rod.twist_unknown)
             for row in np.flatnonzero(fitted.state.used & (np.abs(moved[:, k]) > ERRORS * errors[k]))]
    pairs.sort(key=lambda pair: -abs(moved[pair]) / errors[pair[1]])
    return tuple(Influence(int(row), names[k], float(np.exp(moved[row, k]))) for row, k in pairs)


# --- extensions of the model ----------------------------------------------------------------------------------------------


def advice(fitted: Fitted) -> tuple[Advice, ...]:
    """Extensions of a finished fit that are worth trying, the best first."""
    found = (Advice(option, meaning, _gain(fitted, unknowns)) for option, meaning, unknowns in _extensions(fitted.fit.unknowns))
    return tuple(sorted((one for one in found if one.gain > WORTH), key=lambda one: -one.gain))


def _extensions(unknowns: Unknowns) -> Iterator[tuple[str, str, Unknowns]]:
    """(option, meaning, unknowns) of each extension."""
    names, rod = unknowns.parameters, unknowns.rod

    def learning(meaning: str, *parameters: str, **more):
        return f"parameters={','.join(parameters).replace('_', '-')}", meaning, replace(unknowns, parameters=parameters, **more)

    if "up" not in names and rod.loads is None:
        yield learning("the direction of gravity", *names, "up")
    if "bend" in names and _held_by_frames(unknowns):
        others = (name for name in names if name != "bend")
        yield learning(UNROUND, "bend_1", "bend_2", "bend_12", *others, uneven=False)
    if not unknowns.clips and rod.clamped.any():
        yield "clip=unknown", "clips of another length", replace(unknowns, clips=True)
    if unknowns.curvature != "field":
        yield "rest_curvature=field", "rest curvature that varies along the rod", replace(unknowns, curvature="field")
    if unknowns.round and not unknowns.uneven:
        yield "stiffness=field", "bend stiffness that varies along the rod", replace(unknowns, uneven=True)
    if rod.exact:
        yield "clamps=loose", "clamps that are off what was reported", replace(unknowns, rod=replace(rod, exact=False))


def _held_by_frames(unknowns: Unknowns) -> bool:
    """Whether both ends' frames were reported: only then do observations separate bending about m1 from bending about m2."""
    seen = unknowns.rod.observations
    return seen.start_frame is not None and seen.end_frame is not None


def _gain(fitted: Fitted, unknowns: Unknowns) -> float:
    """By how much −2 ln of the evidence is lower for ``unknowns``, in the linear model at the end of ``fitted``, its sizes
    fitted."""
    values = _with_fields(fitted.state.values, unknowns)
    comparison = replace(fitted.fit.comparison, unknowns=unknowns)
    linear, _ = comparison.linear(fitted.state.solution, values, fitted.state.used)
    evidence = Evidence.of(unknowns, linear, unknowns.offset(values, fitted.fit.origin))
    scales = evidence.best(fitted.state.scales.learning(unknowns.scale_names), SEARCH_STEPS)
    return fitted.posterior.value - evidence.posterior(scales).value


def _with_fields(values: Values, unknowns: Unknowns) -> Values:
    """``values`` with the fields of ``unknowns``: a new one is uniform, at the mean rest curvature or bend stiffness."""
    if len(unknowns.knots) != len(values.curvature):
        mean = values.curvature.mean(axis=0) if len(values.curvature) else np.zeros(2)
        values = replace(values, curvature=np.tile(mean, (len(unknowns.knots), 1)))
    if len(unknowns.stiffness_knots) != len(values.stiffness):
        values = replace(values, stiffness=np.zeros(len(unknowns.stiffness_knots)))
    return values


def with_stiffness_along(found: list[Fitted], steps: int, stiffness: str) -> list[Fitted]:
    """The optima ``found``, the best first, or these with a bend stiffness that varies along the rod, each continued for
    ``steps``: as ``stiffness`` of :class:`.RefinementOptions` says."""
    if stiffness == "uniform" or not found[0].fit.unknowns.round:
        return found
    first, *others = found
    first = most_probable(first)  # one row for each observation
    if stiffness == "auto" and _gain(first, replace(first.fit.unknowns, uneven=True)) <= WORTH:
        return found
    uneven = sorted((_continued(one, steps) for one in (first, *map(most_probable, others))), key=lambda one: one.rank)
    return uneven if stiffness == "field" or behind(uneven[0], first) < -WORTH else found


def _continued(fitted: Fitted, steps: int) -> Fitted:
    """The fit with a stiffness that varies along the rod."""
    fit, begun = _begun(fitted, replace(fitted.fit.unknowns, uneven=True))
    return fit.run(replace(begun, used=fitted.state.used & begun.sound), steps).after(fitted)


def _begun(fitted: Fitted, unknowns: Unknowns) -> tuple[Fit, State]:
    """The fit of other unknowns, and where it begins: at the end of ``fitted``."""
    fit, state = replace(fitted.fit, comparison=replace(fitted.fit.comparison, unknowns=unknowns)), fitted.state
    return fit, fit.at(_with_fields(state.values, unknowns), state.scales.learning(unknowns.scale_names), state.solution)


# --- other models ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Score:
    """The score of a model minus that of the fitted one, over the rods that count in both."""

    model: str  # its name
    difference: float  # ln of the odds that it predicts better than the fitted model; negative: worse
    error: float  # standard error of the difference
    rods: int  # number of rods that count in both


def scores(fitted: Fitted) -> tuple[Score, ...]:
    """The scores of all other models, each fitted from the end of ``fitted``."""
    found, own = [], fitted.evidence.left_out(fitted.linear, fitted.state.scales)
    for name, unknowns in _variants(fitted.fit.unknowns).items():
        fit, begun = _begun(fitted, unknowns)
        other = fit.run(begun, STEPS)
        both = fitted.state.used & other.state.used
        change = (other.evidence.left_out(other.linear, other.state.scales) - own)[both]
        error = np.std(change, ddof=1) * np.sqrt(len(change)) if len(change) > 1 else np.inf
        found.append(Score(name, float(change.sum()), float(error), int(both.sum())))
    return tuple(found)


def _variants(unknowns: Unknowns) -> dict[str, Unknowns]:
    """The models of the list above, without that of ``unknowns`` itself."""
    found = {name: replace(unknowns, curvature=curvature) for name, curvature in (("straight", "none"), ("curved", "field"))}
    if "bend" in unknowns.parameters and _held_by_frames(unknowns):
        others = tuple(name for name in unknowns.parameters if name != "bend")
        found["ribbon"] = replace(unknowns, parameters=("bend_1", "bend_2", *others))
    return {name: model for name, model in found.items() if model != unknowns}


# --- misfits whose marks are wrong ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Mislabelled:
    """An observation that fits as the others do once its marks are put right."""

    observation: int  # its row
    marks: tuple[int, ...]  # none: all in reverse order; two: swapped; one: it is somewhere else

    @property
    def text(self) -> str:
        """What is wrong, in words."""
        if not self.marks:
            return "its marks are in reverse order"
        if len(self.marks) == 1:
            return f"mark {self.marks[0]}, counted from 0, is not where the others say"
        return f"marks {self.marks[0]} and {self.marks[1]}, counted from 0, are swapped"


def mislabelled(fitted: Fitted) -> tuple[Mislabelled, ...]:
    """Those among the first MOST_MISFITS misfits of a finished fit."""
    fit, state = fitted.fit, fitted.state
    misfits = np.flatnonzero(~state.used & (fit.comparison.count > 0) & fit.far(state))[:MOST_MISFITS]
    if fit.rods is not None or not state.used.any() or not len(misfits):
        return ()
    usual = ODD * max(np.median(fit.mean_squares(state.residuals)[state.used]), EXACT)
    best = (_best_order(fitted, int(row), usual) for row in misfits)
    return tuple(one for one in best if one is not None)


def _best_order(fitted: Fitted, row: int, usual: float) -> Mislabelled | None:
    """Of the orders of the marks of observation ``row`` that with the least mean square, below ``usual``: one with all marks
    where there is any."""
    fit, state, rod = fitted.fit, fitted.state, fitted.fit.unknowns.rod
    kinds = [Clamp(int(np.max(kind))) for kind in (rod.clamps.start, rod.clamps.end)]
    # Marks alone of a rod that is held alike at both ends fit in either order: then another shape was found, not another order.
    orders, seen = _orders(rod.observations, row, any(rod.reported) or kinds[0] != kinds[1])
    within = np.flatnonzero(reachable(seen, observation_clamps(seen, *kinds), rod.exact))
    without_one = np.array([len(orders[order]) == 1 for order in within], dtype=bool)

    def begun(rows: np.ndarray):
        own, same = seen.take(rows), np.full(len(rows), row)
        held = replace(rod.take(same, rolled=None), observations=own, clamps=observation_clamps(own, *kinds))
        comparison = Comparison.of(replace(fit.unknowns, rod=held), fit.comparison.directors is not None)
        among = replace(fit, comparison=replace(comparison, correction=fit.comparison.correction[same]))
        values = replace(state.values, scatter=np.zeros((len(rows), POSE)))
        return among, among.from_marks(values, state.scales.given(any_roll=max(state.scales["any_roll"], WINDOW)))

    def squares(one: Fit, now: State) -> np.ndarray:
        return np.where(now.sound, one.mean_squares(now.residuals), np.inf)

    for kind in (within[~without_one], within[without_one]):
        if len(kind):
            nearest = kind[np.argsort(squares(*begun(kind)), kind="stable")[:POSED_ORDERS]]
            among, now = begun(nearest)
            apart = squares(among, among.posed(now))
            if apart.min() <= usual:
                return Mislabelled(row, orders[nearest[apart.argmin()]])
    return None


def _orders(seen: Observations, row: int, reverse: bool) -> tuple[list[tuple[int, ...]], Observations]:
    """The marks that each order changes, as :class:`Mislabelled` has them, and the observations so changed. None takes
    neighbours farther apart, over the length between them, than they are now: right ones take them together."""
    there = np.flatnonzero(seen.valid[row]).tolist()
    orders = [*[()] * reverse, *combinations(there, 2), *(((mark,) for mark in there) if len(there) > FEWEST else ())]
    vertices = np.repeat(seen.vertices[row : row + 1], len(orders), axis=0)
    for number, marks in enumerate(orders):  # of one rod's marks
        if len(marks) == 2:
            vertices[number, list(marks)] = vertices[number, list(marks[::-1])]
        elif marks:
            vertices[number, marks] = np.nan
        else:
            vertices[number] = vertices[number, ::-1]
    apart, now = (np.nan_to_num(np.linalg.norm(np.diff(marks, axis=1), axis=-1) / seen.rest_length).max(axis=1)
                  for marks in (vertices, seen.vertices[row : row + 1]))
    near = np.flatnonzero(apart <= NO_FARTHER * now)
    changed, vertices = seen.take(np.full(len(near), row)), vertices[near]
    return [orders[order] for order in near], replace(changed, vertices=vertices, valid=np.isfinite(vertices).all(axis=-1))
