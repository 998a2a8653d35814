"""Steps of damped least squares of many rods: the best of their length, and bit by bit the same in any batch."""

import numpy as np
import pytest

from doo_ti.manipulation.damped_steps import DampedSteps, normal_equations


def problems(count: int, size: int):
    """JᵀJ (B, K, K) of columns of very different lengths, Jᵀe (B, K), lengths, a (B, K) and c (B,)."""
    random = np.random.default_rng(0)
    jacobian = random.normal(size=(count, 3 * size, size)) * np.geomspace(1e-3, 3.0, size)
    across = np.swapaxes(jacobian, 1, 2)
    return (across @ jacobian, (across @ random.normal(size=(count, 3 * size, 1)))[..., 0], random.uniform(0.01, 2.0, count),
            random.normal(size=(count, size)), random.uniform(-0.1, 0.3, count))


def test_normal_equations():
    random = np.random.default_rng(1)
    columns, residual = random.normal(size=(19, 6, 3, 7)), random.normal(size=(19, 6, 3))
    weight = random.uniform(0, 2, (19, 6)) * (random.random((19, 6)) < 0.6)
    normal, right = normal_equations(columns, weight, residual)
    np.testing.assert_allclose(normal, np.einsum("bv,bvxi,bvxj->bij", weight, columns, columns), atol=1e-12)
    np.testing.assert_allclose(right, np.einsum("bv,bvxi,bvx->bi", weight, columns, residual), atol=1e-12)
    np.testing.assert_array_equal(normal_equations(columns[-1:], weight[-1:], residual[-1:])[0], normal[-1:])


@pytest.mark.parametrize("count, size", [(1, 2), (200, 12)])
def test_damped_steps_are_the_best_of_their_length_and_within_their_limit(count, size):
    """Optimality: Jᵀe − JᵀJ u is λ u plus what lies along the limit, λ and the multiplier are not negative."""
    normal, gradient, length, across, room = problems(count, size)
    steps = DampedSteps(normal, gradient).below(length, across, room)
    free = DampedSteps(normal, gradient).below(length, np.zeros_like(across), np.zeros_like(room))
    active = np.sum(across * free, axis=1) > room
    np.testing.assert_array_equal(steps[~active], free[~active])
    np.testing.assert_allclose(np.sum(across * steps, axis=1)[active], room[active], atol=1e-9)
    shortest = np.abs(room) / np.linalg.norm(across, axis=1)  # that reaches the limit
    size = np.linalg.norm(steps, axis=1)
    assert (size <= np.maximum(length, shortest * active) * (1 + 1e-9)).all()
    for row in np.flatnonzero(length > shortest):
        left = gradient[row] - normal[row] @ steps[row]
        parts = np.stack([steps[row], across[row]])[: 1 + active[row]]
        multipliers, *_ = np.linalg.lstsq(parts.T, left, rcond=None)
        np.testing.assert_allclose(multipliers @ parts, left, atol=1e-4 * np.linalg.norm(gradient[row]))
        assert (multipliers > -1e-4).all()
    np.testing.assert_array_equal(DampedSteps(normal[:1], gradient[:1]).below(length[:1], across[:1], room[:1]), steps[:1])
    assert DampedSteps(normal[:0], gradient[:0]).below(length[:0], across[:0], room[:0]).shape == (0, steps.shape[1])
    length[::2] = 0.0
    steps = DampedSteps(normal, gradient).below(length, across, room)
    assert not steps[::2].any() and steps[1::2].any(axis=1).all(), "no step where none is allowed"
