"""Damped steps with a limit, and how taut grippers hold a rod."""

import numpy as np

from doo_ti.manipulation.goal import DampedSteps
from doo_ti.manipulation.poses import drawn_in, moved, slack, slack_gradient
from doo_ti.rod.frames import rotation_matrix
from doo_ti.rod.types import Clamp, Clamps


def test_a_limited_step_is_the_best_of_those_within_its_limit():
    """Optimality (Karush, Kuhn and Tucker): what is left of the gradient lies across the limit, and points out of it."""
    random = np.random.default_rng(2)
    jacobian, gradient = random.normal(size=(40, 8, 5)), random.normal(size=(40, 5))
    across, room = random.normal(size=(40, 5)), random.uniform(0, 0.3, 40)
    normal = np.swapaxes(jacobian, 1, 2) @ jacobian + np.eye(5)
    steps = DampedSteps(normal, gradient)
    step = steps.below(np.full(40, 1e3), across, room)
    used, left = np.sum(across * step, axis=1), gradient - (normal @ step[..., None])[..., 0]
    active = np.sum(across * steps.within(np.full(40, 1e3)), axis=1) > room
    assert 5 < active.sum() < 35 and (used <= room + 1e-9).all() and np.allclose(used[active], room[active])
    multiplier = np.sum(across * left, axis=1) / np.sum(across**2, axis=1)
    assert np.allclose(left, (multiplier * active)[:, None] * across, atol=1e-3) and (multiplier[active] > 0).all()
    assert (np.linalg.norm(steps.below(np.full(40, 0.05), across, room), axis=1) <= 0.05 + 1e-12).all()


def test_slack_and_its_gradient():
    random = np.random.default_rng(3)
    frames = rotation_matrix(random.normal(size=(2, 5, 3)))
    clamps = Clamps(Clamp.FRAME, Clamp.FRAME, random.normal(size=(5, 3)), 100 + random.normal(size=(5, 3)), *frames)
    stiff, change = np.full(5, 7.0), 1e-5 * random.normal(size=(5, 12))
    there, back = (slack(moved(clamps, sign * change), 300.0, stiff) for sign in (1, -1))
    assert np.allclose((there - back) / 2, np.sum(slack_gradient(clamps, stiff) * change, axis=1), atol=1e-11)
    for free in (np.ones(12, dtype=bool), np.arange(12) >= 6):
        looser = slack(drawn_in(clamps, np.full(5, 2.0), stiff, free), 300.0, stiff)
        assert np.allclose(looser, slack(clamps, 300.0, stiff) + 2.0)
