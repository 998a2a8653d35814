"""From stiffness relative to weight (footnote 6) to stiffness: what weighing a piece of the rod adds.

In the continuum bend α is EI, twist β is GJ and the weight per length w is 2 μ (PAPER.md), so shapes determine EI/w = α/(2 μ)
in mm³ and no more. A linear density ρ gives w = ρ g, hence EI and GJ.
"""

import numpy as np

STANDARD_GRAVITY = 9.80665
"""m/s²."""


def weight_per_length(linear_density: float) -> float:
    """w in N/m of a rod of ``linear_density`` g/m."""
    return 1e-3 * linear_density * STANDARD_GRAVITY


def relative_stiffness(value, weight):
    """EI/w or GJ/w in mm³ from bend or twist (mm³) and the weight μ they are relative to."""
    return np.asarray(value) / (2.0 * np.asarray(weight))


def stiffness(over_weight: float, linear_density: float) -> float:
    """EI or GJ in N m² from EI/w or GJ/w in mm³ and the linear density in g/m."""
    return over_weight * weight_per_length(linear_density) * 1e-9
