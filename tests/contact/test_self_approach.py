"""Which rods may touch themselves on the straight way between two shapes, against their distances at many instants of it."""

import numpy as np
import pytest

from doo_ti import Clamp, Clamps, Configuration, Itself, Material, relax
from doo_ti.contact.itself import smallest_self_gap
from doo_ti.relaxation.self_approach import approach_in_motion, approach_in_relaxation, stays_in_order
from doo_ti.rod.frames import matrix_from_quaternion, quaternion_of_turn, quaternion_product, vertices_from_quaternions

COUNT, INSTANTS = 64, 80


def bent(rng, edges: int) -> np.ndarray:
    """(COUNT, edges, 4) frames of random smooth curves, of which the last turn furthest."""
    share = np.linspace(0.0, 1.0, edges - 1)
    waves = np.stack([np.ones_like(share), np.cos(np.pi * share), np.sin(2.0 * np.pi * share)])
    turn = np.linspace(0.2, 3.0, COUNT)[:, None, None] * rng.normal(size=(COUNT, 3, 3)).transpose(0, 2, 1) @ waves * 3.0 / edges
    steps = quaternion_of_turn(turn.transpose(0, 2, 1))
    frames = np.empty((COUNT, edges, 4))
    frames[:, 0] = quaternion_of_turn(rng.normal(size=(COUNT, 3)) * 0.3)
    for e in range(1, edges):
        frames[:, e] = quaternion_product(frames[:, e - 1], steps[:, e - 1])
    return frames


@pytest.mark.sampled(1)
@pytest.mark.parametrize("edges, radius", [(7, 2.0), (33, 0.5), (40, 4.0)])
def test_rods_that_touch_on_their_way_are_found_and_no_others(rng, edges, radius):
    lengths = np.full((1, edges), 100.0 / edges) * rng.uniform(0.8, 1.2, edges)
    start, frames = bent(rng, edges), bent(rng, edges)
    before, after = (vertices_from_quaternions(np.zeros(3), each, lengths) for each in (start, frames))
    own = np.array([radius])
    shares = np.linspace(0.0, 1.0, INSTANTS)
    gap = np.min([smallest_self_gap(before + share * (after - before), own) for share in shares], axis=0)
    rows = np.arange(COUNT)
    touching, turned = approach_in_relaxation(start, rows, frames, lengths, own, rows)
    near = approach_in_motion(before, after, rows, lengths, own)
    still = approach_in_motion(after, after, rows, lengths, own)
    found = np.isin(rows, touching)
    # Between two instants the distance may be less.
    certain = (gap < 0.0) | (gap > 1.5)
    np.testing.assert_array_equal(found[certain], gap[certain] < 0.0)
    assert 0.1 < found.mean() < 0.9
    assert not np.isin(turned, touching).any()
    assert near[gap < 0.0].all()
    certain = np.abs(smallest_self_gap(after, own)) > 3e-3 * radius + 1e-3
    np.testing.assert_array_equal(still[certain], smallest_self_gap(after, own)[certain] < 0.0)


def test_rods_that_are_not_finite_are_found_after_relaxations_and_not_in_motions():
    lengths, radius, rows = np.full((1, 10), 3.0), np.array([1.0]), np.arange(2)
    frames = np.tile([1.0, 0.0, 0.0, 0.0], (2, 10, 1))
    lost = frames.copy()
    lost[1, 4] = np.nan
    np.testing.assert_array_equal(approach_in_relaxation(frames, rows, lost, lengths, radius, rows)[0], [1])
    places = vertices_from_quaternions(np.zeros(3), frames, lengths)
    gone = places.copy()
    gone[1] = np.nan
    assert not approach_in_motion(places, gone, rows, lengths, radius).any()


@pytest.mark.thorough
@pytest.mark.parametrize("edges, radius", [(20, 3.0), (40, 1.0)])
@pytest.mark.parametrize("precision", ["f32", "f64", "mixed"])
def test_rods_that_stay_in_order_are_apart_and_have_not_turned(rng, edges, radius, precision, monkeypatch):
    """Those are not looked at: that they would not be found is what makes it allowed."""
    lengths = 100.0 / edges * rng.uniform(0.8, 1.2, edges)
    frames = bent(rng, edges)
    frames[::2] = [1.0, 0.0, 0.0, 0.0]
    start = Configuration(np.zeros((COUNT, 3)), frames, lengths)
    reach = rng.uniform(0.6, 0.98, (COUNT, 1)) * lengths.sum() * [1.0, 0.0, 0.0]
    ends = [matrix_from_quaternion(quaternion_of_turn(0.3 * rng.normal(size=(COUNT, 3)))) for _ in range(2)]
    clamps = Clamps(Clamp.FRAME, Clamp.FRAME, np.zeros((COUNT, 3)), reach, *ends)
    material = Material(1e5 * np.ones(COUNT), 1e5, rng.uniform(0.0, 10.0, COUNT))
    seen = []

    def remember(table, results):
        seen.append((table, stays_in_order(table, results)))
        return seen[-1][1]

    monkeypatch.setattr("doo_ti.relaxation.relax.stays_in_order", remember)
    solution = relax(start, material, clamps, obstacles=[Itself()], radius=radius, precision=precision)
    table, in_order = seen[0]
    assert 0.1 < in_order.mean() < 0.9, in_order.mean()
    every, index = np.arange(COUNT), table.configuration_index
    touching, turned = approach_in_relaxation(
        table.start, index, solution.configuration.quaternions, table.rest_length, table.contact.radius, every)
    assert not in_order[touching].any() and not in_order[turned].any()
    assert (solution.contact.gap[in_order] > 0.0).all()
