"""Rods without observations: their shapes, and what relax makes of them."""

import numpy as np
import pytest

from doo_ti import Clamp, Material, Status, end_clamps, hanging, relax, straight_rod
from tests.conftest import check_refused


def test_a_straight_rod():
    rod = straight_rod(120.0, 12, start=(1, 2, 3), direction=(0, 3, 4))
    np.testing.assert_allclose(rod.vertices[0, -1], [1, 2 + 72, 3 + 96])
    np.testing.assert_allclose(rod.rest_length, 10.0)
    clamps = end_clamps(rod, Clamp.FRAME, Clamp.POSITION)
    np.testing.assert_allclose(clamps.end_position, rod.vertices[:, -1])
    np.testing.assert_allclose(clamps.start_frame[0, :, 0], [0, 0.6, 0.8], atol=1e-12)


@pytest.mark.parametrize("up", [(0, 0, 1), (0, 1, 0), (1, -2, 0.5)])
def test_arcs_meet_their_ends_and_sag(up):
    ends = np.array([[600, 0, 0], [0, 600, 100], [0, 0, 0], [0, 0, 500], [0, 0, -999], [2000, 0, 0]], dtype=float)
    rope, clamps = hanging(1000.0, 30, (0, 0, 0), ends, up=up)
    reached = np.vstack([ends[:5], [[1000, 0, 0]]])  # the last one is too far: straight towards the point
    np.testing.assert_allclose(rope.vertices[:, -1], reached, atol=1e-6)
    middle = rope.vertices[:5].mean(axis=1) - 0.5 * ends[:5]
    assert (middle @ np.array(up) < 1e-6).all()
    solution = relax(rope, Material(bend=1e6, twist=1e6), clamps, up=up)
    assert solution.status.tolist() == [Status.CONVERGED] * 5 + [Status.INFEASIBLE] and solution.stable[:5].all()


def test_ropes_of_several_lengths_are_each_as_its_own():
    lengths, ends = np.array([800.0, 1000.0, 1300.0]), np.array([[500, 0, 0], [0, 600, 100], [0, 0, 500]], dtype=float)
    ropes, _ = hanging(lengths, 20, (0, 0, 0), ends)
    np.testing.assert_allclose(ropes.rest_length.sum(axis=1), lengths)
    for row, length in enumerate(lengths):
        np.testing.assert_array_equal(ropes.vertices[row], hanging(length, 20, (0, 0, 0), ends[row])[0].vertices[0])


def test_wrong_arguments_are_named():
    for call, name in (
            (lambda: straight_rod(0, 10), "length"), (lambda: straight_rod(10, 1), "edges"),
            (lambda: straight_rod(10, 5, direction=(0, 0, 0)), "direction"), (lambda: straight_rod([10, 20], 5), "length"),
            (lambda: hanging([10, -1], 5, (0, 0, 0), (1, 0, 0)), "-1"),
            (lambda: hanging([10, 20], 5, np.zeros((3, 3)), (1, 0, 0)), "2, 3 rows"),
            (lambda: hanging(10, 5, (0, 0), (1, 0, 0)), "start"), (lambda: hanging(10, 5, (0, 0, 0), (np.nan, 0, 0)), "end"),
            (lambda: hanging(10, 5, (0, 0, 0), (1, 0, 0), up=(0, 0, 0)), "up")):
        check_refused(name, call)
