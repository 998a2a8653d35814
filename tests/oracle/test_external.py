"""The oracle of springs against itself: derivatives by complex steps and finite differences, minima by scipy."""

import numpy as np
import pytest
from scipy.optimize import minimize

from tests.oracle.algebra import body_rotated
from tests.oracle.chain_form import linear_derivatives
from tests.oracle.equilibrium import State, closed, energy_of, equilibrium, free_variables, moved, vertices_of
from tests.oracle.external import Springs, minimum, newton_step, total_derivatives, total_energy, vertex_jacobian
from tests.oracle.test_oracle import Clamp, ends_of, random_rod, random_state

EDGES = 5
STARTS = [Clamp.POSITION, Clamp.TANGENT, Clamp.FRAME]


def random_springs(rng, vertices: np.ndarray, away: float = 4.0, stiffness: float = 200.0) -> Springs:
    """At most vertices, some of them blind in one direction, and two along every edge; targets ``away`` mm off."""
    count = len(vertices)
    k = stiffness * rng.uniform(0.5, 2.0, count)
    k[1] = 0.0
    sight = rng.normal(size=(count, 3))
    sight /= np.linalg.norm(sight, axis=1, keepdims=True)
    matrices = k[:, None, None] * (np.eye(3) - sight[:, :, None] * sight[:, None, :])
    share = rng.uniform(0, 1, (count - 1, 2))
    samples = (1 - share)[..., None] * vertices[:-1, None] + share[..., None] * vertices[1:, None]
    along = Springs.along_edges(
        stiffness * rng.uniform(0, 1, share.shape), share, samples + away * rng.normal(size=samples.shape))
    return Springs.at_vertices(matrices, vertices + away * rng.normal(size=vertices.shape)) + along


def problem(rng, edges: int = EDGES, away: float = 4.0):
    rod, state = random_rod(rng, edges=edges), random_state(rng, edges=edges, bending=0.2)
    return rod, state, random_springs(rng, vertices_of(rod, state), away)


def everything(rod) -> np.ndarray:
    return np.arange(3 + 3 * rod.edges)


def turned(state: State, unknowns: np.ndarray) -> State:
    """The state after a step in all unknowns, complex ones too."""
    quaternions = body_rotated(list(state.quaternions.T), list(unknowns[3:].reshape(-1, 3).T))
    return State(state.start + unknowns[:3], np.array(quaternions).T)


def slope(rod, springs, state, k: int, offset=0.0) -> float:
    """∂E/∂unknown k at the unknowns ``offset``, by a complex step."""
    unknowns = np.zeros(3 + 3 * rod.edges, dtype=complex) + offset
    unknowns[k] += 1e-100j
    return total_energy(rod, springs, turned(state, unknowns)).imag * 1e100


def test_the_energy_is_the_sum_it_says(rng):
    rod, state, _ = problem(rng)
    vertices, k = vertices_of(rod, state), rng.uniform(1, 2, EDGES + 1)
    target, mark = rng.normal(size=(EDGES + 1, 3)), rng.normal(size=(EDGES, 2, 3))
    share, along = np.tile([0.25, 0.5], (EDGES, 1)), rng.uniform(1, 2, (EDGES, 2))
    expected = sum(0.5 * k[i] * np.sum((vertices[i] - target[i]) ** 2) for i in range(EDGES + 1))
    for e in range(EDGES):
        for s in range(2):
            place = (1 - share[e, s]) * vertices[e] + share[e, s] * vertices[e + 1]
            expected += 0.5 * along[e, s] * np.sum((place - mark[e, s]) ** 2)
    springs = Springs.at_vertices(k, target) + Springs.along_edges(along, share, mark)
    assert springs.energy(vertices) == pytest.approx(expected, rel=1e-13)
    assert total_energy(rod, springs, state) == pytest.approx(energy_of(rod, state)[0] + expected, rel=1e-13)


def test_gradient_against_complex_steps(rng):
    rod, state, springs = problem(rng)
    gradient, _ = total_derivatives(rod, springs, state)
    exact = np.array([slope(rod, springs, state, k) for k in everything(rod)])
    np.testing.assert_allclose(gradient, exact, rtol=0, atol=1e-12 * np.abs(exact).max())


@pytest.mark.thorough
def test_hessian_against_differences_of_complex_steps(rng):
    """Second derivatives in one chart: (1, w/2) of both steps added before normalising."""
    rod, state, springs = problem(rng)
    _, hessian = total_derivatives(rod, springs, state)
    offsets = 1e-5 * np.eye(3 + 3 * rod.edges)
    for k in everything(rod):
        for m in everything(rod):
            difference = slope(rod, springs, state, k, offsets[m]) - slope(rod, springs, state, k, -offsets[m])
            assert difference / 2e-5 == pytest.approx(hessian[k, m], abs=1e-7 * np.abs(hessian).max())
    np.testing.assert_allclose(hessian, hessian.T, rtol=0, atol=1e-13 * np.abs(hessian).max())


def on_closure(rod, state, ends, matrix) -> np.ndarray:
    """The matrix on the free motions that keep closure, by a projector that lifts the others out of the way."""
    free = free_variables(rod, ends)
    matrix = matrix[np.ix_(free, free)]
    if ends.end_position is None:
        return matrix
    rows = vertex_jacobian(rod, state.quaternions)[-1][:, free]
    across = np.linalg.pinv(rows) @ rows
    along = np.eye(len(free)) - across
    return along @ matrix @ along + np.abs(matrix).max() * across


@pytest.mark.parametrize("end", [Clamp.FREE, Clamp.FRAME], ids=["free end", "both held"])
@pytest.mark.parametrize("start", STARTS)
def test_the_step_solves_the_shifted_problem(rng, start, end):
    rod, state, springs = problem(rng)
    ends = ends_of(rod, state, start, end)
    free, shift = free_variables(rod, ends), 2e4
    step = newton_step(rod, springs, state, ends, shift)
    unknowns = np.append(step.translation, step.rotation)
    held = np.setdiff1d(everything(rod), free)
    assert (unknowns[held] == 0).all() and (step.translation == 0).all()
    gradient, hessian = total_derivatives(rod, springs, state)
    if end != Clamp.FREE:
        far = vertex_jacobian(rod, state.quaternions)[-1]
        multiplier = -np.linalg.lstsq(far[:, free].T, gradient[free], rcond=None)[0]
        np.testing.assert_allclose(far @ unknowns, 0, atol=1e-12)
        np.testing.assert_allclose(step.residual[free], gradient[free] + far[:, free].T @ multiplier, atol=1e-9)
        gradient = gradient + far.T @ step.force
        hessian[3:, 3:] += linear_derivatives(rod, state.quaternions, multiplier)[1]
    left = gradient + hessian @ unknowns + shift * np.append(np.zeros(3), unknowns[3:])
    np.testing.assert_allclose(left[free], 0, atol=1e-10 * np.abs(gradient).max())
    assert step.descends == (np.linalg.eigvalsh(on_closure(rod, state, ends, hessian + shift * np.eye(len(hessian))))[0] > 0)
    # A large shift makes it steepest descent.
    steep = newton_step(rod, springs, state, ends, 1e14)
    np.testing.assert_allclose(1e14 * steep.rotation.ravel()[free - 3], -steep.residual[free], rtol=1e-4,
                               atol=1e-6 * np.abs(gradient).max())


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
def test_without_springs_it_is_the_equilibrium_of_the_rod(rng):
    for end in (Clamp.FREE, Clamp.TANGENT):
        rod, state = random_rod(rng, edges=7), random_state(rng, edges=7, bending=0.15)
        ends = ends_of(rod, state, Clamp.FRAME, end)
        none = Springs.at_vertices(np.zeros(8), np.zeros((8, 3)))
        found, plain = minimum(rod, none, state, ends), equilibrium(rod, state, ends)
        assert found.converged and found.energy == pytest.approx(plain.energy, rel=1e-10)
        np.testing.assert_allclose(found.force, plain.force, rtol=1e-5, atol=1e-6)


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
