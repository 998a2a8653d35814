"""The oracle against itself: two forms of one energy with their derivatives, minima by scipy."""

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from doo_ti import Clamp
from tests.oracle.algebra import body_rotated, directors, gradient_and_hessian, seeds
from tests.oracle.chain_form import Rod, chain_derivatives, chain_energy
from tests.oracle.equilibrium import Ends, State, closed, free_variables, moved, vertices_of
from tests.oracle.external import Springs, minimum, total_energy
from tests.oracle.vertex_form import vertex_energy


def random_rod(rng, edges: int) -> Rod:
    """Uneven lengths, a general B and rest curvature per edge and vertex, and a slanted up."""
    root = rng.normal(size=(edges, 2, 2)) * 300
    up = rng.normal(size=3)
    return Rod(
        rest_length=rng.uniform(2, 4, edges), bend=root @ np.swapaxes(root, 1, 2) + 2e4 * np.eye(2),
        twist=rng.uniform(1e4, 9e4, edges - 1), weight=1.3, rest_curvature=rng.normal(size=(edges - 1, 2)) * 0.02,
        up=up / np.linalg.norm(up))


def random_state(rng, edges: int, bending=0.5) -> State:
    frames = Rotation.random(random_state=rng)
    chain = [frames]
    for _ in range(edges - 1):
        chain.append(chain[-1] * Rotation.from_rotvec(rng.normal(size=3) * bending))
    return State(rng.normal(size=3) * 20, np.array([frame.as_quat(scalar_first=True) for frame in chain]))


def test_vertex_form_is_the_chain_form_with_its_derivatives(rng):
    """Bishop frames, differentiated twice, against the pair formulas: nothing but the definitions in common."""
    rod, state = random_rod(rng, edges=4), random_state(rng, edges=4)
    w = seeds(12)
    frames = [directors(body_rotated(list(q), w[3 * j : 3 * j + 3])) for j, q in enumerate(state.quaternions)]
    vertices = [list(state.start)]
    for length, frame in zip(rod.rest_length, frames, strict=True):
        vertices.append([x + length * t for x, t in zip(vertices[-1], frame[0], strict=True)])
    parts = vertex_energy(vertices, [f[1] for f in frames], [f[2] for f in frames], rod.rest_length, rod.bend, rod.twist,
                          rod.weight, rod.rest_curvature, rod.up)
    np.testing.assert_allclose([part.value for part in parts], chain_energy(rod, state.start, state.quaternions), rtol=1e-12)
    whole = gradient_and_hessian(sum(parts), (), 12)
    gradient, hessian = chain_derivatives(rod, state.quaternions)
    np.testing.assert_allclose(whole[0], gradient, rtol=0, atol=1e-12 * np.abs(gradient).max())
    np.testing.assert_allclose(whole[1], hessian, rtol=0, atol=1e-12 * np.abs(hessian).max())


def problem(rng, edges: int):
    """A rod, its state, and springs at most vertices, blind in one direction, to targets some 4 mm off."""
    rod, state = random_rod(rng, edges=edges), random_state(rng, edges=edges, bending=0.2)
    vertices, k = vertices_of(rod, state), 200.0 * rng.uniform(0.5, 2.0, edges + 1)
    k[1] = 0.0
    sight = rng.normal(size=(edges + 1, 3))
    sight /= np.linalg.norm(sight, axis=1, keepdims=True)
    matrices = k[:, None, None] * (np.eye(3) - sight[:, :, None] * sight[:, None, :])
    return rod, state, Springs.at_vertices(matrices, vertices + 4.0 * rng.normal(size=vertices.shape))


@pytest.mark.sampled(1)
@pytest.mark.parametrize(("edges", "start", "end"), [(4, Clamp.FRAME, Clamp.FREE), (5, Clamp.TANGENT, Clamp.FREE),
                                                      (3, Clamp.POSITION, Clamp.FREE), (5, Clamp.FRAME, Clamp.FRAME)])
def test_minimum_against_a_general_optimiser(rng, edges, start, end):
    """scipy's SLSQP, which uses values only, returns to the minimum of the dense solver."""
    rod, state, springs = problem(rng, edges)
    vertices = vertices_of(rod, state)
    ends = Ends(start, end, vertices[0], None if end == Clamp.FREE else vertices[-1])
    found = minimum(rod, springs, state, ends)
    assert found.converged and found.residual < 1e-10 and found.closure < 1e-13
    free = free_variables(rod, ends)
    near = closed(rod, ends, moved(found.state, free, 0.1 * rng.normal(size=len(free))), free)
    assert total_energy(rod, springs, near) > found.energy + 1
    miss = {"type": "eq", "fun": lambda w: vertices_of(rod, moved(near, free, w))[-1] - ends.end_position}
    answer = minimize(
        lambda w: total_energy(rod, springs, moved(near, free, w)) / 1e4, np.zeros(len(free)), method="SLSQP",
        constraints=[] if end == Clamp.FREE else miss, options={"maxiter": 500, "ftol": 1e-14})
    assert answer.success and 1e4 * answer.fun == pytest.approx(found.energy, rel=1e-8)
    np.testing.assert_allclose(vertices_of(rod, moved(near, free, answer.x)), found.vertices, atol=1e-2)
