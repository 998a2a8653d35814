"""Motions of both clamps: their end, their direction of rotation, and their number of sub-steps."""

from dataclasses import replace

import numpy as np
import pytest

from doo_ti import Clamp, Clamps, InputError
from doo_ti.motion.path import LARGEST_TURN, motion_between
from doo_ti.rod.frames import matrix_from_quaternion, quaternion_about


def clamps_of(rng, count: int, start=Clamp.FRAME, end=Clamp.FRAME) -> Clamps:
    quaternions = rng.normal(size=(2, count, 4))
    frames = matrix_from_quaternion(quaternions / np.linalg.norm(quaternions, axis=-1, keepdims=True))
    return Clamps(start, end, *(10 * rng.normal(size=(2, count, 3))), *frames)


def spun(frame: np.ndarray, angle) -> np.ndarray:
    """Frames turned about their own tangents."""
    return matrix_from_quaternion(quaternion_about(frame[..., 0], np.broadcast_to(angle, len(frame)))) @ frame


def angle_between(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    return np.arccos(np.clip(0.5 * (np.trace(np.swapaxes(first, -1, -2) @ second, axis1=-2, axis2=-1) - 1), -1, 1))


@pytest.mark.parametrize("rotation", [None, 0.3, 7.0, -20.0])
def test_motions_meet_their_goals(rng, rotation):
    here, goal = clamps_of(rng, 40), clamps_of(rng, 40)
    motion = motion_between(here, goal, None if rotation is None else np.full(40, rotation))
    for share, clamps in ((0.0, here), (1.0, goal)):
        for name in ("start_position", "end_position", "start_frame", "end_frame"):
            np.testing.assert_allclose(getattr(motion.at(share), name), getattr(clamps, name), atol=1e-12)


def test_shortest_rotations_turn_evenly(rng):
    """Each share of the way turns a frame by that share of the angle, about one axis: no way is shorter."""
    here, goal = clamps_of(rng, 40), clamps_of(rng, 40)
    motion = motion_between(here, goal)
    for name in ("start_frame", "end_frame"):
        whole = angle_between(getattr(here, name), getattr(goal, name))
        for share in (0.25, 0.5):
            frame = getattr(motion.at(share), name)
            np.testing.assert_allclose(angle_between(getattr(here, name), frame), share * whole, atol=1e-7)
            np.testing.assert_allclose(angle_between(frame, getattr(goal, name)), (1 - share) * whole, atol=1e-7)


@pytest.mark.parametrize("given, turned", [(120, 120), (130, 120), (-240, -240), (400, 480), (-500, -600), (840, 840)])
def test_the_turn_nearest_to_the_given_one_is_taken(rng, given, turned):
    here = clamps_of(rng, 5)
    goal = replace(here, end_frame=spun(here.end_frame, np.radians(120)))
    motion = motion_between(here, goal, np.full(5, np.radians(given)))
    for share in (0.1, 0.6, 1.0):
        expected = spun(here.end_frame, share * np.radians(turned))
        np.testing.assert_allclose(motion.at(share).end_frame, expected, atol=1e-12)


def test_where_only_a_tangent_is_held_the_frame_goes_with_it(rng):
    here, goal = clamps_of(rng, 30), clamps_of(rng, 30, Clamp.TANGENT, Clamp.TANGENT)
    motion = motion_between(here, goal)
    swing = np.arccos(np.sum(here.end_frame[..., 0] * goal.end_frame[..., 0], axis=-1))
    np.testing.assert_allclose(motion.at(1.0).end_frame[..., 0], goal.end_frame[..., 0], atol=1e-12)
    np.testing.assert_allclose(angle_between(here.end_frame, motion.at(1.0).end_frame), swing, atol=1e-7)
    turned = motion_between(here, goal, np.full(30, 1.0)).at(1.0)
    np.testing.assert_allclose(turned.end_frame, spun(motion.at(1.0).end_frame, 1.0), atol=1e-12)
    free = motion_between(here, clamps_of(rng, 30, Clamp.POSITION, Clamp.POSITION))
    np.testing.assert_allclose(free.at(0.7).end_frame, here.end_frame, atol=1e-12)


def test_sub_steps_are_short(rng):
    """What the furthest rod needs: of each frame's turn, of the far one's spin beside it, of each shift."""
    here = clamps_of(rng, 6)
    lengths = np.full(33, 3.0)
    assert motion_between(here, here).needed_steps(lengths).max() == 1
    goal = replace(here, end_frame=spun(here.end_frame, 1.0))
    assert motion_between(here, goal).needed_steps(lengths, 0.1).max() == 10
    assert motion_between(here, goal, np.full(6, 1.0)).needed_steps(lengths, 0.1).max() == 10
    assert motion_between(here, goal, np.full(6, 1.0 + 2 * np.pi)).needed_steps(lengths, 0.1).max() == 73
    moved = replace(here, start_position=here.start_position + [9.9, 0, 0])
    assert motion_between(here, moved).needed_steps(lengths, 0.1).max() == 5
    motion = motion_between(here, clamps_of(rng, 6))
    count = motion.needed_steps(lengths).max()
    for name in ("start_frame", "end_frame"):
        apart = angle_between(getattr(motion.at(0.5), name), getattr(motion.at(0.5 + 1 / count), name))
        assert (apart <= LARGEST_TURN + 1e-9).all()


def test_motions_that_never_end_are_refused(rng):
    here = clamps_of(rng, 2)
    for motion, turn in ((motion_between(here, here, np.full(2, 2.0**32)), LARGEST_TURN),
                         (motion_between(here, clamps_of(rng, 2)), 1e-300)):
        with pytest.raises(InputError, match="sub-steps"):
            motion.needed_steps(np.full(20, 3.0), turn)
