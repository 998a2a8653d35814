"""Where a fit begins whose rods are curved at rest and roll freely in whatever holds their ends.

Such a rod turns to where it has the least energy: its rest curvature then lies as it is bent, in all observations alike, and
makes it look like a softer straight rod. A fit with rolls that are unknown but held takes each of them for a coincidence.

Axes: D observations.
"""

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from doo_ti.refinement.fit import Fit, Fitted, State
from doo_ti.refinement.priors import NAMES, Scales
from doo_ti.refinement.rolls import expected

BEGUN = (1.0, 0.3, 2.0)
"""The initial rest curvature times the rod's length, the likeliest first."""
SIZE, FACTOR = 1.0, 0.7
"""Prior of the size of the rest curvature, times the rod's length: median, and standard deviation of the logarithm. Far smaller
ones are straight rods, of which there is a fit already: to that this one would shrink, past what fits as well."""
STRAIGHT = 0.1
"""That below which a rod counts as straight: it rolls freely to anywhere, and the held rod of unknown roll contains it."""


def swivelling(fit: Fit, fitted: Fitted, curvature: str) -> tuple[Fit, Iterator[State]]:
    """The fit with ends that roll freely and that kind of rest curvature, and where it may begin, from a finished fit of
    straight rods whose ends are held."""
    rod = replace(fit.unknowns.rod, swivels=True)
    unknowns = replace(fit.unknowns, rod=rod, curvature=curvature)
    free, state = replace(fit, comparison=replace(fit.comparison, unknowns=unknowns)), fitted.state
    values = replace(state.values, scatter=_without_roll(fit, state))
    scales = _of_curved(expected(state.scales, unknowns), rod.length)
    fields = (np.tile([size / rod.length, 0.0], (len(unknowns.knots), 1)) for size in BEGUN)
    return free, (free.posed(free.from_marks(replace(values, curvature=field), scales)) for field in fields)


def _of_curved(scales: Scales, length: float) -> Scales:
    own = np.array(NAMES) == "curvature"
    return replace(scales, typical=np.where(own, SIZE / length, scales.typical), factor=np.where(own, FACTOR, scales.factor))


def bent(fit: Fit, fits: Iterable[Fitted]) -> list[Fitted]:
    """Those of ``fits`` that are not straight."""
    least = STRAIGHT / fit.unknowns.rod.length
    return [one for one in fits if np.sqrt((one.state.values.curvature**2).sum(axis=1).mean()) >= least]


def _without_roll(fit: Fit, state: State) -> np.ndarray:
    """(D, POSE) the errors of the clamps, which point as before but are not rolled."""
    scatter = state.values.scatter.copy()
    for end, (_, frame, _, now) in enumerate(fit.unknowns.rod.ends(fit.unknowns.pose(state.values))):
        tangent = np.einsum("dji,dj->di", frame, now[..., 0])
        axis = np.cross([1.0, 0.0, 0.0], tangent)
        sine = np.linalg.norm(axis, axis=1, keepdims=True)
        angle = np.arctan2(sine, tangent[:, :1])
        scatter[:, 3 * end : 3 * end + 3] = axis * angle / np.maximum(sine, 1e-300)
    return scatter
