"""F against dense linear algebra: energies, residuals and certificates, and that F leaves detected saddles.

B differs from edge to edge with its off-diagonal, β from vertex to vertex; rods are curved at rest, their rest lengths
uneven, and up is not z.
"""

import numpy as np
import pytest

from doo_ti import Clamp, Material, Newton, Springs, relax
from tests.oracle.external import where_found
from tests.references.rods import certified, chain, clamps_at, jiggled, planar, stacked
from tests.relaxation.rods import PAIRS, definite, wandering, with_kinds

EDGES = 6
UP = np.array([0.4, -0.5, 0.7])


@pytest.mark.thorough
@pytest.mark.parametrize("weight", [0.0, 300.0], ids=["weightless", "heavy"])
def test_every_pair_of_clamps(rng, weight):
    """The weight of heavy rods bends them about as much as their clamps do."""
    count = len(PAIRS)
    rods = wandering(rng, count, EDGES, rng.uniform(1, 6, EDGES), wander=0.25, twist=0.2)
    material = Material(definite(rng, count, EDGES), rng.uniform(1e5, 3e5, (count, EDGES - 1)), weight,
                        0.01 * rng.normal(size=(count, EDGES - 1, 2)))
    start, clamps = jiggled(rods, rng, 0.03), with_kinds(clamps_at(rods), PAIRS)
    solution = relax(start, material, clamps, Newton(tolerance=1e-9), up=UP)
    for row, names in enumerate(PAIRS):
        here = where_found(solution.configuration, material, clamps, row, UP)
        scale = abs(here.energy) + 1e-3 * np.abs(material.bend[row]).max() / start.rest_length[row].sum()
        softest = here.eigenvalues[0] / here.eigenvalues[-1]
        assert solution.status[row] == 0, names
        assert abs(solution.energy[row] - here.energy) < 1e-12 * (abs(here.energy) + scale), names
        assert here.residual < 1e-10 and here.closure < 1e-12, names
        # Rods that nothing holds against a rigid turn have no shape of their own, and no strict minimum.
        assert softest > -1e-11 and (solution.stable[row] or softest < 1e-7), names


@pytest.mark.parametrize("kinds", [(Clamp.FREE, Clamp.FREE), (Clamp.TANGENT, Clamp.FREE)], ids=["free", "tangent"])
def test_rods_at_rest_with_a_neutral_motion_have_converged(rng, kinds):
    """Nothing stops their spin, or moves them at all: no strict minimum, but at rest, with no energy left."""
    rods = wandering(rng, 64, EDGES)
    material = Material(definite(rng, 64), 1e5, 0.0, 0.01 * rng.normal(size=(64, 2)))
    solution = relax(rods, material, with_kinds(clamps_at(rods), [kinds] * 64))
    assert solution.converged.all() and solution.residual.max() < 1e-7 and np.abs(solution.energy).max() < 1e-6


def test_certificate_is_the_sign_of_the_smallest_eigenvalue(rng):
    rods = wandering(rng, 12, 8, 3.0, wander=0.4, twist=0.4)
    material = Material(definite(rng, 12), rng.uniform(2e4, 2e5, 12), 5.0)
    start, clamps = jiggled(rods, rng, 0.3), clamps_at(rods)
    for solver in (Newton(max_escapes=0), Newton()):
        solution = relax(start, material, clamps, solver)
        assert solution.converged.all()
        for row in range(12):
            here = where_found(solution.configuration, material, clamps, row)
            assert here.residual < 1e-8
            assert solution.stable[row] == (here.eigenvalues[0] > 0), (row, here.eigenvalues[:3])


@pytest.mark.sampled(1)
@pytest.mark.parametrize("precision", ["f64", "f32", "mixed"])
def test_ribbons_bent_exactly_about_their_stiff_axis_turn_over(precision):
    """Planar at 0° with the stiff direction in the plane: every rod is at a saddle, and every rod leaves it."""
    along = np.sin(2 * np.pi * np.arange(33) / 32)
    rods = stacked([planar(side * along, 3.0, distance) for distance in (42.0, 48.0, 54.0, 60.0, 66.0) for side in (-1.0, 1.0)])
    bend, ratio = (axis.ravel() for axis in np.meshgrid([5e4, 1.4e5, 4.2e5], [0.03, 0.1, 0.3]))
    material = Material.diagonal(bend, 3 * bend, bend * ratio)
    index = {"configuration_index": np.arange(10).repeat(9), "material_index": np.tile(np.arange(9), 10)}
    index["precision"] = precision
    resting = relax(rods, material, clamps_at(rods), Newton(max_escapes=0, tolerance=1e-6), **index)
    assert resting.converged.all() and not resting.stable.any()
    left = certified(relax(rods, material, clamps_at(rods), **index))
    assert (left.energy < resting.energy).all()


@pytest.mark.thorough
@pytest.mark.parametrize("other", [Clamp.FREE, Clamp.FRAME])
def test_an_upright_rod_under_springs_buckles_whatever_the_others_hold(other):
    """60 mm upright with a free tip, of half the critical stiffness 2 μ L³/7.84: a saddle, also beside a rod held at both ends,
    with which the kernel takes closure into account."""
    upright = chain(np.tile([0.0, 0.0, 1.0], (20, 1)), [1, 0, 0], 3.0)
    beside = chain(np.tile([1.0, 0.0, 0.0], (20, 1)), [0, 0, 1], 3.0, spin=0.05 * np.arange(20))
    rods = stacked([upright, jiggled(beside, np.random.default_rng(0), 0.1)])
    clamps = with_kinds(clamps_at(rods), [(Clamp.FRAME, Clamp.FREE), (Clamp.FRAME, other)])
    springs = Springs(np.zeros((1, 21, 3)), np.zeros((1, 21)))
    for bend, stands in ((8e4, True), (3e4, False)):
        resting = relax(rods, Material(bend, 1e5), clamps, Newton(max_escapes=0), external=springs)
        assert resting.converged[0] and resting.stable[0] == stands
        left = relax(rods, Material(bend, 1e5), clamps, external=springs)
        assert left.stable[0] and (abs(left.configuration.vertices[0, -1, 2] - 60.0) < 1e-6) == stands
