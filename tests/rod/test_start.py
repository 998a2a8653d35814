"""Starts, clamps and whole turns from observations."""

import numpy as np
import pytest

from doo_ti import Clamp, Observations, observation_clamps, start_configuration
from doo_ti.rod.start import check_feasible, choose_hypothesis, fill_missing, span_excess, turn_hypotheses
from tests.conftest import check_refused
from tests.io.rods import joint_twist, twisted_frames, wavy_vertices


def twisted(rng, turns: float = 2.0, hint: bool = True) -> tuple[Observations, np.ndarray]:
    """Observations whose end frames come from rods of known total twist, exact edge lengths, and that twist (D,)."""
    vertices = wavy_vertices(rng, count=6, marks=12)
    twist = rng.uniform(-turns, turns, 6) * 2 * np.pi
    frames = twisted_frames(vertices, twist, rng)
    off = 0.97 * np.pi * rng.uniform(-1, 1, 6)  # what a hint may be wrong by
    return Observations(vertices, start_frame=frames[:, 0], end_frame=frames[:, -1],
                        total_twist=twist + off if hint else None), twist


def test_start_repeats_exact_vertices_frames_and_twist(rng):
    for _ in range(10):
        observations, twist = twisted(rng)
        clamps = observation_clamps(observations)
        start = start_configuration(observations, clamps)
        np.testing.assert_allclose(start.vertices, observations.vertices, atol=1e-12)
        ends = np.stack([observations.start_frame, observations.end_frame], axis=1)
        np.testing.assert_allclose(start.frames[:, [0, -1]], ends, atol=1e-12)
        joints = joint_twist(start.quaternions)
        np.testing.assert_allclose(joints.sum(axis=1), twist, atol=1e-11)
        spread = observations.rest_length[:-1] + observations.rest_length[1:]
        np.testing.assert_allclose(joints, twist[:, None] * spread / spread.sum(), atol=1e-11)


def test_without_a_hint_three_turns_are_hypotheses(rng):
    observations, twist = twisted(rng, turns=1.0, hint=False)
    clamps = observation_clamps(observations)
    index, turns = turn_hypotheses(observations, clamps)
    np.testing.assert_array_equal((index, turns), [np.repeat(np.arange(6), 3), np.tile([-1, 0, 1], 6)])
    start = start_configuration(observations.take(index), clamps.take(index), turns)
    found = joint_twist(start.quaternions).sum(axis=1).reshape(6, 3)
    np.testing.assert_allclose(np.diff(found, axis=1), 2 * np.pi, atol=1e-11)
    assert (np.abs(found[:, 1]) <= np.pi).all()
    np.testing.assert_allclose(np.abs(found - twist[:, None]).min(axis=1), 0, atol=1e-11)
    alone = start_configuration(observations, clamps)
    np.testing.assert_array_equal(alone.quaternions, start.quaternions[1::3])


@pytest.mark.parametrize("start, end, hint", [
    (Clamp.TANGENT, Clamp.FRAME, False), (Clamp.FRAME, Clamp.TANGENT, False), (Clamp.FRAME, Clamp.TANGENT, True),
    (Clamp.POSITION, Clamp.FREE, False), (Clamp.FREE, Clamp.FRAME, False)])
def test_a_spin_free_end_leaves_no_twist(rng, start, end, hint):
    observations, twist = twisted(rng, hint=hint)
    assert np.abs(twist).max() > 1
    clamps = observation_clamps(observations, start, end)
    np.testing.assert_array_equal(turn_hypotheses(observations, clamps), [np.arange(6), np.zeros(6)])
    configuration = start_configuration(observations, clamps)
    np.testing.assert_allclose(joint_twist(configuration.quaternions), 0, atol=1e-12)
    for kind, edge, frame in ((start, 0, observations.start_frame), (end, -1, observations.end_frame)):
        if kind == Clamp.FRAME:
            np.testing.assert_allclose(configuration.frames[:, edge], frame, atol=1e-12)


def test_measured_frames_are_the_start(rng):
    vertices = wavy_vertices(rng, count=4)
    frames = twisted_frames(vertices, rng.uniform(-9, 9, 4), rng)
    observations = Observations(vertices, frames=frames)
    clamps = observation_clamps(observations, Clamp.FRAME, Clamp.FRAME)
    np.testing.assert_array_equal(turn_hypotheses(observations, clamps)[0], np.arange(4))
    np.testing.assert_allclose(start_configuration(observations, clamps).frames, frames, atol=1e-12)
    assert observation_clamps(observations).start == Clamp.TANGENT


def test_clamps_by_default_and_by_wish(rng):
    observations, _ = twisted(rng)
    clamps = observation_clamps(observations)
    assert (clamps.start, clamps.end) == (Clamp.FRAME, Clamp.FRAME)
    held = np.stack([clamps.start_position, clamps.end_position], axis=1)
    np.testing.assert_array_equal(held, observations.vertices[:, [0, -1]])
    bare = Observations(observations.vertices)
    clamps = observation_clamps(bare)
    assert (clamps.start, clamps.end) == (Clamp.TANGENT, Clamp.TANGENT)
    edge = bare.vertices[:, -1] - bare.vertices[:, -2]
    np.testing.assert_allclose(clamps.end_frame[..., 0], edge / np.linalg.norm(edge, axis=-1, keepdims=True))
    frames = np.concatenate([clamps.start_frame, clamps.end_frame])
    np.testing.assert_allclose(frames.mT @ frames, np.tile(np.eye(3), (12, 1, 1)), atol=1e-14)
    assert (np.linalg.det(frames) > 0).all()
    assert observation_clamps(bare, Clamp.POSITION, Clamp.FREE).end == Clamp.FREE
    check_refused("end_frame: missing", observation_clamps, bare, end=Clamp.FRAME)


def test_a_clamped_tangent_overrides_the_observed_edge(rng):
    observations, _ = twisted(rng)
    vertices = observations.vertices + np.where(np.arange(12)[:, None] == 1, 0.3, 0.0)
    noisy = Observations(vertices, rest_length=observations.rest_length, start_frame=observations.start_frame,
                         end_frame=observations.end_frame, total_twist=observations.total_twist)
    for kind in (Clamp.FRAME, Clamp.TANGENT, Clamp.POSITION):
        start = start_configuration(noisy, observation_clamps(noisy, start=kind))
        off = np.abs(start.frames[:, 0, :, 0] - observations.start_frame[..., 0]).max()
        assert off > 0.01 if kind == Clamp.POSITION else off < 1e-12


def test_a_rod_held_at_its_end_only_meets_that_clamp(rng):
    observations = Observations(wavy_vertices(rng), rest_length=np.full(8, 2.0))
    clamps = observation_clamps(observations, Clamp.FREE, Clamp.POSITION)
    start = start_configuration(observations, clamps)
    np.testing.assert_allclose(start.vertices[:, -1], clamps.end_position, atol=1e-12)
    clamps = observation_clamps(observations, Clamp.FREE, Clamp.FREE)
    np.testing.assert_array_equal(start_configuration(observations, clamps).start, observations.vertices[:, 0])


def test_missing_marks_are_interpolated_by_arc_length(rng):
    rest = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    position = np.concatenate([[0], rest.cumsum()])
    direction = np.array([[1.0, 2, 2], [0, 0, 3]]) / 3
    vertices = position[None, :, None] * direction[:, None]
    valid = np.array([[1, 0, 0, 1, 1, 0, 1], [0, 1, 0, 1, 1, 0, 0]], dtype=bool)
    garbage = np.where(valid[..., None], vertices, rng.choice([np.nan, np.inf, 1e6], (2, 7, 1)))
    observations = Observations(garbage, valid, rest)
    np.testing.assert_allclose(fill_missing(observations), vertices, atol=1e-12)
    clamps = observation_clamps(observations, Clamp.FREE, Clamp.FREE)
    np.testing.assert_allclose(start_configuration(observations, clamps).frames[..., 0],
                               np.broadcast_to(direction[:, None], (2, 6, 3)), atol=1e-12)


@pytest.mark.parametrize("vertex, end, given, kind", [
    (0, "start", False, Clamp.TANGENT), (1, "start", False, Clamp.TANGENT), (0, "start", True, Clamp.FRAME),
    (1, "start", True, Clamp.FRAME), (0, "start", False, Clamp.POSITION), (0, "start", False, Clamp.FREE),
    (8, "end", False, Clamp.TANGENT), (7, "end", False, Clamp.TANGENT), (7, "end", True, Clamp.TANGENT)])
def test_a_missing_outer_mark_is_on_the_line_through_the_next_two(rng, vertex, end, given, kind):
    vertices = wavy_vertices(rng)
    frames = twisted_frames(vertices, np.ones(3), rng)
    valid = np.ones((3, 9), dtype=bool)
    valid[2, vertex] = False
    given = {"start_frame": frames[:, 0], "end_frame": frames[:, -1]} if given else {}
    observations = Observations(vertices, valid, **given)
    clamps = observation_clamps(observations, **{end: kind})
    assert np.isfinite(start_configuration(observations, clamps).vertices).all()
    inwards, outer = 1 if end == "start" else -1, vertex in (0, 8)
    marks, lengths = vertices[2, ::inwards], observations.rest_length[::inwards]
    expected = marks[1] + (marks[1] - marks[2]) * lengths[0] / lengths[1] if outer else marks[0]
    np.testing.assert_allclose(getattr(clamps, f"{end}_position")[2], expected, rtol=0, atol=1e-9 if outer else 0)


def test_infeasible_spans_are_named_with_their_excess():
    straight = np.zeros((3, 6, 3))
    straight[..., 0] = np.arange(6) * 3.0
    straight[1, 4:, 0] += 0.5
    straight[2, 4:, 0] += 0.7
    observations = Observations(straight, rest_length=np.full(5, 3.0))
    clamps = observation_clamps(observations)
    np.testing.assert_allclose(span_excess(clamps, observations.rest_length), [0, 0.5, 0.7], atol=1e-12)
    check_refused(r"vertices_mm: .*observation 2 are 0\.7 mm .*1 more", check_feasible, observations, clamps)
    check_feasible(observations.take([0]), clamps.take([0]))
    assert (span_excess(observation_clamps(observations, end=Clamp.FREE), observations.rest_length) == -np.inf).all()
    # Clamped edges that point away use up the slack: here 9 mm of free edges must bridge 15 + 2 · 3 mm.
    backward = np.broadcast_to(np.diag([-1.0, -1.0, 1.0]), (1, 3, 3))
    turned = Observations(straight[:1], rest_length=np.full(5, 3.0), start_frame=backward, end_frame=backward)
    np.testing.assert_allclose(span_excess(observation_clamps(turned), turned.rest_length), [12.0])
    held = observation_clamps(turned, Clamp.POSITION, Clamp.POSITION)
    np.testing.assert_allclose(span_excess(held, turned.rest_length), [0.0], atol=1e-12)


def test_the_best_hypothesis_of_each_observation_is_chosen():
    index = np.array([0, 0, 0, 1, 1, 1, 2])
    score = np.array([3.0, 1, 2, np.nan, 5, 5, np.nan])
    np.testing.assert_array_equal(choose_hypothesis(index, score, np.ones(7, dtype=bool)), [1, 4, 6])
    # A rod that did not converge is chosen only if none converged.
    np.testing.assert_array_equal(choose_hypothesis(index, score, np.array([1, 0, 1, 0, 0, 1, 0], dtype=bool)), [2, 5, 6])
    # A rod twisted by a turn more must be twice as near.
    index, twist = np.repeat([0, 1], 3), np.tile([-2 * np.pi, 0, 2 * np.pi], 2)
    score = np.array([0.99, 1.0, 1.1, 1.0, 1.0, 0.49])
    np.testing.assert_array_equal(choose_hypothesis(index, score, np.ones(6, dtype=bool), twist), [1, 5])
