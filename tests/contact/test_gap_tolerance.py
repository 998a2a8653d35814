"""What the tolerance of gaps means for the forces of single contacts."""

import numpy as np
import pytest

from doo_ti import Newton, relax
from tools.bench.contact import RADIUS, Specimens, obstacles

EXACT = 1e-8
"""Of a radius."""


@pytest.mark.thorough
def test_forces_of_single_contacts_are_the_more_exact_the_smaller_the_gaps():
    """On the vertices of rods on a table with two pegs, over the largest of the rod."""
    rods, material, clamps = Specimens(1024).moved_on

    def found(tolerance, precision="f64"):
        return relax(rods, material, clamps, Newton(max_iterations=1000, gap_tolerance=tolerance), obstacles=obstacles(),
                     radius=RADIUS, precision=precision)

    exact, errors = found(EXACT), []
    largest = np.linalg.norm(exact.contact_force, axis=2).max(axis=1)
    for tolerance, precision in ((None, "f32"), (None, "f64"), (1e-6, "f64")):
        rough = found(tolerance, precision)
        apart = np.abs(rough.configuration.vertices - exact.configuration.vertices).max(axis=(1, 2))
        same = rough.converged & exact.converged & (apart < 0.1)
        assert same.mean() > 0.98
        error = (np.linalg.norm(rough.contact_force - exact.contact_force, axis=2).max(axis=1) / largest)[same]
        median, worst = 100 * np.median(error), 100 * np.quantile(error, 0.9)
        print(f"{precision}, {tolerance or 'usual'} of a radius: {median:.2g} % in the median, {worst:.2g} % in a tenth of the "
              f"rods, {rough.iterations.mean():.1f} iterations")
        errors.append(np.median(error))
    assert errors[0] < 0.03 and errors[1] < 0.003 and errors[2] < 0.0003
