"""The oracle against itself: two forms of one energy with their derivatives, and differences of energies."""

import numpy as np
from scipy.spatial.transform import Rotation

from tests.oracle.algebra import body_rotated, directors, gradient_and_hessian, seeds
from tests.oracle.chain_form import Rod, chain_derivatives, chain_energy
from tests.oracle.equilibrium import State, moved, vertices_of
from tests.oracle.external import Springs, total_derivatives, total_energy
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
    chain = [Rotation.random(random_state=rng)]
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


def test_derivatives_with_springs_and_forces_are_differences(rng):
    """In the translation of the first vertex and all rotations; springs at most vertices, blind in one direction."""
    rod, state = random_rod(rng, edges=4), random_state(rng, edges=4, bending=0.2)
    vertices, sight = vertices_of(rod, state), rng.normal(size=(5, 3))
    sight /= np.linalg.norm(sight, axis=1, keepdims=True)
    blind = np.eye(3) - sight[:, :, None] * sight[:, None]
    stiffness = np.array([150.0, 0.0, 300.0, 100.0, 400.0])
    target, force = vertices + 4.0 * rng.normal(size=(5, 3)), 300.0 * rng.normal(size=(5, 3))
    springs = Springs(stiffness[:, None, None] * blind, target, force)
    gradient, hessian = total_derivatives(rod, springs, state)
    step, every = 1e-4, np.arange(len(gradient))

    def energy(w: np.ndarray) -> float:
        return total_energy(rod, springs, moved(state, every, w))

    ways = step * np.eye(len(gradient))
    slopes = [(energy(way) - energy(-way)) / (2 * step) for way in ways]
    np.testing.assert_allclose(gradient, slopes, atol=1e-6 * np.abs(gradient).max())
    np.testing.assert_allclose(hessian, hessian.T, atol=1e-12 * np.abs(hessian).max())
    for k, way in enumerate(ways):
        bends = [(energy(way + a) - energy(way - a) - energy(a - way) + energy(-way - a)) / (4 * step**2) for a in ways[k:]]
        np.testing.assert_allclose(hessian[k, k:], bends, atol=1e-5 * np.abs(hessian).max())
