"""A Newton step of rods in contact against dense f64 linear algebra with the same contacts."""

from dataclasses import replace

import numpy as np

from doo_ti import Clamp, Material, Newton, Plane, relax, straight_rod
from doo_ti.relaxation.contact_table import BENDING_LOADS, SOFT
from tests.oracle.algebra import spun_and_tilted
from tests.oracle.chain_form import rod_of
from tests.oracle.equilibrium import clamped_start, free_variables, vertices_of
from tests.oracle.external import Springs, newton_step
from tests.references.rods import clamps_at, jiggled
from tests.relaxation.rods import with_kinds

STARTS = (Clamp.POSITION, Clamp.TANGENT, Clamp.FRAME)
NORMAL = np.array([0.1, -0.2, 1.0]) / np.sqrt(1.05)
EDGES, LENGTH, RADIUS, STIFFNESS, WEIGHT = 9, 90.0, 4.0, 1e5, 3.0
EACH = 12


def test_a_step_is_that_of_dense_linear_algebra():
    """Of heavy rods that are a little inside a plane, to 1e-9: a vertex inside is under a spring along the normal, of the
    stiffness of contacts at first."""
    rng = np.random.default_rng(3)
    count = EACH * len(STARTS)
    height = (RADIUS + 2.0 + 6.0 * rng.uniform(size=(count, 1))) * NORMAL
    rods = replace(straight_rod(LENGTH, EDGES).take([0] * count), start=height)
    clamps = with_kinds(clamps_at(rods), [(start, Clamp.FREE) for start in STARTS for _ in range(EACH)])
    material = Material(STIFFNESS, STIFFNESS, WEIGHT)
    contact = dict(obstacles=[Plane((0, 0, 0), NORMAL)], radius=RADIUS)
    rest = relax(rods, material, clamps, **contact)
    assert rest.converged.all() and (rest.contact.touching.sum(axis=1) >= 1).all()
    start = jiggled(rest.configuration, rng, 2e-3)
    once = Newton(first_shift=0.0, max_iterations=2, max_rotation=1.0, tolerance=1e-28, max_escapes=0)
    after = relax(start, material, clamps, once, **contact)
    stiffness = (BENDING_LOADS * STIFFNESS / LENGTH**2 + 2.0 * WEIGHT * LENGTH / EDGES) / (SOFT * RADIUS)
    inside = []
    for row in range(start.count):
        rod = replace(rod_of(start, material, row), turned=spun_and_tilted)
        state, ends = clamped_start(start, clamps, row)
        free = free_variables(rod, ends)
        if STARTS[row // EACH] != Clamp.FRAME:
            free = free[free != 3]  # the spin of a round rod is held
        vertices = vertices_of(rod, state)  # the clamps turn the first edge
        gap = vertices @ NORMAL - RADIUS
        pressed = gap < 0
        matrices = stiffness * pressed[:, None, None] * np.outer(NORMAL, NORMAL)
        springs = Springs.at_vertices(matrices, vertices - gap[:, None] * NORMAL)
        expected = newton_step(rod, springs, state, ends, free)
        if expected is None:
            continue
        frames = after.configuration.quaternions[row]
        if np.abs(frames - state.quaternions).max() < 1e-12:
            continue  # refused: the energy has kinks where other vertices touch after the step
        same_sign = np.sign(np.sum(frames * expected.quaternions, axis=1))[:, None]
        assert np.abs(frames - same_sign * expected.quaternions).max() < 1e-9
        inside.append(pressed.sum())
    assert len(inside) >= 6 and sum(inside) >= 30
