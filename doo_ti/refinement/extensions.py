"""What a model may lack: extensions, rated on the linear model at the end of the fit by the rise of the evidence (§III-E).

Bend stiffness that varies along the rod is fitted at once where the marks are for it: a uniform rod would be too stiff or too
soft by as much as it varies, with an interval that is too narrow.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from doo_ti.refinement.evidence import Evidence
from doo_ti.refinement.fit import Fit, Fitted
from doo_ti.refinement.rolls import most_probable
from doo_ti.refinement.search import Optimum
from doo_ti.refinement.unknowns import Unknowns

WORTH = 6.0  # −2 ln of the evidence: an extension that lowers it by more is worth trying
STEPS = 15  # of the search for the sizes
UNROUND = "a section that is not round"


@dataclass(frozen=True)
class Advice:
    """An extension of the model: the argument for it, as ``name=value``, its meaning, and by how much it raises twice the
    logarithm of the evidence."""

    option: str
    meaning: str
    gain: float


def advice(fit: Fit, fitted: Fitted) -> tuple[Advice, ...]:
    """Extensions of a finished fit that are worth trying, the best first."""
    found = (Advice(option, meaning, _gain(fit, fitted, unknowns)) for option, meaning, unknowns in _extensions(fit.unknowns))
    return tuple(sorted((one for one in found if one.gain > WORTH), key=lambda one: -one.gain))


def _extensions(unknowns: Unknowns) -> Iterator[tuple[str, str, Unknowns]]:
    """(option, meaning, unknowns) of each extension."""
    names, rod = unknowns.parameters, unknowns.rod

    def learning(meaning: str, *parameters: str, **more):
        return f"parameters={','.join(parameters).replace('_', '-')}", meaning, replace(unknowns, parameters=parameters, **more)

    if "up" not in names and rod.loads is None:
        yield learning("the direction of gravity", *names, "up")
    if "bend" in names and held_by_frames(unknowns):
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


def held_by_frames(unknowns: Unknowns) -> bool:
    """Whether both ends' frames were reported: only then do observations separate bending about m1 from bending about m2."""
    seen = unknowns.rod.observations
    return seen.start_frame is not None and seen.end_frame is not None


def _gain(fit: Fit, fitted: Fitted, unknowns: Unknowns) -> float:
    """By how much −2 ln of the evidence is lower for ``unknowns``, in the linear model at the end of ``fitted``, its sizes
    fitted."""
    values = fitted.state.values
    if len(unknowns.knots) != len(values.curvature):
        mean = values.curvature.mean(axis=0) if len(values.curvature) else np.zeros(2)
        values = replace(values, curvature=np.tile(mean, (len(unknowns.knots), 1)))
    if len(unknowns.stiffness_knots) != len(values.stiffness):
        values = replace(values, stiffness=np.zeros(len(unknowns.stiffness_knots)))
    comparison = replace(fit.comparison, unknowns=unknowns)
    linear, _ = comparison.linear(fitted.state.solution, values, fitted.state.used)
    evidence = Evidence.of(unknowns, linear, unknowns.offset(values, fit.origin))
    scales = evidence.best(fitted.state.scales.learning(unknowns.scale_names), STEPS)
    return fitted.posterior.value - evidence.posterior(scales).value


def with_stiffness_along(found: list[Optimum], steps: int, stiffness: str) -> list[Optimum]:
    """The optima ``found``, the best first, or these with a bend stiffness that varies along the rod, each continued for
    ``steps``: as ``stiffness`` of :class:`.RefinementOptions` says."""
    fit, fitted = most_probable(found[0].fit, found[0].fitted)
    if stiffness == "uniform" or not fit.unknowns.round:
        return found
    if stiffness == "auto" and _gain(fit, fitted, replace(fit.unknowns, uneven=True)) <= WORTH:
        return found
    uneven = sorted((_continued(one, steps) for one in found), key=lambda one: one.fitted.rank)
    return uneven if stiffness == "field" or uneven[0].behind(Optimum(fit, fitted)) < -WORTH else found


def _continued(found: Optimum, steps: int) -> Optimum:
    """The optimum with a stiffness that varies along the rod, one row for each observation."""
    fit, fitted = most_probable(found.fit, found.fitted)
    unknowns = replace(fit.unknowns, uneven=True)
    fit = replace(fit, comparison=replace(fit.comparison, unknowns=unknowns))
    state, none = fitted.state, np.zeros(len(unknowns.stiffness_knots))
    begun = fit.at(replace(state.values, stiffness=none), state.scales.learning(unknowns.scale_names), state.solution)
    return Optimum(fit, fit.run(replace(begun, used=state.used & begun.sound), steps).after(fitted))
