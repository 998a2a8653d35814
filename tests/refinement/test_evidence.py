"""The marginal likelihood against dense Gaussian algebra, and its gradient against differences."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from doo_ti import Newton
from doo_ti.refinement.evidence import Evidence, effect_scales
from doo_ti.refinement.fit import Fit
from tests.refinement.rods_between_clips import TRUTH, held, model, suture


@pytest.fixture(scope="module")
def linear_model():
    """(evidence, residuals, sizes) of five rods with frames."""
    seen = suture(2, frames=True).take([0, 1, 2, 4, 5])
    comparison, scales = model(held(seen, 34), with_frames=True)
    values = comparison.unknowns.begun(TRUTH, np.array([2.0, 2.5]))
    fit = Fit(comparison, values, Newton())
    state = fit.begin(values, scales)
    linear, used = comparison.linear(state.solution, values, state.used)
    assert used.all()
    offset = 0.1 + comparison.unknowns.offset(values, values)
    return Evidence.of(comparison.unknowns, linear, offset), linear, scales


def dense(evidence: Evidence, linear, scales):
    """(r, its mean, its covariance) of all residuals together, directors' zero rows left out."""
    precision, _ = evidence.unknowns.precision(scales)
    shared = [np.concatenate([kind.shared[d] for kind in linear]) for d in range(len(linear[0].values))]
    effects = [np.concatenate([kind.effects[d] for kind in linear]) for d in range(len(shared))]
    values = [np.concatenate([kind.values[d] for kind in linear]) for d in range(len(shared))]
    noise = np.concatenate([np.full(kind.values.shape[1], scales[kind.scale] ** 2) for kind in linear])
    variance = np.array([scales[name] for name in effect_scales(evidence.unknowns)]) ** 2
    keep = [np.abs(j).max(axis=1) > 0 for j in shared]
    prior = np.linalg.inv(precision)
    # r + J x + Z z + ε = 0 with x about −offset: the observed part of −r.
    rows = np.concatenate([j[k] for j, k in zip(shared, keep, strict=True)])
    covariance = rows @ prior @ rows.T
    at = 0
    for z, k in zip(effects, keep, strict=True):
        size = k.sum()
        covariance[at : at + size, at : at + size] += z[k] @ np.diag(variance) @ z[k].T + np.diag(noise[k])
        at += size
    return -np.concatenate([r[k] for r, k in zip(values, keep, strict=True)]), rows @ -evidence.offset, covariance


def counted_by_rows(linear):
    """A director has two numbers in three rows; dense algebra has all three."""
    return tuple(replace(kind, count=(np.abs(kind.shared).max(axis=2) > 0).sum(axis=1).astype(float)) for kind in linear)


@pytest.mark.thorough
def test_it_is_the_density_of_the_residuals(linear_model):
    evidence, linear, scales = linear_model
    linear = counted_by_rows(linear)
    evidence = Evidence.of(evidence.unknowns, linear, evidence.offset)

    def difference(first, second):
        values = []
        for sizes in (first, second):
            seen, mean, covariance = dense(evidence, linear, sizes)
            values.append(-2 * multivariate_normal(mean, covariance, allow_singular=True).logpdf(seen) + sizes.prior()[0])
        return values[1] - values[0]

    other = scales.at(scales.free + np.linspace(-0.3, 0.4, len(scales.free)))
    own = evidence.posterior(other).value - evidence.posterior(scales).value
    assert own == pytest.approx(difference(scales, other), rel=1e-6)


def test_its_gradient(linear_model):
    evidence, _, scales = linear_model
    gradient = evidence.posterior(scales).gradient
    for k in range(len(scales.free)):
        step = 1e-5 * np.eye(len(scales.free))[k]
        above, below = (evidence.posterior(scales.at(scales.free + sign * step)).value for sign in (1, -1))
        assert gradient[k] == pytest.approx((above - below) / 2e-5, rel=1e-5, abs=1e-3)


def test_the_best_sizes_leave_no_slope(linear_model):
    evidence, _, scales = linear_model
    best = evidence.best(scales)
    assert evidence.posterior(best).value < evidence.posterior(scales).value
    inside = [low + 1e-6 < now < high - 1e-6 for now, (low, high) in zip(best.free, np.transpose(best.bounds), strict=True)]
    assert np.abs(evidence.posterior(evidence.best(best)).gradient[inside]).max() < 0.5


def test_steps_without_each_observation(linear_model):
    evidence, linear, scales = linear_model
    found = evidence.without_each(linear, scales)
    for d in range(len(found)):
        others = tuple(replace(kind, **{name: np.delete(getattr(kind, name), d, axis=0)
                                        for name in ("values", "shared", "effects", "count")}) for kind in linear)
        alone = Evidence.of(evidence.unknowns, others, evidence.offset).posterior(scales)
        np.testing.assert_allclose(found[d], alone.step, rtol=1e-6, atol=1e-9)


def test_held_directions_stay(linear_model):
    evidence, _, scales = linear_model
    direction = np.zeros(len(evidence.offset))
    direction[:2] = (1.0, -1.0)
    found = evidence.holding(direction, 0.3).posterior(scales)
    assert direction @ found.step == pytest.approx(0.3)
    assert direction @ found.covariance @ direction == pytest.approx(0, abs=1e-12)


@pytest.mark.thorough
def test_left_out_is_the_decrease_of_the_evidence(linear_model):
    """ln p(one | others) = ln p(all) − ln p(others), both by dense algebra."""
    evidence, linear, scales = linear_model
    linear = counted_by_rows(linear)
    evidence = Evidence.of(evidence.unknowns, linear, evidence.offset)
    own = evidence.left_out(linear, scales)
    seen, mean, spread = dense(evidence, linear, scales)
    every = multivariate_normal(mean, spread, allow_singular=True).logpdf(seen)
    for d in range(len(own)):
        others = tuple(replace(kind, **{name: np.delete(getattr(kind, name), d, axis=0)
                                        for name in ("values", "shared", "effects", "count")}) for kind in linear)
        rest = dense(evidence, others, scales)
        assert own[d] == pytest.approx(every - multivariate_normal(*rest[1:], allow_singular=True).logpdf(rest[0]), rel=1e-5)
