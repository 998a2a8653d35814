"""Whether the model explains the marks, what it still misses, and which option would tell more.

A model that explains its marks leaves residuals that are noise: of the stated size, if one is stated, and independent from
mark to mark. What it misses shows as displacements of neighbouring marks together (the gap of :mod:`.scales`). Extensions
that the fit did without are tried on the linear model at its end: each is worth by how much it raises the evidence.
"""

from dataclasses import dataclass, replace

import numpy as np

from doo_ti.refinement.evidence import Evidence
from doo_ti.refinement.fit import Fit, Fitted
from doo_ti.refinement.linear_model import Moments
from doo_ti.refinement.unknowns import Unknowns

NOTABLE = 0.5
"""Times the noise: a gap as large as that is worth telling."""
EXCESS = 1.5  # times the stated σ: larger residuals say that it is too small, or the model wrong
WORTH = 6.0
"""−2 ln of the evidence: an extension that lowers it by more is worth trying."""


@dataclass(frozen=True)
class Advice:
    """An extension of the model: the argument that makes it, as ``name=value``, what it is, and by how much it raises twice the
    logarithm of the evidence."""

    option: str
    meaning: str
    gain: float


@dataclass(frozen=True)
class Adequacy:
    """What the residuals say.

    noise          σ in mm: learned, or the mean of what was stated
    stated         whether it was stated
    excess         root mean square residual over σ: near one, or the stated σ or the model is wrong
    gap            mm: root mean square of what the model misses, smooth along the rod
    correlation    of the residuals of neighbouring marks
    advice         extensions worth trying, the best first
    """

    noise: float
    stated: bool
    excess: float
    gap: float
    correlation: float
    advice: tuple[Advice, ...]

    @property
    def reaches_noise(self) -> bool:
        """Nothing but noise is left."""
        return self.gap <= NOTABLE * self.noise and (not self.stated or self.excess <= EXCESS)


def adequacy(fit: Fit, fitted: Fitted) -> Adequacy:
    """The residuals of a fit that has come to its end, examined."""
    state, comparison = fitted.state, fit.comparison
    rows = state.residuals[0][state.used].reshape(int(state.used.sum()), -1, 3)
    counts = comparison.weight[state.used] > 0
    stated = fit.unknowns.rod.observations.sigma is not None
    sigma = state.scales["marks"]
    noise = float(np.mean(fit.unknowns.rod.observations.sigma)) if stated else sigma
    gap = state.scales["gap"] * float(np.sqrt((comparison.gap_modes**2).sum(axis=1).mean()))
    degrees = max(3.0 * counts.sum() - len(fit.unknowns.names), 1.0)
    return Adequacy(noise, stated, float(np.sqrt((rows**2).sum() / degrees) / sigma), gap,
                    _correlation(rows, counts), _advice(fit, fitted))


def _correlation(rows: np.ndarray, counts: np.ndarray) -> float:
    both = counts[:, 1:] & counts[:, :-1]
    crossed = (rows[:, 1:] * rows[:, :-1]).sum(axis=-1)[both]
    sizes = np.sqrt((rows[:, 1:] ** 2).sum(axis=-1)[both].sum() * (rows[:, :-1] ** 2).sum(axis=-1)[both].sum())
    return float(crossed.sum() / sizes) if sizes > 0 else 0.0


def _advice(fit: Fit, fitted: Fitted) -> tuple[Advice, ...]:
    found = []
    for option, meaning, unknowns in _extensions(fit.unknowns):
        gain = fitted.posterior.value - _evidence(fit, fitted, unknowns)
        if gain > WORTH:
            found.append(Advice(option, meaning, gain))
    return tuple(sorted(found, key=lambda one: -one.gain))


def _extensions(unknowns: Unknowns):
    """(argument=value of a refinement, meaning, unknowns) of what the model could have besides."""
    names = unknowns.parameters
    listed = ",".join(name.replace("_", "-") for name in names)
    if "up" not in names:
        yield f"parameters={listed},up", "the direction of gravity", replace(unknowns, parameters=(*names, "up"))
    seen = unknowns.rod.observations
    if "bend" in names and seen.start_frame is not None and seen.end_frame is not None:
        others = tuple(name for name in names if name != "bend")
        ribbon = ("bend_1", "bend_2", "bend_12", *others)
        yield (f"parameters={','.join(name.replace('_', '-') for name in ribbon)}", "a section that is not round",
               replace(unknowns, parameters=ribbon))
    if not unknowns.clips and unknowns.rod.clamped.any():
        yield "clip=unknown", "clips of another length", replace(unknowns, clips=True)
    if unknowns.curvature != "field":
        yield "rest_curvature=field", "rest curvature that varies along the rod", replace(unknowns, curvature="field")
    if not unknowns.clamps:
        yield "clamps=loose", "clamps that are off what was reported", replace(unknowns, clamps=True)


def _evidence(fit: Fit, fitted: Fitted, unknowns: Unknowns) -> float:
    """F of the linear model of ``unknowns`` where ``fitted`` ended, its sizes fitted."""
    values = fitted.state.values
    if len(unknowns.knots) != len(values.curvature):
        mean = values.curvature.mean(axis=0) if len(values.curvature) else np.zeros(2)
        values = replace(values, curvature=np.tile(mean, (len(unknowns.knots), 1)))
    comparison = replace(fit.comparison, unknowns=unknowns)
    linear, _ = comparison.linear(fitted.state.solution, values, fitted.state.used)
    evidence = Evidence(unknowns, tuple(Moments.of(kind) for kind in linear), unknowns.offset(values, fit.origin))
    return evidence.posterior(evidence.best(fitted.state.scales.learning(unknowns.scale_names), 15)).value
