"""Between stiffness relative to weight (footnote 6), in which the package computes, and physical units.

In the continuum bend α is EI, twist β is GJ and the weight per length w is 2 μ (PAPER.md): shapes determine EI/w = α/(2 μ) in
mm³ and no more. The weight per length, or a linear density ρ with w = ρ g, gives the rest:

    EI = α w/(2 μ),   GJ = β w/(2 μ),   force = end_force · w/(2 μ).
"""

import numpy as np

UNITS_IN_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0}
"""mm in one unit of length, by its name on the command line."""
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


def bend_or_twist(stiffness, weight_per_length):
    """α or β in mm³, relative to μ = 1, from EI or GJ in N m² and the weight per length in N/m."""
    return 2e9 * np.asarray(stiffness) / np.asarray(weight_per_length)


def force_in_newton(force, weight_per_length, weight=1.0):
    """N from a force in the units of the package, mm² of energy per mm, of a rod of weight μ and w in N/m."""
    return np.asarray(force) * (1e-3 * np.asarray(weight_per_length) / (2.0 * np.asarray(weight)))
