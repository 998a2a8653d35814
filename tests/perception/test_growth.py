"""The stages of Algorithm 1: sampled directions, angular suppression, and which hypotheses are kept."""

import numpy as np

from doo_ti.perception.growth import sampled_directions, select_hypotheses, suppress_similar


def test_directions_are_even_and_forward():
    directions = sampled_directions(200)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1)
    assert (directions[:, 0] > 0).all()
    cosine = directions @ directions.T - 3 * np.eye(200)
    nearest = np.degrees(np.arccos(np.clip(cosine.max(axis=1), -1, 1)))
    assert 5 < nearest.min() and nearest.max() < 12


def test_suppression_is_greedy():
    """Against a loop over rows, one direction after the other."""
    random = np.random.default_rng(4)
    directions = sampled_directions(60)
    error = random.random((7, 60))
    error[2] = np.inf
    chosen = suppress_similar(error, directions, np.radians(30), 5)
    for row in range(7):
        left, wanted = dict(enumerate(error[row])), []
        while left and len(wanted) < 5 and np.isfinite(min(left.values())):
            best = min(left, key=left.get)
            wanted.append(best)
            left = {k: value for k, value in left.items() if directions[k] @ directions[best] <= np.cos(np.radians(30))}
        assert chosen[row][chosen[row] >= 0].tolist() == wanted


def test_selection_is_greedy_in_every_set():
    random = np.random.default_rng(5)
    count = 90
    of_set = np.sort(random.integers(0, 4, count)) * 2  # sets without any hypothesis are allowed
    score, tip = random.random(count), random.random((count, 3)) * 3
    direction = random.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    score[3] = np.nan
    kept = select_hypotheses(score, tip, direction, of_set, 6, 1.0, np.radians(60))
    wanted = []
    for one in np.unique(of_set):
        rows = [k for k in np.flatnonzero(of_set == one) if np.isfinite(score[k])]
        found = []
        for k in sorted(rows, key=lambda k: score[k]):
            near = [np.linalg.norm(tip[k] - tip[j]) < 1.0 and direction[k] @ direction[j] > 0.5 for j in found]
            if not any(near) and len(found) < 6:
                found.append(k)
        wanted += found
    assert kept.tolist() == wanted
