"""F against dense linear algebra, one batch of every pair of clamps: energies, residuals and certificates of the same rods.

B differs from edge to edge with its off-diagonal, β from vertex to vertex; rods are curved at rest, their rest lengths
uneven, and up is not z.
"""

import numpy as np
import pytest

from doo_ti import Clamp, Material, Newton, relax
from tests.oracle.chain_form import rod_of
from tests.oracle.equilibrium import State, clamped_start
from tests.oracle.external import minimum, relaxed
from tests.references.rods import clamps_at, jiggled
from tests.relaxation.rods import PAIRS, definite, wandering, with_kinds

EDGES = 6
UP = np.array([0.4, -0.5, 0.7])
# Their weights bend these rods about as much as their clamps do.
WEIGHTS = {"weightless": 0.0, "heavy": 300.0}


def general_rods(rng, weight: float):
    """One rod for each pair of clamps: start, clamps and material tables."""
    count = len(PAIRS)
    rods = wandering(rng, count, EDGES, rng.uniform(1, 6, EDGES), wander=0.25, twist=0.2)
    material = Material(definite(rng, count, EDGES), rng.uniform(1e5, 3e5, (count, EDGES - 1)), weight,
                        0.01 * rng.normal(size=(count, EDGES - 1, 2)))
    return jiggled(rods, rng, 0.03), with_kinds(clamps_at(rods), PAIRS), material


@pytest.mark.thorough
@pytest.mark.parametrize("weight", WEIGHTS)
def test_every_pair_of_clamps(rng, weight):
    start, clamps, material = general_rods(rng, WEIGHTS[weight])
    solution = relax(start, material, clamps, Newton(tolerance=1e-9), up=UP)
    for row, kinds in enumerate(PAIRS):
        rod = rod_of(start, material, row, up=UP)
        found = State(solution.configuration.start[row], solution.configuration.quaternions[row])
        here = minimum(rod, None, found, clamped_start(start, clamps, row)[1], max_iterations=0)
        names = " - ".join(kind.name.lower() for kind in kinds)
        scale = abs(here.energy) + 1e-3 * np.abs(rod.bend).max() / rod.rest_length.sum()
        softest = here.smallest_eigenvalue / here.eigenvalues[-1]
        print(f"{weight}, {names}: energy {here.energy:.6g}, residual {here.residual:.1e}, softest eigenvalue {softest:.1e}")
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
    print(f"residuals up to {solution.residual.max():.1e}, {np.sum(~solution.converged)} of 64 not converged")
    assert solution.residual.max() < 1e-7 and np.abs(solution.energy).max() < 1e-6
    assert solution.converged.all()


@pytest.mark.thorough
def test_isotropic_rods_that_may_spin(rng):
    """αI with both spins free turns about itself at no cost: F holds one spin, and its energies are the oracle's."""
    kinds = [(Clamp.POSITION, Clamp.POSITION), (Clamp.TANGENT, Clamp.POSITION), (Clamp.TANGENT, Clamp.TANGENT)]
    rods = wandering(rng, 3, EDGES, rng.uniform(1, 6, EDGES), wander=0.25, twist=0.2)
    start, clamps, material = jiggled(rods, rng, 0.03), with_kinds(clamps_at(rods), kinds), Material(2e5, 1.5e5, 300.0)
    solution = relax(start, material, clamps, Newton(tolerance=1e-9), up=UP)
    assert solution.converged.all() and solution.stable.all()
    errors = [abs(solution.energy[row] / relaxed(start, material, clamps, row, up=UP).energy - 1) for row in range(3)]
    print(f"isotropic, spins free: energies within {max(errors):.1e}")
    assert max(errors) < 1e-9
