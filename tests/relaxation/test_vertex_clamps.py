"""Clamps at the end vertex itself, where the end edge has no length: second order in the edge."""

import numpy as np
import pytest
from scipy.integrate import solve_bvp

from doo_ti import Clamp, Clamps, Configuration, Descent, Material, end_clamps, end_loads, hanging, relax, straight_rod
from tests.conftest import check_refused

EI, LENGTH = 1e6, 300.0
EDGES = (20, 40, 80, 160)


def cantilever() -> tuple[float, float]:
    """Droop of the tip, mm, and moment at the clamp, mm², of a heavy elastica of unit μ, whose weight per length is two."""
    s, y = np.linspace(0, LENGTH, 401), np.zeros((4, 401))
    y[0] = s
    for weight in np.linspace(0.1, 2.0, 20):
        found = solve_bvp(
            lambda s, y, w=weight: np.array([np.cos(y[2]), np.sin(y[2]), y[3], w * np.cos(y[2]) * (LENGTH - s) / EI]),
            lambda a, b: np.array([a[0], a[1], a[2], b[3]]), s, y, tol=1e-10, max_nodes=100_000)
        s, y = found.x, found.y
    return abs(y[1, -1]), EI * abs(y[3, 0])


@pytest.mark.thorough
def test_a_cantilever_is_held_at_its_vertex():
    tip, moment = cantilever()
    errors = []
    for edges in EDGES:
        rod = straight_rod(LENGTH, edges, vertex_clamps=True)
        solution = relax(rod, Material(EI, 0.8 * EI), end_clamps(rod, Clamp.FRAME, Clamp.FREE))
        assert solution.converged.all() and solution.stable.all()
        loads = end_loads(solution)
        errors.append([abs(-solution.configuration.vertices[0, -1, 2] / tip - 1),
                       abs(np.linalg.norm(loads.start_moment[0]) / moment - 1)])
    print(np.array(errors))
    assert errors[-1][0] < 1e-4 and errors[-1][1] < 1e-3 and errors[-1][1] < errors[1][1] / 8


@pytest.mark.parametrize("kind", [Clamp.POSITION, Clamp.TANGENT, Clamp.FRAME])
def test_forces_of_a_buckled_rod_have_second_order(kind):
    forces = []
    for edges in (*EDGES, 320):
        rod, clamps = hanging(LENGTH, edges, (0, 0, 0), (240, 0, 0), vertex_clamps=True)
        frame = np.eye(3)[None]
        clamps = Clamps(kind, kind, clamps.start_position, clamps.end_position, frame, frame)
        solution = relax(rod, Material(EI, 0.8 * EI, 1e-9), clamps)
        assert solution.converged.all()
        forces.append(solution.end_force[0, 0])
    limit = forces[-1] + (forces[-1] - forces[-2]) / 3
    errors = np.abs(np.array(forces) / limit - 1)
    print(errors)
    assert errors[3] < 1e-3 and (errors[1:4] < errors[:3] / 3).all()


def test_only_outer_edges_may_have_no_length():
    rod = straight_rod(LENGTH, 10)
    for lengths in (np.array([30.0] * 4 + [0.0] + [30.0] * 5), np.array([0.0] + [30.0] * 8 + [-1.0])):
        wrong = Configuration(rod.start, rod.quaternions, lengths)
        check_refused("rest_length", relax, wrong, Material(EI, EI), end_clamps(rod))
    outer = straight_rod(LENGTH, 10, vertex_clamps=True)
    check_refused("Descent", relax, outer, Material(EI, EI), end_clamps(outer), Descent())
