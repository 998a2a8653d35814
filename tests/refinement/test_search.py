"""Optima of the posterior: where fits begin that have several, and which of them count."""

from dataclasses import replace

import numpy as np
import pytest

from doo_ti import Newton, Observations, Theta, observation_clamps
from doo_ti.refinement.estimate import Interval
from doo_ti.refinement.fit import Fit, State
from doo_ti.refinement.refine import RefinementOptions, finished, first_edges, optima
from doo_ti.refinement.residuals import Comparison
from doo_ti.refinement.search import turns_chosen_again, twisted
from doo_ti.refinement.theta import Scales, typical_scales
from doo_ti.refinement.unknowns import Unknowns, Values
from tests.io.rods import joint_twist
from tests.refinement.rods_between_clips import TRUTH, bare, held, suture


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
