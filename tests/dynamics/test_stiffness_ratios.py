"""Motions of rods whose stiffness differs by up to 1e9: where they come to rest a dense Newton's method, in which every unknown
is scaled by its own stiffness, has nothing left to do; or they say that they failed."""

from types import SimpleNamespace

import numpy as np
import pytest

from doo_ti import Configuration, Dynamics, Grippers, Material, Stepping, relax, simulate
from tests.relaxation.test_stiffness_ratios import KINDS, LENGTH, RATIOS, SHAPE, SOFT, material, poses, resolved

INSTANTS = 61


@pytest.mark.parametrize("pose", range(6))
@pytest.mark.thorough
def test_a_motion_comes_to_rest_where_the_scaled_solve_does(pose):
    rod, held = poses()
    clamps = held[pose]
    begun = relax(rod, Material(SOFT, SOFT), clamps).configuration
    cases = [(kind, ratio) for kind in KINDS for ratio in RATIOS[::3]]
    materials = [material(*case) for case in cases]
    edges = rod.edges
    bend = np.concatenate([np.broadcast_to(one.bend, (1, edges, 2, 2)) for one in materials])
    twist = np.concatenate([np.broadcast_to(one.twist, (1, edges - 1)) for one in materials])
    still = Grippers.resting(clamps, INSTANTS)
    motion = simulate(begun, Material(bend, twist), still, Dynamics(drag=20.0), Stepping(10.0))
    failed = ~motion.converged
    assert np.isnan(motion.positions[failed, -1]).all(), "a rod that failed has no place"
    off = []
    for row in np.flatnonzero(~failed):
        ended = Configuration(motion.positions[row : row + 1, -1, 0], motion.memory.frames[row : row + 1], begun.rest_length)
        apart = resolved(SimpleNamespace(configuration=ended), materials[row], clamps) - ended.vertices[0]
        off.append(np.linalg.norm(apart, axis=-1).max() / LENGTH)
    print(f"pose {pose}: {failed.sum()} of {len(cases)} failed and say so, the others are off by {max(off):.1e} of the length")
    assert max(off) < SHAPE
    ratios = np.array([ratio for _, ratio in cases])
    assert not failed[ratios <= 1e3].any()
    assert failed.mean() < 0.5
