"""Marginal likelihood of the sizes in :mod:`doo_ti.refinement.theta`, unknowns and effects integrated out (empirical Bayes).

With the linear model of :mod:`doo_ti.refinement.residuals` and W = Σ_kinds 1/σ², the effects of each observation are
eliminated first,

    M_d = ZᵀWZ + S⁻¹,    H = A + Σ_d (JᵀWJ − JᵀWZ M_d⁻¹ ZᵀWJ),

and −2 ln of the evidence, without its constant, is

    F = r'ᵀWr' + (x̂ − x̄)ᵀA(x̂ − x̄) + ẑᵀS⁻¹ẑ + Σ n ln σ² + Σ_d (ln |M_d| + ln |S|) + ln |H| − ln |A|,

with r' the residuals at the most probable x̂ and ẑ. It is Laplace's approximation of the evidence of the nonlinear model
(MacKay, *Bayesian Interpolation*, 1992).

Axes: D observations, P unknowns, Q effects of an observation, H learned sizes.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from doo_ti.refinement.residuals import GAP_MODES, Moments, Residuals
from doo_ti.refinement.theta import NAMES, Scales, minimised
from doo_ti.refinement.unknowns import Unknowns

STEPS = 60
ENOUGH = 1e-5
"""Change of F at which the search ends. Where F is flat at first, it falls by little more in a step; the rise that bounds an
interval is about four."""
WARMING = 4  # steps of expectation and maximisation before the search, which fails from sizes that are far off
SETTLED = 0.2
MISSING = 0.8
"""Largest share of the information about an unknown that may be missing because rolls are not known: far from the optimum the
second derivative may have any sign."""
FARTHEST = 2.0  # largest change of the logarithm of a size in one search
HALVINGS = 20  # of the weights of both sides of a kink


@dataclass(frozen=True)
class Posterior:
    """The posterior of the linear model at one set of sizes."""

    step: np.ndarray  # (P,) x̂
    covariance: np.ndarray  # (P, P) of x
    effects: np.ndarray  # (D, Q) ẑ
    value: float  # F
    gradient: np.ndarray  # (H,) of F by the logarithms of the sizes that are learned, priors included


@dataclass(frozen=True)
class Evidence:
    """F of one linear model."""

    unknowns: Unknowns  # whose prior is A
    moments: tuple[Moments, ...]  # of the residuals, kind by kind
    offset: np.ndarray  # (P,) present values less the prior's mean: −x̄
    # (D,) weight of each observation, one unless several stand for the same rod (:mod:`doo_ti.refinement.rolls`)
    share: np.ndarray
    constant: float  # added to F
    basis: np.ndarray  # (P, P') directions that are free, x = basis y + along
    along: np.ndarray  # (P,) the given part of the step, along a held direction

    @classmethod
    def of(cls, unknowns: Unknowns, linear: Sequence[Residuals], offset: np.ndarray, share: np.ndarray | None = None,
           constant: float = 0.0) -> "Evidence":
        """F of the linear model ``linear``."""
        share = np.ones(len(linear[0].values)) if share is None else share
        return cls(unknowns, tuple(Moments.of(kind, share) for kind in linear), offset, share, constant, np.eye(len(offset)),
                   np.zeros(len(offset)))

    def holding(self, direction: np.ndarray, amount: float = 0.0) -> "Evidence":
        """The same, but direction · x is held at ``amount``, ``direction`` (P,)."""
        full, _ = np.linalg.qr(np.column_stack([direction, np.eye(len(direction))]))
        return replace(self, basis=full[:, 1 : len(direction)], along=amount * direction / (direction @ direction))

    def with_other_side(self, linear: Sequence[Residuals], ahead: np.ndarray, scales: Scales) -> "Evidence":
        """F at a kink, with another linear model, around values that are ``ahead`` (P,): the mean of the squares of both,
        weighted so that at its most probable step both are as large. That step lowers the larger of them the most (bundle
        methods: Kiwiel, *Methods of Descent for Nondifferentiable Optimization*, 1985)."""
        other = [Moments.of(replace(kind, values=kind.values - kind.shared @ ahead), self.share) for kind in linear]
        pairs, low, high = list(zip(self.moments, other, strict=True)), 0.0, 1.0
        for _ in range(HALVINGS):
            weight = 0.5 * (low + high)
            both = replace(self, moments=tuple(own.averaged(its, weight) for own, its in pairs))
            at = (found := both.posterior(scales)).step, found.effects
            more = sum((self._squares(its, *at) - self._squares(own, *at)) / scales[own.scale] ** 2 for own, its in pairs)
            low, high = (weight, high) if more > 0 else (low, weight)
        return both

    def posterior(self, scales: Scales, known: bool = False) -> Posterior:
        """The posterior at these sizes; ``known``: as if it were known which of several rows is the rod."""
        kinds = effect_scales(self.unknowns)
        weights, variance, mixed, inner, slope_z = _effects(self.unknowns, self.moments, scales)
        passed, share = inner @ mixed, self.share
        slope = sum(w * kind.shared_slope for w, kind in zip(weights, self.moments, strict=True)) - (
            slope_z[:, None] @ passed)[:, 0]
        counted = (share[:, None, None] * passed).reshape(-1, len(self.offset))
        precision, log_prior = self.unknowns.precision(scales)
        hessian = precision + sum(w * kind.shared for w, kind in zip(weights, self.moments, strict=True)) - (
            counted.T @ mixed.reshape(counted.shape))
        if self.unknowns.rod.copies > 1 and not known:
            hessian = _less(hessian, self.not_known(slope))
        slope = share @ slope + precision @ self.offset
        step, covariance_x, log_hessian = self._solved(hessian, slope, precision)
        effects = -(inner @ (slope_z + mixed @ step)[..., None])[..., 0]
        # The gradient of F is the expectation of that of the complete data's −2 ln likelihood (Fisher's identity).
        crossed = passed @ covariance_x
        spread_z = np.einsum("dqq->dq", inner) + (crossed * passed).sum(axis=-1)
        gradient = dict.fromkeys(NAMES, 0.0)
        value = self.constant + log_hessian - log_prior - float(share @ np.linalg.slogdet(inner)[1])
        # Σ w · spread over all kinds: each unknown and effect counts one, less what the priors know of it.
        rods = float(share.sum())
        rest = self.basis.shape[1] + rods * effects.shape[1] - float(
            (covariance_x * precision).sum() + (share @ (spread_z / variance)).sum())
        for w, kind in [*zip(weights, self.moments, strict=True)][::-1]:
            squares = self._squares(kind, step, effects)
            spread = rest / w if kind is self.moments[0] else float(
                (covariance_x * kind.shared).sum() + share @ (
                    ((inner + crossed @ np.swapaxes(passed, 1, 2)) * kind.effects).sum(axis=(1, 2))
                    - 2 * (crossed * kind.mixed).sum(axis=(1, 2))))
            rest -= w * spread
            value += w * squares + 2 * kind.count * np.log(scales[kind.scale])
            gradient[kind.scale] += 2 * (kind.count - w * (squares + spread))
        second = share @ (effects**2 + spread_z)
        value += float((share @ effects**2 / variance).sum() + rods * np.log(variance).sum())
        for q, name in enumerate(kinds):
            gradient[name] += 2 * (rods - second[q] / variance[q])
        x = self.offset + step
        value += float(x @ precision @ x)
        self._prior_gradient(gradient, scales, np.outer(x, x) + covariance_x)
        extra, own = scales.prior()
        learned = np.array([gradient[name] for name, free in zip(NAMES, scales.learned, strict=True) if free])
        return Posterior(step, covariance_x, effects, value + extra, learned + own)

    def of_directions(self, scales: Scales) -> float:
        """What F is larger by because directions of ends that were not reported are integrated out: ln of what marks tell of
        them, being off by their typical size.

        A limp rod shows directions less. Between fits of one model F therefore leans towards limp rods, the more the more poses
        there are; without this part all directions are equally probable that marks tell apart equally well (Jeffreys' prior of
        them, given the unknowns; Berger, Liseo and Wolpert, 1999)."""
        at = [q for q, name in enumerate(effect_scales(self.unknowns)) if name == "any_turn"]
        if not at:
            return 0.0
        marks = scales.typical[NAMES.index("marks")]
        known = self.moments[0].effects[:, at][:, :, at] / marks**2 + np.eye(len(at)) / scales["any_turn"] ** 2
        return float(self.share @ np.linalg.slogdet(known)[1])

    def not_known(self, slope: np.ndarray) -> np.ndarray:
        """(P, P) the information that is missing because several rows may be the rod: the covariance of their slopes (D, P)
        (Louis, *Finding the observed information matrix when using the EM algorithm*, 1982)."""
        by_observation = self.unknowns.rod.by_observation
        mean = by_observation(self.share[:, None] * slope).sum(axis=1)
        return (self.share[:, None] * slope).T @ slope - mean.T @ mean

    def left_out(self, linear: tuple[Residuals, ...], scales: Scales) -> np.ndarray:
        """(D,) ln of the probability density of each observation, given all others, at these sizes: half of the decrease of F
        when that observation is left out. ``linear``: the residuals from which the moments follow."""
        own, slope, squares, constant = integrated(self.unknowns, linear, scales)
        rest = others(self.unknowns, own, slope, self.offset, scales)
        return -0.5 * (given(rest, own, slope, squares + constant) - given(rest, 0.0, 0.0, 0.0))

    def without_each(self, linear: tuple[Residuals, ...], scales: Scales) -> np.ndarray:
        """(D, P) the most probable step without each observation in turn, at these sizes."""
        own, slope, _, _ = integrated(self.unknowns, linear, scales)
        hessian, slope = others(self.unknowns, own, slope, self.offset, scales)
        return -np.linalg.solve(hessian, slope[..., None])[..., 0]

    def best(self, scales: Scales, steps: int = STEPS) -> Scales:
        """The sizes with the largest evidence that is reached from ``scales``, each within a factor e² of its present value."""
        if not scales.learned.any():
            return scales
        counts = self._counts(scales)
        for _ in range(WARMING if scales.hessian is None else 0):  # else the last search has left them near
            # Each squared size becomes the posterior mean of the squares it is the size of.
            share = self.posterior(scales, known=True).gradient / (2 * counts)
            if np.abs(share).max() < SETTLED:
                break
            change = 0.5 * np.log(np.clip(1 - share, 0.1, 3.0))
            scales = scales.at(np.clip(scales.free + change, *scales.bounds))

        def objective(free):
            found = self.posterior(scales.at(free), known=True)
            return found.value, found.gradient

        low, high = scales.bounds
        begin = np.clip(scales.free, low, high)
        hessian = np.diag(np.where(np.isfinite(counts), 4 * counts, 1.0)) if scales.hessian is None else scales.hessian
        free, hessian = minimised(objective, begin, (np.maximum(low, begin - FARTHEST), np.minimum(high, begin + FARTHEST)),
                                  hessian, steps, ENOUGH)
        return replace(scales.at(free), hessian=hessian)

    def _counts(self, scales: Scales) -> np.ndarray:
        """(H,) how many squares each learned size is the mean of; the range is not one, and is not changed here."""
        rods = float(self.share.sum())
        turns = self.unknowns.rod.pose_scales.count("turn_scatter")
        counts = {"turn": 2 * turns, "turn_scatter": turns * rods, "any_roll": rods, "gap": 3 * GAP_MODES * rods}
        for field in self.unknowns.fields:
            counts |= {field.name: len(self.unknowns.columns(field.name)), field.range: np.inf}
        counts |= {kind.scale: max(kind.count, 1.0) for kind in self.moments}
        return np.array([counts.get(name, 1.0) for name, free in zip(NAMES, scales.learned, strict=True) if free], dtype=float)

    def _solved(self, hessian: np.ndarray, slope: np.ndarray, precision: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """(x̂, covariance of x, ln |H|) over the unknowns that are free."""
        basis = self.basis
        inverse, logarithm = _inverse(basis.T @ hessian @ basis, basis.T @ precision @ basis)
        inverse = basis @ inverse @ basis.T
        return self.along - inverse @ (slope + hessian @ self.along), inverse, logarithm

    def _squares(self, kind: Moments, step: np.ndarray, effects: np.ndarray) -> float:
        """Σ (r + J x + Z z)²."""
        of_effects = self.share @ (effects * ((kind.effects @ effects[..., None])[..., 0] + 2 * kind.effects_slope)).sum(axis=1)
        by_step = self.share @ (kind.shared_slope + (effects[:, None] @ kind.mixed)[:, 0])
        return float(kind.squares + step @ kind.shared @ step + 2 * step @ by_step + of_effects)

    def _prior_gradient(self, gradient: dict[str, float], scales: Scales, second: np.ndarray) -> None:
        """Adds the derivatives of the prior of the unknowns, whose second moments about its mean are ``second``."""
        unknowns = self.unknowns
        own = unknowns.columns("clamps")
        gradient["turn"] += 2 * float((1 - np.diag(second)[own] / scales["turn"] ** 2).sum())
        for field in unknowns.fields:
            own, count = unknowns.columns(field.name), field.components
            matrix, slope = field.covariance(scales)
            inverse, moment = np.linalg.inv(matrix), second[np.ix_(own, own)]
            both = sum(moment[k::count, k::count] for k in range(count))
            gradient[field.name] += 2 * float(len(own) - (inverse * both).sum())
            change = inverse @ slope
            gradient[field.range] += float(count * np.trace(change) - (change @ inverse * both).sum())


def _less(hessian: np.ndarray, missing: np.ndarray) -> np.ndarray:
    """``hessian`` less ``missing``, of which at most the share MISSING along any direction."""
    try:
        root = np.linalg.cholesky(hessian)
    except np.linalg.LinAlgError:
        return hessian
    half = np.linalg.solve(root, missing)
    values, vectors = np.linalg.eigh(np.linalg.solve(root, half.T))
    left = root @ vectors
    return hessian - left * np.minimum(values, MISSING) @ left.T


def _inverse(hessian: np.ndarray, precision: np.ndarray) -> tuple[np.ndarray, float]:
    """H⁻¹ and ln |H|. H is at least the prior's ``precision``; eigenvalues that are smaller by rounding are raised to it."""
    try:
        root = np.linalg.cholesky(hessian)
    except np.linalg.LinAlgError:
        scale = np.linalg.cholesky(precision)
        half = np.linalg.solve(scale, hessian)
        values, vectors = np.linalg.eigh(0.5 * (half @ np.linalg.inv(scale).T + np.linalg.solve(scale, half.T)))
        root = scale @ (vectors * np.sqrt(np.maximum(values, 1.0)))
        inverse = np.linalg.inv(root)
        return inverse.T @ inverse, 2 * float(np.linalg.slogdet(root)[1])
    inverse = np.linalg.inv(root)
    return inverse.T @ inverse, 2 * float(np.log(np.diag(root)).sum())


def effect_scales(unknowns: Unknowns) -> tuple[str, ...]:
    """(Q,) the scale of each effect of an observation: poses first, then the gap's amplitudes. A number of a pose that is not
    unknown has no derivatives; its scale does not matter."""
    poses = () if unknowns.rod.exact else unknowns.rod.pose_scales
    return tuple(name or "turn_scatter" for name in poses) + ("gap",) * (3 * GAP_MODES)


def _effects(unknowns: Unknowns, moments: Sequence[Moments], scales: Scales):
    """1/σ² of each kind, the diagonal of S (Q,), and of each observation ZᵀWJ (D, Q, P), M_d⁻¹ (D, Q, Q) and ZᵀWr (D, Q)."""
    weights = [1 / scales[kind.scale] ** 2 for kind in moments]
    variance = np.array([scales[name] for name in effect_scales(unknowns)]) ** 2
    pairs = list(zip(weights, moments, strict=True))
    inner = np.linalg.inv(np.diag(1 / variance) + sum(w * kind.effects for w, kind in pairs))
    mixed, slope_z = sum(w * kind.mixed for w, kind in pairs), sum(w * kind.effects_slope for w, kind in pairs)
    return weights, variance, mixed, inner, slope_z


def best_effects(unknowns: Unknowns, linear: tuple[Residuals, ...], scales: Scales) -> np.ndarray:
    """(D, Q) the most probable effects of each observation where the unknowns stay."""
    _, _, _, inner, slope_z = _effects(unknowns, [Moments.of(kind) for kind in linear], scales)
    return -(inner @ slope_z[..., None])[..., 0]


def densities(unknowns: Unknowns, linear: tuple[Residuals, ...], scales: Scales) -> np.ndarray:
    """(D,) −2 ln of the density of each observation's residuals, its effects integrated out, at the present unknowns."""
    kinds = tuple(replace(kind, shared=kind.shared[..., :0]) for kind in linear)
    _, _, squares, constant = integrated(unknowns, kinds, scales)
    return squares + constant


def integrated(unknowns: Unknowns, linear: tuple[Residuals, ...], scales: Scales
               ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """−2 ln of the density of each observation's residuals, its effects integrated out, as c + q + 2 s·x + xᵀBx in the
    unknowns x: B (D, P, P), the information that the observation holds about them, s (D, P), q and c (D,); c does not depend
    on the residuals."""
    weights, variance, mixed, inner, slope_z = _effects(unknowns, [Moments.of(kind) for kind in linear], scales)
    pairs, slope_z = list(zip(weights, linear, strict=True)), slope_z[..., None]
    passed = np.swapaxes(mixed, 1, 2) @ inner
    own = sum(w * np.swapaxes(k.shared, 1, 2) @ k.shared for w, k in pairs) - passed @ mixed
    slope = (sum(w * np.swapaxes(k.shared, 1, 2) @ k.values[..., None] for w, k in pairs) - passed @ slope_z)[..., 0]
    squares = sum(w * (k.values**2).sum(axis=1) for w, k in pairs) - (slope_z * (inner @ slope_z)).sum(axis=(1, 2))
    noise = sum(k.count * np.log(2 * np.pi * scales[k.scale] ** 2) for k in linear)
    return own, slope, squares, noise - np.linalg.slogdet(inner)[1] + np.log(variance).sum()


def others(unknowns: Unknowns, own: np.ndarray, slope: np.ndarray, offset: np.ndarray, scales: Scales
           ) -> tuple[np.ndarray, np.ndarray]:
    """(D, P, P) and (D, P) the sums of B and s (:func:`integrated`) of all others than each observation, and of the prior, from
    whose mean the unknowns are ``offset`` (P,) away."""
    precision, _ = unknowns.precision(scales)
    return precision + own.sum(axis=0) - own, slope.sum(axis=0) + precision @ offset - slope


def given(rest: tuple[np.ndarray, np.ndarray], own: np.ndarray | float, slope: np.ndarray | float, value: np.ndarray | float
          ) -> np.ndarray:
    """(D,) −2 ln of the density of each observation given the ``rest``, all :func:`others`, up to what only these say; its own
    B, s, and c + q = ``value``."""
    hessian, slope = rest[0] + own, rest[1] + slope
    return value - np.einsum("dp,dp->d", slope, np.linalg.solve(hessian, slope[..., None])[..., 0]) + np.linalg.slogdet(
        hessian)[1]
