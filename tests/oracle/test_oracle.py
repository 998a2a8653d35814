"""The oracle against itself: two forms of one energy, derivatives by complex steps and differences, minima by scipy."""

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from doo_ti.rod.types import Clamp
from tests.oracle.algebra import body_rotated, directors
from tests.oracle.chain_form import Rod, chain_derivatives, chain_energy
from tests.oracle.equilibrium import Ends, State, closed, energy_of, free_variables, moved, vertices_of
from tests.oracle.external import Springs, minimum, newton_step, total_derivatives, total_energy
from tests.oracle.hyper_dual import gradient_and_hessian, seeds
from tests.oracle.pair import pair_energy, pair_gradient_hessian
from tests.oracle.vertex_form import vertex_energy

EDGES = 5


def random_rod(rng, edges=7, weight=1.3) -> Rod:
    """Uneven lengths, a general B and rest curvature per edge and vertex, and a slanted up."""
    root = rng.normal(size=(edges, 2, 2)) * 300
    up = rng.normal(size=3)
    return Rod(
        rest_length=rng.uniform(2, 4, edges), bend=root @ np.swapaxes(root, 1, 2) + 2e4 * np.eye(2),
        twist=rng.uniform(1e4, 9e4, edges - 1), weight=weight, rest_curvature=rng.normal(size=(edges - 1, 2)) * 0.02,
        up=up / np.linalg.norm(up),
    )


def random_state(rng, edges=7, bending=0.5) -> State:
    frames = Rotation.random(random_state=rng)
    chain = [frames]
    for _ in range(edges - 1):
        chain.append(chain[-1] * Rotation.from_rotvec(rng.normal(size=3) * bending))
    return State(rng.normal(size=3) * 20, np.array([frame.as_quat(scalar_first=True) for frame in chain]))


def ends_of(rod: Rod, state: State, start=Clamp.FRAME, end=Clamp.FRAME) -> Ends:
    vertices = vertices_of(rod, state)
    return Ends(start, end, None if start == Clamp.FREE else vertices[0], None if end == Clamp.FREE else vertices[-1])


def test_vertex_form_is_the_chain_form_with_its_derivatives(rng):
    """Bishop frames, differentiated twice, against the pair formulas: nothing but the definitions in common."""
    rod, state = random_rod(rng, edges=4), random_state(rng, edges=4)
    w = seeds(12)
    frames = [directors(body_rotated(list(q), w[3 * j : 3 * j + 3])) for j, q in enumerate(state.quaternions)]
    vertices = [list(state.start)]
    for length, frame in zip(rod.rest_length, frames, strict=True):
        vertices.append([x + length * t for x, t in zip(vertices[-1], frame[0], strict=True)])
    parts = vertex_energy(
        vertices, [f[1] for f in frames], [f[2] for f in frames], rod.rest_length, rod.bend, rod.twist, rod.weight,
        rod.rest_curvature, rod.up,
    )
    np.testing.assert_allclose([part.value for part in parts], chain_energy(rod, state.start, state.quaternions), rtol=1e-12)
    whole = gradient_and_hessian(sum(parts), (), 12)
    gradient, hessian = chain_derivatives(rod, state.quaternions)
    np.testing.assert_allclose(whole[0], gradient, rtol=0, atol=1e-12 * np.abs(gradient).max())
    np.testing.assert_allclose(whole[1], hessian, rtol=0, atol=1e-12 * np.abs(hessian).max())


@pytest.mark.parametrize("joint", ["gentle", "twist near pi", "twist near -pi", "nearly antiparallel"])
def test_pair_derivatives_in_hard_places_against_complex_step(rng, joint):
    q0 = Rotation.random(random_state=rng)
    turn = {
        "gentle": Rotation.from_rotvec([0.2, 0.3, -0.1]),
        "twist near pi": Rotation.from_rotvec([0.0, 0.1, 0.2]) * Rotation.from_rotvec([np.pi - 1e-3, 0, 0]),
        "twist near -pi": Rotation.from_rotvec([0.0, 0.1, 0.2]) * Rotation.from_rotvec([1e-3 - np.pi, 0, 0]),
        "nearly antiparallel": Rotation.from_rotvec((np.pi - 0.02) * np.array([0, 0.6, 0.8])),
    }[joint]
    bend = np.array([[[4e5, 9e4], [9e4, 2e5]], [[3e5, -5e4], [-5e4, 1e5]]])
    quaternions = [q.as_quat(scalar_first=True) for q in (q0, q0 * turn)]
    constants = (2.0, 3.5, *bend, 7e4, np.array([0.02, -0.03]))
    gradient, hessian = pair_gradient_hessian(*quaternions, *constants)

    def turned(w):
        return [np.array(body_rotated(list(quaternions[j]), list(w[3 * j : 3 * j + 3]))) for j in (0, 1)]

    h = 1e-5
    for k in range(6):
        w = np.zeros(6, dtype=complex)
        w[k] = 1e-100j
        assert pair_energy(*turned(w), *constants).imag * 1e100 == pytest.approx(
            gradient[k], abs=1e-12 * np.abs(gradient).max())
        for m in range(6):
            sides = []
            for sign in (1, -1):
                w = np.zeros(6, dtype=complex)
                w[k] += 1e-100j
                w[m] += sign * h
                sides.append(pair_energy(*turned(w), *constants).imag * 1e100)
            assert (sides[0] - sides[1]) / (2 * h) == pytest.approx(hessian[k, m], abs=1e-5 * np.abs(hessian).max())
    np.testing.assert_allclose(hessian, hessian.T, rtol=0, atol=1e-13 * np.abs(hessian).max())


def random_springs(rng, vertices: np.ndarray, away: float = 4.0, stiffness: float = 200.0) -> Springs:
    """At most vertices, blind in one direction; targets ``away`` mm off."""
    count = len(vertices)
    k = stiffness * rng.uniform(0.5, 2.0, count)
    k[1] = 0.0
    sight = rng.normal(size=(count, 3))
    sight /= np.linalg.norm(sight, axis=1, keepdims=True)
    matrices = k[:, None, None] * (np.eye(3) - sight[:, :, None] * sight[:, None, :])
    return Springs.at_vertices(matrices, vertices + away * rng.normal(size=vertices.shape))


def problem(rng, edges: int = EDGES, away: float = 4.0):
    rod, state = random_rod(rng, edges=edges), random_state(rng, edges=edges, bending=0.2)
    return rod, state, random_springs(rng, vertices_of(rod, state), away)


def turned(state: State, unknowns: np.ndarray) -> State:
    """The state after a step in all unknowns, complex ones too."""
    quaternions = body_rotated(list(state.quaternions.T), list(unknowns[3:].reshape(-1, 3).T))
    return State(state.start + unknowns[:3], np.array(quaternions).T)


def slope(rod, springs, state, k: int, offset=0.0) -> float:
    """∂E/∂unknown k at the unknowns ``offset``, by a complex step."""
    unknowns = np.zeros(3 + 3 * rod.edges, dtype=complex) + offset
    unknowns[k] += 1e-100j
    return total_energy(rod, springs, turned(state, unknowns)).imag * 1e100


def test_derivatives_against_complex_steps_and_differences_of_them(rng):
    """Second derivatives in one chart: (1, w/2) of both steps added before normalising; and the energy that they are of."""
    rod, state, springs = problem(rng, edges=3)
    away = vertices_of(rod, state) - springs.target
    pulled = 0.5 * sum(r @ k @ r for r, k in zip(away, springs.stiffness, strict=True))
    assert total_energy(rod, springs, state) == pytest.approx(energy_of(rod, state)[0] + pulled, rel=1e-13)
    gradient, hessian = total_derivatives(rod, springs, state)
    exact = np.array([slope(rod, springs, state, k) for k in range(len(gradient))])
    np.testing.assert_allclose(gradient, exact, rtol=0, atol=1e-12 * np.abs(exact).max())
    offsets = 1e-5 * np.eye(len(gradient))
    differences = [[slope(rod, springs, state, k, step) - slope(rod, springs, state, k, -step) for step in offsets]
                   for k in range(len(gradient))]
    np.testing.assert_allclose(np.array(differences) / 2e-5, hessian, rtol=0, atol=1e-7 * np.abs(hessian).max())


CASES = {
    "frame, free end": (4, Clamp.FRAME, Clamp.FREE),
    "tangent, free end": (5, Clamp.TANGENT, Clamp.FREE),
    "position, free end": (3, Clamp.POSITION, Clamp.FREE),
    "both frames": (5, Clamp.FRAME, Clamp.FRAME),
}


@pytest.mark.sampled(1)
@pytest.mark.parametrize("case", CASES)
def test_minimum_against_a_general_optimiser(rng, case):
    """scipy's SLSQP, which uses values only, returns to the minimum of the dense solver."""
    edges, start, end = CASES[case]
    rod, state, springs = problem(rng, edges)
    ends = ends_of(rod, state, start, end)
    found = minimum(rod, springs, state, ends)
    assert found.converged and found.residual < 1e-10 and found.closure < 1e-13
    free = free_variables(rod, ends)
    near = closed(rod, ends, moved(found.state, free, 0.1 * rng.normal(size=len(free))), free)
    assert total_energy(rod, springs, near) > found.energy + 1
    miss = {"type": "eq", "fun": lambda w: vertices_of(rod, moved(near, free, w))[-1] - ends.end_position}
    answer = minimize(
        lambda w: total_energy(rod, springs, moved(near, free, w)) / 1e4, np.zeros(len(free)), method="SLSQP",
        constraints=[] if end == Clamp.FREE else miss, options={"maxiter": 500, "ftol": 1e-14},
    )
    assert answer.success and 1e4 * answer.fun == pytest.approx(found.energy, rel=1e-8)
    np.testing.assert_allclose(vertices_of(rod, moved(near, free, answer.x)), found.vertices, atol=1e-2)


@pytest.mark.thorough
def test_an_unstable_start_is_left(rng):
    """A straight rod compressed along its axis by a spring: an equilibrium, but no minimum; the descent reaches a bow."""
    edges = 8
    rod = random_rod(rng, edges=edges, weight=0.0)
    identity = np.tile([1.0, 0.0, 0.0, 0.0], (edges, 1))
    rod = type(rod)(np.full(edges, 3.0), rod.bend, rod.twist, 0.0, 0 * rod.rest_curvature, rod.up)
    state = State(np.zeros(3), identity)
    ends = ends_of(rod, state, Clamp.FRAME, Clamp.FREE)
    k = np.zeros(edges + 1)
    k[-1] = 2e3
    springs = Springs.at_vertices(k, np.zeros((edges + 1, 3)))
    assert not newton_step(rod, springs, state, ends).descends
    found = minimum(rod, springs, state, ends)
    assert found.converged and found.eigenvalues[0] > 0 and np.abs(found.vertices[:, 1:]).max() > 1.0
