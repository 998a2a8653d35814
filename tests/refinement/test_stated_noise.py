"""Marks whose uncertainty is stated, but for those that are missing."""

import numpy as np
import pytest

import doo_ti as d
from doo_ti.refinement.refine import refine
from doo_ti.refinement.theta import Theta


@pytest.mark.thorough
def test_missing_marks_have_no_noise(rng):
    """As triangulate writes them: NaN. It used to become the noise of all."""
    rod, clamps = d.hanging(300.0, 20, np.zeros((4, 3)), [[150.0, 0, 40], [180, 0, 0], [210, 30, 0], [240, 0, -30]],
                            clamp=d.Clamp.FRAME)
    marks = d.relax(rod, d.Material(4e6, 4e6), clamps).configuration.vertices + rng.normal(0, 0.3, (4, 21, 3))
    marks[1, 7], sigma = np.nan, np.full((4, 21), 0.3)
    sigma[1, 7] = np.nan
    seen = d.Observations(marks, rest_length=np.full(20, 15.0), sigma=sigma)
    found = refine(seen, d.observation_clamps(seen), Theta(3e6 * np.eye(2), 3e6))
    assert found.adequacy.stated and found.adequacy.noise == pytest.approx(0.3) and 0.5 < found.adequacy.excess < 1.5
