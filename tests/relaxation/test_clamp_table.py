"""The kernel's table of starts and clamps, against the same in NumPy, written here from the definitions."""

from dataclasses import replace

import numpy as np
import pytest

from doo_ti import Clamp, Clamps, Configuration
from doo_ti.relaxation import tables as of
from doo_ti.relaxation.clamp_table import FEW, INFEASIBLE, SOUND, STRAIGHT, TAUT, clamp_table
from doo_ti.rod.frames import matrix_from_quaternion, smallest_rotation, vertices_from_quaternions
from tests.conftest import check_refused

FREE, POSITION, TANGENT, FRAME = (int(kind) for kind in Clamp)


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def drawn(rng, count: int, edges: int, shared: bool):
    """Rods of any shape, frames of any length, far points at, within and beyond reach, ends held in every way."""
    frames = unit(rng.normal(size=(count, edges, 4)))
    lengths = rng.uniform(1, 5, (1 if shared else count, edges))
    start = rng.normal(size=(count, 3))
    chord = vertices_from_quaternions(start, frames, lengths)[:, -1] - start
    far = start + chord * rng.choice([0.3, 1.0, 3.0], count)[:, None]
    configuration = Configuration(start, frames * rng.uniform(0.1, 9, (count, edges, 1)), lengths[0] if shared else lengths)
    kinds = rng.integers(FREE, FRAME + 1, (count, 2))
    held = matrix_from_quaternion(unit(rng.normal(size=(2, count, 4))))
    return configuration, lengths, kinds, Clamps(kinds[:, 0], kinds[:, 1], start + rng.normal(size=(count, 3)), far, *held)


@pytest.mark.parametrize("shared", [True, False])
@pytest.mark.parametrize("edges", [2, 3, 7])
def test_against_the_definitions(rng, edges, shared):
    count = 300
    rods, lengths, kinds, clamps = drawn(rng, count, edges, shared)
    table, found = clamp_table(rods, lengths, kinds, clamps)
    start, end = kinds.T
    closed, released = (start >= POSITION) & (end >= POSITION), (start < POSITION) & (end >= POSITION)
    tilts = np.stack([start < TANGENT, end < TANGENT], axis=1)
    flags = np.stack([closed, start < FRAME, end < FRAME, *tilts.T, np.ones(count), released], axis=1)
    np.testing.assert_array_equal(table[:, of.CLOSED : of.RELEASED + 1], flags)
    first = np.where((start >= POSITION)[:, None], clamps.start_position, rods.start)
    target = np.where(closed[:, None], clamps.end_position - first, 0.0)
    np.testing.assert_allclose(table[:, of.TARGET : of.TARGET + 3], target, atol=1e-14)
    np.testing.assert_array_equal(table[:, of.ANCHOR : of.ANCHOR + 3], np.where(released[:, None], clamps.end_position, first))
    each = np.broadcast_to(lengths, (count, edges))
    total = each.sum(axis=1)
    np.testing.assert_allclose(table[:, of.TOTAL], total)
    np.testing.assert_array_equal(table[:, of.LONGEST], each.max(axis=1))
    np.testing.assert_allclose(table[:, of.SHORTEST_PAIR], (each[:, 1:] + each[:, :-1]).min(axis=1))
    # The moment of an edge's weight about its own beginning and of all that hangs beyond.
    beyond = total[:, None] - np.cumsum(each, axis=1)
    before = np.cumsum(each, axis=1) - each
    arm = np.where(released[:, None], each * (each + 2 * before), each * (each + 2 * beyond)).max(axis=1)
    np.testing.assert_allclose(table[:, of.HANGING], arm)
    # The frames at the ends as rotations, and of those whether the rod can reach.
    own = matrix_from_quaternion(unit(rods.quaternions[:, [0, -1]]))
    held = np.stack([clamps.start_frame, clamps.end_frame], axis=1)
    carried = matrix_from_quaternion(smallest_rotation(own[..., 0], held[..., 0])) @ own
    wanted = np.where((kinds == FRAME)[..., None, None], held, np.where((kinds == TANGENT)[..., None, None], carried, own))
    ends = matrix_from_quaternion(table[:, of.ENDS :].reshape(-1, 2, 4))
    np.testing.assert_allclose(ends, wanted, atol=1e-12)
    fixed = each[:, [0, -1]] * ~tilts
    span = np.linalg.norm(target - (fixed[..., None] * wanted[..., 0]).sum(axis=1), axis=1)
    free = each.copy()
    free[:, [0, -1]] *= tilts
    within = (span < free.sum(axis=1)) & (2 * free.max(axis=1) <= free.sum(axis=1) + span)  # no side of a polygon is too long
    reaches = ~closed | (within & (edges - (~tilts).sum(axis=1) >= 2))
    np.testing.assert_array_equal(found != INFEASIBLE, reaches)
    assert 0 < reaches.sum() < count


@pytest.mark.parametrize(("share", "expected"), [
    (0.5, STRAIGHT), (1 - 2e-7, STRAIGHT), (1 - 5e-8, TAUT), (1 - 5e-9, TAUT), (1.0, TAUT), (1.001, INFEASIBLE)])
def test_straight_rods(share, expected):
    lengths = np.full((1, 8), 2.0)
    rods = Configuration(np.zeros((1, 3)), np.tile([1.0, 0, 0, 0], (1, 8, 1)), lengths[0])
    far = np.array([[share * 16.0, 0, 0]])
    clamps = Clamps(Clamp.POSITION, Clamp.POSITION, np.zeros((1, 3)), far, np.eye(3)[None], np.eye(3)[None])
    assert clamp_table(rods, lengths, np.full((1, 2), POSITION), clamps)[1] == [expected]
    free = np.array([[POSITION, FREE]])
    assert clamp_table(rods, lengths, free, clamps)[1] == [SOUND], "nothing to reach"


def test_the_opposite_tangent_takes_half_a_turn():
    """Parallel transport has no answer there: any half turn that puts the edge where the clamp wants it will do."""
    lengths = np.full((1, 5), 2.0)
    for own in (np.array([1.0, 0, 0, 0]), unit(np.array([1.0, 1, 1, 1])), np.array([0.6, 0, 0, 0.8])):
        rods = Configuration(np.zeros((1, 3)), np.tile(own, (1, 5, 1)), lengths[0])
        frame = matrix_from_quaternion(own)
        frame[:, :2] *= -1
        clamps = Clamps(Clamp.TANGENT, Clamp.FREE, np.zeros((1, 3)), np.zeros((1, 3)), frame[None], frame[None])
        table, _ = clamp_table(rods, lengths, np.array([[TANGENT, FREE]]), clamps)
        np.testing.assert_allclose(matrix_from_quaternion(table[0, of.ENDS : of.ENDS + 4])[:, 0], frame[:, 0], atol=1e-12)


def test_many_starts_are_read_as_few(rng):
    rods, lengths, kinds, clamps = drawn(rng, FEW + 100, 9, False)
    table, found = clamp_table(rods, lengths, kinds, clamps)
    rows = np.arange(FEW, FEW + 50)
    few, few_found = clamp_table(rods.take(rows), lengths[rows], kinds[rows], clamps.take(rows))
    np.testing.assert_array_equal(table[rows], few)
    np.testing.assert_array_equal(found[rows], few_found)


@pytest.mark.parametrize("end", ["start_frame", "end_frame"])
@pytest.mark.parametrize("kind", [Clamp.TANGENT, Clamp.FRAME])
@pytest.mark.parametrize("tangent", [(0.0, 0.0, 0.0), (0.0, 3.0, 0.0), (0.0, 0.5, 0.0)])
def test_a_tangent_of_another_length_is_refused(rng, end, kind, tangent):
    rods, lengths, _, clamps = drawn(rng, 5, 7, True)
    frames = getattr(clamps, end).copy()
    frames[3] = np.eye(3)[:, [1, 2, 0]] if any(tangent) else 0.0
    frames[3, :, 0] = tangent
    held = replace(clamps, **{end: frames})
    check_refused(f"{end}.*no frame that can be held", clamp_table, rods, lengths, np.full((5, 2), int(kind)), held)
    clamp_table(rods, lengths, np.full((5, 2), POSITION), held)


def test_a_tangent_within_tolerance_is_made_a_unit_vector_and_frames_that_are_not_finite_are_data(rng):
    rods, lengths, _, clamps = drawn(rng, 5, 7, True)
    longer = replace(clamps, start_frame=1.0004 * clamps.start_frame)
    (one, _), (other, _) = (clamp_table(rods, lengths, np.full((5, 2), TANGENT), held) for held in (clamps, longer))
    np.testing.assert_allclose(one, other, atol=1e-14)
    rods, lengths, _, clamps = drawn(rng, 2000, 7, True)
    _, found = clamp_table(rods, lengths, np.full((2000, 2), FRAME), replace(clamps, end_frame=clamps.end_frame * np.nan))
    assert (found == INFEASIBLE).all()
