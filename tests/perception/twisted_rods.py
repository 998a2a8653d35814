"""Rods of known twist, for the tests of Eq. 4."""

from dataclasses import replace

import numpy as np

from doo_ti import Material, Observations, relax
from doo_ti.rod.frames import total_twist
from tests.references.rods import chain, clamps_at, stacked

MATERIAL = Material(6e5, 4e5)
EDGES = 33
TWIST = np.radians([-250.0, -100.0, 30.0, 140.0, 305.0])


def twisted_rods() -> Observations:
    """In shapes that differ, observed without noise."""
    rods = []
    for twist, size in zip(TWIST, (0.5, 0.7, 0.9, 0.6, 0.8), strict=True):
        angle = np.linspace(-size, size, EDGES)
        tangents = np.stack([np.cos(angle), 0.4 * np.sin(2 * angle), np.sin(angle)], axis=1)
        rods.append(chain(tangents, [0, 1, 0], 3.0, spin=twist * np.arange(EDGES) / (EDGES - 1)))
    rods = stacked(rods)
    rods = replace(rods, rest_length=rods.rest_length[0])
    solution = relax(rods, MATERIAL, clamps_at(rods))
    assert (solution.converged & solution.stable).all()
    shape = solution.configuration
    return Observations(shape.vertices, rest_length=np.full(EDGES, 3.0), start_frame=shape.frames[:, 0],
                        end_frame=shape.frames[:, -1], total_twist=total_twist(shape.quaternions))
