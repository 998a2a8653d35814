"""The marginal likelihood against dense Gaussian algebra, its gradient against differences; optima of the posterior: where
fits begin that have several, and which of them count."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.optimize import minimize, rosen, rosen_der
from scipy.stats import multivariate_normal

from doo_ti import Newton, Observations, Theta, observation_clamps
from doo_ti.refinement.estimate import Interval
from doo_ti.refinement.evidence import Evidence, effect_scales
from doo_ti.refinement.fit import Fit, State
from doo_ti.refinement.refine import RefinementOptions, finished, first_edges, optima
from doo_ti.refinement.residuals import Comparison
from doo_ti.refinement.search import turns_chosen_again, twisted
from doo_ti.refinement.theta import Scales, minimised, typical_scales
from doo_ti.refinement.unknowns import Unknowns, Values
from tests.io.rods import joint_twist
from tests.refinement.rods_between_clips import TRUTH, assert_gradient, bare, held, model, suture


@pytest.fixture(scope="module")
def linear_model():
    """(evidence, residuals, sizes) of five rods with frames."""
    comparison, scales = model(held(suture(2, frames=True).take([0, 1, 2, 4, 5]), 34), with_frames=True)
    values = comparison.unknowns.begun(TRUTH, np.array([2.0, 2.5]))
    state = Fit(comparison, values, Newton()).begin(values, scales)
    linear, used = comparison.linear(state.solution, values, state.used)
    assert used.all()
    return Evidence.of(comparison.unknowns, linear, 0.1 + comparison.unknowns.offset(values, values)), linear, scales


def dense(evidence: Evidence, linear, scales):
    """(r, its mean, its covariance) of all residuals together, directors' zero rows left out."""
    prior = np.linalg.inv(evidence.unknowns.precision(scales)[0])
    shared, effects, values = (np.concatenate([getattr(kind, name) for kind in linear], axis=1)
                               for name in ("shared", "effects", "values"))
    noise = np.concatenate([np.full(kind.values.shape[1], scales[kind.scale] ** 2) for kind in linear])
    variance = np.array([scales[name] for name in effect_scales(evidence.unknowns)]) ** 2
    keep = np.abs(shared).max(axis=2) > 0
    # r + J x + Z z + ε = 0 with x about −offset: the observed part of −r.
    rows = shared[keep]
    own = [z[k] * variance @ z[k].T + np.diag(noise[k]) for z, k in zip(effects, keep, strict=True)]
    return -values[keep], rows @ -evidence.offset, rows @ prior @ rows.T + block_diag(*own)


def logarithm(evidence: Evidence, linear, scales) -> float:
    """ln of the density of all residuals, by dense algebra."""
    seen, mean, covariance = dense(evidence, linear, scales)
    return multivariate_normal(mean, covariance, allow_singular=True).logpdf(seen)


@pytest.mark.thorough
def test_it_is_the_density_of_the_residuals_and_left_out_is_its_decrease(linear_model):
    """ln p(one | others) = ln p(all) − ln p(others), both by dense algebra. A director has two numbers in three rows; dense
    algebra has all three."""
    evidence, linear, scales = linear_model
    linear = tuple(replace(kind, count=(np.abs(kind.shared).max(axis=2) > 0).sum(axis=1).astype(float)) for kind in linear)
    evidence = Evidence.of(evidence.unknowns, linear, evidence.offset)

    other = scales.at(scales.free + np.linspace(-0.3, 0.4, len(scales.free)))
    before, after = (-2 * logarithm(evidence, linear, sizes) + sizes.prior()[0] for sizes in (scales, other))
    own = evidence.posterior(other).value - evidence.posterior(scales).value
    assert own == pytest.approx(after - before, rel=1e-6)
    every = logarithm(evidence, linear, scales)
    for d, own in enumerate(evidence.left_out(linear, scales)):
        assert own == pytest.approx(every - logarithm(evidence, without(linear, d), scales), rel=1e-5)


def test_its_gradient_and_that_the_best_sizes_leave_no_slope(linear_model):
    evidence, _, scales = linear_model
    assert_gradient(evidence.posterior, scales)
    best = evidence.best(scales)
    assert evidence.posterior(best).value < evidence.posterior(scales).value
    inside = [low + 1e-6 < now < high - 1e-6 for now, (low, high) in zip(best.free, np.transpose(best.bounds), strict=True)]
    assert np.abs(evidence.posterior(evidence.best(best)).gradient[inside]).max() < 0.5


def without(linear, d: int):
    """The residuals of all observations but ``d``."""
    return tuple(replace(kind, **{name: np.delete(getattr(kind, name), d, axis=0)
                                  for name in ("values", "shared", "effects", "count")}) for kind in linear)


def test_steps_without_each_observation(linear_model):
    evidence, linear, scales = linear_model
    for d, found in enumerate(evidence.without_each(linear, scales)):
        alone = Evidence.of(evidence.unknowns, without(linear, d), evidence.offset).posterior(scales)
        np.testing.assert_allclose(found, alone.step, rtol=1e-6, atol=1e-9)


def test_held_directions_stay(linear_model):
    evidence, _, scales = linear_model
    direction = np.eye(len(evidence.offset))[0] - np.eye(len(evidence.offset))[1]
    found = evidence.holding(direction, 0.3).posterior(scales)
    assert direction @ found.step == pytest.approx(0.3)
    assert direction @ found.covariance @ direction == pytest.approx(0, abs=1e-12)


@pytest.mark.parametrize("bounds", [(np.full(3, -np.inf), np.full(3, np.inf)), (np.full(3, -2.0), np.array([0.8, 2.0, 2.0]))])
def test_the_minimum_is_that_of_scipy(bounds):
    x, hessian = minimised(lambda x: (rosen(x), rosen_der(x)), np.array([-0.5, 0.5, 0.5]), bounds, np.eye(3), 200, 1e-12)
    expected = minimize(rosen, [-0.5, 0.5, 0.5], jac=rosen_der, method="L-BFGS-B", bounds=list(zip(*bounds, strict=True)),
                        options={"ftol": 1e-14, "gtol": 1e-10})
    np.testing.assert_allclose(x, expected.x, atol=1e-4)
    np.linalg.cholesky(hessian)


def test_a_right_hessian_needs_one_step():
    matrix, calls = np.array([[3.0, 1.0], [1.0, 2.0]]), []

    def function(x):
        calls.append(x)
        return 0.5 * x @ matrix @ x, matrix @ x

    x, hessian = minimised(function, np.array([0.4, -0.7]), (np.full(2, -9.0), np.full(2, 9.0)), matrix, 20, 1e-6)
    np.testing.assert_allclose(x, 0.0, atol=1e-12)
    np.testing.assert_allclose(hessian, matrix, atol=1e-12)
    assert len(calls) == 2


def test_a_variable_at_its_bound_stays_where_the_function_falls_beyond():
    x, _ = minimised(lambda x: (x @ x, 2 * x), np.array([1.0, 1.0]), (np.array([1.0, -1.0]), np.full(2, 2.0)), np.eye(2), 20,
                     1e-9)
    np.testing.assert_allclose(x, [1.0, 0.0], atol=1e-4)


def test_no_step_from_a_kink_lowers_the_larger_of_both_models_more(linear_model, rng):
    evidence, linear, scales = linear_model
    ahead = 1e-3 * rng.normal(size=len(evidence.offset))
    beyond = tuple(replace(kind, shared=-0.7 * kind.shared) for kind in linear)
    found = evidence.with_other_side(beyond, ahead, scales).posterior(scales)
    sizes = np.array([scales[name] for name in effect_scales(evidence.unknowns)])

    def of_both(x, z):
        away = evidence.offset + x
        same = away @ evidence.unknowns.precision(scales)[0] @ away + ((z / sizes) ** 2).sum()
        return [same + sum((((k.values + k.shared @ (x - at) + (k.effects @ z[..., None])[..., 0])
                             / scales[k.scale]) ** 2).sum() for k in side) for side, at in ((linear, 0.0), (beyond, ahead))]

    least = of_both(found.step, found.effects)
    assert least[0] == pytest.approx(least[1], rel=1e-4)
    for size in (1e-3, 1e-2, 0.1) * 10:
        x, z = (one * (1 + size * rng.normal(size=one.shape)) for one in (found.step, found.effects))
        assert max(of_both(x, z)) > max(least) * (1 - 1e-5)


def fit_of(seen: Observations) -> tuple[Fit, Values, Scales]:
    unknowns, spacing = Unknowns(held(seen), ("bend", "twist")), float(seen.rest_length[0])
    scales = typical_scales(unknowns.rod.length, spacing, unknowns.scale_names | {"marks", "gap"}, {})
    values = unknowns.begun(TRUTH, unknowns.clip_prior)
    return Fit(Comparison.of(unknowns, False), values, Newton()), values, scales


def _twist(state: State) -> np.ndarray:
    return joint_twist(state.solution.configuration.quaternions).sum(axis=1)


@pytest.mark.thorough
def test_a_converged_fit_is_at_rest_in_every_observation():
    """While the clamps of a single observation still move, the evidence is not that of the optimum."""
    seen, options = bare(suture()), RefinementOptions(curvature="field")
    for found in optima(seen, observation_clamps(seen), (TRUTH,), options):
        one = finished(found, options)
        assert found.converged and one.converged
        assert one.fit.run(one.state, 12).posterior.value == pytest.approx(one.posterior.value, abs=0.5)


@pytest.mark.thorough
def test_turns_that_were_measured_are_returned_to():
    seen = suture()
    fit, values, scales = fit_of(seen)
    begun = fit.from_marks(values, scales)
    measured = _twist(begun)
    wrong = fit.merged(begun, fit.from_marks(values, scales, turn=1), np.arange(seen.count) == 4)
    assert abs(_twist(wrong)[4] - measured[4]) > 3
    np.testing.assert_allclose(_twist(turns_chosen_again(fit.run(wrong, 3), 5)[0].state), measured, atol=0.5)


@pytest.mark.thorough
def test_fits_begin_with_the_least_twist_too():
    """Between marks far apart a soft rod with a turn more looks the same, and would confirm its softness."""
    least = next(iter(twisted(*fit_of(replace(suture(), total_twist=None)))))
    assert np.abs(_twist(least)).max() < np.pi + 0.5


def test_the_first_mesh_resolves_bends_beside_clamps():
    cable = Observations(np.linspace(0, [1000.0, 0, 0], 9)[None], rest_length=np.full(8, 125.0))
    assert [first_edges(cable, Theta(bend * np.eye(2), bend)) for bend in (1e9, 2e6, 1e3)] == [24, 45, 64]


@pytest.mark.thorough
def test_twists_do_not_follow_the_guessed_place_of_a_missing_outer_mark():
    turned = suture(end_rotations_deg=(0.0, 90.0, 170.0, 250.0, -120.0, -200.0), end_distances_mm=(42.0, 78.0))
    vertices, rest = turned.vertices[:, ::6].copy(), turned.rest_length[:30].reshape(-1, 6).sum(axis=1)
    vertices[::2, -1] = vertices[1::3, 0] = np.nan
    seen = replace(turned, vertices=vertices, rest_length=rest, valid=np.isfinite(vertices).all(axis=-1), total_twist=None)
    fit, values, scales = fit_of(seen)
    np.testing.assert_allclose(_twist(fit.begin(replace(values, clip=np.full(2, 1.5)), scales)), turned.total_twist, atol=1.0)


def test_intervals_contain_those_of_other_optima():
    both = Interval(-1.0, 1.0, 0.5).widened(Interval(-0.2, 0.3, 0.1), 1.5)
    assert (both.low, both.high, both.error) == (-1.0, 1.8, 0.5)
    assert Interval(-1.0, None, 0.5).widened(Interval(-0.2, 0.3, 0.1), -2.0).low == -2.2
    assert Interval(-1.0, 1.0, 0.5).widened(Interval(None, 0.3, 0.1), 0.0).low is None
