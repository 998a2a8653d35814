"""Quantiles against scipy's."""

import math

import pytest
from scipy import stats

from doo_ti.refinement.confidence import chi_square_probability, f_probability, f_quantile

DEGREES = (1, 2, 3, 7, 66)


@pytest.mark.parametrize("first", DEGREES)
@pytest.mark.parametrize("probability", [0.05, 0.5, 0.95, 0.99])
def test_quantiles_are_those_of_scipy(first, probability):
    for second in (1, 4, 57, 5997, 100_000):
        assert f_quantile(probability, first, second) == pytest.approx(stats.f.ppf(probability, first, second), rel=1e-9)
    assert first * f_quantile(probability, first) == pytest.approx(stats.chi2.ppf(probability, first), rel=1e-9)


def test_a_single_parameter_s_is_the_square_of_student_s_and_the_normal_s():
    assert math.sqrt(f_quantile(0.95, 1, 12)) == pytest.approx(stats.t.ppf(0.975, 12), rel=1e-9)
    assert math.sqrt(f_quantile(0.95, 1)) == pytest.approx(1.959963984540054, rel=1e-9)


@pytest.mark.parametrize("degrees", [*DEGREES, 6000])
def test_probabilities_are_those_of_scipy(degrees):
    for share in (0.0, 0.3, 0.9, 1.0, 1.1, 3.0):
        expected = stats.chi2.cdf(share * degrees, degrees)
        assert chi_square_probability(share * degrees, degrees) == pytest.approx(expected, rel=1e-9, abs=1e-12)
        assert f_probability(share, degrees, 40) == pytest.approx(stats.f.cdf(share, degrees, 40), rel=1e-9, abs=1e-12)
