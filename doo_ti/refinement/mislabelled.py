"""Misfits whose marks are in the wrong order, or have one wrong mark, told apart from rods that the model does not explain.

A misfit is tried with its marks in reverse order, with two of them swapped, and without one of them: relaxed at the Θ of the
others, and posed as they are. Where one of these fits as the others do, the misfit is named for it; it stays left out.
"""

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from doo_ti.refinement.fit import EXACT, ODD, Fit, Fitted, State
from doo_ti.refinement.held_rod import POSE
from doo_ti.refinement.residuals import Comparison
from doo_ti.rod.observations import Observations
from doo_ti.rod.start import observation_clamps, reachable
from doo_ti.rod.types import Clamp

MOST = 8
"""Misfits that are tried, the first of them."""
POSED = 12
"""Orders of each misfit with all its marks that are posed, and as many without one: those nearest to their marks before."""
FEWEST = 5
"""Marks, without one of which a rod may be tried."""


@dataclass(frozen=True)
class Mislabelled:
    """An observation that fits as the others do once its marks are put right.

    observation  its row
    marks        none: all in reverse order; two: swapped; one: it is somewhere else
    """

    observation: int
    marks: tuple[int, ...]

    @property
    def text(self) -> str:
        """What is wrong, in words."""
        if not self.marks:
            return "its marks are in reverse order"
        if len(self.marks) == 1:
            return f"mark {self.marks[0]}, counted from 0, is not where the others say"
        return f"marks {self.marks[0]} and {self.marks[1]}, counted from 0, are swapped"


def mislabelled(fit: Fit, fitted: Fitted) -> tuple[Mislabelled, ...]:
    """Those among the first MOST misfits of a finished fit."""
    state = fitted.state
    misfits = np.flatnonzero(~state.used & (fit.comparison.count > 0))[:MOST]
    if fit.rods is not None or not state.used.any() or not len(misfits):
        return ()
    usual = ODD * max(np.median(fit.mean_squares(state.residuals)[state.used]), EXACT)
    best = (_best_order(fit, fitted, int(row), usual) for row in misfits)
    return tuple(one for one in best if one is not None)


def _best_order(fit: Fit, fitted: Fitted, row: int, usual: float) -> Mislabelled | None:
    """Of the orders of the marks of observation ``row`` that with the least mean square, below ``usual``: one with all marks
    where there is any."""
    state, rod = fitted.state, fit.unknowns.rod
    orders, seen = _orders(rod.observations, row)
    kinds = [Clamp(int(np.max(kind))) for kind in (rod.clamps.start, rod.clamps.end)]
    within = np.flatnonzero(reachable(seen, observation_clamps(seen, *kinds), rod.exact))
    without_one = np.array([len(orders[order]) == 1 for order in within], dtype=bool)

    def begun(rows: np.ndarray):
        own = seen.take(rows)
        held = replace(rod, observations=own, rolled=None, clamps=observation_clamps(own, *kinds),
                       surroundings=rod.surroundings.take(np.full(len(rows), row)),
                       loads=None if rod.loads is None else rod.loads[np.full(len(rows), row)])
        unknowns = replace(fit.unknowns, rod=held)
        correction = fit.comparison.correction
        correction = correction if np.ndim(correction) == 0 else correction[np.full(len(rows), row)]
        comparison = replace(Comparison.of(unknowns, fit.comparison.directors is not None), correction=correction)
        among = replace(fit, comparison=comparison)
        values = replace(state.values, scatter=np.zeros((len(rows), POSE)))
        return among, among.from_marks(values, state.scales)

    def squares(one: Fit, now: State) -> np.ndarray:
        return np.where(now.solution.converged & now.solution.stable, one.mean_squares(now.residuals), np.inf)

    for kind in (within[~without_one], within[without_one]):
        if len(kind):
            nearest = kind[np.argsort(squares(*begun(kind)), kind="stable")[:POSED]]
            among, now = begun(nearest)
            apart = squares(among, among.posed(now))
            if apart.min() <= usual:
                return Mislabelled(row, orders[nearest[apart.argmin()]])
    return None


def _orders(seen: Observations, row: int) -> tuple[list[tuple[int, ...]], Observations]:
    """The marks that each order changes, as :class:`Mislabelled` has them, and the observations so changed."""
    there = np.flatnonzero(seen.valid[row]).tolist()
    orders = [(), *combinations(there, 2), *(((mark,) for mark in there) if len(there) > FEWEST else ())]
    vertices = np.repeat(seen.vertices[row : row + 1], len(orders), axis=0)
    vertices[0] = vertices[0, ::-1]
    for number, marks in enumerate(orders):  # of one rod's marks
        if len(marks) == 2:
            vertices[number, list(marks)] = vertices[number, list(marks[::-1])]
        elif marks:
            vertices[number, marks] = np.nan
    changed = seen.take(np.full(len(orders), row))
    return orders, replace(changed, vertices=vertices, valid=np.isfinite(vertices).all(axis=-1))
