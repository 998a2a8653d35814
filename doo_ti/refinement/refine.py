"""Θ of observed rods by maximum a posteriori, and its uncertainty, without a grid (§III-E).

The model is the rod between its clips (:mod:`doo_ti.refinement.held_rod`), curved at rest, with clamps slightly off their
reported poses. Unknown are Θ, the clips' lengths, the rest curvature and the clamps' errors; the sizes of noise, curvature and
errors (:mod:`doo_ti.refinement.theta`) are learned from the same observations (:mod:`doo_ti.refinement.evidence`).

A discrete rod clamped in the middle of an edge differs from the continuum by h² to leading order. So with marks x_h and x_k on
meshes of edges h and k < h,

    x_0 ≈ x_h + (x_k − x_h) h²/(h² − k²);

the second term (Richardson's extrapolation), computed once at the end of a fit and then kept, makes a repeated fit one of the
continuum up to h⁴.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from doo_ti.contact.surroundings import Surroundings
from doo_ti.refinement.adequacy import Adequacy, Mislabelled, Score, adequacy, mislabelled, scores, with_stiffness_along
from doo_ti.refinement.estimate import Estimate, estimated, within_reach
from doo_ti.refinement.fit import FINE, Fitted
from doo_ti.refinement.held_rod import HeldRod
from doo_ti.refinement.rolls import bent, most_probable
from doo_ti.refinement.search import once, searched, turns_chosen_again
from doo_ti.refinement.theta import NAMES, Scales, Theta, typical_scales
from doo_ti.refinement.unknowns import Unknowns, Values
from doo_ti.relaxation.contact_table import require_clear
from doo_ti.relaxation.newton import Newton
from doo_ti.rod.frames import of_like_signs, unit_vectors
from doo_ti.rod.observations import Observations
from doo_ti.rod.start import start_configuration, turn_hypotheses
from doo_ti.rod.types import Clamps, Solution, Status
from doo_ti.system.arguments import short_repr, typed
from doo_ti.system.errors import InputError

FEWEST_EDGES, MOST_EDGES = 24, 400
PER_LAYER, MOST_FOR_LAYERS = 2.0, 64
"""Edges of the first mesh in the length over which a rod bends beside a clamp, and how many at most for their sake: the first Θ
may be far too soft."""
ASYMPTOTIC = 1.0  # times the noise: a larger correction of the mesh is not reliable, and the mesh is made twice as fine
CORRECTIONS = 2
MARGIN = 10.0  # −2 ln of the evidence by which the correction of the mesh may change which optimum is the best


@typed
@dataclass(frozen=True)
class RefinementOptions:
    """Options of a fit.

    parameters        learned parameters of Θ, from :data:`doo_ti.refinement.unknowns.PARAMETERS`; the others are fixed. Bend,
                      twist and weight are determined only up to a common factor, so one of them should be fixed: usually
                      weight
    clip              length that a clip holds from the outer mark on, mm, the same at both ends; 0: it ends at that
                      mark; None: unknown
    curvature         rest curvature: "field", "uniform" along the rod, "none", or "auto": a field, but none where the rolls of
                      both ends are unknown and the evidence is for straight rods
    stiffness         bend stiffness along a round rod: "uniform", "field", or "auto": a field where the evidence is for it
    clamps            "loose": reported frames may be off, positions are those of marks with noise, and what is not reported is
                      unknown in each observation; or "exact": all as reported, and as the outer marks say
    frame_error       standard deviations of a reported frame's place over the outer mark's, mm, and of its direction in each
                      observation, rad; None: learned
    frame_weight      w_m of Eq. 1 in mm; where it is positive measured frames are compared too
    edges             of the mesh, without correction for their length; None: as many as the noise requires, corrected
    solver            of the relaxations from the observations
    iterations        largest number of steps
    intervals         "profile", or "covariance", which takes no extra time
    models            whether other models are fitted and compared
    surroundings      what the rods touch, without friction; with one row for all observations or one for each
    twist_follows     whether a twist stiffness that is not learned stays in proportion to the bend stiffness, not as it is
    loads             (D, M) weights of bodies that hang at the marks, as those of :class:`.PointLoads`; None: nothing hangs
                      there. Where they are known the weight of the rod can be learned beside its stiffness
    """

    __repr__ = short_repr

    parameters: tuple[str, ...] = ("bend", "twist")
    clip: float | None = None
    curvature: str = "auto"
    stiffness: str = "auto"
    clamps: str = "loose"
    frame_error: tuple[float, float] | None = None
    frame_weight: float = 0.0
    edges: int | None = None
    solver: Newton = Newton()
    iterations: int = 60
    intervals: str = "profile"
    models: bool = False
    surroundings: Surroundings = Surroundings()
    loads: np.ndarray | None = None
    twist_follows: bool = False


@dataclass(frozen=True)
class Refinement:
    """The most probable Θ and its uncertainty. D observations.

    estimate            Θ, intervals, covariance, clips, regions
    adequacy            what the residuals say about the model
    scores              of other models, if these were fitted
    marks               (D, M, 3) places of the marks in the model, mm; NaN in rods that failed
    mean_squares        (D,) mean square of the marks' residuals, mm² or, where σ was given, over σ²
    distance            (D,) Eq. 1 between marks and model, mm; NaN in rods that failed
    status, stable      (D,) how the relaxations ended
    used                (D,) bool: rods that determined Θ
    misfits             (D,) bool: rods that are converged and stable but far from their marks
    mislabelled         those left out that fit as the others do with their marks in another order, or without one of them
    converged, steps    False where the allowed steps did not suffice; and how many were tried
    swivels             whether rods that roll freely in what holds them fit best: their rest curvature lies as they are bent
    roll_kept           rad by which rolls differ between observations where one roll for all fits best; else None
    turns_ignored       whether measured whole turns (``total_twist``) were left out, since others fit better
    mesh_edges          N
    mesh_error          mm, root mean square of the correction for the length of the mesh's edges; None without correction
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
    mislabelled: tuple[Mislabelled, ...]
    converged: bool
    steps: int
    swivels: bool
    roll_kept: float | None
    turns_ignored: bool
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
        """Reason: number of rods that for this reason did not determine Θ."""
        reasons = np.array([kind.name.lower().replace("_", " ") for kind in Status])[self.status]
        sound = self.status == Status.CONVERGED
        near = np.where(self.misfits, "far from its marks", "about to snap")
        reasons = np.where(sound, np.where(self.stable, near, "unstable"), reasons)
        names, counts = np.unique(reasons[~self.used], return_counts=True)
        return dict(zip(names.tolist(), counts.tolist(), strict=True))


@typed
def refine(observations: Observations, clamps: Clamps, theta: Theta | Sequence[Theta],
           options: RefinementOptions = RefinementOptions()) -> Refinement:
    """Fit Θ and the other unknowns of the experiment to ``observations`` (maximum a posteriori), with 95 % intervals.

    clamps  reported clamps of the observations
    theta   Θ and direction of gravity at the start of the fit; of several starts the best is continued

    Rods that do not converge, are unstable, infeasible or far from their marks are left out; their number is in the result.
    Raises InputError for options that do not fit the observations or each other, for rods inside obstacles, and where no rod is
    left.
    """
    thetas = (theta,) if isinstance(theta, Theta) else tuple(theta)
    found = _at_their_ends(optima(observations, clamps, thetas, options), options)
    best, *rivals = once(within_reach(with_stiffness_along(found, options.iterations, options.stiffness)))
    return _refinement(best, rivals, options, observations.total_twist is not None)


def _at_their_ends(found: list[Fitted], options: RefinementOptions) -> list[Fitted]:
    """The best of the optima and those near to it, to the tolerance FINE.

    Not while there are others: those that lose rods on the way, which are about to snap there, and rods that roll freely and
    have become straight, which roll to anywhere. The derivatives of both mean little, and so does their evidence."""
    to_its_end, lost = _corrected if options.edges is None else finished, []
    while found:
        near = within_reach(found, MARGIN)
        ended = [to_its_end(one, options) for one in near]
        kept = [now for before, now in zip(near, ended, strict=True) if now.counted.sum() >= before.counted.sum()
                and (not now.fit.unknowns.rod.swivels or bent(now))]
        if kept:
            return kept
        lost += ended
        found = [one for one in found if not any(one is other for other in near)]
    return within_reach(sorted(lost, key=lambda one: one.rank))


def unknowns_of(rod: HeldRod, options: RefinementOptions) -> Unknowns:
    """The unknowns of a fit to ``rod``."""
    curvature = "field" if options.curvature == "auto" else options.curvature
    return Unknowns(rod, tuple(options.parameters), options.clip is None, curvature, options.twist_follows)


def optima(observations: Observations, clamps: Clamps, thetas: tuple[Theta, ...], options: RefinementOptions) -> list[Fitted]:
    """The optima of the fit on its first mesh, the best first."""
    check(observations, clamps, options)
    edges = options.edges or first_edges(observations, thetas[0])
    rod = HeldRod(observations, clamps, edges, options.surroundings, options.clamps == "exact", loads=options.loads)
    unknowns = unknowns_of(rod, options)
    clip = rod.clip_in_reach(unknowns.clip_prior) if options.clip is None else np.full(2, options.clip)
    return searched(unknowns, thetas, clip, _scales(unknowns, options), options)


def first_edges(observations: Observations, theta: Theta) -> int:
    """As many as the marks need, and the bends beside clamps, √(EI/T) long, T half the rod's weight: on a coarser mesh the
    wrong one of several optima may fit better."""
    length = observations.length
    layers = length * np.sqrt(2.0 * theta.weight * length / float(np.trace(theta.bend)))  # EI/w is α/(2 μ)
    wanted = max(2 * observations.edges, min(np.ceil(PER_LAYER * layers), MOST_FOR_LAYERS))
    return int(np.clip(wanted, FEWEST_EDGES, MOST_EDGES))


def check(observations: Observations, clamps: Clamps, options: RefinementOptions) -> None:
    """Raise InputError for options that do not fit the observations or each other, and for rods inside obstacles."""
    observations.require_frames(options.frame_weight)
    if options.clip is not None and not 0 <= options.clip < 0.25 * observations.length:
        raise InputError(observations.source, "clip", f"{options.clip:g} mm of a rod of {observations.length:g} mm",
                         "give a length from zero up, below a quarter of the rod's")
    for name, value, known in (("curvature", options.curvature, ("auto", "field", "uniform", "none")),
                               ("stiffness", options.stiffness, ("auto", "uniform", "field")),
                               ("clamps", options.clamps, ("loose", "exact")),
                               ("intervals", options.intervals, ("profile", "covariance"))):
        if value not in known:
            raise InputError("refine", name, f"{value!r} is unknown", f"give one of {', '.join(known)}")
    if options.frame_error is not None:
        if options.clamps == "exact":
            raise InputError("refine", "frame_error", "given beside exact clamps", "give one of them")
        if len(options.frame_error) != 2 or not all(0 < error < np.inf for error in options.frame_error):
            raise InputError("refine", "frame_error", f"{options.frame_error}", "give two positive numbers, mm and rad")
        if observations.start_frame is None and observations.end_frame is None and observations.frames is None:
            raise InputError(observations.source, "start_frame", "missing, but an error of frames is given", "leave it out")
    if options.stiffness == "field" and any(name.startswith("bend_") for name in options.parameters):
        raise InputError("refine", "stiffness", "a field, of a rod that is not round", "learn bend, or give uniform")
    if options.edges is not None and not 6 <= options.edges <= 4 * MOST_EDGES:
        raise InputError("refine", "edges", f"{options.edges}", f"give 6 to {4 * MOST_EDGES}")
    if options.loads is not None:
        if np.shape(options.loads) != observations.valid.shape or not np.min(options.loads) >= 0:
            raise InputError("refine", "loads", f"shape {np.shape(options.loads)}, or negative",
                             f"give {observations.valid.shape}, of zero or more")
        if "up" in options.parameters:
            raise InputError("refine", "parameters", "up, of rods with bodies at their marks", "leave it out")
    if options.surroundings:
        index, turns = turn_hypotheses(observations, clamps)
        held = clamps.take(index)
        starts = start_configuration(observations.take(index), held, turns)
        require_clear(observations.source, options.surroundings.take(index), held, starts, index)


def _scales(unknowns: Unknowns, options: RefinementOptions) -> Scales:
    seen = unknowns.rod.observations
    learned = {"gap", "marks"} | ({"frames"} if options.frame_weight > 0 else set()) | unknowns.scale_names
    fixed = {} if seen.sigma is None else {"marks": 1.0}
    if options.frame_error is not None:
        place, turn = options.frame_error
        fixed |= {"any_shift": place, "turn": turn, "turn_scatter": turn}
    return typical_scales(unknowns.rod.length, float(np.median(seen.rest_length)), learned - set(fixed), fixed)


def _refinement(best: Fitted, rivals: list[Fitted], options: RefinementOptions, measured_turns: bool) -> Refinement:
    fitted = most_probable(best)
    fit, state, rod, correction = fitted.fit, fitted.state, fitted.fit.unknowns.rod, fitted.fit.comparison.correction
    sound = state.sound
    lengths = fit.unknowns.lengths(state.values)
    marks = rod.marks(state.solution, lengths) + correction
    marks = np.where(sound[:, None, None], marks, np.nan)
    estimate = estimated(best, rivals, profiled=options.intervals == "profile")
    return Refinement(
        estimate=replace(estimate, values=state.values), adequacy=adequacy(fitted),
        scores=scores(fitted) if options.models else (), marks=marks, mean_squares=fit.mean_squares(state.residuals),
        distance=rod.distance(marks, state.solution, lengths, options.frame_weight),
        status=state.solution.status, stable=state.solution.stable, used=state.used, converged=fitted.converged,
        misfits=sound & ~state.used & fit.far(state), mislabelled=mislabelled(fitted), steps=fitted.steps,
        swivels=rod.swivels, roll_kept=state.scales["any_roll"] if state.scales.learned[NAMES.index("any_roll")] else None,
        turns_ignored=rod.observations.total_twist is None and measured_turns, mesh_edges=rod.edges,
        mesh_error=_root_mean_square(correction[state.used]) if options.edges is None else None)


def finished(found: Fitted, options: RefinementOptions) -> Fitted:
    """The optimum to the tolerance FINE, from where the search has left it."""
    return replace(found.fit, tolerance=FINE).run(found.state, options.iterations).after(found)


def _root_mean_square(values: np.ndarray) -> float:
    return float(np.sqrt((values**2).mean())) if values.size else 0.0


# --- the error of the mesh ------------------------------------------------------------------------------------------------


def _corrected(fitted: Fitted, options: RefinementOptions) -> Fitted:
    """The fit repeated with the correction of its mesh, on a mesh twice as fine where the correction is too large."""
    fit = replace(fitted.fit, tolerance=FINE)
    for _ in range(CORRECTIONS):
        values, solution, unknowns = fitted.state.values, fitted.state.solution, fit.unknowns
        rod, sigma = unknowns.rod, unknowns.rod.observations.sigma
        correction = mesh_correction(unknowns, values, solution, fit.solver)
        noise = fitted.state.scales["marks"] * (1.0 if sigma is None else float(np.nanmean(sigma)))
        if _root_mean_square(correction[fitted.state.used]) > ASYMPTOTIC * noise and 2 * rod.edges <= MOST_EDGES:
            unknowns = replace(unknowns, rod=replace(rod, edges=2 * rod.edges))
            solution = relaxed_on(unknowns, values, solution, rod, fit.solver)
            correction = mesh_correction(unknowns, values, solution, fit.solver)
        fit = replace(fit, comparison=replace(fit.comparison, unknowns=unknowns, correction=correction))
        fitted = fit.run(fit.at(values, fitted.state.scales, solution), options.iterations).after(fitted)
    if fit.unknowns.rod.turns_unknown:  # a misfit of the first mesh may have taken another turn
        fitted = turns_chosen_again(fitted, options.iterations)[0]
    return fitted


def mesh_correction(unknowns: Unknowns, values: Values, solution: Solution, solver: Newton) -> np.ndarray:
    """(D, M, 3) the second term of the formula above, mm; zero for rods that are on another branch on a mesh twice as fine."""
    coarse = unknowns.rod
    finer = replace(unknowns, rod=replace(coarse, edges=2 * coarse.edges - 1))
    fine = relaxed_on(finer, values, solution, coarse, solver)
    lengths = unknowns.lengths(values)
    h, k = (rod.mesh(lengths).edge for rod in (coarse, finer.rod))
    change = finer.rod.marks(fine, lengths) - coarse.marks(solution, lengths)
    sound = solution.converged & solution.stable & fine.converged & fine.stable
    sound &= np.abs(np.nan_to_num(change, nan=np.inf)).max(axis=(1, 2)) < h
    return np.where(sound[:, None, None], change, 0.0) * h**2 / (h**2 - k**2)


def relaxed_on(unknowns: Unknowns, values: Values, solution: Solution, before: HeldRod, solver: Newton) -> Solution:
    """F on the mesh of ``unknowns``, starting from ``solution``, which is on the mesh of ``before``."""
    rods, lengths = solution.configuration, unknowns.lengths(values)
    weights = before.mesh(lengths).at_edges(unknowns.rod.mesh(lengths).middles)[0]
    # Of like signs, so that weighted means of them are frames between.
    between = unit_vectors(np.einsum("xe,rek->rxk", weights, of_like_signs(rods.quaternions)))
    return unknowns.rod.followed(rods.start, between, *unknowns.model(values), solver)
