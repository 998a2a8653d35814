"""Eq. 1 as printed: valid marks, frames, w_m, f32, rods that failed."""

from dataclasses import replace

import numpy as np
import pytest

from doo_ti import Configuration, InputError, Observations, distance
from tests.io.rods import twisted_frames, wavy_vertices
from tests.relaxation.rods import wandering

COUNT, EDGES = 7, 9


def observed(rng, count: int = COUNT, **changes) -> Observations:
    """Observations with measured frames and all marks, or with what ``changes`` say."""
    vertices = wavy_vertices(rng, count, EDGES + 1)
    frames = twisted_frames(vertices, rng.uniform(-2, 2, count), rng)
    return Observations(**{"vertices": vertices, "frames": frames, "rest_length": np.full(EDGES, 3.0)} | changes)


def beside(rods: Configuration, observations: Observations, index, weight: float = 0.0) -> np.ndarray:
    """d = 1/(n−1) Σ ‖v_i − v_i'‖ + w_m/(E−1) Σ ‖m1_j − m1_j'‖, mm, of each rod from its observation with n valid vertices."""
    found = []
    for r, d in enumerate(index):
        valid = observations.valid[d]
        off = np.linalg.norm(rods.vertices[r, valid] - observations.vertices[d, valid], axis=1)
        found.append(off.sum() / (valid.sum() - 1))
        if weight:
            turned = np.linalg.norm(rods.frames[r, ..., 1] - observations.frames[d, ..., 1], axis=1)
            found[-1] += weight * turned.sum() / (len(turned) - 1)
    return np.array(found)


def test_missing_marks_are_left_out(rng):
    valid = rng.random((COUNT, EDGES + 1)) < 0.6
    valid[:, :2] = True
    vertices = wavy_vertices(rng, COUNT, EDGES + 1)
    rods, found = wandering(rng, COUNT, EDGES), []
    for missing in (np.nan, 1e6, np.inf):
        observations = observed(rng, vertices=np.where(valid[..., None], vertices, missing), valid=valid, frames=None)
        found.append(distance(rods, observations))
    np.testing.assert_array_equal(found[1:], [found[0]] * 2)
    np.testing.assert_allclose(found[0], beside(rods, observations, range(COUNT)), rtol=1e-13)
    assert (valid.sum(axis=1) < EDGES + 1).any()


def test_many_rods_of_few_observations(rng):
    rods, observations = wandering(rng, 40, EDGES, rng.uniform(2, 4, EDGES)), observed(rng)
    index = rng.integers(0, COUNT, 40)
    found = distance(rods, observations, index, 2.0)
    np.testing.assert_allclose(found, beside(rods, observations, index, 2.0), rtol=1e-13)
    one = Configuration(rods.start, rods.quaternions, rods.rest_length[0])
    np.testing.assert_array_equal(distance(one, observations, index, 2.0), found)


def test_rods_that_came_to_nothing_have_no_distance(rng):
    rods = wandering(rng, COUNT, EDGES)
    rods.quaternions[3] = np.nan
    found = distance(rods, observed(rng), frame_weight=1.0)
    assert np.isnan(found).tolist() == [k == 3 for k in range(COUNT)]


@pytest.mark.parametrize(("changed", "field"), [
    ({"frame_weight": 1.0}, "frame"), ({"frame_weight": -1.0}, "frame_weight"), ({"frame_weight": np.nan}, "frame_weight"),
    ({"frame_weight": "a"}, "frame_weight"), ({"index": np.arange(3)}, "vertices"), ({"index": np.zeros((2, 3), int)}, "index"),
    ({"index": 3}, "index"), ({"index": [0, 1, 2, 3, 4, 5, COUNT]}, "index"), ({"index": [-1, 0, 1, 2, 3, 4, 5]}, "index"),
    ({"rods": 3}, "vertices"), ({"edges": EDGES + 1}, "vertices|edges"), ({"rest_length": np.ones(3)}, "rest_length"),
    ({"rest_length": np.ones((2, 9))}, "rest_length"), ({"start": np.zeros((1, 3))}, "start|quaternions")])
def test_what_cannot_be_compared_is_refused(rng, changed, field):
    rods = wandering(rng, changed.pop("rods", COUNT), changed.pop("edges", EDGES))
    with pytest.raises(InputError, match=field):
        rods = replace(rods, **{key: changed.pop(key) for key in ("rest_length", "start") if key in changed})
        distance(rods, observed(rng, frames=None), **changed)
