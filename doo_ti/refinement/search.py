"""The optima of the posterior that a fit reaches from several starts, the best first.

A posterior may have several: of the whole turns of rods between frames, of the rolls of rods that are curved at rest, of
straight and of curved rods. Which is the best says the evidence; those that it hardly tells apart count in the intervals
(:mod:`doo_ti.refinement.estimate`).

Frames that hold a rod at both ends, where nobody measured the total twist, leave it open up to whole turns. F takes, of
several, the rod nearest to the marks: under a twist stiffness that is too low a wrong turn changes the shape little, is taken,
and confirms the stiffness. So a fit begins with several twist stiffnesses, each with the turns that are nearest then, and once
with as little twist as the frames leave in all rods, which marks that are far apart may not tell from a turn more; the
posterior decides. At its end each observation's turns are chosen once more, under what was learned.
"""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import generate_binary_structure, minimum_filter

from doo_ti.refinement.evidence import given, integrated, others
from doo_ti.refinement.fit import ODD, POSED, ROUGH, Fit, Fitted, State
from doo_ti.refinement.residuals import Comparison
from doo_ti.refinement.rolls import Curved, bent, curved, kept, rolled, swivelling
from doo_ti.refinement.theta import Scales, Theta, common_rod
from doo_ti.refinement.unknowns import Unknowns, Values
from doo_ti.rod.grid import Grid
from doo_ti.rod.types import Clamp
from doo_ti.system.errors import InputError

if TYPE_CHECKING:
    from doo_ti.refinement.refine import RefinementOptions

TRIED_FIRST = 4  # steps from each of several starts; only the best of them are continued
NEAR = 30.0  # of these, −2 ln of the evidence above the best up to which others are continued too
HOPELESS = 100.0  # rods that roll freely are not tried from other starts where the first ends so far behind rods that are held
SAME = 0.3  # standard errors: fits whose Θ differ by less are one optimum
COMPARED = 5  # steps of each of two fits before they are compared, without the rods that count in one alone
FIRST_TURN = 0.3
"""rad, the initial rest curvature times the rod's length where the rolls at both ends are free: a straight rod has no preferred
side, and with a much smaller curvature the side changes with every small change of the unknowns."""
RATIOS = (0.25, 0.5, 1.0, 2.0, 4.0)  # twist over bend stiffness with which a fit begins
TURNS = (-1, 0, 1)  # whole turns of an observation that are compared, each with the most probable clamps
FAR_OFF = np.radians(3.0)  # of the errors of frames, above which measured whole turns may be wrong, and are left open as well
AGAIN = 3  # how often each observation is chosen once more, as long as that changes any


def behind(fitted: Fitted, best: Fitted) -> float:
    """−2 ln of the evidence above that of ``best``. Where they count different rods it is that of the rods that count in
    both, and each rod that one of them leaves out counts there as noise three times as large, with which rods become
    misfits (:data:`doo_ti.refinement.fit.ODD`): a model may not win by fitting less."""
    used = fitted.counted, best.counted
    if np.array_equal(*used):
        return fitted.value - best.value
    coordinates = fitted.fit.unknowns.rod.by_observation(fitted.fit.comparison.count)[:, 0]
    both = used[0] & used[1]
    values = []
    for one, counted in zip((fitted, best), used, strict=True):
        rods = np.repeat(both, one.fit.unknowns.rod.copies)
        state = replace(one.state, used=rods & one.state.used)
        value = replace(one.fit, rods=rods).run(state, COMPARED).posterior.value if both.any() else 0.0
        values.append(value + np.log(ODD) * float(coordinates[~counted].sum()))
    return values[0] - values[1]


def alike(fitted: Fitted, other: Fitted) -> bool:
    """Whether Θ and the kind of model are the same."""
    own, its = fitted.fit.unknowns, other.fit.unknowns
    if (own.curvature, own.rod.swivels) != (its.curvature, its.rod.swivels):
        return False
    count = own.theta_count
    apart = (one.fit.unknowns.offset(one.state.values, one.fit.origin)[:count] for one in (fitted, other))
    errors = np.sqrt(np.diag(other.posterior.covariance)[:count])
    return bool((np.abs(np.subtract(*apart)) <= SAME * errors).all())


def searched(unknowns: Unknowns, thetas: Sequence[Theta], clip: np.ndarray, scales: Scales, options: "RefinementOptions"
             ) -> list[Fitted]:
    """The optima that are reached from each of ``thetas`` and ``clip`` (2,), the clips' lengths, to the tolerance ROUGH. Raises
    InputError where no rod is converged and stable at any Θ."""
    rod, steps = unknowns.rod, options.iterations
    straight_first = rod.rolled_together and unknowns.curvature != "none" and all(one.rest_curvature is None for one in thetas)
    model = replace(unknowns, curvature="none") if straight_first else unknowns
    found = _from_thetas(Comparison.of(model, options.frame_weight > 0), thetas, clip, scales, options)
    if rod.turns_unknown and "twist" in model.parameters:
        found = _from_twists(found, scales, steps)
    if rod.rolls_known:
        found = once([*turns_chosen_again(found[0], steps), *found])
    seen = rod.observations
    if rod.rolls_known and seen.total_twist is not None and found[0].state.scales["turn_scatter"] > FAR_OFF:
        unmeasured = replace(rod, observations=replace(seen, total_twist=None))
        found = _ordered(found, searched(replace(unknowns, rod=unmeasured), thetas, clip, scales, options))
    if straight_first:
        begun = curved(found[0], unknowns.curvature)
        fit, state = rolled(begun)
        any_roll = [fit.run(state, steps)]
        same_roll = _kept(begun, min(found[0], *any_roll, key=lambda one: one.rank), steps)
        best = min(found[0], *any_roll, *same_roll, key=lambda one: one.rank)
        free = _swivelling(found[0], best, unknowns.curvature, steps)
        found = _ordered(*([found[:1]] if options.curvature == "auto" else []), any_roll, same_roll, free)
    return found


def _from_thetas(comparison: Comparison, thetas: Sequence[Theta], clip: np.ndarray, scales: Scales,
                 options: "RefinementOptions") -> list[Fitted]:
    unknowns, tried = comparison.unknowns, []
    origin = replace(unknowns.begun(thetas[0], clip), theta=unknowns.expected(thetas[0]))
    fit = Fit(comparison, origin, options.solver, tolerance=ROUGH)
    rolls_free = all((np.asarray(kind) < Clamp.FRAME).all() for kind in (unknowns.rod.held.start, unknowns.rod.held.end))
    for theta in thetas:
        values = unknowns.begun(theta, clip)
        if rolls_free and len(values.curvature) and not values.curvature.any():
            values.curvature[:] = [FIRST_TURN / unknowns.rod.length, 0.0]
        try:
            tried.append(fit.run(fit.begin(values, scales), TRIED_FIRST if len(thetas) > 1 else options.iterations))
        except InputError as error:
            last = error
    if not tried:
        raise last
    return tried if len(thetas) == 1 else _continued(tried, options.iterations)[:1]


def _from_twists(found: list[Fitted], scales: Scales, steps: int) -> list[Fitted]:
    """``found`` with what is reached from the Θ of the best with other twist stiffnesses, once more as long as another Θ is
    better."""
    for _ in range(AGAIN):
        best = found[0]
        tried = [best.fit.run(state, TRIED_FIRST) for state in twisted(best.fit, best.state.values, scales)]
        found = once(sorted([*found, *_continued(tried, steps)], key=lambda one: one.rank))
        if alike(found[0], best):
            break
    return found


def _kept(begun: Curved, best: Fitted, steps: int) -> list[Fitted]:
    """Optima of curved rods that keep their roll; none where these are far behind ``best``."""
    tried = [fit.run(state, TRIED_FIRST) for fit, state in kept(begun)]
    hopeless = behind(min(tried, key=lambda one: one.rank), best) > HOPELESS
    return [] if hopeless else [one for one in _continued(tried, steps) if one.converged]


def _swivelling(straight: Fitted, best: Fitted, curvature: str, steps: int) -> list[Fitted]:
    """Optima of curved rods that roll freely, from the fit of straight ones that do not; none where these are far behind
    ``best``. Those that became straight say nothing that ``straight`` does not."""
    fit, states = swivelling(straight, curvature)
    first = fit.run(next(states), TRIED_FIRST)
    if behind(first, best) > HOPELESS:
        return []
    tried = [one for one in (first, *(fit.run(state, TRIED_FIRST) for state in states)) if bent(one)]
    if not tried or behind(min(tried, key=lambda one: one.rank), best) > NEAR:
        return []
    return [one for one in _continued(tried, steps) if one.converged and bent(one)]


def _continued(tried: list[Fitted], steps: int) -> list[Fitted]:
    """Those of ``tried`` that are near the best, each continued for ``steps``, the best first."""
    tried, found = sorted(tried, key=lambda one: one.rank), []
    for one in tried:
        near = one.counted.sum() == tried[0].counted.sum() and one.value < tried[0].value + NEAR
        if near and not any(alike(one, other) for other in found):
            found.append(one.fit.run(one.state, steps).after(one))
    return once(sorted(found, key=lambda one: one.rank))


def once(optima: Iterable[Fitted]) -> list[Fitted]:
    """Each optimum once."""
    found: list[Fitted] = []
    for one in optima:
        if not any(alike(one, other) for other in found):
            found.append(one)
    return found


def _ordered(first: list[Fitted], *others: list[Fitted]) -> list[Fitted]:
    """All together, those of the most probable kind in front."""
    kinds = [first, *filter(None, others)]
    apart = [0.0, *(behind(kind[0], first[0]) for kind in kinds[1:])]
    return [one for k in np.argsort(apart, kind="stable") for one in kinds[k]]


def lowest_cells(grid: Grid, mean_distance: np.ndarray, count: int) -> np.ndarray:
    """Up to ``count`` local minima of a landscape (G,) over the cells of ``grid``, the lowest first: cells with no lower
    neighbour along any axis. Cells that are NaN count as infinitely high."""
    height = np.nan_to_num(np.asarray(mean_distance, dtype=np.float64), nan=np.inf).reshape(grid.shape)
    around = minimum_filter(height, footprint=generate_binary_structure(height.ndim, 1), mode="nearest")
    cells = np.flatnonzero((height <= around) & np.isfinite(height))
    return cells[np.argsort(height.ravel()[cells], kind="stable")][:count]


def theta_of_cell(grid: Grid, cell: int, up) -> Theta:
    """Θ of a grid's cell."""
    return Theta.of(grid.materials(np.array([cell])), up=up)


# --- whole turns ----------------------------------------------------------------------------------------------------------


def twisted(fit: Fit, values: Values, scales: Scales) -> Iterator[State]:
    """Rods relaxed from their observations at ``values``, with each of several twist stiffnesses, and with the least twist."""
    theta = values.theta
    least = fit.posed(fit.from_marks(replace(values, theta=common_rod(theta), scatter=0 * values.scatter), scales, turn=0))
    if least.used.any():
        yield least
    for ratio in RATIOS:
        twisted = replace(theta, twist=ratio * float(np.diag(theta.bend).mean()))
        with suppress(InputError):  # no rod is stable at that twist stiffness
            yield fit.begin(replace(values, theta=twisted, scatter=0 * values.scatter), scales)


def turns_chosen_again(fitted: Fitted, steps: int) -> list[Fitted]:
    """``fitted``, continued as long as that makes it better. Each time every observation takes the turns that are most probable
    under what was learned: of several, or of those that were measured and those that misfits took instead. All that were
    reached, the best first."""
    fit, reached = fitted.fit, [fitted]
    turns = TURNS if fit.unknowns.rod.turns_unknown else (None,)
    for _ in range(AGAIN):
        state = reached[-1].state
        values = replace(state.values, scatter=0 * state.values.scatter)
        begun = _best_of(fit, [state, *(fit.posed(fit.from_marks(values, state.scales, turn)) for turn in turns)])
        if np.array_equal(begun.values.scatter, state.values.scatter):
            break
        reached.append(fit.run(begun, steps).after(reached[-1]))
        if reached[-1].rank >= reached[-2].rank:
            break
    return sorted(reached, key=lambda one: one.rank)


def _best_of(fit: Fit, states: Sequence[State]) -> State:
    """Of each observation that which is most probable given the others, at the same sizes. What is shared is free to follow to
    first order: it may have adapted to a wrong shape of that observation."""
    best = states[0]
    of_best = own, slope, present = _densities(fit, best)
    used = best.used & np.isfinite(present)
    own, slope = (np.where(used.reshape(-1, *(1,) * (part.ndim - 1)), part, 0.0) for part in (own, slope))
    rest = others(fit.unknowns, own, slope, fit.unknowns.offset(best.values, fit.origin), best.scales)
    least = given(rest, *of_best)
    for other in states[1:]:
        value = given(rest, *_densities(fit, other))
        better = value < least - POSED
        if better.any():
            best, least = fit.merged(best, other, better), np.where(better, value, least)
    return best


def _densities(fit: Fit, state: State) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of each observation B and s, and c + q, of :func:`doo_ti.refinement.evidence.integrated`; that is infinite where the rod
    is not sound."""
    linear, usable = fit.comparison.linear(state.solution, state.values, state.sound, leave_out_soft=False)
    own, slope, squares, constant = integrated(fit.unknowns, linear, state.scales)
    return own, slope, np.where(usable, squares + constant, np.inf)
