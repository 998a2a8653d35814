"""Which model the observations speak for: leave-one-out predictive scores (§III-E).

Each model is fitted, and each observation predicted from all others; a score is the sum of the logarithms of the probability
densities of what was observed. Models:

    straight        no rest curvature, each clamp in the middle of the outermost edge, as Eq. 2 has it
    curved          with a field of rest curvature
    clips           curved, the clips' lengths unknown
    clamps          clips, and clamps that may be off
    ribbon          clamps, with bend stiffness about m1 and m2 for itself, for ends whose whole frames are held
"""

from dataclasses import dataclass, replace

import numpy as np

from doo_ti.refinement.fit import Fit, Fitted
from doo_ti.refinement.unknowns import Unknowns

STEPS = 10


@dataclass(frozen=True)
class Score:
    """The score of one model beside that of another, over the rods that count in both.

    model       its name
    difference  ln of the odds that it predicts better than the model it stands beside; negative: worse
    error       standard error of the difference
    rods        how many count in both
    """

    model: str
    difference: float
    error: float
    rods: int


def variants(unknowns: Unknowns) -> dict[str, Unknowns]:
    """The models that can stand beside that of ``unknowns``, but for itself."""
    straight = replace(unknowns, curvature="none", clips=False, clamps=False)
    found = {"straight": straight, "curved": replace(straight, curvature="field"),
             "clips": replace(unknowns, curvature="field", clamps=False), "clamps": replace(unknowns, clamps=True)}
    framed = unknowns.rod.observations.start_frame is not None and unknowns.rod.observations.end_frame is not None
    if framed and "bend" in unknowns.parameters:
        others = tuple(name for name in unknowns.parameters if name != "bend")
        found["ribbon"] = replace(unknowns, parameters=("bend_1", "bend_2", *others))
    return {name: model for name, model in found.items() if model != unknowns}


def scores(fit: Fit, fitted: Fitted) -> tuple[Score, ...]:
    """Every variant beside ``fitted``, each from its Θ on."""
    own = fitted.evidence.left_out(fitted.linear, fitted.state.scales)
    found = []
    for name, unknowns in variants(fit.unknowns).items():
        _, other = fitted_variant(fit, fitted, unknowns)
        both = fitted.state.used & other.state.used
        change = (other.evidence.left_out(other.linear, other.state.scales) - own)[both]
        error = np.std(change, ddof=1) * np.sqrt(len(change)) if len(change) > 1 else np.inf
        found.append(Score(name, float(change.sum()), float(error), int(both.sum())))
    return tuple(found)


def fitted_variant(fit: Fit, fitted: Fitted, unknowns: Unknowns, steps: int = STEPS) -> tuple[Fit, Fitted]:
    """The fit of ``unknowns`` to what ``fit`` compares, and where it comes to from the values and sizes of ``fitted``."""
    before = fitted.state.values
    lengths = unknowns.rod.observations.rest_length
    clip = before.clip if unknowns.clips else 0.5 * np.array([lengths[0], lengths[-1]])
    values = replace(
        before, clip=clip, curvature=before.curvature if unknowns.curvature == fit.unknowns.curvature
        else np.zeros((len(unknowns.knots), 2)),
        constant=before.constant * unknowns.clamps, scatter=before.scatter * unknowns.clamps)
    own = Fit(replace(fit.comparison, unknowns=unknowns), replace(fit.origin, clip=clip), fit.solver, fit.rods)
    scales = fitted.state.scales.learning(unknowns.scale_names)
    return own, own.run(own.at(values, scales, fitted.state.solution), steps)
