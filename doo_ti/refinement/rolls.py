"""Where a fit begins whose rods are curved at rest, held by clips whose roll is not known.

A straight round rod does not say how it was rolled. One that is curved at rest by κ about the first axis of its section, and
rolled by φ_d in observation d, changes the residuals of the straight fit to first order by κ (J₁ cos φ_d + J₂ sin φ_d), J the
derivatives by both components of a uniform rest curvature. So with B_d and s_d of these two (the clamps integrated out), and
u = (cos φ, sin φ), the best rolls for a κ minimise each

    κ² uᵀ B_d u + 2 κ u·s_d,

and the best κ minimises their sum. Without that a fit would begin with rolls that are all wrong, and learn that the rod is
straight, or stiff in torsion.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from doo_ti.refinement.evidence import integrated
from doo_ti.refinement.fit import Fit, Fitted, State
from doo_ti.refinement.priors import Scales
from doo_ti.refinement.turns import chosen_again
from doo_ti.refinement.unknowns import Values

ROLLS = 72
TRIED = 6
"""Rolls of each observation from which a fit begins: the best of these, and of those between."""
AGAIN = 5
"""Steps of each fit before they are compared, without the rods that count in one alone."""
LARGEST, CURVATURES = 4.0, 200
"""κ times the rod's length: the largest that is tried, and how many."""


def rolled(fit: Fit, fitted: Fitted, curvature: str) -> tuple[Fit, State]:
    """The fit with that kind of rest curvature, and where it begins, from a finished fit of straight rods."""
    uniform = replace(fit.comparison, unknowns=replace(fit.unknowns, curvature="uniform"))
    values = replace(fitted.state.values, curvature=np.zeros((1, 2)))
    sound = fitted.state.solution.converged & fitted.state.solution.stable
    linear, used = uniform.linear(fitted.state.solution, values, sound, leave_out_soft=False)
    own = uniform.unknowns.columns("curvature")
    information, slope, _, _ = integrated(uniform.unknowns, linear, fitted.state.scales)
    information, slope = information[:, own[:, None], own], slope[:, own]
    angle = np.linspace(-np.pi, np.pi, ROLLS, endpoint=False)
    u = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    squares, along = np.einsum("ak,dkl,al->da", u, information, u), slope @ u.T
    sizes = np.linspace(0.0, LARGEST, CURVATURES)
    change = np.stack([(size**2 * squares + 2 * size * along)[used].min(axis=1).sum() for size in sizes])
    size = sizes[change.argmin()]
    roll = np.where(used, angle[(size**2 * squares + 2 * size * along).argmin(axis=1)], 0.0)
    unknowns = replace(fit.unknowns, curvature=curvature)
    begun = np.tile([size / unknowns.rod.length, 0.0], (len(unknowns.knots), 1))
    curved = replace(fit, comparison=replace(fit.comparison, unknowns=unknowns))
    scales = fitted.state.scales.learning(unknowns.scale_names)
    return curved, curved.best_of(list(_turned(curved, replace(values, curvature=begun), scales, roll, 0.0)))


def _turned(fit: Fit, values: Values, scales: Scales, roll: np.ndarray, least: float) -> Iterator[State]:
    """All observations rolled by ``roll`` (D,) and, from ``least`` on, by more, with the most probable clamps then."""
    for extra in np.linspace(0.0, 2 * np.pi, TRIED, endpoint=False):
        if extra >= least:
            scatter = values.scatter.copy()
            scatter[:, 0] += (roll + extra + np.pi) % (2 * np.pi) - np.pi
            yield fit.posed(fit.from_marks(replace(values, scatter=scatter), scales))


def rolls_chosen_again(fit: Fit, fitted: Fitted, steps: int) -> Fitted:
    """``fitted``, continued with the rolls that are most probable under what was learned, as long as that helps."""
    return chosen_again(fit, fitted, steps, lambda state: _turned(fit, state.values, state.scales, np.zeros(len(state.used)),
                                                                  np.pi / TRIED))


def more_probable(straight: tuple[Fit, Fitted], curved: tuple[Fit, Fitted]) -> tuple[Fit, Fitted]:
    """The curved fit where the evidence of the rods that count in both is for it, else the straight one."""
    both = straight[1].state.used & curved[1].state.used
    if not both.any():
        return straight
    values = [replace(fit, rods=both).run(replace(fitted.state, used=both), AGAIN).posterior.value
              for fit, fitted in (straight, curved)]
    return curved if values[1] < values[0] else straight
