"""Arrows of contact forces: in N where the weight per length of the rods is known."""

import numpy as np

from doo_ti import Plane, Surroundings
from doo_ti.report.touched import Touched


def test_arrows_in_newton():
    positions = np.zeros((2, 1, 5, 3))
    positions[..., 0] = 25.0 * np.arange(5)
    force = np.zeros_like(positions)
    force[..., 2] = 40.0
    around = Surroundings([Plane((0, 0, 0), (0, 0, 1))], 1.0)
    plain, known = Touched(around, positions, force), Touched(around, positions, force, np.array([1e-3, 5e-4]))
    assert plain.legend.endswith("mm²/mm)") and known.legend.endswith(" N)")
    length = [np.linalg.norm(known.arrows(row, 0)[1], axis=-1) / known.arrow_scale for row in (0, 1)]
    np.testing.assert_allclose(length, np.array([[0.04], [0.02]]) * np.ones(5))
    shown = float(known.legend.split("10 mm: ")[1].split()[0])
    np.testing.assert_allclose(np.linalg.norm(known.arrows(0, 0)[1], axis=-1), 10 * 0.04 / shown)
