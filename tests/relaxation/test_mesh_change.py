"""By how much rods of a mesh rest elsewhere than continuous ones, as estimated by edges half as long."""

import numpy as np
from scipy.integrate import cumulative_trapezoid, solve_bvp

import doo_ti as d
from doo_ti.contact.surroundings import Surroundings
from doo_ti.relaxation.relax import clamp_change, mesh_change

LENGTH, EDGES, BEND = 300.0, 20, 3e6
MATERIAL = d.Material(BEND, BEND, 1.0)


def cantilever(held_length: float) -> tuple[np.ndarray, np.ndarray]:
    """(N, 2) mm places and (N,) arc lengths of a rod, stiff over ``held_length``: EI φ'' = w (L − s) cos φ, EI/w = bend/2."""
    found = solve_bvp(lambda s, y: np.stack([y[1], 2 * (LENGTH - s) * np.cos(y[0]) / BEND]),
                      lambda start, end: np.array([start[0], end[1]]),
                      np.linspace(held_length, LENGTH, 200), np.zeros((2, 200)), tol=1e-9, max_nodes=20_000)
    s = np.linspace(held_length, LENGTH, 20_001)
    angle = found.sol(s)[0]
    tangents = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return [held_length, 0] + cumulative_trapezoid(tangents, s, axis=0, initial=0), s


def test_a_cantilever_and_its_elastica():
    """Which bends from the middle of the edge that the clamp holds, or from its own end vertex."""
    rod = d.straight_rod(LENGTH, EDGES)
    clamps = d.end_clamps(rod, d.Clamp.FRAME, d.Clamp.FREE)
    rest = d.relax(rod, MATERIAL, clamps).configuration
    arc = np.linspace(0, LENGTH, EDGES + 1)[3:]
    change, moved = (change(rest, MATERIAL, clamps, (0, 0, 1), Surroundings())[0] for change in (mesh_change, clamp_change))
    assert rest.vertices[0, -1, 2] < -50
    for found, held, tolerance in ((change, 0.5 * LENGTH / EDGES, 0.1), (moved, 0.0, 0.6)):
        points, s = cantilever(held)
        true = np.stack([np.interp(arc, s, points[:, 0]), np.interp(arc, s, points[:, 1])], axis=1)
        off = true - rest.vertices[0, 3:, [0, 2]].T
        assert np.linalg.norm(off[-1]) > 10 * tolerance
        np.testing.assert_allclose(found[3:, [0, 2]], off, atol=tolerance)
        assert np.abs(found[:, 1]).max() < 1e-9 and np.abs(found[0]).max() < 1e-9


def test_a_rope_between_hinges_with_a_rest_curvature_of_its_own():
    """Against one of 160 edges, whose every eighth vertex is at the same place along it."""
    def rope(edges: int):
        along = np.cos(np.linspace(0, 2, edges + 1)[1:-1])
        theta = d.Material(BEND, BEND, 1.0, rest_curvature=0.01 * np.stack([along, 0.5 * along], axis=-1)[None])
        start, clamps = d.hanging(LENGTH, edges, start=(0, 0, 0), end=(200, 0, 40), clamp=d.Clamp.POSITION)
        return d.relax(start, theta, clamps, d.Newton.careful()).configuration, theta, clamps

    coarse, theta, clamps = rope(EDGES)
    off = rope(8 * EDGES)[0].vertices[0, ::8] - coarse.vertices[0]
    change = mesh_change(coarse, theta, clamps, (0, 0, 1), Surroundings())[0]
    assert np.abs(off).max() > 0.05
    np.testing.assert_allclose(change, off, atol=0.25 * np.abs(off).max())
