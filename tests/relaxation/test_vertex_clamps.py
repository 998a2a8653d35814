"""Clamps at the end vertex itself, where the end edge has no length: second order in the edge."""

from dataclasses import replace

import numpy as np
import pytest

from doo_ti import Clamp, Configuration, Descent, Material, end_clamps, end_loads, hanging, relax, straight_rod
from tests.conftest import check_refused
from tests.references.rods import certified
from tests.references.test_heavy_cantilever import drooping

EI, LENGTH = 1e6, 300.0
EDGES = (20, 40, 80, 160)


@pytest.mark.thorough
def test_a_cantilever_is_held_at_its_vertex():
    elastica, errors = drooping(2 * LENGTH**3 / EI), []  # of unit μ, whose weight per length is two
    tip, moment = -LENGTH * elastica(1.0)[3], EI / LENGTH * abs(elastica(0.0)[1])
    for edges in EDGES:
        rod = straight_rod(LENGTH, edges, vertex_clamps=True)
        solution = certified(relax(rod, Material(EI, 0.8 * EI), end_clamps(rod, Clamp.FRAME, Clamp.FREE)))
        loads = end_loads(solution)
        errors.append([abs(-solution.configuration.vertices[0, -1, 2] / tip - 1),
                       abs(np.linalg.norm(loads.start_moment[0]) / moment - 1)])
    assert errors[-1][0] < 1e-4 and errors[-1][1] < 1e-3 and errors[-1][1] < errors[1][1] / 8


@pytest.mark.parametrize("kind", [Clamp.POSITION, Clamp.TANGENT, Clamp.FRAME])
def test_forces_of_a_buckled_rod_have_second_order(kind):
    forces = []
    for edges in (*EDGES, 320):
        rod, clamps = hanging(LENGTH, edges, (0, 0, 0), (240, 0, 0), vertex_clamps=True)
        clamps = replace(clamps, start=kind, end=kind, start_frame=np.eye(3)[None], end_frame=np.eye(3)[None])
        solution = relax(rod, Material(EI, 0.8 * EI, 1e-9), clamps)
        assert solution.converged.all()
        forces.append(solution.end_force[0, 0])
    limit = forces[-1] + (forces[-1] - forces[-2]) / 3
    errors = np.abs(np.array(forces) / limit - 1)
    assert errors[3] < 1e-3 and (errors[1:4] < errors[:3] / 3).all()


def test_only_outer_edges_may_have_no_length():
    rod = straight_rod(LENGTH, 10)
    for lengths in (np.array([30.0] * 4 + [0.0] + [30.0] * 5), np.array([0.0] + [30.0] * 8 + [-1.0])):
        wrong = Configuration(rod.start, rod.quaternions, lengths)
        check_refused("rest_length", relax, wrong, Material(EI, EI), end_clamps(rod))
    outer = straight_rod(LENGTH, 10, vertex_clamps=True)
    check_refused("Descent", relax, outer, Material(EI, EI), end_clamps(outer), Descent())
