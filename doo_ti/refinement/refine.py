"""Beyond the grid: the Θ that observations speak for, and how far they bound it (§III-E).

The model is the rod between its clips (:mod:`.held_rod`), curved at rest (:mod:`.curvature_field`), its clamps a little off
what was reported. What is unknown is Θ, the clips' lengths, the rest curvature and the clamps' errors; how large noise,
curvature and errors are is learned from the same observations (:mod:`.evidence`). Intervals are those of the marginal
likelihood (:mod:`.profile`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from doo_ti.errors import InputError
from doo_ti.io.observations import Observations
from doo_ti.refinement.adequacy import Adequacy, adequacy
from doo_ti.refinement.estimate import Estimate, estimated
from doo_ti.refinement.fit import Fit, Fitted
from doo_ti.refinement.held_rod import POSE, HeldRod
from doo_ti.refinement.mesh_error import mesh_correction, relaxed_on
from doo_ti.refinement.residuals import Comparison
from doo_ti.refinement.scales import typical_scales
from doo_ti.refinement.selection import Score, fitted_variant, scores
from doo_ti.refinement.unknowns import Theta, Unknowns
from doo_ti.relaxation.newton import Newton
from doo_ti.types import Clamp, Clamps, Status

FEWEST_EDGES, MOST_EDGES = 24, 400
TRIED_FIRST = 4
"""Steps from each of several starts before the best of them goes on."""
ASYMPTOTIC = 1.0
"""Times the noise: a larger correction of the mesh is not to be trusted, and the mesh is made twice as fine."""
CORRECTIONS = 2
CLEAR = 6.0
"""−2 ln of the evidence: by so much a simpler model has to be better to be taken."""
FIRST_TURN = 0.3
"""rad, the turn of the whole rod's rest curvature to begin with where all spins are free: with none a rod has no preferred
side, and with next to none it turns wildly."""


@dataclass(frozen=True)
class RefinementOptions:
    """How a fit is made.

    parameters        of Θ, from :data:`doo_ti.refinement.unknowns.PARAMETERS`; the others stay. Bend, twist and weight are
                      determined only up to a common factor, so one of them should stay: weight, as a rule
    clip              length that a clip holds from the outer mark on, mm, both alike; None: unknown
    curvature         rest curvature: "field", "uniform" along the rod, or "none"
    clamps            "loose": they may be off what was reported; "exact"; or "auto": exact where the evidence says so
    frame_weight      w_m of Eq. 1 in mm; where it is positive measured frames count, too
    curvature_spread  standard deviation of the rest curvature, 1/mm; None: learned
    curvature_range   distance over which it is about the same, mm; None: learned
    edges             of the mesh, and no correction for their length; None: as many as the noise asks for, and corrected
    solver            of the relaxations from the observations
    iterations        steps allowed
    intervals         "profile", or "covariance", which takes no time
    models            whether other models are fitted and compared
    """

    parameters: tuple[str, ...] = ("bend", "twist")
    clip: float | None = None
    curvature: str = "field"
    clamps: str = "auto"
    frame_weight: float = 0.0
    curvature_spread: float | None = None
    curvature_range: float | None = None
    edges: int | None = None
    solver: Newton = Newton()
    iterations: int = 60
    intervals: str = "profile"
    models: bool = False


@dataclass(frozen=True)
class Refinement:
    """The most probable Θ and how far to trust it. D observations.

    estimate            Θ, intervals, covariance, clips, regions
    adequacy            what the residuals say about the model
    scores              of other models beside this one, if they were asked for
    marks               (D, M, 3) where the model has the marks, mm; NaN in rods that failed
    mean_squares        (D,) mean square of the marks' residuals, mm² or, where σ was given, over σ²
    distance            (D,) Eq. 1 between marks and model, mm; NaN in rods that failed
    status, stable      (D,) how the relaxations ended
    used                (D,) bool: rods that determined Θ
    misfits             (D,) bool: rods that are converged and stable but far from what was observed
    converged           False where the steps allowed did not do
    steps               tried
    mesh_edges          N
    mesh_error          mm, root mean square of the correction for the length of the mesh's edges; None where it is off
    """

    estimate: Estimate
    adequacy: Adequacy
    scores: tuple[Score, ...]
    marks: np.ndarray
    mean_squares: np.ndarray
    distance: np.ndarray
    status: np.ndarray
    stable: np.ndarray
    used: np.ndarray
    misfits: np.ndarray
    converged: bool
    steps: int
    mesh_edges: int
    mesh_error: float | None

    @property
    def theta(self) -> Theta:
        return self.estimate.theta

    @property
    def mean_distance(self) -> float:
        """Eq. 1, mm: the mean over rods that determined Θ."""
        return float(self.distance[self.used].mean()) if self.used.any() else np.nan

    @property
    def reasons(self) -> dict[str, int]:
        """Why how many rods did not determine Θ."""
        reasons = np.array([kind.name.lower().replace("_", " ") for kind in Status])[self.status]
        sound = self.status == Status.CONVERGED
        reasons = np.where(sound, np.where(self.stable, "far from its marks", "unstable"), reasons)
        names, counts = np.unique(reasons[~self.used], return_counts=True)
        return dict(zip(names.tolist(), counts.tolist(), strict=True))


def refine(observations: Observations, clamps: Clamps, theta: Theta | Sequence[Theta],
           options: RefinementOptions = RefinementOptions()) -> Refinement:
    """The most probable Θ that is reached from ``theta``, or from the best of several.

    Gravity's direction is that of ``theta``. Rods that do not converge, are unstable, infeasible or far from their marks do not
    count; how many there are is in the result. Raises InputError for options that do not fit the observations or each other,
    and where no rod is left.
    """
    thetas = (theta,) if isinstance(theta, Theta) else tuple(theta)
    fit, fitted = _fitted(observations, clamps, thetas, options)
    correction = None
    if options.edges is None:
        fit, fitted, correction = _corrected(fit, fitted, options)
    if options.clamps == "auto":
        fit, fitted = _simpler(fit, fitted)
    found = scores(fit, fitted) if options.models else ()
    return _refinement(fit, fitted, options, correction, found)


def predicted(found: Refinement, observations: Observations, clamps: Clamps, options: RefinementOptions
              ) -> tuple[np.ndarray, np.ndarray]:
    """(D,) Eq. 1 in mm of observations that ``found`` has not seen, each rod relaxed from its observation, and which of them
    (D,) are converged and stable. What the clamps are off in one observation is unknown there, and taken as none."""
    rod = HeldRod(observations, clamps, 2 * found.mesh_edges if found.mesh_error is not None else found.mesh_edges)
    unknowns = Unknowns(rod, tuple(options.parameters), options.clip is None, options.curvature, options.clamps != "exact")
    values = replace(found.estimate.values, scatter=np.zeros((observations.count, POSE)))
    solution = rod.relaxed(unknowns.material(values), values.clip, unknowns.pose(values), options.solver, values.theta.up)
    frames = rod.directors(solution, values.clip) if options.frame_weight > 0 else None
    return (mark_distance(rod.marks(solution, values.clip), observations, frames, options.frame_weight),
            solution.converged & solution.stable)


def _fitted(observations: Observations, clamps: Clamps, thetas: tuple[Theta, ...], options: RefinementOptions):
    """The fit on its first mesh, and where it came to from the best of ``thetas``."""
    check(observations, options)
    edges = options.edges or int(np.clip(2 * observations.edges, FEWEST_EDGES, MOST_EDGES))
    rod = HeldRod(observations, clamps, edges)
    unknowns = Unknowns(rod, tuple(options.parameters), options.clip is None, options.curvature, options.clamps != "exact")
    scales = _scales(unknowns, options)
    comparison = Comparison.of(unknowns, options.frame_weight > 0)
    clip = unknowns.clip_prior if options.clip is None else np.full(2, options.clip)
    tried = []
    for theta in thetas:
        values = unknowns.begun(theta, clip)
        if _spins(clamps) and not values.curvature.any():
            values.curvature[:] = [FIRST_TURN / rod.length, 0.0]
        fit = Fit(comparison, replace(values, theta=thetas[0]), options.solver)
        try:
            state = fit.begin(values, scales)
        except InputError as error:
            if len(thetas) == 1:
                raise
            last = error
            continue
        tried.append((fit, fit.run(state, TRIED_FIRST if len(thetas) > 1 else options.iterations)))
    if not tried:
        raise last
    fit, fitted = min(tried, key=lambda one: (-one[1].state.used.sum(), one[1].posterior.value))
    if len(thetas) > 1:
        further = fit.run(fitted.state, options.iterations)
        fitted = replace(further, steps=further.steps + fitted.steps)
    return fit, fitted


def _spins(clamps: Clamps) -> bool:
    """Whether every rod may spin about itself at both ends."""
    return bool(np.all((np.asarray(clamps.start) < Clamp.FRAME) & (np.asarray(clamps.end) < Clamp.FRAME)))


def _corrected(fit: Fit, fitted: Fitted, options: RefinementOptions):
    """The fit with its mesh corrected, made finer before where the correction is too large."""
    for _ in range(CORRECTIONS):
        values, solution = fitted.state.values, fitted.state.solution
        correction = mesh_correction(fit.unknowns, values, solution, fit.solver)
        size = _root_mean_square(correction[fitted.state.used])
        noise = fitted.state.scales["marks"] * (1.0 if fit.unknowns.rod.observations.sigma is None
                                                else float(np.mean(fit.unknowns.rod.observations.sigma)))
        edges = fit.unknowns.rod.edges
        if size > ASYMPTOTIC * noise and 2 * edges <= MOST_EDGES:
            finer = replace(fit.unknowns, rod=replace(fit.unknowns.rod, edges=2 * edges))
            solution = relaxed_on(finer, values, solution, fit.unknowns.rod, fit.solver)
            fit = replace(fit, comparison=replace(fit.comparison, unknowns=finer, correction=0.0))
            correction = mesh_correction(finer, values, solution, fit.solver)
        fit = replace(fit, comparison=replace(fit.comparison, correction=correction))
        further = fit.run(fit.at(values, fitted.state.scales, solution), options.iterations)
        fitted = replace(further, steps=further.steps + fitted.steps)
    return fit, fitted, correction


def _simpler(fit: Fit, fitted: Fitted) -> tuple[Fit, Fitted]:
    """The model whose clamps are exact, where the evidence of the same rods speaks for it; else what is given."""
    exact = replace(fit, rods=fitted.state.used)
    exact, found = fitted_variant(exact, fitted, replace(fit.unknowns, clamps=False))
    same = found.state.used.sum() == fitted.state.used.sum()
    if not (same and found.converged and found.posterior.value < fitted.posterior.value - CLEAR):
        return fit, fitted
    return replace(exact, rods=None), replace(found, steps=found.steps + fitted.steps)


def check(observations: Observations, options: RefinementOptions) -> None:
    """Raise InputError for options that do not fit the observations or each other."""
    if options.frame_weight > 0 and observations.frames is None:
        raise InputError(observations.source, "frames", "missing, but a frame weight is given", "use a frame weight of zero")
    if options.clip is not None and not 0 < options.clip < 0.25 * observations.rest_length.sum():
        raise InputError(observations.source, "clip", f"{options.clip:g} mm of a rod of {observations.rest_length.sum():g} mm",
                         "give a positive length below a quarter of the rod's")
    for name, value, known in (("curvature", options.curvature, ("field", "uniform", "none")),
                               ("clamps", options.clamps, ("auto", "loose", "exact")),
                               ("intervals", options.intervals, ("profile", "covariance"))):
        if value not in known:
            raise InputError("refine", name, f"{value!r} is unknown", f"give one of {', '.join(known)}")
    if options.edges is not None and not 6 <= options.edges <= 4 * MOST_EDGES:
        raise InputError("refine", "edges", f"{options.edges}", f"give 6 to {4 * MOST_EDGES}")


def _scales(unknowns: Unknowns, options: RefinementOptions):
    seen = unknowns.rod.observations
    learned, fixed = {"gap"}, {}
    if seen.sigma is None:
        learned.add("marks")
    else:
        fixed["marks"] = 1.0
    if options.frame_weight > 0:
        learned.add("frames")
    for name, value in (("curvature", options.curvature_spread), ("range", options.curvature_range)):
        if value is not None:
            fixed[name] = value
    learned |= unknowns.scale_names - set(fixed)
    return typical_scales(unknowns.rod.length, float(np.median(seen.rest_length)), learned, fixed)


def _refinement(fit: Fit, fitted: Fitted, options: RefinementOptions, correction, found: tuple[Score, ...]) -> Refinement:
    state, rod = fitted.state, fit.unknowns.rod
    sound = state.solution.converged & state.solution.stable
    marks = rod.marks(state.solution, state.values.clip) + fit.comparison.correction
    marks = np.where(sound[:, None, None], marks, np.nan)
    frames = rod.directors(state.solution, state.values.clip) if options.frame_weight > 0 else None
    return Refinement(
        estimate=estimated(fit, fitted, profiled=options.intervals == "profile"), adequacy=adequacy(fit, fitted), scores=found,
        marks=marks, mean_squares=fit.mean_squares(state.residuals), distance=mark_distance(marks, rod.observations, frames,
                                                                                          options.frame_weight),
        status=state.solution.status, stable=state.solution.stable, used=state.used, misfits=sound & ~state.used,
        converged=fitted.converged, steps=fitted.steps, mesh_edges=rod.edges,
        mesh_error=None if correction is None else _root_mean_square(correction[state.used]))


def mark_distance(marks: np.ndarray, observations: Observations, directors: np.ndarray | None = None,
                  frame_weight: float = 0.0) -> np.ndarray:
    """(D,) Eq. 1 in mm between ``marks`` (D, M, 3), and m1 half-way between them, and what was observed."""
    valid = observations.valid
    apart = np.linalg.norm(np.where(valid[..., None], marks - np.nan_to_num(observations.vertices), 0.0), axis=-1)
    total = apart.sum(axis=1) / (valid.sum(axis=1) - 1)
    if directors is not None:
        turned = np.linalg.norm(directors - observations.frames[..., 1], axis=-1)
        total = total + frame_weight * turned.sum(axis=1) / (observations.edges - 1)
    return total


def _root_mean_square(values: np.ndarray) -> float:
    return float(np.sqrt((values**2).mean())) if values.size else 0.0
