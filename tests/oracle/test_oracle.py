"""The oracle against itself: two forms of one energy, derivatives three ways, a solver that descends."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from doo_ti.rod.types import Clamp
from tests.oracle.algebra import body_rotated, directors
from tests.oracle.chain_form import Rod, chain_derivatives, chain_energy
from tests.oracle.equilibrium import Ends, State, closed, equilibrium, free_variables, vertices_of
from tests.oracle.hyper_dual import HyperDual, angle, gradient_and_hessian, seeds
from tests.oracle.metric import distance
from tests.oracle.pair import linear_gradient_hessian, pair_energy, pair_gradient_hessian
from tests.oracle.vertex_form import vertex_energy


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


def vertex_parts(rod: Rod, state: State):
    _, m1, m2 = (np.array(d).T for d in directors(state.quaternions.T))
    return vertex_energy(
        vertices_of(rod, state), m1, m2, rod.rest_length, rod.bend, rod.twist, rod.weight, rod.rest_curvature, rod.up
    )


def test_hyper_dual_angle_has_the_derivatives_of_atan2():
    for at in (0.1, 1.2, 2.0, 3.1, -0.4, -1.7, -3.1):
        x = HyperDual(at, 1.0, 1.0)
        sine, cosine = x.compose(np.sin(at), np.cos(at), -np.sin(at)), x.compose(np.cos(at), -np.sin(at), -np.cos(at))
        y = angle(sine, cosine)
        assert (y.value, y.first, y.mixed) == pytest.approx((at, 1.0, 0.0), abs=1e-15)


def test_vertex_form_is_the_chain_form(rng):
    for _ in range(20):
        rod, state = random_rod(rng), random_state(rng)
        chain = chain_energy(rod, state.start, state.quaternions)
        np.testing.assert_allclose(vertex_parts(rod, state), chain, rtol=1e-12)


def test_isotropic_bend_is_alpha_kb_squared_over_length(rng):
    rod, state = random_rod(rng), random_state(rng)
    rod = replace(rod, bend=np.broadcast_to(3e5 * np.eye(2), rod.bend.shape), rest_curvature=0 * rod.rest_curvature)
    edges = np.diff(vertices_of(rod, state), axis=0) / rod.rest_length[:, None]
    cosine = np.sum(edges[1:] * edges[:-1], axis=1)
    binormal = 2 * np.cross(edges[:-1], edges[1:]) / (1 + cosine)[:, None]
    expected = np.sum(3e5 * np.sum(binormal**2, axis=1) / (rod.rest_length[1:] + rod.rest_length[:-1]))
    assert chain_energy(rod, state.start, state.quaternions)[0] == pytest.approx(expected, rel=1e-13)


def _right_multiplied(quaternions, by):
    rotations = Rotation.from_quat(quaternions, scalar_first=True) * Rotation.from_quat(by, scalar_first=True)
    return rotations.as_quat(scalar_first=True)


def test_joint_twist_beyond_pi_wraps_in_both_forms(rng):
    rod, state = random_rod(rng, edges=2), random_state(rng, edges=2)
    energies = []
    for angle_about_t in (0.4, 0.4 + 2 * np.pi):
        half = 0.5 * angle_about_t
        spun = _right_multiplied(state.quaternions[1:], [np.cos(half), np.sin(half), 0, 0])
        energies.append(vertex_parts(rod, State(state.start, np.vstack([state.quaternions[:1], spun]))))
    np.testing.assert_allclose(energies[0], energies[1], rtol=1e-12)


def test_chain_derivatives_against_complex_step_and_whole_rod_hyper_duals(rng):
    rod, state = random_rod(rng, edges=4), random_state(rng, edges=4)
    gradient, hessian = chain_derivatives(rod, state.quaternions)
    step = np.zeros(12)
    for k in range(12):
        w = np.zeros((4, 3), dtype=complex)
        w.flat[k] = 1e-100j
        turned = np.array(body_rotated(list(state.quaternions.T), list(w.T))).T
        step[k] = sum(chain_energy(rod, state.start, turned)).imag * 1e100
    np.testing.assert_allclose(gradient, step, rtol=0, atol=1e-13 * np.abs(gradient).max())
    w = seeds(12)
    frames = [body_rotated(list(q), w[3 * j : 3 * j + 3]) for j, q in enumerate(state.quaternions)]
    whole = gradient_and_hessian(sum(chain_energy(rod, state.start, frames)), (), 12)
    np.testing.assert_allclose(whole[0], gradient, rtol=0, atol=1e-13 * np.abs(gradient).max())
    np.testing.assert_allclose(whole[1], hessian, rtol=0, atol=1e-13 * np.abs(hessian).max())


def test_vertex_form_has_the_hessian_of_the_chain_form(rng):
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


def test_linear_derivatives_are_those_of_the_design(rng):
    """gradient l (0, −c·m2, c·m1), Hessian by rotation vectors [[0, c1/2, c2/2], [c1/2, −ct, 0], [c2/2, 0, −ct]]."""
    force, quaternion = rng.normal(size=(5, 3)), random_state(rng, edges=5).quaternions
    length = rng.uniform(1, 4, 5)
    gradient, hessian = linear_gradient_hessian(force, quaternion, length)
    ct, c1, c2 = (length * np.sum(force * np.array(d).T, axis=1) for d in directors(quaternion.T))
    zero = 0 * ct
    np.testing.assert_allclose(gradient, np.stack([zero, -c2, c1], axis=1), atol=1e-14)
    expected = np.array([[zero, c1 / 2, c2 / 2], [c1 / 2, -ct, zero], [c2 / 2, zero, -ct]]).transpose(2, 0, 1)
    np.testing.assert_allclose(hessian, expected, atol=1e-14)


def ends_of(rod: Rod, state: State, start=Clamp.FRAME, end=Clamp.FRAME) -> Ends:
    vertices = vertices_of(rod, state)
    return Ends(start, end, None if start == Clamp.FREE else vertices[0], None if end == Clamp.FREE else vertices[-1])


@pytest.mark.sampled(1)
@pytest.mark.parametrize("end", list(Clamp))
@pytest.mark.parametrize("start", [Clamp.POSITION, Clamp.TANGENT, Clamp.FRAME])
def test_equilibrium_closes_descends_and_is_stationary(rng, start, end):
    rod, state = random_rod(rng, edges=8), random_state(rng, edges=8, bending=0.15)
    ends = ends_of(rod, state, start, end)
    found = equilibrium(rod, state, ends, tolerance=1e-11)
    # Hung by one point, a rod still turns freely about the vertical: one neutral mode, and no other.
    neutral = int(start == Clamp.POSITION and end == Clamp.FREE)
    assert found.converged and found.closure < 1e-14 and found.stable == (not neutral)
    np.testing.assert_allclose(found.eigenvalues[:neutral] / found.eigenvalues[-1], 0, atol=1e-13)
    assert found.eigenvalues[neutral] > 1e-9 * found.eigenvalues[-1]
    assert found.energy < sum(chain_energy(rod, state.start, state.quaternions))
    assert found.energy == pytest.approx(sum(chain_energy(rod, found.start, found.quaternions)), rel=1e-13)
    # No neighbour that keeps the clamps is lower.
    at = State(found.start, found.quaternions)
    free = free_variables(rod, ends)
    for _ in range(20):
        near = closed(rod, ends, State(at.start, _nudged(at, free, rng)), free)
        assert sum(chain_energy(rod, near.start, near.quaternions)) > found.energy


def _nudged(state, free, rng):
    w = np.zeros(3 + 3 * len(state.quaternions))
    w[free] = 1e-3 * rng.normal(size=len(free))
    return np.array(body_rotated(list(state.quaternions.T), list(w[3:].reshape(-1, 3).T))).T


def test_equilibrium_against_a_general_optimiser(rng):
    """scipy's SLSQP, which uses values only, ends at the minimum of the dense solver."""
    rod, state = random_rod(rng, edges=5), random_state(rng, edges=5, bending=0.2)
    ends = ends_of(rod, state)
    found = equilibrium(rod, state, ends)
    free = free_variables(rod, ends)

    def at(w):
        full = np.zeros(18)
        full[free] = w
        return np.array(body_rotated(list(state.quaternions.T), list(full[3:].reshape(-1, 3).T))).T

    def miss(w):
        return vertices_of(rod, State(state.start, at(w)))[-1] - ends.end_position

    answer = minimize(
        lambda w: sum(chain_energy(rod, state.start, at(w))) / 1e4, np.zeros(len(free)), method="SLSQP",
        constraints={"type": "eq", "fun": miss}, options={"maxiter": 500, "ftol": 1e-14},
    )
    assert answer.success and 1e4 * answer.fun == pytest.approx(found.energy, rel=1e-8)


def test_distance_counts_valid_marks_only(rng):
    observed = rng.normal(size=(6, 3))
    moved = observed + np.array([3.0, 4.0, 0.0])
    assert distance(moved, observed) == pytest.approx(5 * 6 / 5)
    valid = np.array([True, False, True, True, False, True])
    broken = np.where(valid[:, None], observed, np.nan)
    assert distance(moved, broken, valid=valid) == pytest.approx(5 * 4 / 3)
    m1 = np.tile([1.0, 0.0, 0.0], (5, 1))
    turned = np.tile([0.0, 1.0, 0.0], (5, 1))
    assert distance(moved, observed, m1, turned, frame_weight=6.7) == pytest.approx(6 + 6.7 * np.sqrt(2) * 5 / 4)
