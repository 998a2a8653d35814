"""Both clamps on one line: an experiment that hardly depends on Θ, and planar rods.

The paper's rod, 99 mm in 33 edges, both end tangents along the line between the ends, weight 1.
"""

import numpy as np
from scipy.optimize import brentq

from doo_ti import Configuration, Material, relax
from tests.references.rods import chain, clamps_at, stacked

EDGES, EDGE = 33, 3.0


def bow(distance: float, rotation: float) -> Configuration:
    """An even bow that hangs in the vertical plane, its end turned by ``rotation`` degrees."""
    along = np.arange(EDGES) / (EDGES - 1)
    shape = np.sin(2 * np.pi * along)
    size = brentq(lambda a: np.sum(EDGE * np.cos(a * shape)) - distance, 0, 2)
    tangents = np.stack([np.cos(size * shape), 0 * shape, -np.sin(size * shape)], axis=1)
    return chain(tangents, [0, 1, 0], EDGE, spin=np.radians(rotation) * along)


def largest_movement(distance: float, rotation: float) -> float:
    """Farthest any vertex gets from where the range's middle has it, mm: bend and twist ratio over a factor 25 each."""
    bend, ratio = (grid.ravel() for grid in np.meshgrid(np.geomspace(4e5, 1e7, 9), np.geomspace(0.24, 6.0, 9)))
    rod = bow(distance, rotation)
    solution = relax(rod, Material(bend, bend * ratio, 1.0), clamps_at(rod))
    assert solution.converged.all() and solution.stable.all()
    vertices = solution.configuration.vertices
    return np.linalg.norm(vertices - vertices[len(vertices) // 2], axis=2).max()


def test_54_mm_and_120_degrees_is_nearly_blind_to_the_parameters():
    movement = {rotation: largest_movement(54.0, rotation) for rotation in (60, 120, 180)}
    print(f"\nlargest vertex movement over 25 × 25-fold bend and twist ratio, 54 mm: {movement}")
    assert movement[120] < 0.6
    assert movement[60] > 3 * movement[120] and movement[180] > 3 * movement[120]


def test_stiff_enough_in_twist_the_planar_bow_is_stable():
    rods = stacked([bow(distance, 0.0) for distance in (42.0, 54.0, 66.0)])
    solution = relax(rods, Material(6e5, 6e5, 1.0), clamps_at(rods))
    assert solution.converged.all() and solution.stable.all()
    assert np.abs(solution.configuration.vertices[..., 1]).max() < 1e-6
