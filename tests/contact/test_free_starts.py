"""Rods whose start is free converge as well as those held there; and edges without length, and long ones, beside obstacles."""

import numpy as np
import pytest

from doo_ti import Box, Capsule, Clamp, Configuration, Material, Newton, Plane, PointLoads, Sphere, relax, straight_rod
from doo_ti.contact.surroundings import Itself
from doo_ti.relaxation.sensitivity import gripper_jacobian
from doo_ti.rod.frames import unit_vectors
from doo_ti.rod.shapes import end_clamps, hanging
from tests.contact.clutter import gaps
from tests.references.rods import certified
from tests.relaxation.rods import wandering

LENGTH, RADIUS = 300.0, 3.0
FINE_ENDS = straight_rod(LENGTH, 30, vertex_clamps=True)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("edges", [4, 16])
def test_they_reach_the_tolerance_on_a_plane(rng, edges):
    """Vertex 0 takes no more of its way to the middle of an obstacle in a step than others. When it dived through, κ grew until
    residuals of 1e-2 counted as rounding."""
    rods = wandering(rng, 60, edges, LENGTH / edges, wander=2.0 / edges)
    bend = LENGTH**3 * 10 ** rng.uniform(-3, 1, 60)
    normal = unit_vectors(rng.normal(size=(60, 3)))
    lowest = np.einsum("rk,rvk->rv", normal, rods.vertices[:, -2:]).min(axis=1)
    floor = Plane(normal * (lowest - 0.02 * LENGTH - RADIUS)[:, None], normal)
    found = relax(rods, Material(bend, 0.7 * bend), end_clamps(rods, Clamp.FREE, Clamp.FRAME),
                  Newton(tolerance=1e-9, max_iterations=2000), obstacles=[floor], radius=RADIUS)
    assert found.converged.all() and found.residual.max() < 1e-4


@pytest.mark.parametrize("kind", [Clamp.POSITION, Clamp.TANGENT, Clamp.FRAME])
def test_straight_ones_in_any_direction(rng, kind):
    """The edges of a straight rod are parallel, but for rounding."""
    rods = Configuration.concatenate([straight_rod(LENGTH, 10, direction=way) for way in rng.normal(size=(200, 3))])
    clamps, far = end_clamps(rods, Clamp.FREE, kind), Sphere((1e4, 0, 0), 5.0)
    assert relax(rods, Material(3e6, 2e6), clamps, obstacles=[far], radius=1.0).converged.all()


@pytest.mark.parametrize("kind", [Clamp.POSITION, Clamp.FRAME])
@pytest.mark.parametrize("edges", [2, 8])
def test_under_a_load_at_their_start(rng, kind, edges):
    """The energy of a load may be negative; its rounding is not."""
    rods = wandering(rng, 100, edges, LENGTH / edges, wander=0.5)
    bend = LENGTH**3 * 10 ** rng.uniform(-3, 1, 100)
    force = np.zeros((100, edges + 1, 3))
    force[:, 0] = 30.0 * rng.normal(size=(100, 3)) * (bend / LENGTH**2)[:, None]
    found = relax(rods, Material(bend, 0.7 * bend), end_clamps(rods, Clamp.FREE, kind), external=PointLoads(force))
    assert found.converged.all()


@pytest.mark.parametrize("obstacle", [Sphere((0, 0, -22.2), 20.0), Box((0, 0, -22.2), (40, 40, 40)),
                                      Sphere((280, 0, -60), 20.0)], ids=["sphere", "box", "below the tip"])
def test_end_edges_without_length_beside_curved_obstacles(obstacle):
    found = certified(relax(FINE_ENDS, Material(1e6, 1e6), end_clamps(FINE_ENDS), obstacles=[obstacle], radius=2.0))
    assert gaps([obstacle], found.configuration.vertices, 2.0).min() > -1e-3


def test_rods_with_such_edges_beside_themselves_have_gaps_and_derivatives():
    found = relax(FINE_ENDS, Material(1e6, 1e6), end_clamps(FINE_ENDS), obstacles=[Itself()], radius=2.0)
    assert np.isfinite(found.contact.gap).all() and gripper_jacobian(found).usable.all()


def test_gaps_of_long_edges_are_those_of_their_nearest_places(rng):
    ropes, clamps = hanging(LENGTH, 7, start=np.zeros((20, 3)), end=(200.0, 0.0, 0.0))
    begin = np.stack([rng.uniform(40, 160, 20), np.full(20, -50.0), rng.uniform(-110, -80, 20)], axis=-1)
    pegs = Capsule(begin, (100.0, 50.0, -95.0), 6.0)
    found = relax(ropes, Material(1e4, 1e4), clamps, obstacles=[pegs], radius=1.0)
    touching = found.converged & (np.abs(found.contact_force).sum(axis=(1, 2)) > 0)
    assert touching.sum() > 5
    own = gaps([pegs], found.configuration.vertices, 1.0, along=2000)[touching]
    np.testing.assert_allclose(found.contact.gap[touching], own, atol=1e-5)
