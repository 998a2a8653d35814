"""Quantiles of the F and χ² distributions, for confidence intervals and regions.

The region that holds the truth of p parameters with some probability is dᵀ C⁻¹ d ≤ p F(p, n), n degrees of freedom from which
the noise was estimated; where the noise is known n is infinite and p F(p, ∞) is the quantile of χ² with p. A single
parameter's interval is the same with p = 1: Student's t², or the normal's square.
"""

import math

ROUNDS = 200  # of a continued fraction or series, whose terms fall geometrically long before


def f_quantile(probability: float, first: float, second: float = math.inf) -> float:
    """The x that F with ``first`` and ``second`` degrees of freedom stays below with ``probability``; ``second`` may be inf."""
    return _inverse(lambda x: f_probability(x, first, second), probability)


def f_probability(x: float, first: float, second: float = math.inf) -> float:
    """The probability of F being below x ≥ 0."""
    if math.isinf(second):
        return chi_square_probability(first * x, first)
    return _beta_ratio(0.5 * first, 0.5 * second, first * x / (first * x + second))


def chi_square_probability(x: float, degrees: float) -> float:
    """The probability of χ² with ``degrees`` of freedom being below x ≥ 0: the incomplete gamma ratio P(degrees/2, x/2)."""
    a, x = 0.5 * degrees, 0.5 * x
    if x <= 0:
        return 0.0
    scale = math.exp(a * math.log(x) - x - math.lgamma(a))
    if x > a + 1:
        return 1.0 - scale * _gamma_fraction(a, x)
    term = total = 1.0 / a
    power = a
    while term > 1e-17 * total:
        power += 1.0
        term *= x / power
        total += term
    return scale * total


def _gamma_fraction(a: float, x: float) -> float:
    """Γ(a, x)/(xᵃ e⁻ˣ) as a continued fraction, by Lentz' method."""
    b = x + 1.0 - a
    c, d = 1e300, 1.0 / b
    value = d
    for k in range(1, ROUNDS + int(10 * math.sqrt(a))):
        step, b = -k * (k - a), b + 2.0
        d = 1.0 / (step * d + b)
        c = b + step / c
        value *= c * d
        if abs(c * d - 1.0) < 1e-15:
            break
    return value


def _beta_ratio(a: float, b: float, x: float) -> float:
    """The incomplete beta ratio I_x(a, b)."""
    if x <= 0 or x >= 1:
        return float(x >= 1)
    scale = math.exp(math.lgamma(a + b) - math.lgamma(a) - math.lgamma(b) + a * math.log(x) + b * math.log1p(-x))
    # The fraction converges fast below the mean; beyond it the other tail is taken.
    if x > (a + 1) / (a + b + 2):
        return 1.0 - scale * _beta_fraction(b, a, 1.0 - x) / b
    return scale * _beta_fraction(a, b, x) / a


def _beta_fraction(a: float, b: float, x: float) -> float:
    c, d = 1.0, 1.0 / (1.0 - (a + b) * x / (a + 1.0))
    value = d
    for m in range(1, ROUNDS + int(10 * math.sqrt(a + b))):
        for step in (m * (b - m) * x / ((a + 2 * m - 1) * (a + 2 * m)),
                     -(a + m) * (a + b + m) * x / ((a + 2 * m) * (a + 2 * m + 1))):
            d = 1.0 / (1.0 + step * d)
            c = 1.0 + step / c
            value *= c * d
        if abs(c * d - 1.0) < 1e-15:
            break
    return value


def _inverse(probability_below, probability: float) -> float:
    """The x with ``probability_below(x)`` = ``probability``, by doubling and bisection."""
    low, high = 0.0, 1.0
    while probability_below(high) < probability:
        low, high = high, 2.0 * high
    for _ in range(ROUNDS):
        middle = 0.5 * (low + high)
        if middle in (low, high):
            break
        low, high = (middle, high) if probability_below(middle) < probability else (low, middle)
    return 0.5 * (low + high)
