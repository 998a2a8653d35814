"""Rods at rest amid obstacles: outside all of them, and in equilibrium by an independent computation."""

import numpy as np
import pytest

from doo_ti import Box, Capsule, Cylinder, Plane, Ring, Sphere, Status, relax
from tests.contact.clutter import OBSTACLES, RADIUS, differences, gaps, sagging
from tests.oracle.external import where_found


@pytest.fixture(scope="module")
def rested():
    """(solution, material, clamps) of rods amid obstacles of all kinds."""
    start, material, clamps = sagging(np.random.default_rng(5), 128)
    return relax(start, material, clamps, obstacles=OBSTACLES, radius=RADIUS), material, clamps


def test_most_rods_converge_outside_the_obstacles_and_the_rest_are_flagged(rested):
    solution, _, _ = rested
    feasible = solution.status != Status.INFEASIBLE
    assert feasible.mean() > 0.5 and solution.converged[feasible].mean() >= 0.99
    assert solution.stable[solution.converged].mean() > 0.97
    gap = gaps(OBSTACLES, solution.configuration.vertices[solution.converged], RADIUS)
    assert gap.min() > -1e-3 * RADIUS and np.median(gap) < 1e-3 * RADIUS, "inside, or hardly any rod touches"


@pytest.mark.parametrize("most", [12, pytest.param(40, marks=pytest.mark.thorough)])
def test_forces_balance_and_push_where_rods_touch(rested, most):
    """The moments of bending, twist, gravity and contact on the free edges, less those of the clamp, and the energy, dense."""
    solution, material, clamps = rested
    forces = solution.tables.contact.forces
    rows = np.flatnonzero(solution.converged & (np.abs(forces) > 0).any(axis=(1, 2)))[:most]
    assert len(rows) > most / 2
    for row in rows:
        here = where_found(solution.configuration, material, clamps, row, force=forces[row])
        assert here.residual * 100.0 * min(1.0, material.bend[row].max() / 1e4) < 1e-7
        # That of the rod alone, without what closes the gaps of contacts, which depends on the solver.
        energy = here.energy + (forces[row] * solution.configuration.vertices[row]).sum()
        assert solution.energy[row] == pytest.approx(energy, abs=1e-10 * material.bend[row].max() / 100.0, rel=1e-10)
    x = solution.configuration.vertices[rows]
    near = np.min([obstacle.distance(x)[0] for obstacle in OBSTACLES], axis=0) - RADIUS
    pushed = np.linalg.norm(forces[rows], axis=-1) > 1e-6
    # A force on an edge is shared by its two vertices, which an edge's length at most lies between.
    assert near[pushed].max() < 3.1


@pytest.mark.parametrize("obstacle", [
    Plane((1, 2, 3), (1, -2, 2)), Sphere((1, 2, 3), 4.0), Capsule((1, 2, 3), (4, 4, 4), 2.0),
    Cylinder((1, 2, 3), (4, 4, 4), 2.0), Ring((1, 2, 3), (1, 2, 0), 5.0, 1.0), Box((1, 2, 3), (2, 4, 6))],
    ids=lambda obstacle: type(obstacle).__name__)
def test_the_normal_is_the_gradient_of_the_distance(obstacle, rng):
    points = rng.normal(scale=8.0, size=(1, 400, 3)) + [1, 2, 3]
    _, normal = obstacle.distance(points)
    off = np.abs(differences(obstacle, points) - normal).max(axis=-1)
    # Beside a medial axis a difference may straddle it.
    assert np.quantile(off, 0.98) < 1e-7
    assert np.allclose(np.linalg.norm(normal, axis=-1), 1.0)
