"""Both clamps on one line: an experiment that hardly depends on Θ, and planar rods at a saddle.

The paper's rod, 99 mm in 33 edges, both end tangents along the line between the ends, weight 1.
"""

import numpy as np
import pytest
from scipy.optimize import brentq

from doo_ti import Configuration, Material, Newton, relax
from tests.oracle.external import relaxed
from tests.references.rods import chain, clamps_at, stacked

EDGES, EDGE = 33, 3.0


def bow(distance: float, rotation: float, side: float = -1.0) -> Configuration:
    """An even bow in the vertical plane, hanging (side −1) or standing (1), its end turned by ``rotation`` degrees."""
    along = np.arange(EDGES) / (EDGES - 1)
    shape = np.sin(2 * np.pi * along)
    size = brentq(lambda a: np.sum(EDGE * np.cos(a * shape)) - distance, 0, 2)
    tangents = np.stack([np.cos(size * shape), 0 * shape, side * np.sin(size * shape)], axis=1)
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


@pytest.mark.thorough
@pytest.mark.parametrize(("distance", "side", "ratio"), [(42.0, -1, 0.2), (54.0, -1, 0.1), (66.0, 1, 1.0)],
                         ids=["42 mm, little twist", "54 mm, little twist", "standing"])
def test_planar_saddle_at_0_degrees_is_named_and_left(distance, side, ratio):
    """With low twist stiffness a hanging bow leaves its plane, and a standing bow falls over; started exactly in the plane,
    only the certificate shows it."""
    rod, material = bow(distance, 0.0, side), Material(6e5, 6e5 * ratio, 1.0)
    clamps = clamps_at(rod)
    dense = relaxed(rod, material, clamps, leave_saddles=False)
    assert dense.converged and not dense.stable
    stopped = relax(rod, material, clamps, Newton(max_escapes=0))
    assert stopped.converged.all() and not stopped.stable.any()
    assert stopped.energy[0] == pytest.approx(dense.energy, rel=1e-9)
    assert np.abs(stopped.configuration.vertices[..., 1]).max() < 1e-6
    left = relax(rod, material, clamps)
    assert left.converged.all() and left.stable.all()
    assert left.energy[0] < stopped.energy[0] - 1e-4 * abs(stopped.energy[0])
    assert left.energy[0] == pytest.approx(relaxed(rod, material, clamps).energy, rel=1e-8)


def test_stiff_enough_in_twist_the_planar_bow_is_stable():
    rods = stacked([bow(distance, 0.0) for distance in (42.0, 54.0, 66.0)])
    solution = relax(rods, Material(6e5, 6e5, 1.0), clamps_at(rods))
    assert solution.converged.all() and solution.stable.all()
    assert np.abs(solution.configuration.vertices[..., 1]).max() < 1e-6
