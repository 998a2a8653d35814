"""Rods with a free end under springs at their vertices: the Riccati sweep against dense f64 linear algebra."""

from itertools import product

import numpy as np
import pytest

from doo_ti import Clamp, Descent, Material, Newton, Springs, relax
from tests.conftest import check_refused
from tests.oracle.chain_form import rod_of
from tests.oracle.equilibrium import clamped_start, free_variables
from tests.oracle.external import Springs as DenseSprings
from tests.oracle.external import newton_step
from tests.references.rods import certified, clamps_at, jiggled
from tests.relaxation.rods import assert_same, definite, wandering, with_kinds

STARTS = (Clamp.POSITION, Clamp.TANGENT, Clamp.FRAME)
ENDS = tuple((start, Clamp.FREE) for start in STARTS)
ALL_ENDS = tuple(product(Clamp, Clamp))
UP = np.array([0.4, -0.5, 0.7])
EDGES = 7


def rods_under_springs(rng, count: int, isotropic: bool, ends=ENDS):
    """``count`` rods for each pair of ``ends``, and springs to points some way off their vertices, a few of none."""
    kinds, total = [pair for pair in ends for _ in range(count)], count * len(ends)
    rods = wandering(rng, total, EDGES, rng.uniform(1, 6, EDGES), wander=0.2, twist=0.2)
    if isotropic:
        material = Material(rng.uniform(1e5, 3e5, total), rng.uniform(1e5, 3e5, total), 100.0)
    else:
        material = Material(definite(rng, total, EDGES), rng.uniform(1e5, 3e5, (total, EDGES - 1)), 100.0,
                            0.01 * rng.normal(size=(total, EDGES - 1, 2)))
    stiffness = 300.0 * rng.uniform(0, 1, (total, EDGES + 1)) * (rng.uniform(size=(total, EDGES + 1)) < 0.8)
    springs = Springs(rods.vertices + 2.0 * rng.normal(size=rods.vertices.shape), stiffness)
    return jiggled(rods, rng, 0.03), with_kinds(clamps_at(rods), kinds), material, springs


def dense(springs: Springs, row: int) -> DenseSprings:
    return DenseSprings.at_vertices(springs.stiffness[row], springs.points[row])


@pytest.mark.sampled(1)
@pytest.mark.parametrize("isotropic", [True, False], ids=["isotropic", "general"])
def test_one_step_is_the_dense_one(rng, isotropic):
    """Second trip of the loop: the frames the first step leads to."""
    start, clamps, material, springs = rods_under_springs(rng, 3, isotropic)
    near = relax(start, material, clamps, Newton(tolerance=1e-7), up=UP, external=springs).configuration
    start = jiggled(near, rng, 0.004)
    option = Newton(first_shift=0.0, max_iterations=2, max_rotation=1.0, tolerance=1e-28, max_escapes=0)
    after = relax(start, material, clamps, option, up=UP, external=springs)
    steps = 0
    for row in range(start.count):
        rod = rod_of(start, material, row, up=UP)
        state, ends = clamped_start(start, clamps, row)
        free = free_variables(rod, ends)
        if isotropic and STARTS[row // 3] != Clamp.FRAME:
            free = free[free != 3]  # the spin of a round rod is held
        if (expected := newton_step(rod, dense(springs, row), state, ends, free)) is not None:
            steps += 1
            frames = after.configuration.quaternions[row]
            same_sign = np.sign(np.sum(frames * expected.quaternions, axis=1))[:, None]
            # The trace on the diagonal, 1e-12 of it, shows in the softest motion.
            assert np.abs(frames - same_sign * expected.quaternions).max() < 2e-9
    assert steps >= 6


@pytest.mark.sampled(1)
@pytest.mark.parametrize("precision", ["f64", "f32", "mixed"])
def test_long_rods_are_pulled_to_their_points(rng, precision):
    """33 edges, stiff springs: the vertices come to the points, whose polygon has the rod's lengths."""
    rods = wandering(rng, 20, 33, 3.0)
    clamps, springs = clamps_at(rods, Clamp.FRAME, Clamp.FREE), Springs(rods.vertices, np.full((20, 34), 1e5))
    start = jiggled(rods, rng, 0.02)
    solution = certified(relax(start, Material(1e5, 1e5, 1.0), clamps, precision=precision, external=springs))
    assert np.linalg.norm(solution.configuration.vertices - rods.vertices, axis=-1).max() < 0.2


def test_rods_share_springs_by_index(rng):
    start, clamps, material, springs = rods_under_springs(rng, 2, True)
    rows = np.array([2, 2, 0, 1, 5, 3])
    picked = Springs(springs.points[rows], springs.stiffness[rows])
    one = relax(start, material, clamps, external=springs, external_index=rows)
    assert_same(one, slice(None), relax(start, material, clamps, external=picked), slice(None))


def test_wrong_input_is_reported_in_one_sentence(rng):
    start, clamps, material, springs = rods_under_springs(rng, 1, True)
    few = Springs(np.zeros((3, 4, 3)), np.zeros((3, 4)))
    for options, said in (({"solver": Descent(), "external": springs}, "external energy"), ({"external": few}, "vertices"),
                          ({"external": springs, "external_index": [0, 1, 9]}, "external_index"),
                          ({"external_index": [0, 1, 2]}, "external")):
        check_refused(said, relax, start, material, clamps, **options)
    check_refused("stiffness", Springs, np.zeros((1, 4, 3)), -np.ones((1, 4)))
